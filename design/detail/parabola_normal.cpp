#include "design/detail/parabola_normal.h"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>

namespace lightmill::detail {

namespace {

constexpr std::size_t kFewest = 6;
constexpr double kWellAround = 0.05;      ///< least over greatest spread
constexpr double kWellDetermined = 0.02;  ///< of each term, that the others do not explain

}  // namespace

std::optional<Vec3> parabola_normal(const Vec3& at, const std::vector<Vec3>& around) {
  if (around.size() < kFewest) return std::nullopt;
  Eigen::MatrixXd terms(around.size(), 5);
  Eigen::VectorXd rises(around.size());
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (std::size_t k = 0; k < around.size(); ++k) {
    const Vec3 d = around[k] - at;
    const double weight = 1 / (d.head<2>().squaredNorm() + 1e-12);
    terms.row(k) << d.x(), d.y(), d.x() * d.x(), d.x() * d.y(), d.y() * d.y();
    terms.row(k) *= weight;
    rises[k] = weight * d.z();
    spread += d.head<2>() * d.head<2>().transpose();
  }
  const Vec2 spreads = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(spread).eigenvalues();
  if (spreads[0] < kWellAround * spreads[1]) return std::nullopt;
  const Eigen::VectorXd scale = terms.colwise().norm().transpose();
  if (scale.minCoeff() == 0) return std::nullopt;
  Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr;
  qr.setThreshold(kWellDetermined);
  qr.compute(terms * scale.cwiseInverse().asDiagonal());
  if (qr.rank() < terms.cols()) return std::nullopt;
  const Eigen::VectorXd fit = qr.solve(rises).cwiseQuotient(scale);
  if (!fit.allFinite()) return std::nullopt;
  return Vec3(-fit[0], -fit[1], 1).normalized();
}

}  // namespace lightmill::detail

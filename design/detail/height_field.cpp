#include "design/detail/height_field.h"

#include <Eigen/CholmodSupport>
#include <Eigen/SparseCore>
#include <algorithm>

#include "design/core/errors.h"
#include "design/detail/one_blas_thread.h"

namespace lightmill::detail {

struct HeightIntegrator::Factor {
  Eigen::CholmodDecomposition<Eigen::SparseMatrix<double>, Eigen::Lower> cholesky;
};

HeightIntegrator::HeightIntegrator(const std::vector<Vec2>& xy, const std::vector<std::array<int, 3>>& triangles,
                                   const Creases& creases)
    : xy_(xy), factor_(std::make_unique<Factor>()) {
  const OneBlasThread one_blas_thread;
  for (const auto& t : triangles) {
    for (int k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(t[k], t[(k + 1) % 3]);
      edges_.push_back({low, high});
    }
  }
  std::sort(edges_.begin(), edges_.end());
  edges_.erase(std::unique(edges_.begin(), edges_.end()), edges_.end());

  double mean2 = 0;
  for (const auto& [i, j] : edges_) mean2 += (xy_[j] - xy_[i]).squaredNorm() / static_cast<double>(edges_.size());
  // The weighted graph Laplacian; vertex 0 is held, because heights are known up to a constant only.
  const auto count = static_cast<Eigen::Index>(xy_.size());
  constexpr double kShortest = 0.01;  // of the mean, squared
  constexpr double kTorn = 0.05;
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(edges_.size() * 3 + 1);
  for (const auto& [i, j] : edges_) {
    const double weight =
        creases.torn(i, j) ? kTorn : mean2 / std::max((xy_[j] - xy_[i]).squaredNorm(), kShortest * mean2);
    weights_.push_back(weight);
    entries.emplace_back(i, i, weight);
    entries.emplace_back(j, j, weight);
    entries.emplace_back(j, i, -weight);
  }
  entries.emplace_back(0, 0, 1.0);
  Eigen::SparseMatrix<double> laplacian(count, count);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  factor_->cholesky.compute(laplacian);
  if (factor_->cholesky.info() != Eigen::Success)
    throw NumericalError("surface: the height equations cannot be factorised");
}

HeightIntegrator::~HeightIntegrator() = default;

Eigen::VectorXd HeightIntegrator::solve(const Eigen::VectorXd& right) const {
  return factor_->cholesky.solve(right);
}

std::vector<double> HeightIntegrator::integrate(const std::vector<Vec2>& slopes, const Creases& creases) const {
  const OneBlasThread one_blas_thread;
  Eigen::VectorXd right = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(xy_.size()));
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    const auto& [i, j] = edges_[e];
    const double share = creases.crossed[i] == 0 ? 0.5 : creases.share(i, j);
    const double rise = weights_[e] * (share * slopes[i] + (1 - share) * slopes[j]).dot(xy_[j] - xy_[i]);
    right[j] += rise;
    right[i] -= rise;
  }
  const Eigen::VectorXd heights = solve(right);
  if (!heights.allFinite()) throw NumericalError("surface: the height equations have no finite solution");
  const double lowest = heights.minCoeff();
  std::vector<double> result(xy_.size());
  for (Eigen::Index v = 0; v < heights.size(); ++v) result[v] = heights[v] - lowest;
  return result;
}

}  // namespace lightmill::detail

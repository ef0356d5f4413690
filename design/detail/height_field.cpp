#include "design/detail/height_field.h"

#include <Eigen/CholmodSupport>
#include <Eigen/SparseCore>
#include <algorithm>

#include "design/core/errors.h"

namespace lightmill::detail {

struct HeightIntegrator::Factor {
  Eigen::CholmodDecomposition<Eigen::SparseMatrix<double>, Eigen::Lower> cholesky;
};

HeightIntegrator::HeightIntegrator(int vertex_count, const std::vector<std::array<int, 3>>& triangles)
    : vertex_count_(vertex_count), factor_(std::make_unique<Factor>()) {
  for (const auto& t : triangles) {
    for (int k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(t[k], t[(k + 1) % 3]);
      edges_.push_back({low, high});
    }
  }
  std::sort(edges_.begin(), edges_.end());
  edges_.erase(std::unique(edges_.begin(), edges_.end()), edges_.end());

  // The graph Laplacian; vertex 0 is held, because heights are known up to a constant only.
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(edges_.size() * 3 + 1);
  for (const auto& [i, j] : edges_) {
    entries.emplace_back(i, i, 1.0);
    entries.emplace_back(j, j, 1.0);
    entries.emplace_back(j, i, -1.0);
  }
  entries.emplace_back(0, 0, 1.0);
  Eigen::SparseMatrix<double> laplacian(vertex_count, vertex_count);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  factor_->cholesky.compute(laplacian);
  if (factor_->cholesky.info() != Eigen::Success)
    throw NumericalError("surface: the height equations cannot be factorised");
}

HeightIntegrator::~HeightIntegrator() = default;

Eigen::VectorXd HeightIntegrator::solve(const Eigen::VectorXd& right) const {
  return factor_->cholesky.solve(right);
}

std::vector<double> HeightIntegrator::integrate(const std::vector<Vec2>& xy, const std::vector<Vec2>& slopes) const {
  Eigen::VectorXd right = Eigen::VectorXd::Zero(vertex_count_);
  for (const auto& [i, j] : edges_) {
    const double rise = 0.5 * (slopes[i] + slopes[j]).dot(xy[j] - xy[i]);
    right[j] += rise;
    right[i] -= rise;
  }
  const Eigen::VectorXd heights = solve(right);
  if (!heights.allFinite()) throw NumericalError("surface: the height equations have no finite solution");
  const double lowest = heights.minCoeff();
  std::vector<double> result(vertex_count_);
  for (int v = 0; v < vertex_count_; ++v) result[v] = heights[v] - lowest;
  return result;
}

}  // namespace lightmill::detail

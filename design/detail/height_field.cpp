#include "design/detail/height_field.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "design/core/errors.h"

namespace lightmill::detail {

HeightIntegrator::HeightIntegrator(const std::vector<Vec2>& xy, const std::vector<std::array<int, 3>>& triangles,
                                   const Creases& creases)
    : xy_(xy) {
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
  constexpr double kShortest = 0.01;  // of the mean, squared
  constexpr double kTorn = 0.05;
  std::vector<GraphEdge> weighted;
  weighted.reserve(edges_.size());
  for (const auto& [i, j] : edges_) {
    weights_.push_back(creases.torn(i, j) ? kTorn : mean2 / std::max((xy_[j] - xy_[i]).squaredNorm(), kShortest * mean2));
    weighted.push_back({i, j, weights_.back()});
  }
  tie_parts(static_cast<int>(xy_.size()), 1.0, weighted);
  factor_.emplace(xy_, weighted);
}

std::vector<double> HeightIntegrator::integrate(const std::vector<Vec2>& slopes, const Creases& creases) const {
  std::vector<double> right(xy_.size(), 0.0);
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    const auto& [i, j] = edges_[e];
    const double share = creases.crossed[i] == 0 ? 0.5 : creases.share(i, j);
    const double rise = weights_[e] * (share * slopes[i] + (1 - share) * slopes[j]).dot(xy_[j] - xy_[i]);
    right[j] += rise;
    right[i] -= rise;
  }
  std::vector<double> heights = factor_->solve(right);
  const double lowest = *std::min_element(heights.begin(), heights.end());
  if (!std::isfinite(std::accumulate(heights.begin(), heights.end(), 0.0)))
    throw NumericalError("surface: the height equations have no finite solution");
  for (double& height : heights) height -= lowest;
  return heights;
}

}  // namespace lightmill::detail

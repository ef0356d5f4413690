#include "design/detail/hollow_limit.h"

#include <cmath>

namespace lightmill::detail {

std::vector<Vec2> limited_hollows(std::vector<Vec2> slopes, const std::vector<Vec3>& positions,
                                  const std::vector<std::array<int, 2>>& edges, const Creases& creases, double radius_mm) {
  constexpr int kSweeps = 300;
  constexpr double kClose = 0.01;   // of the limit
  constexpr double kMargin = 1.04;  // of the radius: heights follow slopes that are none of a surface only on the whole
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    bool done = true;
    for (std::size_t k = 0; k < edges.size(); ++k) {
      // There and back again: what is too much travels along the order of the edges.
      const auto& [i, j] = edges[sweep % 2 == 0 ? k : edges.size() - 1 - k];
      if (creases.torn(i, j)) continue;
      const Vec2 way = (positions[j] - positions[i]).head<2>();
      const double length = way.norm();
      if (!(length > 0)) continue;
      const Vec2 along = way / length;
      // The curvature of a graph along a direction, from its second derivative.
      const Vec2 mean = (slopes[i] + slopes[j]) / 2;
      const double rise = mean.dot(along);
      const double most = length / (kMargin * radius_mm) * (1 + rise * rise) * std::sqrt(1 + mean.squaredNorm());
      const double excess = (slopes[j] - slopes[i]).dot(along) - most;
      if (!(excess > 0)) continue;
      done &= excess < kClose * most;
      slopes[i] += excess / 2 * along;
      slopes[j] -= excess / 2 * along;
    }
    if (done) break;
  }
  return slopes;
}

}  // namespace lightmill::detail

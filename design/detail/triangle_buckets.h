// Triangles of the plane by place.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// Squares over the triangles' box, about two triangles each; every square knows the triangles whose boxes touch it.
class TriangleBuckets {
 public:
  TriangleBuckets() = default;
  TriangleBuckets(const std::vector<Vec2>& points, const std::vector<std::array<int, 3>>& triangles) {
    for (const Vec2& p : points) box_.include(p);
    side_ = std::max(1, static_cast<int>(std::sqrt(static_cast<double>(triangles.size()) / 2)));
    buckets_.resize(static_cast<std::size_t>(side_) * side_);
    for (std::size_t t = 0; t < triangles.size(); ++t) {
      Box2 box;
      for (const int v : triangles[t]) box.include(points[v]);
      for (int j = along(box.min, 1); j <= along(box.max, 1); ++j) {
        for (int i = along(box.min, 0); i <= along(box.max, 0); ++i)
          buckets_[static_cast<std::size_t>(j) * side_ + i].push_back(static_cast<int>(t));
      }
    }
  }

  [[nodiscard]] const Box2& box() const { return box_; }
  /// All triangles that hold a place within the box; beside it, those near the border.
  [[nodiscard]] const std::vector<int>& near(const Vec2& place) const {
    return buckets_[static_cast<std::size_t>(along(place, 1)) * side_ + along(place, 0)];
  }

 private:
  [[nodiscard]] int along(const Vec2& place, int axis) const {
    const double pitch = std::max(box_.size()[axis], 1e-9) / side_;
    return static_cast<int>(std::clamp((place[axis] - box_.min[axis]) / pitch, 0.0, side_ - 1.0));
  }

  Box2 box_;
  int side_ = 0;
  std::vector<std::vector<int>> buckets_;
};

}  // namespace lightmill::detail

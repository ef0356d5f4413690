// Segments in the plane by place, for the ways from points to the nearest of them.
#pragma once

#include <array>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

using Segment = std::array<Vec2, 2>;

/// Segments within `reach` of a point are in the point's bucket.
class NearBorder {
 public:
  NearBorder(std::vector<Segment> segments, double reach);

  /// Ways from the point to the border shorter than `reach` (at most the constructor's): the shortest, and every other
  /// that meets a segment's inside at an angle of more than 45 degrees to those found before (the second side of a
  /// corner, the far side of a bridge).
  [[nodiscard]] std::vector<Vec2> ways(const Vec2& point, double reach) const;

  /// Whether any segment is nearer than the constructor's reach.
  [[nodiscard]] bool near(const Vec2& point) const;

 private:
  [[nodiscard]] int column(double x) const;
  [[nodiscard]] int row(double y) const;
  [[nodiscard]] const std::vector<int>& bucket(const Vec2& point) const;

  std::vector<Segment> segments_;
  double reach_;
  Box2 box_;
  double pitch_ = 1;
  int columns_ = 1, rows_ = 1;
  std::vector<std::vector<int>> buckets_;
};

}  // namespace lightmill::detail

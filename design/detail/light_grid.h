// A grid that collects light exactly: triangles, segments and boxes of flux are shared out over its pixels.
#pragma once

#include "design/core/geometry.h"
#include "design/core/grid.h"

namespace lightmill::detail {

/// Coordinates are in pixels: pixel (i, j) is [i, i+1] x [j, j+1]. What falls beside the grid is added to `outside`, so
/// that the flux handed in is always the flux in `flux` plus `outside`.
class LightGrid {
 public:
  LightGrid(int width, int height) : flux(width, height) {}

  /// Spreads `amount` evenly over a triangle of either orientation. A triangle without area is the limit of thin ones:
  /// a segment whose density rises and falls linearly, or a point.
  void add_triangle(const Vec2& a, const Vec2& b, const Vec2& c, double amount);

  /// Spreads `amount` over the segment that a triangle with these (collinear) corners collapses to.
  void add_segment(const Vec2& a, const Vec2& b, const Vec2& c, double amount);

  void add_point(const Vec2& p, double amount);

  /// Spreads `amount` evenly over a box that is at most one pixel wide and high.
  void add_small_box(const Vec2& centre, double half_width, double half_height, double amount);

  Grid<double> flux;
  double outside = 0;
};

}  // namespace lightmill::detail

// Exact area coverage of pixels by filled outlines, and exact flux of grids and lines on other grids.
#pragma once

#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"

namespace lightmill::detail {

enum class FillRule { kNonZero, kEvenOdd };

/// Share of each pixel of a `width` x `height` grid over `extent` (row 0 at the smallest y) that lies inside the
/// outlines (closed polygons that may cross themselves and each other), by the given rule. Analytic, to rounding.
Grid<double> coverage(const std::vector<std::vector<Vec2>>& outlines, FillRule rule, const Box2& extent, int width,
                      int height);

/// Flux onto another grid over the same rectangle, by exact overlap.
Grid<double> box_filtered(const Grid<double>& flux, int width, int height);

/// Adds the flux of a segment with a linear density per mm to the pixels it passes; what lies outside the grid is left
/// out.
void add_segment(Grid<double>& flux, const Box2& extent, const Vec2& from, const Vec2& to, double density_from,
                 double density_to);

}  // namespace lightmill::detail

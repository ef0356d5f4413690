// Filled shapes as light: which borders of the irradiance a viewer would see, exactly.
#pragma once

#include <vector>

#include "design/core/geometry.h"
#include "design/target.h"

namespace lightmill::detail {

enum class FillRule { kNonZero, kEvenOdd };

/// A filled shape: a viewer shows irradiance `light` with the given opacity over what lies beneath.
struct Fill {
  std::vector<std::vector<Vec2>> outlines_mm;  ///< closed polygons that may cross themselves and each other
  FillRule rule = FillRule::kNonZero;
  double light = 0;
  double opacity = 1;
};

/// The borders of what a viewer shows of the fills within the extent, later fills covering earlier ones, on black.
/// Edges are cut where they cross; borders meet only at their ends, to rounding.
/// Throws InputError when there are too many crossings to do that in reasonable time.
std::vector<AreaBorder> borders_of(const std::vector<Fill>& fills, const Box2& extent);

}  // namespace lightmill::detail

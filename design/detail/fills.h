// Filled shapes as light: which borders of the irradiance a viewer would see, exactly.
#pragma once

#include <vector>

#include "design/core/geometry.h"
#include "design/target.h"

namespace lightmill::detail {

enum class FillRule { kNonZero, kEvenOdd };

/// The inside of closed polygons that may cross themselves and each other.
struct Region {
  std::vector<std::vector<Vec2>> outlines_mm;
  FillRule rule = FillRule::kNonZero;
  [[nodiscard]] bool contains(const Vec2& p) const;
};

/// What shows only where one of the regions is.
using Clip = std::vector<Region>;

/// A filled shape: a viewer shows irradiance `light` with the given opacity over what lies beneath.
struct Fill {
  Region shape;
  double light = 0;
  double opacity = 1;
  int group = -1;          ///< the innermost group of shapes that are shown as one layer; -1: none
  std::vector<int> clips;  ///< it shows only where all of them are
};

/// Shapes, next to each other in drawing order, that are put together first and shown with the opacity then.
struct FillGroup {
  double opacity = 1;
  int parent = -1;  ///< comes before it; -1: none
};

/// Filled shapes in drawing order: later ones cover earlier ones.
struct FilledShapes {
  std::vector<Fill> fills;
  std::vector<FillGroup> groups;
  std::vector<Clip> clips;
};

/// The borders of what a viewer shows of the shapes within the extent, on black.
/// Edges are cut where they cross; borders meet only at their ends, to rounding.
/// Throws InputError when there are too many crossings to do that in reasonable time.
std::vector<AreaBorder> borders_of(const FilledShapes& shapes, const Box2& extent);

/// The parts of a curve inside a box or a clip; densities are interpolated at the cuts.
std::vector<CurveLight> clipped(const CurveLight& curve, const Box2& box);
std::vector<CurveLight> clipped(const CurveLight& curve, const Clip& clip);

}  // namespace lightmill::detail

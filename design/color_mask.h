// The semi-transparent filter on a lens that colours its caustic: each place of the lens's back passes the colour of
// the picture where its light lands [paper fig. 9].
#pragma once

#include <optional>
#include <vector>

#include "design/beams.h"
#include "design/target.h"

namespace lightmill {

/// Linear colours over a rectangle, row 0 at the smallest y.
struct ColourGrid {
  Box2 extent;
  Grid<float> red, green, blue;
};

/// The colours of the target's picture on the receiver; empty when it is gray, or there is none.
std::optional<ColourGrid> target_colours(const TargetSpec& spec);

/// Curves and points that shine on a dark place of the picture would go out behind the filter's black: dark colours on them and
/// up to a millimetre beside are lifted towards white, so that the filter is clear there.
void clear_for_curves(ColourGrid& colours, const TargetLight& target);

/// What a filter for this colour passes of red, green and blue: as much as it can, so that one channel passes whole.
/// Black passes nothing: no light shall go there.
Vec3 filter_of(const Vec3& colour);

/// The filter on z = 0 over `extent` with pixels of 1 / `pixels_per_mm`. Colours are the target's between its pixels'
/// centres; light that lands beside the picture is stopped, places through which no light of the surface comes are
/// clear. `ends` as ray_ends() gives for the mesh.
ColourGrid colour_mask(const SurfaceMesh& mesh, const std::vector<RayEnds>& ends, const ColourGrid& colours,
                       const Box2& extent, double pixels_per_mm);

/// The caustic through the filter: light that lands at a place has the filter's colour for that place.
ColourGrid coloured(const Caustic& caustic, const ColourGrid& colours);

}  // namespace lightmill

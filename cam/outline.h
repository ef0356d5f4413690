// Where the lens lies as seen along Z: what is milled as optical surface, and what the part is cut out along.
#pragma once

#include <vector>

#include "cam/spline_surface.h"
#include "design/optics.h"

namespace lightmill {

/// A rectangle or a disk about the origin, or the inside of one loop.
struct Outline {
  enum class Shape { kRectangle, kDisk, kLoop };
  Shape shape = Shape::kRectangle;
  Vec2 size_mm{0, 0};         ///< of rectangle and disk
  std::vector<Vec2> loop_mm;  ///< counter-clockwise, without crossings

  [[nodiscard]] bool contains(const Vec2& place_mm) const;
  [[nodiscard]] double area_mm2() const;
};

/// The lens's outline. Throws InputError when it is more than one piece, has holes, or crosses itself.
Outline outline_of(const Lens& lens);

/// The outline as places at most `pitch_mm` apart, counter-clockwise; corners are among them.
std::vector<Vec2> outline_places(const Outline& outline, double pitch_mm);

/// Lowest and highest place of the surface along the outline, at places 0.1 mm apart.
struct BorderHeights {
  double lowest_mm, highest_mm;
};
BorderHeights border_heights(const SplineSurface& surface, const Outline& outline);

/// Larger by a land of this width all around; a rectangle's corners stay sharp, a loop's become round.
Outline with_land(const Outline& outline, double width_mm);

/// The way of the centre of a mill of this radius around the part, counter-clockwise: nowhere nearer, and at most 6 um
/// farther than it could be. Throws InputError where the mill does not fit into the outline.
std::vector<Vec2> way_around(const Outline& outline, double radius_mm);

/// The surface as it is up to 6 mm outside the outline, then going over into level ground at the lowest place of the border,
/// for good; nowhere outside lower than `drop_mm` (or half the lens's thickness there) below that ground. So nothing that a
/// fit makes up far from the lens matters to the cutters, and none is led below the land or the back.
SplineSurface faded_outside(const SplineSurface& surface, const Outline& outline, double drop_mm);

}  // namespace lightmill

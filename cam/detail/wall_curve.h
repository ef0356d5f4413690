// The outline as the solid's walls follow it: smooth curves between its corners, seen along Z.
#pragma once

#include <vector>

#include "cam/outline.h"

namespace lightmill::detail {

/// A piece of the border from one upright edge to the next, the lens on its left: cubics through places with these speeds
/// at the knots (two knots: a straight line), or an arc of a circle about the origin whose parameter is the angle.
struct WallPiece {
  std::vector<double> knots;
  std::vector<Vec2> places, speeds;
  double radius_mm = 0;  ///< above 0: the arc

  [[nodiscard]] bool straight() const { return radius_mm == 0 && knots.size() == 2; }
  [[nodiscard]] Vec2 place(double t) const;
  [[nodiscard]] Vec2 speed(double t) const;
  /// Where x (axis 0) or y (1) turns around, in order, with both ends: between them it rises or falls all the way.
  [[nodiscard]] std::vector<double> turns(int axis) const;
};

/// At least two, in order, counter-clockwise, each ending where the next one begins to the bit. A place where the outline
/// turns by more than 0.25, or where a curve would leave a chord by more than about 0.05 mm, is a corner.
std::vector<WallPiece> wall_pieces(const Outline& outline);

/// The integral of the surface's height within the walls, mm^3.
double volume_within(const SplineSurface& surface, const std::vector<WallPiece>& walls);

/// The area within the walls.
double area_within_mm2(const std::vector<WallPiece>& walls);

}  // namespace lightmill::detail

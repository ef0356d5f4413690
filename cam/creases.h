// Concave creases sharper than the finishing ball, as lines with what the ball leaves in them.
#pragma once

#include <vector>

#include "cam/reachable.h"

namespace lightmill {

/// A line along which the ball rests on two flanks and leaves a fillet. Lengths as seen along Z but for the leftover.
struct Crease {
  std::vector<Vec2> line_mm;
  std::vector<double> half_width_mm;  ///< of what is not reached, at every place of the line, to the farther side
  double length_mm = 0;
  double angle_rad = 0;       ///< between the normals of the flanks where the fillet ends; the mean along the line
  double most_angle_rad = 0;
  double fillet_mm = 0;       ///< mean width of what is not reached
  double area_mm2 = 0;        ///< not reached along the line
  double leftover_um = 0;     ///< highest above the design
  Vec3 one_normal = Vec3::UnitZ(), other_normal = Vec3::UnitZ();  ///< of the flanks half-way along the line
};

/// From the reachable surface of a ball on a grid; lines shorter than `shortest_mm` are left out. The longest first.
std::vector<Crease> concave_creases(const SplineSurface& surface, const ReachableSurface& reachable, double shortest_mm = 1);

}  // namespace lightmill

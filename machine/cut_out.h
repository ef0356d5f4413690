// How a part came out of its blank: deviation of its walls from the outline, and the tabs that hold it.
#pragma once

#include <vector>

#include "cam/outline.h"
#include "machine/solid_stock.h"

namespace lightmill {

/// Wall minus outline at right angles to it, positive where material is left. Where there is no wall within 1 mm of the outline
/// the deviation counts as 1 mm.
struct WallDeviation {
  double max_left_um = 0, max_gouge_um = 0, rms_um = 0;
  Vec3 left_place_mm = Vec3::Zero(), gouge_place_mm = Vec3::Zero();
  long places = 0;  ///< where it was measured: where x and y rays between the two heights cross the outline
};
WallDeviation measure_walls(const SolidStock& solid, const Outline& outline, double from_mm, double to_mm);

/// A bridge of material over the slot around a part.
struct Tab {
  Vec2 place_mm = Vec2::Zero();  ///< its middle
  double height_mm = 0;          ///< of its lowest place on the best way across
  double width_mm = 0;           ///< just below that height, along the slot's middle
};
/// What stands higher than `least_mm` all the way across a slot of this width around the part; heights to a hundredth of
/// the blank's. A skin over the whole slot is one bridge.
std::vector<Tab> find_tabs(const SolidStock& solid, const Outline& part, double slot_mm, double least_mm);

}  // namespace lightmill

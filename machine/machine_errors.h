// How a real machine and its cutters differ from their files: what the dry run may add between joints and stock.
#pragma once

#include "cam/cutter.h"
#include "design/core/geometry.h"

namespace lightmill {

/// All zero: none. A certificate says how large an error may be, not which way it goes: `seed` draws the signs.
struct MachineErrors {
  Vec3 backlash_mm = Vec3::Zero();      ///< lost motion of X, Y, Z where they turn round
  double outer_backlash_rad = 0, inner_backlash_rad = 0;
  Vec3 scale = Vec3::Zero();            ///< the axis goes (1 + scale) of its way, from the workpiece's origin
  Vec3 squareness_rad = Vec3::Zero();   ///< X leans by y * [0] and z * [1], Y by z * [2]
  Vec3 outer_pivot_mm = Vec3::Zero();   ///< where the rotary axes really are, from where the machine file says
  Vec3 inner_pivot_mm = Vec3::Zero();
  Vec3 drift_mm = Vec3::Zero();         ///< of the tip when the machine is warm: drift (1 - exp(-t / drift_hours))
  double drift_hours = 1;
  double tool_radius_mm = 0;            ///< every cutter is larger by this
  double runout_mm = 0;                 ///< its axis stands off the spindle's by this
  Vec3 vibration_mm = Vec3::Zero();     ///< amplitude of the tip's
  double vibration_hz = 0;
  unsigned seed = 0;                    ///< 0: every sign as given, the vibration begins at zero

  [[nodiscard]] bool moves_the_tip() const;
};

/// The same with the signs that the seed draws, and the vibration's phase.
struct DrawnErrors {
  MachineErrors errors;
  double phase_rad = 0;
};
DrawnErrors drawn(const MachineErrors& errors);

/// A cutter as it turns: larger by the radius's error; off its axis by the runout it sweeps a body with a flat end of that
/// radius.
Cutter as_it_turns(Cutter cutter, const MachineErrors& errors);

}  // namespace lightmill

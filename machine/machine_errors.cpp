#include "machine/machine_errors.h"

#include <random>

namespace lightmill {

bool MachineErrors::moves_the_tip() const {
  return !(backlash_mm.isZero(0) && outer_backlash_rad == 0 && inner_backlash_rad == 0 && scale.isZero(0) &&
           squareness_rad.isZero(0) && outer_pivot_mm.isZero(0) && inner_pivot_mm.isZero(0) && drift_mm.isZero(0) &&
           (vibration_mm.isZero(0) || vibration_hz == 0));
}

DrawnErrors drawn(const MachineErrors& errors) {
  DrawnErrors result{errors, 0};
  if (errors.seed == 0) return result;
  std::mt19937 random(errors.seed);
  const auto sign = [&] { return (random() >> 16 & 1U) != 0 ? 1.0 : -1.0; };
  MachineErrors& e = result.errors;
  for (Vec3* v : {&e.scale, &e.squareness_rad, &e.outer_pivot_mm, &e.inner_pivot_mm, &e.drift_mm, &e.vibration_mm}) {
    for (int i = 0; i < 3; ++i) (*v)[i] *= sign();
  }
  e.tool_radius_mm *= sign();
  result.phase_rad = 2 * kPi * random() / 4294967296.0;
  return result;
}

Cutter as_it_turns(Cutter cutter, const MachineErrors& errors) {
  const MachineErrors e = drawn(errors).errors;
  const bool ball = cutter.is_ball();
  cutter.diameter_mm += 2 * e.tool_radius_mm;
  if (ball) cutter.corner_radius_mm = cutter.radius_mm();
  else if (cutter.corner_radius_mm > 0) cutter.corner_radius_mm += e.tool_radius_mm;
  cutter.diameter_mm += 2 * e.runout_mm;
  return cutter;
}

}  // namespace lightmill

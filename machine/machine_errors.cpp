#include "machine/machine_errors.h"

#include <random>

#include "design/core/errors.h"
#include "design/core/text.h"

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
  const double least = ball || cutter.corner_radius_mm == 0 ? cutter.radius_mm() : cutter.corner_radius_mm;
  if (e.tool_radius_mm <= -least) {
    throw InputError("tool_radius_um = " + compact(e.tool_radius_mm * 1000, 3) + " leaves nothing of the " + compact(least * 1000, 3) + " um " +
                     (least == cutter.radius_mm() ? "radius" : "corner radius") + " of '" + cutter.name + "'; give how far cutters are off their files, a few um");
  }
  cutter.diameter_mm += 2 * e.tool_radius_mm;
  if (ball) cutter.corner_radius_mm = cutter.radius_mm();
  else if (cutter.corner_radius_mm > 0) cutter.corner_radius_mm += e.tool_radius_mm;
  cutter.diameter_mm += 2 * e.runout_mm;
  return cutter;
}

}  // namespace lightmill

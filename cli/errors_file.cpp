#include "cli/errors_file.h"

#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kMicrometre = 1e-3;
constexpr double kMicrometrePerMetre = 1e-6;
constexpr double kArcSecond = kPi / 180 / 3600;
/// Larger ones are no errors but another machine.
constexpr double kMost = 1e5;

/// One text form for reading and writing: visit(key, value, unit).
template <typename Errors, typename Visit>
void visit_all(Errors& e, Visit&& visit) {
  visit("backlash_um", e.backlash_mm, kMicrometre);
  visit("outer_backlash_arcsec", e.outer_backlash_rad, kArcSecond);
  visit("inner_backlash_arcsec", e.inner_backlash_rad, kArcSecond);
  visit("scale_um_per_m", e.scale, kMicrometrePerMetre);
  visit("squareness_um_per_m", e.squareness_rad, kMicrometrePerMetre);
  visit("outer_pivot_um", e.outer_pivot_mm, kMicrometre);
  visit("inner_pivot_um", e.inner_pivot_mm, kMicrometre);
  visit("drift_um", e.drift_mm, kMicrometre);
  visit("drift_hours", e.drift_hours, 1.0);
  visit("tool_radius_um", e.tool_radius_mm, kMicrometre);
  visit("runout_um", e.runout_mm, kMicrometre);
  visit("vibration_um", e.vibration_mm, kMicrometre);
  visit("vibration_hz", e.vibration_hz, 1.0);
}

}  // namespace

MachineErrors read_machine_errors(TomlTable& table) {
  MachineErrors errors;
  const auto refuse = [&](const char* key, const char* rule) { throw InputError(table.complaint(key, rule)); };
  visit_all(errors, [&](const char* key, auto& value, double unit) {
    if constexpr (std::is_same_v<std::decay_t<decltype(value)>, Vec3>) {
      value = table.vector3(key, value / unit) * unit;
      if (!(value.cwiseAbs().maxCoeff() <= kMost * unit)) refuse(key, "must be three numbers of at most 100000");
    } else {
      value = table.number_in(key, value / unit, -kMost, kMost) * unit;
    }
  });
  if (errors.backlash_mm.minCoeff() < 0) refuse("backlash_um", "must not be below 0");
  if (errors.outer_backlash_rad < 0) refuse("outer_backlash_arcsec", "must not be below 0");
  if (errors.inner_backlash_rad < 0) refuse("inner_backlash_arcsec", "must not be below 0");
  if (errors.drift_hours < 0.001) refuse("drift_hours", "must be at least 0.001");
  if (errors.runout_mm < 0) refuse("runout_um", "must not be below 0");
  if (errors.vibration_hz < 0 || errors.vibration_hz > 2000) refuse("vibration_hz", "must be in 0 to 2000");
  if (!errors.vibration_mm.isZero(0) && errors.vibration_hz == 0) refuse("vibration_hz", "must be above 0 where vibration_um is: say at which frequency");
  errors.seed = static_cast<unsigned>(table.integer_in("seed", 0, 0, 1'000'000'000));
  return errors;
}

std::string machine_errors_text(const MachineErrors& errors, std::string_view prefix) {
  std::string text;
  const auto line = [&](const char* key, const std::string& value) { text += std::string(prefix) + key + " = " + value + "\n"; };
  const auto number = [](double value) { return compact(value, 6); };
  visit_all(errors, [&](const char* key, const auto& value, double unit) {
    if constexpr (std::is_same_v<std::decay_t<decltype(value)>, Vec3>) {
      line(key, "[" + number(value.x() / unit) + ", " + number(value.y() / unit) + ", " + number(value.z() / unit) + "]");
    } else {
      line(key, number(value / unit));
    }
  });
  line("seed", std::to_string(errors.seed));
  return text;
}

}  // namespace lightmill

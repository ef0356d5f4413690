// Canned cycles of RS274/NGC and Fanuc.
#include <tuple>

#include "machine/detail/word_reader.h"

namespace lightmill::detail {

namespace {
constexpr int kMostPecks = 10000;
// How far above the last depth a drill comes back: LinuxCNC's; on Fanuc a parameter (5114, 5115) says so.
constexpr double kPeckGap_mm = 0.254;
}  // namespace

/// The sticky words of a cycle: as written, so that G90 and G91 may change between two holes.
void WordReader::read_cycle(double height) {
  if (last_cycle_ < 0) cycle_.level = height;
  if (motion_ != last_cycle_) {
    const double level = cycle_.level;
    cycle_ = {};
    cycle_.level = level;
  }
  last_cycle_ = motion_;
  const std::string name = "G" + std::to_string(motion_ / 10);
  const auto sticky = [&](char letter, std::optional<double>& kept, bool needed, double scale) {
    if (has(letter)) kept = use(letter) * scale;
    if (needed && !kept) reject(1, name + " needs " + letter);
  };
  sticky('R', cycle_.r, true, unit_);
  sticky(static_cast<char>('X' + kPlanes[plane_][2]), cycle_.depth, true, unit_);
  const bool dwells = motion_ == 820 || motion_ == 860 || motion_ == 880 || motion_ == 890;
  if (dwells || motion_ == 740 || motion_ == 840) sticky('P', cycle_.dwell_s, dwells && !fanuc_, fanuc_ ? 1e-3 : 1);
  if (cycle_.dwell_s && *cycle_.dwell_s < 0) reject(column_of('P'), "negative time");
  if (motion_ == 730 || motion_ == 830) {
    sticky('Q', cycle_.peck, true, unit_);
    if (!(*cycle_.peck > 0)) reject(1, name + " needs a positive Q");
  }
  if (motion_ == 870) {
    sticky('I', cycle_.i, true, unit_);
    sticky('J', cycle_.j, true, unit_);
    sticky('K', cycle_.k, true, unit_);
  }
}

/// G73, G74, G81 to G89 along the axis across the plane.
void WordReader::drill() {
  const auto u = static_cast<std::size_t>(kPlanes[plane_][0]), v = static_cast<std::size_t>(kPlanes[plane_][1]),
             w = static_cast<std::size_t>(kPlanes[plane_][2]);
  if (fanuc_ && plane_ != 0) reject(1, "canned cycles are understood in G17 only");
  if (plane_ != 0 && (motion_ == 740 || motion_ == 840))
    reject(1, "G74 and G84 are understood in G17 only");  // LinuxCNC confuses the axes elsewhere
  if (path_.on()) reject(1, "canned cycles while cutter compensation is on");
  if (feed_.inverse_time() || feed_.value == 0) reject(1, "a canned cycle needs a feed per minute");
  const AxisValues from = path_.place();
  path_.forget_lead();
  read_cycle(from[w]);
  const double r = *cycle_.r + (incremental_ ? cycle_.level : 0), bottom = *cycle_.depth + (incremental_ ? r : 0);
  if (r < bottom) reject(1, "R lies below the hole's end");
  if (cycle_.peck && (r - bottom) / *cycle_.peck > kMostPecks) reject(1, "too many pecks");
  const char counter = fanuc_ && has('K') ? 'K' : 'L';
  const double count = has(counter) ? use(counter) : 1;
  if (!(count >= (fanuc_ ? 0 : 1) && count <= 10000) || count != std::floor(count))
    reject(column_of(counter), std::string(1, counter) + " counts holes");
  const double clear = to_r_level_ ? r : std::max(cycle_.level, r);
  AxisValues step{};
  AxisValues at = from;
  for (const int axis : taken_axes()) {
    if (axis > 2) reject(1, "a rotary axis in a canned cycle");
    const double value = target_value(axis);
    (incremental_ ? step : at)[static_cast<std::size_t>(axis)] = value;
  }
  if (cycle_.level < r) {
    AxisValues up = from;
    up[w] = r;
    if (up != core_.here()) core_.move(up, true, 0);
  }
  at[w] = std::max(core_.here()[w], clear);
  const auto go = [&](bool rapid) {
    if (at != core_.here()) core_.move(at, rapid, rapid ? 0 : core_.seconds_at(at, feed().value));
  };
  for (int n = 0; n < static_cast<int>(count); ++n) {
    for (std::size_t i = 0; i < 3; ++i) at[i] += step[i];
    if (polar()) std::tie(at[u], at[v]) = polar_end();
    go(true);
    at[w] = r;
    go(true);
    make_hole(at, r, bottom, clear);
  }
}

/// From the R level down and up again.
void WordReader::make_hole(AxisValues& at, double r, double bottom, double clear) {
  const auto u = static_cast<std::size_t>(kPlanes[plane_][0]), v = static_cast<std::size_t>(kPlanes[plane_][1]),
             w = static_cast<std::size_t>(kPlanes[plane_][2]);
  const auto go = [&](double height, bool rapid) {
    at[w] = height;
    if (at != core_.here()) core_.move(at, rapid, rapid ? 0 : core_.seconds_at(at, feed().value));
  };
  const auto dwell = [&] {
    if (cycle_.dwell_s.value_or(0) > 0) core_.say(ProgramStep::kDwell, 0, *cycle_.dwell_s);
  };
  const auto turn = [&](int direction) { core_.say(ProgramStep::kSpindle, direction, direction == 5 ? 0 : rpm_); };
  const std::string name = "G" + std::to_string(motion_ / 10);
  if ((motion_ == 740 || motion_ == 840 || (motion_ >= 860 && motion_ <= 880)) && spindle_ == 5)
    reject(1, name + " with the spindle standing");
  switch (motion_) {
    case 730:
    case 830:
      for (double depth = r - *cycle_.peck; depth > bottom; depth -= *cycle_.peck) {
        go(depth, false);
        if (motion_ == 830) go(r, true);
        go(depth + kPeckGap_mm, true);
      }
      go(bottom, false);
      return go(clear, true);
    case 740:
    case 840:
      if (spindle_ != (motion_ == 840 ? 3 : 4)) reject(1, name + " with the spindle turning the other way");
      go(bottom, false);
      turn(5);
      turn(7 - spindle_);
      dwell();
      if (fanuc_) go(r, false);
      go(clear, fanuc_);
      turn(5);
      return turn(spindle_);
    case 850:
      go(bottom, false);
      go(r, false);
      return go(clear, true);
    case 890:
      go(bottom, false);
      dwell();
      return go(clear, false);
    case 860:
      go(bottom, false);
      dwell();
      turn(5);
      go(clear, true);
      return turn(spindle_);
    case 870: {
      const double* const ijk[] = {&*cycle_.i, &*cycle_.j, &*cycle_.k};
      const double top = *ijk[w] + (incremental_ ? bottom : 0);
      const auto aside = [&](int sign) {
        at[u] += sign * *ijk[u];
        at[v] += sign * *ijk[v];
        go(at[w], true);
      };
      aside(1);
      turn(5);
      go(bottom, true);
      aside(-1);
      turn(spindle_);
      go(top, false);
      go(bottom, false);
      turn(5);
      aside(1);
      go(clear, true);
      aside(-1);
      return turn(spindle_);
    }
    case 880:
      go(bottom, false);
      dwell();
      turn(5);
      core_.say(ProgramStep::kPause, 0);  // the operator takes the cutter out
      turn(spindle_);
      at[w] = clear;
      return go(clear, true);
    default:
      go(bottom, false);
      dwell();
      return go(clear, true);
  }
}

}  // namespace lightmill::detail

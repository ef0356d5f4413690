// Canned cycles of RS274/NGC and Fanuc.
#include <tuple>

#include "machine/detail/word_reader.h"

namespace lightmill::detail {

/// G81, G82, G83, G85, G89 along Z.
void WordReader::drill() {
  if (plane_ != 0) reject(1, "canned cycles are understood in G17 only");
  if (compensation_.on()) reject(1, "canned cycles while cutter compensation is on");
  if (inverse_time_ || feed_ == 0) reject(1, "a canned cycle needs a feed per minute");
  const AxisValues from = place();
  lead_ = {};
  const bool fresh = motion_ != last_cycle_;
  last_cycle_ = motion_;
  if (fresh) cycle_level_ = from[2];
  if (has('R'))
    cycle_r_ = use('R') * unit_ + (incremental_ ? cycle_level_ : 0);
  else if (fresh)
    reject(1, "a canned cycle needs R");
  if (has('Z'))
    cycle_z_ = use('Z') * unit_ + (incremental_ ? cycle_r_ : 0);
  else if (fresh)
    reject(1, "a canned cycle needs Z");
  const double dwell = (motion_ == 82 || motion_ == 89) && has('P') ? use('P') : 0;
  if (dwell < 0) reject(column_of('P'), "negative time");
  if (motion_ == 83) {
    if (has('Q')) cycle_q_ = use('Q') * unit_;
    if (cycle_q_ <= 0) reject(1, "G83 needs a positive Q");
    if ((cycle_r_ - cycle_z_) / cycle_q_ > 10000) reject(1, "G83 with too many pecks");
  }
  const double count = has('L') ? use('L') : 1;
  if (!(count >= 1 && count <= 10000) || count != std::floor(count)) reject(column_of('L'), "L counts holes");
  if (cycle_r_ < cycle_z_) reject(1, "R lies below Z");
  const double back = to_r_level_ ? cycle_r_ : std::max(from[2], cycle_r_);
  AxisValues step{};
  AxisValues at = from;
  for (const int axis : taken_axes()) {
    const double v = target_value(axis);
    if (incremental_)
      step[static_cast<std::size_t>(axis)] = v;
    else
      at[static_cast<std::size_t>(axis)] = v;
  }
  const auto go = [&](double z, bool rapid) {
    at[2] = z;
    if (at != core_.here()) core_.move(at, rapid, rapid ? 0 : core_.seconds_at(at, feed_));
  };
  for (int n = 0; n < static_cast<int>(count); ++n) {
    if (core_.here()[2] < cycle_r_) {
      AxisValues up = core_.here();
      up[2] = cycle_r_;
      core_.move(up, true, 0);
    }
    for (std::size_t i = 0; i < 5; ++i) at[i] += step[i];
    if (polar()) std::tie(at[0], at[1]) = polar_end();
    go(core_.here()[2], true);
    go(cycle_r_, true);
    if (motion_ == 83) {
      for (double z = cycle_r_ - cycle_q_; z > cycle_z_; z -= cycle_q_) {
        go(z, false);
        go(cycle_r_, true);
        go(z + 0.254, true);
      }
    }
    go(cycle_z_, false);
    if (dwell > 0) core_.say(ProgramStep::kDwell, 0, dwell);
    if (motion_ == 85 || motion_ == 89) go(cycle_r_, false);
    go(back, true);
  }
}

}  // namespace lightmill::detail

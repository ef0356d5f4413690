// What a program asks of a probe, of inputs and outputs: this machine has none, and answers as the control would.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

/// G38.2 to G38.5: there is never a contact.
void WordReader::probe() {
  constexpr double kShortest_mm = 0.254;
  if (path_.on()) reject(1, "probing while cutter compensation is on");
  const Feed given = feed();
  if (motion_ >= 384) reject(1, "the probe has no contact that could open");
  const AxisValues from = path_.place();
  AxisValues to = from;
  for (const int axis : taken_axes()) {
    const auto i = static_cast<std::size_t>(axis);
    if (axis > 2) reject(1, "a rotary axis in a probing move");
    const double v = target_value(axis);
    to[i] = incremental_ ? from[i] + v : v;
  }
  const double way = std::hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
  if (way < kShortest_mm) reject(1, "a probing move that is too short");
  path_.forget_lead();
  core_.move(to, false, given.inverse_time ? 60 / given.value : core_.seconds_at(to, given.value));
  if (motion_ == 382) reject(1, "the probe made no contact");
  for (int axis = 0; axis < 3; ++axis) numbers_[5061 + axis] = to[static_cast<std::size_t>(axis)] / unit_;
  numbers_[5070] = 0;
}

/// M50 to M53 and M62 to M68: overrides stay at 100 %, outputs lead nowhere, inputs are low.
void WordReader::signal(int code) {
  const std::string name = "M" + std::to_string(code);
  if (code <= 53) {
    if (has('P')) use('P');
    return;
  }
  if (code <= 65) {
    const double p = need('P', name.c_str());
    if (p < 0) reject(column_of('P'), "P names an output");
    return;
  }
  if (code >= 67) {
    if (need('E', name.c_str()) < 0) reject(column_of('E'), "E names an output");
    need('Q', name.c_str());
    return;
  }
  if (has('P') == has('E')) reject(1, "M66 takes either P or E");
  const bool analog = has('E');
  const double input = use(analog ? 'E' : 'P'), wait = has('L') ? use('L') : 0, most = has('Q') ? use('Q') : 0;
  if (input < 0) reject(1, "M66 with a negative input");
  if (wait != std::floor(wait) || wait < 0 || wait > 4) reject(column_of('L'), "L is a way to wait, 0 to 4");
  if (wait != 0 && analog) reject(column_of('L'), "an analog input is read at once");
  if (wait != 0 && !(most > 0)) reject(1, "M66 that waits needs a time Q");
  // To rise, to fall and to be high an input that stays low takes all the time.
  const bool in_vain = wait >= 1 && wait <= 3;
  if (in_vain) path_.say(ProgramStep::kDwell, 0, most);
  numbers_[5399] = in_vain ? -1 : 0;
}

}  // namespace lightmill::detail

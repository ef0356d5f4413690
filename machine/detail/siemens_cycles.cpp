// Siemens 840D: CYCLE81, 82 and 83, called once or, with MCALL, behind every block that moves.
#include "machine/detail/siemens_reader.h"

namespace lightmill::detail {

namespace {
constexpr double kMostPecks = 10000;
}

/// CYCLE81(RTP, RFP, SDIS, DP, DPR), CYCLE82(..., DTB), CYCLE83(..., FDEP, FDPR, DAM, DTB, DTS, FRF, VARI), MCALL
/// before them; false if the block is none.
bool SiemensReader::cycle_call() {
  const int where = column();
  const bool modal = take_name("MCALL");
  skip_blanks();
  if (modal && (p_ == end_ || *p_ == ';')) {
    modal_cycle_.reset();
    return true;
  }
  const std::string_view word = name();
  if (word != "CYCLE81" && word != "CYCLE82" && word != "CYCLE83") {
    if (modal) reject(column(), "MCALL is understood with CYCLE81, CYCLE82 and CYCLE83");
    return false;
  }
  Cycle cycle;
  cycle.number = 80 + (word.back() - '0');
  take_name(word);
  skip_blanks();
  cycle.values = arguments();
  const std::size_t most = cycle.number == 81 ? 5 : cycle.number == 82 ? 6 : 12;
  for (std::size_t i = most; i < cycle.values.size(); ++i) {
    if (cycle.values[i].value_or(0) != 0) reject(where, "a value too many that is not 0");
  }
  cycle.values.resize(12);
  if (path_.on()) reject(where, "a cycle while cutter compensation is on");
  if (modal)
    modal_cycle_ = cycle;
  else
    drill(cycle);
  return true;
}

/// From above the reference plane to the depth, DP or DPR below that plane, and back to the retract plane.
void SiemensReader::drill(const Cycle& cycle) {
  refuse_inside_contour();
  const auto given = [&](std::size_t i) { return cycle.values[i].has_value(); };
  const auto length = [&](std::size_t i) { return cycle.values[i].value_or(0) * unit_; };
  const auto across = static_cast<std::size_t>(kPlanes[plane_][2]);
  if (!given(0) || !given(1) || (!given(3) && !given(4))) reject(1, "a drilling cycle needs RTP, RFP and DP or DPR");
  const double reference = length(1), clear = reference + std::abs(length(2)), retract = length(0),
               bottom = given(4) ? reference - std::abs(length(4)) : length(3);
  if (!(bottom < clear && retract >= reference)) reject(1, "RTP lies above RFP, and that above the depth");
  const bool pecks = cycle.number == 83;
  double first = clear - bottom, factor = 1;
  if (pecks) {
    if (!given(5) && !given(6)) reject(1, "CYCLE83 needs FDEP or FDPR");
    first = given(6) ? std::abs(length(6)) : reference - length(5);
    if (length(7) < 0) reject(1, "CYCLE83 is understood with DAM from 0 on, not as a factor");
    if (given(10) && length(10) != 0) factor = *cycle.values[10];
    if (!(first > 0 && (reference - bottom) / first <= kMostPecks && factor > 0))
      reject(1, "CYCLE83 needs a first depth below RFP and FRF above 0");
  }
  const bool lifts_out = pecks && cycle.values[11].value_or(0) != 0;
  const auto to = [&](double height, bool rapid, double share = 1) {
    AxisValues place = path_.place();
    if (place[across] == height) return;
    place[across] = height;
    Feed at = rapid ? Feed{} : feed();
    at.value *= share;
    path_.straight(place, rapid, at);
  };
  const auto wait = [&](std::size_t i) {
    const double seconds = cycle.values[i].value_or(0);
    if (seconds < 0) reject(1, "a dwell counted in turns is not understood");
    if (seconds > 0) path_.say(ProgramStep::kDwell, 0, seconds);
  };
  if (feed_.inverse_time()) reject(1, "a drilling cycle under G93");
  to(clear, true);
  if (!pecks) {
    to(bottom, false);
    if (cycle.number == 82) wait(5);
    return to(retract, true);
  }
  // The manual's distance before the ground to which the drill comes back in rapid, and by which it breaks chips.
  const double depth = reference - bottom, before = depth <= 30 ? 0.6 : std::min(depth / 50, 7.0), chip = 1;
  double peck = first;
  for (double done = 0; done < depth;) {
    if (done > 0) {
      // Each stroke is shorter by DAM until it is as short as that; what is left of less than two such is halved.
      const double less = length(7), left = depth - done;
      if (less > 0) peck = peck - less > less ? peck - less : peck > less ? less : peck;
      if (less > 0 && peck == less && left > less && left < 2 * less) peck = left / 2;
      if (lifts_out) {
        to(clear, true);
        wait(9);
        to(std::min(clear, reference - done + before), true);
      } else {
        to(reference - done + chip, false);
      }
    }
    const double share = done == 0 ? factor : 1;
    done = std::min(done + peck, depth);
    to(reference - done, false, share);
    wait(8);
  }
  to(retract, true);
}

}  // namespace lightmill::detail

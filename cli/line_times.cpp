#include "cli/line_times.h"

#include <algorithm>
#include <utility>

#include "design/core/text.h"

namespace lightmill {

LineTimes::LineTimes(std::function<TextLine(const TimedBlock&)> place)
    : place_(std::move(place)),
      rows_("program,line,rapid,stood_s,seconds,asked_mm_per_min,reached_mm_per_min,top_speed_per_s,acceleration_per_s2\n") {}

void LineTimes::add(const TimedBlock& block) {
  if (block.motion.line != line_ || block.program != program_ || block.motion.rapid != rapid_ || block.motion.stood_s > 0) {
    end_row();
    line_ = block.motion.line;
    program_ = block.program;
    rapid_ = block.motion.rapid;
    stood_s_ = block.motion.stood_s;
    at_ = place_(block);
  }
  seconds_ += block.seconds;
  asked_s_ += block.motion.seconds;
  tip_mm_ += block.tip_mm;
  speed_ = std::max(speed_, block.top);
  const bool steady = block.entry == block.top && block.exit == block.top;
  if (!steady) acceleration_ = std::max(acceleration_, block.acceleration);
}

void LineTimes::end_row() {
  constexpr int kDecimals = 6;
  if (seconds_ > 0 || stood_s_ > 0) {
    rows_ += at_.program + "," + std::to_string(at_.line) + (rapid_ ? ",1" : ",0");
    const auto feed = [this](double seconds) { return seconds > 0 ? tip_mm_ / seconds * 60 : 0; };
    for (const double value : {stood_s_, seconds_, feed(asked_s_), feed(seconds_), speed_, acceleration_}) {
      rows_ += "," + compact(value, kDecimals);
    }
    rows_ += "\n";
  }
  stood_s_ = seconds_ = asked_s_ = tip_mm_ = speed_ = acceleration_ = 0;
}

std::string LineTimes::table() {
  end_row();
  line_ = -1;
  return std::move(rows_);
}

}  // namespace lightmill

#include "machine/program_schedule.h"

#include <algorithm>
#include <cmath>

#include "machine/motion_timing.h"
#include "machine/program_lines.h"
#include "machine/program_trace.h"

namespace lightmill {

namespace {

/// Adds up times by line, in whichever order they come.
class Collector {
 public:
  Collector(const MachineModel& machine, std::string_view program) : timer_(machine) {
    for (const ProgramLine& line : program_lines(program)) numbers_.push_back(line.number);
    schedule_.until_s.assign(numbers_.size(), 0);
    timer_.on_block = [this](const TimedBlock& block) { add(block.motion.line, block.seconds); };
  }
  /// `motion.line` is a number of the text.
  void move(const Motion& motion, const std::vector<SweptMove>& pieces) {
    add(motion.line, motion.stood_s);
    timer_.move(motion, pieces.front(), pieces.back());
  }
  ProgramSchedule finish() {
    timer_.finish();
    double sum = 0;
    for (double& seconds : schedule_.until_s) seconds = sum += seconds;
    return std::move(schedule_);
  }

 private:
  MotionTimer timer_;
  std::vector<long> numbers_;
  ProgramSchedule schedule_;
  void add(long number, double seconds) {
    const auto at = std::lower_bound(numbers_.begin(), numbers_.end(), number) - numbers_.begin();
    if (at < static_cast<long>(numbers_.size())) schedule_.until_s[static_cast<std::size_t>(at)] += seconds;
  }
};

}  // namespace

double ProgramSchedule::at(long lines) const {
  if (lines <= 0 || until_s.empty()) return 0;
  return until_s[std::min(static_cast<std::size_t>(lines), until_s.size()) - 1];
}

ProgramSchedule schedule_program(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                                 std::string_view program) {
  Collector times(machine, program);
  trace_program(machine, setup, dialect, program, [&](const Motion& motion, const std::vector<SweptMove>& pieces) { times.move(motion, pieces); });
  return times.finish();
}

void PaceEstimate::observe(double scheduled_s, double now_s, bool moving) {
  if (begun_ && moving) {
    const double seconds = now_s - last_now_s_, kept = std::exp(-seconds / kMemory_s);
    actual_s_ = actual_s_ * kept + seconds;
    scheduled_s_ = scheduled_s_ * kept + scheduled_s - last_scheduled_s_;
  }
  begun_ = true;
  last_scheduled_s_ = scheduled_s;
  last_now_s_ = now_s;
}

}  // namespace lightmill

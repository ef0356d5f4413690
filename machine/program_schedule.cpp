#include "machine/program_schedule.h"

#include <algorithm>
#include <cmath>

#include "machine/kinematics.h"
#include "machine/motion_timing.h"
#include "machine/program_lines.h"
#include "machine/program_reader.h"
#include "machine/program_run.h"

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
  [[nodiscard]] long number(long count) const { return numbers_[static_cast<std::size_t>(count - 1)]; }
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

void run_lines(const MachineModel& machine, const OperatorSetup& setup, std::string_view program, Collector& times) {
  SimulationOptions options;
  options.remove_stock = false;
  SimulatedMachine simulated(machine, setup, options);
  simulated.on_motion = [&](Motion motion, const std::vector<SweptMove>& pieces) {
    motion.line = times.number(motion.line);
    times.move(motion, pieces);
  };
  for (const ProgramLine& line : program_lines(program)) {
    simulated.receive(line.text);
    simulated.receive("\n");
    simulated.work(1);
    simulated.receive("~");  // goes on at tool changes and pauses, is nothing elsewhere
    simulated.take_replies();
  }
}

/// As quick as the axes are; above 0, because pieces share a motion's time.
constexpr double kRapid_s = 1e-6;

JointPosition position(const AxisValues& q) {
  return {q[0], q[1], q[2], q[3], q[4]};
}

void run_file(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
              std::string_view program, Collector& times) {
  const ReaderSetup reader = reader_setup(machine, setup);
  WorkpieceView view(machine, setup.workpiece_origin_mm);
  std::vector<SweptMove> pieces;
  Motion motion;
  motion.to = position(reader.start);
  double length_mm = 0;
  read_program(program, reader_dialect(dialect), machine, reader, [&](const ProgramStep& step) {
    if (step.kind == ProgramStep::kDwell) motion.stood_s += step.seconds;
    if (step.kind == ProgramStep::kSpindle) motion.spindle_rpm = step.number == 5 ? 0 : step.rpm;
    if (step.kind == ProgramStep::kChangeTool) {
      motion.tool = step.number;
      const auto found = reader.tool_length_mm.find(step.number);
      length_mm = found == reader.tool_length_mm.end() ? 0 : found->second;
    }
    if (step.kind != ProgramStep::kMove) return;
    motion.line = step.line;
    motion.from = motion.to;
    motion.to = position(step.target);
    motion.rapid = step.rapid;
    motion.seconds = std::max(step.seconds, kRapid_s);
    motion.corner_tolerance_mm = step.corner_tolerance_mm;
    motion.exact_stop = step.exact_stop;
    pieces.clear();
    view.sweep(motion, length_mm, {}, pieces);
    times.move(motion, pieces);
    motion.stood_s = 0;
  });
}

}  // namespace

double ProgramSchedule::at(long lines) const {
  if (lines <= 0 || until_s.empty()) return 0;
  return until_s[std::min(static_cast<std::size_t>(lines), until_s.size()) - 1];
}

ProgramSchedule schedule_program(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                                 std::string_view program) {
  Collector times(machine, program);
  if (dialect == "grblhal") {
    run_lines(machine, setup, program, times);
  } else {
    run_file(machine, setup, dialect, program, times);
  }
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

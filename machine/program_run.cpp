#include "machine/program_run.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "design/core/text.h"
#include "machine/detail/fault_picture.h"
#include "machine/detail/stock_worker.h"
#include "machine/kinematics.h"
#include "machine/program_lines.h"

namespace lightmill {
namespace {

constexpr double kLimitSlack = 1e-6;  // of a last decimal
constexpr double kDegreesPerRad = 180 / kPi;
constexpr long kStepsPerReport = 4096;
/// A corner that may be rounded by more than this is no longer what was planned, roughing or not; in inches 0.01 is usual.
constexpr double kMostRounding_mm = 0.5;

// Thrown through the reader where the machine stops.
struct Stopped {};

/// The first line behind the closing % of a text that begins with one, which no control reads; 0: there is none.
long line_behind_tape(std::string_view text) {
  int marks = 0;
  for (const ProgramLine& line : program_lines(text)) {
    if (line.text == "%") {
      ++marks;
    } else if (marks == 0) {
      return 0;
    } else if (marks > 1) {
      return line.number;
    }
  }
  return 0;
}

class Runner {
 public:
  Runner(const MachineModel& machine, ReaderDialect dialect, const OperatorSetup& setup, const StockOptions& options,
         const std::function<void(const Motion&)>& on_motion, const std::function<void(const TimedBlock&)>& on_block)
      : machine_(machine),
        dialect_(dialect),
        setup_(setup),
        view_(machine, setup.workpiece_origin_mm, setup.errors),
        timer_(machine),
        on_motion_(on_motion),
        stock_(setup.blank, options),
        reader_(reader_setup(machine, setup)),
        at_(reader_.start) {
    timer_.on_block = on_block;
  }

  /// False if the machine has stopped.
  bool run(const ProgramFile& program, const Monitor& monitor) {
    program_ = program.name;
    stock_.begin_program(program.name);
    timer_.begin_program();
    reader_.start = at_;
    const auto lines = static_cast<double>(std::count(program.text.begin(), program.text.end(), '\n') + 1);
    long steps = 0;
    try {
      const ReadResult read = read_program(program.text, dialect_, machine_, reader_, [&](const ProgramStep& step) {
        if (++steps % kStepsPerReport == 0)
          monitor.report("running " + program.name, static_cast<double>(step.line) / lines);
        // What stops the machine is not executed.
        stopped_blocks_ = step.block - 1;
        perform(step);
      });
      result_.blocks += read.blocks;
      if (read.error) {
        add_fault("error", read.error->line, "column " + std::to_string(read.error->column) + ": " + read.error->rule);
      } else if (!read.ended) {
        add_fault("no_program_end", static_cast<long>(lines),
                  "the program does not end itself; write or copy it again");
      } else if (const long behind = line_behind_tape(program.text); behind > 0) {
        add_fault("behind_end", behind, "the control reads nothing behind the closing %: two programs in one file? Run each by itself");
      }
      return !read.error && read.ended;
    } catch (const Stopped&) {
      result_.blocks += stopped_blocks_;
      return false;
    }
  }

  ProgramRun finish() {
    stock_.finish();
    result_.faults.insert(result_.faults.end(), stock_.faults().begin(), stock_.faults().end());
    result_.surface = stock_.stock().surface();
    result_.solid = stock_.stock().solid();
    timer_.finish();
    result_.timing = timer_.sections();
    return std::move(result_);
  }

 private:
  Fault& add_fault(std::string kind, long line, std::string message) {
    Fault fault;
    fault.kind = std::move(kind);
    fault.program = program_;
    fault.line = line;
    fault.message = std::move(message);
    fault.place_mm = view_.cutter(to_position(at_), tool_ ? tool_->length_mm : 0).tip_mm;
    result_.faults.push_back(std::move(fault));
    return result_.faults.back();
  }

  void perform(const ProgramStep& step) {
    switch (step.kind) {
      case ProgramStep::kMove:
        return move(step);
      case ProgramStep::kDwell:
        commanded_s_ += step.seconds;
        stood_s_ += step.seconds;
        return;
      case ProgramStep::kSpindle:
        if (step.number == 3 && !(cutting_ && rpm_ > 0))
          at_speed_s_ = commanded_s_ + machine_.spindle_start_s;
        cutting_ = step.number == 3;  // cutters are right-handed
        rpm_ = step.number == 5 ? 0 : step.rpm;
        return;
      case ProgramStep::kChangeTool:
        change_tool(step);
        return;
      case ProgramStep::kEnd:
        cutting_ = false;
        rpm_ = 0;
        return;
      case ProgramStep::kCoolant:
      case ProgramStep::kPause:
        return;
    }
  }

  void change_tool(const ProgramStep& step) {
    cutting_ = false;
    rpm_ = 0;
    told_length_of_ = 0;
    const auto found = std::find_if(setup_.cutters.begin(), setup_.cutters.end(),
                                    [&](const Cutter& cutter) { return cutter.number == step.number; });
    tool_ = found == setup_.cutters.end() ? nullptr : &*found;
    if (tool_ != nullptr) stock_.set_cutter(*tool_);
  }

  void move(const ProgramStep& step) {
    within_limits(step);
    if (!step.rapid || machine_.has_straight_rapids()) return go(step, step.target);
    // Every axis at its own speed: a leg up to the next one's arrival.
    const AxisValues from = at_;
    AxisValues arrivals{};
    for (std::size_t i = 0; i < 5; ++i) arrivals[i] = axis_seconds(i, from[i], step.target[i]);
    AxisValues order = arrivals;
    std::sort(order.begin(), order.end());
    double before = 0;
    for (const double seconds : order) {
      if (seconds <= before) continue;
      AxisValues to = step.target;
      for (std::size_t i = 0; i < 5; ++i) {
        if (arrivals[i] > seconds) to[i] = from[i] + seconds / arrivals[i] * (step.target[i] - from[i]);
      }
      go(step, to);
      before = seconds;
    }
  }

  void go(const ProgramStep& step, const AxisValues& to) {
    Motion motion;
    motion.line = step.line;
    motion.from = to_position(at_);
    motion.to = to_position(to);
    motion.rapid = step.rapid;
    motion.seconds = std::max(step.seconds, least_seconds(to));
    motion.spindle_on = cutting_ && rpm_ > 0 && commanded_s_ >= at_speed_s_ - 1e-9;
    motion.spindle_rpm = rpm_;
    motion.tool = tool_ != nullptr ? tool_->number : 0;
    if (tool_ == nullptr && !step.rapid && !told_no_tool_) {
      told_no_tool_ = true;
      add_fault("no_tool", step.line, "a feed move without a tool in the spindle");
    }
    if (tool_ != nullptr && !step.rapid) check_length(step);
    const double rounding = step.corner_tolerance_mm;
    if (!step.rapid && std::isfinite(rounding) && rounding > kMostRounding_mm && rounding != told_rounding_mm_) {
      told_rounding_mm_ = rounding;
      add_fault("tolerance", step.line, "corners may be rounded by " + compact(rounding, 3) + " mm; no more than " + compact(kMostRounding_mm, 3) +
                                            " mm leave the part as planned").amount_mm = rounding;
    }
    motion.corner_tolerance_mm = rounding;
    motion.exact_stop = step.exact_stop;
    motion.stood_s = std::exchange(stood_s_, 0.0);
    commanded_s_ += motion.seconds;
    at_ = to;
    pieces_.clear();
    view_.sweep(motion, tool_ ? tool_->length_mm : 0, {}, pieces_);
    timer_.move(motion, pieces_.front(), pieces_.back());
    if (on_motion_) on_motion_(motion);
    if (tool_ != nullptr) stock_.move(pieces_);
  }

  /// The length in force is the spindle's tool's, where a word of its own calls it.
  void check_length(const ProgramStep& step) {
    if (step.number == 0 || step.number == tool_->number || step.number == told_length_of_) return;
    told_length_of_ = step.number;
    const double off = reader_.tool_length_mm.at(step.number) - tool_->length_mm;
    const std::string number = std::to_string(tool_->number), of = std::to_string(step.number);
    add_fault("wrong_tool", step.line,
              "cuts with tool " + number + " ('" + tool_->name + "') at the length of tool " + of + " (H" + of + "), its tip " + compact(std::abs(off), 3) +
                  " mm too " + (off >= 0 ? "high" : "low") + "; write H" + number + ", or T" + of + " if that tool is meant")
        .amount_mm = std::abs(off);
  }

  [[nodiscard]] double axis_seconds(std::size_t axis, double from, double to) const {
    const std::array<double, 5> speeds{machine_.x.max_speed_mm_per_s, machine_.y.max_speed_mm_per_s,
                                       machine_.z.max_speed_mm_per_s, machine_.outer.max_speed_rad_per_s,
                                       machine_.inner.max_speed_rad_per_s};
    return speeds[axis] > 0 ? std::abs(to - from) / speeds[axis] : 0;
  }

  [[nodiscard]] double least_seconds(const AxisValues& to) const {
    double seconds = 0;
    for (std::size_t i = 0; i < 5; ++i) seconds = std::max(seconds, axis_seconds(i, at_[i], to[i]));
    return seconds;
  }

  void within_limits(const ProgramStep& step) {
    const auto check = [&](char letter, double value, double least, double most, double unit, const char* name) {
      // An endless axis has no limits; words of a last decimal may stand just outside.
      const double slack = unit == 1 ? 1e-3 : kLimitSlack;
      if (value >= least - slack && value <= most + slack) return;
      const double amount = value < least ? least - value : value - most;
      Fault& fault = add_fault("limit", step.line,
                               std::string(1, letter) + " would pass its limit " + compact((value < least ? least : most) * unit, 3) +
                                   " " + name + " by " + compact(amount * unit, 3) + " " + name);
      fault.amount_mm = amount;
      fault.picture = travel_picture(machine_, to_position(at_), to_position(step.target));
      throw Stopped{};
    };
    const AxisValues& q = step.target;
    check('X', q[0], machine_.x.min_mm, machine_.x.max_mm, 1, "mm");
    check('Y', q[1], machine_.y.min_mm, machine_.y.max_mm, 1, "mm");
    check('Z', q[2], machine_.z.min_mm, machine_.z.max_mm, 1, "mm");
    check(machine_.outer.letter, q[3], machine_.outer.min_rad, machine_.outer.max_rad, kDegreesPerRad, "deg");
    check(machine_.inner.letter, q[4], machine_.inner.min_rad, machine_.inner.max_rad, kDegreesPerRad, "deg");
  }

  const MachineModel& machine_;
  ReaderDialect dialect_;
  const OperatorSetup& setup_;
  WorkpieceView view_;
  MotionTimer timer_;
  const std::function<void(const Motion&)>& on_motion_;
  detail::StockWorker stock_;
  ReaderSetup reader_;
  ProgramRun result_;
  std::string program_;
  long stopped_blocks_ = 0;
  AxisValues at_{};
  const Cutter* tool_ = nullptr;
  bool cutting_ = false, told_no_tool_ = false;
  int told_length_of_ = 0;
  double rpm_ = 0, at_speed_s_ = 0;
  double told_rounding_mm_ = 0;
  double stood_s_ = 0;
  double commanded_s_ = 0;  ///< machine time without accelerations: no spindle is ever thought ready too early
  std::vector<SweptMove> pieces_;
};

}  // namespace

ReaderSetup reader_setup(const MachineModel& machine, const OperatorSetup& setup) {
  ReaderSetup reader;
  reader.start[2] = machine.retract_z_mm;
  const Vec3& zero = setup.workpiece_origin_mm;
  reader.offsets[static_cast<std::size_t>(setup.work_offset - 54)] = {zero.x(), zero.y(), zero.z(), 0, 0};
  for (const Cutter& cutter : setup.cutters) {
    reader.tool_length_mm[cutter.number] = cutter.length_mm;
    reader.tool_diameter_mm[cutter.number] = cutter.diameter_mm;
  }
  return reader;
}

ProgramRun run_programs(const MachineModel& machine, ReaderDialect dialect, const OperatorSetup& setup,
                        const std::vector<ProgramFile>& programs, const StockOptions& options, const Monitor& monitor,
                        const std::function<void(const Motion&)>& on_motion,
                        const std::function<void(const TimedBlock&)>& on_block) {
  Runner runner(machine, dialect, setup, options, on_motion, on_block);
  for (std::size_t i = 0; i < programs.size(); ++i) {
    const auto count = static_cast<double>(programs.size());
    const auto index = static_cast<double>(i);
    if (!runner.run(programs[i], monitor.part(index / count, (index + 1) / count))) break;
  }
  return runner.finish();
}

}  // namespace lightmill

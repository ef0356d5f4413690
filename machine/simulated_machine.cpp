#include "machine/simulated_machine.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <deque>
#include <optional>
#include <utility>

#include "design/core/text.h"
#include "machine/detail/interpreter.h"
#include "machine/detail/receive_buffer.h"
#include "machine/detail/stock_worker.h"
#include "machine/kinematics.h"
#include "machine/program_lines.h"
#include "machine/pseudo_terminal.h"

namespace lightmill {

namespace {

using detail::GcodeStep;
using detail::Joints;

constexpr double kDegreesPerRad = 180 / kPi;
/// Rounding of sums of program numbers (mm, rad) is no overtravel.
constexpr double kLimitSlack = 1e-6;
constexpr std::string_view kBanner = "GrblHAL 1.1f ['$' or '$HELP' for help]\r\n";
/// WCO comes with every so many status reports, as in grblHAL.
constexpr int kReportsPerOffset = 10;

Joints to_array(const JointPosition& j) {
  return {j.x_mm, j.y_mm, j.z_mm, j.outer_rad, j.inner_rad};
}
JointPosition to_position(const Joints& a) {
  return {a[0], a[1], a[2], a[3], a[4]};
}

/// Outside comments, is there a letter of `letters`?
bool has_word(std::string_view line, std::string_view letters) {
  bool comment = false;
  for (const char c : line) {
    if (c == ';') return false;
    if (c == '(') comment = true;
    if (c == ')') comment = false;
    if (!comment &&
        letters.find(static_cast<char>(std::toupper(static_cast<unsigned char>(c)))) != std::string_view::npos) {
      return true;
    }
  }
  return false;
}

}  // namespace

struct SimulatedMachine::Impl {
  SimulatedMachine* outside;
  MachineModel machine;
  OperatorSetup setup;
  SimulationOptions options;
  detail::Interpreter interpreter;
  WorkpieceView view;
  detail::ReceiveBuffer buffer;
  std::unique_ptr<detail::StockWorker> stock;

  // The machine.
  JointPosition joints;  ///< where the axes are
  Joints planned{};      ///< where they are when all planned motions are done
  const Cutter* tool = nullptr;
  int tool_number = 0;
  bool spindle_clockwise = false;
  double rpm = 0;
  double at_speed_s = 0;  ///< machine time at which the spindle has reached its speed
  double machine_seconds = 0;
  double stood_s = 0;  ///< dwell since the last motion
  std::vector<SweptMove> pieces;
  std::vector<Fault> faults;
  bool told_no_tool = false;

  // Motions that wait for their time; always empty when not paced.
  struct Planned {
    Motion motion;
    bool dwell = false;
    double end_s = 0;  ///< machine clock
  };
  std::deque<Planned> planner;
  double held_at_s = 0;

  // The protocol.
  std::string replies;
  bool dead = false;
  bool held = false, door = false, checking = false;
  bool waits_for_tool = false, pauses = false;
  int incoming_tool = 0;
  bool overlong = false;      ///< the beginning of the line in the buffer has been thrown away
  std::size_t next_step = 0;  ///< of the line that waits for the operator
  bool locked = false;        ///< by an alarm; $X or $H unlocks
  bool needs_reset = false;   ///< a critical alarm: deaf until reset
  int latched_error = 0;
  int reports = 0;
  std::string program;
  long program_line = 0;  ///< since reset
  long total_lines = 0;   ///< program lines since power-on
  long executed_lines = 0;
  long oks = 0;
  long received_bytes = 0;
  LineDigest digest;

  // A paced wire.
  std::string wire;
  std::chrono::steady_clock::time_point wire_time{};
  double wire_credit = 0;

  Impl(SimulatedMachine* self, const MachineModel& m, const OperatorSetup& s, const SimulationOptions& o)
      : outside(self),
        machine(m),
        setup(s),
        options(o),
        interpreter(m),
        view(m, s.workpiece_origin_mm),
        buffer(m.receive_buffer_bytes) {
    if (options.remove_stock) stock = std::make_unique<detail::StockWorker>(setup.blank, options.stock);
    joints.x_mm = std::clamp(0.0, machine.x.min_mm, machine.x.max_mm);
    joints.y_mm = std::clamp(0.0, machine.y.min_mm, machine.y.max_mm);
    joints.z_mm = std::clamp(machine.retract_z_mm, machine.z.min_mm, machine.z.max_mm);
    if (setup.work_offset >= 54 && setup.work_offset <= 59) {
      interpreter.set_offset(setup.work_offset, {setup.workpiece_origin_mm.x(), setup.workpiece_origin_mm.y(),
                                                 setup.workpiece_origin_mm.z()});
    }
    synchronise();
  }

  void synchronise() {
    planned = to_array(joints);
    interpreter.set_position(planned);
  }

  [[nodiscard]] bool paced() const { return options.time_factor > 0; }
  /// Machine time that runs with the wall clock.
  [[nodiscard]] double clock_s() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count() *
           options.time_factor;
  }

  // --- Replies ---

  void say(std::string_view text) {
    replies += text;
    replies += "\r\n";
  }
  void say_ok() {
    if (++oks != options.planted.drop_ok_at) replies += "ok\r\n";
  }
  void say_error(int code) { say("error:" + std::to_string(code)); }

  Fault& add_fault(std::string kind, std::string message) {
    Fault fault;
    fault.kind = std::move(kind);
    fault.program = program;
    fault.line = program_line;
    fault.message = std::move(message);
    faults.push_back(std::move(fault));
    return faults.back();
  }

  void raise_alarm(int number, const std::string& kind, const std::string& message, double amount_mm = 0) {
    Fault& fault = add_fault(kind, message);
    fault.amount_mm = amount_mm;
    fault.place_mm = view.cutter(joints, tool ? tool->length_mm : 0).tip_mm;
    say("ALARM:" + std::to_string(number));
    say("[MSG:Reset to continue]");
    planner.clear();
    locked = needs_reset = true;
    stop_spindle();
  }

  // --- Motion ---

  void stop_spindle() {
    rpm = 0;
    spindle_clockwise = false;
  }

  double least_seconds(const Joints& from, const Joints& to) const {
    const std::array<double, 5> speeds = {machine.x.max_speed_mm_per_s, machine.y.max_speed_mm_per_s,
                                          machine.z.max_speed_mm_per_s, machine.outer.max_speed_rad_per_s,
                                          machine.inner.max_speed_rad_per_s};
    double seconds = machine.min_block_s;
    for (std::size_t i = 0; i < 5; ++i) {
      if (speeds[i] > 0) seconds = std::max(seconds, std::abs(to[i] - from[i]) / speeds[i]);
    }
    return seconds;
  }

  /// The first overtravel of a line's moves, in words; nothing if all is within the limits.
  struct Overtravel {
    std::string message;
    double amount = 0;
  };
  [[nodiscard]] std::optional<Overtravel> overtravel() const {
    for (const GcodeStep& step : interpreter.steps()) {
      if (step.kind != GcodeStep::kMove) continue;
      const auto check = [&](char letter, double value, double least, double most, double unit,
                             const char* unit_name) -> std::optional<Overtravel> {
        if (value >= least - kLimitSlack && value <= most + kLimitSlack) return std::nullopt;
        const double amount = value < least ? least - value : value - most;
        return Overtravel{std::string(1, letter) + " would pass its limit " +
                              compact((value < least ? least : most) * unit, 3) + " " + unit_name + " by " +
                              compact(amount * unit, 3) + " " + unit_name,
                          amount};
      };
      const Joints& q = step.target;
      if (auto found = check('X', q[0], machine.x.min_mm, machine.x.max_mm, 1, "mm")) return found;
      if (auto found = check('Y', q[1], machine.y.min_mm, machine.y.max_mm, 1, "mm")) return found;
      if (auto found = check('Z', q[2], machine.z.min_mm, machine.z.max_mm, 1, "mm")) return found;
      if (auto found =
              check(machine.outer.letter, q[3], machine.outer.min_rad, machine.outer.max_rad, kDegreesPerRad, "deg")) {
        return found;
      }
      if (auto found =
              check(machine.inner.letter, q[4], machine.inner.min_rad, machine.inner.max_rad, kDegreesPerRad, "deg")) {
        return found;
      }
    }
    return std::nullopt;
  }

  void perform(const Planned& done) {
    if (done.dwell) {
      machine_seconds += done.motion.seconds;
      stood_s += done.motion.seconds;
      return;
    }
    Motion motion = done.motion;
    // Cutters are right-handed: they cut when the spindle turns clockwise and has reached its speed.
    motion.spindle_on = spindle_clockwise && machine_seconds >= at_speed_s - 1e-9;
    motion.stood_s = std::exchange(stood_s, 0.0);
    machine_seconds += motion.seconds;
    joints = motion.to;
    if (tool == nullptr && !motion.rapid && !told_no_tool) {
      told_no_tool = true;
      add_fault("no_tool", "a feed move without a tool in the spindle");
    }
    if (!stock && !outside->on_motion) return;
    pieces.clear();
    view.sweep(motion, tool ? tool->length_mm : 0, {}, pieces);
    if (outside->on_motion) outside->on_motion(motion, pieces);
    if (stock && tool != nullptr) stock->move(pieces);
  }

  void plan(const GcodeStep& step) {
    Planned next;
    next.dwell = step.kind == GcodeStep::kDwell;
    next.motion.line = program_line;
    if (next.dwell) {
      next.motion.seconds = step.seconds;
    } else {
      next.motion.from = to_position(planned);
      next.motion.to = to_position(step.target);
      next.motion.rapid = step.rapid;
      next.motion.seconds = std::max(step.seconds, least_seconds(planned, step.target));
      next.motion.spindle_rpm = rpm;
      next.motion.tool = tool_number;
      planned = step.target;
    }
    if (!paced()) {
      perform(next);
      return;
    }
    const double start = planner.empty() ? clock_s() : planner.back().end_s;
    next.end_s = start + next.motion.seconds;
    planner.push_back(next);
  }

  /// Lets the planned motions happen whose time has come.
  void advance() {
    if (planner.empty() || held || door || waits_for_tool) return;
    const double now = clock_s();
    while (!planner.empty() && planner.front().end_s <= now) {
      perform(planner.front());
      planner.pop_front();
    }
  }

  /// Carries out the steps of the current line from next_step on; stops where the operator is asked.
  void run_steps() {
    const std::vector<GcodeStep>& steps = interpreter.steps();
    while (next_step < steps.size()) {
      const GcodeStep& step = steps[next_step++];
      switch (step.kind) {
        case GcodeStep::kMove:
        case GcodeStep::kDwell:
          plan(step);
          break;
        case GcodeStep::kSpindle:
          if (step.number == 0) {
            stop_spindle();
          } else {
            if (rpm == 0 || (step.number == 3) != spindle_clockwise)
              at_speed_s = machine_seconds + machine.spindle_start_s;
            rpm = step.rpm;
            spindle_clockwise = step.number == 3;
          }
          break;
        case GcodeStep::kChangeTool: {
          stop_spindle();
          const bool known = step.number == 0 || find_cutter(step.number) != nullptr;
          if (!known) {
            raise_alarm(3, "alarm", "tool " + std::to_string(step.number) + " is not in the magazine");
            next_step = steps.size();
            return;
          }
          waits_for_tool = true;
          incoming_tool = step.number;
          return;
        }
        case GcodeStep::kPause:
          pauses = true;
          return;
        case GcodeStep::kEnd:
          stop_spindle();
          say("[MSG:Pgm End]");
          break;
        case GcodeStep::kSelectTool:
        case GcodeStep::kCoolant:
        case GcodeStep::kOptionalPause:
          break;
      }
    }
  }

  [[nodiscard]] const Cutter* find_cutter(int number) const {
    for (const Cutter& cutter : setup.cutters) {
      if (cutter.number == number) return &cutter;
    }
    return nullptr;
  }

  void resume() {
    if (door || held) {
      // What was planned is late by the time of the hold.
      const double late = clock_s() - held_at_s;
      for (Planned& waiting : planner) waiting.end_s += late;
      door = held = false;
      return;
    }
    if (waits_for_tool) {
      waits_for_tool = false;
      tool_number = incoming_tool;
      tool = find_cutter(incoming_tool);
      if (stock && tool != nullptr) stock->set_cutter(*tool);
      run_steps();
    } else if (pauses) {
      pauses = false;
      run_steps();
      if (!pauses && !needs_reset) say_ok();
    }
  }

  // --- Real-time bytes ---

  /// True if the byte was one: it does not enter the buffer.
  bool real_time(unsigned char byte) {
    switch (byte) {
      case '?':
      case 0x80:
      case 0x87:
        report(byte == 0x87);
        return true;
      case '!':
      case 0x82:
        if (!held && !door && !locked) {
          advance();
          held = true;
          held_at_s = clock_s();
        }
        return true;
      case '~':
      case 0x81:
        if (!locked) resume();
        return true;
      case 0x18:
        reset();
        return true;
      case 0x84:
        if (!door && !locked) {
          advance();
          if (!held) held_at_s = clock_s();
          door = true;
          say("[MSG:Check Door]");
        }
        return true;
      default:
        return byte >= 0x80;  // overrides and others that are not simulated
    }
  }

  void reset() {
    advance();
    const bool moving = !planner.empty() && !held && !door;
    planner.clear();
    buffer.clear();
    interpreter.reset();
    synchronise();
    stop_spindle();
    held = door = checking = waits_for_tool = pauses = needs_reset = false;
    next_step = 0;
    latched_error = 0;
    program_line = 0;
    reports = 0;
    if (moving) {
      locked = true;
      say("ALARM:3");
    }
    say("");
    say(kBanner.substr(0, kBanner.size() - 2));
    if (locked) say("[MSG:'$H'|'$X' to unlock]");
  }

  [[nodiscard]] std::string axes_text(const Joints& q, bool degrees = true) const {
    std::array<double, 6> values{q[0], q[1], q[2], 0, 0, 0};
    const double unit = degrees ? kDegreesPerRad : 1;
    values[static_cast<std::size_t>(machine.outer.letter - 'A' + 3)] = q[3] * unit;
    values[static_cast<std::size_t>(machine.inner.letter - 'A' + 3)] = q[4] * unit;
    std::string text;
    for (std::size_t i = 0; i < 6; ++i) text += (i ? "," : "") + fixed(values[i], 3);
    return text;
  }

  /// Work offset and tool length together, as grblHAL's WCO.
  [[nodiscard]] Joints work_offset() const {
    const auto& offset = interpreter.offset(interpreter.modes().offset);
    return {offset[0], offset[1], offset[2] + interpreter.modes().tool_length_mm, 0, 0};
  }

  void report(bool complete) {
    advance();
    const char* state = "Idle";
    if (locked) {
      state = "Alarm";
    } else if (door) {
      state = "Door:0";
    } else if (waits_for_tool) {
      state = "Tool";
    } else if (held || pauses) {
      state = "Hold:0";
    } else if (checking) {
      state = "Check";
    } else if (!planner.empty() || buffer.next_line().has_value()) {
      state = "Run";
    }
    const int blocks = std::max(0, machine.planner_blocks - static_cast<int>(planner.size()));
    std::string text = std::string("<") + state + "|MPos:" + axes_text(to_array(joints)) +
                       "|Bf:" + std::to_string(blocks) + "," + std::to_string(buffer.free()) +
                       "|FS:" + compact(interpreter.modes().feed, 1) + "," + compact(rpm, 0);
    if (complete || reports % kReportsPerOffset == 0) text += "|WCO:" + axes_text(work_offset());
    if (complete || reports % kReportsPerOffset == 1) text += "|Ov:100,100,100";
    ++reports;
    say(text + ">");
  }

  // --- Lines ---

  /// Executes one line of the buffer; false if there is none or the machine waits for something.
  bool next_line() {
    if (dead || held || door || waits_for_tool || pauses || needs_reset) return false;
    const auto found = buffer.next_line();
    if (!found) {
      if (buffer.drop_longer_than(detail::kLongestLine)) overlong = true;
      return false;
    }
    if (paced() && !planner.empty()) {
      // Spindle, tool and the like happen between motions, not ahead of them; a full planner takes nothing.
      if (static_cast<int>(planner.size()) >= machine.planner_blocks || has_word(*found, "MPT$")) return false;
    }
    std::string_view line = *found;
    const std::size_t first = line.find_first_not_of(" \t\r");
    line = first == std::string_view::npos ? std::string_view()
                                           : line.substr(first, line.find_last_not_of(" \t\r") + 1 - first);
    buffer.drop_line();
    take_line(line);
    return true;
  }

  void take_line(std::string_view line) {
    if (!overlong) {
      if (line.empty()) {
        latched_error = 0;
        say_ok();
        return;
      }
      if (line.front() == '$') {
        latched_error = 0;
        system_command(line);
        return;
      }
    }
    ++program_line;
    ++total_lines;
    const PlantedFaults& planted = options.planted;
    if (total_lines == planted.drop_line_at) return;
    if (total_lines == planted.hang_up_at_line) {
      dead = true;
      return;
    }
    if (total_lines == planted.reset_at_line) {
      reset();
      return;
    }
    if (total_lines == planted.alarm_at_line) {
      raise_alarm(1, "alarm", "a limit switch has closed");
      return;
    }
    if (locked) {
      say_error(9);
      return;
    }
    if (latched_error != 0) {
      say_error(latched_error);
      return;
    }
    const bool spoilt = total_lines == planted.error_at_line;
    const int error = overlong ? static_cast<int>(detail::kOverflow) : spoilt ? 2 : interpreter.execute(line);
    overlong = false;
    if (error != 0) {
      latched_error = error;
      add_fault("error", "error:" + std::to_string(error) + " " + std::string(detail::describe(error)) + " in '" +
                             std::string(line.substr(0, 80)) + "'");
      say_error(error);
      return;
    }
    if (const auto past = overtravel()) {
      raise_alarm(2, "limit", past->message + " in '" + std::string(line.substr(0, 80)) + "'", past->amount);
      return;
    }
    if (checking) {
      say_ok();
      return;
    }
    ++executed_lines;
    digest.add(line);
    next_step = 0;
    run_steps();
    // M6 is acknowledged at once, M0 when the operator goes on, a line that raises an alarm never.
    if (!pauses && !needs_reset) say_ok();
  }

  void system_command(std::string_view line) {
    if (line == "$I" || line == "$i") {
      say("[VER:1.1f.20260817:lightmill simulation]");
      say("[OPT:VNML+," + std::to_string(machine.planner_blocks) + "," + std::to_string(machine.receive_buffer_bytes) +
          ",6,0]");
      say("[AXS:6:XYZABC]");
      say("[NEWOPT:ENUMS,RT+,TC,SED]");
      say("[FIRMWARE:grblHAL]");
    } else if (line == "$$") {
      say("$10=511");
      say("$13=0");
      say("$20=1");
      say("$22=1");
      say("$30=" + fixed(machine.max_spindle_rpm, 3));
      say("$31=" + fixed(machine.min_spindle_rpm, 3));
      say("$110=" + fixed(machine.x.max_speed_mm_per_s * 60, 3));
      say("$111=" + fixed(machine.y.max_speed_mm_per_s * 60, 3));
      say("$112=" + fixed(machine.z.max_speed_mm_per_s * 60, 3));
      say("$130=" + fixed(machine.x.max_mm - machine.x.min_mm, 3));
      say("$131=" + fixed(machine.y.max_mm - machine.y.min_mm, 3));
      say("$132=" + fixed(machine.z.max_mm - machine.z.min_mm, 3));
    } else if (line == "$G") {
      const detail::GcodeModes& m = interpreter.modes();
      std::string text = "[GC:G" + std::to_string(m.motion) + " G" + std::to_string(m.offset) + " G" +
                         std::to_string(m.plane) + " G" + (m.inches ? "20" : "21") + " G" + (m.incremental ? "91" : "90") + " G" +
                         (m.inverse_time ? "93" : "94") + (m.tool_length_mm != 0 ? " G43.1" : " G49") + " M" +
                         std::to_string(m.spindle);
      text += m.mist ? " M7" : "";
      text += m.flood ? " M8" : "";
      text += !m.mist && !m.flood ? " M9" : "";
      say(text + " T" + std::to_string(m.tool) + " F" + compact(m.feed, 1) + " S" + compact(m.rpm, 0) + "]");
    } else if (line == "$#") {
      for (int g = 54; g <= 59; ++g) {
        const auto& o = interpreter.offset(g);
        say("[G" + std::to_string(g) + ":" + axes_text({o[0], o[1], o[2], 0, 0}) + "]");
      }
      say("[TLO:" + axes_text({0, 0, interpreter.modes().tool_length_mm, 0, 0}) + "]");
    } else if (line == "$X") {
      if (locked) say("[MSG:Caution: Unlocked]");
      locked = false;
    } else if (line == "$H") {
      if (checking) {
        say_error(8);
        return;
      }
      locked = false;
      home();
    } else if (line == "$C") {
      if (locked) {
        say_error(9);
        return;
      }
      if (checking) {
        say("[MSG:Disabled]");
        say_ok();
        reset();
        return;
      }
      checking = true;
      say("[MSG:Enabled]");
    } else if (line != "$") {
      say_error(3);
      return;
    }
    say_ok();
  }

  /// Z to the top, then the others.
  void home() {
    GcodeStep up{.kind = GcodeStep::kMove, .rapid = true, .target = planned};
    up.target[2] = machine.z.max_mm;
    plan(up);
    GcodeStep rest = up;
    rest.target = {std::clamp(0.0, machine.x.min_mm, machine.x.max_mm),
                   std::clamp(0.0, machine.y.min_mm, machine.y.max_mm), machine.z.max_mm, 0, 0};
    plan(rest);
    interpreter.set_position(planned);
  }

  // --- The wire ---

  void arrive(std::string_view bytes) {
    for (const char c : bytes) {
      char byte = c;
      if (++received_bytes == options.planted.garble_byte_at) byte = static_cast<char>(byte ^ 1);
      const auto code = static_cast<unsigned char>(byte);
      if ((code >= 0x80 || code == '?' || code == '!' || code == '~' || code == 0x18) && real_time(code)) continue;
      buffer.push(byte);
    }
  }

  /// What has had time to arrive at the given baud rate (ten bits a byte).
  void let_arrive() {
    const auto now = std::chrono::steady_clock::now();
    wire_credit += std::chrono::duration<double>(now - wire_time).count() * options.baud / 10;
    wire_time = now;
    // An idle wire saves nothing up.
    wire_credit = std::min(wire_credit, static_cast<double>(wire.size()));
    const auto count = static_cast<std::size_t>(wire_credit);
    wire_credit -= static_cast<double>(count);
    arrive(std::string_view(wire).substr(0, count));
    wire.erase(0, count);
  }
};

SimulatedMachine::SimulatedMachine(const MachineModel& machine, const OperatorSetup& setup,
                                   const SimulationOptions& options)
    : impl_(std::make_unique<Impl>(this, machine, setup, options)) {}

SimulatedMachine::~SimulatedMachine() = default;

void SimulatedMachine::start() {
  impl_->say("");
  impl_->say(kBanner.substr(0, kBanner.size() - 2));
}

void SimulatedMachine::receive(std::string_view bytes) {
  if (impl_->dead) return;
  if (impl_->options.baud <= 0) {
    impl_->arrive(bytes);
    return;
  }
  if (impl_->wire.empty()) impl_->wire_time = std::chrono::steady_clock::now();
  impl_->wire += bytes;
  impl_->let_arrive();
}

int SimulatedMachine::work(int lines) {
  if (!impl_->wire.empty()) impl_->let_arrive();
  impl_->advance();
  int done = 0;
  while (done < lines && impl_->next_line()) ++done;
  return done;
}

std::string SimulatedMachine::take_replies() {
  std::string replies;
  replies.swap(impl_->replies);
  return replies;
}

void SimulatedMachine::begin_program(const std::string& name) {
  impl_->program = name;
  impl_->program_line = 0;
  if (impl_->stock) impl_->stock->begin_program(name);
}

bool SimulatedMachine::busy() const {
  return !impl_->planner.empty() || !impl_->wire.empty();
}

bool SimulatedMachine::behind() const {
  return impl_->stock && impl_->stock->behind();
}

bool SimulatedMachine::dead() const {
  return impl_->dead;
}

SimulationResult SimulatedMachine::result() const {
  SimulationResult result;
  result.lines = impl_->executed_lines;
  result.machine_seconds = impl_->machine_seconds;
  result.faults = impl_->faults;
  result.received_bytes = impl_->received_bytes;
  result.overflowed_bytes = impl_->buffer.lost();
  result.highest_buffer_fill = impl_->buffer.highest();
  result.received_digest = impl_->digest.hex();
  result.joints = impl_->joints;
  result.tool = impl_->tool_number;
  result.alarm = impl_->locked;
  if (result.overflowed_bytes > 0) {
    Fault fault;
    fault.kind = "overflow";
    fault.program = impl_->program;
    fault.message = std::to_string(result.overflowed_bytes) + " bytes lost because the receive buffer was full";
    result.faults.push_back(std::move(fault));
  }
  if (impl_->stock) {
    impl_->stock->finish();
    const std::vector<Fault>& more = impl_->stock->faults();
    result.faults.insert(result.faults.end(), more.begin(), more.end());
  }
  return result;
}

MachinedSurface SimulatedMachine::machined() {
  if (!impl_->stock) return {};
  impl_->stock->finish();
  return impl_->stock->stock().surface();
}

void serve(SimulatedMachine& machine, PseudoTerminal& terminal, const std::function<bool()>& should_end) {
  using std::chrono::milliseconds;
  // A few lines at a time, then their acknowledgements: the sender writes the next ones while we work.
  constexpr int kLinesAtOnce = 16;
  std::array<char, 65536> bytes;
  std::string unsent;
  bool progress = true;
  while (!should_end()) {
    // Real-time bytes must not wait for lines, so the terminal is looked at between batches.
    const bool behind = machine.behind();
    const milliseconds patience(progress ? 0 : (behind || machine.busy() || !unsent.empty() ? 1 : 20));
    const std::size_t count = terminal.read_some(bytes, patience);
    if (count > 0) machine.receive({bytes.data(), count});
    const int lines = behind ? 0 : machine.work(kLinesAtOnce);
    unsent += machine.take_replies();
    if (!unsent.empty()) unsent.erase(0, terminal.write_some(unsent, milliseconds(0)));
    if (machine.dead()) {
      terminal.hang_up();
      return;
    }
    progress = count > 0 || lines > 0;
  }
}

}  // namespace lightmill

// grbl 1.1 and grblHAL: lines acknowledged one by one, real-time bytes that act at once, alarms and latched errors.
#include <algorithm>
#include <cctype>
#include <cmath>
#include <utility>

#include "design/core/text.h"
#include "machine/detail/controller.h"
#include "machine/detail/fault_picture.h"
#include "machine/detail/interpreter.h"
#include "machine/detail/line_buffer.h"
#include "machine/detail/receive_buffer.h"
#include "machine/detail/sent_text.h"
#include "machine/program_lines.h"

namespace lightmill::detail {

namespace {

constexpr double kDegreesPerRad = 180 / kPi;
/// The work offset comes with every so many status reports, as in both firmwares.
constexpr int kReportsPerOffset = 10;
/// After a limit switch, a soft limit or a reset in motion the firmware is deaf until reset; after others $X is enough.
constexpr int kLastCriticalAlarm = 3;
constexpr int kTowardsContact = 383;  ///< G38.2, G38.3

/// What sets the two firmwares apart.
struct Firmware {
  std::string_view banner;
  std::string_view identity;  ///< before the planner's blocks in [OPT:...]
  int receive_buffer_bytes, planner_blocks;
  bool latches_errors;   ///< refuses all lines after an error, until an empty line, a $ command or a reset
  bool changes_tools;    ///< M6
  int axes;              ///< in reports; three: no rotary words either
  bool reports_buffers;  ///< Bf at power-on ($10 changes it)
  LineBuffer::Keeps keeps;
  std::size_t longest_line;  ///< of what it keeps
};

Firmware firmware_of(Personality personality, const MachineModel& machine) {
  if (personality == Personality::kGrbl) {
    return {"Grbl 1.1h ['$' for help]", "V", 128, 15, false, false, 3, false, LineBuffer::Keeps::kContent, 79};
  }
  return {"GrblHAL 1.1f ['$' or '$HELP' for help]",
          "VNML+",
          machine.receive_buffer_bytes,
          machine.planner_blocks,
          true,
          true,
          6,
          true,
          LineBuffer::Keeps::kText,
          kLongestLine};
}

MachineModel axes_of(const Firmware& firmware, MachineModel machine) {
  if (firmware.axes == 3) machine.chain = Chain::kThreeAxis;
  return machine;
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

class GrblController final : public Controller {
 public:
  GrblController(Mill& mill, Personality personality)
      : Controller(mill),
        firmware_(firmware_of(personality, mill.machine())),
        planted_(mill.options().planted),
        interpreter_(axes_of(firmware_, mill.machine()), firmware_.axes > 3 ? 9 : 6),
        buffer_(firmware_.receive_buffer_bytes),
        line_(firmware_.keeps, firmware_.longest_line),
        reports_buffers_(firmware_.reports_buffers) {
    const OperatorSetup& setup = mill_.setup();
    if (setup.work_offset >= 54 && setup.work_offset <= 59) {
      const Vec3& origin = setup.workpiece_origin_mm;
      interpreter_.set_offset(setup.work_offset, {origin.x(), origin.y(), origin.z()});
    }
    interpreter_.set_position(mill_.planned());
  }

  void power_on() override {
    if (dead_) {
      // It does not know where the axes stand until they are homed, or somebody vouches for them.
      dead_ = false;
      forget();
      locked_ = true;
    }
    say("");
    say(firmware_.banner);
    if (locked_) say("[MSG:'$H'|'$X' to unlock]");
  }

  void receive(std::string_view bytes) override {
    if (dead_) return;
    for (const char byte : bytes) {
      ++received_bytes_;
      const auto code = static_cast<unsigned char>(byte);
      if ((code >= 0x80 || code == '?' || code == '!' || code == '~' || code == 0x18) && real_time(code)) continue;
      // The main loop takes bytes out faster than a line brings them, unless it waits for something.
      if (buffer_.free() == 0 && !waits()) line_.fill_from(buffer_);
      buffer_.push(byte);
    }
  }

  bool work() override {
    if (probing_ != 0 && !mill_.moving()) end_probing();
    if (waits() || !line_.fill_from(buffer_)) return false;
    if (mill_.moving()) {
      // Spindle, tool and the like happen between motions, not ahead of them; a full planner takes nothing.
      if (mill_.planned_blocks() >= firmware_.planner_blocks || has_word(line_.kept(), "MPT$")) return false;
    }
    take_line();
    line_.clear();
    return true;
  }

  void begin_program() override { program_line_ = 0; }
  [[nodiscard]] bool dead() const override { return dead_; }

  void add_to(SimulationResult& result) const override {
    result.lines = executed_lines_;
    result.received_bytes = received_bytes_;
    result.overflowed_bytes = buffer_.lost();
    result.highest_buffer_fill = buffer_.highest();
    result.received_digest = digest_.hex();
    result.alarm = locked_;
  }

 private:
  const Firmware firmware_;
  const PlantedFaults& planted_;
  Interpreter interpreter_;
  ReceiveBuffer buffer_;
  LineBuffer line_;

  bool dead_ = false;
  bool door_ = false, checking_ = false;
  bool waits_for_tool_ = false, pauses_ = false;
  int probing_ = 0;  ///< 382 to 385: until the motion ends
  int incoming_tool_ = 0;
  std::size_t next_step_ = 0;  ///< of the line that waits for the operator
  bool locked_ = false;        ///< by an alarm; $X or $H unlocks
  bool needs_reset_ = false;   ///< a critical alarm: deaf until reset
  int latched_error_ = 0;
  bool reports_buffers_;
  int reports_ = 0;
  long program_line_ = 0;  ///< since reset
  long total_lines_ = 0;   ///< program lines since power-on
  long executed_lines_ = 0;
  long received_bytes_ = 0;
  LineDigest digest_;

  /// The main loop stands and takes nothing out of the receive buffer.
  [[nodiscard]] bool waits() const {
    return dead_ || mill_.held() || door_ || waits_for_tool_ || pauses_ || probing_ != 0 || needs_reset_;
  }

  // --- Replies ---

  void say(std::string_view text) {
    replies_ += text;
    replies_ += "\r\n";
  }
  void say_ok() { say("ok"); }
  void say_error(int code) { say("error:" + std::to_string(code)); }

  Fault& raise_alarm(int number, const std::string& kind, const std::string& message) {
    mill_.drop_motions();
    Fault& fault = mill_.add_fault(kind, message, program_line_);
    fault.place_mm = mill_.tip_mm();
    say("ALARM:" + std::to_string(number));
    interpreter_.set_position(mill_.planned());
    locked_ = true;
    needs_reset_ = number <= kLastCriticalAlarm;
    if (needs_reset_) say("[MSG:Reset to continue]");
    mill_.stop_spindle();
    return fault;
  }

  // --- Steps of a line ---

  /// Carries out the steps of the current line from next_step_ on; stops where the operator is asked.
  void run_steps() {
    const std::vector<GcodeStep>& steps = interpreter_.steps();
    while (next_step_ < steps.size()) {
      const GcodeStep& step = steps[next_step_++];
      switch (step.kind) {
        case GcodeStep::kMove:
          mill_.plan_move(step.target, step.seconds, step.rapid, program_line_);
          break;
        case GcodeStep::kProbe:
          if (step.number <= kTowardsContact) mill_.plan_move(step.target, step.seconds, false, program_line_);
          probing_ = step.number;
          return;
        case GcodeStep::kDwell:
          mill_.plan_dwell(step.seconds);
          break;
        case GcodeStep::kSpindle:
          if (step.number == 0) {
            mill_.stop_spindle();
          } else {
            mill_.turn_spindle(step.number == 3, step.rpm);
          }
          break;
        case GcodeStep::kChangeTool:
          mill_.stop_spindle();
          if (!mill_.has_cutter(step.number)) {
            raise_alarm(3, "alarm", "tool " + std::to_string(step.number) + " is not in the magazine");
            next_step_ = steps.size();
            return;
          }
          waits_for_tool_ = true;
          incoming_tool_ = step.number;
          return;
        case GcodeStep::kPause:
          pauses_ = true;
          return;
        case GcodeStep::kEnd:
          mill_.stop_spindle();
          say("[MSG:Pgm End]");
          break;
        case GcodeStep::kSelectTool:
        case GcodeStep::kCoolant:
        case GcodeStep::kOptionalPause:
          break;
      }
    }
  }

  void resume() {
    if (door_ || mill_.held()) {
      mill_.go_on();
      door_ = false;
    } else if (waits_for_tool_) {
      waits_for_tool_ = false;
      mill_.change_tool(incoming_tool_);
      run_steps();
    } else if (pauses_) {
      pauses_ = false;
      run_steps();
      if (!pauses_ && !needs_reset_) say_ok();
    }
  }

  /// There is never a contact: G38.2 ends in an alarm, G38.3 at its target; G38.4 and G38.5 would leave one.
  /// [grbl 1.1, doc/csv/alarm_codes_en_US.csv, alarms 4 and 5]
  void end_probing() {
    const int probe = std::exchange(probing_, 0);
    mill_.expect_standstill();
    if (probe > kTowardsContact) {
      raise_alarm(4, "probe", "the probe has no contact that could open");
    } else {
      say("[PRB:" + axes_text(to_joints(mill_.joints())) + ":0]");
      if (probe == 382) raise_alarm(5, "probe", "the probe made no contact");
    }
    say_ok();
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
        if (!door_ && !locked_ && !checking_) mill_.hold();
        return true;
      case '~':
      case 0x81:
        if (!locked_) resume();
        return true;
      case 0x18:
        reset();
        return true;
      case 0x84:
        open_door();
        return true;
      default:
        if (byte >= 0x90 && byte <= 0x9d) turn_override(byte);
        return byte >= 0x80;  // others are not simulated
    }
  }

  void open_door() {
    if (door_ || locked_) return;
    mill_.hold();
    door_ = true;
    say("[MSG:Check Door]");
  }

  void turn_override(unsigned char byte) {
    Overrides now = mill_.overrides();
    const auto turn = [&](int& percent, int kind) {
      constexpr int kSteps[] = {0, 10, -10, 1, -1};
      percent = kind == 0 ? 100 : std::clamp(percent + kSteps[kind], 10, 200);
    };
    if (byte <= 0x94) {
      turn(now.feed, byte - 0x90);
    } else if (byte >= 0x99) {
      turn(now.spindle, byte - 0x99);
    } else if (byte <= 0x97) {
      now.rapid = byte == 0x95 ? 100 : byte == 0x96 ? 50 : 25;
    }
    mill_.set_overrides(now);
  }

  void reset() {
    mill_.advance();
    const bool moving = mill_.moving() && !mill_.held();
    forget();
    if (moving) {
      locked_ = true;
      say("ALARM:3");
    }
    power_on();
  }

  /// All but offsets and place.
  void forget() {
    mill_.drop_motions();
    mill_.set_overrides({});
    buffer_.clear();
    line_.clear();
    interpreter_.reset();
    interpreter_.set_position(mill_.planned());
    mill_.stop_spindle();
    door_ = checking_ = waits_for_tool_ = pauses_ = needs_reset_ = false;
    probing_ = 0;
    next_step_ = 0;
    latched_error_ = 0;
    program_line_ = 0;
    reports_ = 0;
  }

  [[nodiscard]] std::string axes_text(const Joints& q) const {
    std::array<double, 6> values{q[0], q[1], q[2], 0, 0, 0};
    const MachineModel& machine = mill_.machine();
    values[static_cast<std::size_t>(machine.outer.letter - 'A' + 3)] = q[3] * kDegreesPerRad;
    values[static_cast<std::size_t>(machine.inner.letter - 'A' + 3)] = q[4] * kDegreesPerRad;
    std::string text;
    for (int i = 0; i < firmware_.axes; ++i) text += (i ? "," : "") + fixed(values[static_cast<std::size_t>(i)], 3);
    return text;
  }

  [[nodiscard]] const char* state() {
    if (locked_) return "Alarm";
    if (door_) return "Door:0";
    if (waits_for_tool_) return "Tool";
    if (mill_.held() || pauses_) return "Hold:0";
    if (checking_) return "Check";
    return mill_.moving() || line_.whole() || buffer_.holds_line() ? "Run" : "Idle";
  }

  void report(bool complete) {
    mill_.advance();
    const int blocks = std::max(0, firmware_.planner_blocks - mill_.planned_blocks());
    std::string text = std::string("<") + state() + "|MPos:" + axes_text(to_joints(mill_.joints()));
    if (reports_buffers_) text += "|Bf:" + std::to_string(blocks) + "," + std::to_string(buffer_.free());
    text += "|FS:" + compact(mill_.feed_per_min(), 0) + "," + compact(mill_.rpm(), 0);
    const Overrides& overrides = mill_.overrides();
    if (complete || reports_ % kReportsPerOffset == 0) text += "|WCO:" + axes_text(interpreter_.zero());
    if (complete || reports_ % kReportsPerOffset == 1) {
      text += "|Ov:" + std::to_string(overrides.feed) + "," + std::to_string(overrides.rapid) + "," +
              std::to_string(overrides.spindle);
    }
    ++reports_;
    say(text + ">");
  }

  // --- Lines ---

  void take_line() {
    const std::string_view line = line_.kept();
    if (!line_.overlong()) {
      if (line.empty() || line.front() == '$') latched_error_ = 0;
      if (line_.text().empty()) {
        say_ok();
        return;
      }
      if (line.starts_with('$')) {
        system_command(line);
        return;
      }
    }
    ++program_line_;
    ++total_lines_;
    if (total_lines_ == planted_.drop_line_at) return;
    if (total_lines_ == planted_.power_loss_at_line) {
      dead_ = true;
      mill_.drop_motions();
      mill_.stop_spindle();
      return;
    }
    if (total_lines_ == planted_.reset_at_line) {
      reset();
      return;
    }
    if (total_lines_ == planted_.alarm_at_line) {
      raise_alarm(1, "alarm", "a limit switch has closed");
      return;
    }
    if (total_lines_ == planted_.door_at_line) open_door();
    if (locked_ && !line.empty()) {
      say_error(9);
      return;
    }
    if (latched_error_ != 0) {
      say_error(latched_error_);
      return;
    }
    if (const int error = read_line(line); error != 0) {
      if (firmware_.latches_errors) latched_error_ = error;
      mill_.add_fault("error",
                      "error:" + std::to_string(error) + " " + std::string(describe(error)) + " in '" +
                          std::string(line_.text().substr(0, 80)) + "'",
                      program_line_);
      say_error(error);
      return;
    }
    for (const GcodeStep& step : interpreter_.steps()) {
      if (step.kind != GcodeStep::kMove && step.kind != GcodeStep::kProbe) continue;
      if (const auto past = mill_.overtravel(step.target)) {
        Fault& fault = raise_alarm(2, "limit", past->message + " in '" + std::string(line_.text().substr(0, 80)) + "'");
        fault.amount_mm = past->amount;
        fault.picture = travel_picture(mill_.machine(), mill_.joints(), to_position(step.target));
        return;
      }
    }
    if (checking_) {
      say_ok();
      return;
    }
    ++executed_lines_;
    digest_.add(line_.text());
    next_step_ = 0;
    if (has_word(line, "MT")) mill_.expect_standstill();
    run_steps();
    // M6 is acknowledged at once, M0 when the operator goes on, a probe at its end, a line that raises an alarm never.
    if (!pauses_ && !probing_ && !locked_) say_ok();
  }

  int read_line(std::string_view line) {
    if (line_.overlong()) return kOverflow;
    if (total_lines_ == planted_.error_at_line) return kBadNumber;
    if (!firmware_.changes_tools && words_of(line).tool_change) return kUnsupported;
    return interpreter_.execute(line);
  }

  void system_command(std::string_view line) {
    if (line == "$I" || line == "$i") {
      const bool hal = firmware_.axes > 3;
      say(hal ? "[VER:1.1f.20260817:lightmill simulation]" : "[VER:1.1h.20190830:lightmill simulation]");
      say("[OPT:" + std::string(firmware_.identity) + "," + std::to_string(firmware_.planner_blocks) + "," +
          std::to_string(firmware_.receive_buffer_bytes) + (hal ? ",6,0]" : "]"));
      if (hal) {
        say("[AXS:6:XYZABC]");
        say("[NEWOPT:ENUMS,RT+,TC,SED]");
        say("[FIRMWARE:grblHAL]");
      }
    } else if (line == "$$") {
      say_settings();
    } else if (line.starts_with("$10=")) {
      if (mill_.moving()) {
        say_error(8);
        return;
      }
      reports_buffers_ = (std::atoi(std::string(line.substr(4)).c_str()) & 2) != 0;
    } else if (line == "$G") {
      say_modes();
    } else if (line == "$#") {
      for (const int g : {54, 55, 56, 57, 58, 59, 591, 592, 593}) {
        if (g < 100 || firmware_.axes > 3) say("[" + code_name(g) + ":" + axes_text(interpreter_.offset(g)) + "]");
      }
      say("[G28:" + axes_text(interpreter_.reference(0)) + "]");
      say("[G30:" + axes_text(interpreter_.reference(1)) + "]");
      say("[G92:" + axes_text(interpreter_.shift()) + "]");
      say("[TLO:" + axes_text({0, 0, interpreter_.modes().tool_length_mm, 0, 0}) + "]");
    } else if (line == "$X") {
      if (locked_) say("[MSG:Caution: Unlocked]");
      locked_ = false;
    } else if (line == "$H") {
      if (checking_) {
        say_error(8);
        return;
      }
      locked_ = false;
      home();
    } else if (line == "$C") {
      if (locked_) {
        say_error(9);
        return;
      }
      if (checking_) {
        say("[MSG:Disabled]");
        say_ok();
        reset();
        return;
      }
      checking_ = true;
      say("[MSG:Enabled]");
    } else if (line != "$") {
      say_error(3);
      return;
    }
    say_ok();
  }

  void say_settings() {
    const MachineModel& machine = mill_.machine();
    say(reports_buffers_ ? "$10=511" : "$10=1");
    say("$13=0");
    say("$20=1");
    say("$22=1");
    say("$30=" + fixed(machine.max_spindle_rpm, 3));
    say("$31=" + fixed(machine.min_spindle_rpm, 3));
    say("$110=" + fixed(machine.x.max_speed_mm_per_s * 60, 3));
    say("$111=" + fixed(machine.y.max_speed_mm_per_s * 60, 3));
    say("$112=" + fixed(machine.z.max_speed_mm_per_s * 60, 3));
    say("$120=" + fixed(machine.x.acceleration_mm_per_s2, 3));
    say("$121=" + fixed(machine.y.acceleration_mm_per_s2, 3));
    say("$122=" + fixed(machine.z.acceleration_mm_per_s2, 3));
    say("$130=" + fixed(machine.x.max_mm - machine.x.min_mm, 3));
    say("$131=" + fixed(machine.y.max_mm - machine.y.min_mm, 3));
    say("$132=" + fixed(machine.z.max_mm - machine.z.min_mm, 3));
  }

  void say_modes() {
    const GcodeModes& m = interpreter_.modes();
    std::string text = "[GC:" + code_name(m.motion) + " " + code_name(m.offset) + " G" +
                       std::to_string(m.plane) + " G" + (m.inches ? "20" : "21") + " G" +
                       (m.incremental ? "91" : "90") + " G" + (m.inverse_time ? "93" : "94") +
                       (m.tool_length_mm != 0 ? " G43.1" : " G49") + " M" + std::to_string(m.spindle);
    text += m.mist ? " M7" : "";
    text += m.flood ? " M8" : "";
    text += !m.mist && !m.flood ? " M9" : "";
    say(text + " T" + std::to_string(m.tool) + " F" + compact(m.feed, 1) + " S" + compact(m.rpm, 0) + "]");
  }

  /// Z to the top, then the others.
  void home() {
    const MachineModel& machine = mill_.machine();
    Joints up = mill_.planned();
    up[2] = machine.z.max_mm;
    mill_.plan_move(up, 0, true, program_line_);
    mill_.plan_move({std::clamp(0.0, machine.x.min_mm, machine.x.max_mm),
                     std::clamp(0.0, machine.y.min_mm, machine.y.max_mm), machine.z.max_mm, 0, 0},
                    0, true, program_line_);
    interpreter_.set_position(mill_.planned());
  }
};

}  // namespace

std::unique_ptr<Controller> make_grbl_controller(Mill& mill, Personality personality) {
  return std::make_unique<GrblController>(mill, personality);
}

}  // namespace lightmill::detail

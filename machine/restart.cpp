#include "machine/restart.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>

#include "design/core/text.h"
#include "machine/detail/interpreter.h"
#include "machine/detail/restart_parts.h"
#include "machine/detail/sent_text.h"
#include "machine/fault_words.h"
#include "machine/kinematics.h"
#include "machine/program_lines.h"
#include "machine/streamer.h"

namespace lightmill {

namespace {

using detail::GcodeModes;
using detail::GcodeStep;
using detail::Joints;

constexpr double kDegreesPerRad = 180 / kPi;
/// A control drops moves of less than a motor's step: only longer ones surely have a planner block.
constexpr double kSureMove_mm = 0.02;
/// What a control has cut into steps already is no longer among its planner's blocks: ten segments in grbl.
constexpr int kPreparedBlocks = 10;
/// Of a reported position from the way, which has three decimals.
constexpr double kOnTheWay_mm = 0.02;
/// Of the restart's numbers from the original's (mm, rad): seven decimals are written.
constexpr double kSame = 1e-6;
constexpr int kDecimals = 7;
constexpr std::size_t kLinesPerReport = 4096;

/// From lines that were sent to lines of the program; those of a restart's entry are none, those of its overlap are old.
std::size_t count_of(const std::vector<ProgramLine>& lines, const JournalHeader& header, long sent) {
  const std::size_t base = detail::index_of_line(lines, header.uncut_line);
  if (sent <= header.entry_lines) return base;
  return std::clamp(detail::index_of_line(lines, header.first_line) + static_cast<std::size_t>(sent - header.entry_lines), base, lines.size());
}

/// Lines of a program, one after the other, on a control that has just been switched on with the axes at the top.
class Replay {
 public:
  Replay(const MachineModel& machine, const OperatorSetup& setup, std::string_view program)
      : lines_(program_lines(program)), interpreter_(machine), view_(machine, setup.workpiece_origin_mm) {
    const Vec3& zero = setup.workpiece_origin_mm;
    if (setup.work_offset >= 54 && setup.work_offset <= 59) {
      interpreter_.set_offset(setup.work_offset, {zero.x(), zero.y(), zero.z()});
    }
    interpreter_.set_position({std::clamp(0.0, machine.x.min_mm, machine.x.max_mm),
                               std::clamp(0.0, machine.y.min_mm, machine.y.max_mm), machine.retract_z_mm, 0, 0});
  }

  [[nodiscard]] const std::vector<ProgramLine>& lines() const { return lines_; }
  [[nodiscard]] std::size_t next() const { return next_; }
  [[nodiscard]] const ProgramLine& line() const { return lines_[next_]; }  ///< the next one
  [[nodiscard]] const Joints& before() const { return before_; }           ///< the last one
  [[nodiscard]] const Joints& position() const { return interpreter_.position(); }
  [[nodiscard]] const GcodeModes& modes() const { return interpreter_.modes(); }
  [[nodiscard]] const std::vector<GcodeStep>& steps() const { return interpreter_.steps(); }
  [[nodiscard]] const Joints& offset() const { return interpreter_.offset(modes().offset); }
  [[nodiscard]] ToolPose pose(const Joints& q) { return view_.cutter(to_position(q), modes().tool_length_mm); }
  WorkpieceView& view() { return view_; }
  void stand_at(const JointPosition& j) { interpreter_.set_position({j.x_mm, j.y_mm, j.z_mm, j.outer_rad, j.inner_rad}); }

  void execute() {
    before_ = interpreter_.position();
    const ProgramLine& line = lines_[next_];
    if (const int error = interpreter_.execute(line.text); error != 0) {
      throw InputError("line " + std::to_string(line.number) +
                       " of the program: " + std::string(detail::describe(error)) + " in '" +
                       std::string(line.text.substr(0, 80)) + "'; a control would stop there");
    }
    if (interpreter_.sets_places()) {
      throw InputError("line " + std::to_string(line.number) + " of the program sets an offset or a reference place: '" +
                       std::string(line.text.substr(0, 80)) +
                       "'; a control keeps only some of them, so no restart behind it is safe: begin the program again");
    }
    ++next_;
  }

 private:
  std::vector<ProgramLine> lines_;
  detail::Interpreter interpreter_;
  WorkpieceView view_;
  Joints before_{};
  std::size_t next_ = 0;
};

bool moves_for_sure(const Joints& from, const Joints& to) {
  for (std::size_t i = 0; i < 5; ++i) {
    if (std::abs(to[i] - from[i]) >= (i < 3 ? kSureMove_mm : kSureMove_mm / kDegreesPerRad)) return true;
  }
  return false;
}

/// How far a point is from a straight way of the axes; mm and degrees alike.
double distance_to_way(const Joints& from, const Joints& to, const Joints& point) {
  double length = 0, along = 0;
  std::array<double, 5> d{}, p{};
  for (std::size_t i = 0; i < 5; ++i) {
    const double unit = i < 3 ? 1 : kDegreesPerRad;
    d[i] = (to[i] - from[i]) * unit;
    p[i] = (point[i] - from[i]) * unit;
    length += d[i] * d[i];
    along += d[i] * p[i];
  }
  const double t = length > 0 ? std::clamp(along / length, 0.0, 1.0) : 0;
  double square = 0;
  for (std::size_t i = 0; i < 5; ++i) square += (p[i] - t * d[i]) * (p[i] - t * d[i]);
  return std::sqrt(square);
}

/// MPos as axes of this machine.
std::optional<Joints> reported_joints(const MachineModel& machine, const StatusReport& report) {
  const std::vector<double>& p = report.machine_position;
  if (p.size() < 3) return std::nullopt;
  Joints q{p[0], p[1], p[2], 0, 0};
  if (!machine.has_rotary()) return q;
  const auto place = [](char letter) { return static_cast<std::size_t>(letter - 'A' + 3); };
  if (p.size() <= std::max(place(machine.outer.letter), place(machine.inner.letter))) return std::nullopt;
  q[3] = p[place(machine.outer.letter)] / kDegreesPerRad;
  q[4] = p[place(machine.inner.letter)] / kDegreesPerRad;
  return q;
}

}  // namespace

long last_line_of(std::string_view program, const JournalHeader& header, long sent) {
  const std::vector<ProgramLine> lines = program_lines(program);
  const std::size_t count = count_of(lines, header, sent);
  return count == 0 ? 0 : lines[count - 1].number;
}

StreamPlace find_place(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                       const JournalSummary& journal) {
  const JournalHeader& header = journal.header;
  if (const std::string digest = program_digest(program); digest != header.program_digest) {
    throw InputError("the journal is of another version of " + header.program + " (its digest is " +
                     header.program_digest + ", the program's " + digest + "); put back the program that was streamed");
  }
  Replay replay(machine, setup, program);
  const auto& lines = replay.lines();
  const std::size_t base = detail::index_of_line(lines, header.uncut_line);
  const auto program_lines_of = [&](long sent) { return count_of(lines, header, sent); };
  const auto number = [&](std::size_t count) { return count == 0 ? 0 : lines[count - 1].number; };

  StreamPlace place;
  const std::size_t acknowledged = program_lines_of(journal.acknowledged);
  const std::size_t sent = std::max(acknowledged, program_lines_of(journal.sent));
  place.acknowledged_line = number(acknowledged);
  place.sent_line = number(sent);

  StatusReport report;
  const bool has_report = !journal.report.empty() && parse_status(journal.report, report);
  const std::size_t at_report = program_lines_of(journal.acknowledged_at_report);
  const int capacity = std::max({header.planner_blocks, machine.planner_blocks, report.free_blocks}) + kPreparedBlocks;
  const bool idle = has_report && report.state == "Idle";
  const int under_way =
      !has_report || report.free_blocks < 0 ? capacity : std::min(capacity, capacity - report.free_blocks);

  // Lines before `proven` are carried out; `waiting` are the last lines behind it that move.
  std::size_t proven = base;
  std::string why = base > 0 ? "earlier streams have cut what is before it" : "nothing is proven to be cut";
  std::deque<std::size_t> waiting;
  const auto prove = [&](std::size_t count, const std::string& reason) {
    if (count <= proven) return;
    proven = count;
    why = reason;
  };
  const auto without_last = [&](int blocks) {
    if (static_cast<int>(waiting.size()) < blocks) return proven;
    return blocks == 0 ? replay.next() : waiting[waiting.size() - static_cast<std::size_t>(blocks)];
  };
  const std::size_t audited = journal.end == "lost acknowledgement" ? program_lines_of(journal.audited) : lines.size();
  while (replay.next() < acknowledged) {
    const Joints from = replay.position();
    replay.execute();
    bool waits = false;
    for (const GcodeStep& step : replay.steps()) {
      waits = waits || (step.kind != GcodeStep::kMove && step.kind != GcodeStep::kSelectTool &&
                        step.kind != GcodeStep::kOptionalPause);
    }
    if (waits) {
      waiting.clear();
      prove(replay.next() - 1, "the control has stood still for line " + std::to_string(number(replay.next())));
    }
    if (moves_for_sure(from, replay.position())) waiting.push_back(replay.next() - 1);
    if (static_cast<int>(waiting.size()) > capacity) waiting.pop_front();
    if (replay.next() == at_report && has_report) {
      if (idle) {
        prove(at_report,
              "the controller said it was idle when line " + std::to_string(number(at_report)) + " was acknowledged");
      } else {
        prove(without_last(under_way), "the controller said so when line " + std::to_string(number(at_report)) +
                                           " was acknowledged: at most " + std::to_string(under_way) +
                                           " moves were still waiting");
      }
    }
  }
  prove(without_last(capacity), "line " + std::to_string(place.acknowledged_line) +
                                    " is acknowledged and the controller holds at most " + std::to_string(capacity) +
                                    " moves");
  if (journal.done()) prove(lines.size(), "the stream ended well");
  if (audited < proven) {
    proven = std::max(base, audited);
    why = "an acknowledgement is missing and a line may be lost; up to here every one had come";
  }
  place.executed_line = number(proven);
  place.uncut_line = proven < lines.size() ? lines[proven].number : 0;
  place.reason = why;

  if (!has_report) return place;
  place.report_age_s = journal.seconds - journal.report_seconds;
  const std::optional<Joints> stood = reported_joints(machine, report);
  if (!stood) return place;
  place.reported = to_position(*stood);
  Replay again(machine, setup, program);
  double nearest = kOnTheWay_mm;
  while (again.next() < std::min(at_report, lines.size())) {
    Joints from = again.position();
    again.execute();
    if (again.next() <= std::min(proven, at_report)) continue;
    for (const GcodeStep& step : again.steps()) {
      if (step.kind != GcodeStep::kMove) continue;
      const double distance = distance_to_way(from, step.target, *stood);
      if (distance < nearest) {
        nearest = distance;
        place.reported_line = number(again.next());
      }
      from = step.target;
    }
  }
  return place;
}

namespace {

/// Writes and checks one restart.
class RestartWriter {
 public:
  RestartWriter(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                const RestartOptions& options)
      : machine_(machine), setup_(setup), program_(program), options_(options) {}

  Restart write(long line) {
    restart_.uncut_line = line;
    Replay replay(machine_, setup_, program_);
    const std::size_t first = good_place(detail::index_to_go_on_at(replay.lines(), line));
    if (first == 0) {
      restart_.text = std::string(program_);
      return std::move(restart_);
    }
    while (replay.next() < first) {
      letters_ |= detail::words_of(replay.line().text).letters;
      replay.execute();
      for (const GcodeStep& step : replay.steps()) {
        if (step.kind == GcodeStep::kDwell && replay.modes().spindle != 5)
          restart_.dwell_s = std::max(restart_.dwell_s, step.seconds);
      }
    }
    restart_.first_line = replay.line().number;
    entry(replay);
    tail(replay.line().number);
    check(replay);
    return std::move(restart_);
  }

 private:
  const MachineModel& machine_;
  const OperatorSetup& setup_;
  std::string_view program_;
  const RestartOptions& options_;
  Restart restart_;
  std::uint32_t letters_ = 0;  ///< of words that the program has used
  JointPosition stopped_;      ///< where the restart backs out from

  /// The index of the line to go on with; 0: nothing was cut before.
  std::size_t good_place(std::size_t uncut) {
    Replay replay(machine_, setup_, program_);
    std::vector<detail::LineFacts> facts(uncut + 1);
    // An arc's G2 or G3 cannot be set without moving, so the line must say it itself.
    const auto is_good = [&] {
      return replay.modes().motion <= 1 || replay.modes().motion == 80 || detail::words_of(replay.line().text).motion;
    };
    while (replay.next() < uncut) {
      detail::LineFacts& line = facts[replay.next()];
      line.good = is_good();
      const GcodeModes before = replay.modes();
      replay.execute();
      const GcodeModes& after = replay.modes();
      line.stops_spindle = after.spindle == 5 && before.spindle != 5;
      line.plain = after.offset == before.offset && after.tool_length_mm == before.tool_length_mm;
      Joints from = replay.before();
      for (const GcodeStep& step : replay.steps()) {
        line.plain = line.plain && step.kind == GcodeStep::kMove && !step.rapid;
        if (step.kind != GcodeStep::kMove) continue;
        if (!step.rapid) {
          line.feeds = true;
          line.cut_mm += (replay.pose(step.target).tip_mm - replay.pose(from).tip_mm).norm();
        }
        from = step.target;
      }
    }
    facts.back().good = is_good();
    restart_.overlap_mm = options_.overlap_mm;
    return detail::restart_index(facts, replay.modes().spindle == 5 && replay.position()[2] < machine_.retract_z_mm,
                                 restart_.overlap_mm);
  }

  void line(const std::string& words) {
    restart_.text += words + "\n";
    ++restart_.entry_lines;
  }

  [[nodiscard]] static std::string word(char letter, double value) { return letter + compact(value, kDecimals); }

  /// Words of the axes first .. last, as far as the program has used them.
  [[nodiscard]] std::string words(const Replay& at, const Joints& q, std::size_t first, std::size_t last) const {
    const std::array<char, 5> letters{'X', 'Y', 'Z', machine_.outer.letter, machine_.inner.letter};
    std::string text;
    for (std::size_t i = first; i <= last; ++i) {
      if ((letters_ >> (letters[i] - 'A') & 1U) == 0) continue;
      double value = i < 3 ? q[i] - at.offset()[i] : q[i] * kDegreesPerRad;
      if (i == 2) value -= at.modes().tool_length_mm;
      text += " " + word(letters[i], value);
    }
    return text;
  }

  void entry(Replay& at) {
    const GcodeModes& modes = at.modes();
    const Joints& q = at.position();
    restart_.place = at.pose(q);
    restart_.tool = modes.tool;
    restart_.tool_length_mm = modes.tool_length_mm;
    restart_.rpm = modes.spindle == 5 ? 0 : modes.rpm;
    restart_.dwell_s = modes.spindle == 5 ? 0 : std::max(restart_.dwell_s, machine_.spindle_start_s);
    const Joints above = stand_off(at, q);
    restart_.stand_off = at.pose(above);

    if (at.lines().front().text == "%") line("%");
    line("(RESTART of " + detail::plain_comment(options_.program_name) + " at its line " + std::to_string(restart_.first_line) + ")");
    line("(its lines before " + std::to_string(restart_.uncut_line) + " are cut, " + fixed(restart_.overlap_mm, 3) +
         " mm are gone over again)");
    line("G21 G90 G94 G17 G40 G49 G80 " + detail::code_name(modes.offset));
    stopped_ = options_.stands.value_or(to_position(q));
    const Vec3 out = detail::outwards(at.view(), stopped_);
    restart_.backs_out_mm = detail::back_out_mm(machine_, out, stopped_.z_mm, options_.back_out_mm);
    if (restart_.backs_out_mm > 0) {
      const Vec3 way = restart_.backs_out_mm * out;
      line("G91 G1 " + word('X', way.x()) + " " + word('Y', way.y()) + " " + word('Z', way.z()) + " " +
           word('F', options_.entry_feed_mm_per_s * 60));
      line("G90");
    }
    const std::string top = "G53 G0 " + word('Z', machine_.retract_z_mm);
    line(top);
    if (modes.tool > 0) {
      const Vec3& change = machine_.tool_change_mm;
      line("G53 G0 " + word('X', change.x()) + " " + word('Y', change.y()));
      if (change.z() != machine_.retract_z_mm) line("G53 G0 " + word('Z', change.z()));
      line("T" + std::to_string(modes.tool) + " M6");
    }
    if (modes.tool_length_mm != 0) line("G43.1 " + word('Z', modes.tool_length_mm));
    if (modes.spindle != 5) {
      line(word('S', modes.rpm) + " M" + std::to_string(modes.spindle));
      line("G4 " + word('P', restart_.dwell_s));
    } else if (modes.rpm != 0) {
      line(word('S', modes.rpm));
    }
    if (modes.mist) line("M7");
    if (modes.flood) line("M8");
    // The operator may have jogged at the tool change.
    line(top);
    if (const std::string turn = words(at, q, 3, 4); !turn.empty()) line("G0" + turn);
    line("G0" + words(at, above, 0, 1));
    if (q[2] < machine_.retract_z_mm) {
      line("G0" + words(at, above, 2, 2));
      line("G1" + words(at, q, 0, 2) + " " + word('F', options_.entry_feed_mm_per_s * 60));
    }
    // What holds where the program goes on. A G1 wants a feed, so it comes before G93; G2 and G3 the next line says
    // itself.
    if (modes.plane != 17) line("G" + std::to_string(modes.plane));
    if (modes.feed > 0) line(std::string(modes.motion == 1 ? "G1 " : "") + word('F', modes.feed));
    if (modes.motion == 0) line("G0");
    if (modes.motion == 80) line("G80");
    if (modes.inverse_time) line("G93");
    if (modes.inches) line("G20");
    if (modes.incremental) line("G91");
  }

  /// Along the tool's axis out of the box around blank and clamps, but never above the machine's top.
  [[nodiscard]] Joints stand_off(Replay& at, const Joints& q) const {
    const ToolPose pose = at.pose(q);
    const double way = detail::way_out_mm(setup_, pose, at.modes().tool, options_.clearance_mm);
    const auto at_way = [&](double mm) {
      const JointPosition j = at.view().joints(pose.tip_mm + mm * pose.axis, q[3], q[4], at.modes().tool_length_mm);
      return Joints{j.x_mm, j.y_mm, j.z_mm, q[3], q[4]};
    };
    const Joints above = at_way(way);
    if (above[2] <= machine_.retract_z_mm) return above;
    return at_way(way * std::max(0.0, machine_.retract_z_mm - q[2]) / (above[2] - q[2]));
  }

  void tail(long first_line) {
    std::size_t at = 0;
    for (long i = 1; i < first_line; ++i) at = program_.find('\n', at) + 1;
    restart_.text += program_.substr(at);
  }

  /// The restart as the control will hear it, beside the original from there on.
  void check(Replay& original) const {
    Replay heard(machine_, setup_, restart_.text);
    if (restart_.backs_out_mm > 0) heard.stand_at(stopped_);
    while (static_cast<long>(heard.next()) < restart_.entry_lines) {
      heard.execute();
      for (const GcodeStep& step : heard.steps()) {
        if (step.kind == GcodeStep::kMove) detail::within_travels(machine_, step.target, heard.lines()[heard.next() - 1].text);
      }
    }
    same(heard.position(), original.position(), restart_.first_line);
    const GcodeModes &a = heard.modes(), &b = original.modes();
    const bool own_motion = detail::words_of(original.line().text).motion;
    const std::array<std::pair<const char*, bool>, 14> modes{
        {{"motion", own_motion || a.motion == b.motion},
         {"plane", a.plane == b.plane},
         {"work offset", a.offset == b.offset},
         {"units", a.inches == b.inches},
         {"distance mode", a.incremental == b.incremental},
         {"feed mode", a.inverse_time == b.inverse_time},
         {"spindle", a.spindle == b.spindle},
         {"mist", a.mist == b.mist},
         {"flood", a.flood == b.flood},
         {"tool", a.tool == b.tool},
         {"feed", b.feed == 0 || std::abs(a.feed - b.feed) < kSame * b.feed},
         {"speed", a.rpm == b.rpm},
         {"tool length", std::abs(a.tool_length_mm - b.tool_length_mm) < kSame},
         {"line", heard.line().text == original.line().text}}};
    for (const auto& [what, equal] : modes) {
      if (!equal) throw NumericalError(std::string("the restart does not restore the ") + what);
    }
    while (original.next() < original.lines().size()) {
      original.execute();
      heard.execute();
      same(heard.position(), original.position(), original.lines()[original.next() - 1].number);
    }
  }

  void same(const Joints& a, const Joints& b, long number) const {
    const std::array<char, 5> letters{'X', 'Y', 'Z', machine_.outer.letter, machine_.inner.letter};
    for (std::size_t i = 0; i < 5; ++i) {
      // An axis that the program has not used is nowhere known.
      if (i >= 3 && (letters_ >> (letters[i] - 'A') & 1U) == 0) continue;
      if (std::abs(a[i] - b[i]) > kSame) {
        throw NumericalError("the restart does not follow the program at line " + std::to_string(number));
      }
    }
  }
};

}  // namespace

Restart write_restart(const MachineModel& machine, const OperatorSetup& setup, std::string_view program, long line,
                      const RestartOptions& options) {
  if (!(options.overlap_mm >= 0 && options.clearance_mm > 0 && options.entry_feed_mm_per_s > 0)) {
    throw InputError("a restart needs an overlap of at least 0 mm and a clearance and an entry feed above 0");
  }
  if (options.dialect != "grblhal") return detail::write_file_restart(machine, setup, program, line, options);
  return RestartWriter(machine, setup, program, options).write(line);
}

std::vector<PathPiece> path_near(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                                 const Vec3& place, double radius_mm, const std::string& dialect) {
  if (dialect != "grblhal") return detail::file_path_near(machine, setup, program, place, radius_mm, dialect);
  std::vector<PathPiece> pieces;
  Replay replay(machine, setup, program);
  while (replay.next() < replay.lines().size()) {
    Joints from = replay.position();
    replay.execute();
    for (const GcodeStep& step : replay.steps()) {
      if (step.kind != GcodeStep::kMove) continue;
      detail::add_piece_near(place, radius_mm,
                             {replay.lines()[replay.next() - 1].number, replay.pose(from).tip_mm,
                              replay.pose(step.target).tip_mm, step.rapid},
                             pieces);
      from = step.target;
    }
  }
  return pieces;
}

namespace {

/// What the operator does first, unless the restart does: out of the cut along the tool's axis, then up.
std::string back_out(const MachineModel& machine, const OperatorSetup& setup, const JointPosition& stopped) {
  WorkpieceView view(machine, setup.workpiece_origin_mm);
  const JointPosition out = detail::backed_out(view, stopped, detail::kBackOut_mm);
  const std::string top = "G53 G0 Z" + compact(machine.retract_z_mm, kDecimals) + "\n";
  if (out.z_mm >= machine.retract_z_mm) return top;
  return "G53 G0 X" + compact(out.x_mm, kDecimals) + " Y" + compact(out.y_mm, kDecimals) + " Z" +
         compact(out.z_mm, kDecimals) + "\n" + top;
}

}  // namespace

RestartTrial try_restart(const MachineModel& machine, const OperatorSetup& setup, const StockOptions& stock,
                         const std::vector<std::string>& done, std::string_view program, const Restart& restart,
                         const std::string& dialect, const Monitor& monitor) {
  if (dialect != "grblhal") {
    return detail::try_file_restart(machine, setup, stock, done, program, restart, dialect, monitor);
  }
  constexpr const char* kName = "restart";
  SimulationOptions options;
  options.stock = stock;
  SimulatedMachine simulated(machine, setup, options);
  std::size_t lines_total = program_lines(program).size() + program_lines(restart.text).size(), lines_done = 0;
  for (const std::string& text : done) lines_total += program_lines(text).size();
  const auto mill = [&](std::string_view text, long before_line) {
    for (const ProgramLine& line : program_lines(text)) {
      if (line.number >= before_line) break;
      if (++lines_done % kLinesPerReport == 0) {
        monitor.report("trying the restart", static_cast<double>(lines_done) / static_cast<double>(lines_total));
      }
      simulated.receive(std::string(line.text) + "\n");
      simulated.work(1);
      simulated.receive("~");  // goes on at tool changes and pauses, is nothing elsewhere
      simulated.take_replies();
    }
  };
  constexpr long kAll = std::numeric_limits<long>::max();
  for (const std::string& text : done) mill(text, kAll);
  // A restart without an entry is the whole program over what it has done already.
  mill(program, restart.uncut_line);
  simulated.receive("\x18");
  simulated.begin_program("");
  mill("$X\n" + (restart.backs_out_mm > 0 ? "" : back_out(machine, setup, simulated.result().joints)), kAll);
  const double seconds_before = simulated.result().machine_seconds;
  simulated.begin_program(kName);
  mill(restart.text, kAll);

  RestartTrial trial;
  SimulationResult result = simulated.result();
  trial.seconds = result.machine_seconds - seconds_before;
  SentLines sent;
  sent.add(kName, restart.text);
  for (Fault& fault : result.faults) {
    if (fault.program != kName) continue;
    locate(fault, sent);
    trial.faults.push_back(std::move(fault));
  }
  trial.surface = simulated.machined();
  return trial;
}

}  // namespace lightmill

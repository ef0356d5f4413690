// Restarts of programs that controls run as files: Fanuc, LinuxCNC, Siemens, Heidenhain in both its languages.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "design/core/text.h"
#include "machine/detail/restart_parts.h"
#include "machine/kinematics.h"
#include "machine/program_lines.h"
#include "machine/program_run.h"

namespace lightmill::detail {

namespace {

constexpr double kDegreesPerRad = 180 / kPi;
/// Of the restart's numbers from the original's (mm, rad): seven decimals are written.
constexpr double kSame = 1e-6;
constexpr int kDecimals = 7;


/// A word of a block: a letter and its number as it stands there.
struct Word {
  char letter;
  std::string_view number;
};

bool is_number_part(char c) {
  return (c >= '0' && c <= '9') || c == '.' || c == '+' || c == '-';
}

/// The words of a block as far as they are a letter and a number; comments, keywords and brackets are left out.
std::vector<Word> words_in(std::string_view line) {
  std::vector<Word> words;
  for (std::size_t i = 0; i < line.size();) {
    const char c = static_cast<char>(std::toupper(static_cast<unsigned char>(line[i])));
    if (c == ';') break;
    if (c == '(') {
      while (i < line.size() && line[i] != ')') ++i;
      continue;
    }
    std::size_t end = i + 1;
    while (end < line.size() && is_number_part(line[end])) ++end;
    const bool keyword = i > 0 && std::isalnum(static_cast<unsigned char>(line[i - 1])) != 0 && !is_number_part(line[i - 1]);
    if (c >= 'A' && c <= 'Z' && end > i + 1 && !keyword) words.push_back({c, line.substr(i + 1, end - i - 1)});
    i = end;
  }
  return words;
}

/// "54", "5.1": a code without leading zeros.
std::string code(const Word& word) {
  std::string text(word.number);
  while (text.size() > 1 && text[0] == '0' && text[1] != '.') text.erase(0, 1);
  return word.letter + text;
}

/// What the program's text has set where it is to go on; what a reader's steps do not tell.
struct TextModes {
  std::vector<std::string> settings;  ///< blocks that set offset, smoothing, shortest ways... in their order, without numbers
  std::vector<std::string> opening;   ///< of the program
  std::string tool_call;              ///< Heidenhain: with speed and length offset
  std::string offset;                 ///< G54
  int motion = -1;                    ///< G0 to G3; kCycle
  bool says_motion = false;           ///< the last line did
  std::string feed;
  int plane = 17;
  int feed_mode = 94;
  bool incremental = false, compensated = false, inches = false;
  /// Another straight move, or an arc that says so itself, can follow without the lines before it.
  [[nodiscard]] bool goes_on() const { return motion < 2 || (says_motion && motion != kCycle); }
  static constexpr int kCycle = 80;
};

/// How a dialect says things.
class Syntax {
 public:
  Syntax(ReaderDialect dialect, const MachineModel& machine) : dialect_(dialect), machine_(machine) {}

  [[nodiscard]] bool conversational() const { return dialect_ == ReaderDialect::kHeidenhain; }
  [[nodiscard]] bool iso() const { return dialect_ == ReaderDialect::kHeidenhainIso; }
  [[nodiscard]] bool heidenhain() const { return conversational() || iso(); }
  [[nodiscard]] bool siemens() const { return dialect_ == ReaderDialect::kSiemens; }
  [[nodiscard]] bool fanuc() const { return dialect_ == ReaderDialect::kFanuc; }

  /// X1.5, X+1.5, X1., C=DC(291.682)
  [[nodiscard]] std::string word(std::size_t axis, double value, const char* prefix = "") const {
    const std::array<char, 5> letters{'X', 'Y', 'Z', machine_.outer.letter, machine_.inner.letter};
    const bool endless = axis == 3 ? is_endless(machine_.outer) : axis == 4 && is_endless(machine_.inner);
    if (siemens() && endless) {
      double turned = std::fmod(value, 360);
      if (turned < 0) turned += 360;
      return std::string(" ") + letters[axis] + "=DC(" + compact(turned, kDecimals) + ")";
    }
    std::string number = compact(value, kDecimals);
    if (heidenhain() && number.front() != '-') number.insert(0, 1, '+');
    if (fanuc() && number.find('.') == std::string::npos) number += '.';
    return std::string(" ") + prefix + letters[axis] + number;
  }
  [[nodiscard]] static bool is_endless(const RotaryAxis& axis) { return !std::isfinite(axis.max_rad - axis.min_rad); }

  /// A straight move by words of the axes.
  [[nodiscard]] std::string rapid(const std::string& words) const {
    if (conversational()) return "L" + words + " FMAX";
    return (iso() ? "G00" : "G0") + words;
  }
  [[nodiscard]] std::string feed_move(const std::string& words, const std::string& feed) const {
    if (conversational()) return "L" + words + " F" + feed;
    return (iso() ? "G01" : "G1") + words + " F" + feed;
  }
  [[nodiscard]] std::string machine_rapid(const std::string& words) const {
    if (conversational()) return "L" + words + " R0 FMAX M91";
    if (iso()) return "G00" + words + " M91";
    return siemens() ? "SUPA G0" + words + " D0" : "G53 G0" + words;
  }
  [[nodiscard]] std::string tcp_off() const {
    if (heidenhain()) return "M129";
    if (siemens()) return "TRAFOOF";
    return fanuc() ? "G49" : "M429";
  }
  [[nodiscard]] std::string number(double value) const {
    std::string text = compact(value, kDecimals);
    return fanuc() && text.find('.') == std::string::npos ? text + "." : text;
  }
  void dwell(double seconds, std::vector<std::string>& blocks) const {
    if (conversational()) {
      blocks.emplace_back("CYCL DEF 9.0 DWELL TIME");
      blocks.push_back("CYCL DEF 9.1 DWELL " + compact(seconds, 3));
    } else if (iso()) {
      blocks.push_back("G04 F" + compact(seconds, 3));
    } else if (fanuc()) {
      blocks.push_back("G4 P" + compact(1000 * seconds, 0));
    } else {
      blocks.push_back((siemens() ? "G4 F" : "G4 P") + compact(seconds, 3));
    }
  }

  /// A block without its number (and ISO's asterisk).
  [[nodiscard]] std::string_view bare(std::string_view line) const {
    const auto skip_digits = [&] {
      while (!line.empty() && line.front() >= '0' && line.front() <= '9') line.remove_prefix(1);
      while (!line.empty() && line.front() == ' ') line.remove_prefix(1);
    };
    if (conversational()) skip_digits();
    if (!conversational() && line.size() > 1 && line.front() == 'N' && line[1] >= '0' && line[1] <= '9') {
      line.remove_prefix(1);
      skip_digits();
    }
    while (iso() && !line.empty() && (line.back() == '*' || line.back() == ' ')) line.remove_suffix(1);
    return line;
  }

  /// Lines behind it may be carried out in another order, or with other numbers, than they stand there.
  [[nodiscard]] bool jumps(std::string_view line) const {
    const std::string_view block = bare(line);
    if (conversational()) return block.starts_with("LBL") || block.starts_with("CALL") || block.starts_with("FN ");
    if (iso()) return block.starts_with("G98") || begins_with_code(block, 'L') || begins_with_code(block, 'D');
    if (siemens()) return false;
    if (!fanuc() && !block.empty() && (block.front() == 'O' || block.front() == 'o')) return true;
    return block.find('#') < block.find_first_of("(;") || block.find("M98") < block.find_first_of("(;");
  }

  /// Reads a line of the program into the modes.
  void read(std::string_view line, TextModes& modes) const {
    const std::string_view block = bare(line);
    modes.says_motion = false;
    if (conversational()) return read_conversational(block, modes);
    if (line.starts_with('%') || (fanuc() && block.starts_with('O'))) {
      modes.opening.emplace_back(block);
      return;
    }
    if (block.starts_with("CYCLE832")) {
      modes.settings.emplace_back(block);
      return;
    }
    bool setting = false, other = false;
    for (const Word& word : words_in(block)) {
      const std::string name = code(word);
      if (word.letter == 'F' && block.find("G4 ") == std::string_view::npos && block.find("G04") == std::string_view::npos) modes.feed = word.number;
      if (word.letter == 'G' || word.letter == 'M') {
        read_code(name, modes);
        const bool sets = is_setting(name);
        setting = setting || sets;
        other = other || (!sets && name != "G43" && name != "G80");
      } else if (std::string_view("PQT").find(word.letter) == std::string_view::npos || (word.letter == 'T' && !iso())) {
        other = true;
      }
    }
    if (iso() && (block.starts_with("G30") || block.starts_with("G31"))) modes.opening.emplace_back(block);
    if (iso() && words_in(block).size() > 1 && block.front() == 'T') modes.tool_call = block;
    if (setting && !other) modes.settings.emplace_back(block);
  }

 private:
  ReaderDialect dialect_;
  const MachineModel& machine_;

  static bool begins_with_code(std::string_view block, char letter) {
    return block.size() > 1 && block[0] == letter && block[1] >= '0' && block[1] <= '9';
  }
  static void read_code(const std::string& name, TextModes& modes) {
    static const std::vector<std::string> cycles{"G33", "G73", "G76", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89"};
    const bool cycle = std::find(cycles.begin(), cycles.end(), name) != cycles.end();
    if (name == "G0" || name == "G1" || name == "G2" || name == "G3" || cycle) {
      modes.motion = cycle ? TextModes::kCycle : name[1] - '0';
      modes.says_motion = true;
    }
    if (name == "G80") modes.motion = -1;
    if (name == "G20" || name == "G70" || name == "G700") modes.inches = true;
    if (name == "G17" || name == "G18" || name == "G19") modes.plane = name[2] - '0' + 10;
    if (name == "G90" || name == "G91") modes.incremental = name == "G91";
    if (name == "G93" || name == "G94" || name == "G95") modes.feed_mode = name[2] - '0' + 90;
    if (name == "G41" || name == "G42") modes.compensated = true;
    if (name == "G40") modes.compensated = false;
    if (name.size() >= 3 && name.starts_with("G5") && name[2] >= '4' && name[2] <= '9') modes.offset = name;
  }
  /// Codes that move nothing and that a restart repeats as they stand; those that it sets itself are none.
  [[nodiscard]] bool is_setting(const std::string& name) const {
    static const std::vector<std::string> common{"G17", "G18", "G19", "G21", "G40", "G49", "G61", "G61.1", "G64",
                                                 "G71", "G90", "G91", "G93", "G94", "G95", "G80", "G5.1", "G60", "G642",
                                                 "G62", "G247", "M126", "M127"};
    if (name.size() >= 3 && name.starts_with("G5") && name[2] >= '4' && name[2] <= '9') return true;
    return std::find(common.begin(), common.end(), name) != common.end();
  }

  static void read_conversational(std::string_view block, TextModes& modes) {
    if (block.starts_with("BEGIN") || block.starts_with("BLK")) modes.opening.emplace_back(block);
    modes.inches = modes.inches || (block.starts_with("BEGIN") && block.ends_with("INCH"));
    if (block.starts_with("CC ") || block.starts_with("C ")) modes.motion = 2;
    if (block.starts_with("L ")) modes.motion = 1;
    modes.says_motion = block.starts_with("CR ");
    if (block.starts_with("TOOL CALL ") && block.size() > 10 && block[10] != 'S') modes.tool_call = block;
    const bool cycle = block.starts_with("CYCL DEF 7.") || block.starts_with("CYCL DEF 32.") || block.starts_with("CYCL DEF 247");
    const bool continues = block.starts_with("Q339=");
    if (cycle || continues || block == "M126" || block == "M127") modes.settings.emplace_back(block);
    if (!block.starts_with("L") && !block.starts_with("C")) return;
    if (block.starts_with("CYCL")) return;
    for (const Word& word : words_in(block)) {
      if (word.letter == 'F') modes.feed = word.number;
    }
  }
};

/// What is true in the machine where a line begins.
struct ShopState {
  AxisValues joints{}, programmed{};
  int tool = 0, spindle = 5;
  double rpm = 0, dwell_s = 0;
  bool mist = false, flood = false, tcp = false, rotary_used = false;

  void take(const ProgramStep& step) {
    switch (step.kind) {
      case ProgramStep::kMove:
        rotary_used = rotary_used || step.target[3] != joints[3] || step.target[4] != joints[4];
        joints = step.target;
        programmed = step.programmed;
        tcp = step.tcp;
        break;
      case ProgramStep::kDwell:
        if (spindle != 5) dwell_s = std::max(dwell_s, step.seconds);
        break;
      case ProgramStep::kSpindle:
        spindle = step.number;
        rpm = step.rpm;
        break;
      case ProgramStep::kCoolant:
        mist = step.number == 7 || (mist && step.number != 9);
        flood = step.number == 8 || (flood && step.number != 9);
        break;
      case ProgramStep::kChangeTool:
        tool = step.number;
        spindle = 5;
        break;
      case ProgramStep::kPause:
      case ProgramStep::kEnd:
        break;
    }
  }
};

void rethrow(const ReadResult& read) {
  if (!read.error) return;
  throw InputError("line " + std::to_string(read.error->line) + " of the program: " + read.error->rule +
                   "; a control would stop there");
}

class FileRestartWriter {
 public:
  FileRestartWriter(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                    const RestartOptions& options)
      : machine_(machine),
        setup_(setup),
        program_(program),
        options_(options),
        dialect_(reader_dialect(options.dialect)),
        syntax_(dialect_, machine),
        reader_(reader_setup(machine, setup)),
        view_(machine, setup.workpiece_origin_mm),
        lines_(program_lines(program)) {}

  Restart write(long line) {
    restart_.uncut_line = line;
    const std::size_t uncut = index_to_go_on_at(lines_, line);
    for (const ProgramLine& each : lines_) {
      if (!syntax_.jumps(each.text)) continue;
      throw InputError("the program has loops, subprograms or variables in line " + std::to_string(each.number) +
                       ", no restart can be written for it");
    }
    const std::size_t first = good_place(uncut);
    if (first == 0) {
      restart_.text = std::string(program_);
      return std::move(restart_);
    }
    restart_.first_line = lines_[first].number;
    const ShopState state = state_before(restart_.first_line);
    for (std::size_t i = 0; i < first; ++i) syntax_.read(lines_[i].text, modes_);
    if (modes_.compensated || modes_.inches) {
      throw InputError(std::string(modes_.inches ? "the program is in inches" : "cutter compensation is on") + " at line " +
                       std::to_string(restart_.first_line) + ", no restart can be written there");
    }
    entry(state);
    assemble(first);
    check(state);
    return std::move(restart_);
  }

 private:
  const MachineModel& machine_;
  const OperatorSetup& setup_;
  std::string_view program_;
  const RestartOptions& options_;
  ReaderDialect dialect_;
  Syntax syntax_;
  ReaderSetup reader_;
  WorkpieceView view_;
  std::vector<ProgramLine> lines_;
  Restart restart_;
  TextModes modes_;
  std::vector<std::string> blocks_;  ///< of the entry, without numbers
  JointPosition stopped_;            ///< where the restart backs out from
  AxisValues above_{};               ///< where the feed in begins

  [[nodiscard]] double length_mm(int tool) const {
    const auto found = reader_.tool_length_mm.find(tool);
    return found == reader_.tool_length_mm.end() ? 0 : found->second;
  }
  ToolPose pose(const AxisValues& q, int tool) { return view_.cutter(to_position(q), length_mm(tool)); }

  /// The index of the line to go on with; 0: nothing was cut before.
  std::size_t good_place(std::size_t uncut) {
    std::vector<LineFacts> facts(uncut + 1);
    ShopState state;
    state.joints = reader_.start;
    bool low_without_spindle = false;
    std::size_t at = 0;
    const long end = lines_[uncut].number;
    const ReadResult read = read_program(program_, dialect_, machine_, reader_, [&](const ProgramStep& step) {
      if (step.line >= end) return;
      while (at + 1 < uncut && lines_[at].number < step.line) ++at;
      LineFacts& line = facts[at];
      line.plain = line.plain && step.kind == ProgramStep::kMove && !step.rapid;
      if (step.kind == ProgramStep::kMove && !step.rapid) {
        line.feeds = true;
        line.cut_mm += (pose(step.target, state.tool).tip_mm - pose(state.joints, state.tool).tip_mm).norm();
      }
      line.stops_spindle = line.stops_spindle || (step.kind == ProgramStep::kSpindle && step.number == 5 && state.spindle != 5);
      state.take(step);
      low_without_spindle = state.spindle == 5 && state.joints[2] < machine_.retract_z_mm;
    });
    rethrow(read);
    TextModes modes;
    bool continued = false;
    for (std::size_t i = 0; i <= uncut; ++i) {
      const std::size_t set = modes.settings.size() + modes.opening.size();
      syntax_.read(lines_[i].text, modes);
      // Lines that set something are not gone over again: the entry has set it.
      if (modes.settings.size() + modes.opening.size() > set) facts[i].plain = false;
      facts[i].good = modes.goes_on() && !continued;
      continued = lines_[i].text.ends_with('~');
    }
    restart_.overlap_mm = options_.overlap_mm;
    return restart_index(facts, low_without_spindle, restart_.overlap_mm);
  }

  ShopState state_before(long first_line) {
    ShopState state;
    state.joints = reader_.start;
    read_program(program_, dialect_, machine_, reader_, [&](const ProgramStep& step) {
      if (step.line < first_line) state.take(step);
    });
    return state;
  }

  void block(const std::string& text) { blocks_.push_back(text); }
  [[nodiscard]] std::string words(const AxisValues& q, std::size_t first, std::size_t last) const {
    std::string text;
    for (std::size_t i = first; i <= last; ++i) text += syntax_.word(i, i < 3 ? q[i] : q[i] * kDegreesPerRad);
    return text;
  }
  [[nodiscard]] std::string top() const { return syntax_.machine_rapid(syntax_.word(2, machine_.retract_z_mm)); }
  void comment(const std::string& text) {
    std::string upper = plain_comment(text);
    std::transform(upper.begin(), upper.end(), upper.begin(), [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
    block(syntax_.heidenhain() || syntax_.siemens() ? "; " + upper : "(" + upper + ")");
  }

  void entry(const ShopState& state) {
    const AxisValues& q = state.joints;
    restart_.tool = state.tool;
    restart_.tool_length_mm = length_mm(state.tool);
    restart_.rpm = state.spindle == 5 ? 0 : state.rpm;
    restart_.dwell_s = state.spindle == 5 ? 0 : std::max(state.dwell_s, machine_.spindle_start_s);
    restart_.place = pose(q, state.tool);
    // Along the tool's axis out of the box around blank and clamps, but never above the machine's top.
    double way = way_out_mm(setup_, restart_.place, state.tool, options_.clearance_mm);
    const auto at_way = [&](double mm) {
      return to_joints(view_.joints(restart_.place.tip_mm + mm * restart_.place.axis, q[3], q[4], length_mm(state.tool)));
    };
    AxisValues above = at_way(way);
    if (above[2] > machine_.retract_z_mm) {
      way *= std::max(0.0, machine_.retract_z_mm - q[2]) / (above[2] - q[2]);
      above = at_way(way);
    }
    restart_.stand_off = pose(above, state.tool);
    const bool down = q[2] < machine_.retract_z_mm;
    AxisValues off = state.programmed;  // the same in the program's coordinates
    for (std::size_t i = 0; i < 3; ++i) off[i] += state.tcp ? way * restart_.place.axis[static_cast<int>(i)] : above[i] - q[i];

    comment("RESTART OF " + options_.program_name + " AT ITS LINE " + std::to_string(restart_.first_line));
    comment("ITS LINES BEFORE " + std::to_string(restart_.uncut_line) + " ARE CUT, " + fixed(restart_.overlap_mm, 3) +
            " MM ARE GONE OVER AGAIN");
    if (machine_.has_tcp) block(syntax_.tcp_off());
    for (const std::string& setting : modes_.settings) block(setting);
    if (syntax_.iso()) block("G90 G40");
    if (!syntax_.heidenhain()) block(syntax_.siemens() ? "G17 G40 G71 G90 G94" : "G21 G90 G94 G17 G40 G49 G80");
    stopped_ = options_.stands.value_or(to_position(q));
    const Vec3 out = outwards(view_, stopped_);
    restart_.backs_out_mm = back_out_mm(machine_, out, stopped_.z_mm, options_.back_out_mm);
    if (restart_.backs_out_mm > 0) back_out(restart_.backs_out_mm * out);
    block(top());
    const Vec3& change = machine_.tool_change_mm;
    block(syntax_.machine_rapid(syntax_.word(0, change.x()) + syntax_.word(1, change.y())));
    if (change.z() != machine_.retract_z_mm) block(syntax_.machine_rapid(syntax_.word(2, change.z())));
    if (syntax_.heidenhain()) {
      if (!modes_.tool_call.empty()) block(modes_.tool_call);
    } else if (state.tool > 0) {
      block("T" + std::to_string(state.tool) + " M6");
    }
    if (state.spindle != 5) {
      const std::string turn = "M" + std::to_string(state.spindle);
      block(syntax_.heidenhain() ? turn : "S" + compact(state.rpm, kDecimals) + " " + turn);
      syntax_.dwell(restart_.dwell_s, blocks_);
    }
    if (state.mist) block("M7");
    if (state.flood) block("M8");
    block(top());
    if (state.rotary_used) block(syntax_.rapid(words(q, 3, 4)));
    block(syntax_.machine_rapid(words(above, 0, 1)));
    above_ = above;
    if (down) {
      approach(state, off);
      block(syntax_.feed_move(words(state.programmed, 0, 2), syntax_.number(options_.entry_feed_mm_per_s * 60)));
    }
    restore(state);
  }

  void back_out(const Vec3& way) {
    std::string all;
    for (std::size_t i = 0; i < 3; ++i) all += syntax_.word(i, way[static_cast<int>(i)], syntax_.conversational() ? "I" : "");
    if (!syntax_.conversational()) block("G91");
    block(syntax_.feed_move(all, syntax_.number(options_.entry_feed_mm_per_s * 60)));
    if (!syntax_.conversational()) block("G90");
  }

  /// From X and Y above the place to the clearance on the tool's axis, with the tool's length and, where the program has it
  /// there, tool-centre-point control.
  void approach(const ShopState& state, const AxisValues& off) {
    const std::string tool = std::to_string(state.tool);
    const std::string down = words(off, 2, 2), all = words(off, 0, 2);
    if (syntax_.fanuc()) return block((state.tcp ? "G43.4 H" + tool + all : "G43 H" + tool + down));
    if (syntax_.siemens()) {
      block("D1");
      if (state.tcp) {
        block("TRAORI");
        if (!modes_.offset.empty()) block(modes_.offset);
        block("ORIWKS ORIAXES");
      }
    } else if (syntax_.heidenhain()) {
      if (state.tcp) block("M128");
    } else {
      block("G43 H" + tool);
      if (state.tcp) block("M428");
    }
    block(syntax_.rapid(state.tcp ? all : down));
  }

  void restore(const ShopState& state) {
    if (syntax_.heidenhain()) {
      // A feed stays with the block that says it: once more to where it stands.
      if (!modes_.feed.empty()) block(syntax_.feed_move(words(state.programmed, 0, 2), modes_.feed));
      if (syntax_.iso() && modes_.motion == 0) block("G00");
      if (syntax_.iso() && modes_.incremental) block("G91");
      return;
    }
    if (modes_.plane != 17) block("G" + std::to_string(modes_.plane));
    if (modes_.incremental) block("G91");
    if (modes_.feed_mode == 95) block("G95");
    if (modes_.feed_mode != 93 && !modes_.feed.empty()) block("F" + modes_.feed);
    if (modes_.motion == 0 || modes_.motion == 1) block("G" + std::to_string(modes_.motion));
    if (modes_.feed_mode == 93) block("G93");
  }

  /// Numbers and names where the dialect has them.
  void assemble(std::size_t first) {
    const std::string end = program_.find("\r\n") == std::string_view::npos ? "\n" : "\r\n";
    long number = 0;
    bool continued = false;
    const auto write = [&](std::string_view block) {
      std::string text = renamed(block);
      if (syntax_.conversational()) text = (continued ? "  " : std::to_string(number++) + " ") + text;
      continued = block.ends_with('~');
      if (syntax_.iso() && !block.starts_with('%')) text = "N" + std::to_string(++number) + " " + text;
      if (syntax_.iso()) text += " *";
      restart_.text += text + end;
    };
    for (const std::string& opening : modes_.opening) write(opening);
    for (const std::string& block : blocks_) write(block);
    restart_.entry_lines = static_cast<long>(modes_.opening.size() + blocks_.size());
    if (!syntax_.heidenhain()) {
      std::size_t at = 0;
      for (long i = 1; i < lines_[first].number; ++i) at = program_.find('\n', at) + 1;
      restart_.text += program_.substr(at);
      return;
    }
    for (std::size_t i = first; i < lines_.size(); ++i) {
      const std::string_view block = syntax_.bare(lines_[i].text);
      if (syntax_.iso() && block.starts_with('%')) restart_.text += "N99999999 ";
      write(block);
    }
  }

  /// A Heidenhain program is called as its file.
  [[nodiscard]] std::string renamed(std::string_view block) const {
    std::string text(block);
    const char* const name = syntax_.conversational() && (block.starts_with("BEGIN PGM ") || block.starts_with("END PGM ")) ? " PGM "
                             : syntax_.iso() && block.starts_with('%')                                                    ? "%"
                                                                                                                          : nullptr;
    if (name == nullptr) return text;
    const std::size_t from = text.find(name) + std::string_view(name).size();
    return text.insert(std::min(text.find(' ', from), text.size()), kFileRestartSuffix);
  }

  /// The restart as the control will read it, beside the original from there on.
  void check(const ShopState& original) {
    struct Heard {
      ProgramStep step;
      long line;
    };
    std::vector<Heard> wanted;
    const auto kept = [](const ProgramStep& step) { return step.kind != ProgramStep::kMove || step.whole; };
    read_program(program_, dialect_, machine_, reader_, [&](const ProgramStep& step) {
      if (step.line >= restart_.first_line && kept(step)) wanted.push_back({step, step.line});
    });
    ReaderSetup reader = reader_;
    if (restart_.backs_out_mm > 0) reader.start = to_joints(stopped_);
    ShopState state;
    state.joints = reader.start;
    AxisValues last_rapid{};
    bool through = false;
    std::size_t next = 0;
    const auto differs = [&](const std::string& what) { throw NumericalError("the restart does not restore the " + what); };
    const auto follows = [&](const ProgramStep& step) {
      if (next >= wanted.size()) differs("program's end");
      const ProgramStep& other = wanted[next].step;
      const std::string where = " at line " + std::to_string(wanted[next].line);
      ++next;
      if (step.kind != other.kind || step.number != other.number || step.rpm != other.rpm) differs("program" + where);
      if (step.kind != ProgramStep::kMove) return;
      if (!same(step.target, other.target)) differs("place" + where);
      if (step.rapid != other.rapid || step.tcp != other.tcp) differs("modes" + where);
      if (std::abs(step.seconds - other.seconds) > 1e-4 + kSame * other.seconds && next > 1) differs("feed" + where);
      if (step.corner_tolerance_mm != other.corner_tolerance_mm || step.exact_stop != other.exact_stop) differs("smoothing" + where);
    };
    const std::vector<ProgramLine> heard_lines = program_lines(restart_.text);
    const ReadResult read = read_program(restart_.text, dialect_, machine_, reader, [&](const ProgramStep& step) {
      if (step.line <= restart_.entry_lines) {
        if (step.kind == ProgramStep::kMove) {
          within_travels(machine_, step.target, heard_lines[static_cast<std::size_t>(step.line - 1)].text);
          if (step.rapid) last_rapid = step.target;
        }
        state.take(step);
        return;
      }
      if (!through) {
        through = true;
        if (!same(state.joints, original.joints) || !same(last_rapid, above_)) differs("place");
        if (state.tool != original.tool) differs("tool");
        if (state.spindle != original.spindle || (state.spindle != 5 && state.rpm != original.rpm)) differs("spindle");
        if (state.mist != original.mist || state.flood != original.flood) differs("coolant");
      }
      if (kept(step)) follows(step);
    });
    if (read.error) differs("program: line " + std::to_string(read.error->line) + ", " + read.error->rule);
    if (next != wanted.size()) differs("program's end");
  }

  /// Endless axes may have turned more often.
  [[nodiscard]] bool same(const AxisValues& a, const AxisValues& b) const {
    for (std::size_t i = 0; i < 5; ++i) {
      double apart = a[i] - b[i];
      if ((i == 3 && Syntax::is_endless(machine_.outer)) || (i == 4 && Syntax::is_endless(machine_.inner)))
        apart = std::remainder(apart, 2 * kPi);
      if (std::abs(apart) > kSame) return false;
    }
    return true;
  }
};

/// The program up to the first line that may not be cut, with an end of its own: the tool backs out as the operator would
/// move it, or stays in the cut if the restart does that itself.
std::string cut_short(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                      const Restart& restart, const std::string& dialect) {
  const Syntax syntax(reader_dialect(dialect), machine);
  const ReaderSetup reader = reader_setup(machine, setup);
  ShopState state;
  state.joints = reader.start;
  read_program(program, reader_dialect(dialect), machine, reader, [&](const ProgramStep& step) {
    if (step.line < restart.uncut_line) state.take(step);
  });
  std::vector<std::string> blocks;
  if (machine.has_tcp) blocks.push_back(syntax.tcp_off());
  if (restart.backs_out_mm == 0) {
    WorkpieceView view(machine, setup.workpiece_origin_mm);
    const AxisValues out = to_joints(backed_out(view, to_position(state.joints), kBackOut_mm));
    if (out[2] < machine.retract_z_mm)
      blocks.push_back(syntax.machine_rapid(syntax.word(0, out[0]) + syntax.word(1, out[1]) + syntax.word(2, out[2])));
    blocks.push_back(syntax.machine_rapid(syntax.word(2, machine.retract_z_mm)));
  }
  blocks.emplace_back("M30");
  std::string text, first;
  long number = 0;
  for (const ProgramLine& line : program_lines(program)) {
    if (line.number >= restart.uncut_line) break;
    if (first.empty()) first = line.text;
    text += std::string(line.text) + "\n";
    const char* const begin = line.text.data() + (syntax.iso() && line.text.front() == 'N' ? 1 : 0);
    if (long n = 0; std::from_chars(begin, line.text.data() + line.text.size(), n).ec == std::errc()) number = n + 1;
  }
  for (const std::string& block : blocks) {
    text += syntax.conversational() ? std::to_string(number++) + " " + block
            : syntax.iso()          ? "N" + std::to_string(number++) + " " + block + " *"
                                    : block;
    text += "\n";
  }
  if (syntax.conversational()) text += std::to_string(number) + " END" + first.substr(first.find(" PGM")) + "\n";
  if (syntax.iso()) text += "N99999999 " + first + "\n";
  if (first == "%") text += "%\n";
  return text;
}

}  // namespace

Restart write_file_restart(const MachineModel& machine, const OperatorSetup& setup, std::string_view program, long line,
                           const RestartOptions& options) {
  return FileRestartWriter(machine, setup, program, options).write(line);
}

std::vector<PathPiece> file_path_near(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                                      const Vec3& place, double radius_mm, const std::string& dialect) {
  std::vector<PathPiece> pieces;
  const ReaderSetup reader = reader_setup(machine, setup);
  WorkpieceView view(machine, setup.workpiece_origin_mm);
  AxisValues from = reader.start;
  double length_mm = 0;
  read_program(program, reader_dialect(dialect), machine, reader, [&](const ProgramStep& step) {
    if (step.kind == ProgramStep::kChangeTool) {
      const auto found = reader.tool_length_mm.find(step.number);
      length_mm = found == reader.tool_length_mm.end() ? 0 : found->second;
    }
    if (step.kind != ProgramStep::kMove) return;
    add_piece_near(place, radius_mm,
                   {step.line, view.cutter(to_position(from), length_mm).tip_mm, view.cutter(to_position(step.target), length_mm).tip_mm,
                    step.rapid},
                   pieces);
    from = step.target;
  });
  return pieces;
}

RestartTrial try_file_restart(const MachineModel& machine, const OperatorSetup& setup, const StockOptions& stock,
                              const std::vector<std::string>& done, std::string_view program, const Restart& restart,
                              const std::string& dialect, const Monitor& monitor) {
  const std::string name = "restart";
  std::vector<ProgramFile> files;
  for (const std::string& text : done) files.push_back({"done " + std::to_string(files.size()), text});
  files.push_back({"cut", cut_short(machine, setup, program, restart, dialect)});
  files.push_back({name, restart.text});
  ProgramRun run = run_programs(machine, reader_dialect(dialect), setup, files, stock, monitor);
  RestartTrial trial;
  for (Fault& fault : run.faults) {
    if (fault.program == name) {
      trial.faults.push_back(std::move(fault));
    } else if (fault.kind == "error" || fault.kind == "limit" || fault.kind == "no_program_end") {
      throw NumericalError("the trial cannot mill what is done: line " + std::to_string(fault.line) + ", " + fault.message);
    }
  }
  for (const SectionTiming& section : run.timing) {
    if (section.program == static_cast<int>(files.size())) trial.seconds += section.timing.seconds;
  }
  trial.surface = std::move(run.surface);
  return trial;
}

}  // namespace lightmill::detail

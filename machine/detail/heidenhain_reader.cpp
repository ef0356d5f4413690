// Heidenhain conversational: blocks, tools, cycles, modes.
#include "machine/detail/heidenhain_reader.h"

namespace lightmill::detail {

namespace {

constexpr Grammar::Operator kOperators[] = {{"+", 0, [](double a, double b) { return a + b; }},
                                            {"-", 0, [](double a, double b) { return a - b; }},
                                            {"*", 1, [](double a, double b) { return a * b; }},
                                            {"/", 1, [](double a, double b) { return a / b; }},
                                            {"^", 2, [](double a, double b) { return std::pow(a, b); }}};

constexpr Grammar::Function kFunctions[] = {{"SQRT", [](double x) { return std::sqrt(x); }},
                                            {"SQ", [](double x) { return x * x; }},
                                            {"SIN", sine},
                                            {"COS", cosine},
                                            {"TAN", tangent},
                                            {"ASIN", arc_sine},
                                            {"ACOS", arc_cosine},
                                            {"ATAN", [](double x) { return arc_tangent(x, 1); }},
                                            {"LN", [](double x) { return std::log(x); }},
                                            {"LOG", [](double x) { return std::log10(x); }},
                                            {"EXP", [](double x) { return std::exp(x); }},
                                            {"NEG", [](double x) { return -x; }},
                                            {"INT", [](double x) { return std::trunc(x); }},
                                            {"ABS", [](double x) { return std::abs(x); }},
                                            {"FRAC", [](double x) { return x - std::trunc(x); }}};

constexpr Grammar kHeidenhain{'(', ')', 3, kOperators, kFunctions, {}, true, true};

}  // namespace

HeidenhainReader::HeidenhainReader(std::string_view text, ReaderCore& core, bool iso)
    : ExpressionReader(kHeidenhain), core_(core), path_(core, true), lines_(split_lines(text)), iso_(iso) {}

ReadResult HeidenhainReader::run() {
  return run_lines(
      core_, lines_.size(), ended_,
      iso_ ? "the program's last block, % and its name, is missing" : "END PGM is missing",
      [this](std::size_t at) {
        at_ = at;
        next_ = at + 1;
        if (split(lines_[at])) iso_ ? read_iso_block() : read_block();
        return next_;
      },
      [this] { check_frame(); });
}

/// Block numbers count from 0 without a gap, or grow (DIN/ISO); labels are found before anything moves.
void HeidenhainReader::check_frame() {
  long last = -1;
  bool first = true;
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    core_.line = static_cast<long>(i) + 1;
    const bool follows = continued_;
    if (!split(lines_[i]) || follows) continue;
    if (iso_ && !first && number_ <= last) reject(1, "block numbers are whole and grow");
    if (!iso_ && number_ != last + 1) reject(1, "block number " + std::to_string(last + 1) + " expected");
    last = number_;
    first = false;
    const bool labels = tokens_.size() == 2 && (iso_ ? is(0, "G98") && tokens_[1].text[0] == 'L' : is(0, "LBL"));
    if (!labels) continue;
    const std::string_view name = tokens_[1].text.substr(iso_ ? 1 : 0);
    if (name != "0" && !labels_.emplace(name, i).second) reject(tokens_[1].column, "label set twice");
  }
  continued_ = false;
}

void HeidenhainReader::preset(double n, int column) {
  preset_ = datum(core_, n, column);
  shift_ = {};
  renew_offset();
}

/// Words of a block without its number, comment and end; false if nothing is left.
bool HeidenhainReader::split(std::string_view line) {
  split_words(line, tokens_);
  const bool follows = continued_;
  const std::size_t last = line.find_last_not_of(" \t");
  continued_ = last != std::string_view::npos && line[last] == '~';  // behind the comment, too
  if (!tokens_.empty() && tokens_.back().text == "~") tokens_.pop_back();
  if (tokens_.empty() && (iso_ || follows || last == std::string_view::npos)) return false;
  if (iso_ && !continued_) {
    if (tokens_.back().text == "*")
      tokens_.pop_back();
    else if (line.find(';') == std::string_view::npos)
      reject(tokens_.back().column, "a block ends with *");
    if (tokens_.empty()) return false;
  }
  if (follows) return true;
  number_ = -1;
  if (iso_ && tokens_[0].text[0] != 'N') return true;
  if (tokens_.empty()) reject(1, "a block number is missing");
  const char* p = tokens_[0].text.data() + (iso_ ? 1 : 0);
  const char* const end = tokens_[0].text.data() + tokens_[0].text.size();
  double n = 0;
  if (!read_digits(p, end, n) || p != end || n > 1e8 || n != std::floor(n)) reject(1, "a block number is missing");
  number_ = static_cast<long>(n);
  tokens_.erase(tokens_.begin());
  return !tokens_.empty() || !iso_;
}

void HeidenhainReader::read_block() {
  if (tokens_.empty()) return;
  const std::string_view first = tokens_[0].text;
  if (defining_) return read_cycle_words(0);
  if (first == "BEGIN" || first == "END") return frame(first == "BEGIN");
  if (!begun_) reject(tokens_[0].column, "the program must start with BEGIN PGM");
  if (first == "*") return;  // a heading
  for (const std::string_view path : {"L", "C", "CR", "CT", "LP", "CP", "CTP"}) {
    if (first == path) return move(first);
  }
  if (first == "CC") return circle_centre();
  if (first == "FN") return fn();
  if (first.size() > 1 && first[0] == 'Q' && first[1] >= '0' && first[1] <= '9') return formula();
  if (first == "LBL") return label();
  if (first == "CALL") return call();
  if (first == "RND" || first == "CHF") return corner();
  refuse_inside_contour();
  if (first == "APPR") return begin_approach();
  if (first == "DEP") return depart();
  if (first == "LN") return vector_move();
  if (first == "TOOL") return tool();
  if (first == "CYCL") return cycle();
  if (first == "BLK") {
    const bool known = is(2, "0.1") || is(2, "0.2") || is(2, "CYLINDER");
    if (!is(1, "FORM") || tokens_.size() < 6 || !known) incomplete();
    return;
  }
  if (first == "STOP") {
    modes(1);
    path_.flush();
    return core_.say(ProgramStep::kPause, 0);
  }
  if (first == "PLANE") return plane();
  if (first == "FUNCTION") return function();
  if (first[0] == 'M') {
    modes(0);
    return finish();
  }
  reject(tokens_[0].column, "'" + std::string(first) + "' is not understood");
}

/// FUNCTION TCPM, FUNCTION RESET TCPM.
void HeidenhainReader::function() {
  if (is(1, "RESET") && is(2, "TCPM") && tokens_.size() == 3) return set_tcp(false);
  static constexpr std::string_view kTcpm[] = {"FUNCTION", "TCPM", "F", "TCP", "AXIS", "POS", "PATHCTRL", "AXIS"};
  for (std::size_t i = 0; i < 8; ++i) {
    if (!is(i, kTcpm[i]))
      reject(tokens_[std::min(i, tokens_.size() - 1)].column,
             "only FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS is understood");
  }
  expect_end(8);
  set_tcp(true);
}

void HeidenhainReader::set_tcp(bool on) {
  refuse_beside_compensation("M128, M129 or TCPM");
  core_.set_tcp(on);
}

void HeidenhainReader::frame(bool begin) {
  if (!is(1, "PGM") || tokens_.size() != 4) incomplete();
  if (!is(3, "MM") && !is(3, "INCH")) reject(tokens_[3].column, "MM or INCH expected");
  if (begin) {
    if (begun_) reject(1, "BEGIN PGM a second time");
    begun_ = true;
    name_ = tokens_[2].text;
    unit_ = is(3, "MM") ? 1 : kMmPerInch;
    preset(1, 1);
    return;
  }
  refuse_inside_contour();
  if (!begun_ || tokens_[2].text != name_) reject(tokens_[2].column, "END PGM must name the program that began");
  path_.stop();
  if (core_.tcp()) core_.set_tcp(false);
  core_.say(ProgramStep::kEnd, 2);
  ended_ = true;
}

void HeidenhainReader::renew_offset() {
  AxisValues sum = preset_;
  for (std::size_t i = 0; i < 5; ++i) sum[i] += shift_[i];
  core_.set_offset(sum);
  core_.set_frame({plane_turn_, plane_turn_ * tilted_shift_}, core_.tilted());
}

void HeidenhainReader::tool() {
  if (is(1, "DEF")) return define_tool();
  if (!is(1, "CALL") || tokens_.size() < 3) incomplete();
  refuse_beside_compensation("TOOL CALL");
  std::size_t i = 2;
  int selected = tool_;
  if (tokens_[2].text[0] != 'S') {
    if (core_.tcp()) reject(tokens_[0].column, "M129 must come before TOOL CALL");
    const double n = number(tokens_[2].text, tokens_[2].column);
    if (n < 0 || n > 32767 || n != std::floor(n)) reject(tokens_[2].column, "tool numbers are whole and not negative");
    if (!is(3, "Z")) reject(tokens_[2].column, "TOOL CALL needs the tool axis Z");
    selected = static_cast<int>(n);
    i = 4;
  }
  double length = tool_length(selected, tokens_[2].column);
  radius_delta_mm_ = 0;
  for (; i < tokens_.size(); ++i) {
    const std::string_view text = tokens_[i].text;
    if (text[0] == 'S') {
      rpm_ = number(text.substr(1), tokens_[i].column);
      if (rpm_ < 0 || rpm_ > core_.machine.max_spindle_rpm)
        reject(tokens_[i].column, "spindle speed out of the machine's range");
    } else if (text[0] == 'F' && text != "FMAX") {
      feed_ = number(text.substr(1), tokens_[i].column) * unit_;
      if (!(feed_ > 0)) reject(tokens_[i].column, "the feed must be above 0");
    } else if (text.starts_with("DL") || (text.starts_with("DR") && !text.starts_with("DR2"))) {
      (text[1] == 'L' ? length : radius_delta_mm_) += number(text.substr(2), tokens_[i].column) * unit_;
    } else {
      reject(tokens_[i].column, "'" + std::string(text) + "' is not understood here");
    }
  }
  if (tokens_[2].text[0] != 'S') {
    tool_ = selected;
    core_.say(ProgramStep::kChangeTool, tool_);
    core_.set_length(length);
    spindle_ = 5;
  } else if (spindle_ != 5) {
    core_.say(ProgramStep::kSpindle, spindle_, rpm_);
  }
}

/// TOOL DEF 5 L+10 R+5 measures a tool; without L and R it has the magazine look for it.
void HeidenhainReader::define_tool() {
  if (tokens_.size() < 3) incomplete();
  const double n = number(tokens_[2].text, tokens_[2].column);
  if (n < 0 || n > 32767 || n != std::floor(n)) reject(tokens_[2].column, "tool numbers are whole and not negative");
  if (tokens_.size() == 3) return;
  DefinedTool tool;
  for (std::size_t i = 3; i < tokens_.size(); ++i) {
    const Token& token = tokens_[i];
    if (token.text[0] != 'L' && token.text[0] != 'R') expect_end(i);
    (token.text[0] == 'L' ? tool.length_mm : tool.radius_mm) = number(token.text.substr(1), token.column) * unit_;
  }
  defined_tools_[static_cast<int>(n)] = tool;
}

double HeidenhainReader::tool_length(int number, int column) const {
  const auto defined = defined_tools_.find(number);
  return defined != defined_tools_.end() ? defined->second.length_mm : core_.tool_length(number, column);
}

/// F and M words from `i` on; what takes effect at the block's start does so.
void HeidenhainReader::modes(std::size_t i) {
  fmax_ = machine_coordinates_ = tcp_off_ = false;
  block_seconds_ = 0;
  ends_.clear();
  bool tcp_on = false;
  for (; i < tokens_.size(); ++i) {
    const Token& token = tokens_[i];
    const std::string_view text = token.text;
    if (text == "R0" || text == "RL" || text == "RR") {
      side_ = text == "RL" ? 1 : text == "RR" ? -1 : 0;
      continue;
    }
    if (text == "FMAX" || (text == "F" && is(i + 1, "MAX"))) {  // with a blank on older controls
      if (text == "F") ++i;
      fmax_ = true;
      continue;
    }
    if (text.starts_with("FT")) {
      block_seconds_ = number(text.substr(2), token.column);
      if (!(block_seconds_ >= 0.001 && block_seconds_ <= 999.999)) reject(token.column, "FT takes 0.001 to 999.999 s");
      continue;
    }
    if (text[0] == 'F') {
      const double f = number(text.substr(1), token.column);
      if (f <= 0) reject(token.column, "the feed must be above 0");
      if (!tcp_on) feed_ = f * unit_;  // behind M128 it limits the compensating moves
      continue;
    }
    if (text[0] != 'M') expect_end(i);
    const double code = number(text.substr(1), token.column);
    if (code != std::floor(code) || code < 0 || code > 999) reject(token.column, "M codes are whole");
    switch (static_cast<int>(code)) {
      case 140:
        i = retract(i + 1);
        break;
      case 3:
      case 4:
      case 13:
      case 14:
        spindle_ = code == 3 || code == 13 ? 3 : 4;
        if (rpm_ == 0) reject(token.column, "no spindle speed");
        say(ProgramStep::kSpindle, spindle_, rpm_);
        if (code >= 13) say(ProgramStep::kCoolant, 8);
        break;
      case 7:
      case 8:
        say(ProgramStep::kCoolant, static_cast<int>(code));
        break;
      case 91:
        machine_coordinates_ = true;
        break;
      case 126:
        shortest_ = true;
        break;
      case 127:
        shortest_ = false;
        break;
      case 128:
        tcp_on = true;
        set_tcp(true);
        break;
      case 129:
        tcp_off_ = true;
        break;
      case 0:
      case 1:
      case 2:
      case 5:
      case 9:
      case 30:
      case 99:
        ends_.push_back(static_cast<int>(code));
        break;
      default:
        reject(token.column, "M" + std::string(text.substr(1)) + " is not understood");
    }
  }
  if (tcp_off_) set_tcp(false);
}

/// M140 MB MAX, M140 MB50 F500: back along the tool, to the end of the travel or so far; the next word's index is one
/// more.
std::size_t HeidenhainReader::retract(std::size_t i) {
  if (i >= tokens_.size() || !tokens_[i].text.starts_with("MB")) incomplete();
  const int column = tokens_[i].column;
  refuse_beside_compensation("M140");
  refuse_inside_contour();
  if (core_.tcp()) reject(column, "M140 under M128");
  std::string_view way = tokens_[i].text.substr(2);
  if (way.empty() && ++i >= tokens_.size()) incomplete();
  if (way.empty()) way = tokens_[i].text;
  const bool feeds = i + 1 < tokens_.size() && tokens_[i + 1].text[0] == 'F' && !is(i + 1, "FMAX");
  const double feed = feeds ? number(tokens_[i + 1].text.substr(1), tokens_[i + 1].column) * unit_ : 0;
  if (feeds && !(feed > 0)) reject(tokens_[i + 1].column, "the feed must be above 0");
  path_.forget_lead();
  if (way == "MAX") {
    if (core_.machine.has_rotary() && core_.machine.outer.on_head && core_.joints()[3] != 0)
      reject(column, "MB MAX with a leaning head");
    AxisValues top = core_.joints();
    top[2] = core_.machine.z.max_mm;
    core_.move_joints(top, !feeds, feeds ? std::abs(top[2] - core_.joints()[2]) * 60 / feed : 0);
  } else {
    AxisValues to = core_.here();
    to[2] += number(way, column) * unit_;
    core_.move(to, !feeds, feeds ? core_.seconds_at(to, feed) : 0);
  }
  return i + (feeds || is(i + 1, "FMAX") ? 1 : 0);
}

/// What takes effect at the block's end.
void HeidenhainReader::finish() {
  for (const int code : ends_) {
    if (code == 5) say(ProgramStep::kSpindle, spindle_ = 5);
    if (code == 9) say(ProgramStep::kCoolant, 9);
    if (code == 5 || code == 9) continue;
    refuse_inside_contour();
    if (code == 99) call_cycle();
    if (code == 0 || code == 1) {
      path_.flush();
      core_.say(ProgramStep::kPause, code);
    }
    if (code == 2 || code == 30) {
      path_.stop();
      core_.say(ProgramStep::kEnd, code);
      ended_ = true;
    }
  }
}

ReadResult read_heidenhain(std::string_view text, ReaderCore& core) {
  return HeidenhainReader(text, core, false).run();
}

}  // namespace lightmill::detail

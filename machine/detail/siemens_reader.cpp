// Siemens 840D: blocks, words and codes.
#include "machine/detail/siemens_reader.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kLongestBlock = 512;

constexpr Grammar::Operator kOperators[] = {{"==", 0, [](double a, double b) { return double(a == b); }},
                                            {"<>", 0, [](double a, double b) { return double(a != b); }},
                                            {">", 0, [](double a, double b) { return double(a > b); }},
                                            {"<", 0, [](double a, double b) { return double(a < b); }},
                                            {">=", 0, [](double a, double b) { return double(a >= b); }},
                                            {"<=", 0, [](double a, double b) { return double(a <= b); }},
                                            {"OR", 1, [](double a, double b) { return double(a != 0 || b != 0); }},
                                            {"XOR", 2, [](double a, double b) { return double((a != 0) != (b != 0)); }},
                                            {"AND", 3, [](double a, double b) { return double(a != 0 && b != 0); }},
                                            {"+", 4, [](double a, double b) { return a + b; }},
                                            {"-", 4, [](double a, double b) { return a - b; }},
                                            {"*", 5, [](double a, double b) { return a * b; }},
                                            {"/", 5, [](double a, double b) { return a / b; }},
                                            {"DIV", 5, [](double a, double b) { return std::trunc(a / b); }},
                                            {"MOD", 5, [](double a, double b) { return std::fmod(a, b); }}};

constexpr Grammar::Function kFunctions[] = {{"SIN", sine},
                                            {"COS", cosine},
                                            {"TAN", tangent},
                                            {"ASIN", arc_sine},
                                            {"ACOS", arc_cosine},
                                            {"SQRT", [](double x) { return std::sqrt(x); }},
                                            {"ABS", [](double x) { return std::abs(x); }},
                                            {"POT", [](double x) { return x * x; }},
                                            {"TRUNC", [](double x) { return std::trunc(x); }},
                                            {"ROUND", [](double x) { return std::round(x); }},
                                            {"LN", [](double x) { return std::log(x); }},
                                            {"EXP", [](double x) { return std::exp(x); }}};

constexpr Grammar::PairFunction kPairFunctions[] = {{"ATAN2", arc_tangent},
                                                    {"MINVAL", [](double a, double b) { return std::min(a, b); }},
                                                    {"MAXVAL", [](double a, double b) { return std::max(a, b); }}};

constexpr Grammar kSiemens{'(', ')', 6, kOperators, kFunctions, kPairFunctions, true};

void once(std::uint32_t& groups, int group, int where) {
  if ((groups >> group & 1U) != 0) reject(where, "two codes of one group in a block");
  groups |= 1U << group;
}

}  // namespace

SiemensReader::SiemensReader(std::string_view text, ReaderCore& core)
    : ExpressionReader(kSiemens), core_(core), path_(core, true), lines_(split_lines(text)) {
  core_.set_offset({});  // G500 until an offset is named
}

ReadResult SiemensReader::run() {
  ReadResult result = run_lines(
      core_, lines_.size(), ended_, "the file ends without M30, M17 or M2",
      [this](std::size_t at) {
        read_line(at);
        return next_;
      },
      [] {});
  return result;
}

void SiemensReader::read_line(std::size_t at) {
  at_ = at;
  next_ = at + 1;
  const std::string_view line = lines_[at];
  if (line.size() > kLongestBlock) reject(kLongestBlock + 1, "block too long");
  text_.assign(line);
  for (char& c : text_) {
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 32);
  }
  p_ = text_.data();
  end_ = p_ + text_.size();
  if (!take("/")) read_block();  // else the operator's switch is on
}

void SiemensReader::read_block() {
  skip_blanks();
  if (take("N") || take(":")) {
    double n = 0;
    if (!read_digits(p_, end_, n)) {
      if (p_[-1] == ':') reject(column(), "a block number is missing");
      --p_;  // a name
    } else {
      expect_word_end();
    }
    skip_blanks();
  }
  if (const std::string_view label = name(); label.size() > 1 && p_ + label.size() != end_ && p_[label.size()] == ':') {
    p_ += label.size() + 1;
    skip_blanks();
  }
  if (p_ == end_ || *p_ == ';' || statement()) return;
  Words words;
  std::uint32_t groups = 0;
  for (skip_blanks(); p_ != end_ && *p_ != ';'; skip_blanks()) read_word(words, groups);
  perform(words);
}

std::string_view SiemensReader::name() const {
  const char* p = p_;
  while (p != end_ && ((*p >= 'A' && *p <= 'Z') || *p == '_' || (p != p_ && *p >= '0' && *p <= '9'))) ++p;
  return {p_, static_cast<std::size_t>(p - p_)};
}

bool SiemensReader::take_name(std::string_view wanted) {
  if (name() != wanted) return false;
  p_ += wanted.size();
  return true;
}

bool SiemensReader::operand(double& v, int depth) {
  const int where = column();
  if (take_name("NOT")) {
    v = value(depth) == 0;
    return true;
  }
  if (take_name("TRUE") || take_name("FALSE")) {
    v = p_[-2] == 'U';
    return true;
  }
  if (*p_ == '$') {
    const bool machine = take("$AA_IM[");
    if (!machine && !take("$AA_IW[") && !take("$P_EP[")) reject(where, "this system variable is not known here");
    const int axis = p_ == end_ ? -1 : core_.axis_of(*p_);
    if (axis < 0) reject(column(), "an axis of this machine expected");
    ++p_;
    if (!take("]")) reject(column(), "']' is missing");
    if (path_.on()) reject(where, "the position is not known while cutter compensation is on");
    const double q = (machine ? core_.joints() : place())[static_cast<std::size_t>(axis)];
    v = q / (axis < 3 ? unit_ : kRadPerDegree);
    return true;
  }
  const Variable* const known = variable(depth);
  if (known != nullptr) v = known->value;
  return known != nullptr;
}

double SiemensReader::address_value() {
  if (take("=")) return expression();
  const bool negative = p_ != end_ && *p_ == '-';
  if (p_ != end_ && (*p_ == '-' || *p_ == '+')) ++p_;
  double v = 0;
  if (!read_digits(p_, end_, v)) reject(column(), "bad number format");
  return negative ? -v : v;
}

void SiemensReader::pass_corners(bool exact_stop, double tolerance_mm) {
  core_.exact_stop = exact_stop;
  core_.corner_tolerance_mm = tolerance_mm;
}

void SiemensReader::read_word(Words& w, std::uint32_t& groups) {
  const int where = column();
  const std::string_view word = name();
  if (word.empty()) reject(where, "a word must begin with a letter");
  const bool address = word.size() == 1 || (word[1] >= '0' && word[1] <= '9');
  if (address && word.size() == 2 && word[1] == '3' && p_ + 2 != end_ && p_[2] == '=' && word[0] <= 'C') {
    p_ += 2;
    std::optional<double>& part = w.direction[static_cast<std::size_t>(word[0] - 'A')];
    if (part) reject(where, "a word repeated");
    part = address_value();
    return expect_word_end();
  }
  if (!address) {
    if (!read_keyword(word, where, w)) reject(where, std::string(word) + " is not known to this control");
    return;
  }
  const char letter = *p_++;
  if (const int axis = core_.axis_of(letter); axis >= 0)
    return read_axis(w.axes[static_cast<std::size_t>(axis)], axis >= 3, where);
  if (letter >= 'I' && letter <= 'K') return read_axis(w.centre[static_cast<std::size_t>(letter - 'I')], false, where);
  const double v = address_value();
  expect_word_end();
  read_address(letter, v, where, w, groups);
}

bool SiemensReader::read_keyword(std::string_view word, int where, Words& w) {
  p_ += word.size();
  const std::pair<std::string_view, std::optional<double>&> kNumbers[] = {
      {"CR", w.radius}, {"TURN", w.turns}, {"RND", w.rounding}, {"CHF", w.chamfer}, {"CHR", w.side}};
  for (const auto& [name, v] : kNumbers) {
    if (word != name) continue;
    if (v || p_ == end_ || *p_ != '=') reject(where, std::string(word) + " stands once in a block, with =");
    v = address_value();
    expect_word_end();
    return true;
  }
  if (word == "MSG" || word == "CYCLE832" || word == "WORKPIECE") {  // WORKPIECE: the blank
    if (!take("(")) reject(column(), "'(' is missing");
    const char* const begin = p_;
    while (p_ != end_ && *p_ != ')') ++p_;
    if (word == "CYCLE832") {
      double tolerance = 0;
      const char* at = begin;
      pass_corners(false, read_digits(at, p_, tolerance) && tolerance > 0 ? tolerance * unit_ : -1);
    }
    if (!take(")")) reject(where, "')' is missing");
    return true;
  }
  // How fast and how smoothly, which is the control's affair.
  constexpr std::string_view kWithoutEffect[] = {"STOPRE", "SOFT", "BRISK", "FFWON", "FFWOF"};
  if (std::find(std::begin(kWithoutEffect), std::end(kWithoutEffect), word) == std::end(kWithoutEffect)) {
    if (word == "SUPA")
      w.suppress = true;
    else if (word == "TRAORI" || word == "TRAFOOF")
      w.tcp = word == "TRAORI";
    else if (word == "ORIWKS" || word == "ORIMKS")
      machine_directions_ = word == "ORIMKS";
    else if (word == "ORIAXES")
      turning_ = Turning::kAxes;
    else if (word == "ORIVECT" || word == "ORIPLANE")
      turning_ = Turning::kGreatCircle;
    else
      return false;
  }
  expect_word_end();
  return true;
}

void SiemensReader::read_address(char letter, double v, int where, Words& w, std::uint32_t& groups) {
  switch (letter) {
    case 'G':
      return g_code(w, v, where, groups);
    case 'M':
      return m_code(w, v, where, groups);
    case 'F':
      w.f = v;
      return once(groups, 20, where);
    case 'S':
      w.s = v;
      return once(groups, 21, where);
    case 'T':
    case 'D':
      if (v < 0 || v > 32767 || v != std::floor(v)) reject(where, "T and D are whole numbers");
      (letter == 'T' ? w.tool : w.d) = static_cast<int>(v);
      return once(groups, letter == 'T' ? 22 : 23, where);
    default:
      reject(where, std::string("word ") + letter + " is not known to this machine");
  }
}

// X1.5, X=R1*2, C=DC(30), C=AC(30), X=IC(2), C=ACP(10)
void SiemensReader::read_axis(AxisWord& word, bool rotary, int where) {
  if (word.named) reject(where, "axis named twice");
  word.named = true;
  if (p_ != end_ && *p_ == '=') {
    ++p_;
    static constexpr std::pair<std::string_view, How> kHows[] = {{"DC(", How::kShortest},
                                                                 {"ACP(", How::kUpwards},
                                                                 {"ACN(", How::kDownwards},
                                                                 {"AC(", How::kAbsolute},
                                                                 {"IC(", How::kIncremental}};
    for (const auto& [text, how] : kHows) {
      if (!take(text)) continue;
      word.how = how;
      break;
    }
    word.value = expression();
    if (word.how != How::kModal && !take(")")) reject(column(), "')' is missing");
    const bool turns = word.how == How::kShortest || word.how == How::kUpwards || word.how == How::kDownwards;
    if (turns && (!rotary || !(word.value >= 0 && word.value < 360)))
      reject(where, "DC, ACP and ACN take an angle from 0 to below 360 of a rotary axis");
  } else {
    word.value = address_value();
  }
  expect_word_end();
}

void SiemensReader::g_code(Words& w, double v, int where, std::uint32_t& groups) {
  const int code = v == std::floor(v) && v >= 0 && v <= 999 ? static_cast<int>(v) : -1;
  switch (code) {
    case 0:
    case 1:
    case 2:
    case 3:
      w.motion = code;
      return once(groups, 1, where);
    case 4:
      w.dwell = true;
      return once(groups, 2, where);
    case 17:
    case 18:
    case 19:
      if (path_.on() && plane_ != code - 17) reject(where, "a change of plane while cutter compensation is on");
      plane_ = code - 17;
      return once(groups, 6, where);
    case 40:
    case 41:
    case 42:
      w.compensation = code;
      return once(groups, 7, where);
    case 53:
    case 153:
      w.suppress = true;
      return once(groups, 9, where);
    case 54:
    case 55:
    case 56:
    case 57:
      w.offset = code - 53;
      return once(groups, 8, where);
    case 500:
      w.offset = 0;
      return once(groups, 8, where);
    case 505:
    case 506:
      w.offset = code - 500;
      return once(groups, 8, where);
    case 60:
    case 64:
      pass_corners(code == 60, code == 60 ? 0 : -1);
      return once(groups, 10, where);
    case 601:
    case 602:
      return once(groups, 12, where);  // how exact G60 is: the control's affair
    case 642:
      pass_corners(false, -1);
      return once(groups, 10, where);
    case 70:
    case 71:
    case 700:
    case 710:
      unit_ = code == 70 || code == 700 ? kMmPerInch : 1;
      return once(groups, 13, where);
    case 90:
    case 91:
      incremental_ = code == 91;
      return once(groups, 14, where);
    case 93:
    case 94:
    case 95:
      feed_.set_mode(code);
      return once(groups, 15, where);
    default:
      reject(where, code < 0 ? "unknown code" : "G" + std::to_string(code) + " is not known to this control");
  }
}

void SiemensReader::m_code(Words& w, double v, int where, std::uint32_t& groups) {
  const int code = v == std::floor(v) && v >= 0 && v < 1000 ? static_cast<int>(v) : -1;
  switch (code) {
    case 3:
    case 4:
    case 5:
      w.spindle = code;
      return once(groups, 16, where);
    case 7:
    case 8:
    case 9:
      w.coolant = code;
      return once(groups, 17, where);
    case 6:
      w.change = true;
      return once(groups, 18, where);
    case 0:
    case 1:
    case 2:
    case 17:
    case 30:
      w.stop = code;
      return once(groups, 19, where);
    default:
      reject(where, "this M code is not known to this control");
  }
}

void SiemensReader::change_tool(const Words& w) {
  if (w.tool >= 0) {
    static_cast<void>(core_.tool_length(w.tool, 1));  // refuses an unknown tool
    selected_ = w.tool;
  }
  if (w.change) {
    if (core_.tcp()) reject(1, "TRAFOOF must come before a tool change");
    if (path_.on()) reject(1, "a tool change while cutter compensation is on");
    tool_ = selected_;
    spindle_ = 5;
    core_.say(ProgramStep::kChangeTool, tool_);
    core_.set_length(core_.tool_length(tool_, 1));  // D1 comes with the tool
  }
}

void SiemensReader::perform(Words& w) {
  const bool only_path = w.d < 0 && w.tool < 0 && w.tcp < 0 && w.offset < 0 && w.spindle < 0 && w.coolant < 0 &&
                         w.stop < 0 && w.compensation < 0 && !w.s && !w.suppress && !w.dwell && !w.change;
  if (!only_path) refuse_inside_contour();
  if (w.dwell) {
    if (!w.f || *w.f < 0) reject(1, "G4 needs its seconds in F");
    path_.say(ProgramStep::kDwell, 0, *w.f);
    w.f.reset();
  }
  if (w.f) {
    if (*w.f <= 0) reject(1, "the feed must be above 0");
    feed_.value = feed_.inverse_time() ? *w.f : *w.f * unit_;
  }
  if (w.s) {
    rpm_ = *w.s;
    if (!(rpm_ >= 0 && rpm_ <= core_.machine.max_spindle_rpm)) reject(1, "spindle speed out of the machine's range");
    if (spindle_ != 5 && w.spindle < 0) w.spindle = spindle_;
  }
  change_tool(w);
  if (w.spindle >= 0) {
    if (w.spindle != 5 && rpm_ == 0) reject(1, "no spindle speed");
    spindle_ = w.spindle;
    path_.say(ProgramStep::kSpindle, spindle_, spindle_ == 5 ? 0 : rpm_);
  }
  if (w.coolant >= 0) path_.say(ProgramStep::kCoolant, w.coolant);
  if (path_.on() && (w.d >= 0 || w.offset >= 0 || w.tcp >= 0 || w.suppress))
    reject(1, "D, an offset, a transformation or SUPA while cutter compensation is on");
  if (w.d >= 0) {
    if (w.d > 1) reject(1, "cutting edges D0 and D1 are known");
    core_.set_length(w.d == 0 ? 0 : core_.tool_length(tool_, 1));
  }
  if (w.offset >= 0)
    core_.set_offset(w.offset == 0 ? AxisValues{} : core_.setup.offsets[static_cast<std::size_t>(w.offset) - 1]);
  if (w.tcp >= 0) core_.set_tcp(w.tcp == 1);
  if (w.compensation >= 0) set_compensation(w.compensation);
  if (w.motion >= 0) motion_ = w.motion;
  const auto named = [](const AxisWord& a) { return a.named; };
  const bool directed = w.direction[0] || w.direction[1] || w.direction[2];
  const bool round = motion_ >= 2 && std::any_of(w.centre.begin(), w.centre.end(), named);  // a full circle
  if (std::any_of(w.axes.begin(), w.axes.end(), named) || directed || round)
    move(w, w.f.has_value());
  else if (std::any_of(w.centre.begin(), w.centre.end(), named) || w.radius || w.turns)
    reject(1, "words of an arc without one");
  const auto in_plane = [&](int i) { return w.axes[static_cast<std::size_t>(kPlanes[plane_][i])].named; };
  if (modal_cycle_ && (in_plane(0) || in_plane(1))) {
    if (path_.on() || w.suppress) reject(1, "cutter compensation or SUPA while MCALL is on");
    drill(*modal_cycle_);
  }
  if (w.stop == 0 || w.stop == 1) {
    path_.flush();
    core_.say(ProgramStep::kPause, w.stop);
  }
  if (w.stop >= 2) leave_program(w.stop);
}

ReadResult read_siemens(std::string_view text, ReaderCore& core) {
  return SiemensReader(text, core).run();
}

}  // namespace lightmill::detail

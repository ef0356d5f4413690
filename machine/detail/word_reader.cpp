// RS274/NGC as LinuxCNC reads it, and Fanuc's blocks: lines, words, codes and their modal groups.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

namespace {
constexpr std::uint32_t kDirectionLetters = bit('I') | bit('J') | bit('K');
}

WordReader::WordReader(std::string_view text, bool fanuc, ReaderCore& core)
    : ExpressionReader(word_grammar(fanuc)),
      fanuc_(fanuc),
      core_(core),
      lines_(split_lines(text)),
      path_(core, fanuc) {
  for (const char letter : {'X', 'Y', 'Z', 'A', 'B', 'C'}) {
    if (core.axis_of(letter) >= 0) axis_letters_ |= bit(letter);
  }
  core_.set_offset(core_.setup.offsets[0]);
  std::copy(core_.setup.offsets.begin(), core_.setup.offsets.end(), offsets_.begin());
  to_r_level_ = !fanuc;  // LinuxCNC starts in G99, as its rs274 shows
}

ReadResult WordReader::run() {
  ReadResult result;
  try {
    while (at_ < lines_.size() && !ended_) {
      core_.line = static_cast<long>(at_) + 1;
      if ((result.blocks = ++core_.blocks) > core_.setup.most_blocks) reject(1, "the program does not end");
      next_ = at_ + 1;
      read_block(lines_[at_]);
      at_ = next_;
    }
    path_.flush();
    if (!ended_) {
      core_.line = static_cast<long>(lines_.size());
      if (percents_ < 2) reject(1, "the file ends without M2, M30 or a closing %");
      ended_ = true;
    }
  } catch (const ReaderError& e) {
    result.error = ProgramError{core_.line, e.column, e.rule};
  }
  result.ended = ended_;
  return result;
}

void WordReader::prepare(std::string_view line) {
  text_.clear();
  columns_.clear();
  if (line.size() > 255) reject(256, "line longer than 255 characters");
  bool comment = false;
  int start = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    char c = line[i];
    if (comment) {
      if (c == '(') reject(static_cast<int>(i) + 1, "a comment inside a comment");
      comment = c != ')';
      continue;
    }
    if (c == '(') {
      comment = true;
      start = static_cast<int>(i) + 1;
      continue;
    }
    if (c == ';') {
      if (fanuc_) continue;
      break;
    }
    if (c == ' ' || c == '\t') continue;
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 32);
    text_.push_back(c);
    columns_.push_back(static_cast<int>(i) + 1);
  }
  if (comment) reject(start, "a comment that does not end");
  p_ = text_.data();
  end_ = p_ + text_.size();
}

void WordReader::read_block(std::string_view line) {
  prepare(line);
  if (p_ == end_) return;
  if (*p_ == '%') {
    if (end_ - p_ > 1) reject(column() + 1, "% stands alone on its line");
    if (++percents_ == 2) next_ = lines_.size();
    return;
  }
  if (*p_ == '/') return;  // the operator's switch is on
  if (*p_ == 'N') {
    ++p_;
    double n = 0;
    if (!read_digits(p_, end_, n)) reject(column(), "a block number is missing");
  }
  if (p_ != end_ && *p_ == 'O') {
    if (!fanuc_) return flow();
    ++p_;
    double n = 0;
    if (!read_digits(p_, end_, n) || p_ != end_) reject(column(), "a program number stands alone on its line");
    return;
  }
  if (fanuc_ && p_ != end_ && statement()) return;
  words_ = 0;
  reads_arguments_ = false;
  polar_radius_.reset();
  polar_angle_.reset();
  settings_.clear();
  codes_.clear();
  std::uint32_t groups = 0;
  while (p_ != end_ && !(fanuc_ && *p_ == '/')) read_word(groups);  // from / on the operator's switch
  perform();
  for (const auto& [key, v] : settings_) {  // after the block, as RS274 wants it
    if (key[0] != '<')
      numbers_[std::stoi(key)] = v;
    else
      (key[1] == '_' ? globals_ : locals_.back())[key.substr(1)] = v;
  }
}

void WordReader::read_word(std::uint32_t& groups) {
  const int where = column();
  if (*p_ == '#' && !fanuc_) {
    ++p_;
    std::string key;
    if (take("<"))
      key = "<" + name_end();
    else
      key = std::to_string(address(value(), where));
    if (const long n = key[0] == '<' ? 0 : std::stol(key); n >= 5161 && n < 5400)
      reject(where, "G10, G28.1, G30.1 and G92 set these parameters");
    if (!take("=")) reject(column(), "'=' is missing");
    settings_.emplace_back(key, value());
    return;
  }
  const char letter = *p_;
  if (!fanuc_ && (letter == '@' || letter == '^')) {
    ++p_;
    std::optional<double>& word = letter == '@' ? polar_radius_ : polar_angle_;
    if (word) reject(where, std::string("word ") + letter + " repeated");
    word = value();
    polar_column_ = where;
    return;
  }
  if (letter < 'A' || letter > 'Z') reject(where, "a word must begin with a letter");
  ++p_;
  if (reads_arguments_ && read_argument(letter, where)) return;
  point_ = true;
  const double v = value();
  if (std::isnan(v)) return;  // Fanuc: a word whose variable is empty counts for nothing
  if (letter == 'G' || letter == 'M') {
    const double rounded = std::round(v * 10);
    if (!(rounded >= 0 && rounded < 10000) || std::abs(v * 10 - rounded) > 1e-6) reject(where, "unknown code");
    const int tenths = static_cast<int>(rounded);
    const int group = letter == 'G' ? g_group(tenths) : m_group(tenths);
    if (group < 0) reject(where, letter + code_name(tenths) + why_refused(letter, tenths));
    const std::uint32_t mark = 1U << (letter == 'G' ? group : group + 16);  // M codes have groups of their own
    if ((groups & mark) != 0) reject(where, "two codes of one modal group in a block");
    groups |= mark;
    codes_.push_back({letter, tenths, group});
    reads_arguments_ = letter == 'G' && fanuc_ && (tenths == 650 || tenths == 660);
    if (reads_arguments_) {
      arguments_.clear();
      ijk_ = {};
    }
    return;
  }
  const bool axis = (axis_letters_ & bit(letter)) != 0;
  if (!axis && std::string_view("DEFHIJKLPQRST").find(letter) == std::string_view::npos) {
    reject(where, std::string("word ") + letter + " is not known to this machine");
  }
  if (fanuc_ && axis && !point_ && v != 0) reject(where, "a coordinate needs a decimal point");
  if ((words_ & bit(letter)) != 0) reject(where, std::string("word ") + letter + " repeated");
  words_ |= bit(letter);
  values_[index_of(letter)] = v;
  word_columns_[index_of(letter)] = where;
}

bool WordReader::set_feed(int feed_mode, double unit) {
  if (feed_mode >= 0) feed_.set_mode(feed_mode);
  if (!has('F')) return false;
  const double f = use('F');
  if (f < 0) reject(column_of('F'), "negative feed");
  feed_.value = feed_.inverse_time() ? f : f * unit;
  return true;
}

void WordReader::set_speed_and_tool(Request& request) {
  if (has('S')) {
    rpm_ = use('S');
    if (rpm_ < 0 || rpm_ > core_.machine.max_spindle_rpm)
      reject(column_of('S'), "spindle speed out of the machine's range");
    if (spindle_ != 5 && request.spindle < 0) request.spindle = spindle_;
  }
  if (has('T')) {
    const double t = use('T');
    if (t < 0 || t > 99999 || t != std::floor(t)) reject(column_of('T'), "tool numbers are whole and not negative");
    selected_ = static_cast<int>(t);
    static_cast<void>(core_.tool_length(selected_, column_of('T')));  // refuses an unknown tool
  }
  if (request.change) {
    tool_ = selected_;
    spindle_ = 5;
    if (!fanuc_) path_.forget_lead();  // LinuxCNC asks the machine where it stands
    core_.say(ProgramStep::kChangeTool, tool_);
  }
  if (request.spindle >= 0) {
    spindle_ = request.spindle;
    path_.say(ProgramStep::kSpindle, spindle_, spindle_ == 5 ? 0 : rpm_);
  }
}

void WordReader::dwell() {
  const char letter = fanuc_ && has('X') && !has('P') ? 'X' : 'P';
  const double time = need(letter, "G4");
  if (time < 0) reject(column_of(letter), "negative time");
  path_.say(ProgramStep::kDwell, 0, fanuc_ && letter == 'P' ? time / 1000 : time);
}

/// What LinuxCNC does not take while cutter compensation is on.
void WordReader::refuse_beside_compensation(const Code& code) {
  if (!path_.on()) return;
  const bool refused =
      code.letter == 'G'
          ? code.group == 8 || code.group == 9 || code.group == 10 || code.group == 12 || code.group == 13 ||
                (code.group == 0 && code.tenths > 40 && code.tenths != 100 && code.tenths < 921) ||
                (code.group == 2 && code.tenths / 10 - 17 != plane_)
          : code.group == 6 || code.group == 9 || code.group == 10 || (code.group == 5 && code.tenths < 700);
  if (refused) reject(1, std::string(1, code.letter) + code_name(code.tenths) + " while cutter compensation is on");
}

void WordReader::perform() {
  Request request;
  const double unit = unit_;
  for (const Code& code : codes_) {
    refuse_beside_compensation(code);
    if (code.letter == 'G')
      take_g(code, request);
    else
      take_m(code.tenths / 10, request);
  }
  refuse_in_tilted_plane(request);
  const bool feed_here = set_feed(request.feed_mode, fanuc_ ? unit_ : unit /* LinuxCNC takes F before G20 and G21 */);
  set_speed_and_tool(request);
  if (request.signal >= 0) signal(request.signal);
  if (request.coolant >= 0) path_.say(ProgramStep::kCoolant, request.coolant);
  if (request.shot == 40) dwell();
  if (request.shot == 51) {
    const double q = need('Q', "G5.1");
    if (q != 0 && q != 1) reject(column_of('Q'), "G5.1 takes Q0 or Q1");
    if (has('R')) use('R');
  }
  if (request.offset >= 0) {
    offset_ = static_cast<std::size_t>(request.offset);
    renew_offset();
  }
  if (request.compensation >= 0) set_compensation(request.compensation);
  bool axes_taken = request.length >= 0 && set_length(request.length);
  if (request.tcp >= 0) core_.set_tcp(request.tcp == 1);
  if (request.plane >= 0) take_plane(request.plane);
  if (request.shot == 531) turn_to_plane();
  axes_taken |= shift(request.shot);

  bool moved = false;
  const bool other = request.motion >= 0 && request.motion != motion_;
  if (motion_ == 52 && other && request.motion != 53) reject(1, "only G5.2 may stand between G5.2 and G5.3");
  if (request.motion == 53) {
    end_spline(motion_ == 52);
    request.motion = motion_ = -1;
  }
  if (request.motion >= 0) motion_ = request.motion;
  if (motion_ == 800) last_cycle_ = -1;
  const bool axes = (words_ & axis_letters_) != 0 || polar() || (directions_ && (words_ & kDirectionLetters) != 0);
  if (motion_ == 52) {
    if (axes || request.motion == 52) add_control_point(other, feed_here);
  } else if (request.motion == 800) {
    if (axes) reject(1, "axis words while motion is cancelled");
  } else if (axes || request.motion >= 20) {
    if (axes_taken) reject(1, "two codes want the axis words");
    move(request.shot == 530, feed_here);
    moved = true;
  }
  if (request.macro >= 0) take_macro_call(request.macro);
  if (request.keep >= 0) keep_modes(request.keep);
  if ((words_ & ~bit('N')) != 0 && request.stop < 98) {
    for (char c = 'A'; c <= 'Z'; ++c) {
      if (has(c)) reject(column_of(c), std::string("word ") + c + " has no use in this block");
    }
  }
  stop(request.stop);
  if (moved && request.stop < 98) call_modal();
}

void WordReader::stop(int code) {
  if (code == 2 || code == 30)
    path_.stop();
  else if (code == 0 || code == 1 || code == 60)
    path_.flush();
  switch (code) {
    case 0:
    case 1:
    case 60:
      return core_.say(ProgramStep::kPause, code);
    case 2:
    case 30:
      ended_ = true;
      return core_.say(ProgramStep::kEnd, code);
    case 98:
      return call_subprogram();
    case 99:
      return leave_program();
    default:
      return;
  }
}

ReadResult read_word_program(std::string_view text, bool fanuc, ReaderCore& core) {
  return WordReader(text, fanuc, core).run();
}

}  // namespace lightmill::detail

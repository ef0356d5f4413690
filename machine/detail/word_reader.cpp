// RS274/NGC as LinuxCNC reads it, and Fanuc's blocks, which share its words.
#include <bit>
#include <optional>
#include <tuple>
#include <unordered_map>

#include "machine/detail/reader_core.h"

namespace lightmill::detail {
namespace {

constexpr int kDeepestCall = 10;

std::size_t index_of(char letter) {
  return static_cast<std::size_t>(letter - 'A');
}
constexpr std::uint32_t bit(char letter) {
  return 1U << (letter - 'A');
}

class WordReader {
 public:
  WordReader(std::string_view text, bool fanuc, ReaderCore& core)
      : fanuc_(fanuc), core_(core), lines_(split_lines(text)) {
    for (const char letter : {'X', 'Y', 'Z', 'A', 'B', 'C'}) {
      if (core.axis_of(letter) >= 0) axis_letters_ |= bit(letter);
    }
    core_.set_offset(core_.setup.offsets[0]);
    offsets_ = core_.setup.offsets;
    to_r_level_ = !fanuc;  // LinuxCNC starts in G99, as its rs274 shows
  }

  ReadResult run() {
    ReadResult result;
    try {
      while (at_ < lines_.size() && !ended_) {
        core_.line = static_cast<long>(at_) + 1;
        if (++result.blocks > core_.setup.most_blocks) reject(1, "the program does not end");
        std::size_t next = at_ + 1;
        next_ = next;
        read_block(lines_[at_]);
        at_ = next_;
      }
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

 private:
  // --- A line's text, without blanks and comments, in capitals ---
  void prepare(std::string_view line) {
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
  [[nodiscard]] int column() const {
    const auto i = static_cast<std::size_t>(p_ - text_.data());
    return columns_.empty() ? 1 : columns_[std::min(i, columns_.size() - 1)];
  }
  bool take(std::string_view word) {
    if (!std::string_view(p_, static_cast<std::size_t>(end_ - p_)).starts_with(word)) return false;
    p_ += word.size();
    return true;
  }

  // --- Values: numbers, parameters, functions, expressions ---
  double value(int depth = 0) {
    if (depth > 40) reject(column(), "expression nested too deeply");
    if (p_ == end_) reject(column(), "a value is missing");
    if (take("-")) return -value(depth + 1);
    if (take("+")) return value(depth + 1);
    double v = 0;
    if ((*p_ >= '0' && *p_ <= '9') || *p_ == '.') {
      if (!read_digits(p_, end_, v, &point_)) reject(column(), "bad number format");
      return v;
    }
    point_ = true;
    if (fanuc_) reject(column(), "a number is missing");
    if (*p_ == '[') return bracket(depth + 1);
    if (*p_ == '#') return parameter(depth + 1);
    struct Function {
      const char* name;
      double (*f)(double);
    };
    static const Function kFunctions[] = {{"ABS", [](double x) { return std::abs(x); }},
                                          {"ACOS", [](double x) { return std::acos(x) / kRadPerDegree; }},
                                          {"ASIN", [](double x) { return std::asin(x) / kRadPerDegree; }},
                                          {"COS", [](double x) { return std::cos(x * kRadPerDegree); }},
                                          {"EXP", [](double x) { return std::exp(x); }},
                                          {"FIX", [](double x) { return std::floor(x); }},
                                          {"FUP", [](double x) { return std::ceil(x); }},
                                          {"LN", [](double x) { return std::log(x); }},
                                          {"ROUND", [](double x) { return std::round(x); }},
                                          {"SIN", [](double x) { return std::sin(x * kRadPerDegree); }},
                                          {"SQRT", [](double x) { return std::sqrt(x); }},
                                          {"TAN", [](double x) { return std::tan(x * kRadPerDegree); }}};
    if (take("ATAN")) {
      const double y = bracket(depth + 1);
      if (!take("/")) reject(column(), "ATAN needs [y]/[x]");
      return std::atan2(y, bracket(depth + 1)) / kRadPerDegree;
    }
    if (take("EXISTS[#<")) {
      const std::string name = name_end();
      if (!take("]")) reject(column(), "']' is missing");
      return named(name) != nullptr ? 1 : 0;
    }
    for (const Function& function : kFunctions) {
      if (!take(function.name)) continue;
      v = function.f(bracket(depth + 1));
      if (!std::isfinite(v)) reject(column(), std::string(function.name) + " of a value out of its range");
      return v;
    }
    reject(column(), "bad number format");
  }
  std::string name_end() {
    const char* close = std::find(p_, end_, '>');
    if (close == end_) reject(column(), "'>' is missing");
    std::string name(p_, close);
    p_ = close + 1;
    return name;
  }
  double* named(const std::string& name) {
    auto& names = name.starts_with('_') ? globals_ : locals_.back();
    const auto found = names.find(name);
    return found == names.end() ? nullptr : &found->second;
  }
  double parameter(int depth) {
    ++p_;  // #
    const int where = column();
    if (take("<")) {
      const std::string name = name_end();
      if (const double* known = named(name)) return *known;
      static constexpr const char* kAxes[] = {"_X", "_Y", "_Z"};
      for (std::size_t i = 0; i < 3; ++i) {
        if (name == kAxes[i]) return core_.here()[i] / unit_;
      }
      if (name == "_METRIC") return unit_ == 1;
      if (name == "_IMPERIAL") return unit_ != 1;
      if (name == "_FEED") return feed_ / unit_;
      if (name == "_RPM") return rpm_;
      reject(where, "parameter #<" + name + "> was never set");
    }
    return numbered(address(value(depth), where));
  }
  static int address(double v, int where) {
    if (!(v >= 1 && v <= 5602) || v != std::floor(v)) reject(where, "parameter numbers are whole and from 1 to 5602");
    return static_cast<int>(v);
  }
  double numbered(int n) {
    if (n >= 5420 && n <= 5422) return core_.here()[static_cast<std::size_t>(n - 5420)] / unit_;
    if (n == 5400) return tool_;
    const auto found = numbers_.find(n);
    return found == numbers_.end() ? 0 : found->second;
  }
  double bracket(int depth) {
    if (!take("[")) reject(column(), "'[' is missing");
    const double v = level(0, depth);
    if (!take("]")) reject(column(), "']' is missing");
    return v;
  }
  /// Levels from loose to tight: logic, comparison, sum, product, power; all from left to right.
  double level(int strength, int depth) {
    if (depth > 40) reject(column(), "expression nested too deeply");
    if (strength == 5) return value(depth + 1);
    double a = level(strength + 1, depth);
    for (;;) {
      const int where = column();
      const auto b = [&] { return level(strength + 1, depth); };
      if (strength == 0 && take("AND")) {
        const double r = b();
        a = a != 0 && r != 0;
      } else if (strength == 0 && take("XOR")) {
        const double r = b();
        a = (a != 0) != (r != 0);
      } else if (strength == 0 && take("OR")) {
        const double r = b();
        a = a != 0 || r != 0;
      } else if (strength == 1 && take("EQ"))
        a = a == b();
      else if (strength == 1 && take("NE"))
        a = a != b();
      else if (strength == 1 && take("GT"))
        a = a > b();
      else if (strength == 1 && take("GE"))
        a = a >= b();
      else if (strength == 1 && take("LT"))
        a = a < b();
      else if (strength == 1 && take("LE"))
        a = a <= b();
      else if (strength == 2 && take("+"))
        a += b();
      else if (strength == 2 && take("-"))
        a -= b();
      else if (strength == 3 && take("MOD")) {
        const double d = b();
        a = std::fmod(a, d);
        if (a < 0) a += std::abs(d);
      } else if (strength == 3 && take("/"))
        a /= b();
      else if (strength == 3 && !(end_ - p_ > 1 && p_[1] == '*') && take("*"))
        a *= b();
      else if (strength == 4 && take("**"))
        a = std::pow(a, b());
      else
        return a;
      if (!std::isfinite(a)) reject(where, "the result is no number");
    }
  }

  // --- O-words: sub, endsub, return, call, if, elseif, else, endif, while, endwhile, do, repeat, endrepeat ---
  struct Frame {
    std::size_t back;
    std::unordered_map<int, double> saved;
    std::size_t loops;
  };
  /// What M70 keeps.
  struct Modes {
    double unit, feed, rpm;
    bool incremental, centre_absolute, inverse_time, to_r_level;
    int plane, spindle;
    std::size_t offset;
  };
  struct Loop {
    std::string label;
    std::size_t line;
    double left;
    bool repeats;
  };

  /// O<name> or O<number> at the line's start; the label, and the cursor behind it.
  std::string label() {
    if (take("<")) return name_end();
    const double v = value();
    return std::to_string(static_cast<long>(std::clamp(v, -1e9, 1e9)));
  }
  /// The next line from `from` on with this label and one of the words; the line's number.
  std::size_t find(std::size_t from, const std::string& wanted, std::initializer_list<std::string_view> words,
                   std::string_view* found = nullptr) {
    const int where = column();
    const std::string text = text_;
    const std::vector<int> columns = columns_;
    const auto offset = p_ - text_.data();
    for (std::size_t i = from; i < lines_.size(); ++i) {
      const std::size_t first = lines_[i].find_first_not_of(" \t");
      if (first == std::string_view::npos || (lines_[i][first] | 32) != 'o') continue;
      prepare(lines_[i]);
      ++p_;
      if (p_ != end_ && (*p_ == '#' || *p_ == '[')) continue;
      if (label() != wanted) continue;
      for (const std::string_view word : words) {
        if (!take(word)) continue;
        if (found != nullptr) *found = word;
        const std::size_t line = i;
        if (word != "ELSEIF") {  // whose condition is read next
          text_ = text;
          columns_ = columns;
          p_ = text_.data() + offset;
          end_ = text_.data() + text_.size();
        }
        return line;
      }
    }
    reject(where, "o<" + wanted + "> has no end");
  }
  void leave_sub() {
    Frame& frame = frames_.back();
    for (int n = 1; n <= 30; ++n) numbers_.erase(n);
    for (const auto& [n, v] : frame.saved) numbers_[n] = v;
    next_ = frame.back;
    loops_.resize(frame.loops);
    if (saved_.back() && restores_.back()) restore();
    saved_.pop_back();
    restores_.pop_back();
    frames_.pop_back();
    locals_.pop_back();
  }
  void enter_sub(Frame frame) {
    frames_.push_back(std::move(frame));
    locals_.emplace_back();
    saved_.emplace_back();
    restores_.push_back(false);
  }

  /// M70 to M73: each level of call has its own memory.
  void keep_modes(int code) {
    if (code == 70 || code == 73) {
      saved_.back() = Modes{unit_,         feed_,       rpm_,   incremental_, centre_absolute_,
                            inverse_time_, to_r_level_, plane_, spindle_,     offset_};
      restores_.back() = code == 73;
      if (code == 73 && frames_.empty()) reject(1, "M73 outside of a subprogram");
      return;
    }
    if (!saved_.back()) reject(1, "M" + std::to_string(code) + " without modes that M70 has kept");
    if (code == 72) restore();
    if (code == 71) saved_.back().reset();
  }
  void restore() {
    const Modes& kept = *saved_.back();
    unit_ = kept.unit;
    feed_ = kept.feed;
    incremental_ = kept.incremental;
    centre_absolute_ = kept.centre_absolute;
    inverse_time_ = kept.inverse_time;
    to_r_level_ = kept.to_r_level;
    plane_ = kept.plane;
    if (offset_ != kept.offset) {
      offset_ = kept.offset;
      renew_offset();
    }
    if (spindle_ != kept.spindle || (spindle_ != 5 && rpm_ != kept.rpm)) {
      core_.say(ProgramStep::kSpindle, kept.spindle, kept.spindle == 5 ? 0 : kept.rpm);
    }
    spindle_ = kept.spindle;
    rpm_ = kept.rpm;
  }

  /// Out of the loop of this name, or to its end for the next round.
  void leave_loop(const std::string& name, int where, bool again) {
    while (!loops_.empty() && loops_.back().label != name &&
           loops_.size() > (frames_.empty() ? 0 : frames_.back().loops)) {
      loops_.pop_back();  // loops inside
    }
    const bool counted = !loops_.empty() && loops_.back().label == name;
    if (!counted && whiles_.find(name) == whiles_.end()) reject(where, "break or continue outside of its loop");
    const std::size_t end = find(next_, name, {"ENDWHILE", "ENDREPEAT", "WHILE"});
    next_ = again ? end : end + 1;
    if (!again && counted) loops_.pop_back();
  }
  void flow() {
    ++p_;  // O
    const int where = column();
    const std::string name = label();
    if (take("SUB")) {
      next_ = find(next_, name, {"ENDSUB"}) + 1;
    } else if (take("ENDSUB") || take("RETURN")) {
      if (frames_.empty()) reject(where, "return outside of a subprogram");
      if (p_ != end_) globals_["_VALUE"] = bracket(0);
      leave_sub();
    } else if (take("CALL")) {
      if (frames_.size() >= kDeepestCall) reject(where, "subprograms nested too deeply");
      std::vector<double> arguments;
      while (p_ != end_ && *p_ == '[' && arguments.size() < 30) arguments.push_back(bracket(0));
      auto sub = subs_.find(name);
      if (sub == subs_.end()) sub = subs_.emplace(name, find(0, name, {"SUB"})).first;
      Frame frame{next_, {}, loops_.size()};
      for (int n = 1; n <= 30; ++n) {
        if (const auto old = numbers_.find(n); old != numbers_.end()) frame.saved[n] = old->second;
        numbers_[n] = static_cast<std::size_t>(n) <= arguments.size() ? arguments[static_cast<std::size_t>(n) - 1] : 0;
      }
      enter_sub(std::move(frame));
      next_ = sub->second + 1;
    } else if (take("IF")) {
      bool go = bracket(0) != 0;
      std::size_t line = next_;
      while (!go) {
        std::string_view word;
        line = find(line, name, {"ELSEIF", "ELSE", "ENDIF"}, &word) + 1;
        next_ = line;
        go = word != "ELSEIF" || bracket(0) != 0;
        if (word != "ELSEIF") p_ = end_;
      }
      p_ = end_;
    } else if (take("ELSEIF") || take("ELSE")) {
      next_ = find(next_, name, {"ENDIF"}) + 1;
      p_ = end_;
    } else if (take("ENDIF")) {
    } else if (take("DO")) {
      loops_.push_back({name, next_, 0, false});
    } else if (take("WHILE")) {
      const bool again = bracket(0) != 0;
      if (!loops_.empty() && loops_.back().label == name && !loops_.back().repeats) {  // the end of a do
        if (again)
          next_ = loops_.back().line;
        else
          loops_.pop_back();
      } else if (!again) {
        next_ = find(next_, name, {"ENDWHILE"}) + 1;
      } else {
        whiles_[name] = at_;
      }
    } else if (take("ENDWHILE")) {
      const auto start = whiles_.find(name);
      if (start == whiles_.end()) reject(where, "endwhile without while");
      next_ = start->second;
    } else if (take("REPEAT")) {
      const double count = bracket(0);
      if (count < 1)
        next_ = find(next_, name, {"ENDREPEAT"}) + 1;
      else
        loops_.push_back({name, next_, std::floor(count), true});
    } else if (take("ENDREPEAT")) {
      if (loops_.empty() || loops_.back().label != name) reject(where, "endrepeat without repeat");
      if ((loops_.back().left -= 1) >= 1)
        next_ = loops_.back().line;
      else
        loops_.pop_back();
    } else if (take("BREAK") || take("CONTINUE")) {
      leave_loop(name, where, p_[-1] == 'E');
    } else {
      reject(column(), "unknown word after the O number");
    }
    if (p_ != end_) reject(column(), "nothing may follow an O word's arguments");
  }

  // --- One block ---
  void read_block(std::string_view line) {
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
    words_ = 0;
    polar_radius_.reset();
    polar_angle_.reset();
    std::array<int, 16> g{}, m{};
    std::size_t gs = 0, ms = 0;
    std::uint32_t groups = 0;
    std::vector<std::pair<std::string, double>>& settings = settings_;
    settings.clear();
    while (p_ != end_) {
      const int where = column();
      if (*p_ == '#' && !fanuc_) {
        ++p_;
        std::string key;
        if (take("<"))
          key = "<" + name_end();
        else
          key = std::to_string(address(value(), where));
        if (!take("=")) reject(column(), "'=' is missing");
        settings.emplace_back(key, value());
        continue;
      }
      const char letter = *p_;
      if (!fanuc_ && (letter == '@' || letter == '^')) {
        ++p_;
        std::optional<double>& word = letter == '@' ? polar_radius_ : polar_angle_;
        if (word) reject(where, std::string("word ") + letter + " repeated");
        word = value();
        polar_column_ = where;
        continue;
      }
      if (letter < 'A' || letter > 'Z') reject(where, "a word must begin with a letter");
      ++p_;
      point_ = true;
      const double v = value();
      if (letter == 'G' || letter == 'M') {
        const double tenths = std::round(v * 10);
        if (!(tenths >= 0 && tenths < 10000) || std::abs(v * 10 - tenths) > 1e-6) reject(where, "unknown code");
        const int code = static_cast<int>(tenths);
        int group = letter == 'G' ? g_group(code) : m_group(code);
        if (group < 0) reject(where, std::string(1, letter) + compact_code(code) + " is not known to this control");
        if (letter == 'M') group += 16;  // groups of their own
        if ((groups >> group & 1U) != 0) reject(where, "two codes of one modal group in a block");
        groups |= 1U << group;
        (letter == 'G' ? g[gs++] : m[ms++]) = code;
        continue;
      }
      const bool axis = (axis_letters_ & bit(letter)) != 0;
      static constexpr std::string_view kLinuxCncLetters = "DFHIJKLPQRST", kFanucLetters = "DFHIJKLPQRST";
      if (!axis && (fanuc_ ? kFanucLetters : kLinuxCncLetters).find(letter) == std::string_view::npos) {
        reject(where, std::string("word ") + letter + " is not known to this machine");
      }
      if (fanuc_ && axis && !point_ && v != 0) reject(where, "a coordinate needs a decimal point");
      if ((words_ & bit(letter)) != 0) reject(where, std::string("word ") + letter + " repeated");
      words_ |= bit(letter);
      values_[index_of(letter)] = v;
      word_columns_[index_of(letter)] = where;
    }
    perform({g.data(), gs}, {m.data(), ms});
    for (const auto& [key, v] : settings) {  // after the block, as RS274 wants it
      if (key[0] != '<')
        numbers_[std::stoi(key)] = v;
      else
        (key[1] == '_' ? globals_ : locals_.back())[key.substr(1)] = v;
    }
  }

  static std::string compact_code(int tenths) {
    return std::to_string(tenths / 10) + (tenths % 10 != 0 ? "." + std::to_string(tenths % 10) : "");
  }
  [[nodiscard]] int g_group(int code) const {
    switch (code) {
      case 0:
      case 10:
      case 20:
      case 30:
      case 800:
      case 810:
      case 820:
      case 830:
        return 1;
      case 850:
      case 890:
        return 1;
      case 170:
      case 180:
      case 190:
        return 2;
      case 900:
      case 910:
        return 3;
      case 901:
      case 911:
        return fanuc_ ? -1 : 4;
      case 930:
      case 940:
        return 5;
      case 200:
      case 210:
        return 6;
      case 400:
        return 7;
      case 430:
      case 490:
        return 8;
      case 431:
        return fanuc_ ? -1 : 8;
      case 434:
        return fanuc_ ? 8 : -1;
      case 980:
      case 990:
        return 10;
      case 540:
      case 550:
      case 560:
      case 570:
      case 580:
      case 590:
        return 12;
      case 591:
      case 592:
      case 593:
        return fanuc_ ? -1 : 12;
      case 610:
      case 640:
        return 13;
      case 611:
        return fanuc_ ? -1 : 13;
      case 40:
      case 280:
      case 530:
        return 0;
      case 300:
      case 100:
      case 920:
      case 921:
      case 922:
      case 923:
        return fanuc_ ? -1 : 0;
      case 51:
        return fanuc_ ? 0 : -1;
      default:
        return -1;
    }
  }
  [[nodiscard]] int m_group(int code) const {
    if (code % 10 != 0) return -1;
    switch (code / 10) {
      case 0:
      case 1:
      case 2:
      case 30:
        return 4;
      case 60:
        return fanuc_ ? -1 : 4;
      case 3:
      case 4:
      case 5:
        return 7;
      case 6:
        return 6;
      case 7:
      case 8:
      case 9:
        return 8;
      case 48:
      case 49:
        return fanuc_ ? -1 : 9;
      case 70:
      case 71:
      case 72:
      case 73:
        return fanuc_ ? -1 : 5;
      case 428:
      case 429:
        return fanuc_ ? -1 : 10;  // the trunnion configurations' remaps
      case 98:
      case 99:
        return fanuc_ ? 4 : -1;
      default:
        return -1;
    }
  }
  [[nodiscard]] bool has(char letter) const { return (words_ & bit(letter)) != 0; }
  double use(char letter) {
    words_ &= ~bit(letter);
    return values_[index_of(letter)];
  }
  double need(char letter, const char* why) {
    if (!has(letter)) reject(1, std::string(why) + " needs " + letter);
    return use(letter);
  }
  [[nodiscard]] double scale(int axis) const { return axis < 3 ? unit_ : kRadPerDegree; }

  void perform(std::pair<const int*, std::size_t> gs, std::pair<const int*, std::size_t> ms) {
    int motion = -1, length = -1, shot = -1, offset = -1, feed_mode = -1, stop = -1, spindle = -1, coolant = -1,
        tcp = -1, keep = -1;
    bool change = false;
    for (std::size_t i = 0; i < gs.second; ++i) {
      const int code = gs.first[i];
      switch (g_group(code)) {
        case 1:
          motion = code / 10;
          break;
        case 2:
          plane_ = code / 10 - 17;
          break;
        case 3:
          incremental_ = code == 910;
          break;
        case 4:
          centre_absolute_ = code == 901;
          break;
        case 5:
          feed_mode = code / 10;
          break;
        case 6:
          unit_ = code == 200 ? kMmPerInch : 1;
          break;
        case 8:
          length = code;
          break;
        case 10:
          to_r_level_ = code == 990;
          break;
        case 12:
          offset = code >= 591 ? code - 591 + 6 : code / 10 - 54;
          break;
        case 13:
          core_.exact_stop = code == 611 || (fanuc_ && code == 610);
          core_.corner_tolerance_mm = fanuc_ ? -1 : code == 640 ? std::numeric_limits<double>::infinity() : 0;
          if (code == 640) {
            if (has('P')) core_.corner_tolerance_mm = unit_ * std::abs(use('P'));
            if (has('Q')) use('Q');
          }
          break;
        case 0:
          shot = code;
          break;
        default:
          break;
      }
    }
    for (std::size_t i = 0; i < ms.second; ++i) {
      const int code = ms.first[i] / 10;
      if (code <= 2 || code == 30 || code == 60 || code == 98 || code == 99)
        stop = code;
      else if (code <= 5)
        spindle = code;
      else if (code == 6)
        change = true;
      else if (code <= 9)
        coolant = code;
      else if (code >= 428)
        tcp = code == 428;
      else if (code >= 70 && code <= 73)
        keep = code;
    }
    if (feed_mode >= 0) {
      if ((feed_mode == 93) != inverse_time_) feed_ = 0;
      inverse_time_ = feed_mode == 93;
    }
    bool feed_here = false;
    if (has('F')) {
      const double f = use('F');
      if (f < 0) reject(word_columns_[index_of('F')], "negative feed");
      feed_ = inverse_time_ ? f : f * unit_;
      feed_here = true;
    }
    if (has('S')) {
      rpm_ = use('S');
      if (rpm_ < 0 || rpm_ > core_.machine.max_spindle_rpm)
        reject(word_columns_[index_of('S')], "spindle speed out of the machine's range");
      if (spindle_ != 5 && spindle < 0) spindle = spindle_;
    }
    if (has('T')) {
      const double t = use('T');
      if (t < 0 || t > 99999 || t != std::floor(t))
        reject(word_columns_[index_of('T')], "tool numbers are whole and not negative");
      selected_ = static_cast<int>(t);
      static_cast<void>(core_.tool_length(selected_, word_columns_[index_of('T')]));  // refuses an unknown tool
    }
    if (change) {
      tool_ = selected_;
      spindle_ = 5;
      core_.say(ProgramStep::kChangeTool, tool_);
    }
    if (spindle >= 0) {
      spindle_ = spindle;
      core_.say(ProgramStep::kSpindle, spindle, spindle == 5 ? 0 : rpm_);
    }
    if (coolant >= 0) core_.say(ProgramStep::kCoolant, coolant);
    if (shot == 40) {
      if (!has('P') && fanuc_ && has('X')) {
        const double x = use('X');
        if (x < 0) reject(word_columns_[index_of('X')], "negative time");
        core_.say(ProgramStep::kDwell, 0, x);
      } else {
        const double p = need('P', "G4");
        if (p < 0) reject(word_columns_[index_of('P')], "negative time");
        core_.say(ProgramStep::kDwell, 0, fanuc_ ? p / 1000 : p);
      }
    }
    if (shot == 51) {
      const double q = need('Q', "G5.1");
      if (q != 0 && q != 1) reject(word_columns_[index_of('Q')], "G5.1 takes Q0 or Q1");
      if (has('R')) use('R');
    }
    if (offset >= 0) {
      offset_ = static_cast<std::size_t>(offset);
      renew_offset();
    }
    bool axes_taken = false;
    if (length >= 0) {
      if (length == 490) {
        core_.set_tcp(false);
        core_.set_length(0);
      } else if (length == 431) {
        core_.set_length(need('Z', "G43.1") * unit_);
        axes_taken = true;
      } else {
        double h = tool_;
        if (has('H'))
          h = use('H');
        else if (fanuc_)
          reject(1, "G43 needs H");
        if (h != std::floor(h) || h < 0 || h > 99999) reject(word_columns_[index_of('H')], "H names a tool");
        core_.set_length(core_.tool_length(static_cast<int>(h), word_columns_[index_of('H')]));
        if (length == 434) core_.set_tcp(true);
      }
    }
    if (tcp >= 0) core_.set_tcp(tcp == 1);
    if (shot == 100) {
      set_data();
      axes_taken = true;
    } else if (shot == 280 || shot == 300) {
      reference();
      axes_taken = true;
    } else if (shot == 920) {
      for (const int axis : taken_axes()) shift_[axis] += core_.here()[axis] - target_value(axis);
      renew_offset();
      axes_taken = true;
    } else if (shot == 921 || shot == 922) {
      if (shot == 922) kept_shift_ = shift_;
      if (shot == 921) kept_shift_ = {};
      shift_ = {};
      renew_offset();
    } else if (shot == 923) {
      shift_ = kept_shift_;
      renew_offset();
    }
    if (motion >= 0) motion_ = motion;
    const bool axes = (words_ & axis_letters_) != 0 || polar();
    if (motion == 80) {
      if (axes) reject(1, "axis words while motion is cancelled");
    } else if (axes || (motion >= 0 && motion >= 2)) {
      if (axes_taken) reject(1, "two codes want the axis words");
      move(shot == 530, feed_here);
    }
    if (keep >= 0) keep_modes(keep);
    if ((words_ & ~bit('N')) != 0 && !(fanuc_ && stop == 98)) {
      for (char c = 'A'; c <= 'Z'; ++c) {
        if (has(c)) reject(word_columns_[index_of(c)], std::string("word ") + c + " has no use in this block");
      }
    }
    if (stop == 0 || stop == 1 || stop == 60) core_.say(ProgramStep::kPause, stop);
    if (stop == 2 || stop == 30) {
      core_.say(ProgramStep::kEnd, stop);
      ended_ = true;
    }
    if (stop == 98) call_fanuc();
    if (stop == 99) {
      if (frames_.empty()) reject(1, "M99 outside of a subprogram");
      leave_sub();
    }
  }

  void call_fanuc() {
    const double p = need('P', "M98");
    const double repeats = has('L') ? use('L') : 1;
    if (words_ != 0) reject(1, "M98 takes P and L only");
    if (!(repeats >= 1 && repeats <= 9999) || frames_.size() >= kDeepestCall)
      reject(1, "subprograms nested too deeply, or L out of range");
    for (std::size_t i = 0; i < lines_.size(); ++i) {
      if (lines_[i].size() < 2 || lines_[i][0] != 'O') continue;
      prepare(lines_[i]);
      ++p_;
      double n = -1;
      if (!read_digits(p_, end_, n) || n != p) continue;
      p_ = end_;
      // Repeats return to the call with one less to do: the frames are stacked in advance.
      if (frames_.size() + static_cast<std::size_t>(repeats) > 9999) reject(1, "too many repeats");
      for (int k = 0; k < static_cast<int>(repeats); ++k) {
        enter_sub({k == 0 ? next_ : i + 1, {}, loops_.size()});
      }
      next_ = i + 1;
      return;
    }
    reject(word_columns_[index_of('P')],
           "program O" + std::to_string(static_cast<long>(std::clamp(p, -1e9, 1e9))) + " is not in this file");
  }

  void renew_offset() {
    AxisValues sum = offsets_[offset_];
    for (std::size_t i = 0; i < 5; ++i) sum[i] += shift_[i];
    core_.set_offset(sum);
  }
  std::vector<int> taken_axes() {
    std::vector<int> axes;
    for (std::uint32_t rest = words_ & axis_letters_; rest != 0; rest &= rest - 1)
      axes.push_back(core_.axis_of(static_cast<char>('A' + std::countr_zero(rest))));
    return axes;
  }
  double target_value(int axis) {
    const char letter = axis < 3    ? static_cast<char>('X' + axis)
                        : axis == 3 ? core_.machine.outer.letter
                                    : core_.machine.inner.letter;
    return use(letter) * scale(axis);
  }
  [[nodiscard]] bool polar() const { return polar_radius_ || polar_angle_; }
  /// X and Y of the words @ and ^ about the program's zero; under G91 they add to where the machine stands.
  std::pair<double, double> polar_end() {
    if (plane_ != 0) reject(polar_column_, "polar words need G17");
    if (has('X') || has('Y')) reject(polar_column_, "polar words beside X or Y");
    const double x = core_.here()[0], y = core_.here()[1];
    const bool at_zero = std::hypot(x, y) < 1e-9;
    if (at_zero && (incremental_ || !polar_angle_ || !polar_radius_)) {
      reject(polar_column_, "at zero a polar word has no radius or angle to start from");
    }
    double radius = std::hypot(x, y), angle = std::atan2(y, x);
    if (polar_radius_) radius = *polar_radius_ * unit_ + (incremental_ ? radius : 0);
    if (polar_angle_) angle = *polar_angle_ * kRadPerDegree + (incremental_ ? angle : 0);
    return {radius * std::cos(angle), radius * std::sin(angle)};
  }
  void set_data() {
    const double l = need('L', "G10"), p = need('P', "G10 L2");
    if ((l != 2 && l != 20) || p < 0 || p > 9 || p != std::floor(p))
      reject(word_columns_[index_of('L')], "G10 is understood with L2 and L20, P0 to P9");
    const std::size_t system = p == 0 ? offset_ : static_cast<std::size_t>(p) - 1;
    for (const int axis : taken_axes()) {
      const double v = target_value(axis);
      const double machine = core_.joints()[static_cast<std::size_t>(axis)] - (axis == 2 ? core_.length_mm() : 0);
      offsets_[system][static_cast<std::size_t>(axis)] =
          l == 2 ? v : machine - v - shift_[static_cast<std::size_t>(axis)];
    }
    renew_offset();
  }
  /// G28, G30: through the point named to the machine's zero.
  void reference() {
    const auto axes = taken_axes();
    if (core_.tcp()) reject(1, "reference move while tool-centre-point control is on");
    AxisValues via = core_.here();
    for (const int axis : axes) {
      const double v = target_value(axis);
      via[static_cast<std::size_t>(axis)] = incremental_ ? via[static_cast<std::size_t>(axis)] + v : v;
    }
    if (!axes.empty()) core_.move(via, true, 0);
    AxisValues home = core_.joints();
    for (int axis = 0; axis < 5; ++axis) {
      if (axes.empty() || std::find(axes.begin(), axes.end(), axis) != axes.end())
        home[static_cast<std::size_t>(axis)] = 0;
    }
    core_.move_joints(home, true, 0);
  }

  void move(bool machine_coordinates, bool feed_here) {
    AxisValues to = core_.here();
    const std::uint32_t named = words_ & axis_letters_;
    if (machine_coordinates) {
      if (motion_ > 1) reject(1, "G53 needs G0 or G1");
      to = core_.joints();
    }
    if (motion_ >= 81) return drill();
    last_cycle_ = -1;
    if (polar()) {
      if (machine_coordinates) reject(polar_column_, "polar words name no machine coordinates");
      const auto [x, y] = polar_end();
      to[0] = x;
      to[1] = y;
    }
    for (const int axis : taken_axes()) {
      const double v = target_value(axis);
      to[static_cast<std::size_t>(axis)] =
          incremental_ && !machine_coordinates ? to[static_cast<std::size_t>(axis)] + v : v;
    }
    if (motion_ == 80) reject(1, "axis words while motion is cancelled");
    if (motion_ != 0) {
      if (inverse_time_ && !feed_here) reject(1, "F is missing in a block with inverse-time feed");
      if (feed_ == 0) reject(1, "feed not given or zero");
    }
    const auto timed = [&](double seconds_at_feed) {
      return motion_ == 0 ? 0 : inverse_time_ ? 60 / feed_ : seconds_at_feed;
    };
    if (motion_ <= 1) {
      if (machine_coordinates)
        core_.move_joints(to, motion_ == 0, timed(core_.seconds_at(to, feed_)));
      else
        core_.move(to, motion_ == 0, timed(core_.seconds_at(to, feed_)));
      return;
    }
    // The plane's axes in the order of a right-handed turn, and the letters of the centre.
    static constexpr int kPlanes[3][3] = {{0, 1, 2}, {2, 0, 1}, {1, 2, 0}};
    const int u = kPlanes[plane_][0], v = kPlanes[plane_][1], w = kPlanes[plane_][2];
    const AxisValues from = core_.here();
    const bool clockwise = motion_ == 2;
    double cu = 0, cv = 0, extra_turns = 0;
    if (has('P')) {
      extra_turns = use('P') - 1;
      if (extra_turns < 0 || extra_turns > 1000 || extra_turns != std::floor(extra_turns))
        reject(word_columns_[index_of('P')], "P counts an arc's turns");
    }
    if (has('R')) {
      if ((named & (bit(static_cast<char>('X' + u)) | bit(static_cast<char>('X' + v)))) == 0)
        reject(1, "no axis word in the arc's plane");
      centre_by_radius(from[u], from[v], to[u], to[v], use('R') * unit_, clockwise, word_columns_[index_of('R')], cu,
                       cv);
    } else {
      const char iu = static_cast<char>('I' + u), iv = static_cast<char>('I' + v);
      if (!has(iu) && !has(iv)) reject(1, "arc without centre or radius");
      if (centre_absolute_ && (!has(iu) || !has(iv))) reject(1, "an absolute centre needs both words");
      cu = (has(iu) ? use(iu) * unit_ : 0) + (centre_absolute_ ? 0 : from[u]);
      cv = (has(iv) ? use(iv) * unit_ : 0) + (centre_absolute_ ? 0 : from[v]);
      const double r0 = std::hypot(from[u] - cu, from[v] - cv), r1 = std::hypot(to[u] - cu, to[v] - cv),
                   off = std::abs(r1 - r0);
      if (r0 == 0 || off > 0.5 || (off > 0.005 && off > 0.001 * r0)) reject(1, "the arc's ends do not fit its centre");
    }
    double turn = turn_between(std::atan2(from[v] - cv, from[u] - cu), std::atan2(to[v] - cv, to[u] - cu), clockwise);
    turn += (clockwise ? -2 : 2) * kPi * extra_turns;
    const double length = std::hypot(std::hypot(from[u] - cu, from[v] - cv) * turn, to[w] - from[w]);
    core_.arc(to, u, v, cu, cv, turn, timed(length * 60 / feed_));
  }

  /// G81, G82, G83, G85, G89 along Z.
  void drill() {
    if (plane_ != 0) reject(1, "canned cycles are understood in G17 only");
    if (inverse_time_ || feed_ == 0) reject(1, "a canned cycle needs a feed per minute");
    const AxisValues from = core_.here();
    const bool fresh = motion_ != last_cycle_;
    last_cycle_ = motion_;
    if (fresh) cycle_level_ = from[2];
    if (has('R'))
      cycle_r_ = use('R') * unit_ + (incremental_ ? cycle_level_ : 0);
    else if (fresh)
      reject(1, "a canned cycle needs R");
    if (has('Z'))
      cycle_z_ = use('Z') * unit_ + (incremental_ ? cycle_r_ : 0);
    else if (fresh)
      reject(1, "a canned cycle needs Z");
    const double dwell = (motion_ == 82 || motion_ == 89) && has('P') ? use('P') : 0;
    if (dwell < 0) reject(word_columns_[index_of('P')], "negative time");
    if (motion_ == 83) {
      if (has('Q')) cycle_q_ = use('Q') * unit_;
      if (cycle_q_ <= 0) reject(1, "G83 needs a positive Q");
      if ((cycle_r_ - cycle_z_) / cycle_q_ > 10000) reject(1, "G83 with too many pecks");
    }
    const double count = has('L') ? use('L') : 1;
    if (!(count >= 1 && count <= 10000) || count != std::floor(count))
      reject(word_columns_[index_of('L')], "L counts holes");
    if (cycle_r_ < cycle_z_) reject(1, "R lies below Z");
    const double back = to_r_level_ ? cycle_r_ : std::max(from[2], cycle_r_);
    AxisValues step{};
    AxisValues at = from;
    for (const int axis : taken_axes()) {
      const double v = target_value(axis);
      if (incremental_)
        step[static_cast<std::size_t>(axis)] = v;
      else
        at[static_cast<std::size_t>(axis)] = v;
    }
    const auto go = [&](double z, bool rapid) {
      at[2] = z;
      if (at != core_.here()) core_.move(at, rapid, rapid ? 0 : core_.seconds_at(at, feed_));
    };
    for (int n = 0; n < static_cast<int>(count); ++n) {
      if (core_.here()[2] < cycle_r_) {
        AxisValues up = core_.here();
        up[2] = cycle_r_;
        core_.move(up, true, 0);
      }
      for (std::size_t i = 0; i < 5; ++i) at[i] += step[i];
      if (polar()) std::tie(at[0], at[1]) = polar_end();
      go(core_.here()[2], true);
      go(cycle_r_, true);
      if (motion_ == 83) {
        for (double z = cycle_r_ - cycle_q_; z > cycle_z_; z -= cycle_q_) {
          go(z, false);
          go(cycle_r_, true);
          go(z + 0.254, true);
        }
      }
      go(cycle_z_, false);
      if (dwell > 0) core_.say(ProgramStep::kDwell, 0, dwell);
      if (motion_ == 85 || motion_ == 89) go(cycle_r_, false);
      go(back, true);
    }
  }

  bool fanuc_;
  ReaderCore& core_;
  std::vector<std::string_view> lines_;
  std::size_t at_ = 0, next_ = 0;
  bool ended_ = false;
  int percents_ = 0;
  std::string text_;
  std::vector<int> columns_;
  const char *p_ = nullptr, *end_ = nullptr;
  bool point_ = false;
  std::unordered_map<int, double> numbers_;
  std::unordered_map<std::string, double> globals_;
  std::vector<std::unordered_map<std::string, double>> locals_{1};
  std::unordered_map<std::string, std::size_t> subs_, whiles_;
  std::vector<Frame> frames_;
  std::vector<Loop> loops_;
  std::vector<std::pair<std::string, double>> settings_;
  std::uint32_t words_ = 0, axis_letters_ = 0;
  std::array<double, 26> values_{};
  std::array<int, 26> word_columns_{};
  // Modes.
  double unit_ = 1, feed_ = 0, rpm_ = 0;
  bool incremental_ = false, centre_absolute_ = false, inverse_time_ = false, to_r_level_ = false;
  int motion_ = 0, plane_ = 0, spindle_ = 5, tool_ = 0, selected_ = 0, last_cycle_ = -1;
  double cycle_level_ = 0, cycle_r_ = 0, cycle_z_ = 0, cycle_q_ = 0;
  std::size_t offset_ = 0;
  std::array<AxisValues, 9> offsets_{};
  AxisValues shift_{}, kept_shift_{};
  std::vector<std::optional<Modes>> saved_{1};
  std::vector<bool> restores_{false};  ///< M73: at the subprogram's return
  std::optional<double> polar_radius_, polar_angle_;
  int polar_column_ = 0;
};

}  // namespace

ReadResult read_word_program(std::string_view text, bool fanuc, ReaderCore& core) {
  return WordReader(text, fanuc, core).run();
}

}  // namespace lightmill::detail

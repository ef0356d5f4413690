// Fanuc's custom macros: variables, jumps and loops, calls with arguments.
#include "machine/detail/word_reader.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kDeepestMacro = 4;
constexpr int kLocals = 33;
constexpr double kEmpty = std::numeric_limits<double>::quiet_NaN();

/// A block without comment, blanks and block number, in capitals; never an error.
std::string bare(std::string_view line, double& block_number) {
  std::string text;
  bool comment = false;
  for (char c : line) {
    if (c == '(') comment = true;
    if (!comment && c != ' ' && c != '\t') text.push_back(c >= 'a' && c <= 'z' ? static_cast<char>(c - 32) : c);
    if (c == ')') comment = false;
  }
  block_number = -1;
  if (text.starts_with('N')) {
    const char* p = text.data() + 1;
    if (read_digits(p, text.data() + text.size(), block_number))
      text.erase(0, static_cast<std::size_t>(p - text.data()));
  }
  return text;
}

/// The local variable of a macro call's argument; 0: none. The nth I, J or K of a block has one of its own.
int local_of(char letter, int nth) {
  if (letter >= 'I' && letter <= 'K') return 4 + (letter - 'I') + 3 * nth;
  if (letter >= 'A' && letter <= 'C') return 1 + (letter - 'A');
  if (letter >= 'D' && letter <= 'F') return 7 + (letter - 'D');
  if (letter >= 'Q' && letter <= 'Z') return 17 + (letter - 'Q');
  return letter == 'H' ? 11 : letter == 'M' ? 13 : 0;
}

/// As whole as it can be said.
std::string said(double number) {
  return std::isnan(number) ? "nothing" : std::to_string(static_cast<long>(std::clamp(number, -1e9, 1e9)));
}

bool is_local(int n) {
  return n >= 1 && n <= kLocals;
}
bool is_common(int n) {
  return (n >= 100 && n <= 199) || (n >= 500 && n <= 999);
}

}  // namespace

/// Where the blocks are that calls and jumps lead to.
void WordReader::look_through() {
  if (looked_through_) return;
  looked_through_ = true;
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    double n = -1;
    const std::string text = bare(lines_[i], n);
    const auto number_behind = [&](std::size_t at) {
      double v = -1;
      const char* p = text.data() + std::min(at, text.size());
      return read_digits(p, text.data() + text.size(), v) ? v : -1;
    };
    const auto mark = [&](char kind, double number) { marks_[{kind, number}].push_back(i); };
    if (n >= 0) mark('N', n);
    if (text.starts_with("END")) mark('E', number_behind(3));
    // To LinuxCNC an O with a word behind its number is another thing.
    if (text.starts_with('O') && (fanuc_ || text.find_first_not_of("0123456789", 1) == std::string::npos)) {
      mark('O', number_behind(1));
      programs_.push_back(i);
    }
    const std::size_t loop = text.starts_with("DO")      ? 0
                             : text.starts_with("WHILE") ? text.rfind("]DO")
                                                         : std::string::npos;
    if (loop != std::string::npos) mark('D', number_behind(loop + (loop == 0 ? 2 : 3)));
  }
}

/// The block with this mark in the program that runs: the next one, for N else the first, or the last one before; -1: none.
long WordReader::find_mark(char kind, double number, bool backwards) {
  look_through();
  const auto marked = marks_.find({kind, number});
  if (marked == marks_.end()) return -1;
  // The program of this block: from its O to the next one.
  const auto after = std::upper_bound(programs_.begin(), programs_.end(), at_);
  const std::size_t first = after == programs_.begin() ? 0 : after[-1];
  const std::size_t last = after == programs_.end() ? lines_.size() : *after;
  const std::vector<std::size_t>& lines = marked->second;
  const auto here = std::lower_bound(lines.begin(), lines.end(), at_);
  if (backwards) return here != lines.begin() && here[-1] >= first ? static_cast<long>(here[-1]) : -1;
  if (here != lines.end() && *here < last) return static_cast<long>(*here);
  const auto start = std::lower_bound(lines.begin(), here, first);
  return kind == 'N' && start != here ? static_cast<long>(*start) : -1;
}

std::size_t WordReader::find_program(double number, int where) {
  look_through();
  const auto marked = marks_.find({'O', number});
  if (marked == marks_.end()) reject(where, "program O" + said(number) + " is not in this file");
  return marked->second.front();
}

double WordReader::variable(double n, int where) {
  if (n != std::floor(n) || !(n >= 0 && n <= 99999)) reject(where, "variable numbers are whole and not negative");
  const int i = static_cast<int>(n);
  if (i == 0) return kEmpty;
  if (is_local(i) || is_common(i)) {
    const auto found = numbers_.find(i);
    return found == numbers_.end() ? kEmpty : found->second;
  }
  // Ends of blocks, and where the axes stand in machine and work coordinates: X Y Z and the rotary axes.
  const int axis = i % 20 - 1;
  if (i >= 5001 && i <= 5045 && axis >= 0 && axis < 5) {
    if (path_.on()) reject(where, "the position is not known while cutter compensation is on");
    const AxisValues at = i / 20 == 251 ? core_.joints() : path_.place();
    return at[static_cast<std::size_t>(axis)] / scale(axis);
  }
  const int system = (i - 5221) / 20;
  if (i >= 5221 && system < 6 && (i - 5221) % 20 < 5) {
    const int offset_axis = (i - 5221) % 20;
    return offsets_[static_cast<std::size_t>(system)][static_cast<std::size_t>(offset_axis)] / scale(offset_axis);
  }
  reject(where, "system variable #" + std::to_string(i) + " is not known to this control");
}

void WordReader::assign() {
  ++p_;  // #
  const int where = column();
  const double n = value();
  if (!take("=")) reject(column(), "'=' is missing");
  const double v = expression();
  if (n == 3000) reject(where, "the program raises alarm " + said(v));
  if (n != std::floor(n) || !(n >= 0 && n <= 99999)) reject(where, "variable numbers are whole and not negative");
  const int i = static_cast<int>(n);
  if (!is_local(i) && !is_common(i)) reject(where, "variable #" + std::to_string(i) + " cannot be set here");
  if (std::isnan(v))
    numbers_.erase(i);
  else
    numbers_[i] = v;
}

void WordReader::go_to(double n, int where) {
  const long line = n >= 0 ? find_mark('N', n, false) : -1;
  if (line < 0) reject(where, "there is no block N" + said(n));
  next_ = static_cast<std::size_t>(line);
}

/// A block that is no motion but a statement; false if it is none.
bool WordReader::statement() {
  const int where = column();
  const auto condition = [&] {
    const double v = bracket();
    return !std::isnan(v) && v != 0;
  };
  const auto loop_number = [&] {
    const int place = column();
    const double m = value();
    if (m != 1 && m != 2 && m != 3) reject(place, "loops are numbered 1 to 3");
    return m;
  };
  if (*p_ == '#') {
    assign();
  } else if (take("IF")) {
    const bool holds = condition();
    if (take("GOTO")) {
      const double n = value();
      if (holds) go_to(n, where);
    } else if (!take("THEN")) {
      reject(column(), "IF needs GOTO or THEN");
    } else if (holds) {
      if (p_ == end_ || *p_ != '#') reject(column(), "THEN needs a variable to set");
      assign();
    } else {
      p_ = end_;
    }
  } else if (take("GOTO")) {
    go_to(value(), where);
  } else if (take("WHILE")) {
    const bool holds = condition();
    if (!take("DO")) reject(column(), "WHILE needs DO");
    const long end = find_mark('E', loop_number(), false);
    if (end < 0) reject(where, "the loop has no END");
    if (!holds) next_ = static_cast<std::size_t>(end) + 1;
  } else if (take("DO")) {
    if (find_mark('E', loop_number(), false) < 0) reject(where, "the loop has no END");
  } else if (take("END")) {
    const double m = loop_number();
    const long start = find_mark('D', m, true);
    if (start < 0 || find_mark('E', m, true) > start) reject(where, "END without DO");
    next_ = static_cast<std::size_t>(start);
  } else {
    return false;
  }
  if (p_ != end_) reject(column(), "nothing may follow this statement");
  return true;
}

/// A word behind G65 or G66: false if it is none of the arguments.
bool WordReader::read_argument(char letter, int where) {
  if (letter == 'L' || letter == 'P') return false;
  point_ = true;
  const int nth = letter >= 'I' && letter <= 'K' ? ijk_[static_cast<std::size_t>(letter - 'I')]++ : 0;
  const double v = value();
  const int n = nth < 10 ? local_of(letter, nth) : 0;
  if (n == 0) reject(where, std::string(1, letter) + " is no argument of a macro call");
  if (!point_ && v != 0 && std::string_view("DEFHMST").find(letter) == std::string_view::npos)
    reject(where, "an argument needs a decimal point");
  if (std::isnan(v))
    arguments_.erase(n);
  else
    arguments_[n] = v;
  return true;
}

double WordReader::repeats(double program) {
  const double wanted = has('L') ? use('L') : fanuc_ && program >= 10000 ? std::floor(program / 10000) : 1;
  if (!(wanted >= 1 && wanted <= 9999) || wanted != std::floor(wanted))
    reject(1, "L counts from 1 to 9999");
  return wanted;
}

/// M98: a subprogram sees its caller's variables.
void WordReader::call_subprogram() {
  const double p = need('P', "M98"), times = repeats(p);
  if (words_ != 0) reject(1, "M98 takes P and L only");
  const double program = fanuc_ && p >= 10000 ? std::fmod(p, 10000) : p;
  call(find_program(program, column_of('P')), times, nullptr, false);
}

void WordReader::call(std::size_t line, double times, const std::unordered_map<int, double>* arguments, bool modal) {
  const auto macros = std::count_if(frames_.begin(), frames_.end(), [](const Frame& f) { return f.locals > 0; });
  if (frames_.size() >= kDeepestCall || (arguments != nullptr && static_cast<std::size_t>(macros) >= kDeepestMacro))
    reject(1, "subprograms nested too deeply");
  Frame frame{next_, {}, loops_.size()};
  frame.start = line + 1;
  frame.left = static_cast<long>(times) - 1;
  frame.modal = modal;
  if (arguments != nullptr) {
    frame.locals = kLocals;
    frame.arguments = *arguments;
    for (int n = 1; n <= kLocals; ++n) {
      if (const auto old = numbers_.find(n); old != numbers_.end()) frame.saved[n] = old->second;
    }
    set_locals(*arguments, kLocals);
  }
  enter_sub(std::move(frame));
  next_ = line + 1;
}

/// G65, G66, G67.
void WordReader::take_macro_call(int tenths) {
  if (tenths == 670) {
    modal_call_.reset();
    return;
  }
  const bool modal = tenths == 660;
  const double program = need('P', modal ? "G66" : "G65");
  MacroCall macro{find_program(program, column_of('P')), repeats(0), arguments_};
  if (!modal) return call(macro.line, macro.times, &macro.arguments, false);
  if (modal_call_) reject(1, "G66 while a modal call is on");
  modal_call_ = std::move(macro);
}

/// Behind a block that moved axes.
void WordReader::call_modal() {
  if (!modal_call_ || std::any_of(frames_.begin(), frames_.end(), [](const Frame& f) { return f.modal; })) return;
  const MacroCall macro = *modal_call_;
  call(macro.line, macro.times, &macro.arguments, true);
}

/// M99, with P at another block of the caller than the next.
void WordReader::leave_program() {
  const bool to_block = fanuc_ && has('P');
  const double n = to_block ? use('P') : 0;
  if (words_ != 0) reject(1, fanuc_ ? "M99 takes P only" : "M99 takes no words");
  if (frames_.empty() && !to_block) reject(1, "M99 outside of a subprogram begins the program again, without end");
  if (!frames_.empty()) {
    if (to_block) frames_.back().left = 0;
    const std::size_t back = frames_.back().back;
    leave_sub();
    if (!to_block) return;
    at_ = back - 1;  // the caller's block, from which the number is looked for
  }
  go_to(n, column_of('P'));
}

}  // namespace lightmill::detail

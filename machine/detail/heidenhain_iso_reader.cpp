// Heidenhain DIN/ISO programs.
#include "machine/detail/reader_core.h"

namespace lightmill::detail {
namespace {

class HeidenhainIsoReader {
 public:
  HeidenhainIsoReader(std::string_view text, ReaderCore& core) : core_(core), lines_(split_lines(text)) {}

  ReadResult run() {
    return run_lines(
        core_, lines_.size(), ended_, "the program's last block, % and its name, is missing",
        [this](std::size_t at) {
          if (split(lines_[at])) read_block();
          return at + 1;
        },
        [] {});
  }

 private:
  /// The block's words without its end; false for an empty line.
  bool split(std::string_view line) {
    split_words(line, tokens_);
    if (tokens_.empty()) return false;
    if (tokens_.back().text == "*") {
      tokens_.pop_back();
    } else if (line.find(';') == std::string_view::npos) {
      reject(tokens_.back().column, "a block ends with *");
    }
    return !tokens_.empty();
  }

  void read_block() {
    std::size_t i = 0;
    if (begun_) {
      const Token& label = tokens_[0];
      const double n =
          label.text.size() > 1 && label.text[0] == 'N' ? signed_number(label.text.substr(1), label.column) : -1;
      if (n <= number_ || n != std::floor(n)) reject(label.column, "block numbers are whole and grow");
      number_ = n;
      i = 1;
      if (i == tokens_.size()) return;  // a comment
    }
    if (tokens_[i].text[0] == '%') return frame(i);
    if (!begun_) reject(tokens_[0].column, "the program must start with % and its name");
    Words words;
    for (; i < tokens_.size(); ++i) read_word(words, i);
    perform(words);
  }

  void frame(std::size_t i) {
    if (i + 2 != tokens_.size() || (tokens_[i + 1].text != "G71" && tokens_[i + 1].text != "G70")) {
      reject(tokens_[i].column, "%, the name and G70 or G71 expected");
    }
    if (!begun_) {
      begun_ = true;
      name_ = tokens_[i].text;
      unit_ = tokens_[i + 1].text == "G71" ? 1 : kMmPerInch;
      return core_.set_offset(datum(core_, 1, 1));
    }
    if (tokens_[i].text != name_) reject(tokens_[i].column, "the last block must name the program that began");
    if (core_.tcp()) core_.set_tcp(false);
    if (!said_end_) core_.say(ProgramStep::kEnd, 2);
    ended_ = true;
  }

  struct Words {
    std::array<bool, 5> named{};
    AxisValues axes{};
    std::vector<int> g, m;
    double f = 0, s = 0, t = 0, q339 = 0, delta = 0, i = 0, j = 0, radius = 0;
    bool has_f = false, has_s = false, has_t = false, has_q = false, has_centre = false, has_radius = false;
    [[nodiscard]] bool has(int code) const { return std::find(g.begin(), g.end(), code) != g.end(); }
    [[nodiscard]] bool has_m(int code) const { return std::find(m.begin(), m.end(), code) != m.end(); }
  };

  void read_word(Words& w, std::size_t& i) {
    const std::string_view text = tokens_[i].text;
    const int column = tokens_[i].column;
    const auto next = [&] {
      if (++i >= tokens_.size()) reject(column, "a value is missing");
      return signed_number(tokens_[i].text, tokens_[i].column);
    };
    if (text.starts_with("P0") && text.size() == 3) {
      static_cast<void>(next());
      return;
    }
    if (text.starts_with("Q339=")) {
      w.q339 = signed_number(text.substr(5), column);
      w.has_q = true;
      return;
    }
    if (text.starts_with("DL")) {
      w.delta = signed_number(text.substr(2), column) * unit_;
      return;
    }
    const char letter = text[0];
    const double v = signed_number(text.substr(1), column);
    if (const int axis = core_.axis_of(letter); axis >= 0) {
      const auto k = static_cast<std::size_t>(axis);
      if (w.named[k]) reject(column, "axis named twice");
      w.named[k] = true;
      w.axes[k] = v * (axis < 3 ? unit_ : kRadPerDegree);
      return;
    }
    switch (letter) {
      case 'G':
      case 'M':
        if (v != std::floor(v) || v < 0 || v > 999) reject(column, "unknown code");
        (letter == 'G' ? w.g : w.m).push_back(static_cast<int>(v));
        check_code(letter, static_cast<int>(v), column);
        return;
      case 'F':
        w.f = v;
        w.has_f = true;
        if (v <= 0) reject(column, "F must be above 0");
        return;
      case 'S':
        w.s = v;
        w.has_s = true;
        return;
      case 'T':
        w.t = v;
        w.has_t = true;
        return;
      case 'I':
      case 'J':
        (letter == 'I' ? w.i : w.j) = v * unit_;
        w.has_centre = true;
        return;
      case 'R':
        w.radius = v * unit_;
        w.has_radius = true;
        return;
      default:
        reject(column, "'" + std::string(text) + "' is not understood");
    }
  }

  static void check_code(char letter, int code, int column) {
    static constexpr int kG[] = {0, 1, 2, 3, 4, 17, 30, 31, 40, 62, 90, 91, 247};
    static constexpr int kM[] = {0, 1, 2, 3, 4, 5, 7, 8, 9, 13, 14, 30, 91, 126, 127, 128, 129};
    const bool known = letter == 'G' ? std::find(std::begin(kG), std::end(kG), code) != std::end(kG)
                                     : std::find(std::begin(kM), std::end(kM), code) != std::end(kM);
    if (!known) reject(column, std::string(1, letter) + std::to_string(code) + " is not understood");
  }

  void perform(const Words& w) {
    if (w.has(62)) {
      core_.corner_tolerance_mm = w.t > 0 ? w.t : -1;
      return;
    }
    if (w.has(30) || w.has(31)) return;  // the blank
    for (const int code : w.g) {
      if (code <= 3) motion_ = code;
      if (code == 90 || code == 91) incremental_ = code == 91;
    }
    if (w.has(247)) {
      if (!w.has_q) reject(tokens_[0].column, "G247 needs Q339");
      core_.set_offset(datum(core_, w.q339, tokens_[0].column));
    }
    if (w.has(4)) {
      if (!w.has_f) reject(tokens_[0].column, "G04 needs its seconds in F");
      return core_.say(ProgramStep::kDwell, 0, w.f);
    }
    if (w.has_t) call_tool(w);
    if (w.has_s) {
      rpm_ = w.s;
      if (rpm_ < 0 || rpm_ > core_.machine.max_spindle_rpm) {
        reject(tokens_[0].column, "spindle speed out of the machine's range");
      }
    }
    if (w.has_f) feed_ = w.f * unit_;
    bool machine_coordinates = false;
    for (const int code : w.m) {
      if (code == 3 || code == 4 || code == 13 || code == 14) {
        if (rpm_ == 0) reject(tokens_[0].column, "no spindle speed");
        core_.say(ProgramStep::kSpindle, code % 10, rpm_);
      }
      if (code == 7 || code == 8 || code >= 13) {
        if (code == 7 || code == 8 || code == 13 || code == 14) core_.say(ProgramStep::kCoolant, code == 7 ? 7 : 8);
      }
      if (code == 91) machine_coordinates = true;
      if (code == 126 || code == 127) shortest_ = code == 126;
      if (code == 128) core_.set_tcp(true);
    }
    if (std::any_of(w.named.begin(), w.named.end(), [](bool n) { return n; })) move(w, machine_coordinates);
    for (const int code : w.m) {
      if (code == 129) core_.set_tcp(false);
      if (code == 5) core_.say(ProgramStep::kSpindle, 5);
      if (code == 9) core_.say(ProgramStep::kCoolant, 9);
      if (code == 0 || code == 1) core_.say(ProgramStep::kPause, code);
      if (code == 2 || code == 30) {
        core_.say(ProgramStep::kEnd, code);
        said_end_ = true;
      }
    }
  }

  void call_tool(const Words& w) {
    if (core_.tcp()) reject(tokens_[0].column, "M129 must come before a tool call");
    if (!w.has(17)) reject(tokens_[0].column, "a tool call needs its axis, G17");
    if (w.t < 0 || w.t > 32767 || w.t != std::floor(w.t))
      reject(tokens_[0].column, "tool numbers are whole and not negative");
    const int tool = static_cast<int>(w.t);
    const double length = core_.tool_length(tool, tokens_[0].column) + w.delta;
    core_.say(ProgramStep::kChangeTool, tool);
    core_.set_length(length);
  }

  void move(const Words& w, bool machine_coordinates) {
    if (said_end_) reject(tokens_[0].column, "a move after the program's end");
    const AxisValues from = machine_coordinates ? core_.joints() : core_.here();
    AxisValues to = from;
    for (std::size_t k = 0; k < 5; ++k) {
      if (!w.named[k]) continue;
      to[k] = incremental_ ? from[k] + w.axes[k] : w.axes[k];
      if (k >= 3 && shortest_ && !incremental_) to[k] = from[k] + std::remainder(to[k] - from[k], 2 * kPi);
    }
    if (motion_ != 0 && feed_ == 0) reject(tokens_[0].column, "feed not given");
    if (machine_coordinates) {
      if (motion_ > 1) reject(tokens_[0].column, "M91 needs a straight line");
      return core_.move_joints(to, motion_ == 0, motion_ == 0 ? 0 : core_.seconds_at(to, feed_));
    }
    if (motion_ <= 1) return core_.move(to, motion_ == 0, motion_ == 0 ? 0 : core_.seconds_at(to, feed_));
    const bool clockwise = motion_ == 2;
    double cu = w.i, cv = w.j;
    if (w.has_radius) {
      centre_by_radius(from[0], from[1], to[0], to[1], w.radius, clockwise, tokens_[0].column, cu, cv);
    } else if (!w.has_centre) {
      reject(tokens_[0].column, "an arc needs its centre I, J or its radius");
    }
    const double r0 = std::hypot(from[0] - cu, from[1] - cv), r1 = std::hypot(to[0] - cu, to[1] - cv);
    if (r0 == 0 || std::abs(r1 - r0) > 0.016) reject(tokens_[0].column, "the arc's ends do not fit its centre");
    const double turn =
        turn_between(std::atan2(from[1] - cv, from[0] - cu), std::atan2(to[1] - cv, to[0] - cu), clockwise);
    core_.arc(to, 0, 1, cu, cv, turn, std::hypot(r0 * turn, to[2] - from[2]) * 60 / feed_);
  }

  ReaderCore& core_;
  std::vector<std::string_view> lines_;
  std::vector<Token> tokens_;
  std::string_view name_;
  double number_ = -1, unit_ = 1, feed_ = 0, rpm_ = 0;
  bool begun_ = false, ended_ = false, said_end_ = false, incremental_ = false, shortest_ = false;
  int motion_ = 1;
};

}  // namespace

ReadResult read_heidenhain_iso(std::string_view text, ReaderCore& core) {
  return HeidenhainIsoReader(text, core).run();
}

}  // namespace lightmill::detail

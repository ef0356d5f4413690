// Heidenhain conversational (TNC) programs.
#include <unordered_map>

#include "machine/detail/reader_core.h"

namespace lightmill::detail {
namespace {

constexpr std::size_t kDeepestCall = 8;

class HeidenhainReader {
 public:
  HeidenhainReader(std::string_view text, ReaderCore& core) : core_(core), lines_(split_lines(text)) {}

  ReadResult run() {
    return run_lines(
        core_, lines_.size(), ended_, "END PGM is missing",
        [this](std::size_t at) {
          at_ = at;
          next_ = at + 1;
          if (split(lines_[at])) read_block();
          return next_;
        },
        [this] { check_frame(); });
  }

 private:
  /// Block numbers count from 0 without a gap; labels are found before anything moves.
  void check_frame() {
    long expected = 0;
    for (std::size_t i = 0; i < lines_.size(); ++i) {
      core_.line = static_cast<long>(i) + 1;
      const bool follows = continued_;
      if (!split(lines_[i])) continue;
      if (follows) continue;
      if (number_ != expected) reject(1, "block number " + std::to_string(expected) + " expected");
      ++expected;
      if (tokens_.size() == 2 && tokens_[0].text == "LBL" && tokens_[1].text != "0") {
        if (!labels_.emplace(tokens_[1].text, i).second) reject(tokens_[1].column, "label set twice");
      }
    }
    continued_ = false;
  }

  void preset(double n, int column) {
    preset_ = datum(core_, n, column);
    shift_ = {};
    renew();
  }

  /// Words of a block without its number and comment; false if nothing is left.
  bool split(std::string_view line) {
    split_words(line, tokens_);
    const bool follows = continued_;
    continued_ = false;
    if (!tokens_.empty() && tokens_.back().text == "~") {
      continued_ = true;
      tokens_.pop_back();
    }
    if (tokens_.empty()) {
      if (line.find_first_not_of(" \t") == std::string_view::npos || follows) return false;
    }
    if (follows) return true;
    if (tokens_.empty()) reject(1, "a block number is missing");
    const char* p = tokens_[0].text.data();
    const char* const end = p + tokens_[0].text.size();
    double n = 0;
    if (!read_digits(p, end, n) || p != end || n > 1e8) reject(1, "a block number is missing");
    number_ = static_cast<long>(n);
    tokens_.erase(tokens_.begin());
    return true;
  }

  [[nodiscard]] bool is(std::size_t i, std::string_view text) const {
    return i < tokens_.size() && tokens_[i].text == text;
  }
  void expect_end(std::size_t i) const {
    if (i < tokens_.size()) reject(tokens_[i].column, "'" + std::string(tokens_[i].text) + "' is not understood here");
  }
  [[noreturn]] void incomplete() const {
    reject(tokens_.empty() ? 1 : tokens_.back().column, "the block is not complete");
  }

  void read_block() {
    if (tokens_.empty()) return;
    const std::string_view first = tokens_[0].text;
    if (cycle_247_) {
      if (!first.starts_with("Q339=")) reject(tokens_[0].column, "cycle 247 needs Q339");
      cycle_247_ = false;
      preset(signed_number(first.substr(5), tokens_[0].column), tokens_[0].column);
      return expect_end(1);
    }
    if (first == "BEGIN" || first == "END") return frame(first == "BEGIN");
    if (!begun_) reject(tokens_[0].column, "the program must start with BEGIN PGM");
    if (first == "*") return;  // a heading
    if (first == "L" || first == "C" || first == "CR") return move(first);
    if (first == "CC") return circle_centre();
    if (first == "TOOL") return tool();
    if (first == "CYCL") return cycle();
    if (first == "BLK") {
      if (!is(1, "FORM") || tokens_.size() < 6 || (tokens_[2].text != "0.1" && tokens_[2].text != "0.2")) incomplete();
      return;
    }
    if (first == "STOP") {
      modes(1);
      return core_.say(ProgramStep::kPause, 0);
    }
    if (first == "FUNCTION") {
      if (is(1, "RESET") && is(2, "TCPM") && tokens_.size() == 3) return core_.set_tcp(false);
      static constexpr std::string_view kTcpm[] = {"FUNCTION", "TCPM", "F", "TCP", "AXIS", "POS", "PATHCTRL", "AXIS"};
      for (std::size_t i = 0; i < 8; ++i) {
        if (!is(i, kTcpm[i]))
          reject(tokens_[std::min(i, tokens_.size() - 1)].column,
                 "only FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS is understood");
      }
      expect_end(8);
      return core_.set_tcp(true);
    }
    if (first == "LBL") {
      if (tokens_.size() != 2) incomplete();
      if (tokens_[1].text == "0" && !calls_.empty()) {
        next_ = calls_.back();
        calls_.pop_back();
      }
      return;
    }
    if (first == "CALL") return call();
    if (first[0] == 'M') {
      modes(0);
      return finish();
    }
    reject(tokens_[0].column, "'" + std::string(first) + "' is not understood");
  }

  void frame(bool begin) {
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
    if (!begun_ || tokens_[2].text != name_) reject(tokens_[2].column, "END PGM must name the program that began");
    if (core_.tcp()) core_.set_tcp(false);
    core_.say(ProgramStep::kEnd, 2);
    ended_ = true;
  }

  void renew() {
    AxisValues sum = preset_;
    for (std::size_t i = 0; i < 5; ++i) sum[i] += shift_[i];
    core_.set_offset(sum);
  }

  /// X+1.5, IB-3: writes into `to`; false if the word names no axis.
  bool axis_word(const Token& token, AxisValues& to, const AxisValues& from, bool* absolute_rotary = nullptr) const {
    std::string_view text = token.text;
    const bool incremental = text.size() > 1 && text[0] == 'I' && core_.axis_of(text[1]) >= 0;
    if (incremental) text.remove_prefix(1);
    const int axis = text.empty() ? -1 : core_.axis_of(text[0]);
    if (axis < 0) return false;
    const auto i = static_cast<std::size_t>(axis);
    const double v = signed_number(text.substr(1), token.column) * (axis < 3 ? unit_ : kRadPerDegree);
    to[i] = incremental ? from[i] + v : v;
    if (axis >= 3 && absolute_rotary != nullptr) absolute_rotary[axis - 3] = !incremental;
    return true;
  }

  void tool() {
    if (is(1, "DEF")) return;
    if (!is(1, "CALL") || tokens_.size() < 3) incomplete();
    std::size_t i = 2;
    int selected = tool_;
    if (tokens_[2].text[0] != 'S') {
      if (core_.tcp()) reject(tokens_[0].column, "M129 must come before TOOL CALL");
      const double n = signed_number(tokens_[2].text, tokens_[2].column);
      if (n < 0 || n > 32767 || n != std::floor(n))
        reject(tokens_[2].column, "tool numbers are whole and not negative");
      if (!is(3, "Z")) reject(tokens_[2].column, "TOOL CALL needs the tool axis Z");
      selected = static_cast<int>(n);
      i = 4;
    }
    double length = core_.tool_length(selected, tokens_[2].column);
    for (; i < tokens_.size(); ++i) {
      const std::string_view text = tokens_[i].text;
      if (text[0] == 'S') {
        rpm_ = signed_number(text.substr(1), tokens_[i].column);
        if (rpm_ < 0 || rpm_ > core_.machine.max_spindle_rpm)
          reject(tokens_[i].column, "spindle speed out of the machine's range");
      } else if (text.starts_with("DL")) {
        length += signed_number(text.substr(2), tokens_[i].column) * unit_;
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

  void cycle() {
    if (!is(1, "DEF") || tokens_.size() < 3) incomplete();
    const std::string_view what = tokens_[2].text;
    if (what == "247") {
      for (std::size_t i = 3; i < tokens_.size(); ++i) {
        if (tokens_[i].text.starts_with("Q339="))
          return preset(signed_number(tokens_[i].text.substr(5), tokens_[i].column), tokens_[i].column);
      }
      if (!continued_) reject(tokens_[2].column, "cycle 247 needs Q339");
      cycle_247_ = true;
      return;
    }
    if (what == "7.0" || what == "9.0" || what == "32.0") return;  // headings; the values follow
    if (what.starts_with("7.") && what.size() == 3) {
      if (tokens_.size() < 4 || core_.tcp()) reject(tokens_[0].column, "a datum shift needs an axis and no M128");
      for (std::size_t i = 3; i < tokens_.size(); ++i) {
        if (!axis_word(tokens_[i], shift_, shift_)) expect_end(i);
      }
      return renew();
    }
    if (what == "9.1") {
      if (tokens_.size() < 4) incomplete();
      const Token& last = tokens_.back();
      const double seconds =
          signed_number(last.text.starts_with("DWELL") ? last.text.substr(5) : last.text, last.column);
      if (seconds < 0) reject(last.column, "negative time");
      return core_.say(ProgramStep::kDwell, 0, seconds);
    }
    if (what == "32.1" || what == "32.2") {
      if (what == "32.1") core_.corner_tolerance_mm = -1;
      for (std::size_t i = 3; i < tokens_.size(); ++i) {
        const std::string_view text = tokens_[i].text;
        const std::size_t skip = text.starts_with("HSC-MODE:") ? 9
                                 : text.starts_with("TA")      ? 2
                                 : text.starts_with("T")       ? 1
                                                               : 0;
        if (skip == 0) expect_end(i);
        const double value = signed_number(text.substr(skip), tokens_[i].column);
        if (what == "32.1" && skip == 1) core_.corner_tolerance_mm = std::max(0.0, value);
      }
      return;
    }
    reject(tokens_[2].column, "cycle " + std::string(what) + " is not understood");
  }

  void circle_centre() {
    for (std::size_t i = 1; i < tokens_.size(); ++i) {
      if (!axis_word(tokens_[i], centre_, core_.here())) expect_end(i);
    }
    if (tokens_.size() < 3) incomplete();
    has_centre_ = true;
  }

  /// F and M words from `i` on; what takes effect at the block's start does so.
  void modes(std::size_t i) {
    fmax_ = machine_coordinates_ = tcp_off_ = false;
    block_seconds_ = 0;
    ends_.clear();
    bool tcp_on = false;
    for (; i < tokens_.size(); ++i) {
      const Token& token = tokens_[i];
      const std::string_view text = token.text;
      if (text == "R0") continue;
      if (text == "FMAX") {
        fmax_ = true;
        continue;
      }
      if (text.starts_with("FT")) {
        block_seconds_ = signed_number(text.substr(2), token.column);
        if (!(block_seconds_ >= 0.001 && block_seconds_ <= 999.999)) reject(token.column, "FT takes 0.001 to 999.999 s");
        continue;
      }
      if (text[0] == 'F') {
        const double f = signed_number(text.substr(1), token.column);
        if (f <= 0) reject(token.column, "the feed must be above 0");
        if (!tcp_on) feed_ = f * unit_;  // behind M128 it limits the compensating moves
        continue;
      }
      if (text[0] != 'M') expect_end(i);
      const double code = signed_number(text.substr(1), token.column);
      if (code != std::floor(code) || code < 0 || code > 999) reject(token.column, "M codes are whole");
      switch (static_cast<int>(code)) {
        case 3:
        case 4:
        case 13:
        case 14:
          spindle_ = code == 3 || code == 13 ? 3 : 4;
          if (rpm_ == 0) reject(token.column, "no spindle speed");
          core_.say(ProgramStep::kSpindle, spindle_, rpm_);
          if (code >= 13) core_.say(ProgramStep::kCoolant, 8);
          break;
        case 7:
        case 8:
          core_.say(ProgramStep::kCoolant, static_cast<int>(code));
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
          core_.set_tcp(true);
          break;
        case 129:
          tcp_off_ = true;
          break;
        case 0:
        case 2:
        case 5:
        case 9:
        case 30:
          ends_.push_back(static_cast<int>(code));
          break;
        default:
          reject(token.column, "M" + std::string(text.substr(1)) + " is not understood");
      }
    }
    if (tcp_off_) core_.set_tcp(false);
  }
  /// What takes effect at the block's end.
  void finish() {
    for (const int code : ends_) {
      if (code == 5) core_.say(ProgramStep::kSpindle, spindle_ = 5);
      if (code == 9) core_.say(ProgramStep::kCoolant, 9);
      if (code == 0) core_.say(ProgramStep::kPause);
      if (code == 2 || code == 30) {
        core_.say(ProgramStep::kEnd, code);
        ended_ = true;
      }
    }
  }

  void move(std::string_view kind) {
    std::size_t i = 1;
    bool rotary[2] = {false, false}, axes = false;
    const AxisValues before = core_.here();
    AxisValues words{};
    std::array<bool, 5> named{};
    for (; i < tokens_.size(); ++i) {
      AxisValues probe = before;
      if (!axis_word(tokens_[i], probe, before, rotary)) break;
      const std::string_view text = tokens_[i].text;
      const auto axis = static_cast<std::size_t>(core_.axis_of(text[0] == 'I' ? text[1] : text[0]));
      if (named[axis]) reject(tokens_[i].column, "axis named twice");
      named[axis] = true;
      words[axis] = probe[axis];
      axes = true;
    }
    double radius = 0;
    int sense = 0;
    if (kind != "L") {
      for (; i < tokens_.size(); ++i) {
        const std::string_view text = tokens_[i].text;
        if (text == "DR+" || text == "DR-")
          sense = text[2] == '+' ? 1 : -1;
        else if (kind == "CR" && text[0] == 'R' && text != "R0" && text.size() > 1 && text[1] != 'L' && text[1] != 'R')
          radius = signed_number(text.substr(1), tokens_[i].column) * unit_;
        else
          break;
      }
      if (sense == 0 || (kind == "CR" && radius == 0))
        reject(tokens_[0].column, "an arc needs DR+ or DR-, and CR its R");
    }
    modes(i);
    AxisValues to = machine_coordinates_ ? core_.joints() : core_.here();
    const AxisValues from = to;
    for (std::size_t k = 0; k < 5; ++k) {
      if (named[k]) to[k] = words[k];
    }
    for (std::size_t k = 3; k < 5 && shortest_; ++k) {
      if (named[k] && rotary[k - 3]) to[k] = from[k] + std::remainder(to[k] - from[k], 2 * kPi);
    }
    const bool timed = block_seconds_ > 0;
    if (!fmax_ && !timed && axes && feed_ == 0) reject(tokens_[0].column, "feed not given");
    if (kind == "L") {
      const double seconds = fmax_ ? 0 : timed ? block_seconds_ : core_.seconds_at(to, feed_);
      if (machine_coordinates_ && axes)
        core_.move_joints(to, fmax_, seconds);
      else if (axes)
        core_.move(to, fmax_, seconds);
      return finish();
    }
    if (timed) reject(tokens_[0].column, "FT is understood on straight lines only");
    if (fmax_ || machine_coordinates_) reject(tokens_[0].column, "an arc takes neither FMAX nor M91");
    double cu = centre_[0], cv = centre_[1];
    const bool clockwise = sense < 0;
    if (kind == "CR")
      centre_by_radius(from[0], from[1], to[0], to[1], radius, clockwise, tokens_[0].column, cu, cv);
    else if (!has_centre_)
      reject(tokens_[0].column, "C needs a CC before it");
    const double r0 = std::hypot(from[0] - cu, from[1] - cv), r1 = std::hypot(to[0] - cu, to[1] - cv);
    if (r0 == 0 || std::abs(r1 - r0) > 0.016) reject(tokens_[0].column, "the arc's ends do not fit its centre");
    const double turn =
        turn_between(std::atan2(from[1] - cv, from[0] - cu), std::atan2(to[1] - cv, to[0] - cu), clockwise);
    core_.arc(to, 0, 1, cu, cv, turn, std::hypot(r0 * turn, to[2] - from[2]) * 60 / feed_);
    finish();
  }

  void call() {
    if (!is(1, "LBL") || (tokens_.size() != 3 && tokens_.size() != 4)) incomplete();
    const auto label = labels_.find(tokens_[2].text);
    if (label == labels_.end()) reject(tokens_[2].column, "label " + std::string(tokens_[2].text) + " is not set");
    if (tokens_.size() == 4) {
      const std::string_view text = tokens_[3].text;
      if (!text.starts_with("REP")) expect_end(3);
      double wanted = signed_number(text.substr(3), tokens_[3].column);
      if (!(wanted >= 1 && wanted <= 65534)) reject(tokens_[3].column, "REP counts from 1 to 65534");
      auto& left = repeats_.try_emplace(at_, static_cast<long>(wanted)).first->second;
      if (left-- > 0)
        next_ = label->second + 1;
      else
        repeats_.erase(at_);
      return;
    }
    if (calls_.size() >= kDeepestCall) reject(tokens_[0].column, "subprograms nested too deeply");
    calls_.push_back(next_);
    next_ = label->second + 1;
  }

  ReaderCore& core_;
  std::vector<std::string_view> lines_;
  std::size_t at_ = 0, next_ = 0;
  std::vector<Token> tokens_;
  long number_ = 0;
  bool continued_ = false, begun_ = false, ended_ = false, cycle_247_ = false;
  std::string_view name_;
  std::unordered_map<std::string_view, std::size_t> labels_;
  std::unordered_map<std::size_t, long> repeats_;
  std::vector<std::size_t> calls_;
  double unit_ = 1, feed_ = 0, rpm_ = 0;
  double block_seconds_ = 0;  ///< FT: of this block alone
  int tool_ = 0, spindle_ = 5;
  bool shortest_ = false, fmax_ = false, machine_coordinates_ = false, tcp_off_ = false, has_centre_ = false;
  std::vector<int> ends_;
  AxisValues preset_{}, shift_{}, centre_{};
};

}  // namespace

ReadResult read_heidenhain(std::string_view text, ReaderCore& core) {
  return HeidenhainReader(text, core).run();
}

}  // namespace lightmill::detail

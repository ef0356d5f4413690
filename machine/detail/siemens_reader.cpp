// Siemens 840D programs.
#include "machine/detail/reader_core.h"

namespace lightmill::detail {
namespace {

class SiemensReader {
 public:
  SiemensReader(std::string_view text, ReaderCore& core) : core_(core), lines_(split_lines(text)) {
    core_.set_offset({});  // G500 until an offset is named
  }

  ReadResult run() {
    return run_lines(
        core_, lines_.size(), ended_, "the file ends without M30, M17 or M2",
        [this](std::size_t at) {
          read_block(lines_[at]);
          return at + 1;
        },
        [] {});
  }

 private:
  enum class How : std::uint8_t { kModal, kAbsolute, kIncremental, kShortest };
  struct AxisWord {
    bool named = false;
    double value = 0;
    How how = How::kModal;
  };
  struct Words {
    std::array<AxisWord, 5> axes{};
    double i = 0, j = 0, k = 0, radius = 0, f = 0, s = 0;
    bool has_centre = false, has_radius = false, has_f = false, has_s = false;
    int motion = -1, d = -1, tool = -1, tcp = -1, offset = -1, spindle = -1, coolant = -1, stop = -1;
    bool suppress = false, dwell = false, change = false;
  };

  [[nodiscard]] int column() const { return static_cast<int>(p_ - begin_) + 1; }
  bool take(std::string_view word) {
    if (!std::string_view(p_, static_cast<std::size_t>(end_ - p_)).starts_with(word)) return false;
    p_ += word.size();
    return true;
  }
  double value() {
    const bool negative = p_ != end_ && *p_ == '-';
    if (p_ != end_ && (*p_ == '-' || *p_ == '+')) ++p_;
    double v = 0;
    if (!read_digits(p_, end_, v)) reject(column(), "bad number format");
    return negative ? -v : v;
  }
  [[nodiscard]] bool word_ends() const { return p_ == end_ || *p_ == ' ' || *p_ == '\t' || *p_ == ';'; }

  void read_block(std::string_view line) {
    if (line.size() > 512) reject(513, "block too long");
    begin_ = p_ = line.data();
    end_ = p_ + line.size();
    if (take("/")) return;  // the operator's switch is on
    Words words;
    bool any = false;
    std::uint32_t groups = 0;
    while (true) {
      while (p_ != end_ && (*p_ == ' ' || *p_ == '\t')) ++p_;
      if (p_ == end_ || *p_ == ';') break;
      read_word(words, groups);
      any = true;
    }
    if (any) perform(words);
  }

  void pass_corners(bool exact_stop, double tolerance_mm) {
    core_.exact_stop = exact_stop;
    core_.corner_tolerance_mm = tolerance_mm;
  }

  void read_word(Words& w, std::uint32_t& groups) {
    const int where = column();
    for (const std::string_view keyword :
         {"SUPA", "TRAORI", "TRAFOOF", "ORIWKS", "ORIMKS", "ORIAXES", "ORIVECT", "STOPRE", "SOFT", "FFWON", "G642"}) {
      const char* const before = p_;
      if (!take(keyword)) continue;
      if (!word_ends()) {
        p_ = before;
        break;
      }
      if (keyword == "SUPA") w.suppress = true;
      if (keyword == "G642") pass_corners(false, -1);
      if (keyword == "TRAORI") w.tcp = 1;
      if (keyword == "TRAFOOF") w.tcp = 0;
      if (keyword == "ORIAXES") axes_interpolate_ = true;
      if (keyword == "ORIVECT") reject(where, "only ORIAXES is followed: rotary axes turn evenly");
      return;
    }
    const bool cycle832 = take("CYCLE832(");
    if (cycle832 || take("MSG(")) {
      const char* const begin = p_;
      while (p_ != end_ && *p_ != ')') ++p_;
      if (cycle832) {
        double tolerance = 0;
        const char* at = begin;
        pass_corners(false, read_digits(at, p_, tolerance) && tolerance > 0 ? tolerance * unit_ : -1);
      }
      if (!take(")")) reject(where, "')' is missing");
      return;
    }
    const char letter = *p_++;
    if (letter < 'A' || letter > 'Z') reject(where, "a word must begin with a letter");
    if (const int axis = core_.axis_of(letter); axis >= 0) return axis_word(w, axis, where);
    if (letter == 'C' && take("R=")) {
      w.radius = value();
      w.has_radius = true;
      return;
    }
    const double v = value();
    if (!word_ends()) reject(column(), "words stand apart by blanks");
    const auto once = [&](int group) {
      if ((groups >> group & 1U) != 0) reject(where, "two codes of one group in a block");
      groups |= 1U << group;
    };
    switch (letter) {
      case 'N':
        return;
      case 'G':
        return g_code(w, v, where, once);
      case 'M':
        return m_code(w, v, where, once);
      case 'F':
        w.f = v;
        w.has_f = true;
        return once(20);
      case 'S':
        w.s = v;
        w.has_s = true;
        return once(21);
      case 'T':
      case 'D':
        if (v < 0 || v > 32767 || v != std::floor(v)) reject(where, "T and D are whole numbers");
        (letter == 'T' ? w.tool : w.d) = static_cast<int>(v);
        return once(letter == 'T' ? 22 : 23);
      case 'I':
      case 'J':
      case 'K':
        (letter == 'I' ? w.i : letter == 'J' ? w.j : w.k) = v;
        w.has_centre = true;
        return once(24 + (letter - 'I'));
      default:
        reject(where, std::string("word ") + letter + " is not known to this machine");
    }
  }

  // X1.5, X=1.5, C=DC(30), C=AC(30), X=IC(2)
  void axis_word(Words& w, int axis, int where) {
    AxisWord& word = w.axes[static_cast<std::size_t>(axis)];
    if (word.named) reject(where, "axis named twice");
    word.named = true;
    if (take("=")) {
      const bool known = take("DC(")   ? (word.how = How::kShortest, true)
                         : take("AC(") ? (word.how = How::kAbsolute, true)
                         : take("IC(") ? (word.how = How::kIncremental, true)
                                       : false;
      word.value = value();
      if (known && !take(")")) reject(column(), "')' is missing");
      if (word.how == How::kShortest && (axis < 3 || !(word.value >= 0 && word.value < 360))) {
        reject(where, "DC takes an angle from 0 to below 360 of a rotary axis");
      }
    } else {
      word.value = value();
    }
    if (!word_ends()) reject(column(), "words stand apart by blanks");
  }

  template <typename Once>
  void g_code(Words& w, double v, int where, const Once& once) {
    if (v != std::floor(v) || v < 0 || v > 999) reject(where, "unknown code");
    switch (const int code = static_cast<int>(v)) {
      case 0:
      case 1:
      case 2:
      case 3:
        w.motion = code;
        return once(1);
      case 4:
        w.dwell = true;
        return once(2);
      case 17:
        return once(6);
      case 40:
        return once(7);
      case 53:
      case 153:
        w.suppress = true;
        return once(9);
      case 54:
      case 55:
      case 56:
      case 57:
        w.offset = code - 53;
        return once(8);
      case 500:
        w.offset = 0;
        return once(8);
      case 505:
      case 506:
        w.offset = code - 500;
        return once(8);
      case 60:
      case 64:
        pass_corners(code == 60, code == 60 ? 0 : -1);
        return once(10);
      case 70:
      case 71:
      case 700:
      case 710:
        unit_ = code == 70 || code == 700 ? kMmPerInch : 1;
        return once(13);
      case 90:
      case 91:
        incremental_ = code == 91;
        return once(14);
      case 93:
      case 94:
        if ((code == 93) != inverse_time_) feed_ = 0;
        inverse_time_ = code == 93;
        return once(15);
      default:
        reject(where, "G" + std::to_string(code) + " is not known to this control");
    }
  }

  template <typename Once>
  void m_code(Words& w, double v, int where, const Once& once) {
    const int code = v == std::floor(v) && v >= 0 && v < 1000 ? static_cast<int>(v) : -1;
    switch (code) {
      case 3:
      case 4:
      case 5:
        w.spindle = code;
        return once(16);
      case 7:
      case 8:
      case 9:
        w.coolant = code;
        return once(17);
      case 6:
        w.change = true;
        return once(18);
      case 0:
      case 1:
      case 2:
      case 17:
      case 30:
        w.stop = code;
        return once(19);
      default:
        reject(where, "this M code is not known to this control");
    }
  }

  void perform(Words& w) {
    if (w.dwell) {
      if (!w.has_f || w.f < 0) reject(1, "G4 needs its seconds in F");
      core_.say(ProgramStep::kDwell, 0, w.f);
      w.has_f = false;
    }
    const bool feed_here = w.has_f;
    if (w.has_f) {
      if (w.f <= 0) reject(1, "the feed must be above 0");
      feed_ = inverse_time_ ? w.f : w.f * unit_;
    }
    if (w.has_s) {
      rpm_ = w.s;
      if (rpm_ < 0 || rpm_ > core_.machine.max_spindle_rpm) reject(1, "spindle speed out of the machine's range");
      if (spindle_ != 5 && w.spindle < 0) w.spindle = spindle_;
    }
    if (w.tool >= 0) {
      static_cast<void>(core_.tool_length(w.tool, 1));  // refuses an unknown tool
      selected_ = w.tool;
    }
    if (w.change) {
      if (core_.tcp()) reject(1, "TRAFOOF must come before a tool change");
      tool_ = selected_;
      spindle_ = 5;
      core_.say(ProgramStep::kChangeTool, tool_);
      core_.set_length(core_.tool_length(tool_, 1));  // D1 comes with the tool
    }
    if (w.spindle >= 0) {
      if (w.spindle != 5 && rpm_ == 0) reject(1, "no spindle speed");
      spindle_ = w.spindle;
      core_.say(ProgramStep::kSpindle, spindle_, spindle_ == 5 ? 0 : rpm_);
    }
    if (w.coolant >= 0) core_.say(ProgramStep::kCoolant, w.coolant);
    if (w.d >= 0) {
      if (w.d > 1) reject(1, "cutting edges D0 and D1 are known");
      core_.set_length(w.d == 0 ? 0 : core_.tool_length(tool_, 1));
    }
    if (w.offset >= 0)
      core_.set_offset(w.offset == 0 ? AxisValues{} : core_.setup.offsets[static_cast<std::size_t>(w.offset) - 1]);
    if (w.tcp >= 0) core_.set_tcp(w.tcp == 1);
    if (w.motion >= 0) motion_ = w.motion;
    if (std::any_of(w.axes.begin(), w.axes.end(), [](const AxisWord& a) { return a.named; })) move(w, feed_here);
    if (w.stop == 0 || w.stop == 1) core_.say(ProgramStep::kPause, w.stop);
    if (w.stop >= 2) {
      core_.say(ProgramStep::kEnd, w.stop);
      ended_ = true;
    }
  }

  void move(const Words& w, bool feed_here) {
    const AxisValues from = w.suppress ? core_.joints() : core_.here();
    AxisValues to = from;
    for (std::size_t i = 0; i < 5; ++i) {
      const AxisWord& word = w.axes[i];
      if (!word.named) continue;
      if (i >= 3 && core_.tcp() && !axes_interpolate_) reject(1, "rotary axes under TRAORI need ORIAXES");
      const double v = word.value * (i < 3 ? unit_ : kRadPerDegree);
      const bool incremental = word.how == How::kIncremental || (word.how == How::kModal && incremental_);
      to[i] = incremental ? from[i] + v : v;
      if (word.how == How::kShortest) to[i] = from[i] + std::remainder(v - from[i], 2 * kPi);
    }
    if (motion_ != 0) {
      if (inverse_time_ && !feed_here) reject(1, "F is missing in a block with inverse-time feed");
      if (feed_ == 0) reject(1, "feed not given");
    }
    const auto timed = [&](double seconds) { return motion_ == 0 ? 0 : inverse_time_ ? 60 / feed_ : seconds; };
    if (w.suppress) {
      if (core_.tcp()) reject(1, "SUPA before TRAFOOF");
      if (motion_ > 1) reject(1, "SUPA needs G0 or G1");
      if (w.axes[2].named) to[2] += core_.length_mm();  // frames are suppressed, the tool's length is not
      return core_.move_joints(to, motion_ == 0, timed(core_.seconds_at(to, feed_)));
    }
    if (motion_ <= 1) return core_.move(to, motion_ == 0, timed(core_.seconds_at(to, feed_)));
    const bool clockwise = motion_ == 2;
    double cu = from[0] + w.i * unit_, cv = from[1] + w.j * unit_;
    if (w.has_radius) {
      centre_by_radius(from[0], from[1], to[0], to[1], w.radius * unit_, clockwise, 1, cu, cv);
    } else if (!w.has_centre || w.k != 0) {
      reject(1, "an arc in G17 needs I and J or CR=");
    }
    const double r0 = std::hypot(from[0] - cu, from[1] - cv), r1 = std::hypot(to[0] - cu, to[1] - cv);
    if (r0 == 0 || std::abs(r1 - r0) > 0.01) reject(1, "the arc's ends do not fit its centre");
    const double turn =
        turn_between(std::atan2(from[1] - cv, from[0] - cu), std::atan2(to[1] - cv, to[0] - cu), clockwise);
    core_.arc(to, 0, 1, cu, cv, turn, timed(std::hypot(r0 * turn, to[2] - from[2]) * 60 / feed_));
  }

  ReaderCore& core_;
  std::vector<std::string_view> lines_;
  const char *begin_ = nullptr, *p_ = nullptr, *end_ = nullptr;
  bool ended_ = false, incremental_ = false, inverse_time_ = false, axes_interpolate_ = false;
  double unit_ = 1, feed_ = 0, rpm_ = 0;
  int motion_ = 1, tool_ = 0, selected_ = 0, spindle_ = 5;
};

}  // namespace

ReadResult read_siemens(std::string_view text, ReaderCore& core) {
  return SiemensReader(text, core).run();
}

}  // namespace lightmill::detail

#include "postproc/program_check.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <optional>
#include <set>

#include "design/core/text.h"
#include "postproc/detail/dialect.h"

namespace lightmill {
namespace {

constexpr std::size_t kMostFaults = 20;
constexpr std::size_t kLongestLine = 80;
constexpr std::string_view kRealTimeCharacters = "!?~%$";
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
constexpr double kTop_mm = 1e-6;    // how near to the machine's top is at the top
constexpr double kPlane_mm = 1e-3;  // rapids may graze the safe plane by rounding
constexpr double kFeedLoss = 3e-4;  // a feed word may be this much too slow by rounding down, and nothing too fast
constexpr double kDegree = kPi / 180;

struct Words {
  std::vector<int> g;  // times ten: G43.1 is 431
  std::vector<int> m;
  double x = kUnknown, y = kUnknown, z = kUnknown, outer = kUnknown, inner = kUnknown;
  double f = kUnknown, s = kUnknown, t = kUnknown, p = kUnknown, n = kUnknown, h = kUnknown, q = kUnknown;

  [[nodiscard]] bool has_g(int code) const { return std::find(g.begin(), g.end(), code) != g.end(); }
  [[nodiscard]] bool has_m(int code) const { return std::find(m.begin(), m.end(), code) != m.end(); }
  [[nodiscard]] bool linear() const { return !std::isnan(x) || !std::isnan(y) || !std::isnan(z); }
  [[nodiscard]] bool rotary() const { return !std::isnan(outer) || !std::isnan(inner); }
};

// Where the axes stand, as the text says: machine coordinates, mm and rad; NaN where it has not said yet.
struct Place {
  double x = kUnknown, y = kUnknown, z = kUnknown, outer = kUnknown, inner = kUnknown;
  bool top = false;
};

class Checker {
 public:
  Checker(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion, const ProgramOptions& options)
      : machine_(machine),
        setup_(setup),
        motion_(motion),
        options_(options),
        dialect_(detail::dialect_of(machine.controller)),
        half_unit_(0.51 * std::pow(10.0, -options.decimals)) {}

  std::vector<std::string> check(std::string_view text) {
    if (text.empty() || text.back() != '\n') complain("the last line does not end with a line feed");
    for (std::size_t begin = 0; begin < text.size() && faults_.size() < kMostFaults;) {
      ++line_;
      const std::size_t end = std::min(text.find('\n', begin), text.size());
      read_line(text.substr(begin, end - begin));
      begin = end + 1;
    }
    if (faults_.size() < kMostFaults) at_end();
    return std::move(faults_);
  }

 private:
  [[nodiscard]] Place unknown_place() const {
    Place place;
    if (!machine_.has_rotary()) place.outer = place.inner = 0;
    return place;
  }

  void complain(const std::string& what) {
    if (faults_.size() < kMostFaults) faults_.push_back("line " + std::to_string(line_) + ": " + what);
  }

  void read_line(std::string_view line) {
    if (dialect_.percent && line == "%") {
      if (line_ != 1 && !ended_) complain("% ends the program before M30");
      ++percents_;
      return;
    }
    if (dialect_.program_number && line_ == 2) {
      if (line.size() != 5 || line.front() != 'O' || line.find_first_not_of("0123456789", 1) != std::string_view::npos) {
        complain("the program's number is missing: O and four digits");
      }
      return;
    }
    if (line.size() > kLongestLine) complain("longer than 80 characters");
    for (const char c : line) {
      if (c < ' ' || c > '~') return complain("a character that is not printable ASCII");
      if (kRealTimeCharacters.find(c) != std::string_view::npos) {
        return complain(std::string("'") + c + "' would act as a real-time command");
      }
    }
    if (line.empty()) return complain("an empty line");
    if (line.front() == '(') {
      if (line.find(')') != line.size() - 1 || line.rfind('(') != 0)
        complain("a comment that does not end with its line");
      return;
    }
    if (ended_) return complain("a block after the program's end");
    if (const auto words = read_words(line)) run(*words);
  }

  // Words of a block, or nothing (after a complaint) if a character is not part of one.
  std::optional<Words> read_words(std::string_view line) {
    Words words;
    std::set<char> seen;
    const char* at = line.data();
    const char* const end = at + line.size();
    while (at != end) {
      if (*at == ' ') {
        ++at;
        continue;
      }
      const char letter = *at++;
      const char* digits = at;
      if (digits != end && *digits == '-') ++digits;
      double value = 0;
      const auto [stop, error] = std::from_chars(at, end, value, std::chars_format::fixed);
      if (letter < 'A' || letter > 'Z' || digits == end || *digits < '0' || *digits > '9' || error != std::errc()) {
        complain("not words of a letter and a number: '" + std::string(line) + "'");
        return std::nullopt;
      }
      at = stop;
      const bool code = letter == 'G' || letter == 'M';
      if (!code && !seen.insert(letter).second) complain(std::string("two words ") + letter);
      if (letter == 'G') {
        words.g.push_back(static_cast<int>(std::lround(value * 10)));
      } else if (letter == 'M') {
        words.m.push_back(static_cast<int>(std::lround(value)));
      } else if (dialect_.decimal_point && std::string_view("XYZABCF").find(letter) != std::string_view::npos &&
                 std::string_view(digits, stop).find('.') == std::string_view::npos) {
        complain(std::string(1, letter) + " without a decimal point");
      } else if (machine_.has_rotary() && letter == machine_.outer.letter) {
        words.outer = value;
      } else if (machine_.has_rotary() && letter == machine_.inner.letter) {
        words.inner = value;
      } else if (double* slot = scalar(words, letter)) {
        *slot = value;
      } else {
        complain(std::string("a word ") + letter + " that this machine does not know");
      }
    }
    return words;
  }

  static double* scalar(Words& words, char letter) {
    switch (letter) {
      case 'X':
        return &words.x;
      case 'Y':
        return &words.y;
      case 'Z':
        return &words.z;
      case 'F':
        return &words.f;
      case 'S':
        return &words.s;
      case 'T':
        return &words.t;
      case 'P':
        return &words.p;
      case 'H':
        return &words.h;
      case 'Q':
        return &words.q;
      case 'N':
        return &words.n;
      default:
        return nullptr;
    }
  }

  // One block, in the order in which a controller acts on its words [NIST RS274NGC, table 8].
  void run(const Words& words) {
    if (!std::isnan(words.n)) {
      if (!(words.n > last_n_)) complain("block numbers do not grow");
      last_n_ = words.n;
    }
    if (words.has_g(930) && words.has_g(940)) complain("G93 and G94 in one block");
    if (words.has_g(930)) inverse_time_ = true;
    if (words.has_g(940)) {
      inverse_time_ = false;
      feed_ = kUnknown;
    }
    feed_word(words);
    if (!std::isnan(words.s)) {
      if (words.s < machine_.min_spindle_rpm || words.s > machine_.max_spindle_rpm)
        complain("S outside the spindle's range");
      if (std::abs(words.s - motion_.spindle_rpm) > 0.5) complain("S is not the speed of the pass");
      speed_ = words.s;
    }
    if (!std::isnan(words.t)) selected_ = words.t;
    for (const int m : words.m) run_m(m);
    if (words.has_g(40)) {
      if (!(words.p > 0)) complain("a dwell without P");
      if (words.p * (dialect_.dwell_in_ms ? 1e-3 : 1) + 1e-9 >= std::max(options_.warm_up_s, machine_.spindle_start_s) && spindle_) dwelled_ = true;
    } else if (!std::isnan(words.p) && !words.has_g(640)) {
      complain("P without a dwell");
    }
    bool absolute = false;
    bool tool_length = false;
    for (const int g : words.g) {
      switch (g) {
        case 0:
        case 10:
          mode_ = g / 10;
          break;
        case 40:
        case 930:
        case 940:
          break;
        case 170:
        case 210:
        case 400:
        case 800:
        case 900:
          modal_.insert(g);
          break;
        case 490:
          modal_.insert(g);
          length_mm_ = 0;
          break;
        case 431:
          if (dialect_.length_in_table) complain("G43.1 is unknown to this controller");
          tool_length = true;
          break;
        case 430:
          if (!dialect_.length_in_table) complain("G43 needs a tool table, which this controller has not");
          if (tool_ < 0 || words.h != tool_) complain("G43 H is not the tool in the spindle");
          if (words.linear() || words.rotary()) complain("G43 with axis words");
          length_mm_ = motion_.cutter.length_mm;  // the operator's entry in the table
          measured_ = true;
          break;
        case 640:
          if (dialect_.modes.empty() || !(words.p >= 0 && words.p <= 0.002 + 1e-9)) complain("G64 P is not what was asked for");
          modal_.insert(g);
          break;
        case 51:
          if (dialect_.smoothing_on.empty() || (words.q != 0 && words.q != 1)) complain("G5.1 Q is not 0 or 1");
          smooth_ = words.q == 1;
          break;
        case 530:
          absolute = true;
          break;
        default:
          if (g == 10 * setup_.work_offset) {
            modal_.insert(540);
          } else {
            complain("G" + compact(g / 10.0, 1) + " has no place in this program");
          }
      }
    }
    if (tool_length) {
      if (std::abs(words.z - motion_.cutter.length_mm) > half_unit_) complain("G43.1 is not the tool's length");
      if (words.rotary() || !std::isnan(words.x) || !std::isnan(words.y)) complain("G43.1 with other axis words");
      if (tool_ != motion_.cutter.number) complain("tool length before the tool is in the spindle");
      length_mm_ = words.z;
      measured_ = true;
      return;
    }
    if (words.linear() || words.rotary()) {
      move(words, absolute);
    } else if (absolute) {
      complain("G53 without an axis word");
    }
  }

  void feed_word(const Words& words) {
    if (std::isnan(words.f)) return;
    if (!(words.f > 0)) complain("F must be greater than 0");
    feed_ = words.f;
  }

  void run_m(int m) {
    switch (m) {
      case 3:
        if (!(speed_ > 0)) complain("M3 without S");
        spindle_ = true;
        break;
      case 5:
        spindle_ = dwelled_ = false;
        break;
      case 6:
        if (selected_ != motion_.cutter.number) complain("M6 without the T word of the pass");
        if (!place_.top && !changed_down_) complain("a tool change below the machine's top");
        if (!(std::abs(place_.x - machine_.tool_change_mm.x()) <= half_unit_ &&
              std::abs(place_.y - machine_.tool_change_mm.y()) <= half_unit_ &&
              std::abs(place_.z - machine_.tool_change_mm.z()) <= half_unit_)) {
          complain("a tool change away from the tool change position");
        }
        if (spindle_) complain("a tool change with the spindle on");
        tool_ = static_cast<int>(selected_);
        place_ = unknown_place();  // the operator may move the machine
        risen_ = false;
        break;
      case 7:
      case 8:
        air_ = true;
        break;
      case 9:
        air_ = false;
        break;
      case 30:
        ended_ = true;
        if (!place_.top) complain("the program ends below the machine's top");
        if (spindle_ || air_) complain("the program ends with spindle or air on");
        if (smooth_) complain("the program ends with smoothing on");
        if (machine_.has_rotary() && !(place_.outer == 0 && place_.inner == 0)) {
          complain("the program ends with rotary axes away from zero");
        }
        if (length_mm_ != 0) complain("the program ends with a tool length in force: G49 is missing");
        if (inverse_time_) complain("the program ends in G93");
        break;
      default:
        complain("M" + std::to_string(m) + " has no place in this program");
    }
  }

  void move(const Words& words, bool absolute) {
    if (mode_ < 0) return complain("an axis word before G0 or G1");
    for (const int needed : {210, 900, 170, 400, 800, 540}) {
      if (!modal_.contains(needed))
        return complain("a move before the safe modes are set (G21 G90 G17 G40 G49 G80 and the work offset)");
    }
    const Place from = place_;
    Place to = from;
    if (absolute) {
      if (mode_ != 0) complain("G53 in a feed move");
      if (words.rotary()) complain("G53 with a rotary word");
      if (!std::isnan(words.x)) to.x = words.x;
      if (!std::isnan(words.y)) to.y = words.y;
      if (!std::isnan(words.z)) to.z = words.z;
    } else {
      if (!std::isnan(words.x)) to.x = words.x + setup_.origin_mm.x();
      if (!std::isnan(words.y)) to.y = words.y + setup_.origin_mm.y();
      if (!std::isnan(words.z)) to.z = words.z + setup_.origin_mm.z() + length_mm_;
    }
    if (!std::isnan(words.outer)) to.outer = words.outer * kDegree;
    if (!std::isnan(words.inner)) to.inner = words.inner * kDegree;
    to.top = absolute && !std::isnan(words.z) ? std::abs(to.z - machine_.retract_z_mm) <= kTop_mm
                                              : from.top && (std::isnan(words.z) || absolute);
    place_ = to;
    if (!risen_ && !(absolute && to.top && words.linear() && std::isnan(words.x) && std::isnan(words.y))) {
      complain("a move before the machine is at its top");
    }
    risen_ = true;
    if (tool_ < 0 && !absolute) complain("a move in work coordinates before the tool change");
    within_limits(to);
    if (tool_ < 0) {
      changed_down_ = absolute && !to.top;  // on the way to a tool change below the top
      return;
    }
    if (mode_ == 0) {
      rapid(words, from, to);
    } else {
      feed(words, to);
    }
    follow(from, to);
  }

  void within_limits(const Place& to) {
    const auto check = [&](char letter, double value, double least, double most, double scale) {
      if (value < least - half_unit_ * scale || value > most + half_unit_ * scale) {
        complain(std::string(1, letter) + " leaves the machine's travel");
      }
    };
    check('X', to.x, machine_.x.min_mm, machine_.x.max_mm, 1);
    check('Y', to.y, machine_.y.min_mm, machine_.y.max_mm, 1);
    check('Z', to.z, machine_.z.min_mm, machine_.z.max_mm, 1);
    check(machine_.outer.letter, to.outer, machine_.outer.min_rad, machine_.outer.max_rad, kDegree);
    check(machine_.inner.letter, to.inner, machine_.inner.min_rad, machine_.inner.max_rad, kDegree);
  }

  void rapid(const Words& words, const Place& from, const Place& to) {
    if (words.rotary()) {
      if (!from.top || !to.top) complain("a rapid turns the table below the machine's top");
      return;
    }
    if (!measured_ && !to.top) complain("a rapid down before the tool length is set");
    const bool straight_up = std::isnan(words.x) && std::isnan(words.y) && to.z >= from.z;
    if (straight_up || to.top) return;
    if (!is_high(from) || !is_high(to)) complain("a rapid below the safe plane");
  }

  // At the machine's top, or the tip at or above the safe plane of the workpiece.
  [[nodiscard]] bool is_high(const Place& place) const {
    if (place.top) return true;
    const ToolPose pose = forward(machine_, setup_, length_mm_, {place.x, place.y, place.z, place.outer, place.inner});
    return pose.tip_mm.z() >= motion_.clearance_z_mm - kPlane_mm;  // false for a place not known yet
  }

  void feed(const Words& words, const Place&) {
    if (!dialect_.smoothing_on.empty() && !smooth_) complain("a feed move without G5.1 Q1");
    if (!dialect_.modes.empty() && !modal_.contains(640)) complain("a feed move without G64 P");
    if (!spindle_) complain("a feed move with the spindle off");
    if (!dwelled_) complain("a feed move before the spindle has had time to start");
    if (!measured_) complain("a feed move before the tool length is set");
    const std::string& coolant = motion_.cutter.coolant;
    if (!coolant.empty() && coolant != "none" && !air_) complain("a feed move without " + coolant);
    if (inverse_time_) {
      if (std::isnan(words.f)) complain("a G93 block without F");
    } else {
      if (std::isnan(feed_)) complain("a feed move without F");
      if (words.rotary()) complain("a rotary word in a feed move outside G93");
    }
  }

  // The plan, block by block
  // -------------------------------------------------------------------------------------------

  [[nodiscard]] bool is_at(const JointPosition& joints, const Place& place) const {
    const bool z = place.top ? joints.z_mm == machine_.retract_z_mm : std::abs(joints.z_mm - place.z) <= half_unit_;
    return z && std::abs(joints.x_mm - place.x) <= half_unit_ && std::abs(joints.y_mm - place.y) <= half_unit_ &&
           std::abs(joints.outer_rad - place.outer) <= half_unit_ * kDegree &&
           std::abs(joints.inner_rad - place.inner) <= half_unit_ * kDegree;
  }

  void follow(const Place& from, const Place& to) {
    const auto& moves = motion_.moves;
    while (next_ < moves.size() && !is_at(moves[next_].joints, to) && is_at(moves[next_].joints, from)) ++next_;
    if (next_ < moves.size() && is_at(moves[next_].joints, to)) {
      const AxisMove& planned = moves[next_];
      if ((planned.kind == MoveKind::kRapid) != (mode_ == 0)) complain("rapid and feed are mixed up");
      if (mode_ == 1) check_time(planned, from, to);
      ++next_;
      return;
    }
    // The turning half of a block that was split for its short way: the axes of the next planned move, X, Y, Z as before.
    if (mode_ == 1 && inverse_time_ && next_ < moves.size() && moves[next_].kind != MoveKind::kRapid) {
      const JointPosition& j = moves[next_].joints;
      const bool turned = std::abs(j.outer_rad - to.outer) <= half_unit_ * kDegree &&
                          std::abs(j.inner_rad - to.inner) <= half_unit_ * kDegree;
      const bool stood = to.x == from.x && to.y == from.y && to.z == from.z;
      if (turned && stood && Vec3(j.x_mm - to.x, j.y_mm - to.y, j.z_mm - to.z).norm() < dialect_.least_linear_mm + 2 * half_unit_) {
        check_time(moves[next_], from, to);
        return;
      }
    }
    // Rapids at the top come in several blocks, and the last retract is not part of the plan.
    if (mode_ == 0 && to.top && (next_ == moves.size() || moves[next_].joints.z_mm == machine_.retract_z_mm)) return;
    complain(next_ == moves.size()
                 ? "a move after the last one planned"
                 : "the block does not end where the plan's move " + std::to_string(next_ + 1) + " ends");
  }

  void check_time(const AxisMove& planned, const Place& from, const Place& to) {
    const double length = std::hypot(to.x - from.x, to.y - from.y, to.z - from.z);
    // Rounded coordinates change a short block's length; only its time in G93 is exact.
    const double blur = inverse_time_ ? 0 : 4 * half_unit_ / std::max(length, half_unit_);
    const double seconds = inverse_time_ ? 60 / feed_ : 60 * length / feed_;
    if (std::isnan(seconds) || blur > 0.5) return;
    if (seconds < planned.seconds * (1 - 1e-6 - blur)) complain("F is faster than planned");
    if (seconds > planned.seconds * (1 + kFeedLoss + blur)) complain("F is slower than planned");
  }

  void at_end() {
    if (!ended_) complain("M30 is missing");
    if (dialect_.percent && percents_ != 2) complain("the program must stand between two lines of %");
    const auto& moves = motion_.moves;
    while (next_ < moves.size() && next_ > 0 && close(moves[next_].joints, moves[next_ - 1].joints)) ++next_;
    if (next_ < moves.size()) {
      complain("the program ends before the plan's move " + std::to_string(next_ + 1) + " of " +
               std::to_string(moves.size()));
    }
  }

  // Moves that round to nothing at the end of a plan are not in the text.
  [[nodiscard]] bool close(const JointPosition& a, const JointPosition& b) const {
    return is_at(a, {b.x_mm, b.y_mm, b.z_mm, b.outer_rad, b.inner_rad, false});
  }

  const MachineModel& machine_;
  const WorkSetup& setup_;
  const AxisMotion& motion_;
  const ProgramOptions& options_;
  const detail::Dialect& dialect_;
  double half_unit_;  // half a unit of the last decimal and a little for rounding

  std::vector<std::string> faults_;
  long line_ = 0;
  double last_n_ = -1;
  // Modal state.
  std::set<int> modal_;
  int mode_ = -1;
  bool inverse_time_ = false;
  double feed_ = kUnknown;
  double speed_ = 0;
  double selected_ = -1;
  int tool_ = -1;
  double length_mm_ = 0;
  bool measured_ = false;
  bool spindle_ = false, dwelled_ = false, air_ = false;
  bool risen_ = false;         // the machine has been sent to its top since the start or the tool change
  bool changed_down_ = false;  // went down to a tool change position by machine coordinates
  bool smooth_ = false;
  bool ended_ = false;
  int percents_ = 0;
  Place place_ = unknown_place();
  std::size_t next_ = 0;  // planned move that the next block must fulfil
};

}  // namespace

std::vector<std::string> check_program_text(const MachineModel& machine, const WorkSetup& setup,
                                            const AxisMotion& motion, std::string_view text,
                                            const ProgramOptions& options) {
  return Checker(machine, setup, motion, options).check(text);
}

}  // namespace lightmill

#include "postproc/program_check.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "design/core/text.h"
#include "postproc/detail/dialect.h"
#include "postproc/detail/program_blocks.h"
#include "postproc/detail/trunnion.h"

namespace lightmill {
namespace {

using detail::Block;
using detail::kNotSaid;
using detail::Language;
using detail::Order;

constexpr std::size_t kMostFaults = 20;
constexpr double kPlane_mm = 1e-3;    // rapids may graze the safe plane by rounding
constexpr double kFeedLoss = 3e-4;    // a feed word may be this much too slow by rounding down, and nothing too fast
constexpr double kTimeLoss_s = 1e-3;  // of an FT word, rounded up
constexpr std::size_t kSamplesPerMove = 4;  // of an arc that stands for several moves
constexpr double kDegree = kPi / 180;
constexpr double kPoseSlack = 10;  // in half units: axes follow from a rounded tip and rounded angles under TCP

// Where the axes stand, as the text says: machine coordinates, mm and rad; NaN where it has not said yet. `point` is
// what X, Y, Z guide under tool-centre-point control, in the workpiece frame.
struct Place {
  double x = kNotSaid, y = kNotSaid, z = kNotSaid, outer = kNotSaid, inner = kNotSaid;
  Vec3 point = Vec3::Constant(kNotSaid);
  bool top = false;
  [[nodiscard]] JointPosition joints() const { return {x, y, z, outer, inner}; }
};

// An arc as the text has it: `offset` leads from its start to its centre, in the plane across axis `normal`.
struct WrittenArc {
  Vec3 from, to;
  int normal, a, b;                    // a turns to b
  Eigen::Vector2d centre, start, end;  // the ends seen from the centre
  double turn_rad = 0;

  WrittenArc(const Vec3& first, const Vec3& last, const std::array<double, 3>& offset, int across, bool clockwise)
      : from(first), to(last), normal(across), a((across + 1) % 3), b((across + 2) % 3) {
    centre = {first[a] + offset[static_cast<std::size_t>(a)], first[b] + offset[static_cast<std::size_t>(b)]};
    start = seen(first);
    end = seen(last);
    const double sense = clockwise ? -1 : 1;
    double turn = std::atan2(start.x() * end.y() - start.y() * end.x(), start.dot(end)) * sense;
    if (turn <= 0) turn += 2 * kPi;
    turn_rad = sense * turn;
  }
  [[nodiscard]] Eigen::Vector2d seen(const Vec3& p) const { return Eigen::Vector2d(p[a], p[b]) - centre; }
  [[nodiscard]] Vec3 at(double t) const {
    const double c = std::cos(t * turn_rad), s = std::sin(t * turn_rad),
                 grown = 1 + t * (end.norm() / start.norm() - 1);
    Vec3 p = from + t * (to - from);
    p[a] = centre.x() + grown * (c * start.x() - s * start.y());
    p[b] = centre.y() + grown * (s * start.x() + c * start.y());
    return p;
  }
  [[nodiscard]] double length_mm() const { return std::hypot(turn_rad * start.norm(), to[normal] - from[normal]); }
};

// Both ways: points along the arc from the planned line, in its order, and planned ends of moves from the arc.
double distance_between(const WrittenArc& arc, std::span<const Vec3> planned) {
  const auto from_piece = [&](const Vec3& at, std::size_t i) {
    const Vec3 way = planned[i] - planned[i - 1];
    const double along = std::clamp((at - planned[i - 1]).dot(way) / std::max(way.squaredNorm(), 1e-18), 0.0, 1.0);
    return (at - planned[i - 1] - along * way).norm();
  };
  double off = 0;
  std::size_t piece = 1;
  const std::size_t samples = kSamplesPerMove * (planned.size() - 1);
  for (std::size_t i = 0; i <= samples; ++i) {
    const Vec3 at = arc.at(static_cast<double>(i) / static_cast<double>(samples));
    double nearest = from_piece(at, piece);
    while (piece + 1 < planned.size()) {
      const double next = from_piece(at, piece + 1);
      if (next > nearest) break;
      nearest = next;
      ++piece;
    }
    off = std::max(off, nearest);
  }
  for (const Vec3& p : planned) off = std::max(off, std::abs(arc.seen(p).norm() - arc.start.norm()));
  return off;
}

enum class Tcp { kUnknown, kOff, kOn };

class Checker {
 public:
  Checker(const MachineModel& machine, const WorkSetup& setup, std::span<const AxisMotion> passes,
          const ProgramOptions& options)
      : machine_(machine),
        setup_(setup),
        passes_(passes),
        options_(options),
        dialect_(detail::dialect_of(machine.controller)),
        half_unit_(0.51 * std::pow(10.0, -options.decimals)),
        reader_(machine, dialect_,
                {[this](const std::string& what) { complain(what); }, [this](const Block& block) { run(block); }}) {
    for (const AxisMotion& pass : passes) wants_tcp_.push_back(uses_tcp(machine, pass, options));
    if (!machine.has_tcp) tcp_ = Tcp::kOff;
    place_ = unknown_place();
    for (const Order order : {Order::kMetric, Order::kAbsolute, Order::kPlane, Order::kNoRadius, Order::kOffset}) {
      needed_ |= bit(order);
    }
    if (dialect_.language == Language::kRs274) needed_ |= bit(Order::kNoCycle) | bit(Order::kLengthOff);
    if (dialect_.language == Language::kConversational) needed_ &= ~(bit(Order::kAbsolute) | bit(Order::kPlane));
  }

  std::vector<std::string> check(std::string_view text) {
    if (text.empty() || text.back() != '\n') complain("the last line does not end with a line feed");
    for (std::size_t begin = 0; begin < text.size() && faults_.size() < kMostFaults;) {
      const std::size_t end = std::min(text.find('\n', begin), text.size());
      reader_.line(text.substr(begin, end - begin));
      begin = end + 1;
    }
    if (faults_.size() < kMostFaults) at_end();
    return std::move(faults_);
  }

 private:
  static constexpr std::uint64_t bit(Order order) { return 1ULL << static_cast<int>(order); }

  [[nodiscard]] Place unknown_place() const {
    Place place;
    if (!machine_.has_rotary()) place.outer = place.inner = 0;
    return place;
  }

  void complain(const std::string& what) {
    if (faults_.size() < kMostFaults) faults_.push_back("line " + std::to_string(reader_.line_number()) + ": " + what);
  }

  // The pass whose tool is in the spindle, or the one to come.
  [[nodiscard]] const AxisMotion& pass() const { return passes_[std::min(pass_, passes_.size() - 1)]; }
  [[nodiscard]] bool wants_tcp() const { return wants_tcp_[std::min(pass_, passes_.size() - 1)]; }
  [[nodiscard]] bool air_wanted() const {
    const std::string& coolant = pass().cutter.coolant;
    return !coolant.empty() && coolant != "none";
  }

  // One block, in the order in which a controller acts on its words [NIST RS274NGC, table 8].
  void run(const Block& block) {
    if (ended_) return complain("a block after the program's end");
    modal_ |= block.orders;
    if (block.has(Order::kBlank)) {
      if (block.has(Order::kAbsolute) != (blanks_ == 1 && dialect_.language == Language::kHeidenhainIso)) {
        complain("the blank's corners are out of order");
      }
      blank_[std::min(blanks_++, 1)] = {block.axis[0], block.axis[1], block.axis[2]};
      return;
    }
    if (block.has(Order::kInverse) && block.has(Order::kPerMinute)) complain("G93 and G94 in one block");
    if (block.has(Order::kInverse)) inverse_time_ = true;
    if (block.has(Order::kPerMinute)) {
      inverse_time_ = false;
      feed_ = kNotSaid;
    }
    if (block.f == block.f) {
      if (!(block.f > 0)) complain("F must be greater than 0");
      feed_ = block.f;
    }
    if (block.s == block.s) {
      if (block.s < machine_.min_spindle_rpm || block.s > machine_.max_spindle_rpm)
        complain("S outside the spindle's range");
      speed_ = block.s;
    }
    if (block.t == block.t) selected_ = block.t;
    if (block.m_codes != 0) run_m(block);
    if (block.s == block.s && std::abs(block.s - pass().spindle_rpm) > 0.5) complain("S is not the speed of the pass");
    if (block.has(Order::kDwell) && spindle_ &&
        block.time + 1e-9 >= std::max(options_.warm_up_s, machine_.spindle_start_s)) {
      dwelled_ = true;
    }
    if (block.has(Order::kOffset) && block.offset != setup_.work_offset) complain("the wrong work offset");
    run_length_and_tcp(block);
    run_modes(block);
    if (block.has(Order::kRapid)) mode_ = 0;
    if (block.has(Order::kFeed)) mode_ = 1;
    if (block.has(Order::kClockwise)) mode_ = 2;
    if (block.has(Order::kCounterClockwise)) mode_ = 3;
    if (mode_ < 2 && !(std::isnan(block.centre[0]) && std::isnan(block.centre[1]) && std::isnan(block.centre[2]))) {
      complain("the centre of an arc without G2 or G3");
    }
    if (block.linear() || block.rotary()) {
      move(block);
    } else if (block.has(Order::kMachine)) {
      complain("machine coordinates without an axis word");
    } else if (block.has(Order::kFeed) && dialect_.language == Language::kConversational) {
      complain("L without an axis word");
    }
    if (block.has_m(30)) end();
  }

  void run_length_and_tcp(const Block& block) {
    const Cutter& cutter = pass().cutter;
    if (block.has(Order::kLengthOff)) length_mm_ = 0;
    if (block.has(Order::kNoLength)) {
      length_mm_ = 0;
    }
    if (block.has(Order::kLengthSaid)) {
      if (std::abs(block.length - cutter.length_mm) > half_unit_) complain("G43.1 is not the tool's length");
      if (tool_ != cutter.number) complain("tool length before the tool is in the spindle");
      length_mm_ = block.length;
      measured_ = true;
    }
    if (block.has(Order::kLengthOn)) {
      if (plane_ != 2) complain("the tool length is called outside G17");
      if (tool_ < 0 || (block.length_of != 0 && block.length_of != tool_))
        complain("G43 H is not the tool in the spindle");
      const double delta = dialect_.tcp_ball_centre && wants_tcp() ? -cutter.radius_mm() : 0;
      if (std::abs(block.delta - delta) > half_unit_)
        complain("DL does not take the length to the point that is programmed");
      length_mm_ = cutter.length_mm + block.delta;  // the operator's entry in the table
      measured_ = true;
    }
    if (block.has(Order::kTcpOff)) tcp_ = Tcp::kOff;
    if (block.has(Order::kTcpOn)) {
      if (!measured_ || length_mm_ == 0) complain("tool-centre-point control before the tool length is set");
      if (!wants_tcp()) complain("tool-centre-point control was not asked for");
      if (tcp_ != Tcp::kOff) complain("tool-centre-point control is switched on twice");
      // Planned moves to where the machine stands already are compared here, while words are axes.
      while (next_ < pass().moves.size() && is_at(pass().moves[next_].joints, place_)) ++next_;
      tcp_ = Tcp::kOn;
      framed_ = false;
      if (dialect_.language == Language::kSiemens) modal_ &= ~bit(Order::kOffset);
      place_.point = detail::tip_at(machine_, setup_, length_mm_, place_.joints());
    }
    if (block.has(Order::kTcpFrame)) framed_ = tcp_ == Tcp::kOn;
  }

  void run_modes(const Block& block) {
    if (block.has(Order::kSmoothOn)) {
      smooth_ = true;
      if (block.smoothing > options_.smoothing_mm + 1e-9) complain("the tolerance is wider than what was asked for");
      if (block.smoothing_angle > options_.smoothing_deg + 1e-9) {
        complain("the angular tolerance is wider than what was asked for");
      }
    }
    if (block.has(Order::kSmoothOff)) smooth_ = false;
    if (block.has(Order::kPlane)) plane_ = 2;
    if (block.has(Order::kPlaneZx)) plane_ = 1;
    if (block.has(Order::kPlaneYz)) plane_ = 0;
    if (block.has(Order::kShortWay)) short_way_ = true;
    if (block.has(Order::kLongWay)) short_way_ = false;
  }

  void run_m(const Block& block) {
    constexpr std::uint64_t known = 1ULL << 3 | 1ULL << 5 | 1ULL << 6 | 1ULL << 7 | 1ULL << 8 | 1ULL << 9 | 1ULL << 30;
    if ((block.m_codes & ~known) != 0) complain("an M code that has no place in this program");
    if (block.has_m(6)) change_tool();
    if (block.has_m(3)) {
      if (!(speed_ > 0)) complain("M3 without S");
      spindle_ = true;
    }
    if (block.has_m(7) || block.has_m(8)) {
      if (block.has_m(8) != (pass().cutter.coolant == "flood"))
        complain("M7 and M8 are mixed up: not what the cutter asks for");
      air_ = true;
    }
    if (block.has_m(5)) spindle_ = dwelled_ = false;
    if (block.has_m(9)) air_ = false;
  }

  void change_tool() {
    if (tool_ >= 0) {
      finish_pass();
      ++pass_;
      if (pass_ >= passes_.size()) complain("a tool change after the last pass");
    }
    next_ = 0;
    if (selected_ != pass().cutter.number) complain("M6 without the T word of the pass");
    if (tcp_ != Tcp::kOff) complain("a tool change under tool-centre-point control");
    if (!place_.top && !changed_down_) complain("a tool change below the machine's top");
    if (!(std::abs(place_.x - machine_.tool_change_mm.x()) <= half_unit_ &&
          std::abs(place_.y - machine_.tool_change_mm.y()) <= half_unit_ &&
          std::abs(place_.z - machine_.tool_change_mm.z()) <= half_unit_)) {
      complain("a tool change away from the tool change position");
    }
    if (spindle_) complain("a tool change with the spindle on");
    if (air_) complain("a tool change with the air on");
    if (smooth_ && dialect_.name != "linuxcnc") complain("a tool change with smoothing on");
    tool_ = static_cast<int>(selected_);
    measured_ = false;
    length_mm_ = 0;
    place_ = unknown_place();  // the operator may move the machine
    risen_ = false;
  }

  void end() {
    ended_ = true;
    if (!place_.top) complain("the program ends below the machine's top");
    if (spindle_ || air_) complain("the program ends with spindle or air on");
    if (smooth_ && dialect_.name != "linuxcnc") complain("the program ends with smoothing on");
    if (machine_.has_rotary() && !(home(place_.outer, machine_.outer) && home(place_.inner, machine_.inner))) {
      complain("the program ends with rotary axes away from zero");
    }
    if (length_mm_ != 0 && dialect_.language == Language::kRs274) {
      complain("the program ends with a tool length in force: G49 is missing");
    }
    if (tcp_ != Tcp::kOff) complain("the program ends under tool-centre-point control");
    if (short_way_) complain("the program ends with M126 in force");
    if (inverse_time_) complain("the program ends in G93");
    if (plane_ != 2) complain("the program ends outside G17");
  }

  [[nodiscard]] static bool endless(const RotaryAxis& axis) { return std::isinf(axis.max_rad); }
  [[nodiscard]] bool home(double angle, const RotaryAxis& axis) const {
    return turns_forgotten(axis) ? std::abs(std::remainder(angle, 2 * kPi)) < 1e-9 : angle == 0;
  }

  // Where a rotary word leads: endless axes may be told to go the short way, whatever turn is named.
  [[nodiscard]] double turned(double from, double degrees, const RotaryAxis& axis, bool shortest) const {
    const double to = degrees * kDegree;
    if (!shortest || !endless(axis) || std::isnan(from)) return to;
    return from + std::remainder(to - from, 2 * kPi);
  }

  void move(const Block& block) {
    if (mode_ < 0) return complain("an axis word before G0 or G1");
    if ((modal_ & needed_) != needed_) {
      return complain("a move before the safe modes are set (G21 G90 G17 G40 G49 G80 and the work offset)");
    }
    const bool absolute = block.has(Order::kMachine);
    if (absolute && tcp_ != Tcp::kOff) complain("machine coordinates before tool-centre-point control is off");
    const Place from = place_;
    Place to = from;
    const bool shortest = short_way_ || block.short_way;
    if (dialect_.tcp_ball_centre && block.rotary() && machine_.has_rotary() && short_way_ != endless(machine_.inner)) {
      complain(short_way_ ? "M126 with an axis that is not endless" : "an endless axis turns without M126");
    }
    if (block.said(3)) to.outer = turned(from.outer, block.axis[3], machine_.outer, shortest);
    if (block.said(4)) to.inner = turned(from.inner, block.axis[4], machine_.inner, shortest);
    if (absolute) {
      if (mode_ != 0) complain("machine coordinates in a feed move");
      if (block.rotary()) complain("machine coordinates with a rotary word");
      if (dialect_.language == Language::kSiemens && !block.has(Order::kNoLength)) {
        complain("SUPA without D0 keeps the tool's length: this is not the machine's top");
      }
      if (block.said(0)) to.x = block.axis[0];
      if (block.said(1)) to.y = block.axis[1];
      if (block.said(2)) to.z = block.axis[2];
    } else if (tcp_ == Tcp::kOn) {
      for (int i = 0; i < 3; ++i) {
        if (block.said(i)) to.point[i] = block.axis[static_cast<std::size_t>(i)];
      }
      const JointPosition joints = detail::joints_at(machine_, setup_, length_mm_, to.point, {to.outer, to.inner});
      to.x = joints.x_mm;
      to.y = joints.y_mm;
      to.z = joints.z_mm;
    } else {
      if (block.said(0)) to.x = block.axis[0] + setup_.origin_mm.x();
      if (block.said(1)) to.y = block.axis[1] + setup_.origin_mm.y();
      if (block.said(2)) to.z = block.axis[2] + setup_.origin_mm.z() + length_mm_;
    }
    to.top = absolute && block.said(2) ? std::abs(to.z - machine_.retract_z_mm) <= half_unit_
                                       : from.top && (absolute || (tcp_ != Tcp::kOn && !block.said(2)));
    place_ = to;
    if (!risen_ && !(absolute && to.top && block.linear() && !block.said(0) && !block.said(1))) {
      complain("a move before the machine is at its top");
    }
    risen_ = true;
    if (tool_ < 0 && !absolute) complain("a move in work coordinates before the tool change");
    if (!absolute && block.said(2) && length_mm_ == 0) complain("a Z word without the tool length");
    within_limits(to);
    // On the way to a tool change; its place may lie below the top.
    const bool between_passes = pass_ + 1 < passes_.size() && next_ == pass().moves.size() && !spindle_;
    const bool straight_down = absolute && from.top && !block.said(0) && !block.said(1);
    if (tool_ < 0 || (between_passes && straight_down && !to.top)) {
      changed_down_ = absolute && !to.top;
      return;
    }
    if (mode_ == 0) {
      rapid(block, from, to);
    } else {
      feed(block);
    }
    if (mode_ > 1) {
      arc(block, from, to);
    } else {
      follow(block, from, to);
    }
  }

  void within_limits(const Place& to) {
    const double slack = half_unit_ * (tcp_ == Tcp::kOn ? kPoseSlack : 1);
    const auto check = [&](char letter, double value, double least, double most, double scale) {
      if (value < least - slack * scale || value > most + slack * scale) {
        complain(std::string(1, letter) + " leaves the machine's travel");
      }
    };
    check('X', to.x, machine_.x.min_mm, machine_.x.max_mm, 1);
    check('Y', to.y, machine_.y.min_mm, machine_.y.max_mm, 1);
    check('Z', to.z, machine_.z.min_mm, machine_.z.max_mm, 1);
    check(machine_.outer.letter, to.outer, machine_.outer.min_rad, machine_.outer.max_rad, kDegree);
    check(machine_.inner.letter, to.inner, machine_.inner.min_rad, machine_.inner.max_rad, kDegree);
  }

  void rapid(const Block& block, const Place& from, const Place& to) {
    if (block.rotary()) {
      if (tcp_ == Tcp::kOn || !from.top || !to.top) complain("a rapid turns the table below the machine's top");
      return;
    }
    if (!measured_ && !to.top) complain("a rapid down before the tool length is set");
    const bool straight_up = tcp_ != Tcp::kOn && !block.said(0) && !block.said(1) && to.z >= from.z;
    if (straight_up || to.top) return;
    if (!is_high(from) || !is_high(to)) complain("a rapid below the safe plane");
    if (!machine_.has_straight_rapids() && !from.top &&
        !(detail::lowest_corner(machine_, setup_, pass().cutter.length_mm, from.joints(), to.joints(),
                                std::min(from.z, to.z)) >= pass().clearance_z_mm - kPlane_mm)) {
      complain("a rapid that may dip below the safe plane, because this control's rapids are not straight");
    }
    if (from.top && tcp_ == Tcp::kOn) {
      // The way down is straight in the machine only if it follows the spindle.
      if (!(std::hypot(to.x - from.x, to.y - from.y) <= 2 * kPoseSlack * half_unit_))
        complain("the way down is not along the spindle");
    }
  }

  // At the machine's top, or the tip at or above the safe plane of the workpiece.
  [[nodiscard]] bool is_high(const Place& place) const {
    if (place.top) return true;
    const Vec3 tip = detail::tip_at(machine_, setup_, pass().cutter.length_mm, place.joints());
    return tip.z() >= pass().clearance_z_mm - kPlane_mm;  // false for a place not known yet
  }

  void feed(const Block& block) {
    if (dialect_.smoothing_needed && !smooth_) complain("a feed move without the control's smoothing");
    if (!spindle_) complain("a feed move with the spindle off");
    if (!dwelled_) complain("a feed move before the spindle has had time to start");
    if (!measured_) complain("a feed move before the tool length is set");
    if (air_wanted() && !air_) complain("a feed move without " + pass().cutter.coolant);
    if (tcp_ == Tcp::kOn && dialect_.language == Language::kSiemens && !framed_) {
      complain("a feed move without ORIWKS ORIAXES");
    }
    if (inverse_time_) {
      if (std::isnan(block.f)) complain("a G93 block without F");
    } else if (!block.has(Order::kTimed)) {
      if (std::isnan(feed_)) complain("a feed move without F");
      if (block.rotary() && tcp_ != Tcp::kOn) complain("a rotary word in a feed move outside G93");
    }
  }

  // The plan, block by block
  // --------------------------------------------------------------------------------------------

  // Endless axes whose whole turns the control does not count.
  [[nodiscard]] bool turns_forgotten(const RotaryAxis& axis) const {
    return endless(axis) && (short_way_ || dialect_.modulo_rotary || dialect_.tcp_ball_centre);
  }
  [[nodiscard]] bool is_turned(const JointPosition& joints, const Place& place) const {
    const auto at = [&](double planned, double said, const RotaryAxis& axis) {
      const double off = turns_forgotten(axis) ? std::remainder(planned - said, 2 * kPi) : planned - said;
      return std::abs(off) <= half_unit_ * kDegree;
    };
    return at(joints.outer_rad, place.outer, machine_.outer) && at(joints.inner_rad, place.inner, machine_.inner);
  }

  // The planned pose in what the text says: axes, or the guided point and the angles.
  [[nodiscard]] bool is_at(const JointPosition& joints, const Place& place) const {
    if (!is_turned(joints, place)) return false;
    if (tcp_ == Tcp::kOn) {
      const Vec3 off = detail::tip_at(machine_, setup_, length_mm_, joints) - place.point;
      return off.cwiseAbs().maxCoeff() <= half_unit_;
    }
    // Above the part, X and Y may still be those that followed from a rounded tip.
    const double slack = place.top && wants_tcp() ? kPoseSlack * half_unit_ : half_unit_;
    const bool z = place.top ? joints.z_mm == machine_.retract_z_mm : std::abs(joints.z_mm - place.z) <= half_unit_;
    return z && std::abs(joints.x_mm - place.x) <= slack && std::abs(joints.y_mm - place.y) <= slack;
  }

  void follow(const Block& block, const Place& from, const Place& to) {
    const auto& moves = pass().moves;
    while (next_ < moves.size() && !is_at(moves[next_].joints, to) && is_at(moves[next_].joints, from)) ++next_;
    if (next_ < moves.size() && is_at(moves[next_].joints, to)) {
      const AxisMove& planned = moves[next_];
      if ((planned.kind == MoveKind::kRapid) != (mode_ == 0)) complain("rapid and feed are mixed up");
      if (mode_ == 1) check_time(planned.seconds, length_of(block, from, to), block);
      ++next_;
      return;
    }
    // The turning half of a block that was split for its short way: the axes of the next planned move, X, Y, Z as
    // before.
    if (mode_ == 1 && dialect_.least_linear_mm > 0 && next_ < moves.size() && moves[next_].kind != MoveKind::kRapid &&
        !block.linear()) {
      const JointPosition& j = moves[next_].joints;
      const Vec3 rest = tcp_ == Tcp::kOn ? Vec3(detail::tip_at(machine_, setup_, length_mm_, j) - to.point)
                                         : Vec3(j.x_mm - to.x, j.y_mm - to.y, j.z_mm - to.z);
      if (is_turned(j, to) && rest.norm() < dialect_.least_linear_mm + 2 * half_unit_) {
        check_time(moves[next_].seconds, length_of(block, from, to), block);
        return;
      }
    }
    // Rapids at the top come in several blocks, and the last retract is not part of the plan.
    if (mode_ == 0 && to.top && (next_ == moves.size() || moves[next_].joints.z_mm == machine_.retract_z_mm)) return;
    complain(next_ == moves.size()
                 ? "a move after the last one planned"
                 : "the block does not end where the plan's move " + std::to_string(next_ + 1) + " ends");
  }

  // An arc stands for planned cuts, none of which lies farther from it than was granted.
  void arc(const Block& block, const Place& from, const Place& to) {
    if (block.rotary()) return complain("a rotary word in an arc");
    if (!dialect_.arc_centre_is_relative && (modal_ & bit(Order::kRelativeCentre)) == 0) {
      return complain("an arc before G91.1");
    }
    const bool in_plane = std::isfinite(block.centre[static_cast<std::size_t>((plane_ + 1) % 3)]) &&
                          std::isfinite(block.centre[static_cast<std::size_t>((plane_ + 2) % 3)]);
    if (!in_plane) return complain("an arc without its centre");
    if (std::isfinite(block.centre[static_cast<std::size_t>(plane_)])) return complain("an arc's centre out of its plane");
    const auto& moves = pass().moves;
    std::size_t last = next_;
    while (last < moves.size() && moves[last].kind == MoveKind::kCut && !moves[last].rotary_moves &&
           !is_at(moves[last].joints, to)) {
      ++last;
    }
    if (last >= moves.size() || moves[last].kind != MoveKind::kCut || moves[last].rotary_moves) {
      return complain("the arc does not end where one of the plan's cuts from move " + std::to_string(next_ + 1) +
                      " on ends");
    }
    const WrittenArc arc(guided(from), guided(to), block.centre, plane_, mode_ == 2);
    if (std::abs(arc.turn_rad) > kPi) return complain("an arc of more than half a turn");
    double seconds = 0;
    std::vector<Vec3> planned{arc.from};
    for (std::size_t i = next_; i <= last; ++i) {
      planned.push_back(guided(moves[i].joints));
      seconds += moves[i].seconds;
    }
    const double off = distance_between(arc, planned);
    if (!(off <= options_.arc_tolerance_mm + 2 * half_unit_)) {
      complain("the arc leaves the plan's moves " + std::to_string(next_ + 1) + " to " + std::to_string(last + 1) + " by " +
               compact(off * 1e3, 2) + " um");
    }
    check_time(seconds, arc.length_mm(), block);
    next_ = last + 1;
  }

  [[nodiscard]] Vec3 guided(const Place& place) const {
    return tcp_ == Tcp::kOn ? place.point : Vec3(place.x, place.y, place.z);
  }
  [[nodiscard]] Vec3 guided(const JointPosition& joints) const {
    return tcp_ == Tcp::kOn ? detail::tip_at(machine_, setup_, length_mm_, joints)
                            : Vec3(joints.x_mm, joints.y_mm, joints.z_mm);
  }

  // What the feed counts: mm, or degrees where only rotary axes move.
  [[nodiscard]] double length_of(const Block& block, const Place& from, const Place& to) const {
    if (!block.linear()) return std::hypot(to.outer - from.outer, to.inner - from.inner) / kDegree;
    return (guided(to) - guided(from)).norm();
  }

  void check_time(double planned_s, double length, const Block& block) {
    if (block.has(Order::kTimed) || inverse_time_) {
      const double seconds = inverse_time_ ? 60 / block.f : block.time;
      const double slower = inverse_time_ ? planned_s * (1 + kFeedLoss) : planned_s + kTimeLoss_s + 1e-9;
      if (seconds < planned_s * (1 - 1e-6)) complain("F is faster than planned");
      if (seconds > slower) complain("F is slower than planned");
      return;
    }
    // Rounded coordinates change a short block's length.
    const double blur = 4 * half_unit_ / std::max(length, half_unit_);
    const double seconds = 60 * length / feed_;
    if (std::isnan(seconds) || blur > 0.5) return;
    if (seconds < planned_s * (1 - 1e-6 - blur)) complain("F is faster than planned");
    const double coarse = kFeedLoss + std::pow(10.0, -dialect_.feed_decimals) / feed_;
    if (seconds > planned_s * (1 + coarse + blur)) complain("F is slower than planned");
  }

  void finish_pass() {
    const auto& moves = pass().moves;
    while (next_ < moves.size() && next_ > 0 && close(moves[next_].joints, moves[next_ - 1].joints)) ++next_;
    if (next_ < moves.size()) {
      complain("the program ends before the plan's move " + std::to_string(next_ + 1) + " of " +
               std::to_string(moves.size()));
    }
  }

  void at_end() {
    reader_.finish();
    if (!ended_) complain("M30 is missing");
    if (dialect_.tcp_ball_centre) check_blank();
    if (tool_ < 0 || pass_ + 1 < passes_.size()) return complain("a pass is missing");
    finish_pass();
  }

  // For the control's graphics: two corners, and the cut within them.
  void check_blank() {
    if (blanks_ != 2) return complain("the blank's two corners are missing");
    bool within = (blank_[1] - blank_[0]).minCoeff() > 0 && blank_[0].z() <= 0;
    for (const AxisMotion& pass : passes_) {
      for (const AxisMove& move : pass.moves) {
        if (move.kind != MoveKind::kCut) continue;
        const Vec3 tip = detail::tip_at(machine_, setup_, pass.cutter.length_mm, move.joints);
        within = within && tip.x() > blank_[0].x() && tip.y() > blank_[0].y() && (blank_[1] - tip).minCoeff() > 0;
      }
    }
    if (!within) complain("the blank does not hold the cut");
  }

  // Moves that round to nothing at the end of a plan are not in the text.
  [[nodiscard]] bool close(const JointPosition& a, const JointPosition& b) const {
    return std::abs(a.x_mm - b.x_mm) <= 2 * half_unit_ && std::abs(a.y_mm - b.y_mm) <= 2 * half_unit_ &&
           std::abs(a.z_mm - b.z_mm) <= 2 * half_unit_ &&
           std::abs(a.outer_rad - b.outer_rad) <= 2 * half_unit_ * kDegree &&
           std::abs(a.inner_rad - b.inner_rad) <= 2 * half_unit_ * kDegree;
  }

  const MachineModel& machine_;
  const WorkSetup& setup_;
  std::span<const AxisMotion> passes_;
  const ProgramOptions& options_;
  const detail::Dialect& dialect_;
  double half_unit_;  // half a unit of the last decimal and a little for rounding
  detail::BlockReader reader_;

  std::vector<std::string> faults_;
  std::vector<bool> wants_tcp_;  // per pass
  // Modal state.
  std::uint64_t modal_ = 0, needed_ = 0;
  int mode_ = -1;   // of G0 to G3
  int plane_ = 2;  // axis across the plane of arcs
  bool inverse_time_ = false;
  double feed_ = kNotSaid;
  double speed_ = 0;
  double selected_ = -1;
  int tool_ = -1;
  double length_mm_ = 0;
  bool measured_ = false;
  Tcp tcp_ = Tcp::kUnknown;
  bool framed_ = false;
  bool spindle_ = false, dwelled_ = false, air_ = false;
  bool risen_ = false;         // the machine has been sent to its top since the start or the tool change
  bool changed_down_ = false;  // went down to a tool change position by machine coordinates
  bool smooth_ = false, short_way_ = false;
  bool ended_ = false;
  int blanks_ = 0;
  std::array<Vec3, 2> blank_{Vec3::Zero(), Vec3::Zero()};
  Place place_;
  std::size_t pass_ = 0;
  std::size_t next_ = 0;  // planned move that the next block must fulfil
};

}  // namespace

std::vector<std::string> check_program_text(const MachineModel& machine, const WorkSetup& setup,
                                            std::span<const AxisMotion> passes, std::string_view text,
                                            const ProgramOptions& options) {
  return Checker(machine, setup, passes, options).check(text);
}

std::vector<std::string> check_program_text(const MachineModel& machine, const WorkSetup& setup,
                                            const AxisMotion& motion, std::string_view text,
                                            const ProgramOptions& options) {
  return check_program_text(machine, setup, std::span(&motion, 1), text, options);
}

}  // namespace lightmill

#include "machine/motion_timing.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lightmill {

namespace {

constexpr double kDegreesPerRad = 180 / kPi;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// Directions that differ by less (per unit of length) are one: rounding of a straight line's split.
constexpr double kStraight = 1e-9;
/// Blocks that are looked through at once, beside the queue.
constexpr std::size_t kRound = 4096;
constexpr double kSlowRatio = 0.5;

std::array<double, 5> joints(const JointPosition& q) { return {q.x_mm, q.y_mm, q.z_mm, q.outer_rad, q.inner_rad}; }

bool turns(const TimedBlock& block) { return block.per_length[3] != 0 || block.per_length[4] != 0; }

bool same_spindle(const Motion& a, const Motion& b) {
  return a.tool == b.tool && a.spindle_on == b.spindle_on && a.spindle_rpm == b.spindle_rpm;
}

}  // namespace

ControlRules control_rules(const MachineModel& machine) {
  ControlRules rules;
  rules.queue_blocks = machine.planner_blocks;
  rules.block_s = machine.min_block_s;
  rules.corner_tolerance_mm = machine.corner_tolerance_mm;
  rules.stops_beside_rotary = machine.controller == "linuxcnc";
  return rules;
}

void MotionTiming::add(const MotionTiming& other) {
  blocks += other.blocks;
  stops += other.stops;
  seconds += other.seconds;
  commanded_seconds += other.commanded_seconds;
  feed_seconds += other.feed_seconds;
  commanded_feed_seconds += other.commanded_feed_seconds;
  feed_mm += other.feed_mm;
  slow_seconds += other.slow_seconds;
  if (other.slow_line_seconds > slow_line_seconds) {
    slow_line = other.slow_line;
    slow_line_seconds = other.slow_line_seconds;
    slow_line_mm = other.slow_line_mm;
  }
  for (std::size_t i = 0; i < 5; ++i) {
    top_speed[i] = std::max(top_speed[i], other.top_speed[i]);
    top_acceleration[i] = std::max(top_acceleration[i], other.top_acceleration[i]);
  }
}

MotionTimer::MotionTimer(const MachineModel& machine) : MotionTimer(machine, control_rules(machine)) {}

MotionTimer::MotionTimer(const MachineModel& machine, const ControlRules& rules)
    : top_speed_{machine.x.max_speed_mm_per_s, machine.y.max_speed_mm_per_s, machine.z.max_speed_mm_per_s,
                 machine.outer.max_speed_rad_per_s, machine.inner.max_speed_rad_per_s},
      top_acceleration_{machine.x.acceleration_mm_per_s2, machine.y.acceleration_mm_per_s2, machine.z.acceleration_mm_per_s2,
                        machine.outer.acceleration_rad_per_s2, machine.inner.acceleration_rad_per_s2},
      rules_(rules) {
  const std::array<double, 5> jerk{machine.x.jerk_mm_per_s3, machine.y.jerk_mm_per_s3, machine.z.jerk_mm_per_s3,
                                   machine.outer.jerk_rad_per_s3, machine.inner.jerk_rad_per_s3};
  for (std::size_t i = 0; i < 5; ++i) {
    if (jerk[i] > 0) smoothing_s_ = std::max(smoothing_s_, 2 * top_acceleration_[i] / jerk[i]);
    if (!(top_speed_[i] > 0)) top_speed_[i] = kInfinity;
    if (!(top_acceleration_[i] > 0)) top_acceleration_[i] = kInfinity;
  }
}

void MotionTimer::begin_program() {
  stand();
  ++program_;
  new_section_ = true;
}

void MotionTimer::stand() {
  settle(true);
  standing_ = true;
}

void MotionTimer::finish() {
  settle(true);
  end_slow_run();
}

void MotionTimer::move(const Motion& motion, const SweptMove& first, const SweptMove& last) {
  // Tool and spindle are changed with the axes standing.
  if (!same_spindle(motion, last_) || motion.stood_s > 0) stand();
  // The spindle's start parts programs that follow each other on one wire, whose names the control does not know.
  const bool starts = last_.spindle_rpm == 0 && motion.spindle_rpm > 0;
  if (new_section_ || motion.tool != last_.tool || starts) {
    end_slow_run();
    sections_.push_back({motion.line, program_, motion.tool, {}});
    new_section_ = false;
  }
  last_ = motion;
  sections_.back().timing.seconds += motion.stood_s;
  sections_.back().timing.commanded_seconds += motion.stood_s;

  Block block;
  block.section = static_cast<int>(sections_.size()) - 1;
  TimedBlock& made = block.made;
  made.motion = motion;
  made.program = program_;
  const std::array<double, 5> from = joints(motion.from), to = joints(motion.to);
  std::array<double, 5> way;
  double sum = 0;
  for (std::size_t i = 0; i < 5; ++i) {
    way[i] = to[i] - from[i];
    const double unit = i < 3 ? 1 : kDegreesPerRad;
    sum += way[i] * unit * way[i] * unit;
  }
  made.length = std::sqrt(sum);
  if (made.length == 0) {
    ++sections_.back().timing.blocks;
    if (on_block && motion.stood_s > 0) on_block(made);  // nothing waits before it
    return;
  }
  double quickest = rules_.block_s;
  made.acceleration = kInfinity;
  for (std::size_t i = 0; i < 5; ++i) {
    if (way[i] == 0) continue;
    made.per_length[i] = way[i] / made.length;
    quickest = std::max(quickest, std::abs(way[i]) / top_speed_[i]);
    made.acceleration = std::min(made.acceleration, top_acceleration_[i] / std::abs(made.per_length[i]));
  }
  block.nominal = made.length / std::max({motion.seconds, quickest, 1e-9});
  // What share of the block a piece is, its time says.
  const bool one_piece = first.from.tip_mm == last.from.tip_mm;
  const auto tip_per_length = [&](const SweptMove& piece) -> Vec3 {
    const double share = one_piece || !(piece.seconds > 0) ? 1 : piece.seconds / motion.seconds;
    return (piece.to.tip_mm - piece.from.tip_mm) / (share * made.length);
  };
  block.tip_first = tip_per_length(first);
  block.tip_last = tip_per_length(last);
  made.tip_mm = one_piece ? (last.to.tip_mm - first.from.tip_mm).norm()
                          : (block.tip_first.norm() + block.tip_last.norm()) / 2 * made.length;

  if (!standing_ && !waiting_.empty()) block.corner = corner_between(waiting_.back(), block);
  standing_ = false;
  waiting_.push_back(block);
  if (waiting_.size() >= kRound + 2 * static_cast<std::size_t>(rules_.queue_blocks)) settle(false);
}

MotionTimer::Corner MotionTimer::corner_between(const Block& before, const Block& after) const {
  Corner corner;
  const double slower = std::min(before.nominal, after.nominal);
  corner.most2 = slower * slower;
  if (before.made.motion.exact_stop || (rules_.stops_beside_rotary && (turns(before.made) || turns(after.made)))) {
    return {};
  }
  double change = 0;
  for (std::size_t i = 0; i < 5; ++i) {
    const double difference = std::abs(after.made.per_length[i] - before.made.per_length[i]);
    if (difference < kStraight) continue;
    change = std::max(change, difference);
    corner.s_per_speed = std::max(corner.s_per_speed, difference / top_acceleration_[i]);
  }
  if (change == 0) return corner;
  // speed |c| (speed m + window) / 8 <= tolerance, c the change of the tip's way per length.
  const double said = before.made.motion.corner_tolerance_mm;
  const double tolerance = said >= 0 ? said : rules_.corner_tolerance_mm;
  const double m = corner.s_per_speed, window = smoothing_s_;
  const double tip_change = (after.tip_first - before.tip_last).norm();
  const double shorter = std::min(before.made.length, after.made.length);
  if (tip_change > kStraight && std::isfinite(tolerance)) {
    const double allowed = 8 * tolerance / tip_change;
    double speed = 0;
    if (window == 0) {
      speed = m > 0 ? std::sqrt(allowed / m) : kInfinity;
    } else {
      speed = m > 0 ? (std::sqrt(window * window + 4 * m * allowed) - window) / (2 * m) : allowed / window;
      // A bend of many short blocks is drawn inwards by acceleration * window^2 / 24.
      speed = std::min(speed, std::sqrt(24 * tolerance * shorter / tip_change) / window);
    }
    corner.most2 = std::min(corner.most2, speed * speed);
  }
  // Half of the change-over in either block, at most half of the block.
  if (m > 0) corner.most2 = std::min(corner.most2, shorter / m);
  return corner;
}

/// Speeds of all that waits, and passes on what no later block can change: all, or all but a queue's length.
void MotionTimer::settle(bool all) {
  if (waiting_.empty()) return;
  const std::size_t count = waiting_.size();
  const auto queue = static_cast<std::size_t>(std::max(rules_.queue_blocks, 1));
  const std::size_t done = all ? count : count - std::min(count, queue);

  // It must be able to stop at the end of the queue: 2 a l of the blocks in it, the change-overs at their longest.
  double slowing = 0;
  for (std::size_t k = 0; k < count; ++k) {
    Block& block = waiting_[k];
    block.slowing = slowing;
    const Corner& begin = block.corner;
    const Corner end = k + 1 < count ? waiting_[k + 1].corner : Corner{};
    const double blends = (begin.most2 * begin.s_per_speed + end.most2 * end.s_per_speed) / 2;
    slowing += 2 * block.made.acceleration * std::max(0.0, block.made.length - blends);
  }
  // Backwards: what can still be braked. With half the change-overs at the speeds u and v of its ends a block has
  // l - (u^2 m_u + v^2 m_v) / 2 left to brake on, which makes u^2 linear in v^2.
  double exit2 = 0;
  Corner exit;
  for (std::size_t k = count; k-- > 0;) {
    Block& block = waiting_[k];
    const double a = block.made.acceleration;
    const double braked = (exit2 * (1 - a * exit.s_per_speed) + 2 * a * block.made.length) / (1 + a * block.corner.s_per_speed);
    const double seen = k + queue < count ? waiting_[k + queue].slowing - block.slowing : kInfinity;
    block.entry2 = k == 0 ? settled_entry2_ : std::min({block.corner.most2, braked, seen});
    exit2 = block.entry2;
    exit = block.corner;
  }
  // Forwards: what can be reached.
  for (std::size_t k = 0; k < done; ++k) {
    Block& block = waiting_[k];
    const double a = block.made.acceleration;
    double end2 = 0, end_blend = 0;
    if (k + 1 < count) {
      Block& next = waiting_[k + 1];
      const double reached =
          (block.entry2 * (1 - a * block.corner.s_per_speed) + 2 * a * block.made.length) / (1 + a * next.corner.s_per_speed);
      next.entry2 = std::min(next.entry2, reached);
      end2 = next.entry2;
      end_blend = next.corner.s_per_speed;
      if (end2 > 0 && end_blend > 0) {
        auto& used = sections_[static_cast<std::size_t>(block.section)].timing.top_acceleration;
        for (std::size_t i = 0; i < 5; ++i)
          used[i] = std::max(used[i], std::abs(next.made.per_length[i] - block.made.per_length[i]) / end_blend);
      }
    }
    pass_on(block, end2, end_blend);
  }
  settled_entry2_ = done < count ? waiting_[done].entry2 : 0;
  waiting_.erase(waiting_.begin(), waiting_.begin() + static_cast<std::ptrdiff_t>(done));
}

void MotionTimer::pass_on(Block& block, double exit2, double exit_blend) {
  TimedBlock& made = block.made;
  const double a = made.acceleration;
  made.entry = std::sqrt(block.entry2);
  made.exit = std::sqrt(exit2);
  made.entry_blend_s = made.entry * block.corner.s_per_speed / 2;
  made.exit_blend_s = made.exit * exit_blend / 2;
  const double left = std::max(0.0, made.length - made.entry * made.entry_blend_s - made.exit * made.exit_blend_s);
  const double ends2 = (block.entry2 + exit2) / 2;
  const double top2 = std::max({std::min(block.nominal * block.nominal, std::isfinite(a) ? a * left + ends2 : kInfinity), block.entry2, exit2});
  made.top = std::sqrt(top2);
  const double ramps_s = std::isfinite(a) ? (2 * made.top - made.entry - made.exit) / a : 0;
  const double ramps = std::isfinite(a) ? (top2 - ends2) / a : 0;
  made.seconds = made.entry_blend_s + made.exit_blend_s + ramps_s + std::max(0.0, left - ramps) / made.top;
  const bool stops = exit2 == 0;
  if (stops) made.seconds += smoothing_s_;

  MotionTiming& timing = sections_[static_cast<std::size_t>(block.section)].timing;
  ++timing.blocks;
  timing.seconds += made.seconds;
  timing.commanded_seconds += made.motion.seconds;
  for (std::size_t i = 0; i < 5; ++i) {
    const double share = std::abs(made.per_length[i]);
    timing.top_speed[i] = std::max(timing.top_speed[i], made.top * share);
    if (share > 0 && ramps_s > 0) timing.top_acceleration[i] = std::max(timing.top_acceleration[i], a * share);
  }
  const bool slow = !made.motion.rapid && made.motion.seconds < kSlowRatio * made.seconds;
  if (!made.motion.rapid) {
    timing.stops += stops ? 1 : 0;
    timing.feed_seconds += made.seconds;
    timing.commanded_feed_seconds += made.motion.seconds;
    timing.feed_mm += made.tip_mm;
  }
  if (slow) {
    timing.slow_seconds += made.seconds;
    if (slow_run_.seconds == 0) slow_run_ = {block.section, made.motion.line, 0, 0};
    slow_run_.seconds += made.seconds;
    slow_run_.mm += made.tip_mm;
  } else {
    end_slow_run();
  }
  if (on_block) on_block(made);
}

void MotionTimer::end_slow_run() {
  if (slow_run_.seconds > 0) {
    MotionTiming& timing = sections_[static_cast<std::size_t>(slow_run_.section)].timing;
    if (slow_run_.seconds > timing.slow_line_seconds) {
      timing.slow_line = slow_run_.line;
      timing.slow_line_seconds = slow_run_.seconds;
      timing.slow_line_mm = slow_run_.mm;
    }
  }
  slow_run_ = {};
}

}  // namespace lightmill

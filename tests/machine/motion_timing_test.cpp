#include "machine/motion_timing.h"

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <random>

#include "machine/kinematics.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

using Axes = std::array<double, 5>;

// Different limits on every axis.
MachineModel machine_for(bool jerk) {
  MachineModel machine = test::hostile_machine();
  machine.x = {-1e6, 1e6, 500, 8000, jerk ? 4e5 : 0};
  machine.y = {-1e6, 1e6, 400, 5000, jerk ? 3e5 : 0};
  machine.z = {-1e6, 1e6, 300, 3000, jerk ? 2e5 : 0};
  machine.outer.max_speed_rad_per_s = 10;
  machine.outer.acceleration_rad_per_s2 = 60;
  machine.outer.jerk_rad_per_s3 = jerk ? 3000 : 0;
  machine.inner.max_speed_rad_per_s = 20;
  machine.inner.acceleration_rad_per_s2 = 90;
  machine.inner.jerk_rad_per_s3 = jerk ? 5000 : 0;
  return machine;
}

Motion motion(const Axes& from, const Axes& to, double seconds, bool rapid = false) {
  Motion result;
  result.from = {from[0], from[1], from[2], from[3], from[4]};
  result.to = {to[0], to[1], to[2], to[3], to[4]};
  result.seconds = seconds;
  result.rapid = rapid;
  return result;
}

std::vector<TimedBlock> timed(const MachineModel& machine, const ControlRules& rules, const std::vector<Motion>& motions,
                              MotionTiming* total = nullptr) {
  WorkpieceView view(machine, {10, -5, -400});
  MotionTimer timer(machine, rules);
  std::vector<TimedBlock> blocks;
  timer.on_block = [&](const TimedBlock& block) { blocks.push_back(block); };
  std::vector<SweptMove> pieces;
  for (const Motion& m : motions) {
    pieces.clear();
    view.sweep(m, 80, {}, pieces);
    timer.move(m, pieces.front(), pieces.back());
  }
  timer.finish();
  if (total != nullptr) {
    *total = {};
    for (const SectionTiming& section : timer.sections()) total->add(section.timing);
  }
  return blocks;
}

double seconds(const MachineModel& machine, const std::vector<Motion>& motions, ControlRules rules = {}) {
  rules.queue_blocks = 100000;
  MotionTiming total;
  timed(machine, rules, motions, &total);
  return total.seconds;
}

// The axes' speeds over time, corners included, before any smoothing.
struct Sample {
  double t;
  Axes speed;
};
std::vector<Sample> samples(const std::vector<TimedBlock>& blocks, double smoothing_s) {
  std::vector<Sample> result;
  double begin = 0;
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    const TimedBlock& b = blocks[k];
    const double end = begin + b.seconds - (b.exit == 0 ? smoothing_s : 0);
    const double ramp_in = std::isfinite(b.acceleration) ? (b.top - b.entry) / b.acceleration : 0;
    const double ramp_out = std::isfinite(b.acceleration) ? (b.top - b.exit) / b.acceleration : 0;
    const auto add = [&](double t, double speed) {
      Axes axes;
      for (std::size_t i = 0; i < 5; ++i) axes[i] = speed * b.per_length[i];
      result.push_back({t, axes});
    };
    const auto middle = [&](double t, double speed, const TimedBlock& other) {
      Axes axes;
      for (std::size_t i = 0; i < 5; ++i) axes[i] = speed * (b.per_length[i] + other.per_length[i]) / 2;
      result.push_back({t, axes});
    };
    if (k == 0 || b.entry == 0) {
      add(begin, b.entry);
    } else {
      middle(begin, b.entry, blocks[k - 1]);
    }
    add(begin + b.entry_blend_s, b.entry);
    add(begin + b.entry_blend_s + ramp_in, b.top);
    add(end - b.exit_blend_s - ramp_out, b.top);
    add(end - b.exit_blend_s, b.exit);
    if (b.exit == 0) add(end, 0);
    if (b.exit > 0 && k + 1 < blocks.size()) middle(end, b.exit, blocks[k + 1]);
    begin = begin + b.seconds;
  }
  return result;
}

std::vector<Motion> random_way(std::mt19937& random, int count) {
  std::uniform_real_distribution<double> unit(-1, 1);
  std::vector<Motion> motions;
  Axes at{0, 0, 0, 0.2, 0.3};
  Axes heading{1, 0.2, -0.1, 0, 0};
  for (int k = 0; k < count; ++k) {
    const double kind = unit(random);
    const double sharp = kind > 0.5 ? 1 : 0.05;  // now and then a corner, else a gentle bend
    for (std::size_t i = 0; i < 5; ++i) heading[i] += sharp * unit(random) * (i < 3 ? 1 : 0.02);
    if (kind < -0.7) heading[3] = heading[4] = 0;
    const double size = std::exp(3 * unit(random)) * 0.5;
    Axes to = at;
    for (std::size_t i = 0; i < 5; ++i) to[i] += size * heading[i];
    motions.push_back(motion(at, to, size * std::exp(2 * unit(random)) / 30, kind < -0.9));
    at = to;
  }
  return motions;
}

std::vector<Motion> split(const std::vector<Motion>& motions, int pieces) {
  std::vector<Motion> result;
  for (const Motion& m : motions) {
    const auto at = [&](double t) {
      return JointPosition{m.from.x_mm + t * (m.to.x_mm - m.from.x_mm), m.from.y_mm + t * (m.to.y_mm - m.from.y_mm),
                           m.from.z_mm + t * (m.to.z_mm - m.from.z_mm), m.from.outer_rad + t * (m.to.outer_rad - m.from.outer_rad),
                           m.from.inner_rad + t * (m.to.inner_rad - m.from.inner_rad)};
    };
    for (int k = 0; k < pieces; ++k) {
      Motion part = m;
      part.from = at(double(k) / pieces);
      part.to = at(double(k + 1) / pieces);
      part.seconds = m.seconds / pieces;
      result.push_back(part);
    }
  }
  return result;
}

std::vector<Motion> reversed(const std::vector<Motion>& motions) {
  std::vector<Motion> result(motions.rbegin(), motions.rend());
  for (Motion& m : result) std::swap(m.from, m.to);
  return result;
}

// A long move is a trapezoid, a short one a triangle, whatever the axis; jerk adds its window.
TEST(MotionTimer, StraightMovesTakeTheClosedFormsTime) {
  for (const bool jerk : {false, true}) {
    const MachineModel machine = machine_for(jerk);
    // Twice the longest a / j of an axis: B's 60 / 3000 and X's 8000 / 4e5 are both 0.02 s.
    const double window = jerk ? 0.04 : 0;
    const double feed = 50;
    EXPECT_NEAR(seconds(machine, {motion({}, {20, 0, 0, 0, 0}, 20 / feed)}), 20 / feed + feed / 8000 + window, 1e-12);
    EXPECT_NEAR(seconds(machine, {motion({}, {0, 0, -0.3, 0, 0}, 0.3 / feed)}), 2 * std::sqrt(0.3 / 3000) + window, 1e-12);
    EXPECT_NEAR(seconds(machine, {motion({}, {0, 0, 0, 0, 6}, 0, true)}), 6 / 20.0 + 20.0 / 90 + window, 1e-12);
    // The slower of two axes rules: 30 x, 40 y at 5000 mm/s2 in y.
    EXPECT_NEAR(seconds(machine, {motion({}, {30, 40, 0, 0, 0}, 1)}), 1 + 40 / 5000.0 + window, 1e-12);
  }
}

TEST(MotionTimer, CornerIsPassedAtTheSpeedOfItsParabola) {
  MachineModel machine = machine_for(false);
  machine.y = machine.x;
  ControlRules rules;
  rules.queue_blocks = 1000;
  rules.corner_tolerance_mm = 0.02;
  const auto blocks = timed(machine, rules, {motion({}, {10, 0, 0, 0, 0}, 0.2), motion({10, 0, 0, 0, 0}, {10, 10, 0, 0, 0}, 0.2)});
  // tau = v / a, the corner is left by v sqrt(2) tau / 8.
  const double v = std::sqrt(0.02 * 8 * 8000 / std::sqrt(2.0));
  ASSERT_EQ(blocks.size(), 2U);
  EXPECT_NEAR(blocks[0].exit, v, 1e-9);
  EXPECT_NEAR(blocks[0].exit_blend_s, v / 8000 / 2, 1e-12);
  const double one = v / 8000 / 2 + (2 * 50 - v) / 8000 + (10 - v * v / 16000 - (2 * 2500 - v * v) / 16000) / 50;
  EXPECT_NEAR(blocks[0].seconds, one, 1e-12);
  EXPECT_NEAR(blocks[1].seconds, one, 1e-12);

  rules.corner_tolerance_mm = 0;
  EXPECT_EQ(timed(machine, rules, {motion({}, {10, 0, 0, 0, 0}, 0.2), motion({10, 0, 0, 0, 0}, {10, 10, 0, 0, 0}, 0.2)})[0].exit, 0);
  // A straight line is no corner; exact stop stands there all the same.
  std::vector<Motion> straight = split({motion({}, {10, 0, 0, 0, 0}, 0.2)}, 2);
  EXPECT_NEAR(timed(machine, rules, straight)[0].exit, 50, 1e-9);
  straight[0].exact_stop = true;
  EXPECT_EQ(timed(machine, rules, straight)[0].exit, 0);
}

TEST(MotionTimer, NoAxisExceedsItsLimitsAtAnyTime) {
  for (const bool jerk : {false, true}) {
    const MachineModel machine = machine_for(jerk);
    const Axes top{500, 400, 300, 10, 20}, most{8000, 5000, 3000, 60, 90};
    const Axes jerks{4e5, 3e5, 2e5, 3000, 5000};
    for (unsigned seed = 1; seed <= 20; ++seed) {
      std::mt19937 random(seed);
      const std::vector<Motion> motions = random_way(random, 200);
      ControlRules rules;
      rules.queue_blocks = 20;
      const auto blocks = timed(machine, rules, motions);
      const double window = MotionTimer(machine, rules).smoothing_s();
      const std::vector<Sample> way = samples(blocks, window);
      Axes place{};
      for (std::size_t k = 1; k < way.size(); ++k) {
        const double dt = way[k].t - way[k - 1].t;
        ASSERT_GT(dt, -1e-9) << seed;
        for (std::size_t i = 0; i < 5; ++i) {
          ASSERT_LE(std::abs(way[k].speed[i]), top[i] * (1 + 1e-9)) << seed;
          ASSERT_LE(std::abs(way[k].speed[i] - way[k - 1].speed[i]), most[i] * dt * (1 + 1e-6) + 1e-7) << seed << " axis " << i;
          place[i] += dt * (way[k].speed[i] + way[k - 1].speed[i]) / 2;
        }
      }
      const Axes end{motions.back().to.x_mm, motions.back().to.y_mm, motions.back().to.z_mm, motions.back().to.outer_rad - 0.2,
                     motions.back().to.inner_rad - 0.3};
      for (std::size_t i = 0; i < 5; ++i) EXPECT_NEAR(place[i], end[i], 1e-6) << seed;
      if (!jerk || seed > 4) continue;
      // Averaged over the window: the third difference of the places.
      const auto speed_at = [&](double t) {
        const auto after = std::upper_bound(way.begin(), way.end(), t, [](double a, const Sample& s) { return a < s.t; });
        if (after == way.begin() || after == way.end()) return Axes{};
        const Sample &b = *after, &a = *(after - 1);
        const double share = b.t > a.t ? (t - a.t) / (b.t - a.t) : 0;
        Axes axes;
        for (std::size_t i = 0; i < 5; ++i) axes[i] = a.speed[i] + share * (b.speed[i] - a.speed[i]);
        return axes;
      };
      // The average's acceleration is (v(t) - v(t - window)) / window.
      const double dt = 2e-4;
      Axes before{};
      for (double t = 0; t < way.back().t + window; t += dt) {
        const Axes now = speed_at(t), then = speed_at(t - window);
        for (std::size_t i = 0; i < 5; ++i) {
          const double acceleration = (now[i] - then[i]) / window;
          const double most_change = t > 0 ? jerks[i] * dt * (1 + 1e-6) + 1e-6 : 1e9;
          ASSERT_LE(std::abs(acceleration - before[i]), most_change) << seed;
          before[i] = acceleration;
        }
      }
    }
  }
}

TEST(MotionTimer, SplitMovesAndReversedProgramsTakeTheSameTime) {
  EXPECT_TRUE(rc::check([] {
    std::mt19937 random(*rc::gen::arbitrary<unsigned>());
    const MachineModel machine = machine_for(*rc::gen::arbitrary<bool>());
    const std::vector<Motion> motions = random_way(random, 30);
    const double whole = seconds(machine, motions);
    RC_ASSERT(std::abs(seconds(machine, reversed(motions)) - whole) < 1e-6 * whole);
    const std::vector<Motion> line = {motions[static_cast<std::size_t>(*rc::gen::inRange(0, 30))]};
    RC_ASSERT(std::abs(seconds(machine, split(line, 10)) - seconds(machine, line)) < 1e-6 * seconds(machine, line));
  }));
}

// A queue of N blocks of length l is a stopping distance of N l.
TEST(MotionTimer, ShortQueueHoldsTheSpeedDown) {
  const MachineModel machine = machine_for(false);
  const std::vector<Motion> line = split({motion({}, {100, 0, 0, 0, 0}, 0, true)}, 2000);
  ControlRules rules;
  for (const int queue : {1, 4, 25, 400}) {
    rules.queue_blocks = queue;
    double top = 0;
    for (const TimedBlock& block : timed(machine, rules, line)) top = std::max(top, block.entry);
    EXPECT_NEAR(top, std::min(500.0, std::sqrt(2 * 8000 * 0.05 * queue)), 1e-6) << queue;
  }
  rules.queue_blocks = 400;
  rules.block_s = 0.002;
  MotionTiming total;
  timed(machine, rules, line, &total);
  EXPECT_NEAR(total.seconds, 2000 * 0.002 + 25 / 8000.0, 1e-9);
}

TEST(MotionTimer, LinuxCncStandsBetweenBlocksThatTurn) {
  MachineModel machine = machine_for(false);
  machine.controller = "linuxcnc";
  const ControlRules rules = control_rules(machine);
  EXPECT_TRUE(rules.stops_beside_rotary);
  std::vector<Motion> line = split({motion({}, {10, 0, 0, 0, 0}, 0, true)}, 200);
  MotionTiming plain, turning;
  timed(machine, rules, line, &plain);
  for (std::size_t k = 0; k < line.size(); ++k) {
    line[k].rapid = false;
    line[k].from.outer_rad = 1e-6 * double(k);
    line[k].to.outer_rad = 1e-6 * double(k + 1);
  }
  timed(machine, rules, line, &turning);
  EXPECT_NEAR(plain.seconds, 2 * std::sqrt(10 / 8000.0), 1e-3);
  EXPECT_NEAR(turning.seconds, 200 * 2 * std::sqrt(0.05 / 8000), 1e-6);
  EXPECT_EQ(turning.stops, 200);
  EXPECT_NEAR(turning.slow_seconds, turning.seconds, 1e-9) << "all is slower than half of the commanded speed";
}

TEST(MotionTimer, SectionsFollowToolsAndPrograms) {
  const MachineModel machine = machine_for(false);
  WorkpieceView view(machine, {});
  MotionTimer timer(machine);
  std::vector<SweptMove> pieces;
  Axes at{};
  const auto go = [&](int tool, double stood) {
    Axes to = at;
    to[0] += 10;
    Motion m = motion(at, to, 1);
    m.tool = tool;
    m.stood_s = stood;
    at = to;
    pieces.clear();
    view.sweep(m, 80, {}, pieces);
    timer.move(m, pieces.front(), pieces.back());
  };
  timer.begin_program();
  go(1, 0);
  go(1, 0);
  go(2, 8);
  timer.begin_program();
  go(2, 0);
  timer.finish();
  ASSERT_EQ(timer.sections().size(), 3U);
  const double ramps = 10.0 / 8000;
  EXPECT_NEAR(timer.sections()[0].timing.seconds, 2 + ramps, 1e-9);
  EXPECT_NEAR(timer.sections()[1].timing.seconds, 9 + ramps, 1e-9);
  EXPECT_NEAR(timer.sections()[2].timing.seconds, 1 + ramps, 1e-9);
  EXPECT_EQ(timer.sections()[2].program, 2);
  EXPECT_NEAR(timer.sections()[0].timing.feed_mm, 20, 1e-9);
}

}  // namespace
}  // namespace lightmill

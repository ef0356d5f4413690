#include "postproc/axis_motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>

#include "design/core/errors.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

using test::direction;
using test::kDeg;
using testing::AllOf;
using testing::HasSubstr;

constexpr double kTolerance_mm = 2e-4;  // MotionOptions' default

std::string refusal(const MachineModel& machine, const WorkSetup& setup, const ToolPath& path) {
  try {
    plan_motion(machine, setup, path);
  } catch (const InputError& e) {
    return e.what();
  }
  return "accepted";
}

double distance_to_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const double length2 = (b - a).squaredNorm();
  const double s = length2 > 0 ? std::clamp((p - a).dot(b - a) / length2, 0.0, 1.0) : 0;
  return (p - a - s * (b - a)).norm();
}

JointPosition mix(const JointPosition& a, const JointPosition& b, double s) {
  return {a.x_mm + s * (b.x_mm - a.x_mm), a.y_mm + s * (b.y_mm - a.y_mm), a.z_mm + s * (b.z_mm - a.z_mm),
          a.outer_rad + s * (b.outer_rad - a.outer_rad), a.inner_rad + s * (b.inner_rad - a.inner_rad)};
}

// What must hold for every motion, seen with the matrices of support.h only: all feed blocks stay within `tolerance` of
// the path's straight lines and arrive at its poses in order, rapids never turn the table except at the top, no axis
// passes a limit or its speed, the tip never exceeds the feed.
void expect_motion_holds(const MachineModel& machine, const WorkSetup& setup, const ToolPath& path,
                         const AxisMotion& motion, double tolerance_mm = kTolerance_mm) {
  const auto pose = [&](const JointPosition& j) {
    return test::pose_by_matrices(machine, setup.origin_mm, path.cutter.length_mm, j);
  };
  std::size_t done = 0;  // moves of the path fulfilled
  double worst_tip = 0, worst_axis = 0, worst_speed = 0, worst_feed = 0;
  ASSERT_GE(motion.moves.size(), path.moves.size() + 1);
  EXPECT_EQ(motion.moves.front().joints.z_mm, machine.retract_z_mm);
  for (std::size_t i = 0; i < motion.moves.size(); ++i) {
    const AxisMove& move = motion.moves[i];
    const JointPosition& j = move.joints;
    ASSERT_TRUE(j.x_mm >= machine.x.min_mm && j.x_mm <= machine.x.max_mm);
    ASSERT_TRUE(j.y_mm >= machine.y.min_mm && j.y_mm <= machine.y.max_mm);
    ASSERT_TRUE(j.z_mm >= machine.z.min_mm - 1e-9 && j.z_mm <= machine.z.max_mm + 1e-9);
    ASSERT_TRUE(j.outer_rad >= machine.outer.min_rad - 1e-9 && j.outer_rad <= machine.outer.max_rad + 1e-9);
    ASSERT_TRUE(j.inner_rad >= machine.inner.min_rad - 1e-9 && j.inner_rad <= machine.inner.max_rad + 1e-9);
    if (i > 0) {
      const JointPosition& before = motion.moves[i - 1].joints;
      const double outer = std::abs(j.outer_rad - before.outer_rad), inner = std::abs(j.inner_rad - before.inner_rad);
      EXPECT_EQ(move.rotary_moves, outer > 0 || inner > 0);
      if (move.kind == MoveKind::kRapid) {
        if (move.rotary_moves) {
          EXPECT_EQ(before.z_mm, machine.retract_z_mm);
          EXPECT_EQ(j.z_mm, machine.retract_z_mm);
        }
      } else {
        ASSERT_LT(done, path.moves.size());
        const Move& planned = path.moves[done];
        const Vec3& a = path.moves[done - 1].pose.tip_mm;
        EXPECT_EQ(move.kind, planned.kind);
        EXPECT_LE(inner, kPi + 1e-9) << "the table takes the long way round";
        for (int k = 0; k <= 16; ++k) {
          const Vec3 tip = pose(mix(before, j, k / 16.0)).tip_mm;
          worst_tip = std::max(worst_tip, distance_to_segment(tip, a, planned.pose.tip_mm));
        }
        ASSERT_GT(move.seconds, 0) << i;
        const double length = (pose(j).tip_mm - pose(before).tip_mm).norm();
        worst_feed = std::max(worst_feed, length / move.seconds / planned.feed_mm_per_s);
        worst_speed = std::max({worst_speed, outer / move.seconds / machine.outer.max_speed_rad_per_s,
                                inner / move.seconds / machine.inner.max_speed_rad_per_s,
                                std::abs(j.x_mm - before.x_mm) / move.seconds / machine.x.max_speed_mm_per_s,
                                std::abs(j.y_mm - before.y_mm) / move.seconds / machine.y.max_speed_mm_per_s,
                                std::abs(j.z_mm - before.z_mm) / move.seconds / machine.z.max_speed_mm_per_s});
      }
    }
    // A pose of the path is reached when tip and axis are there.
    while (done < path.moves.size()) {
      const ToolPose here = pose(j), want = path.moves[done].pose;
      if ((here.tip_mm - want.tip_mm).norm() > 1e-8 || (here.axis - want.axis).norm() > 3e-5) break;
      worst_axis = std::max(worst_axis, (here.axis - want.axis).norm());
      ++done;
      if (done < path.moves.size() && (path.moves[done].pose.tip_mm - want.tip_mm).norm() > 0) break;
    }
  }
  EXPECT_EQ(done, path.moves.size()) << "the motion does not reach this move";
  EXPECT_LE(worst_tip, tolerance_mm * 1.02 + 1e-9);
  EXPECT_LE(worst_axis, 1.1e-5);
  EXPECT_LE(worst_feed, 1 + 1e-3);  // a chord over an arc is shorter, blocks end on the line to the tip tolerance
  EXPECT_LE(worst_speed, 1 + 1e-9);
  EXPECT_LE(motion.max_axis_speed_ratio, 1 + 1e-12);
  EXPECT_LE(motion.max_tip_error_um, tolerance_mm * 1e3);
}

TEST(PlanMotion, FixedAxisKeepsRotaryJointsAndMovesOneToOne) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {12, -17, 30}, 54);
  const ToolPath path = test::fixed_rows(30 * kDeg, 70 * kDeg, 4, 50);
  const AxisMotion motion = plan_motion(machine, setup, path);
  ASSERT_EQ(motion.moves.size(), path.moves.size() + 1);
  expect_motion_holds(machine, setup, path, motion);
  EXPECT_EQ(motion.max_tip_error_um, 0);
  EXPECT_EQ(motion.slowed_moves, 0);
  EXPECT_EQ(motion.pass, "finish");
  const JointPosition& first = motion.moves.front().joints;
  EXPECT_NEAR(first.outer_rad, 30 * kDeg, 1e-12);  // of the two branches the one that turns C less
  EXPECT_NEAR(first.inner_rad, 70 * kDeg, 1e-12);
  for (const AxisMove& move : motion.moves) {
    EXPECT_EQ(move.joints.outer_rad, first.outer_rad);
    EXPECT_EQ(move.joints.inner_rad, first.inner_rad);
  }
  for (std::size_t i = 1; i < path.moves.size(); ++i) {
    if (path.moves[i].kind == MoveKind::kRapid) continue;
    const double length = (path.moves[i].pose.tip_mm - path.moves[i - 1].pose.tip_mm).norm();
    EXPECT_NEAR(motion.moves[i + 1].seconds, length / path.moves[i].feed_mm_per_s, 1e-15);
  }
}

TEST(PlanMotion, FixedAxisTakesTheBranchThatReaches) {
  MachineModel machine = test::fixture_machine();
  machine.inner.min_rad = -120 * kDeg;
  machine.inner.max_rad = 120 * kDeg;
  const WorkSetup setup = work_on_table(machine, {0, 0, 30}, 54);
  const AxisMotion motion = plan_motion(machine, setup, test::fixed_rows(30 * kDeg, 170 * kDeg, 1, 5));
  EXPECT_NEAR(motion.moves[0].joints.outer_rad, -30 * kDeg, 1e-12);
  EXPECT_NEAR(motion.moves[0].joints.inner_rad, -10 * kDeg, 1e-12);
}

TEST(PlanMotion, LeadTiltKeepsTheTipOnItsLines) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {23, -17, 30}, 54);
  const ToolPath path = test::lead_rows(20 * kDeg, 3, 40);
  const AxisMotion motion = plan_motion(machine, setup, path);
  expect_motion_holds(machine, setup, path, motion);
  EXPECT_GT(motion.moves.size(), path.moves.size() + 1) << "nothing was cut: the test is too easy";
  EXPECT_GT(motion.max_tip_error_um, 0.01);
}

TEST(PlanMotion, FinerToleranceMakesMoreBlocks) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {23, -17, 30}, 54);
  const ToolPath path = test::lead_rows(20 * kDeg, 2, 10);
  const AxisMotion coarse = plan_motion(machine, setup, path, {.tip_tolerance_mm = 4e-3});
  const AxisMotion fine = plan_motion(machine, setup, path, {.tip_tolerance_mm = 4e-5});
  expect_motion_holds(machine, setup, path, coarse, 4e-3);
  expect_motion_holds(machine, setup, path, fine, 4e-5);
  const double ratio = double(fine.moves.size()) / double(coarse.moves.size());
  EXPECT_GT(ratio, 3);  // the error is quadratic: 100 times finer, 10 times as many
  EXPECT_LT(ratio, 20);
}

// Both machines that we ship: other pivots, the other rotary sign, a limited C.
TEST(PlanMotion, HoldsOnEveryFixtureMachine) {
  for (const char* name : {"hsm400u_grblhal.toml", "bc_offset_grblhal.toml"}) {
    const MachineModel machine = read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines" / name);
    const WorkSetup setup = work_on_table(machine, {19, -14, 30}, 54);
    const ToolPath path = test::lead_rows(20 * kDeg, 3, 10);
    expect_motion_holds(machine, setup, path, plan_motion(machine, setup, path));
  }
}

// A dome milled with the tool along its normal: the axis passes the pole and its neighbourhood.
TEST(PlanMotion, NormalToADomeThroughThePole) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {11, 7, 30}, 54);
  for (const int points : {10, 11}) {  // with and without a pose on the pole
    const ToolPath through = [&] {
      ToolPath path = test::lead_rows(0, 1, points);
      for (Move& move : path.moves) {
        move.pose.tip_mm.y() = 0;
        move.pose.axis.y() = 0;
        move.pose.axis.normalize();
      }
      return path;
    }();
    const AxisMotion motion = plan_motion(machine, setup, through);
    expect_motion_holds(machine, setup, through, motion);
    double least = 1e9, most = -1e9;
    for (const AxisMove& move : motion.moves) {
      least = std::min(least, move.joints.inner_rad);
      most = std::max(most, move.joints.inner_rad);
    }
    EXPECT_LT(most - least, 1e-6) << "C has no reason to turn: the tilt passes through zero on its branch's other side";
  }
  const ToolPath beside = test::lead_rows(0, 5, 20);
  expect_motion_holds(machine, setup, beside, plan_motion(machine, setup, beside));
}

// Comes to the pole from one side and leaves to another: C turns there while the tip stands.
TEST(PlanMotion, TurnsCOnThePole) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {11, 7, 30}, 54);
  ToolPath path = test::empty_path(25);
  path.moves.push_back({{{0, 0, 40}, direction(0.3, 0)}, MoveKind::kRapid, 0});
  path.moves.push_back({{{10, 0, 12}, Vec3::UnitZ()}, MoveKind::kCut, 20});
  path.moves.push_back({{{10, 8, 12}, Vec3::UnitZ()}, MoveKind::kCut, 20});
  path.moves.push_back({{{0, 8, 12}, direction(0.3, 1)}, MoveKind::kCut, 20});
  const AxisMotion motion = plan_motion(machine, setup, path);
  expect_motion_holds(machine, setup, path, motion);
  EXPECT_NEAR(std::abs(motion.moves.back().joints.inner_rad - motion.moves.front().joints.inner_rad), 1, 1e-6);
}

// The axis circles the pole five times: an endless table goes round and round and never back.
TEST(PlanMotion, EndlessTableWindsOn) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {11, 7, 30}, 54);
  const ToolPath path = test::circling(5, 90, false);
  const AxisMotion motion = plan_motion(machine, setup, path);
  expect_motion_holds(machine, setup, path, motion);
  const double wound = motion.moves.back().joints.inner_rad - motion.moves.front().joints.inner_rad;
  EXPECT_NEAR(std::abs(wound), 10 * kPi, 1e-6);
}

TEST(PlanMotion, LimitedTableUnwindsAtTheTop) {
  MachineModel machine = test::hostile_machine();
  machine.inner.min_rad = -400 * kDeg;
  machine.inner.max_rad = 400 * kDeg;
  const WorkSetup setup = work_on_table(machine, {11, 7, 30}, 54);
  const ToolPath lifted = test::circling(5, 90, true);
  const AxisMotion motion = plan_motion(machine, setup, lifted);
  expect_motion_holds(machine, setup, lifted, motion);
  const auto unwound = std::count_if(motion.moves.begin(), motion.moves.end(), [](const AxisMove& move) {
    return move.kind == MoveKind::kRapid && move.rotary_moves;
  });
  EXPECT_GE(unwound, 3);  // the approach, and 1800 degrees in 800: at least two unwindings
  EXPECT_EQ(motion.rewinds, 0u);
  // What just fits is not refused, though the principal angle of its start would be wrong.
  const ToolPath fits = test::circling(2, 90, false);
  expect_motion_holds(machine, setup, fits, plan_motion(machine, setup, fits));
}

// 1800 degrees without a rapid in 800: the tool leaves the part along its axis, turns at the top, and comes back to
// where it was.
TEST(PlanMotion, LimitedTableRewindsAboveThePart) {
  MachineModel machine = test::hostile_machine();
  machine.inner.min_rad = -400 * kDeg;
  machine.inner.max_rad = 400 * kDeg;
  const WorkSetup setup = work_on_table(machine, {11, 7, 30}, 54);
  const ToolPath path = test::circling(5, 90, false);
  const AxisMotion motion = plan_motion(machine, setup, path);
  EXPECT_EQ(motion.rewinds, 2u) << "the fewest that do";
  const auto pose = [&](const AxisMove& move) {
    return test::pose_by_matrices(machine, setup.origin_mm, path.cutter.length_mm, move.joints);
  };
  std::size_t done = 0, rewinds = 0;
  for (std::size_t i = 0; i < motion.moves.size(); ++i) {
    const AxisMove& move = motion.moves[i];
    ASSERT_LE(std::abs(move.joints.inner_rad), machine.inner.max_rad + 1e-9);
    const ToolPose here = pose(move);
    while (done < path.moves.size() && (here.tip_mm - path.moves[done].pose.tip_mm).norm() < 1e-8 &&
           (here.axis - path.moves[done].pose.axis).norm() < 3e-5) {
      ++done;
    }
    if (i < 3 || move.kind != MoveKind::kRapid) continue;
    if (!move.rotary_moves) {
      EXPECT_TRUE(move.joints.z_mm == machine.retract_z_mm || here.tip_mm.z() > path.clearance_z_mm);
      continue;
    }
    ++rewinds;
    // link up, rapid to the top | turn, across, down | plunge: in and out at one place.
    ASSERT_EQ(motion.moves[i - 2].kind, MoveKind::kLink);
    EXPECT_NEAR((pose(motion.moves[i - 2]).tip_mm - pose(motion.moves[i - 3]).tip_mm)
                    .cross(pose(motion.moves[i - 3]).axis)
                    .norm(),
                0, 1e-9)
        << "along the tool";
    ASSERT_EQ(motion.moves[i + 3].kind, MoveKind::kPlunge);
    EXPECT_LT((pose(motion.moves[i + 3]).tip_mm - pose(motion.moves[i - 3]).tip_mm).norm(), 1e-9);
    EXPECT_LT((pose(motion.moves[i + 3]).axis - pose(motion.moves[i - 3]).axis).norm(), 1e-9);
  }
  EXPECT_EQ(done, path.moves.size());
  EXPECT_EQ(rewinds, motion.rewinds);

  // Where the machine is too low to lift the tool, it is refused with the place.
  ToolPath low = path;
  low.clearance_z_mm = 320;
  EXPECT_THAT(refusal(machine, setup, low),
              AllOf(HasSubstr("cannot be lifted to turn back"), HasSubstr("split the pass"), HasSubstr("move ")));
}

TEST(PlanMotion, SlowsDownForTheTable) {
  MachineModel machine = test::hostile_machine();
  machine.outer.max_speed_rad_per_s = machine.inner.max_speed_rad_per_s = 0.2;
  const WorkSetup setup = work_on_table(machine, {11, 7, 30}, 54);
  const ToolPath path = test::lead_rows(10 * kDeg, 2, 20);
  const AxisMotion motion = plan_motion(machine, setup, path);
  expect_motion_holds(machine, setup, path, motion);
  EXPECT_GT(motion.slowed_moves, 0);
  EXPECT_NEAR(motion.max_axis_speed_ratio, 1, 1e-12);
}

TEST(PlanMotion, BlocksLastAsLongAsTheControllerNeeds) {
  MachineModel machine = test::fixture_machine();
  machine.min_block_s = 0.1;
  const WorkSetup setup = work_on_table(machine, {0, 0, 30}, 54);
  for (const AxisMove& move : plan_motion(machine, setup, test::fixed_rows(0.5, 0, 1, 100)).moves) {
    if (move.kind != MoveKind::kRapid) {
      EXPECT_GE(move.seconds, 0.1);
    }
  }
}

RC_GTEST_PROP(PlanMotion, RandomPathsHold, ()) {
  using test::real;
  MachineModel machine = test::fixture_machine();
  machine.outer.point_mm += Vec3(real(-20, 20), real(-20, 20), real(-20, 20));
  machine.inner.point_mm += Vec3(real(-20, 20), real(-20, 20), real(-20, 20));
  machine.outer.direction = *rc::gen::element(-1.0, 1.0);
  machine.inner.direction = *rc::gen::element(-1.0, 1.0);
  const WorkSetup setup = work_on_table(machine, {real(-10, 10), real(-10, 10), 30}, 54);
  ToolPath path = test::empty_path(25);
  const auto pose = [&] {
    return ToolPose{{real(-20, 20), real(-20, 20), real(5, 25)}, direction(real(0, 50) * kDeg, real(-180, 180) * kDeg)};
  };
  path.moves.push_back({pose(), MoveKind::kRapid, 0});
  for (int i = 0; i < 6; ++i) {
    Move move{pose(), *rc::gen::element(MoveKind::kLink, MoveKind::kCut, MoveKind::kRapid), 20};
    if (move.kind == MoveKind::kRapid) move.pose.axis = path.moves.back().pose.axis;
    move.pose.tip_mm.x() += 0.1 + i;  // no two alike
    path.moves.push_back(move);
  }
  const AxisMotion motion = plan_motion(machine, setup, path);
  expect_motion_holds(machine, setup, path, motion);
  RC_ASSERT(!testing::Test::HasFailure());
}

TEST(PlanMotion, RefusesNamingPlaceAndRemedy) {
  const MachineModel machine = test::fixture_machine();
  const WorkSetup setup = work_on_table(machine, {0, 0, 30}, 54);
  ToolPath path = test::fixed_rows(30 * kDeg, 0, 1, 10);

  ToolPath far = path;
  for (Move& move : far.moves) move.pose.tip_mm.y() += 130;
  const std::string message = refusal(machine, setup, far);
  EXPECT_THAT(message,
              AllOf(HasSubstr("finish, move "), HasSubstr("of 15"), HasSubstr("tip ("), HasSubstr("axis ("),
                    HasSubstr("Y would stand at"), HasSubstr("its limit is 120 mm"), HasSubstr("shift the workpiece")));
  EXPECT_EQ(message.find('\n'), std::string::npos);

  ToolPath turning = test::lead_rows(20 * kDeg, 2, 10);
  for (Move& move : turning.moves) move.pose.tip_mm.y() += 130;
  EXPECT_THAT(refusal(machine, setup, turning), AllOf(HasSubstr("Y would stand at"), HasSubstr("shift the workpiece")));

  EXPECT_THAT(refusal(machine, work_on_table(machine, {0, 0, 400}, 54), path), HasSubstr("shorter tool"));

  ToolPath undercut = test::fixed_rows(120 * kDeg, 0, 1, 3);
  EXPECT_THAT(refusal(machine, setup, undercut),
              AllOf(HasSubstr("B would stand at 120 degrees"), HasSubstr("limit is 110")));

  ToolPath long_tool = path;
  long_tool.cutter.length_mm = 130;
  EXPECT_THAT(refusal(machine, setup, long_tool),
              AllOf(HasSubstr("cutter longer than the machine's reach"), HasSubstr("shorter tool")));

  MachineModel low = machine;
  low.retract_z_mm = -290;  // below the first place of the path
  EXPECT_THAT(refusal(low, setup, path), AllOf(HasSubstr("above the machine's top"), HasSubstr("lower the workpiece")));

  ToolPath turning_rapid = path;
  turning_rapid.moves.back().pose.axis = Vec3::UnitZ();
  EXPECT_THAT(refusal(machine, setup, turning_rapid), HasSubstr("a rapid must keep the tool axis"));

  ToolPath no_feed = path;
  no_feed.moves[3].feed_mm_per_s = 0;
  EXPECT_THAT(refusal(machine, setup, no_feed), AllOf(HasSubstr("move 4 of"), HasSubstr("feed greater than 0")));

  ToolPath crooked = path;
  crooked.moves[2].pose.axis *= 1.01;
  EXPECT_THAT(refusal(machine, setup, crooked), HasSubstr("unit vector"));

  ToolPath no_start = path;
  no_start.moves.erase(no_start.moves.begin());
  EXPECT_THAT(refusal(machine, setup, no_start), HasSubstr("begin with a rapid"));

  EXPECT_THAT(refusal(machine, setup, test::empty_path(25)), HasSubstr("no moves"));
}

// The remedy is worth its words: the shift that the message names makes the path fit.
TEST(PlanMotion, TheNamedShiftHelps) {
  const MachineModel machine = test::fixture_machine();
  ToolPath path = test::fixed_rows(30 * kDeg, 40 * kDeg, 1, 10);
  for (Move& move : path.moves) move.pose.tip_mm += Vec3(-30, 190, 0);
  Vec3 offset(0, 0, 30);
  const std::string message = refusal(machine, work_on_table(machine, offset, 54), path);
  Vec3 shift;
  ASSERT_EQ(std::sscanf(message.c_str() + message.find("workpiece by ("), "workpiece by (%lf, %lf, %lf)", &shift.x(),
                        &shift.y(), &shift.z()),
            3)
      << message;
  EXPECT_THAT(refusal(machine, work_on_table(machine, offset + shift * 1.001, 54), path), "accepted");
}

TEST(PlanMotion, StopsWhenAsked) {
  const MachineModel machine = test::fixture_machine();
  Monitor monitor;
  monitor.should_stop = [] { return true; };
  EXPECT_THROW(plan_motion(machine, work_on_table(machine, {0, 0, 30}, 54), test::lead_rows(0.3, 1, 5), {}, monitor),
               Stopped);
}

}  // namespace
}  // namespace lightmill

#include "postproc/kinematics.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "design/core/errors.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

using test::direction;
using test::kDeg;

using test::real;
Vec3 vector(double size) {
  return {real(-size, size), real(-size, size), real(-size, size)};
}

// LinuxCNC's xyzbc-trt with B20 C60, x-offset -20, z-offset -15.
TEST(Kinematics, AgreesWithLinuxCnc) {
  MachineModel machine = test::fixture_machine();
  machine.outer.direction = machine.inner.direction = 1;
  machine.outer.point_mm = {-20, 0, -15};
  machine.inner.point_mm = Vec3::Zero();
  const JointPosition joints{15.031181490, 17.320508076, -6.466751884, 20 * kDeg, 60 * kDeg};
  const ToolPose pose = forward(machine, {}, 0, joints);
  EXPECT_LT((pose.tip_mm - Vec3(20, 0, 5)).norm(), 2e-9);
  const auto both = inverse(machine, {}, 0, pose);
  EXPECT_NEAR(both[0].x_mm, joints.x_mm, 2e-9);
  EXPECT_NEAR(both[0].y_mm, joints.y_mm, 2e-9);
  EXPECT_NEAR(both[0].z_mm, joints.z_mm, 2e-9);
  EXPECT_NEAR(both[0].outer_rad, 20 * kDeg, 1e-12);
  EXPECT_NEAR(both[0].inner_rad, 60 * kDeg, 1e-12);
}

// ISO 841: the programmed angles name the tool's turn relative to the work, t = (sin B cos C, sin B sin C, cos B)
// [5.1].
TEST(Kinematics, IsoAnglesLeanTheToolWhereTheySay) {
  const MachineModel machine = test::fixture_machine();
  const ToolPose pose = forward(machine, {}, 85, {0, 0, 0, 25 * kDeg, 40 * kDeg});
  EXPECT_LT((pose.axis - direction(25 * kDeg, 40 * kDeg)).norm(), 1e-15);
}

TEST(Kinematics, JointsAtZeroOnlyShift) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup{{3, -8, -400}, 54};
  const ToolPose pose = forward(machine, setup, 85, {10, 20, -300, 0, 0});
  EXPECT_LT((pose.tip_mm - Vec3(7, 28, 15)).norm(), 1e-12);
}

RC_GTEST_PROP(Kinematics, ForwardAgreesWithMatrices, ()) {
  MachineModel machine = test::fixture_machine();
  machine.outer.point_mm = vector(50);
  machine.inner.point_mm = vector(50);
  machine.outer.direction = *rc::gen::element(-1.0, 1.0);
  machine.inner.direction = *rc::gen::element(-1.0, 1.0);
  const WorkSetup setup{vector(80), 54};
  const JointPosition joints{real(-250, 250), real(-120, 120), real(-360, 0), real(-110, 110) * kDeg,
                             real(-720, 720) * kDeg};
  const ToolPose ours = forward(machine, setup, 85, joints);
  const ToolPose theirs = test::pose_by_matrices(machine, setup.origin_mm, 85, joints);
  RC_ASSERT((ours.tip_mm - theirs.tip_mm).norm() < 1e-10);
  RC_ASSERT((ours.axis - theirs.axis).norm() < 1e-13);
}

// From joints over the machine's whole range to a pose and back: one of the branches is where we came from, the other
// is another way to the same pose.
RC_GTEST_PROP(Kinematics, InverseFindsTheJointsAgain, ()) {
  MachineModel machine = test::fixture_machine();
  machine.outer.point_mm = vector(50);
  machine.inner.point_mm = vector(50);
  machine.outer.direction = *rc::gen::element(-1.0, 1.0);
  machine.inner.direction = *rc::gen::element(-1.0, 1.0);
  const WorkSetup setup{vector(80), 54};
  const double outer = *rc::gen::element(-1.0, 1.0) * real(0.001, 110) * kDeg;
  const JointPosition joints{real(-250, 250), real(-120, 120), real(-360, 0), outer, real(-180, 180) * kDeg};
  const ToolPose pose = forward(machine, setup, 85, joints);
  const auto both = inverse(machine, setup, 85, pose);
  RC_ASSERT(both[0].outer_rad >= 0 && both[1].outer_rad <= 0);
  const JointPosition& same = both[outer > 0 ? 0 : 1];
  // An axis is known to 1e-16, its azimuth to that over the sine of its tilt.
  const double azimuth = 1e-14 / std::sin(std::abs(outer) > kPi / 2 ? kPi / 2 : std::abs(outer));
  RC_ASSERT(std::abs(same.outer_rad - outer) < 1e-13);
  RC_ASSERT(std::abs(std::remainder(same.inner_rad - joints.inner_rad, 2 * kPi)) < azimuth);
  RC_ASSERT(std::abs(same.x_mm - joints.x_mm) < 1e-10 + 300 * azimuth);
  RC_ASSERT(std::abs(same.y_mm - joints.y_mm) < 1e-10 + 300 * azimuth);
  RC_ASSERT(std::abs(same.z_mm - joints.z_mm) < 1e-10 + 300 * azimuth);
}

RC_GTEST_PROP(Kinematics, BothBranchesReachThePose, ()) {
  MachineModel machine = test::fixture_machine();
  machine.outer.point_mm = vector(50);
  machine.inner.point_mm = vector(50);
  const WorkSetup setup{vector(80), 54};
  // Tilts from far below the resolution of any machine to beyond the horizontal.
  const double tilt = std::pow(10.0, real(-11, 0)) * 110 * kDeg;
  const ToolPose pose{vector(60), direction(tilt, real(-180, 180) * kDeg)};
  for (const JointPosition& joints : inverse(machine, setup, 85, pose)) {
    RC_ASSERT(joints.inner_rad > -kPi && joints.inner_rad <= kPi);
    const ToolPose again = test::pose_by_matrices(machine, setup.origin_mm, 85, joints);
    RC_ASSERT((again.tip_mm - pose.tip_mm).norm() < 1e-9);
    RC_ASSERT((again.axis - pose.axis).norm() < 1e-13);
  }
}

// General directions: an A/C trunnion, and a nutating table whose outer axis leans by 45 degrees.
RC_GTEST_PROP(Kinematics, OtherTrunnionsRoundTrip, ()) {
  MachineModel machine = test::hostile_machine();
  machine.outer.axis = *rc::gen::element(Vec3(1, 0, 0), Vec3(0, 1, 1).normalized(), Vec3(0.2, 0.9, -0.3).normalized());
  machine.inner.axis = *rc::gen::element(Vec3(0, 0, 1), Vec3(0.1, -0.05, 1).normalized());
  const WorkSetup setup{vector(80), 54};
  const JointPosition joints{real(-250, 250), real(-120, 120), real(-360, 0), real(-110, 110) * kDeg,
                             real(-180, 180) * kDeg};
  const ToolPose pose = forward(machine, setup, 85, joints);
  const auto both = inverse(machine, setup, 85, pose);
  RC_ASSERT(both[0].outer_rad >= both[1].outer_rad);
  for (const JointPosition& branch : both) {
    const ToolPose again = forward(machine, setup, 85, branch);
    RC_ASSERT((again.tip_mm - pose.tip_mm).norm() < 1e-6);  // square roots near the edge of the reachable cone
    RC_ASSERT((again.axis - pose.axis).norm() < 1e-7);
  }
}

// One axis or both on the head, none of them quite square: the tip is found with rotation matrices along the chain.
RC_GTEST_PROP(Kinematics, HeadsRoundTripAndAgreeWithMatrices, ()) {
  MachineModel machine = test::hostile_machine();
  const bool both = *rc::gen::arbitrary<bool>();
  machine.chain = both ? Chain::kHeadHead : Chain::kHeadTable;
  machine.outer.on_head = true;
  machine.inner.on_head = both;
  machine.outer.point_mm = vector(80);
  machine.inner.point_mm = vector(80);
  machine.outer.axis = (Vec3::UnitY() + vector(0.01)).normalized();
  machine.inner.axis = (Vec3::UnitZ() + vector(0.01)).normalized();
  machine.outer.direction = *rc::gen::element(-1.0, 1.0);
  machine.inner.direction = *rc::gen::element(-1.0, 1.0);
  const WorkSetup setup{vector(80), 54};
  const double length = 85;
  const JointPosition joints{real(-250, 250), real(-120, 120), real(-360, 0), real(3, 100) * kDeg,
                             real(-180, 180) * kDeg};
  const auto turn = [](const RotaryAxis& axis, double q) {
    return Eigen::Matrix3d(Eigen::AngleAxisd(axis.direction * q, axis.axis));
  };
  const Eigen::Matrix3d o = turn(machine.outer, joints.outer_rad), i = turn(machine.inner, joints.inner_rad);
  const Vec3 P = machine.outer.point_mm, Q = machine.inner.point_mm, gauge(joints.x_mm, joints.y_mm, joints.z_mm);
  const Vec3 on_head = P + o * (Vec3(0, 0, -length) - P);
  const Vec3 tip = both ? Vec3(gauge + Q + i * (on_head - Q))
                        : Vec3(Q + i.transpose() * (gauge + on_head - Q));
  const Vec3 axis = both ? Vec3(i * o * Vec3::UnitZ()) : Vec3(i.transpose() * o * Vec3::UnitZ());
  const ToolPose pose = forward(machine, setup, length, joints);
  RC_ASSERT((pose.tip_mm - (tip - setup.origin_mm)).norm() < 1e-10);
  RC_ASSERT((pose.axis - axis).norm() < 1e-13);
  double nearest = 1e9;
  for (const JointPosition& branch : inverse(machine, setup, length, pose)) {
    const ToolPose again = forward(machine, setup, length, branch);
    RC_ASSERT((again.tip_mm - pose.tip_mm).norm() < 1e-8);
    RC_ASSERT((again.axis - pose.axis).norm() < 1e-10);
    nearest = std::min(nearest, std::abs(branch.x_mm - joints.x_mm) + std::abs(branch.outer_rad - joints.outer_rad));
  }
  RC_ASSERT(nearest < 1e-7);
}

TEST(Kinematics, ThreeAxesReachTheVerticalOnly) {
  MachineModel machine = test::fixture_machine();
  machine.chain = Chain::kThreeAxis;
  const auto joints = inverse(machine, {{1, 2, -400}, 54}, 85, {{3, 4, 5}, Vec3::UnitZ()});
  EXPECT_LT((Vec3(joints[0].x_mm, joints[0].y_mm, joints[0].z_mm) - Vec3(4, 6, -310)).norm(), 1e-12);
  EXPECT_THROW(inverse(machine, {}, 85, {Vec3::Zero(), direction(0.1, 0)}), InputError);
}

TEST(Kinematics, UnreachableAxisOfANutatingTableIsRefused) {
  MachineModel machine = test::hostile_machine();
  machine.outer.axis = Vec3(0, 1, 1).normalized();  // reaches up to the horizontal, no farther
  EXPECT_NO_THROW(inverse(machine, {}, 85, {Vec3::Zero(), direction(80 * kDeg, 1)}));
  EXPECT_THROW(inverse(machine, {}, 85, {Vec3::Zero(), direction(100 * kDeg, 1)}), InputError);
}

TEST(Kinematics, PoleTakesTheGivenInnerAngle) {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup{{3, -8, -400}, 54};
  const ToolPose pose{{5, 6, 7}, Vec3::UnitZ()};
  for (const JointPosition& joints : inverse(machine, setup, 85, pose, 1.25)) {
    EXPECT_EQ(joints.inner_rad, 1.25);
    EXPECT_NEAR(joints.outer_rad, 0, 1e-15);
    EXPECT_LT((forward(machine, setup, 85, joints).tip_mm - pose.tip_mm).norm(), 1e-12);
  }
}

// acos(t_z) would lose half the digits here.
TEST(Kinematics, TiltIsExactNearThePole) {
  const MachineModel machine = test::fixture_machine();
  const auto both = inverse(machine, {}, 85, {Vec3::Zero(), direction(1e-9, 0.3)});
  EXPECT_NEAR(both[0].outer_rad, 1e-9, 1e-22);
  EXPECT_NEAR(both[0].inner_rad, 0.3, 1e-7);
}

TEST(WorkOnTable, AddsTheOffsetToTheTablesCentre) {
  const MachineModel machine = test::fixture_machine();
  const WorkSetup setup = work_on_table(machine, {1, 2, 30}, 55);
  EXPECT_LT((setup.origin_mm - Vec3(1, 2, -390)).norm(), 1e-12);
  EXPECT_EQ(setup.work_offset, 55);
  EXPECT_THROW(work_on_table(machine, Vec3::Zero(), 60), InputError);
}

}  // namespace
}  // namespace lightmill

#include "machine/kinematics.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>

#include "machine_rig.h"

namespace lightmill {
namespace {

constexpr double kRad = kPi / 180;

// LinuxCNC 2.9 (xyzbc-trt-kins), measured: the joints for tip (20, 0, 5), B 20, C 60, x-offset -20, z-offset -15. Its
// rotary signs are the table's.
TEST(Kinematics, AgreesWithLinuxCnc) {
  MachineModel machine;
  machine.outer.axis = Vec3::UnitY();
  machine.outer.point_mm = {-20, 0, -15};
  machine.outer.direction = 1;
  machine.inner.axis = Vec3::UnitZ();
  machine.inner.point_mm = Vec3::Zero();
  machine.inner.direction = 1;
  WorkpieceView view(machine, Vec3::Zero());
  const ToolPose pose = view.cutter({15.031181490, 17.320508076, -6.466751884, 20 * kRad, 60 * kRad}, 0);
  EXPECT_NEAR(pose.tip_mm.x(), 20, 2e-9);
  EXPECT_NEAR(pose.tip_mm.y(), 0, 2e-9);
  EXPECT_NEAR(pose.tip_mm.z(), 5, 2e-9);
}

// Programmed ISO angles name the tool's direction in the work: (sin B cos C, sin B sin C, cos B).
RC_GTEST_PROP(Kinematics, IsoAnglesAreTheToolsDirection, ()) {
  const double b = *rc::gen::inRange(-110, 110) * kRad, c = *rc::gen::inRange(-720, 720) * kRad;
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  const Vec3 axis = view.cutter({1, 2, -3, b, c}, 85).axis;
  const Vec3 expected(std::sin(b) * std::cos(c), std::sin(b) * std::sin(c), std::cos(b));
  RC_ASSERT((axis - expected).norm() < 1e-13);
}

// A point glued to the table and carried by hand, step by step, through the turns of the machine file.
RC_GTEST_PROP(Kinematics, FollowsAPointGluedToTheTable, ()) {
  const MachineModel m = test::skew_machine();
  const Vec3 origin(10, -5, -400);
  const auto number = [](int range) { return *rc::gen::inRange(-range * 1000, range * 1000) / 1000.0; };
  const double b = number(110) * kRad, c = number(400) * kRad, length = 85;
  const Vec3 p_W(number(50), number(40), number(30));
  Vec3 p = origin + p_W;
  p = m.inner.point_mm + Eigen::AngleAxisd(m.inner.direction * c, m.inner.axis) * (p - m.inner.point_mm);
  p = m.outer.point_mm + Eigen::AngleAxisd(m.outer.direction * b, m.outer.axis) * (p - m.outer.point_mm);
  WorkpieceView view(m, origin);
  const ToolPose pose = view.cutter({p.x(), p.y(), p.z() + length, b, c}, length);
  RC_ASSERT((pose.tip_mm - p_W).norm() < 1e-11);
}

// Every chain, axes as measured (out of square): the cutter carried by hand through the head's turns, the work through
// the table's; then the joints back from the tip.
RC_GTEST_PROP(Kinematics, FollowsEveryChain, ()) {
  MachineModel m = test::skew_machine();
  m.outer.axis = Vec3(0.001, 1, -0.0005).normalized();
  m.inner.axis = Vec3(0.0007, -0.0012, 1).normalized();
  m.chain = *rc::gen::element(Chain::kThreeAxis, Chain::kTableTable, Chain::kHeadTable, Chain::kHeadHead);
  if (m.chain == Chain::kHeadTable || m.chain == Chain::kHeadHead) {
    m.outer.point_mm = {3, -2, 140};
    m.outer.direction = 1;
  }
  if (m.chain == Chain::kHeadHead) {
    m.inner.point_mm = {-5, 4, 90};
    m.inner.direction = 1;
  }
  const auto number = [](int range) { return *rc::gen::inRange(-range * 1000, range * 1000) / 1000.0; };
  const double b = number(110) * kRad, c = number(400) * kRad, length = 85;
  const Vec3 gauge(number(50), number(40), number(30)), origin(10, -5, -400);
  const auto turned = [](const RotaryAxis& axis, double angle, const Vec3& p, const Vec3& at) -> Vec3 {
    const Vec3 pivot = at + axis.point_mm;
    return pivot + Eigen::AngleAxisd(axis.direction * angle, axis.axis) * (p - pivot);
  };
  Vec3 tip = gauge - Vec3(0, 0, length), nose = gauge;
  const auto carry_tool = [&](const RotaryAxis& axis, double angle) {
    tip = turned(axis, angle, tip, gauge);
    nose = turned(axis, angle, nose, gauge);
  };
  const auto look_back = [&](const RotaryAxis& axis, double angle) {
    tip = turned(axis, -angle, tip, Vec3::Zero());
    nose = turned(axis, -angle, nose, Vec3::Zero());
  };
  if (m.chain == Chain::kTableTable) look_back(m.outer, b);
  if (m.chain == Chain::kHeadTable || m.chain == Chain::kHeadHead) carry_tool(m.outer, b);
  if (m.chain == Chain::kHeadHead) carry_tool(m.inner, c);
  if (m.chain == Chain::kTableTable || m.chain == Chain::kHeadTable) look_back(m.inner, c);
  WorkpieceView view(m, origin);
  const ToolPose pose = view.cutter({gauge.x(), gauge.y(), gauge.z(), b, c}, length);
  RC_ASSERT((pose.tip_mm - (tip - origin)).norm() < 1e-11);
  RC_ASSERT((pose.axis - (nose - tip) / length).norm() < 1e-12);
  const JointPosition back = view.joints(pose.tip_mm, b, c, length);
  RC_ASSERT((Vec3(back.x_mm, back.y_mm, back.z_mm) - gauge).norm() < 1e-11);
}

TEST(Kinematics, HandMadeQuarterTurns) {
  const MachineModel m = test::skew_machine();
  const Vec3 origin(10, -5, -400);
  WorkpieceView view(m, origin);
  // Everything at zero: the tip hangs `length` below the gauge point, seen from the workpiece's origin.
  EXPECT_LT((view.cutter({10, -5, -300, 0, 0}, 85).tip_mm - Vec3(0, 0, 15)).norm(), 1e-12);
  // C +90 (ISO): the table turns by -90 about (4, -7). The work's origin, 6 right and 2 up of that, goes to (2, -6)
  // from it: machine (6, -13). There the tip is over the origin; +X of the machine is +Y of the work.
  EXPECT_LT((view.cutter({6, -13, -300, 0, kPi / 2}, 85).tip_mm - Vec3(0, 0, 15)).norm(), 1e-12);
  EXPECT_LT((view.cutter({7, -13, -300, 0, kPi / 2}, 85).tip_mm - Vec3(0, 1, 15)).norm(), 1e-12);
  // B +90 (ISO): the table turns by -90 about Y through (-3, -380): up goes to -X, +X goes to up. The origin, 13 right
  // and 20 below, comes to 20 right and 13 above: (17, -367). The tool lies along the work's +X.
  const ToolPose tilted = view.cutter({17, -5, -367 + 85, kPi / 2, 0}, 85);
  EXPECT_LT(tilted.tip_mm.norm(), 1e-12);
  EXPECT_LT((tilted.axis - Vec3::UnitX()).norm(), 1e-12);
}

TEST(Kinematics, WrongLengthSignOrPivotMovesTheTip) {
  const Vec3 origin(10, -5, -400);
  const JointPosition joints{20, 10, -250, 25 * kRad, 40 * kRad};
  const MachineModel good = test::skew_machine();
  const Vec3 tip = WorkpieceView(good, origin).cutter(joints, 85).tip_mm;
  EXPECT_NEAR((WorkpieceView(good, origin).cutter(joints, 84).tip_mm - tip).norm(), 1, 1e-12);
  MachineModel bad = good;
  bad.inner.direction = 1;
  EXPECT_GT((WorkpieceView(bad, origin).cutter(joints, 85).tip_mm - tip).norm(), 1);
  bad = good;
  bad.outer.point_mm.x() += 0.1;
  // A pivot shifted by d moves the tip by |d - R d| = 2 d sin(B / 2).
  EXPECT_NEAR((WorkpieceView(bad, origin).cutter(joints, 85).tip_mm - tip).norm(), 0.2 * std::sin(12.5 * kRad), 1e-12);
}

// Pieces join, keep to the joints' own path, and are as straight as promised.
RC_GTEST_PROP(Kinematics, PiecesFollowTheJoints, ()) {
  const auto number = [](int range) { return *rc::gen::inRange(-range * 1000, range * 1000) / 1000.0; };
  Motion motion;
  motion.from = {number(50), number(50), -300 + number(20), number(100) * kRad, number(300) * kRad};
  motion.to = {number(50), number(50), -300 + number(20), number(100) * kRad, number(300) * kRad};
  motion.seconds = 3;
  motion.line = 17;
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  const SweepTolerance tolerance;
  std::vector<SweptMove> pieces;
  view.sweep(motion, 85, tolerance, pieces);
  RC_ASSERT((pieces.front().from.tip_mm - view.cutter(motion.from, 85).tip_mm).norm() < 1e-9);
  RC_ASSERT((pieces.back().to.tip_mm - view.cutter(motion.to, 85).tip_mm).norm() < 1e-9);
  const double n = static_cast<double>(pieces.size());
  double seconds = 0;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const SweptMove& piece = pieces[i];
    seconds += piece.seconds;
    RC_ASSERT(piece.line == 17);
    if (i > 0) RC_ASSERT(piece.from.tip_mm == pieces[i - 1].to.tip_mm);
    const double t = (static_cast<double>(i) + 0.5) / n;
    const auto mix = [t](double a, double b) { return a + t * (b - a); };
    const JointPosition middle{mix(motion.from.x_mm, motion.to.x_mm), mix(motion.from.y_mm, motion.to.y_mm),
                               mix(motion.from.z_mm, motion.to.z_mm), mix(motion.from.outer_rad, motion.to.outer_rad),
                               mix(motion.from.inner_rad, motion.to.inner_rad)};
    const ToolPose true_middle = view.cutter(middle, 85);
    RC_ASSERT((true_middle.tip_mm - (piece.from.tip_mm + piece.to.tip_mm) / 2).norm() <= tolerance.tip_mm);
    RC_ASSERT(piece.from.axis.dot(piece.to.axis) >= std::cos(tolerance.axis_rad * 1.001));
  }
  RC_ASSERT(std::abs(seconds - 3) < 1e-9);
}

TEST(Kinematics, MovesWithoutRotationStayWhole) {
  Motion motion;
  motion.from = {0, 0, -200, 0.3, 0.4};
  motion.to = {50, 20, -210, 0.3, 0.4};
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  std::vector<SweptMove> pieces;
  view.sweep(motion, 85, {}, pieces);
  EXPECT_EQ(pieces.size(), 1U);
}

}  // namespace
}  // namespace lightmill

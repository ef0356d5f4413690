#include "machine/machine_errors.h"

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <cmath>

#include "design/core/errors.h"
#include "machine/kinematics.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

const Vec3 kOrigin(10, -5, -400);
constexpr double kLength = 85;

Motion motion(const JointPosition& from, const JointPosition& to, double seconds = 1) {
  Motion m;
  m.from = from;
  m.to = to;
  m.seconds = seconds;
  return m;
}

std::vector<SweptMove> swept(WorkpieceView& view, const Motion& m) {
  std::vector<SweptMove> pieces;
  view.sweep(m, kLength, {}, pieces);
  return pieces;
}

// Joints whose tip stands at p of the workpiece, all turns zero.
JointPosition over(const Vec3& p) { return {p.x() + kOrigin.x(), p.y() + kOrigin.y(), p.z() + kOrigin.z() + kLength, 0, 0}; }

TEST(MachineErrors, NoneChangesNothing) {
  rc::check([] {
    const auto number = [](int range) { return *rc::gen::inRange(-range * 1000, range * 1000) / 1000.0; };
    const Motion m = motion({number(50), number(50), number(50), number(1), number(3)}, {number(50), number(50), number(50), number(1), number(3)});
    WorkpieceView plain(test::skew_machine(), kOrigin), with(test::skew_machine(), kOrigin, {});
    const auto a = swept(plain, m), b = swept(with, m);
    RC_ASSERT(a.size() == b.size());
    for (std::size_t i = 0; i < a.size(); ++i) RC_ASSERT(a[i].to.tip_mm == b[i].to.tip_mm && a[i].seconds == b[i].seconds);
  });
}

// A scale error of 50 um a metre: 40 mm become 40.002. Out of square by 100 um a metre: 30 mm of Y push X by 3 um.
TEST(MachineErrors, GeometryIsSeenFromTheWorkpiecesZero) {
  MachineErrors errors;
  errors.scale = {50e-6, 0, 0};
  errors.squareness_rad = {100e-6, 0, 0};
  WorkpieceView view(test::skew_machine(), kOrigin, errors);
  const auto pieces = swept(view, motion(over({0, 0, 0}), over({40, 30, 5})));
  EXPECT_LT((pieces.front().from.tip_mm - Vec3(0, 0, 0)).norm(), 1e-12);
  EXPECT_LT((pieces.back().to.tip_mm - Vec3(40 + 0.002 + 0.003, 30, 5)).norm(), 1e-12);
}

// There and back with 4 um of play: the way back lags 4 um behind, once the play is taken up, and starts standing still.
TEST(MachineErrors, BacklashIsLostMotionAfterATurn) {
  MachineErrors errors;
  errors.backlash_mm = {0.004, 0, 0};
  WorkpieceView view(test::skew_machine(), kOrigin, errors);
  swept(view, motion(over({0, 0, 0}), over({10, 0, 0})));
  const auto back = swept(view, motion(over({10, 0, 0}), over({5, 0, 0})));
  ASSERT_EQ(back.size(), 2U);
  EXPECT_NEAR(back[0].from.tip_mm.x(), 9.998, 1e-12);
  EXPECT_NEAR(back[0].to.tip_mm.x(), 9.998, 1e-12) << "the drive turns, the slide stands";
  EXPECT_NEAR(back[0].seconds, 0.004 / 5, 1e-12);
  EXPECT_NEAR(back[1].to.tip_mm.x(), 5.002, 1e-12);
  const auto on = swept(view, motion(over({5, 0, 0}), over({0, 0, 0})));
  ASSERT_EQ(on.size(), 1U) << "the same way on";
  EXPECT_NEAR(on[0].to.tip_mm.x(), 0.002, 1e-12);
}

TEST(MachineErrors, DriftAndVibrationFollowTheClock) {
  MachineErrors errors;
  errors.drift_mm = {0, 0, 0.01};
  errors.drift_hours = 0.5;
  WorkpieceView warm(test::skew_machine(), kOrigin, errors);
  Motion m = motion(over({0, 0, 5}), over({1, 0, 5}), 1800);
  EXPECT_NEAR(swept(warm, m).back().to.tip_mm.z(), 5 + 0.01 * (1 - std::exp(-1.0)), 1e-12);
  m = motion(over({1, 0, 5}), over({2, 0, 5}), 900);
  m.stood_s = 900;
  EXPECT_NEAR(swept(warm, m).back().to.tip_mm.z(), 5 + 0.01 * (1 - std::exp(-2.0)), 1e-12);

  MachineErrors shaking;
  shaking.vibration_mm = {0, 0, 0.002};
  shaking.vibration_hz = 50;
  WorkpieceView view(test::skew_machine(), kOrigin, shaking);
  double highest = 0, lowest = 0, seconds = 0;
  for (const SweptMove& piece : swept(view, motion(over({0, 0, 0}), over({18, 0, 0}), 1))) {
    seconds += piece.seconds;
    EXPECT_NEAR(piece.to.tip_mm.z(), 0.002 * std::sin(2 * kPi * 50 * seconds), 1e-9);
    highest = std::max(highest, piece.to.tip_mm.z());
    lowest = std::min(lowest, piece.to.tip_mm.z());
  }
  EXPECT_NEAR(highest, 0.002, 1e-4);
  EXPECT_NEAR(lowest, -0.002, 1e-4);
  EXPECT_NEAR(seconds, 1, 1e-12);
}

// A pivot that lies 10 um off moves the tip of a turned table by the turn's chord, and not at all unturned.
TEST(MachineErrors, PivotsActThroughTurnsOnly) {
  MachineErrors errors;
  errors.inner_pivot_mm = {0.01, 0, 0};
  WorkpieceView wrong(test::skew_machine(), kOrigin, errors), right(test::skew_machine(), kOrigin);
  const JointPosition straight = over({3, 4, 5});
  JointPosition turned = straight;
  turned.inner_rad = kPi / 3;
  EXPECT_LT((swept(wrong, motion(straight, straight)).back().to.tip_mm - Vec3(3, 4, 5)).norm(), 1e-12);
  const Vec3 off = swept(wrong, motion(straight, turned)).back().to.tip_mm - swept(right, motion(straight, turned)).back().to.tip_mm;
  EXPECT_NEAR(off.norm(), 0.01 * 2 * std::sin(kPi / 6), 1e-12);
}

TEST(MachineErrors, SeedsDrawSignsAndCuttersGrow) {
  MachineErrors errors;
  errors.scale = {1e-5, 1e-5, 1e-5};
  errors.tool_radius_mm = 0.003;
  bool both = false;
  for (unsigned seed = 1; seed < 20; ++seed) {
    errors.seed = seed;
    const DrawnErrors one = drawn(errors), again = drawn(errors);
    EXPECT_EQ(one.errors.scale, again.errors.scale);
    EXPECT_EQ(one.errors.scale.cwiseAbs(), errors.scale);
    both |= one.errors.tool_radius_mm < 0;
  }
  EXPECT_TRUE(both);
  errors.seed = 0;
  const Cutter ball = as_it_turns(test::ball(1, 80), errors);
  EXPECT_TRUE(ball.is_ball());
  EXPECT_NEAR(ball.radius_mm(), 2.003, 1e-12);
  errors.runout_mm = 0.005;
  const Cutter off = as_it_turns(test::ball(1, 80), errors);
  EXPECT_FALSE(off.is_ball());
  EXPECT_NEAR(off.radius_mm(), 2.008, 1e-12);
  EXPECT_NEAR(off.corner_radius_mm, 2.003, 1e-12);
}

TEST(MachineErrors, ARadiusThatLeavesNothingOfACutterIsRefusedByName) {
  MachineErrors errors;
  errors.tool_radius_mm = -3;
  try {
    as_it_turns(test::ball(1, 80), errors);
    FAIL() << "a cutter of less than nothing";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("tool_radius_um = -3000"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace lightmill

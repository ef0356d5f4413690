#include "machine/detail/work_frame.h"

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <cmath>

#include "machine_rig.h"

namespace lightmill {
namespace {

/// Every chain, with axes as measured: a little off, and a head whose axis leans.
MachineModel machine_of(Chain chain, bool leaning) {
  MachineModel m = test::skew_machine();
  m.chain = chain;
  m.outer.on_head = chain != Chain::kTableTable;
  m.inner.on_head = chain == Chain::kHeadHead;
  if (m.outer.on_head) m.outer.direction = 1;
  if (leaning) {
    m.outer.axis = Vec3(0.1, 1, 0.7).normalized();
    m.inner.axis = Vec3(0.02, -0.01, 1).normalized();
  }
  return m;
}

TEST(WorkFrame, AnglesTurnTheCutterIntoTheDirection) {
  EXPECT_TRUE(rc::check("angles that lead somewhere are found again, and lead there", [] {
    const Chain chain = *rc::gen::element(Chain::kTableTable, Chain::kHeadTable, Chain::kHeadHead);
    const MachineModel machine = machine_of(chain, *rc::gen::inRange(0, 2) == 1);
    WorkpieceView view(machine, {1, 2, 3});
    const auto angle = [](int most) { return *rc::gen::inRange(-most, most) * 1e-2; };
    const double outer = angle(150), inner = angle(600);
    const Vec3 axis = view.cutter({0, 0, 0, outer, inner}, 0).axis;
    const auto found = detail::angles_for(machine, view, 2.5 * axis, {angle(150), angle(600)});
    RC_ASSERT(!found.empty() && found.size() <= 2U);
    bool again = false;
    for (const detail::RotaryAngles& a : found) {
      RC_ASSERT((view.cutter({0, 0, 0, a.outer_rad, a.inner_rad}, 0).axis - axis).norm() < 1e-8);
      RC_ASSERT(a.outer_rad >= machine.outer.min_rad && a.outer_rad <= machine.outer.max_rad);
      again |= std::abs(a.outer_rad - outer) < 1e-6;
    }
    RC_ASSERT(again);
  }));
}

TEST(WorkFrame, AnglesStayNearAndWithinLimits) {
  MachineModel machine = test::skew_machine();
  WorkpieceView view(machine, Vec3::Zero());
  // Upright the inner angle is free and stays.
  const auto upright = detail::angles_for(machine, view, Vec3::UnitZ(), {0.3, 5});
  ASSERT_EQ(upright.size(), 1U);
  EXPECT_EQ(upright[0].inner_rad, 5);
  EXPECT_NEAR(upright[0].outer_rad, 0, 1e-12);
  // Small leans keep their angle.
  const auto lean = detail::angles_for(machine, view, {1e-7, 0, 1}, {0, 0});
  ASSERT_EQ(lean.size(), 2U);
  EXPECT_NEAR(std::abs(lean[0].outer_rad), 1e-7, 1e-13);
  // Whole turns towards where the axis stands, unless a limit is in the way.
  const Vec3 direction(std::sin(0.5), 0, std::cos(0.5));
  for (const auto& a : detail::angles_for(machine, view, direction, {0.5, 40 * kPi})) EXPECT_GT(a.inner_rad, 38 * kPi);
  machine.inner.max_rad = 2 * kPi;
  machine.inner.min_rad = -2 * kPi;
  for (const auto& a : detail::angles_for(machine, view, direction, {0.5, 40 * kPi})) EXPECT_LE(a.inner_rad, 2 * kPi);
  machine.outer.min_rad = 0;
  EXPECT_EQ(detail::angles_for(machine, view, direction, {0.5, 0}).size(), 1U);
  EXPECT_TRUE(detail::angles_for(machine, view, -direction, {0.5, 0}).empty());
}

}  // namespace
}  // namespace lightmill

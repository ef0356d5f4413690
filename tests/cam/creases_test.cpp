#include "cam/creases.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

TEST(ConcaveCreases, AValleyIsOneLineWithItsAngleFilletAndLeftover) {
  // Planes that meet at the normal jump a along a line at a slant: a fillet 2 R sin(a / 2) wide, R (1 / cos(a / 2) - 1) high.
  constexpr double kRadius = 2;
  for (const double jump : {0.2, 0.4}) {
    const double m = std::tan(jump / 2), turn = 0.4;
    const Vec2 across(-std::sin(turn), std::cos(turn));
    const auto s = test::spline_of(Box2::centred({8, 6}), 200, 150, [&](double x, double y) { return 10 + m * std::abs(across.dot(Vec2(x, y)) - 0.3); });
    const auto creases = concave_creases(s, reachable_surface(s, kRadius, 0.05));
    ASSERT_EQ(creases.size(), 1U) << "jump " << jump;
    const Crease& c = creases.front();
    EXPECT_NEAR(c.length_mm, 8 / std::cos(turn), 0.2);
    EXPECT_NEAR(c.angle_rad, jump, 0.02 * jump);
    // The residue's ends are flat: below the threshold for sqrt(2 R 1e-4) on either side.
    EXPECT_NEAR(c.fillet_mm, 2 * kRadius * std::sin(jump / 2) - 2 * std::sqrt(2 * kRadius * 1e-4), 0.05);
    EXPECT_NEAR(c.leftover_um, 1e3 * kRadius * (1 / std::cos(jump / 2) - 1), 0.02 * c.leftover_um + 1.5);
    for (const Vec2& p : c.line_mm) EXPECT_NEAR(across.dot(p), 0.3, 0.06);
  }
}

TEST(ConcaveCreases, RidgesAndWideHollowsAreNoneAndTwoValleysAreTwo) {
  const auto creases_of = [](const std::function<double(double, double)>& form) {
    const auto s = test::spline_of(Box2::centred({8, 6}), 160, 120, form);
    return concave_creases(s, reachable_surface(s, 2, 0.05)).size();
  };
  EXPECT_EQ(creases_of([](double, double y) { return 10 - 0.2 * std::abs(y); }), 0U);
  EXPECT_EQ(creases_of([](double x, double y) { return 10 + 0.02 * (x * x + y * y); }), 0U);
  EXPECT_EQ(creases_of([](double, double y) { return 10 + 0.2 * std::abs(y - 1.5) + 0.15 * std::abs(y + 1.5); }), 2U);
}

}  // namespace
}  // namespace lightmill

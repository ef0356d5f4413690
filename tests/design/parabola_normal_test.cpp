#include "design/detail/parabola_normal.h"

#include <gtest/gtest.h>

#include <cmath>

namespace lightmill::detail {
namespace {

/// On a turned and shifted paraboloid of slopes (0.2, -0.1) at the origin; `noise_mm` up and down in turns.
Vec3 on_paraboloid(double along, double across, double noise_mm) {
  const Vec2 p = Vec2(along * 0.8 - across * 0.6, along * 0.6 + across * 0.8);
  return {p.x() + 3, p.y() - 5, 7 + 0.2 * p.x() - 0.1 * p.y() + 0.03 * p.x() * p.x() - 0.02 * p.x() * p.y() + 0.01 * p.y() * p.y() + noise_mm};
}

/// Of a border and `rows` rows within it, 0.3 mm apart.
std::vector<Vec3> beside_a_border(int rows, double noise_mm) {
  std::vector<Vec3> places;
  for (int row = 0; row <= rows; ++row) {
    for (int k = -2; k <= 2; ++k) {
      if (row != 0 || k != 0) places.push_back(on_paraboloid(0.3 * k, 0.3 * row, (k + row) % 2 == 0 ? noise_mm : -noise_mm));
    }
  }
  return places;
}

TEST(ParabolaNormal, IsExactOnAParaboloid) {
  const auto normal = parabola_normal(on_paraboloid(0, 0, 0), beside_a_border(2, 0));
  ASSERT_TRUE(normal);
  EXPECT_LT((*normal - Vec3(-0.2, 0.1, 1).normalized()).norm(), 1e-12);
}

TEST(ParabolaNormal, IsNoneWhereNothingTellsSlopeFromCurvature) {
  EXPECT_FALSE(parabola_normal(on_paraboloid(0, 0, 0), beside_a_border(1, 1e-4))) << "two lines";
  EXPECT_FALSE(parabola_normal(on_paraboloid(0, 0, 0), beside_a_border(0, 1e-4))) << "one line";
  std::vector<Vec3> bent = beside_a_border(1, 1e-4);
  for (Vec3& p : bent) p.x() += 1e-5 * std::sin(40 * p.y());
  EXPECT_FALSE(parabola_normal(on_paraboloid(0, 0, 0), bent)) << "nearly two lines";
}

TEST(ParabolaNormal, HeightsThatAreOffTiltItByThatOverTheDistance) {
  const auto normal = parabola_normal(on_paraboloid(0, 0, 0), beside_a_border(2, 1e-4));
  ASSERT_TRUE(normal);
  EXPECT_LT((*normal - Vec3(-0.2, 0.1, 1).normalized()).norm(), 5 * 1e-4 / 0.3);
}

}  // namespace
}  // namespace lightmill::detail

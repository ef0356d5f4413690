// What is told of a surface before any pass is planned, against closed forms.
#include "cam/machinability.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "design/core/errors.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::cutter;
using test::spline_of;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr double kDegree = kPi / 180;

OutlineRegion all_of(const SplineSurface& surface) {
  return {Outline{Outline::Shape::kRectangle, surface.extent().size(), {}}, 0};
}

SplineSurface leaning(double degrees) {
  return spline_of(Box2::centred({8, 7}), 24, 22, [&](double, double y) { return 14 + std::tan(degrees * kDegree) * y; });
}

TEST(ContactWindow, OfALeaningPlaneIsItsAngleToTheAxisAndPlanningTakesATiltThatKeepsIt) {
  const auto s = leaning(25);
  const ContactWindow window = contact_window(s, {}, all_of(s), 0.3);  // 30 degrees towards -Y
  EXPECT_NEAR(window.least_rad, 5 * kDegree, 1e-6);
  EXPECT_NEAR(window.most_rad, 5 * kDegree, 1e-6);
  EXPECT_EQ(window.outside_share, 1) << "whatever the pitch is to the lens";
  EXPECT_THAT(window.refusal, IsEmpty());
  FinishOptions better;
  better.tilt_rad = window.tilt_rad.value();
  better.tilt_direction_rad = window.direction_rad.value();
  const ContactWindow kept = contact_window(s, better, all_of(s), 0.1);
  EXPECT_EQ(kept.outside_share, 0);
  EXPECT_EQ(kept.tilt_rad, window.tilt_rad);
}

TEST(ContactWindow, OfAnUprightBallOnACapIsOpenWithinTenDegreesOfItsTop) {
  const double rho = 20;
  const auto s = spline_of(Box2::centred({10, 9}), 60, 54, [&](double x, double y) { return std::sqrt(rho * rho - x * x - y * y) - 8; });
  FinishOptions upright;
  upright.axis = AxisPolicy::kVertical;
  const ContactWindow window = contact_window(s, upright, all_of(s), 0.05);
  const double radius = rho * std::sin(10 * kDegree);
  EXPECT_NEAR(window.outside_share, kPi * radius * radius / 90, 0.01 * kPi * radius * radius / 90);
  EXPECT_LT(window.worst_mm.norm(), 0.05);
  EXPECT_THAT(window.refusal, IsEmpty());
}

TEST(ContactWindow, NamesThePassAndTheTiltThatWouldDoWhereTheOneAskedForIsFarOff) {
  const auto s = leaning(2.5);
  FinishOptions options;
  options.pass = "semi_finish";
  options.tilt_rad = 80 * kDegree;
  const ContactWindow window = contact_window(s, options, all_of(s), 0.1);
  EXPECT_THAT(window.refusal, HasSubstr("semi_finish.axis"));
  EXPECT_THAT(window.refusal, HasSubstr("use less tilt: semi_finish.tilt_deg = 5"));
  EXPECT_FALSE(window.tilt_rad.has_value());
  options.tilt_rad = 50 * kDegree;
  EXPECT_THAT(contact_window(s, options, all_of(s), 0.1).refusal, IsEmpty());
}

TEST(ContactWindow, OfABallThatLeansFromTheNormalIsItsLeanOnAPlane) {
  const auto s = leaning(12);
  FinishOptions options;
  options.axis = AxisPolicy::kLeadTilt;
  options.tilt_rad = 20 * kDegree;
  const ContactWindow window = contact_window(s, options, all_of(s), 0.2);
  EXPECT_NEAR(window.least_rad, 20 * kDegree, 1e-6);
  EXPECT_NEAR(window.most_rad, 20 * kDegree, 1e-6);
}

TEST(Scan, FindsTheSteepestSlopeAndTheAreaOfSharperHollows) {
  // A trough of radius 1.5 across y, 2 mm wide: h = y^2 / (2 rho), whose curvature falls with the slope, h'' / (1 + h'^2)^1.5.
  const double rho = 1.5;
  const auto s = spline_of(Box2::centred({6, 2}), 60, 40, [&](double, double y) { return 12 + y * y / (2 * rho); });
  const SurfaceScan scan = scan_surface(s, all_of(s), 2, 0.02);
  EXPECT_NEAR(1 / scan.most_concave_per_mm, rho, 1e-3);
  EXPECT_NEAR(std::tan(scan.steepest_rad), 0.99 / rho, 1e-6);
  // Radius below 2 where (1 + (y / rho)^2)^1.5 < 2 / rho.
  const double half = rho * std::sqrt(std::pow(2 / rho, 2.0 / 3) - 1);
  EXPECT_NEAR(scan.sharper_mm2, 6 * 2 * half, 0.04 * 6);
}

TEST(Leftovers, InAValleyAreItsFilletsHeightAndNormals) {
  const double m = 0.3, radius = 2, alpha = std::atan(m);
  const auto s = spline_of(Box2::centred({4, 3}), 160, 120, [&](double, double y) { return 12 + m * std::abs(y); });
  const ReachableSurface reachable = reachable_surface(s, radius, 0.02);
  const Leftovers left = leftovers(reachable, concave_creases(s, reachable));
  const double half = radius * std::sin(alpha);
  const double seen = half - std::sqrt(2 * radius * 1e-4 * std::pow(std::cos(alpha), 3));  // where 0.1 um stay
  EXPECT_NEAR(left.in_creases.area_mm2, 4 * 2 * seen, 0.02 * 4 * 2 * seen);
  EXPECT_NEAR(left.in_creases.highest_um, 1e3 * radius * (std::sqrt(1 + m * m) - 1), 3);  // the spline rounds its bottom
  // At a distance y from the bottom the fillet's normal is asin(y / R) off upright, the flank's alpha.
  double squares = 0;
  constexpr int kSteps = 1000;
  for (int k = 0; k < kSteps; ++k) {
    const double off = alpha - std::asin((k + 0.5) / kSteps * half / radius);
    squares += off * off / kSteps;
  }
  EXPECT_NEAR(left.in_creases.rms_mrad, 1e3 * std::sqrt(squares), 0.06 * 1e3 * std::sqrt(squares));
  EXPECT_GT(left.in_creases.most_mrad, 0.9 * 1e3 * alpha);
  EXPECT_LE(left.in_creases.most_mrad, 1e3 * alpha);
  EXPECT_EQ(left.elsewhere.area_mm2, 0);
}

TEST(Leftovers, InADimpleSmallerThanTheBallAreElsewhere) {
  const auto s = spline_of(Box2::centred({4, 3}), 80, 60, [](double x, double y) { return 12 - 0.05 * std::exp(-(x * x + y * y) / 0.08); });
  const ReachableSurface reachable = reachable_surface(s, 2, 0.02);
  const Leftovers left = leftovers(reachable, concave_creases(s, reachable));
  EXPECT_EQ(left.in_creases.area_mm2, 0);
  EXPECT_NEAR(left.elsewhere.area_mm2, reachable.unreachable_area_mm2, 1e-6);
  EXPECT_NEAR(left.elsewhere.highest_um, reachable.max_residue_um, 1e-9);
  EXPECT_GT(left.elsewhere.most_mrad, 0);
}

}  // namespace
}  // namespace lightmill

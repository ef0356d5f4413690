#include "cam/detail/tool_clearance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <tuple>

#include "cam/finishing.h"
#include "design/core/errors.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using detail::ToolClearance;
using test::spline_of;

Cutter tapered(double degrees) {
  Cutter c = test::cutter("rest_1mm_ball");
  c.taper_rad = degrees * kPi / 180;
  c.shank.clear();
  c.shank_diameter_mm = 0.2;
  return c;
}

/// The tip of an upright ball that rests on a plane of this slope along x, over (0, y).
Vec3 resting_tip(double slope, double height, double radius, double y) {
  return {0, y, height + radius * std::sqrt(1 + slope * slope) - radius};
}

TEST(ToolClearance, StackedConesBesideASlopeTouchWhereTheirRimsDo) {
  // The rims of every piece against the plane; the grid knows the plane within a cell.
  constexpr double kSlope = 1.2;
  const auto plane = spline_of(Box2::centred({60, 50}), 30, 25, [](double x, double) { return 60 + kSlope * x; });
  const ToolClearance clearance(plane, Blank{{60, 50}, 100}, 0);
  Cutter c = test::cutter("finish_4mm_ball");
  c.flute_length_mm = 5;
  c.shank = {{5, 9, 1.5, 1.5}, {9, 15, 1.5, 6}};
  c.shank_diameter_mm = 12;
  c.holder = {{20, 30, 8, 12}, {30, 34, 16, 10}};
  std::mt19937 random(31);
  std::uniform_real_distribution<double> u(-1, 1);
  int hits = 0;
  for (int k = 0; k < 300; ++k) {
    const Vec3 tip(-6 + 4 * u(random), 5 * u(random), 62 + 12 * u(random));
    double gap = 1e9;
    for (const auto& [height, radius] : {std::pair(2.0, 2.0), {5.0, 2.0}, {9.0, 1.5}, {15.0, 6.0}, {20.0, 6.0},
                                         {20.0, 8.0}, {30.0, 12.0}, {30.0, 16.0}, {34.0, 10.0}}) {
      gap = std::min(gap, tip.z() + height - (60 + kSlope * (tip.x() + radius)));
    }
    if (std::abs(gap) < 0.3 * kSlope) continue;
    const bool touches = clearance.touches(c, {tip, Vec3::UnitZ()}, 0).has_value();
    EXPECT_EQ(touches, gap < 0) << "gap " << gap << ", tip " << tip.transpose();
    hits += touches;
  }
  EXPECT_GT(hits, 30);
  EXPECT_LT(hits, 270);
}

TEST(ToolClearance, TheShankIsHeldAgainstWhatStandsAndTheFlutesAreNot) {
  const auto flat = spline_of(Box2::centred({12, 10}), 12, 10, [](double, double) { return 10; });
  const Blank blank{{12, 10}, 15};
  Cutter c = test::cutter("semi_finish_4mm_ball");
  c.flute_length_mm = 3;
  c.shank.clear();
  c.shank_diameter_mm = 7;
  const ToolPose pose{Vec3(0, 0, 10), Vec3::UnitZ()};
  // A wall from x = 2.5 to 3.0 mm: under the shank (radius 3.5), beside the flutes (radius 2).
  for (const auto& [wall_x, height, contact] : {std::tuple(2.5, 2.9, false), {2.5, 3.1, true}, {4.0, 4.0, false}, {1.0, 2.9, false}}) {
    RestMaterial rest{Box2::centred({12, 10}), Grid<float>(49, 41, 10.3F)};
    for (int j = 0; j < 41; ++j) {
      for (int i = 0; i < 49; ++i) {
        const double x = -6 + 0.25 * i;
        if (x >= wall_x && x <= wall_x + 0.5) rest.heights_mm.at(i, j) = static_cast<float>(10 + height);
      }
    }
    EXPECT_EQ(ToolClearance(flat, blank, 0.05, 0.25, &rest).touches(c, pose).has_value(), contact) << wall_x << " " << height;
    EXPECT_FALSE(ToolClearance(flat, blank, 0.05).touches(c, pose).has_value());
  }
}

TEST(ToolClearance, APlanTiltsLessOrIsRefusedWhereTheShankWouldMeetWhatStands) {
  const auto flat = spline_of(Box2::centred({12, 10}), 12, 10, [](double, double) { return 10; });
  const Blank blank{{12, 10}, 13};
  Cutter fat = test::cutter("semi_finish_4mm_ball");
  fat.flute_length_mm = 2.1;
  fat.shank.clear();
  fat.shank_diameter_mm = 10;
  FinishOptions options;
  options.cusp_um = 40;
  options.allowance_mm = 0.05;
  options.longest_segment_mm = 2;
  options.tilt_rad = 20 * kPi / 180;
  // The shank's lowest place over the surface, leant by a.
  const auto clear = [](double a) { return 0.05 + 2 * (1 - std::cos(a)) + 2.1 * std::cos(a) - 5 * std::sin(a); };
  for (const double stands : {0.1, 0.8}) {
    options.standing = RestMaterial{Box2::centred({12, 10}), Grid<float>(49, 41, static_cast<float>(10 + stands))};
    const ToolPath path = plan_finishing(flat, blank, fat, options);
    EXPECT_GE(clear(std::acos(path.moves.front().pose.axis.z())), stands - 1e-3);
  }
  options.standing = RestMaterial{Box2::centred({12, 10}), Grid<float>(49, 41, 11.6F)};
  try {
    plan_finishing(flat, blank, fat, options);
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), ::testing::HasSubstr("thinner shank"));
  }
}

TEST(ToolClearance, ATaperedBallsFlankTouchesWallsSteeperThanItself) {
  for (const double wall_deg : {55.0, 70.0, 80.0}) {
    const double slope = std::tan(wall_deg * kPi / 180);
    const auto wall = spline_of(Box2::centred({6, 5}), 24, 20, [&](double x, double) { return 60 + slope * x; });
    const ToolClearance clearance(wall, Blank{{6, 5}, 100}, 0);
    for (const double taper_deg : {3.0, 14.0, 25.0}) {
      const auto contact = clearance.touches(tapered(taper_deg), {resting_tip(slope, 60, 0.5, 0.3), Vec3::UnitZ()});
      EXPECT_EQ(contact.has_value(), wall_deg + taper_deg > 90) << wall_deg << " " << taper_deg;
      if (contact) {
        EXPECT_FALSE(contact->holder);
      }
    }
    // Leaning away from the wall frees it.
    const Vec3 normal = Vec3(-slope, 0, 1).normalized();
    const Vec3 axis(-std::sin(0.5), 0, std::cos(0.5));
    const Vec3 centre = Vec3(0, 0.3, 60) + 0.5 * normal;
    EXPECT_FALSE(clearance.touches(tapered(25), {centre - 0.5 * axis, axis}).has_value()) << wall_deg;
  }
}

TEST(ToolClearance, APlanWithATaperedBallRefusesAWallThatItsFlankCutsAndSaysWhere) {
  // From one flat to another over a wall of at most 72 degrees at x = 0.
  const auto s = spline_of(Box2::centred({7, 3}), 70, 30, [](double x, double) {
    return 10 + 2 * std::sin(std::clamp(x, -1.0, 1.0) * kPi / 2);
  });
  FinishOptions options;
  options.cusp_um = 40;
  options.longest_segment_mm = 2;
  options.chord_tolerance_mm = 1e-3;
  options.axis = AxisPolicy::kVertical;
  EXPECT_NO_THROW(plan_finishing(s, Blank{{7, 3}, 13}, tapered(5), options));
  try {
    plan_finishing(s, Blank{{7, 3}, 13}, tapered(25), options);
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), ::testing::HasSubstr("flank"));
    EXPECT_THAT(e.what(), ::testing::ContainsRegex("near x -?0"));
    EXPECT_THAT(e.what(), ::testing::HasSubstr("less taper"));
  }
}

}  // namespace
}  // namespace lightmill

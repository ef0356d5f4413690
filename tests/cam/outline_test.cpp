#include "cam/outline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "cam/outline_region.h"
#include "design/core/errors.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;

/// A loop with hollows about the origin.
Outline flower(double radius, double petals, int count, int places = 300) {
  Outline outline;
  outline.shape = Outline::Shape::kLoop;
  for (int k = 0; k < places; ++k) {
    const double a = 2 * kPi * k / places;
    const double r = radius + petals * std::sin(count * a + 0.3);
    outline.loop_mm.emplace_back(r * std::cos(a), r * std::sin(a));
  }
  return outline;
}

Outline disk(double diameter) { return {Outline::Shape::kDisk, {diameter, diameter}, {}}; }

double nearest(const std::vector<Vec2>& loop, const std::vector<Vec2>& places) {
  double least = 1e9;
  for (const Vec2& p : places) least = std::min(least, distance_to_loop(loop, p));
  return least;
}

double signed_area(const std::vector<Vec2>& loop) {
  double twice = 0;
  for (std::size_t k = 0; k < loop.size(); ++k) {
    const Vec2 &a = loop[k], &b = loop[(k + 1) % loop.size()];
    twice += a.x() * b.y() - a.y() * b.x();
  }
  return twice / 2;
}

TEST(Outline, AWayAroundIsNowhereNearerThanTheRadiusAndHardlyFarther) {
  for (const double radius : {0.5, 3.0}) {
    for (const Outline& outline : {disk(20), Outline{Outline::Shape::kRectangle, {18, 11}, {}}, flower(10, 1, 5)}) {
      const std::vector<Vec2> way = way_around(outline, radius);
      const std::vector<Vec2> loop = outline_places(outline, 0.01);
      EXPECT_GT(signed_area(way), outline.area_mm2()) << "counter-clockwise, around it";
      // Anywhere on the way's chords, and from the loop's side: every place of the loop that is not in a hollow.
      Outline chords{Outline::Shape::kLoop, {}, way};
      const std::vector<Vec2> on_way = outline_places(chords, 0.02);
      const double least = nearest(loop, on_way);
      EXPECT_GE(least, radius - 1e-5);
      double farthest = 0;
      for (const Vec2& p : on_way) farthest = std::max(farthest, distance_to_loop(loop, p));
      EXPECT_LE(farthest, radius + 0.0061);
      for (const Vec2& p : on_way) EXPECT_FALSE(outline.contains(p));
    }
  }
}

TEST(Outline, AWayAroundADiskHasItsLengthAndARectanglesItsArcs) {
  const auto length = [](const std::vector<Vec2>& way) {
    double sum = 0;
    for (std::size_t k = 0; k < way.size(); ++k) sum += (way[(k + 1) % way.size()] - way[k]).norm();
    return sum;
  };
  EXPECT_NEAR(length(way_around(disk(30), 5)), 40 * kPi, 0.02);
  EXPECT_NEAR(length(way_around({Outline::Shape::kRectangle, {18, 11}, {}}, 5)), 2 * (18 + 11) + 10 * kPi, 0.02);
}

TEST(Outline, ANeckNarrowerThanTheMillIsRefusedWithItsPlace) {
  // A C whose mouth is 2 mm wide over a bay of 8 mm.
  Outline c;
  c.shape = Outline::Shape::kLoop;
  c.loop_mm = {{-10, -10}, {10, -10}, {10, -1}, {6, -1}, {6, -4}, {-4, -4}, {-4, 4}, {6, 4}, {6, 1}, {10, 1}, {10, 10}, {-10, 10}};
  EXPECT_NO_THROW(way_around(c, 0.4));
  try {
    way_around(c, 2);
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("radius 2 mm"));
    EXPECT_THAT(e.what(), HasSubstr("neck"));
  }
}

TEST(Outline, OfALensIsOnePieceWithoutHolesOrCrossings) {
  Lens lens;
  lens.shape = Lens::Shape::kOutline;
  lens.size_mm = {20, 20};
  const std::vector<Vec2> clockwise{{0, 0}, {0, 10}, {10, 10}, {10, 0}, {0, 0}};
  lens.outline_mm = {clockwise};
  const Outline outline = outline_of(lens);
  EXPECT_EQ(outline.loop_mm.size(), 4U);
  EXPECT_NEAR(outline.area_mm2(), 100, 1e-12);
  const auto message = [&] {
    try {
      outline_of(lens);
    } catch (const InputError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  lens.outline_mm = {clockwise, clockwise};
  EXPECT_THAT(message(), HasSubstr("2 loops"));
  lens.outline_mm = {{{0, 0}, {10, 10}, {10, 0}, {0, 8}}};
  EXPECT_THAT(message(), HasSubstr("crosses itself"));
  lens.outline_mm = {{{0, 0}, {10, 10}}};
  EXPECT_THAT(message(), HasSubstr("no area"));
}

TEST(OutlineRegion, HoldsTheInsideAndTheMarginToACell) {
  constexpr double kCellMm = 0.05 * 1.5;
  for (const Outline& outline : {disk(9), Outline{Outline::Shape::kRectangle, {7, 5}, {}}, flower(5, 1, 3)}) {
    const std::vector<Vec2> loop = outline_places(outline, 0.005);
    for (const double margin : {0.0, 0.6, -0.3}) {
      const OutlineRegion region(outline, margin);
      std::mt19937 random(5);
      std::uniform_real_distribution<double> u(-7, 7);
      for (int k = 0; k < 2000; ++k) {
        const Vec2 p(u(random), u(random));
        const double outside = distance_to_loop(loop, p) * (outline.contains(p) ? -1 : 1);
        if (margin >= 0 && outside <= margin) {
          EXPECT_TRUE(region.contains(p)) << p.transpose();
        } else if (margin >= 0 && outside > margin + 2 * kCellMm) {
          EXPECT_FALSE(region.contains(p)) << p.transpose();
        } else if (margin < 0 && outside >= margin) {
          EXPECT_FALSE(region.contains(p)) << p.transpose();
        } else if (margin < 0 && outside < margin - 2 * kCellMm) {
          EXPECT_TRUE(region.contains(p)) << p.transpose();
        }
      }
    }
  }
}

TEST(OutlineRegion, ReachAlongXIsTheGrownOutlines) {
  const std::vector<Vec2> places = outline_places(disk(20), 0.01);
  for (const double y : {0.0, 4.5, -9.99, 10.7, -11.4}) {
    const auto [from, to] = reach_along_x(places, 1.5, y);
    const double half = std::sqrt(11.5 * 11.5 - y * y);
    EXPECT_NEAR(to, half, 1e-4);
    EXPECT_NEAR(from, -half, 1e-4);
  }
  const auto [from, to] = reach_along_x(places, 1.5, 11.6);
  EXPECT_GT(from, to);
}

TEST(FadedOutside, KeepsTheLensAndEndsInLevelGround) {
  const auto hollow = [](double x, double y) { return 15 - 0.01 * (x * x + y * y) + 0.02 * x; };
  const auto s = test::spline_of(Box2::centred({60, 50}), 120, 100, hollow);
  const Outline outline = disk(20);
  const double ground = 15 - 0.01 * 100 - 0.02 * 10, drop = 3;
  const SplineSurface faded = faded_outside(s, outline, drop);
  for (double y = -44.5; y < 45; y += 0.7) {
    for (double x = -49.5; x < 50; x += 0.7) {
      const double r = std::hypot(x, y);
      if (r < 10 + 6 - 1.5 && s.height(x, y) > ground - drop / 2 + 0.2) {
        EXPECT_DOUBLE_EQ(faded.height(x, y), s.height(x, y));
      } else if (r > 10 + 14 + 1.5) {
        EXPECT_NEAR(faded.height(x, y), ground, 0.01);
      }
      EXPECT_GE(faded.height(x, y), ground - drop);
    }
  }
}

/// A 45 degree wedge's outlines, each touching the extent, so that beside it there are none of the fit's coefficients.
TEST(FadedOutside, LeadsNoCutterBelowTheLandOrTheBackHoweverLargeTheBlank) {
  const Vec2 size(12, 10);
  const auto s = test::spline_of(Box2::centred(size), 24, 20, [](double x, double y) { return 10 + x + 0.1 * y; });
  Outline rectangle;
  rectangle.size_mm = size;
  Outline triangle;
  triangle.shape = Outline::Shape::kLoop;
  triangle.loop_mm = {{-6, -5}, {6, -5}, {1, 5}};
  for (const Outline& outline : {rectangle, disk(10), triangle}) {
    double ground = 1e9;
    for (const Vec2& p : outline_places(outline, 0.1)) ground = std::min(ground, s.height(p.x(), p.y()));
    for (const double drop : {0.2, 1.0, 1000.0}) {
      const SplineSurface faded = faded_outside(s, outline, drop);
      const double floor = ground - std::min(drop, ground / 2);
      for (double y = -60; y <= 60; y += 0.5) {
        for (double x = -60; x <= 60; x += 0.5) {
          const double h = faded.height(x, y);
          if (outline.contains({x, y})) {
            EXPECT_NEAR(h, s.height(x, y), 1e-12);
          } else if (std::abs(x) > 8 || std::abs(y) > 7) {
            EXPECT_GE(h, floor - 1e-9) << x << " " << y;
          }
          if (std::hypot(x, y) > 50) {
            EXPECT_NEAR(h, ground, 1e-9) << x << " " << y;
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace lightmill

#include "cam/detail/wall_curve.h"

#include <gtest/gtest.h>

#include <cmath>

#include "cam/outline_region.h"

namespace lightmill::detail {
namespace {

/// A loop about a place off the origin; hollows where `petals_mm` is above 0.
Outline flower(double a, double b, double petals_mm, int places) {
  Outline outline;
  outline.shape = Outline::Shape::kLoop;
  for (int k = 0; k < places; ++k) {
    const double angle = 2 * kPi * k / places;
    const double r = 1 + petals_mm / a * std::sin(5 * angle + 0.3);
    outline.loop_mm.emplace_back(1.5 + r * a * std::cos(angle), -0.7 + r * b * std::sin(angle));
  }
  return outline;
}

const Outline kTriangle{Outline::Shape::kLoop, {}, {{-7, -5}, {8, -3}, {-1, 6}}};
const Outline kDisk{Outline::Shape::kDisk, {13, 13}, {}};
const Outline kRectangle{Outline::Shape::kRectangle, {13, 9}, {}};

/// The plane a + b x + c y.
SplineSurface plane(double a, double b, double c) {
  Grid<double> k(13, 18);
  for (int j = 0; j < k.height; ++j) {
    for (int i = 0; i < k.width; ++i) k.at(i, j) = a + b * (-10 + 2.0 * (i - 1)) + c * (-8 + 16.0 / 15 * (j - 1));
  }
  return {Box2::centred({20, 16}), 10, 15, k};
}

TEST(WallCurve, PiecesCloseAndKeepToTheOutlinesChords) {
  for (const Outline& outline : {kTriangle, kDisk, kRectangle, flower(9, 7, 0, 60), flower(7, 6, 1, 150)}) {
    const std::vector<WallPiece> walls = wall_pieces(outline);
    ASSERT_GE(walls.size(), 2U);
    const std::vector<Vec2> chords = outline_places(outline, 0.02);
    for (std::size_t w = 0; w < walls.size(); ++w) {
      const WallPiece& wall = walls[w];
      EXPECT_LT((wall.places.back() - walls[(w + 1) % walls.size()].places.front()).norm(), 1e-14);
      for (int k = 0; k <= 200; ++k) {
        const double t = wall.knots.front() + (wall.knots.back() - wall.knots.front()) * k / 200;
        EXPECT_LT(distance_to_loop(chords, wall.place(t)), 0.05);
        const Vec2 slope = (wall.place(t + 1e-5) - wall.place(t - 1e-5)) / 2e-5;
        if (k > 0 && k < 200) {
          EXPECT_LT((slope - wall.speed(t)).norm(), 1e-4 * slope.norm());
        }
      }
    }
  }
}

TEST(WallCurve, BetweenTurnsACoordinateRisesOrFallsAllTheWay) {
  for (const Outline& outline : {kTriangle, kDisk, flower(9, 7, 0, 60), flower(9, 7, 0, 100), flower(7, 6, 1, 150)}) {
    for (const WallPiece& wall : wall_pieces(outline)) {
      for (const int axis : {0, 1}) {
        const std::vector<double> turns = wall.turns(axis);
        for (std::size_t k = 0; k + 1 < turns.size(); ++k) {
          const double whole = wall.place(turns[k + 1])[axis] - wall.place(turns[k])[axis];
          for (int m = 0; m < 40; ++m) {
            const auto at = [&](int n) { return wall.place(turns[k] + (turns[k + 1] - turns[k]) * n / 40)[axis]; };
            EXPECT_GE((at(m + 1) - at(m)) * whole, -1e-13);
          }
        }
      }
    }
  }
}

TEST(WallCurve, AreaAndVolumeUnderAPlaneAreThoseOfTheShape) {
  const SplineSurface surface = plane(3, 0.1, -0.2);
  const auto held = [&](const Outline& outline, double area, const Vec2& middle, double relative) {
    const std::vector<WallPiece> walls = wall_pieces(outline);
    EXPECT_NEAR(area_within_mm2(walls) / area, 1, relative);
    EXPECT_NEAR(volume_within(surface, walls) / (area * (3 + 0.1 * middle.x() - 0.2 * middle.y())), 1, relative);
  };
  held(kTriangle, kTriangle.area_mm2(), {0, -2.0 / 3}, 1e-13);
  held(kRectangle, 13 * 9, {0, 0}, 1e-13);
  held(kDisk, kPi * 6.5 * 6.5, {0, 0}, 1e-9);
  held(flower(9, 7, 0, 60), kPi * 9 * 7, {1.5, -0.7}, 1e-5);
}

}  // namespace
}  // namespace lightmill::detail

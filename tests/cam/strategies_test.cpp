// Every strategy of the ball passes: what holds for one-way passes along X holds for it too.
#include <gtest/gtest.h>

#include <random>

#include "cam/finishing.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::spline_of;
using test::SweptBall;

Cutter ball() { return test::cutter("finish_4mm_ball"); }
Blank blank_for(const SplineSurface& s) { return {s.extent().size(), s.highest() + 0.4}; }
bool cuts(const Move& move) { return move.kind == MoveKind::kCut || move.kind == MoveKind::kPlunge; }
Vec3 centre(const ToolPath& path, std::size_t k) { return path.moves[k].pose.tip_mm + path.cutter.radius_mm() * path.moves[k].pose.axis; }

double hill(double x, double y) { return 12 + 0.05 * x - 0.03 * y + 0.11 * std::sin(0.7 * x + 0.4) * std::cos(0.5 * y - 0.2); }
SplineSurface hills(const Vec2& size) { return spline_of(Box2::centred(size), static_cast<int>(size.x() * 4), static_cast<int>(size.y() * 4), hill); }

TEST(Strategies, AJobTurnedByARightAngleGivesTurnedPaths) {
  const Vec2 size(6, 4.5);
  const SplineSurface s = hills(size);
  // (x, y) goes to (-y, x).
  const SplineSurface t = spline_of(Box2::centred({size.y(), size.x()}), static_cast<int>(size.y() * 4), static_cast<int>(size.x() * 4),
                                    [](double x, double y) { return hill(y, -x); });
  for (const Strategy strategy : {Strategy::kOneWay, Strategy::kZigZag, Strategy::kSpiral}) {
    FinishOptions options;
    options.cusp_um = 4;
    options.strategy = strategy;
    const ToolPath one = plan_finishing(s, blank_for(s), ball(), options);
    options.angle_rad = kPi / 2;
    const ToolPath other = plan_finishing(t, blank_for(t), ball(), options);
    ASSERT_EQ(one.moves.size(), other.moves.size());
    for (std::size_t k = 0; k < one.moves.size(); ++k) {
      const Vec3& a = one.moves[k].pose.tip_mm;
      // Beyond the lens's corners the surface goes on along X first, then along Y.
      const Vec3 c = centre(one, k);
      const bool over_lens = std::abs(c.x()) < size.x() / 2 - 0.6 && std::abs(c.y()) < size.y() / 2 - 0.6;
      ASSERT_NEAR((other.moves[k].pose.tip_mm - Vec3(-a.y(), a.x(), a.z())).norm(), 0, over_lens ? 1e-4 : 0.05)
          << k << " of strategy " << static_cast<int>(strategy);
      const Vec3& axis = one.moves[k].pose.axis;
      ASSERT_NEAR((other.moves[k].pose.axis - Vec3(-axis.y(), axis.x(), axis.z())).norm(), 0, 1e-12) << k;
      ASSERT_EQ(one.moves[k].kind, other.moves[k].kind);
    }
  }
}

struct Case {
  const char* name;
  Strategy strategy;
  double angle_deg;
  AxisPolicy axis;
  double allowance_mm;
};

class EveryStrategy : public ::testing::TestWithParam<Case> {};

TEST_P(EveryStrategy, StaysOutOfTheSurfaceAndLeavesNoCuspAboveTheLimit) {
  const Case& c = GetParam();
  const Vec2 size(6, 4.5);
  const SplineSurface s = hills(size);
  FinishOptions options;
  options.strategy = c.strategy;
  options.angle_rad = c.angle_deg * kPi / 180;
  options.axis = c.axis;
  options.allowance_mm = c.allowance_mm;
  const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
  EXPECT_EQ(path.above_limit_mm2, 0);
  const SweptBall swept(path);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  double most = 0, least = 0;
  Vec2 where;
  for (int k = 0; k < 15000; ++k) {
    Vec2 p(size.x() * u(random), size.y() * u(random));
    if (k % 5 == 0) p.x() = (k % 2 ? 0.5 : -0.5) * size.x();
    if (k % 5 == 1) p.y() = (k % 2 ? 0.5 : -0.5) * size.y();
    // Around the diagonals the spiral turns.
    if (k % 5 == 2) p.x() = (k % 2 ? 1 : -1) * (size.x() / 2 - (size.y() / 2 - std::abs(p.y()))) + 0.3 * u(random);
    if (std::abs(p.x()) > size.x() / 2) continue;
    const Vec3 q = Vec3(p.x(), p.y(), s.height(p.x(), p.y())) + c.allowance_mm * s.normal(p.x(), p.y());
    const double left = swept.left_mm(q);
    if (left > most) most = left, where = p;
    least = std::min(least, left);
  }
  EXPECT_LE(most, 1.3e-3 + 2e-5) << "at " << where.transpose();
  EXPECT_GT(most, 1.1e-3) << "closer than needed";
  EXPECT_GE(least, -5e-5);
}

INSTANTIATE_TEST_SUITE_P(Cases, EveryStrategy,
                         ::testing::Values(Case{"one_way_30", Strategy::kOneWay, 30, AxisPolicy::kVertical, 0},
                                           Case{"one_way_back_tilted", Strategy::kOneWay, 197, AxisPolicy::kFixed, 0},
                                           Case{"zig_zag", Strategy::kZigZag, 0, AxisPolicy::kFixed, 0},
                                           Case{"zig_zag_with_allowance", Strategy::kZigZag, -60, AxisPolicy::kVertical, 0.05},
                                           Case{"lead_along_115", Strategy::kOneWay, 115, AxisPolicy::kLeadTilt, 0},
                                           Case{"spiral", Strategy::kSpiral, 0, AxisPolicy::kFixed, 0},
                                           Case{"spiral_turned", Strategy::kSpiral, 20, AxisPolicy::kVertical, 0}),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(ZigZag, EveryOtherPassGoesBackAndSavesTheWayBack) {
  const SplineSurface s = hills({6, 4.5});
  FinishOptions options;
  const ToolPath one_way = plan_finishing(s, blank_for(s), ball(), options);
  options.strategy = Strategy::kZigZag;
  const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
  double from = 0, last = 0;
  int passes = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (!cuts(path.moves[k])) continue;
    if (!cuts(path.moves[k - 1])) from = path.moves[k - 1].pose.tip_mm.x();
    if (k + 1 < path.moves.size() && cuts(path.moves[k + 1])) continue;
    const double way = path.moves[k].pose.tip_mm.x() - from;
    EXPECT_GT(std::abs(way), 6);
    EXPECT_LE(way * last, 0) << "pass " << passes;
    ++passes;
    last = way;
  }
  EXPECT_GT(passes, 27);
  EXPECT_LT(path.length_mm(), 0.7 * one_way.length_mm());
}

TEST(Spiral, GoesFromTheOutsideInWithoutALift) {
  const Vec2 size(6, 4.5);
  const SplineSurface s = hills(size);
  FinishOptions options;
  options.strategy = Strategy::kSpiral;
  const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
  std::size_t first = 0, last = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (!cuts(path.moves[k])) continue;
    if (first == 0) first = k;
    last = k;
  }
  const auto depth = [&](std::size_t k) {
    const Vec3 c = centre(path, k);
    return std::min(size.x() / 2 - std::abs(c.x()), size.y() / 2 - std::abs(c.y()));
  };
  EXPECT_LT(depth(first - 1), -2.4) << "begins beside the block";
  double deepest = -3;
  for (std::size_t k = first; k <= last; ++k) {
    ASSERT_TRUE(cuts(path.moves[k])) << k << ": lifts";
    const Vec3 c = centre(path, k);
    if (c.z() > ball_centre_height(s, 2, c.x(), c.y()) + 1e-4) continue;  // on the curve away from the middle
    EXPECT_GT(depth(k), deepest - 0.5) << "goes back outwards";
    deepest = std::max(deepest, depth(k));
  }
  EXPECT_NEAR(deepest, size.y() / 2, 0.05);
  // Clockwise, as climb milling from the outside in asks for: twice the enclosed area is negative.
  double area = 0;
  for (std::size_t k = first; k <= last; ++k) area += centre(path, k - 1).x() * centre(path, k).y() - centre(path, k).x() * centre(path, k - 1).y();
  EXPECT_LT(area, -12 * size.prod());
}

struct OutlineCase {
  const char* name;
  Outline outline;
  double most_wasted;  ///< of the way that even passes would take
};

Outline disk(double diameter_mm) { return {Outline::Shape::kDisk, {diameter_mm, diameter_mm}, {}}; }

/// Three lobes, or five, with bays between them.
Outline lobes(int count, double radius_mm, double depth) {
  Outline outline;
  outline.shape = Outline::Shape::kLoop;
  for (int k = 0; k < 180; ++k) {
    const double angle = 2 * kPi * k / 180, r = radius_mm * (1 + depth * std::cos(count * angle + 0.3));
    outline.loop_mm.emplace_back(r * std::cos(angle), 0.9 * r * std::sin(angle));
  }
  return outline;
}

class OutlineSpiral : public ::testing::TestWithParam<OutlineCase> {};

TEST_P(OutlineSpiral, CoversTheLensInOneGoWithNoCuspAboveTheLimit) {
  const Outline& outline = GetParam().outline;
  const SplineSurface s = faded_outside(hills({8, 8}), outline, 1);
  const Blank blank{{30, 28}, s.highest() + 0.4};
  FinishOptions options;
  options.strategy = Strategy::kSpiral;
  options.outline = outline;
  options.axis = AxisPolicy::kVertical;
  const ToolPath path = plan_finishing(s, blank, ball(), options);
  EXPECT_EQ(path.above_limit_mm2, 0);

  // No lift, clockwise, and from the outside in: every turn is within the one before.
  std::size_t first = 0, last = 0;
  double area = 0, way = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (!cuts(path.moves[k])) continue;
    if (first == 0) first = k;
    last = k;
  }
  for (std::size_t k = first; k <= last; ++k) {
    ASSERT_TRUE(cuts(path.moves[k])) << k << ": lifts";
    const Vec3 a = centre(path, k - 1), b = centre(path, k);
    area += (a.x() * b.y() - b.x() * a.y()) / 2;
    way += (b - a).norm();
  }
  EXPECT_LT(area, -10 * outline.area_mm2());
  EXPECT_LT(centre(path, last).head<2>().norm(), 1);
  EXPECT_LT(way, GetParam().most_wasted * outline.area_mm2() / path.stepover_mm);

  const SweptBall swept(path);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> u(-1, 1);
  double most = 0, least = 0;
  Vec2 where = Vec2::Zero();
  const std::vector<Vec2> border = outline_places(outline, 0.1);
  for (int k = 0; k < 20000; ++k) {
    Vec2 p(4 * u(random), 4 * u(random));
    if (k % 4 == 0) p = border[k % border.size()];
    if (k % 4 == 1) p *= 0.1;  // where turns are small
    if (k % 4 != 0 && !outline.contains(p)) continue;
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    if (left > most) most = left, where = p;
    least = std::min(least, left);
  }
  EXPECT_LE(most, 1.3e-3 + 2e-5) << "at " << where.transpose();
  EXPECT_GT(most, 1.1e-3) << "closer than needed";
  EXPECT_GE(least, -5e-5);

  // It lands outside, and lifts in its own groove.
  const test::LandingCut landing = test::landing_cut(s, path, 0, [&](const Vec2& p) { return outline.contains(p); });
  EXPECT_EQ(landing.arcs, 1);
  EXPECT_LE(landing.most_mm, test::kLandingCutMm) << landing.where.transpose();
}

INSTANTIATE_TEST_SUITE_P(Outlines, OutlineSpiral,
                         ::testing::Values(OutlineCase{"disk", disk(6), 2.2}, OutlineCase{"three_lobes", lobes(3, 2.7, 0.25), 4},
                                           OutlineCase{"five_lobes", lobes(5, 3, 0.15), 4}),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(SpiralInADisk, OverACreaseLeavesNoCuspWhereTheBallReaches) {
  const Outline outline = disk(5);
  const SplineSurface s = faded_outside(spline_of(Box2::centred({5, 5}), 50, 50, [](double x, double y) { return 12 + 0.2 * std::abs(0.9 * x + 0.43 * y - 0.6); }), outline, 1);
  FinishOptions options;
  options.strategy = Strategy::kSpiral;
  options.outline = outline;
  options.axis = AxisPolicy::kVertical;
  const ToolPath path = plan_finishing(s, {{20, 20}, s.highest() + 0.4}, ball(), options);
  const SweptBall swept(path);
  std::mt19937 random(8);
  std::uniform_real_distribution<double> u(-2.5, 2.5);
  const double border = 2 * std::sin(std::atan(0.2)) + 0.02;
  for (int k = 0; k < 15000; ++k) {
    const Vec2 p(u(random), u(random));
    if (!outline.contains(p)) continue;
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    EXPECT_GE(left, -5e-5);
    const bool reachable = std::abs(0.9 * p.x() + 0.43 * p.y() - 0.6) / std::hypot(0.9, 0.43) > border;
    EXPECT_LE(left, reachable ? 1.3e-3 + 3e-5 : 1) << p.transpose();
  }
}

TEST(Spiral, OverACreaseLeavesNoCuspWhereTheBallReaches) {
  const Vec2 size(6, 5);
  const SplineSurface s = spline_of(Box2::centred(size), 60, 50, [](double x, double y) { return 12 + 0.2 * std::abs(0.9 * x + 0.43 * y - 0.6); });
  FinishOptions options;
  options.strategy = Strategy::kSpiral;
  options.axis = AxisPolicy::kVertical;
  const ToolPath path = plan_finishing(s, blank_for(s), ball(), options);
  const SweptBall swept(path);
  std::mt19937 random(8);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  const double border = 2 * std::sin(std::atan(0.2)) + 0.02;
  for (int k = 0; k < 15000; ++k) {
    const Vec2 p(size.x() * u(random), size.y() * u(random));
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    EXPECT_GE(left, -5e-5);
    const bool reachable = std::abs(0.9 * p.x() + 0.43 * p.y() - 0.6) / std::hypot(0.9, 0.43) > border;
    EXPECT_LE(left, reachable ? 1.3e-3 + 3e-5 : 1) << p.transpose();
  }
}

}  // namespace
}  // namespace lightmill

#include "cam/rest.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::spline_of;
using test::SweptBall;

const double kSlope = 0.25, kSmall = 0.5, kLarge = 2;
const Vec2 kSize(8, 6);

/// From the crease of an oblique valley.
double from_crease(const Vec2& p) { return 0.8 * p.y() - 0.6 * p.x() - 0.3; }

SplineSurface valley() {
  return spline_of(Box2::centred(kSize), 160, 120, [](double x, double y) { return 12 + kSlope * std::abs(from_crease({x, y})); });
}

RestPlan plan(const SplineSurface& s, const FinishOptions& options) {
  const Blank blank{kSize, s.highest() + 0.4};
  const ReachableSurface reachable = reachable_surface(s, kLarge, 0.05);
  const ToolPath finish = plan_finishing(s, blank, test::cutter("finish_4mm_ball"), {});
  return plan_rest(s, blank, test::cutter("rest_1mm_ball"), concave_creases(s, reachable), reachable, finish, options);
}

FinishOptions rest_options() {
  FinishOptions options;
  options.pass = "rest";
  return options;
}

TEST(Rest, LeavesOnlyTheSmallBallsFilletInAValley) {
  const SplineSurface s = valley();
  const RestPlan rest = plan(s, rest_options());
  // A ball of radius R leaves R (sqrt(1 + m^2) - 1) over the crease's bottom; the spline rounds it over 0.1 mm, 2 um up.
  const double per_radius = std::sqrt(1 + kSlope * kSlope) - 1;
  EXPECT_NEAR(rest.highest_before_um, 1e3 * kLarge * per_radius, 6);
  EXPECT_NEAR(rest.highest_after_um, 1e3 * kSmall * per_radius, 4);
  EXPECT_LT(rest.area_after_mm2, 0.4 * rest.area_before_mm2);
  EXPECT_EQ(rest.path.pass, "rest");
  EXPECT_GT(rest.ways, 5U);

  const SweptBall swept(rest.path);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  const double sine = std::sin(std::atan(kSlope));
  double most = 0, least = 0;
  int judged = 0;
  for (int k = 0; k < 20000; ++k) {
    Vec2 p(kSize.x() * u(random), kSize.y() * u(random));
    if (k % 4 == 0) p.x() = (k % 8 ? 0.5 : -0.5) * kSize.x();  // the border, which cuts the fillet off at a slant
    const double d = std::abs(from_crease(p));
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    least = std::min(least, left);
    if (d < kSmall * sine + 0.03 || d > kLarge * sine) continue;
    most = std::max(most, left);
    ++judged;
  }
  EXPECT_GE(least, -5e-5) << "gouges";
  EXPECT_LE(most, 1.3e-3 + 3e-5) << "what only the small ball reaches";
  EXPECT_GT(judged, 1000);
}

TEST(Rest, LandsAndLeavesAlongTheCreaseAboveTheSurface) {
  const SplineSurface s = valley();
  const RestPlan rest = plan(s, rest_options());
  int landings = 0;
  for (std::size_t k = 1; k + 1 < rest.path.moves.size(); ++k) {
    const Move& m = rest.path.moves[k];
    if (m.kind != MoveKind::kLink || rest.path.moves[k + 1].kind == MoveKind::kLink || rest.path.moves[k + 1].kind == MoveKind::kRapid) continue;
    ++landings;
    const Vec3 c = m.pose.tip_mm + kSmall * m.pose.axis;
    EXPECT_GT(c.z(), ball_centre_height(s, kSmall, c.x(), c.y()) + 0.4) << "down to the surface at link feed";
  }
  EXPECT_EQ(landings, static_cast<int>(rest.ways));
}

TEST(Rest, InsideTheLensItLandsWhereFinishingHasLeftNothing) {
  // A valley that ends within the lens.
  const Vec2 size(16, 6);
  const auto s = spline_of(Box2::centred(size), 160, 60, [](double x, double y) {
    return 12 + 0.02 * x + 0.25 * std::hypot(y - 0.4 * x, 0.05) * std::exp(-std::pow(std::hypot(x, y) / 2, 6));
  });
  const Blank blank{size, s.highest() + 0.4};
  const ToolPath finish = plan_finishing(s, blank, test::cutter("finish_4mm_ball"), {});
  const ReachableSurface reachable = reachable_surface(s, kLarge, 0.1);
  const std::vector<Crease> creases = concave_creases(s, reachable);
  FinishOptions options = rest_options();
  options.cusp_um = 4;
  const RestPlan rest = plan_rest(s, blank, test::cutter("rest_1mm_ball"), creases, reachable, finish, options);
  const auto counts = [&](const Vec2& p) { return s.extent().contains(p); };
  const test::LandingCut cut = test::landing_cut(s, rest.path, 0.05, counts, finish);
  EXPECT_GT(cut.arcs, 4);
  EXPECT_LE(cut.most_mm, test::kLandingCutMm) << "at " << cut.where.transpose();

  // And so does the finishing ball that goes along the crease once more.
  for (const Crease& crease : creases) options.also_along.push_back(line_to_follow(crease));
  const test::LandingCut again = test::landing_cut(s, plan_finishing(s, blank, test::cutter("finish_4mm_ball"), options), 0.05, counts);
  EXPECT_GT(again.arcs, 1);
  EXPECT_LE(again.most_mm, test::kLandingCutMm) << "at " << again.where.transpose();
}

TEST(Rest, WithoutACreaseThereIsNothingToDo) {
  const SplineSurface flat = spline_of(Box2::centred(kSize), 24, 18, [](double x, double y) { return 12 + 0.1 * x - 0.002 * y * y; });
  const RestPlan rest = plan(flat, rest_options());
  EXPECT_EQ(rest.ways, 0U);
  EXPECT_TRUE(rest.path.moves.empty());
  EXPECT_EQ(rest.highest_before_um, 0);
}

TEST(AlongCreases, TheBallFollowsTheCreaseOnceMore) {
  const SplineSurface s = valley();
  FinishOptions options;
  options.cusp_um = 3;
  const Blank blank{kSize, s.highest() + 0.4};
  const ToolPath plain = plan_finishing(s, blank, test::cutter("finish_4mm_ball"), options);
  for (const Crease& crease : concave_creases(s, reachable_surface(s, kLarge, 0.05))) options.also_along.push_back(line_to_follow(crease));
  ASSERT_EQ(options.also_along.size(), 1U);
  const ToolPath path = plan_finishing(s, blank, test::cutter("finish_4mm_ball"), options);
  // Up to the last pass's end both plans are the same; what comes then lies over the crease, on the surface.
  ASSERT_GT(path.moves.size(), plain.moves.size());
  const std::size_t same = plain.moves.size() - 2;
  for (std::size_t k = 0; k < same; ++k) ASSERT_EQ(path.moves[k].pose.tip_mm, plain.moves[k].pose.tip_mm);
  double length = 0;
  for (std::size_t k = same + 1; k < path.moves.size(); ++k) {
    if (path.moves[k].kind != MoveKind::kCut) continue;
    const Vec3 c = path.moves[k].pose.tip_mm + kLarge * path.moves[k].pose.axis;
    EXPECT_LT(std::abs(from_crease(c.head<2>())), 0.08);
    EXPECT_GE(c.z(), ball_centre_height(s, kLarge, c.x(), c.y()) - 1e-7);
    length += (path.moves[k].pose.tip_mm - path.moves[k - 1].pose.tip_mm).norm();
  }
  EXPECT_GT(length, 7);
}

}  // namespace
}  // namespace lightmill

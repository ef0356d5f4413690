#include "cam/detail/feeds.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

TEST(ChipShare, IsTheThicknessOfAChipOnTheEffectiveCircle) {
  // By the definition: an edge on a circle of diameter D enters where the engaged width s ends, at an angle phi with
  // cos(phi) = 1 - 2 s / D; the chip there is feed per tooth times sin(phi).
  const double radius = 2, stepover = 0.155, angle = 0.4;
  const double diameter = 2 * radius * std::sin(angle + std::asin(stepover / (2 * radius)));
  EXPECT_NEAR(detail::chip_share(radius, stepover, angle), std::sin(std::acos(1 - 2 * stepover / diameter)), 1e-12);
  EXPECT_EQ(detail::chip_share(radius, stepover, 0), 1) << "on the ball's centre the edge cuts with all of its circle";
  double last = 1;
  for (double a = 0.01; a < 1.4; a += 0.01) {
    const double share = detail::chip_share(radius, stepover, a);
    EXPECT_LE(share, last) << "thinner the farther out";
    last = share;
  }
}

TEST(ChipFeed, KeepsTheChipAsThinAsTheDataMeans) {
  const Cutter ball = test::cutter("finish_4mm_ball");
  const double meant = detail::chip_share(2, 0.14, detail::kDataContactAngle);
  EXPECT_EQ(detail::chip_feed(ball, 0.14, detail::kDataContactAngle), ball.feed_mm_per_s());
  EXPECT_EQ(detail::chip_feed(ball, 0.14, 0.9), ball.feed_mm_per_s()) << "never above the data";
  for (double angle = 0.02; angle < 0.9; angle += 0.02) {
    const double feed = detail::chip_feed(ball, 0.14, angle);
    const double thickest = feed / ball.feed_mm_per_s() * detail::chip_share(2, 0.14, angle);
    EXPECT_LE(thickest, meant * (1 + 1e-9));
    EXPECT_GT(feed, 0.4 * ball.feed_mm_per_s());
  }
}

/// A way of random bends in the plane, all at one feed, with a link in the middle.
std::vector<Move> way(std::uint32_t seed, double feed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  std::vector<Move> moves(1);
  double heading = 0;
  for (int k = 0; k < 400; ++k) {
    heading += (u(random) < 0.1 ? 1.0 : 0.01) * (u(random) - 0.5);
    const Vec3 tip = moves.back().pose.tip_mm + (0.01 + 0.2 * u(random)) * Vec3(std::cos(heading), 0.3 * std::sin(heading), std::sin(heading));
    moves.push_back({{tip, Vec3::UnitZ()}, k == 200 ? MoveKind::kLink : MoveKind::kCut, k == 200 ? 80 : feed});
  }
  return moves;
}

TEST(Acceleration, StaysBelowTheLimitInBendsAndAlongTheWay) {
  for (const std::uint32_t seed : {1U, 2U, 3U}) {
    const double limit = 1000;
    const std::vector<Move> before = way(seed, 30);
    std::vector<Move> moves = before;
    detail::limit_acceleration(moves, limit);
    int slowed = 0;
    for (std::size_t k = 1; k < moves.size(); ++k) {
      EXPECT_LE(moves[k].feed_mm_per_s, before[k].feed_mm_per_s);
      EXPECT_GT(moves[k].feed_mm_per_s, 0.5);
      slowed += moves[k].feed_mm_per_s < before[k].feed_mm_per_s;
    }
    EXPECT_EQ(moves[201].feed_mm_per_s, 80) << "links are through air";
    for (std::size_t k = 1; k + 1 < moves.size(); ++k) {
      if (moves[k].kind != MoveKind::kCut || moves[k + 1].kind != MoveKind::kCut) continue;
      const Vec3 a = moves[k].pose.tip_mm - moves[k - 1].pose.tip_mm;
      const Vec3 b = moves[k + 1].pose.tip_mm - moves[k].pose.tip_mm;
      const double bend = std::acos(std::clamp(a.normalized().dot(b.normalized()), -1.0, 1.0));
      const double over = std::min(0.2, (a.norm() + b.norm()) / 2);
      const double v = std::max(moves[k].feed_mm_per_s, moves[k + 1].feed_mm_per_s);
      EXPECT_LE(v * v * 2 * std::tan(bend / 2) / over, limit * 1.0001) << k;
    }
    EXPECT_GT(slowed, 50);
    EXPECT_LT(slowed, 350);
    // Once settled, nothing changes any more on a straight way, and without a limit nothing at all.
    std::vector<Move> free = before;
    detail::limit_acceleration(free, 1e9);
    for (std::size_t k = 0; k < free.size(); ++k) EXPECT_EQ(free[k].feed_mm_per_s, before[k].feed_mm_per_s);
  }
}

TEST(Acceleration, SlowsDownBeforeACornerAndSpeedsUpBehindIt) {
  std::vector<Move> moves(1);
  for (int k = 1; k <= 40; ++k) moves.push_back({{{0.1 * std::min(k, 20), 0.1 * std::max(0, k - 20), 0}, Vec3::UnitZ()}, MoveKind::kCut, 40});
  detail::limit_acceleration(moves, 500);
  // At the corner a radius of 0.1 / (2 tan 45 degrees); from there v^2 grows by at most 2 a for every mm, and the ladder
  // takes at most 15 % off.
  for (int k = 1; k <= 40; ++k) {
    const int away = k <= 20 ? 20 - k : k - 21;
    const double most = std::min(40.0, std::sqrt(500 * 0.05 + 2 * 500 * 0.1 * away));
    EXPECT_LE(moves[k].feed_mm_per_s, most * 1.0001) << k;
    EXPECT_GE(moves[k].feed_mm_per_s, 0.84 * most) << k;
  }
}

}  // namespace
}  // namespace lightmill

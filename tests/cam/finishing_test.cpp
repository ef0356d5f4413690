#include "cam/finishing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <filesystem>
#include <random>

#include "cam/detail/ball_contact.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/parallel.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::cutter;
using test::spline_of;
using test::SweptBall;
using ::testing::HasSubstr;

constexpr double kCentreToleranceMm = 5e-5;  // 0.05 um
constexpr double kGougeToleranceMm = 6e-5;   // the chord tolerance and a little

Cutter finishing_ball() {
  return cutter("finish_4mm_ball");
}

Box2 box(double x0, double y0, double x1, double y1) {
  Box2 b;
  b.include({x0, y0});
  b.include({x1, y1});
  return b;
}

/// A blank round a surface centred on the origin.
Blank blank_for(const SplineSurface& s) {
  return {s.extent().size(), s.highest() + 0.4};
}

/// Smooth, hilly, off-centre, slopes up to about 0.3, concave radii above 5 mm.
SplineSurface hilly(std::uint32_t seed, const Vec2& size) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  struct Wave {
    double kx, ky, phase, height;
  };
  std::vector<Wave> waves;
  for (int k = 0; k < 6; ++k) {
    const double length = 8 + 10 * u(random);
    const double angle = 2 * kPi * u(random);
    const double wave = 2 * kPi / length;
    waves.push_back({wave * std::cos(angle), wave * std::sin(angle), 6 * u(random), 0.033 / wave / wave});
  }
  return spline_of(Box2::centred(size), static_cast<int>(size.x() / 0.31), static_cast<int>(size.y() / 0.31),
                   [&](double x, double y) {
                     double h = 12 + 0.05 * x - 0.03 * y;
                     for (const Wave& w : waves) h += w.height * std::sin(w.kx * x + w.ky * y + w.phase);
                     return h;
                   });
}

// ---- where a ball rests -------------------------------------------------------------------------------------------

TEST(BallCentreHeight, OnAPlaneIsTheOffsetPlane) {
  const double a = 0.4, b = -0.25, radius = 2;
  const auto s = spline_of(box(-10, -8, 12, 9), 70, 50, [&](double x, double y) { return 12 + a * x + b * y; });
  for (const Vec2& c : {Vec2(0, 0), Vec2(-9.9, 8.8), Vec2(3.3, -7.7), Vec2(13.5, 10)}) {  // also beyond the border
    EXPECT_NEAR(ball_centre_height(s, radius, c.x(), c.y()),
                12 + a * c.x() + b * c.y() + radius * std::sqrt(1 + a * a + b * b), 1e-9);
  }
}

TEST(BallCentreHeight, OnASphericalCapIsAConcentricSphere) {
  const double rho = 147, radius = 2;
  const auto cap = [&](double r, double x, double y) { return std::sqrt(r * r - x * x - y * y); };
  const auto hill =
      spline_of(box(-40, -30, 42, 33), 264, 200, [&](double x, double y) { return cap(rho, x, y) - 120; });
  const double hollow_rho = 30;
  const auto hollow =
      spline_of(box(-12, -9, 12, 10), 80, 60, [&](double x, double y) { return 50 - cap(hollow_rho, x, y); });
  std::mt19937 random(3);
  std::uniform_real_distribution<double> u(-1, 1);
  for (int k = 0; k < 50; ++k) {
    const double x = 36 * u(random), y = 27 * u(random);
    EXPECT_NEAR(ball_centre_height(hill, radius, x, y), cap(rho + radius, x, y) - 120, kCentreToleranceMm);
    EXPECT_NEAR(ball_centre_height(hollow, radius, x / 4, y / 4), 50 - cap(hollow_rho - radius, x / 4, y / 4),
                kCentreToleranceMm);
  }
}

TEST(BallCentreHeight, OnASaddleAndACylinderIsTheNormalOffset) {
  // Quadratics are exact in the spline; all radii of curvature are above the ball's, so every offset point is a centre.
  const double radius = 2;
  for (const auto& [kx, ky] : {std::pair{0.08, -0.05}, std::pair{0.0, 0.12}, std::pair{-0.3, 0.0}}) {
    const auto f = [kx = kx, ky = ky](double x, double y) { return 10 + kx * x * x / 2 + ky * y * y / 2; };
    const auto s = spline_of(box(-8, -7, 9, 6), 55, 42, f);
    std::mt19937 random(9);
    std::uniform_real_distribution<double> u(-3.5, 3.5);
    for (int k = 0; k < 50; ++k) {
      const double x = u(random), y = u(random);
      const Vec3 n = Vec3(-kx * x, -ky * y, 1).normalized();
      const Vec3 c = Vec3(x, y, f(x, y)) + radius * n;
      EXPECT_NEAR(ball_centre_height(s, radius, c.x(), c.y()), c.z(), kCentreToleranceMm);
    }
  }
}

TEST(BallCentreHeight, InAValleyTheBallRestsOnBothFlanksAndOnARidgeRollsOver) {
  const double m = 0.3, radius = 2;
  const double flank = radius * std::sqrt(1 + m * m);
  const auto valley =
      spline_of(box(-6, -5, 6, 5), 240, 200, [&](double x, double y) { return 10 + m * std::abs(y - 0.2 * x); });
  const double across = std::sqrt(1 + 0.04);  // the slope across the crease is m * across
  for (const double x : {-2.0, 0.0, 1.7}) {
    EXPECT_NEAR(ball_centre_height(valley, radius, x, 0.2 * x), 10 + radius * std::sqrt(1 + m * m * across * across),
                kCentreToleranceMm);
  }
  const auto ridge = spline_of(box(-6, -5, 6, 5), 240, 200, [&](double, double y) { return 10 - m * std::abs(y); });
  EXPECT_NEAR(ball_centre_height(ridge, radius, 0.4, 2), 10 - m * 2 + flank, kCentreToleranceMm);
  // On the top: the crease is rounded over two spans of 0.05 mm, by at most m * span / 2.
  EXPECT_NEAR(ball_centre_height(ridge, radius, 0.4, 0), 10 + radius, m * 0.05 / 2);
}

TEST(BallContact, IsTheHighestOfADenseSearchOnRoughSurfaces) {
  // Waves that are sharper than the ball, so that it often rests on several places at once.
  std::mt19937 random(17);
  std::uniform_real_distribution<double> u(-1, 1);
  for (int trial = 0; trial < 6; ++trial) {
    Grid<double> c(33, 27);
    for (double& value : c.values) value = 10 + 0.12 * u(random);
    const SplineSurface s(box(-4, -3, 5, 4), 30, 24, c);
    const double radius = 0.8 + 0.5 * trial;
    const detail::BallContact ball(s, radius, 4);
    for (int k = 0; k < 12; ++k) {
      const double x = 0.5 + 4.4 * u(random), y = 0.5 + 3.4 * u(random);
      double dense = 0;
      constexpr double kStep = 0.01;
      const int n = static_cast<int>(radius / kStep);
      for (int j = -n; j <= n; ++j) {
        for (int i = -n; i <= n; ++i) {
          const double inside = radius * radius - (i * i + j * j) * kStep * kStep;
          if (inside > 0) dense = std::max(dense, s.height(x + i * kStep, y + j * kStep) + std::sqrt(inside));
        }
      }
      const detail::Contact contact = ball.at(x, y);
      EXPECT_GE(contact.z, dense - 1e-9);
      EXPECT_LE(contact.z, dense + 4 * kStep * kStep);
      EXPECT_NEAR(contact.z, ball_centre_height(s, radius, x, y), 1e-8);
      const Vec2 d = contact.point - Vec2(x, y);
      EXPECT_NEAR(s.height(contact.point.x(), contact.point.y()) + std::sqrt(radius * radius - d.squaredNorm()),
                  contact.z, 1e-8);
    }
  }
}

TEST(BallContact, TellsHillsOnACreaseApartThatAreCloserThanASpan) {
  // Ridges and valleys at a slant to the grid, a little rough: hills along them lie half a span apart.
  const double radius = 2;
  for (const unsigned seed : {20U, 28U, 36U}) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> u(-1, 1);
    const double along_x = u(random), along_y = u(random), offset = u(random);
    const double one = 0.2 + 0.15 * u(random), other = 0.2 + 0.15 * u(random);
    Grid<double> c(41, 35);
    for (int j = 0; j < c.height; ++j) {
      for (int i = 0; i < c.width; ++i) {
        const double x = -6 + (i - 1) * 12.0 / 38, y = -5 + (j - 1) * 10.0 / 32;
        c.at(i, j) = 12 - one * std::abs(y - along_x * x) - other * std::abs(x - along_y * y - offset) + 0.04 * u(random);
      }
    }
    const SplineSurface s(box(-6, -5, 6, 5), 38, 32, c);
    const detail::BallContact ball(s, radius, 4);
    std::uniform_real_distribution<double> place(-4, 4);
    for (int k = 0; k < 400; ++k) {
      const double x = place(random), y = place(random);
      double dense = 0;
      constexpr double kStep = 0.03, kReach = 0.9;
      for (double v = -kReach; v <= kReach; v += kStep) {
        for (double w = -kReach; w <= kReach; w += kStep)
          dense = std::max(dense, s.height(x + v, y + w) + std::sqrt(radius * radius - v * v - w * w));
      }
      EXPECT_GE(ball.at(x, y).z, dense - kCentreToleranceMm) << "seed " << seed << " at " << x << " " << y;
    }
  }
}

// ---- passes -------------------------------------------------------------------------------------------------------

TEST(Finishing, StepoverOnAPlaneIsTheClosedForm) {
  const double a = 0.2, b = 0.3;
  const auto s = spline_of(Box2::centred({14, 11}), 45, 35, [&](double x, double y) { return 12 + a * x + b * y; });
  FinishOptions options;
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
  // s = 2 sqrt(h (2 R - h)) between lines in the plane; in y it is shorter by the slope across.
  const double in_plane = 2 * std::sqrt(1.3e-3 * (4 - 1.3e-3));
  const double in_y = in_plane * std::sqrt(1 + a * a) / std::sqrt(1 + a * a + b * b);
  EXPECT_NEAR(path.stepover_mm, in_y, 0.02 * in_y);
  EXPECT_LE(path.stepover_mm, in_y);
  EXPECT_NEAR(path.predicted_cusp_um, 1.3, 0.03);
  // What the moves themselves leave.
  const SweptBall swept(path);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  double most = 0;
  for (int k = 0; k < 20000; ++k) {
    const Vec2 p(14 * u(random), 11 * u(random));
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    EXPECT_GE(left, -kGougeToleranceMm);
    most = std::max(most, left);
  }
  EXPECT_NEAR(most * 1e3, path.predicted_cusp_um, 0.026);
}

TEST(Finishing, OnACylinderAlongThePassesTheStepoverFollowsTheCurvature) {
  for (const double k : {-0.02, 0.05}) {  // convex, concave across the passes
    const auto s = spline_of(Box2::centred({9, 8}), 30, 26, [&](double, double y) { return 12 + k * y * y / 2; });
    const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), {});
    // At the bottom (or top): between contacts s^2 = 8 h / (1/R - k), between centres shorter by 1 - k R.
    const double s0 = std::sqrt(8 * 1.3e-3 / (0.5 - k)) * (1 - 2 * k);
    // Steps in y shrink with the slope at the border, so the widest is at y = 0.
    EXPECT_NEAR(path.stepover_mm, s0, 0.02 * s0);
  }
}

/// y of the passes that run from side to side.
std::vector<double> full_passes(const ToolPath& path, double width_mm) {
  std::vector<double> ys;
  double from_x = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const Move& m = path.moves[k];
    if (m.kind == MoveKind::kLink) from_x = m.pose.tip_mm.x();
    const bool last = k + 1 == path.moves.size() || path.moves[k + 1].kind != MoveKind::kCut;
    if (m.kind == MoveKind::kCut && last && m.pose.tip_mm.x() - from_x > width_mm)
      ys.push_back(m.pose.tip_mm.y() + path.cutter.radius_mm() * m.pose.axis.y());
  }
  return ys;
}

TEST(Finishing, SpacingChangesTooSlowlyToBeSeenInTheLight) {
  // What is left after a polish stands higher by the mean of the cusps, h / 3, where h goes with the spacing's square.
  // Light over a throw f shows the change of slope: I - 1 = (n - 1) f d2/dy2 (h / 3). With second differences of the
  // spacing below 0.2 % of itself that is below 0.49 * 300 * (2 / 3 * 1.3e-3 * 0.002 / 0.14^2) = 1.3 %.
  const Vec2 size(9, 17);
  const auto valley = [](double x, double y) {  // of radius 5 at its bottom, between planes
    const double v = y - 1.3 - 0.05 * x;
    return 12 - 0.072 * std::exp(-v * v / 0.72);
  };
  const auto narrow = spline_of(Box2::centred(size), 36, 68, valley);
  double narrowest = 1;
  for (const auto& s : {narrow, hilly(23, size), hilly(24, size)}) {
    const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), {});
    const std::vector<double> ys = full_passes(path, size.x());
    ASSERT_GT(ys.size(), size.y() / path.stepover_mm);
    for (std::size_t k = 2; k < ys.size(); ++k) {
      const double below = ys[k - 1] - ys[k - 2];
      const double above = ys[k] - ys[k - 1];
      narrowest = std::min(narrowest, above / path.stepover_mm);
      EXPECT_LT(std::abs(above - below), 0.015 * below) << "at y " << ys[k];
      if (k > 2) {
        const double before = ys[k - 2] - ys[k - 3];
        EXPECT_LT(std::abs(above - 2 * below + before), 0.002 * below) << "at y " << ys[k];
      }
    }
    EXPECT_LE(path.predicted_cusp_um, 1.3);
    // No pieces between: three links lead from pass to pass.
    const auto links =
        std::count_if(path.moves.begin(), path.moves.end(), [](const Move& m) { return m.kind == MoveKind::kLink; });
    EXPECT_EQ(links, 3 * static_cast<long>(ys.size() - 1) + 2);
  }
  EXPECT_LT(narrowest, 0.9) << "nothing to be slow about";
}

class FinishingEverywhere : public ::testing::TestWithParam<int> {};

TEST_P(FinishingEverywhere, NoGougeAndNoCuspAboveTheLimit) {
  const Vec2 size(9, 7.5);
  const auto s = hilly(GetParam(), size);
  FinishOptions options;
  if (GetParam() % 3 == 1) options.axis = AxisPolicy::kVertical;
  if (GetParam() % 3 == 2) options.axis = AxisPolicy::kLeadTilt;
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
  const SweptBall swept(path);
  std::mt19937 random(GetParam());
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  double most = 0, least = 0;
  for (int k = 0; k < 25000; ++k) {
    Vec2 p(size.x() * u(random), size.y() * u(random));
    if (k % 5 == 0) p.x() = (k % 2 ? 0.5 : -0.5) * size.x();  // the border itself
    if (k % 5 == 1) p.y() = (k % 2 ? 0.5 : -0.5) * size.y();
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    most = std::max(most, left);
    least = std::min(least, left);
  }
  EXPECT_LE(most, 1.3e-3 + 2e-5);
  EXPECT_GE(least, -kGougeToleranceMm);
  EXPECT_NEAR(path.predicted_cusp_um * 1e-3, most, 4e-5);
  EXPECT_EQ(path.above_limit_mm2, 0);
  // No waste: no more path than the flat formula at the steepest place and the tightest curvature asks for.
  const double passes = static_cast<double>(std::count_if(path.moves.begin(), path.moves.end(),
                                                          [](const Move& m) { return m.kind == MoveKind::kLink; })) /
                        3;
  EXPECT_LT(passes, 1.5 * size.y() / 0.144);
}

INSTANTIATE_TEST_SUITE_P(Seeds, FinishingEverywhere, ::testing::Range(20, 26));

TEST(Finishing, InACreaseTheReachableFlanksAreWithinTheLimitToTheirBorder) {
  // A crease oblique to the passes; the flanks are reachable to R sin(angle) from it, the fillet between is not.
  const double m = 0.25, turn = 25 * kPi / 180, off = 0.513;
  const double c = std::cos(turn), sn = std::sin(turn);
  const Vec2 size(9, 7);
  const auto from_crease = [&](double x, double y) { return c * y - sn * x - off; };
  const auto s =
      spline_of(Box2::centred(size), 90, 70, [&](double x, double y) { return 12 + m * std::abs(from_crease(x, y)); });
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), {});
  const SweptBall swept(path);
  const double border = 2 * std::sin(std::atan(m));
  std::mt19937 random(2);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  double flank_most = 0, border_most = 0, least = 0, fillet_most = 0;
  for (int k = 0; k < 40000; ++k) {
    const Vec2 p(size.x() * u(random), size.y() * u(random));
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    least = std::min(least, left);
    const double d = std::abs(from_crease(p.x(), p.y()));
    if (d > border)
      flank_most = std::max(flank_most, left);
    else if (d > border - 0.02)
      border_most = std::max(border_most, left);  // closing within 0.1 um of the surface
    else
      fillet_most = std::max(fillet_most, left);
  }
  EXPECT_GE(least, -kGougeToleranceMm);
  EXPECT_LE(flank_most, 1.4e-3);
  EXPECT_LE(border_most, 1.7e-3);
  // In the crease the closing of the sharp valley stays: R (1 / cos - 1), and the crease is rounded a little.
  EXPECT_NEAR(fillet_most, 2 * (std::sqrt(1 + m * m) - 1), 0.03);
  EXPECT_EQ(path.above_limit_mm2, 0);
}

class FinishingWithin : public ::testing::TestWithParam<Outline::Shape> {};

TEST_P(FinishingWithin, AnOutlineCoversItAndLandsBesideIt) {
  Outline outline{GetParam(), {13, 13}, {}};
  if (outline.shape == Outline::Shape::kRectangle) outline.size_mm = {12, 9};
  if (outline.shape == Outline::Shape::kLoop) {  // with a hollow side
    for (int k = 0; k < 90; ++k) {
      const double a = 2 * kPi * k / 90, r = 5 + std::sin(2 * a) + 0.8 * std::sin(3 * a);
      outline.loop_mm.emplace_back(r * std::cos(a), r * std::sin(a));
    }
  }
  const auto s = hilly(52, {24, 22});
  const Blank blank{{26, 25}, s.highest() + 0.4};
  FinishOptions options;
  options.outline = outline;
  const ToolPath path = plan_finishing(s, blank, finishing_ball(), options);
  const SweptBall swept(path);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> u(-7, 7);
  double most = 0, least = 0;
  const std::vector<Vec2> border = outline_places(outline, 0.02);
  for (int k = 0; k < 30000; ++k) {
    const Vec2 p = k % 4 == 0 ? border[static_cast<std::size_t>(k / 4) % border.size()] : Vec2(u(random), u(random));
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    least = std::min(least, left);
    if (k % 4 == 0 || outline.contains(p)) most = std::max(most, left);
  }
  EXPECT_LE(most, 1.3e-3 + 2e-5);
  EXPECT_GE(least, -kGougeToleranceMm);
  // Where passes begin and end the ball stands clear; it comes down to the surface only where it touches beside the lens.
  int ends = 0;
  for (std::size_t k = 1; k + 1 < path.moves.size(); ++k) {
    const bool begins = path.moves[k].kind == MoveKind::kLink && path.moves[k + 1].kind != MoveKind::kLink;
    const bool over = path.moves[k].kind == MoveKind::kCut && path.moves[k + 1].kind == MoveKind::kLink;
    if (!begins && !over) continue;
    const Vec3 c = path.moves[k].pose.tip_mm + 2 * path.moves[k].pose.axis;
    EXPECT_GT(c.z() - ball_centre_height(s, 2, c.x(), c.y()), 0.4);
    ++ends;
  }
  EXPECT_GT(ends, 60);
  for (const Move& m : path.moves) {
    if (m.kind != MoveKind::kCut && m.kind != MoveKind::kPlunge) continue;
    const Vec3 c = m.pose.tip_mm + 2 * m.pose.axis;
    const detail::Contact contact = detail::ball_contact(s, 2, c.x(), c.y());
    EXPECT_FALSE(c.z() - contact.z > 1e-4 && outline.contains(contact.point)) << "lifted over the lens at " << contact.point.transpose();
  }
}

INSTANTIATE_TEST_SUITE_P(Shapes, FinishingWithin,
                         ::testing::Values(Outline::Shape::kRectangle, Outline::Shape::kDisk, Outline::Shape::kLoop));

TEST(SemiFinishing, LeavesItsAllowanceAlongTheNormal) {
  const Vec2 size(16, 12);
  const auto s = hilly(4, size);
  FinishOptions options;
  options.pass = "semi_finish";
  options.allowance_mm = 0.05;
  options.cusp_um = 10;
  const ToolPath path = plan_finishing(s, blank_for(s), cutter("semi_finish_4mm_ball"), options);
  const SweptBall swept(path);
  std::mt19937 random(8);
  std::uniform_real_distribution<double> u(-0.5, 0.5);
  double most = 0, least = 1;
  for (int k = 0; k < 20000; ++k) {
    const Vec2 p(size.x() * u(random), size.y() * u(random));
    const double left = swept.left_mm({p.x(), p.y(), s.height(p.x(), p.y())});
    most = std::max(most, left);
    least = std::min(least, left);
  }
  EXPECT_NEAR(least, 0.05, 2e-4);
  EXPECT_LE(most, 0.0602);
  EXPECT_GE(most, 0.059);
}

// ---- moves --------------------------------------------------------------------------------------------------------

TEST(Finishing, MovesAreSafeOneWayAndAtSaneFeeds) {
  const Vec2 size(18, 12);
  const auto s = hilly(31, size);
  const Blank blank{{22, 15}, s.highest() + 1};
  const Cutter ball = finishing_ball();
  const ToolPath path = plan_finishing(s, blank, ball, {});
  ASSERT_GT(path.moves.size(), 1000u);
  EXPECT_EQ(path.moves.front().kind, MoveKind::kRapid);
  EXPECT_EQ(path.moves.back().kind, MoveKind::kRapid);
  EXPECT_DOUBLE_EQ(path.clearance_z_mm, blank.height_mm + 5);
  double last_y = -1e9;
  std::size_t cuts = 0;
  for (std::size_t k = 0; k < path.moves.size(); ++k) {
    const Move& m = path.moves[k];
    EXPECT_NEAR(m.pose.axis.norm(), 1, 1e-12);
    EXPECT_EQ(m.pose.axis, path.moves[0].pose.axis) << "fixed tilt";
    if (m.kind == MoveKind::kRapid) {
      EXPECT_GE(m.pose.tip_mm.z(), path.clearance_z_mm);
      continue;
    }
    const Move& from = path.moves[k - 1];
    EXPECT_GT(m.feed_mm_per_s, 0);
    if (m.kind == MoveKind::kCut) {
      ++cuts;
      EXPECT_GT(m.pose.tip_mm.x(), from.pose.tip_mm.x()) << "one way";
      EXPECT_GE(m.pose.tip_mm.y(), last_y - 1e-9) << "y grows";
      EXPECT_LE((m.pose.tip_mm - from.pose.tip_mm).norm(), 0.2 * std::sqrt(1 + 0.5 * 0.5));
      EXPECT_LE(m.feed_mm_per_s, ball.feed_mm_per_s() + 1e-12);
      EXPECT_LE(m.feed_mm_per_s / (ball.spindle_rpm / 60), path.stepover_mm / 3 + 1e-12);
      last_y = m.pose.tip_mm.y();
    }
    if (m.kind == MoveKind::kLink) {
      // The ball in air: beside the block, or above the surface by more than semi-finishing leaves.
      for (double t = 0; t <= 1; t += 0.05) {
        const Vec3 c = from.pose.tip_mm + t * (m.pose.tip_mm - from.pose.tip_mm) + ball.radius_mm() * m.pose.axis;
        const bool beside = std::abs(c.x()) > 11 + ball.radius_mm() || std::abs(c.y()) > 7.5 + ball.radius_mm();
        if (!beside) {
          EXPECT_GT(c.z() - ball_centre_height(s, ball.radius_mm(), c.x(), c.y()), 0.4);
        }
      }
    }
  }
  EXPECT_GT(cuts, path.moves.size() / 2);
  // Every pass starts and ends with the whole ball beside the block.
  EXPECT_LT(path.moves[1].pose.tip_mm.x(), -11 - ball.radius_mm());
}

TEST(Finishing, SamePassesWhateverTheThreadCount) {
  const auto s = hilly(40, {14, 14});
  const auto bytes = [&](int threads) {
    set_thread_count(threads);
    const auto file = std::filesystem::path(::testing::TempDir()) /
                      ("threads_" + std::to_string(threads) + "_" + std::to_string(::getpid()) + ".bin");
    write_toolpaths(file, {plan_finishing(s, blank_for(s), finishing_ball(), {})});
    set_thread_count(0);
    return read_whole(file);
  };
  const std::string one = bytes(1);
  EXPECT_EQ(one, bytes(3));
  EXPECT_EQ(one, bytes(3));
}

TEST(Finishing, StopsWhenTheUserAsks) {
  const auto s = hilly(40, {12, 12});
  Monitor monitor;
  monitor.should_stop = [] { return true; };
  EXPECT_THROW(plan_finishing(s, blank_for(s), finishing_ball(), {}, monitor), Stopped);
}

// ---- entries and exits --------------------------------------------------------------------------------------------

struct EntryCase {
  const char* name;
  Strategy strategy;
  double angle_deg;
  double disk_mm;  ///< 0: the whole rectangle, entered from beside the block
};

class Entries : public ::testing::TestWithParam<EntryCase> {};

TEST_P(Entries, LeaveThePassWithItsOwnCurvatureAndNeverTouchTheLens) {
  const EntryCase& c = GetParam();
  const Vec2 size(9, 7);
  const auto s = hilly(61, size);
  FinishOptions options;
  options.cusp_um = 8;
  options.strategy = c.strategy;
  options.angle_rad = c.angle_deg * kPi / 180;
  const double radius = 2;
  if (c.disk_mm > 0) options.outline = Outline{Outline::Shape::kDisk, {c.disk_mm, c.disk_mm}, {}};
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
  std::vector<Vec3> lens;
  for (double y = -size.y() / 2; y <= size.y() / 2 + 1e-9; y += 0.1) {
    for (double x = -size.x() / 2; x <= size.x() / 2 + 1e-9; x += 0.1) {
      if (!options.outline || options.outline->contains({x, y})) lens.emplace_back(x, y, s.height(x, y));
    }
  }
  const auto centre = [&](std::size_t k) { return Vec3(path.moves[k].pose.tip_mm + radius * path.moves[k].pose.axis); };
  const auto feeds = [&](std::size_t k) { return path.moves[k].kind == MoveKind::kCut || path.moves[k].kind == MoveKind::kPlunge; };
  int arcs = 0;
  // From an end of a way inwards: first the arc's height over the ball at rest, then where it meets the pass.
  const auto judge = [&](std::size_t end, int inwards) {
    std::vector<std::pair<Vec3, double>> arc;
    std::size_t k = end;
    for (;; k += inwards) {
      const Vec3 p = centre(k);
      const double lift = p.z() - ball_centre_height(s, radius, p.x(), p.y());
      if (lift < 2e-6) break;
      arc.emplace_back(p, lift);
    }
    const Vec3 meets = centre(k);
    ASSERT_GE(arc.size(), 4U);
    EXPECT_GT(arc.front().second, 0.3) << "comes down clear of the work";
    for (const auto& [p, lift] : arc) {
      const double away = (p - meets).head<2>().norm();
      EXPECT_LE(lift, 0.5 * away * away * away + 1e-5) << "neither height nor slope nor curvature jumps, " << away << " mm away";
      double gap = 1;
      for (const Vec3& q : lens) gap = std::min(gap, (p - q).norm() - radius);
      EXPECT_GT(gap, 0.1) << "an arc touches the lens at " << p.transpose();
    }
    ++arcs;
  };
  for (std::size_t k = 1; k + 1 < path.moves.size(); ++k) {
    if (!feeds(k) && feeds(k + 1)) judge(k, 1);
    if (feeds(k) && !feeds(k + 1) && c.strategy != Strategy::kSpiral) judge(k, -1);  // which ends in the middle
  }
  EXPECT_GT(arcs, c.strategy == Strategy::kSpiral ? 0 : 30);
}

INSTANTIATE_TEST_SUITE_P(Strategies, Entries,
                         ::testing::Values(EntryCase{"one_way", Strategy::kOneWay, 0, 0}, EntryCase{"zig_zag_25", Strategy::kZigZag, 25, 0},
                                           EntryCase{"disk", Strategy::kOneWay, 0, 6}, EntryCase{"disk_zig_zag", Strategy::kZigZag, 70, 6},
                                           EntryCase{"spiral", Strategy::kSpiral, 0, 0}),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(Landing, OfInfillTakesOffNothing) {
  // A valley too short to reach the border asks for pieces between passes; the next pass is not cut yet where they land.
  const Vec2 size(28, 4);
  const auto s = spline_of(Box2::centred(size), 280, 40, [](double x, double y) {
    return 12 + 0.05 * y + 0.25 * std::hypot(y - 0.15 * x, 0.05) * std::exp(-std::pow((x + 1) / 1.2, 4));
  });
  for (const Strategy strategy : {Strategy::kOneWay, Strategy::kZigZag, Strategy::kSpiral}) {
    FinishOptions options;
    options.strategy = strategy;
    const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
    const test::LandingCut cut = test::landing_cut(s, path, 0.05, [&](const Vec2& p) { return s.extent().contains(p); });
    EXPECT_GT(cut.arcs, strategy == Strategy::kSpiral ? 0 : 2) << "nothing to look at";  // a spiral may do without pieces
    EXPECT_LE(cut.most_mm, test::kLandingCutMm) << "at " << cut.where.transpose();
  }
}

TEST(Landing, ASpiralEndsInItsOwnGroove) {
  for (const Vec2& size : {Vec2(6, 4.5), Vec2(5, 5), Vec2(4.5, 6)}) {
    const auto s = hilly(63, size);
    FinishOptions options;
    options.strategy = Strategy::kSpiral;
    const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
    const test::LandingCut cut = test::landing_cut(s, path, 0.05, [&](const Vec2& p) { return s.extent().contains(p); });
    EXPECT_EQ(cut.arcs, 1);
    EXPECT_LE(cut.most_mm, test::kLandingCutMm) << "at " << cut.where.transpose();
  }
}

TEST(Climb, OneWayPassesMeetTheEdgeThatComesTowardsThem) {
  const auto s = hilly(62, {9, 7});
  struct Way {
    Strategy strategy;
    AxisPolicy axis;
  };
  for (const auto& [strategy, axis] : {Way{Strategy::kOneWay, AxisPolicy::kFixed}, Way{Strategy::kZigZag, AxisPolicy::kFixed},
                                       Way{Strategy::kOneWay, AxisPolicy::kLeadTilt}}) {
    FinishOptions options;
    options.cusp_um = 8;
    options.strategy = strategy;
    options.axis = axis;
    options.angle_rad = 0.4;
    const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
    double climb = 0, all = 0;
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      if (path.moves[k].kind != MoveKind::kCut) continue;
      const ToolPose& pose = path.moves[k].pose;
      const Vec3 c = pose.tip_mm + 2 * pose.axis;
      const Vec2 touch = detail::ball_contact(s, 2, c.x(), c.y()).point;
      if (!s.extent().contains(touch)) continue;
      // Where the edge at the contact is a moment later: M3 turns clockwise as seen along the tool from the spindle.
      const Vec3 at = Vec3(touch.x(), touch.y(), s.height(touch.x(), touch.y())) - c;
      const Vec3 later = Eigen::AngleAxisd(-1e-3, pose.axis) * at;
      const Vec3 way = pose.tip_mm - path.moves[k - 1].pose.tip_mm;
      all += way.norm();
      if ((later - at).dot(way) < 0) climb += way.norm();
    }
    const double share = contact_summary(s, path, options).climb_share;
    EXPECT_NEAR(share, climb / all, 0.05);
    EXPECT_NEAR(climb / all, strategy == Strategy::kOneWay ? 1 : 0.5, strategy == Strategy::kOneWay ? 0 : 0.05);
  }
}

// ---- axis ---------------------------------------------------------------------------------------------------------

double contact_angle(const SplineSurface& s, const Vec3& axis, double x, double y) {
  return std::acos(axis.dot(s.normal(x, y))) * 180 / kPi;
}

TEST(FixedTilt, KeepsTheContactWindowAndGivesWayToSlopes) {
  // A plane that leans 25 degrees: tilted by 30 towards -Y as asked for, the ball would touch with its centre (5
  // degrees).
  const double slope = std::tan(25 * kPi / 180);
  const auto s = spline_of(Box2::centred({8, 7}), 24, 22, [&](double, double y) { return 14 + slope * y; });
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), {});
  const double gamma = contact_angle(s, path.moves[0].pose.axis, 0, 0);
  EXPECT_GE(gamma, 10);
  EXPECT_LE(gamma, 55);
  // On a gentle one nothing gives way: 30 degrees towards -Y, climb milling for passes along +X.
  const auto gentle = spline_of(Box2::centred({8, 7}), 24, 22, [&](double x, double) { return 14 + 0.1 * x; });
  const Vec3 axis = plan_finishing(gentle, blank_for(gentle), finishing_ball(), {}).moves[0].pose.axis;
  EXPECT_NEAR(axis.y(), -0.5, 1e-12);
  EXPECT_NEAR(axis.x(), 0, 1e-12);
}

TEST(FixedTilt, AFocusingLensPasses) {
  // 100 mm lens to a point at 300 mm: hyperboloid, 16 mm of relief, 23 degrees at the corners; here every 4th mm of it.
  const double n = 1.49, f = 300;
  const auto s = spline_of(Box2::centred({100, 100}), 100, 100, [&](double x, double y) {
    // n z + sqrt(r^2 + (f - z)^2) = const, by fixed-point iteration.
    const double r2 = x * x + y * y, r2c = 5000, zc = 0;
    const double constant = n * zc + std::sqrt(r2c + (f - zc) * (f - zc));
    double z = 0;
    for (int k = 0; k < 200; ++k) z += (constant - n * z - std::sqrt(r2 + (f - z) * (f - z))) / (n - 0.9);
    return 10 + z;
  });
  FinishOptions options;
  options.pass = "semi_finish";
  options.cusp_um = 60;  // few passes: this is about the axis
  options.longest_segment_mm = 2;
  options.chord_tolerance_mm = 1e-3;
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
  for (const double x : {-50.0, 0.0, 50.0}) {
    for (const double y : {-50.0, 0.0, 50.0}) {
      const double gamma = contact_angle(s, path.moves[0].pose.axis, x, y);
      EXPECT_GE(gamma, 9.9);
      EXPECT_LE(gamma, 55.1);
    }
  }
}

TEST(FixedTilt, TooSteepASurfaceIsAnErrorThatNamesTheSlopes) {
  const auto s =
      spline_of(Box2::centred({8, 8}), 26, 26, [&](double x, double y) { return 20 + 0.05 * (x * x + y * y) * 2.5; });
  try {
    plan_finishing(s, blank_for(s), finishing_ball(), {});
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("degrees steep"));
    EXPECT_THAT(e.what(), HasSubstr("lead_tilt"));
  }
}

TEST(Clearance, AHolderThatWouldTouchIsAnErrorAndALongerCutterIsNot) {
  // A 20 mm hill beside a plain: with 5 mm out of the holder it touches, with the fixture's 32 mm it does not.
  const auto s = spline_of(Box2::centred({60, 44}), 60, 44, [&](double x, double y) {
    return 10 + 10 * (1 + std::sin(std::clamp(x / 21, -1.0, 1.0) * kPi / 2)) + 0.001 * y * y;
  });
  FinishOptions options;
  options.cusp_um = 60;
  options.longest_segment_mm = 2;
  options.chord_tolerance_mm = 1e-3;
  options.axis = AxisPolicy::kVertical;
  EXPECT_NO_THROW(plan_finishing(s, blank_for(s), finishing_ball(), options));
  Cutter stubby = finishing_ball();
  stubby.holder = {{5, 50, 8, 25}};
  try {
    plan_finishing(s, blank_for(s), stubby, options);
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("holder"));
    EXPECT_THAT(e.what(), HasSubstr("farther out"));
  }
  Cutter thick = finishing_ball();
  thick.shank_diameter_mm = 30;
  EXPECT_THROW(plan_finishing(s, blank_for(s), thick, options), InputError);
  EXPECT_THROW(plan_finishing(s, blank_for(s), cutter("rough_10mm"), options), InputError);
  EXPECT_THROW(plan_finishing(s, Blank{{50, 44}, 40}, finishing_ball(), options), InputError);
}

TEST(Clearance, TheAxisLeansAnotherWayWhereTheHolderWouldTouch) {
  // A wall's foot to the right of the passes, where the axis leans if nobody minds.
  const auto s = spline_of(Box2::centred({30, 30}), 30, 30, [&](double, double y) { return 10 + 3 * (1 - std::tanh((y + 6) / 4)); });
  FinishOptions options;
  options.cusp_um = 60;
  options.longest_segment_mm = 2;
  options.chord_tolerance_mm = 1e-3;
  Cutter wide = finishing_ball();
  wide.holder = {{9, 40, 9, 12}};
  for (const AxisPolicy axis : {AxisPolicy::kFixed, AxisPolicy::kLeadTilt}) {
    options.axis = axis;
    const auto lean = [&](const Cutter& cutter) {
      const ToolPath path = plan_finishing(s, blank_for(s), cutter, options);
      return path.moves[path.moves.size() / 2].pose.axis;
    };
    EXPECT_GT(lean(wide).y(), lean(finishing_ball()).y() + 0.1) << "away from the wall";
  }
}

TEST(Contact, AngleAndSpeedOnAPlaneAreTheClosedForms) {
  const auto s = spline_of(Box2::centred({8, 7}), 24, 22, [](double x, double) { return 14 + 0.1 * x; });
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), {});
  const ContactSummary contact = contact_summary(s, path, {});
  const double angle = std::acos(std::cos(30 * kPi / 180) / std::sqrt(1.01));  // the axis leans to -Y, the plane along X
  EXPECT_NEAR(contact.least_angle_rad, angle, 1e-6);
  EXPECT_NEAR(contact.most_angle_rad, angle, 1e-6);
  EXPECT_NEAR(contact.slowest_m_per_min, 2 * kPi * 2 * 36000 * std::sin(angle) / 1000, 0.01);
}

TEST(Blur, OfCuspsIsTheirRmsSlopeOverTheThrowAndFallsWithThePolish) {
  // s / (R sqrt(12)) for the parabola between two contacts.
  const double s = 2 * std::sqrt(1.5e-3 * (4 - 1.5e-3));
  EXPECT_NEAR(blur_on_screen_mm(2, 1.5, 300, 1.49, 0), 0.49 * 300 * s / (2 * std::sqrt(12.0)), 0.01);
  EXPECT_LT(blur_on_screen_mm(2, 1.5, 300, 1.49, 0.1), 0.01);
  double before = 1e9;
  for (const double sigma : {0.0, 0.02, 0.05, 0.1}) {
    EXPECT_LT(blur_on_screen_mm(2, 1.5, 300, 1.49, sigma), before);
    before = blur_on_screen_mm(2, 1.5, 300, 1.49, sigma);
    const double cusp = cusp_for_blur_um(2, before, 300, 1.49, sigma);
    EXPECT_NEAR(cusp, 1.5, 1e-6);
  }
  EXPECT_THROW(cusp_for_blur_um(2, 1e-4, 300, 1.49, 0), InputError);
}

TEST(Blur, ThePolishThatHidesCuspsLeavesTheRippleAsked) {
  // Heights of scallops, smoothed node by node; brightness on the wall goes as 1 + (n - 1) D h''.
  const double radius = 2, stepover = 0.15, distance = 80, index = 1.49;
  constexpr int kNodes = 256;
  const double pitch = stepover / kNodes;
  const auto scallop = [&](double y) { return std::pow(y - stepover * std::round(y / stepover), 2) / (2 * radius); };
  for (const double ripple : {0.2, 0.05}) {
    const double sigma = polish_that_hides_mm(radius, stepover, distance, index, ripple);
    const int reach = static_cast<int>(8 * sigma / pitch);
    std::vector<double> smooth(kNodes, 0.0);
    for (int i = 0; i < kNodes; ++i) {
      for (int k = -reach; k <= reach; ++k) {
        smooth[i] += scallop((i + k) * pitch) * std::exp(-0.5 * std::pow(k * pitch / sigma, 2)) * pitch / (sigma * std::sqrt(2 * kPi));
      }
    }
    double most = 0;
    for (int i = 0; i < kNodes; ++i) {
      const double second = smooth[(i + 1) % kNodes] - 2 * smooth[i] + smooth[(i + kNodes - 1) % kNodes];
      most = std::max(most, std::abs((index - 1) * distance * second / (pitch * pitch)));
    }
    EXPECT_NEAR(most, ripple, 0.02 * ripple);
  }
  EXPECT_EQ(polish_that_hides_mm(2, 0.15, 0.1, 1.49, 0.05), 0) << "a wall so near that raw cusps do not show";
}

TEST(LeadTilt, TheAxisIsSmoothKeepsTheWindowAndNeverStandsUpright) {
  const Vec2 size(16, 13);
  const auto s = hilly(77, size);
  FinishOptions options;
  options.axis = AxisPolicy::kLeadTilt;
  const ToolPath path = plan_finishing(s, blank_for(s), finishing_ball(), options);
  double turned = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const Move& m = path.moves[k];
    const Move& from = path.moves[k - 1];
    const double turn = std::acos(std::min(1.0, m.pose.axis.dot(from.pose.axis))) * 180 / kPi;
    const double upright = std::acos(m.pose.axis.z()) * 180 / kPi;
    EXPECT_GE(upright, 4.9);
    if (m.kind == MoveKind::kCut || m.kind == MoveKind::kPlunge) {
      EXPECT_LE(turn, 0.5 + 1e-6);
      turned = std::max(turned, turn);
      const Vec3 c = m.pose.tip_mm + 2 * m.pose.axis;
      const double x = std::clamp(c.x(), -size.x() / 2, size.x() / 2);
      const double y = std::clamp(c.y(), -size.y() / 2, size.y() / 2);
      EXPECT_GE(contact_angle(s, m.pose.axis, x, y), 8);  // near the contact, not exactly at it
      EXPECT_LE(contact_angle(s, m.pose.axis, x, y), 57);
    } else if (turn > 1e-4) {
      EXPECT_EQ(m.kind, MoveKind::kLink);
      EXPECT_GE(std::min(m.pose.tip_mm.z(), from.pose.tip_mm.z()), path.clearance_z_mm - 1e-9)
          << "turns at clearance only";
    }
  }
  EXPECT_GT(turned, 0.01) << "five axes for real";
}

}  // namespace
}  // namespace lightmill

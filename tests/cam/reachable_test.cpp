#include "cam/reachable.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "design/core/parallel.h"

namespace lightmill {
namespace {

/// The spline whose coefficients are the heights at their places: exact for planes, within span^2 / 6 of the second
/// derivatives elsewhere.
template <typename F>
SplineSurface spline_of(const Box2& extent, double span_mm, F height) {
  const int nx = static_cast<int>(std::lround(extent.size().x() / span_mm));
  const int ny = static_cast<int>(std::lround(extent.size().y() / span_mm));
  const Vec2 span = extent.size().cwiseQuotient(Vec2(nx, ny));
  Grid<double> c(nx + 3, ny + 3);
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i)
      c.at(i, j) = height(extent.min.x() + (i - 1) * span.x(), extent.min.y() + (j - 1) * span.y());
  }
  return {extent, nx, ny, c};
}

Vec2 node(const ReachableSurface& r, int i, int j) {
  return r.extent.min + r.pitch_mm * Vec2(i, j);
}

constexpr double kPromiseUm = 0.2;

TEST(Reachable, APlaneIsReachedEverywhere) {
  const Box2 extent{{-2, 1}, {3, 4}};
  const SplineSurface surface = spline_of(extent, 0.5, [](double x, double y) { return 10 + 0.3 * x - 0.2 * y; });
  const ReachableSurface r = reachable_surface(surface, 2, 0.1);
  EXPECT_EQ(r.closing_mm.width, 51);
  EXPECT_EQ(r.closing_mm.height, 31);
  EXPECT_EQ(r.max_residue_um, 0);
  EXPECT_EQ(r.unreachable_area_mm2, 0);
  for (int j = 0; j < r.closing_mm.height; ++j) {
    for (int i = 0; i < r.closing_mm.width; ++i) {
      const Vec2 p = node(r, i, j);
      EXPECT_NEAR(r.closing_mm.at(i, j), surface.height(p.x(), p.y()), 2e-6);
    }
  }
}

TEST(Reachable, CapsAndWideBowlsAreReachedEverywhere) {
  const Box2 extent{{-1.1, -0.7}, {0.9, 0.8}};
  const auto cap = [](double rho) {
    return [rho](double x, double y) { return 10 + std::copysign(std::sqrt(rho * rho - x * x - y * y), rho) - rho; };
  };
  EXPECT_EQ(reachable_surface(spline_of(extent, 0.1, cap(3)), 2, 0.05).max_residue_um, 0);
  EXPECT_EQ(reachable_surface(spline_of(extent, 0.1, cap(1.6)), 2, 0.05).max_residue_um, 0);
  // Hollow, with a radius a little above and a little below the ball's.
  EXPECT_EQ(reachable_surface(spline_of(extent, 0.1, cap(-2.2)), 2, 0.05).max_residue_um, 0);
  EXPECT_GT(reachable_surface(spline_of(extent, 0.1, cap(-1.8)), 2, 0.05).max_residue_um, 1);
}

TEST(HollowCurvature, OfBowlsSaddlesAndHillsIsTheTightestHollowsOwn) {
  const auto quadric = [](double kx, double ky) { return SplineSurface::Sample{10, 0, 0, kx, 0, ky}; };
  EXPECT_DOUBLE_EQ(hollow_curvature(quadric(0.2, 0.1)), 0.2);
  EXPECT_DOUBLE_EQ(hollow_curvature(quadric(-0.3, 0.1)), 0.1);
  EXPECT_DOUBLE_EQ(hollow_curvature(quadric(-0.3, -0.1)), -0.1);
  // A sphere's, anywhere on it.
  const double x = 3, y = -2, rho = 9, w = std::sqrt(rho * rho - x * x - y * y);
  const SplineSurface::Sample s{0, x / w, y / w, 1 / w + x * x / (w * w * w), x * y / (w * w * w), 1 / w + y * y / (w * w * w)};
  EXPECT_NEAR(hollow_curvature(s), 1 / rho, 1e-7);
}

TEST(Reachable, ABallOnAHoleRestsOnItsRim) {
  // A bowl of radius 1 in a plane: the ball of radius 2 cannot enter, and what it leaves is the sphere through the rim.
  const Box2 extent{{-1.2, -1.2}, {1.2, 1.2}};
  constexpr double kRim = 0.5, kBall = 2;
  const double sunk = std::sqrt(1 - kRim * kRim);
  const auto hole = [&](double x, double y) {
    return 10 + std::min(0.0, sunk - std::sqrt(std::max(0.0, 1 - x * x - y * y)));
  };
  const SplineSurface surface = spline_of(extent, 0.01, hole);
  const ReachableSurface r = reachable_surface(surface, kBall, 0.06);
  double worst_um = 0;
  for (int j = 0; j < r.closing_mm.height; ++j) {
    for (int i = 0; i < r.closing_mm.width; ++i) {
      const double d = node(r, i, j).norm();
      if (d > 0.97 * kRim) continue;
      const double truth = 10 + std::sqrt(kBall * kBall - kRim * kRim) - std::sqrt(kBall * kBall - d * d);
      worst_um = std::max(worst_um, 1e3 * std::abs(r.closing_mm.at(i, j) - truth));
    }
  }
  // The spline rounds the rim by about jump * span / 3 = 2 um.
  EXPECT_LT(worst_um, 2.5);
  EXPECT_NEAR(r.unreachable_area_mm2, kPi * kRim * kRim, 0.03);
}

TEST(Reachable, AValleyKeepsAFillet) {
  // Straight across y: leftover R (1 / cos(a / 2) - 1), width 2 R tan(a / 2).
  for (const double radius : {2.0, 0.5}) {
    for (const double jump : {0.1, 0.3, 0.5}) {
      const Box2 extent{{-1.03, -0.15}, {0.97, 0.2}};
      const double t = std::tan(jump / 2);
      const SplineSurface surface = spline_of(extent, 0.01, [&](double x, double) { return 10 + t * std::abs(x); });
      const ReachableSurface r = reachable_surface(surface, radius, 0.01);
      const double half = radius * std::sin(jump / 2);  // of the touching lines, seen from above
      const Grid<float> normals = residue_normals_mrad(r);
      double worst_um = 0, most_um = 0, width = 0;
      for (int i = 0; i < r.closing_mm.width; ++i) {
        const double x = node(r, i, 15).x();
        const double truth = std::abs(x) < half ? 10 + radius / std::cos(jump / 2) - std::sqrt(radius * radius - x * x)
                                                : 10 + t * std::abs(x);
        if (std::abs(x) > 0.03 || half > 0.03) {
          worst_um = std::max(worst_um, 1e3 * std::abs(r.closing_mm.at(i, 15) - truth));
        }
        if (std::abs(x) < 0.005) most_um = 1e3 * (r.closing_mm.at(i, 15) - 10.0);
        if (r.residue_um.at(i, 15) > r.threshold_um) width += r.pitch_mm;
        // The fillet's normal turns evenly from flank to flank; differences span two pitches.
        if (std::abs(x) > 0.03 && std::abs(x) < half - 0.03) {
          EXPECT_NEAR(normals.at(i, 15), 1e3 * (jump / 2 - std::asin(std::abs(x) / radius)), 5) << "R " << radius << " a " << jump << " x " << x;
        } else if (std::abs(x) > half + 0.03) {
          EXPECT_EQ(normals.at(i, 15), 0);
        }
      }
      EXPECT_LT(worst_um, kPromiseUm) << "R " << radius << " a " << jump;
      EXPECT_NEAR(most_um, 1e3 * radius * (1 / std::cos(jump / 2) - 1), kPromiseUm + 0.03);
      // The residue's ends are flat: (x - half)^2 / 2 R is below 0.1 um for sqrt(2 R 1e-4) on either side.
      EXPECT_NEAR(width, 2 * half - 2 * std::sqrt(2 * radius * 1e-4), 0.03);
    }
  }
}

TEST(Reachable, AValleyAcrossTheGridOnASlope) {
  // Two planes that meet along a line that is neither level nor along an axis: the fillet is a cylinder.
  constexpr double kRadius = 2;
  const Vec2 g1(0.30, 0.12), g2(-0.05, 0.02);
  const Box2 extent{{-1.5, -1.1}, {1.3, 1.2}};
  const auto height = [&](double x, double y) { return 10 + std::max(g1.dot(Vec2(x, y)), g2.dot(Vec2(x, y))); };
  const SplineSurface surface = spline_of(extent, 0.01, height);
  const ReachableSurface r = reachable_surface(surface, kRadius, 0.035);
  const Vec3 n1 = Vec3(-g1.x(), -g1.y(), 1).normalized();
  const Vec3 n2 = Vec3(-g2.x(), -g2.y(), 1).normalized();
  const Vec3 axis = n1.cross(n2).normalized();
  // A point R above both planes: (0, 0, 10) + a n1 + b n2.
  const double k = n1.dot(n2);
  const Vec3 on_axis = Vec3(0, 0, 10) + kRadius / (1 + k) * (n1 + n2);
  double worst_um = 0;
  int in_fillet = 0;
  for (int j = 0; j < r.closing_mm.height; ++j) {
    for (int i = 0; i < r.closing_mm.width; ++i) {
      const Vec2 p = node(r, i, j);
      double truth = height(p.x(), p.y());
      // Lower intersection of the vertical through p with the cylinder.
      const Vec3 up = Vec3::UnitZ() - axis.z() * axis;
      Vec3 from = Vec3(p.x(), p.y(), 0) - on_axis;
      from -= axis.dot(from) * axis;
      const double a = up.squaredNorm(), b = up.dot(from), c = from.squaredNorm() - kRadius * kRadius;
      if (b * b - a * c > 0) {
        const double z = (-b - std::sqrt(b * b - a * c)) / a;
        const Vec3 out = (from + z * up) / kRadius;
        if (-out.dot(n1) >= k && -out.dot(n2) >= k) {
          truth = z;
          ++in_fillet;
        }
      }
      // Ten spans beside the border the linear continuation of the rounded crease differs from the planes'.
      if (p.x() < extent.min.x() + 0.6 || p.x() > extent.max.x() - 0.6) continue;
      if (p.y() < extent.min.y() + 0.6 || p.y() > extent.max.y() - 0.6) continue;
      worst_um = std::max(worst_um, 1e3 * std::abs(r.closing_mm.at(i, j) - truth));
    }
  }
  EXPECT_GT(in_fillet, 100);
  EXPECT_LT(worst_um, kPromiseUm);
}

/// Independent of everything under test: dense scans, then finer ones around the best.
double brute_closing(const SplineSurface& surface, double radius, const Vec2& p) {
  const auto rest = [&](const Vec2& c) {
    double best = -1e9;
    Vec2 at = c;
    double half = 0.8 * radius;
    for (double pitch = radius / 40; pitch > 1e-4; pitch /= 5) {
      const Vec2 middle = at;
      for (double v = -half; v <= half; v += pitch) {
        for (double u = -half; u <= half; u += pitch) {
          const Vec2 q = middle + Vec2(u, v);
          const double inside = radius * radius - (q - c).squaredNorm();
          if (inside < 0) continue;
          const double z = surface.height(q.x(), q.y()) + std::sqrt(inside);
          if (z > best) best = z, at = q;
        }
      }
      half = pitch;
    }
    return best;
  };
  double best = 1e9;
  Vec2 at = p;
  double half = 0.6 * radius;
  for (double pitch = radius / 20; pitch > 1e-4; pitch /= 4) {
    const Vec2 middle = at;
    for (double v = -half; v <= half; v += pitch) {
      for (double u = -half; u <= half; u += pitch) {
        const Vec2 c = middle + Vec2(u, v);
        const double inside = radius * radius - (p - c).squaredNorm();
        if (inside < 0) continue;
        const double z = rest(c) - std::sqrt(inside);
        if (z < best) best = z, at = c;
      }
    }
    half = 1.5 * pitch;
  }
  return best;
}

SplineSurface rough_surface(unsigned seed, double amplitude) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(0, 1);
  double k[4][4];
  for (auto& row : k) {
    row[0] = 2 + 3 * u(random);
    row[1] = 2 + 3 * u(random);
    row[2] = 6 * u(random);
    row[3] = amplitude * u(random);
  }
  return spline_of(Box2{{-1.4, -1.0}, {1.2, 1.3}}, 0.1, [&](double x, double y) {
    double h = 10;
    for (const auto& r : k) h += r[3] * std::sin(r[0] * x + r[1] * y * (r[2] > 3 ? 1 : -1) + r[2]);
    return h;
  });
}

TEST(Reachable, AgreesWithDenseSearchOnRoughSurfaces) {
  constexpr double kRadius = 2;
  for (const unsigned seed : {11U, 12U}) {
    const SplineSurface surface = rough_surface(seed, 0.06);
    const ReachableSurface r = reachable_surface(surface, kRadius, 0.1);
    ASSERT_GT(r.max_residue_um, 5) << "seed " << seed;
    // The nodes with the highest residues, and some without.
    int tried = 0;
    for (int j = 2; j < r.closing_mm.height && tried < 3; j += 5) {
      for (int i = 3; i < r.closing_mm.width && tried < 3; i += 7) {
        if (r.residue_um.at(i, j) < 0.2 * r.max_residue_um) continue;
        ++tried;
        const Vec2 p = node(r, i, j);
        EXPECT_NEAR(r.closing_mm.at(i, j), brute_closing(surface, kRadius, p), 1e-3 * kPromiseUm)
            << "seed " << seed << " at " << p.transpose();
      }
    }
    EXPECT_GT(tried, 0);
  }
}

TEST(Reachable, IsAboveTheSurfaceAndGrowsWithTheBall) {
  for (const unsigned seed : {21U, 22U, 23U}) {
    const SplineSurface surface = rough_surface(seed, 0.05);
    const ReachableSurface small = reachable_surface(surface, 1, 0.08);
    const ReachableSurface large = reachable_surface(surface, 1.7, 0.08);
    for (std::size_t k = 0; k < small.residue_um.values.size(); ++k) {
      EXPECT_GE(small.residue_um.values[k], 0);
      EXPECT_GE(large.residue_um.values[k], small.residue_um.values[k] - kPromiseUm);
    }
  }
}

TEST(Reachable, DoesNotDependOnTheThreadCount) {
  const SplineSurface surface = rough_surface(31, 0.06);
  set_thread_count(1);
  const ReachableSurface one = reachable_surface(surface, 2, 0.06);
  set_thread_count(3);
  const ReachableSurface three = reachable_surface(surface, 2, 0.06);
  set_thread_count(0);
  EXPECT_EQ(one.closing_mm.values, three.closing_mm.values);
  EXPECT_EQ(one.residue_um.values, three.residue_um.values);
}

TEST(Reachable, RefusesNonsense) {
  const SplineSurface surface = rough_surface(1, 0.01);
  EXPECT_THROW(reachable_surface(surface, 0, 0.1), InputError);
  EXPECT_THROW(reachable_surface(surface, 2, -0.1), InputError);
}

}  // namespace
}  // namespace lightmill

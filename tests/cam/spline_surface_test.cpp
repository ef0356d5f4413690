#include "cam/spline_surface.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "cam/detail/spline_refinement.h"

namespace lightmill {
namespace {

// A hostile set-up: off-centre, different sizes and spans in x and y.
const Box2 kExtent{{-3, 5}, {9, 12}};
constexpr int kSpansX = 11;
constexpr int kSpansY = 5;

SplineSurface random_surface(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(9, 11);
  Grid<double> c(kSpansX + 3, kSpansY + 3);
  for (double& value : c.values) value = uniform(random);
  return {kExtent, kSpansX, kSpansY, c};
}

/// The spline that is a product of two quadratics: on uniform knots the coefficient of a cubic polynomial is its
/// blossom, here f(a, b, c) averaged over pairs of the knots around the Greville point.
double quadratic_blossom(double a, double b, double c, const double (&p)[3]) {
  return p[0] + p[1] * (a + b + c) / 3 + p[2] * (a * b + b * c + c * a) / 3;
}

constexpr double kP[3] = {2.0, 0.3, -0.05};  // of x
constexpr double kQ[3] = {1.5, -0.1, 0.02};  // of y

SplineSurface polynomial_surface() {
  Grid<double> c(kSpansX + 3, kSpansY + 3);
  const Vec2 span = kExtent.size().cwiseQuotient(Vec2(kSpansX, kSpansY));
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) {
      const double x = kExtent.min.x() + (i - 1) * span.x();
      const double y = kExtent.min.y() + (j - 1) * span.y();
      c.at(i, j) =
          quadratic_blossom(x - span.x(), x, x + span.x(), kP) * quadratic_blossom(y - span.y(), y, y + span.y(), kQ);
    }
  }
  return {kExtent, kSpansX, kSpansY, c};
}

double value(const double (&p)[3], double t) {
  return p[0] + p[1] * t + p[2] * t * t;
}
double slope(const double (&p)[3], double t) {
  return p[1] + 2 * p[2] * t;
}
double integral(const double (&p)[3], double a, double b) {
  const auto primitive = [&](double t) { return p[0] * t + p[1] * t * t / 2 + p[2] * t * t * t / 3; };
  return primitive(b) - primitive(a);
}

TEST(SplineSurface, ItsHighestAndLowestAreThoseOfEveryPointOfTheScan) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    const SplineSurface s = random_surface(seed);
    double lowest = 1e9, highest = -1e9;
    for (int j = 0; j <= 8 * kSpansY; ++j) {
      for (int i = 0; i <= 8 * kSpansX; ++i) {
        const double h = s.height(kExtent.min.x() + kExtent.size().x() * i / (8 * kSpansX), kExtent.min.y() + kExtent.size().y() * j / (8 * kSpansY));
        lowest = std::min(lowest, h);
        highest = std::max(highest, h);
      }
    }
    EXPECT_EQ(s.lowest(), lowest);
    EXPECT_EQ(s.highest(), highest);
  }
}

TEST(SplineSurface, ReproducesPolynomialsWithDerivatives) {
  const SplineSurface surface = polynomial_surface();
  for (const double x : {-3.0, -2.2, 0.1, 4.0, 8.99, 9.0}) {
    for (const double y : {5.0, 6.4, 9.1, 12.0}) {
      const auto s = surface.sample(x, y);
      EXPECT_NEAR(s.h, value(kP, x) * value(kQ, y), 1e-12);
      EXPECT_NEAR(s.hx, slope(kP, x) * value(kQ, y), 1e-12);
      EXPECT_NEAR(s.hy, value(kP, x) * slope(kQ, y), 1e-12);
      EXPECT_NEAR(s.hxx, 2 * kP[2] * value(kQ, y), 1e-11);
      EXPECT_NEAR(s.hxy, slope(kP, x) * slope(kQ, y), 1e-11);
      EXPECT_NEAR(s.hyy, value(kP, x) * 2 * kQ[2], 1e-11);
      EXPECT_EQ(surface.height(x, y), s.h);
      const Vec3 n = surface.normal(x, y);
      EXPECT_NEAR(n.norm(), 1, 1e-15);
      EXPECT_NEAR(n.dot(Vec3(1, 0, s.hx)), 0, 1e-14);
      EXPECT_NEAR(n.dot(Vec3(0, 1, s.hy)), 0, 1e-14);
      EXPECT_GT(n.z(), 0);
    }
  }
}

TEST(SplineSurface, VolumeIsTheIntegral) {
  EXPECT_NEAR(polynomial_surface().volume_mm3(), integral(kP, -3, 9) * integral(kQ, 5, 12), 1e-10);
}

TEST(SplineSurface, ExtremesAreOfTheSurface) {
  const SplineSurface surface = polynomial_surface();
  // The x factor peaks at its vertex 3, the y factor at 12; the lowest corner is (-3, 5) or (9, 5).
  EXPECT_NEAR(surface.highest(), value(kP, 3) * value(kQ, 12), 1e-3);
  EXPECT_NEAR(surface.lowest(), value(kP, 9) * value(kQ, 5), 1e-3);
}

TEST(SplineSurface, SecondDerivativesAreContinuousAcrossKnots) {
  const SplineSurface surface = random_surface(1);
  const Vec2 span = surface.span_mm();
  for (int k = 1; k < kSpansX; ++k) {
    const double x = kExtent.min.x() + k * span.x();
    const auto a = surface.sample(x - 1e-9, 7.7);
    const auto b = surface.sample(x + 1e-9, 7.7);
    EXPECT_NEAR(a.h, b.h, 1e-7);
    EXPECT_NEAR(a.hx, b.hx, 1e-7);
    EXPECT_NEAR(a.hxx, b.hxx, 1e-7);
  }
}

TEST(SplineSurface, APlaneGoesOnOutside) {
  Grid<double> c(kSpansX + 3, kSpansY + 3);
  const Vec2 span = kExtent.size().cwiseQuotient(Vec2(kSpansX, kSpansY));
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) {
      c.at(i, j) = 10 + 0.3 * (kExtent.min.x() + (i - 1) * span.x()) - 0.2 * (kExtent.min.y() + (j - 1) * span.y());
    }
  }
  const SplineSurface plane(kExtent, kSpansX, kSpansY, c);
  for (const Vec2& p : {Vec2(12, 8), Vec2(0, -3), Vec2(-9, 20), Vec2(200, -300)}) {
    EXPECT_NEAR(plane.height(p.x(), p.y()), 10 + 0.3 * p.x() - 0.2 * p.y(), 1e-10);
  }
}

TEST(SplineSurface, GoesOnC2AcrossTheBorder) {
  const SplineSurface surface = random_surface(2);
  for (const double y : {5.0, 7.3, 12.0}) {
    const auto in = surface.sample(9 - 1e-9, y);
    const auto out = surface.sample(9 + 1e-9, y);
    EXPECT_NEAR(in.h, out.h, 1e-7);
    EXPECT_NEAR(in.hx, out.hx, 1e-7);
    EXPECT_NEAR(in.hxx, out.hxx, 1e-7);
    EXPECT_NEAR(in.hxy, out.hxy, 1e-7);
  }
}

TEST(SplineSurface, DetailsFadeOutside) {
  // The steepest slope along the border, out to 20 mm, stays near what random coefficients have inside. Straight on
  // from every border point it would grow by |hxy| (0.5 / mm here) with every mm.
  for (unsigned seed = 10; seed < 15; ++seed) {
    const SplineSurface surface = random_surface(seed);
    double inside = 0, outside = 0;
    for (double t = 0; t <= 1; t += 0.01) {
      const double y = 5 + 7 * t, x = -3 + 12 * t;
      for (double s = 0; s <= 1; s += 0.02) inside = std::max(inside, std::abs(surface.sample(-3 + 12 * s, y).hy));
      for (double out = 0.1; out < 20; out += 0.3) {
        outside = std::max(outside, std::abs(surface.sample(9 + out, y).hy));
        outside = std::max(outside, std::abs(surface.sample(x, 5 - out).hx));
      }
    }
    EXPECT_LT(outside, 5 * inside) << "seed " << seed;
  }
}

TEST(SplineSurface, DerivativesAreThoseOfTheHeightEverywhere) {
  const SplineSurface surface = random_surface(3);
  std::mt19937 random(4);
  std::uniform_real_distribution<double> ux(-5, 11), uy(3, 14);
  constexpr double kStep = 1e-5;
  for (int k = 0; k < 200; ++k) {
    const double x = ux(random);
    const double y = uy(random);
    const auto s = surface.sample(x, y);
    EXPECT_NEAR(s.hx, (surface.height(x + kStep, y) - surface.height(x - kStep, y)) / (2 * kStep), 1e-5);
    EXPECT_NEAR(s.hy, (surface.height(x, y + kStep) - surface.height(x, y - kStep)) / (2 * kStep), 1e-5);
    EXPECT_NEAR(s.hxy, (surface.sample(x + kStep, y).hy - surface.sample(x - kStep, y).hy) / (2 * kStep), 1e-4);
  }
}

TEST(SplineSurface, RefusesWrongSizes) {
  EXPECT_THROW(SplineSurface(kExtent, 4, 4, Grid<double>(7, 6)), InputError);
  EXPECT_THROW(SplineSurface(Box2{}, 4, 4, Grid<double>(7, 7)), InputError);
  EXPECT_THROW(SplineSurface(kExtent, 0, 4, Grid<double>(3, 7)), InputError);
}

/// A mesh of about square cells over `extent` whose inner vertices have slid off the grid by up to `slide` edges.
template <typename F>
SurfaceMesh slid_mesh(const Box2& extent, int cells_x, double slide, F height) {
  const double edge = extent.size().x() / cells_x;
  const int cells_y = static_cast<int>(std::lround(extent.size().y() / edge));
  std::mt19937 random(7);
  std::uniform_real_distribution<double> phase(0, 6);
  const double p = phase(random), q = phase(random);
  SurfaceMesh mesh;
  for (int j = 0; j <= cells_y; ++j) {
    for (int i = 0; i <= cells_x; ++i) {
      double x = extent.min.x() + extent.size().x() * i / cells_x;
      double y = extent.min.y() + extent.size().y() * j / cells_y;
      const double dx = slide * edge * std::sin(0.9 * x + 0.3 * y + p);
      const double dy = slide * edge * std::cos(0.7 * y - 0.5 * x + q);
      if (i > 0 && i < cells_x) x += dx;
      if (j > 0 && j < cells_y) y += dy;
      mesh.vertices.emplace_back(x, y, height(x, y));
    }
  }
  const int row = cells_x + 1;
  for (int j = 0; j < cells_y; ++j) {
    for (int i = 0; i < cells_x; ++i) {
      const int a = j * row + i;
      mesh.triangles.push_back({a, a + 1, a + row + 1});
      mesh.triangles.push_back({a, a + row + 1, a + row});
    }
  }
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  return mesh;
}

/// Largest distance of the fit from the truth, um, on a scan that knows nothing of the mesh.
template <typename F>
double worst_um(const SplineSurface& surface, F truth, double skip_mm = 0) {
  double worst = 0;
  const Box2& e = surface.extent();
  for (double x = e.min.x() + skip_mm; x <= e.max.x() - skip_mm; x += 0.173) {
    for (double y = e.min.y() + skip_mm; y <= e.max.y() - skip_mm; y += 0.147) {
      worst = std::max(worst, 1e3 * std::abs(surface.height(x, y) - truth(x, y)));
    }
  }
  return worst;
}

// 0.3125 mm edges, as a 321 mesh on 100 mm has.
const Box2 kPatch{{-8, 3}, {17, 18}};
constexpr int kPatchCells = 80;

TEST(FitSpline, FollowsASphereFromASlidMesh) {
  const auto cap = [](double x, double y) { return std::sqrt(150.0 * 150 - x * x - y * y) - 130; };
  const SplineFit fit = fit_spline(slid_mesh(kPatch, kPatchCells, 0.4, cap), kPatch);
  EXPECT_EQ(fit.surface.spans_x(), 80);
  EXPECT_EQ(fit.surface.spans_y(), 48);
  EXPECT_LT(fit.summary.rms_deviation_um, 0.01);
  EXPECT_LT(fit.summary.rms_normal_deviation_urad, 50);
  EXPECT_EQ(fit.summary.crease_share, 0);
  EXPECT_LT(worst_um(fit.surface, cap), 0.05);
}

TEST(FitSpline, FollowsWavesOfTenEdges) {
  const auto waves = [](double x, double y) {
    return 12 + 0.02 * std::sin(2 * x) * std::cos(1.7 * y) + 0.4 * std::sin(0.3 * x + 0.2 * y);
  };
  const SplineFit fit = fit_spline(slid_mesh(kPatch, kPatchCells, 0.4, waves), kPatch);
  EXPECT_LT(fit.summary.rms_deviation_um, 0.5);
  EXPECT_LT(fit.summary.crease_share, 0.05);
  EXPECT_LT(worst_um(fit.surface, waves), 2);
}

TEST(FitSpline, ReproducesAPlaneExactly) {
  const auto plane = [](double x, double y) { return 10 + 0.2 * x - 0.1 * y; };
  const SplineFit fit = fit_spline(slid_mesh(kPatch, 20, 0.4, plane), kPatch);
  EXPECT_LT(worst_um(fit.surface, plane), 1e-6);
  EXPECT_LT(fit.summary.rms_normal_deviation_urad, 1e-3);
}

TEST(FitSpline, GoesOverACreaseWithinTwoEdgesAndDoesNotRing) {
  constexpr double kJump = 0.3;
  const double cos = std::cos(0.31), sin = std::sin(0.31);
  const auto across = [&](double x, double y) { return cos * (x - 4.05) + sin * (y - 10); };
  for (const double sign : {1.0, -1.0}) {  // a valley, a roof
    const auto crease = [&](double x, double y) { return 12 + sign * kJump / 2 * std::abs(across(x, y)); };
    const SplineFit fit = fit_spline(slid_mesh(kPatch, kPatchCells, 0.3, crease), kPatch);
    EXPECT_GT(fit.summary.crease_share, 0.02);
    EXPECT_LT(fit.summary.crease_share, 0.15);
    EXPECT_LT(fit.summary.rms_deviation_um, 0.01);
    const double edge = kPatch.size().x() / kPatchCells;
    for (double x = kPatch.min.x(); x <= kPatch.max.x(); x += 0.0719) {
      for (double y = kPatch.min.y(); y <= kPatch.max.y(); y += 0.0713) {
        const double d = std::abs(across(x, y)) / edge;
        const auto s = fit.surface.sample(x, y);
        const double filled_um = 1e3 * sign * (s.h - crease(x, y));
        const double slope = sign * kJump / 2 * (across(x, y) > 0 ? 1 : -1);
        const double off_slope = (Vec2(s.hx, s.hy) - slope * Vec2(cos, sin)).norm() / kJump;
        const double in = std::min({x - kPatch.min.x(), kPatch.max.x() - x, y - kPatch.min.y(), kPatch.max.y() - y});
        const bool at_border = in < 3 * edge;  // where a crease leaves the lens, its end is less sure
        // Over one edge the crease rises by 50 um.
        EXPECT_GT(filled_um, at_border ? -15 : -10);
        EXPECT_LT(std::abs(filled_um), d > 3 ? (at_border ? 2 : 0.05) : d > 2 ? (at_border ? 5 : 0.3) : 26.0);
        if (at_border) continue;
        EXPECT_LT(off_slope, d > 3 ? 0.001 : d > 2 ? 0.015 : 0.6);
      }
    }
  }
}

TEST(FitSpline, FinerCreasesBetweenTheNormalsOfTheirSidesAreAnEdgeWide) {
  // As the design leaves it: every vertex has the normal of its side. Light goes astray where the slope is off by 3 % of the jump.
  constexpr double kJump = 0.3;
  const double edge = kPatch.size().x() / kPatchCells;
  for (const double angle : {0.0, 0.31, kPi / 4}) {
    const Vec2 normal(std::cos(angle), std::sin(angle));
    const auto across = [&](double x, double y) { return normal.dot(Vec2(x - 4.05, y - 10)); };
    const auto slope = [&](double x, double y) { return std::copysign(kJump / 2, across(x, y)); };
    const auto crease = [&](double x, double y) { return 12 + slope(x, y) * across(x, y); };
    SurfaceMesh mesh = slid_mesh(kPatch, kPatchCells, 0.3, crease);
    for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
      const Vec2 s = slope(mesh.vertices[v].x(), mesh.vertices[v].y()) * normal;
      mesh.normals[v] = Vec3(-s.x(), -s.y(), 1).normalized();
    }
    const SplineFit fit = fit_spline(mesh, kPatch, {.finer_creases = true});
    EXPECT_EQ(fit.surface.spans_x(), 2 * kPatchCells);
    EXPECT_NEAR(fit.summary.crease_width_mm, edge, 1e-9);
    const double step = 0.05 * edge;
    double astray_mm2 = 0, length_mm = 0;
    for (double y = kPatch.min.y() + 3 * edge; y <= kPatch.max.y() - 3 * edge; y += step) {
      const double at = 4.05 - (y - 10) * std::tan(angle);
      length_mm += step / std::cos(angle);
      for (double x = at - 5 * edge / std::cos(angle); x <= at + 5 * edge / std::cos(angle); x += step) {
        const auto s = fit.surface.sample(x, y);
        const double off = (Vec2(s.hx, s.hy) - slope(x, y) * normal).norm() / kJump;
        if (off > 0.03) astray_mm2 += step * step;
        if (std::abs(across(x, y)) > 1.5 * edge) {
          ASSERT_LT(off, 0.05) << "angle " << angle << ", at " << x << ", " << y;
        }
        if (std::abs(across(x, y)) > 2.5 * edge) {
          ASSERT_LT(off, 0.01) << "angle " << angle << ", at " << x << ", " << y;
        }
      }
    }
    EXPECT_LT(astray_mm2 / length_mm, 1.25 * edge) << "angle " << angle;
  }
}

TEST(FitSpline, OnlyAroundCreasesAreSpansFinerWhereAsked) {
  const auto crease = [](double x, double y) { return 12 + 0.1 * std::abs(x - 4.05) + 0.01 * std::sin(0.8 * x) * std::cos(y); };
  const SplineFit fit = fit_spline(slid_mesh(kPatch, kPatchCells, 0.3, crease), kPatch, {.finer_creases = true});
  EXPECT_EQ(fit_spline(slid_mesh(kPatch, kPatchCells, 0.3, crease), kPatch).surface.spans_x(), kPatchCells);
  const Grid<double>& all = fit.surface.coefficients();
  const auto columns = [&](int from, int to) {
    Grid<double> some(to - from, all.height);
    for (int j = 0; j < all.height; ++j) {
      for (int i = from; i < to; ++i) some.at(i - from, j) = all.at(i, j);
    }
    return some;
  };
  // The crease is 38.5 edges, 77 spans from the left.
  EXPECT_TRUE(detail::with_spans_doubled(columns(0, 60 + 3), 1e-11).has_value());
  EXPECT_FALSE(detail::with_spans_doubled(columns(60, 100 + 3), 1e-11).has_value());
  EXPECT_TRUE(detail::with_spans_doubled(columns(100, 160 + 3), 1e-11).has_value());
}

TEST(FitSpline, TakesNoBumpForACrease) {
  // 20 um high, two edges from its middle to its steepest slope.
  const double wide = 2 * kPatch.size().x() / kPatchCells;
  const auto bump = [&](double x, double y) {
    return 12 + 0.02 * std::exp(-(Vec2(x, y) - Vec2(4, 10)).squaredNorm() / (2 * wide * wide));
  };
  EXPECT_LT(worst_um(fit_spline(slid_mesh(kPatch, kPatchCells, 0.3, bump), kPatch).surface, bump), 1);
}

TEST(FitSpline, GoesOnSmoothlyWhereTheMeshDoesNotReach) {
  // The mesh of a free outline covers a part of the rectangle only.
  const auto cap = [](double x, double y) { return std::sqrt(150.0 * 150 - x * x - y * y) - 130; };
  SurfaceMesh mesh = slid_mesh(Box2{{-4, -4}, {4, 4}}, 32, 0.3, cap);
  const SplineFit fit = fit_spline(mesh, Box2{{-5, -6}, {7, 5}});
  EXPECT_LT(fit.summary.max_deviation_um, 0.5);
  EXPECT_LT(worst_um(fit.surface, cap), 100);  // curvature 1/150 not continued over 3 mm: 30 um
}

TEST(FitSpline, ALargeMeshIsFittedInSquaresWithoutSeams) {
  // 400 x 40 spans, a corner of the rectangle without vertices.
  const Box2 strip{{-60, -7}, {65, 5.5}};
  const auto cap = [](double x, double y) { return std::sqrt(150.0 * 150 - x * x - y * y) - 130; };
  SurfaceMesh mesh = slid_mesh(strip, 400, 0.3, cap);
  std::erase_if(mesh.triangles, [&](const auto& t) { return mesh.vertices[t[0]].x() > 58; });
  std::vector<int> kept(mesh.vertices.size(), -1);
  SurfaceMesh part;
  for (auto& triangle : mesh.triangles) {
    for (int& v : triangle) {
      if (kept[v] < 0) {
        kept[v] = static_cast<int>(part.vertices.size());
        part.vertices.push_back(mesh.vertices[v]);
        part.normals.push_back(mesh.normals[v]);
      }
      v = kept[v];
    }
  }
  part.triangles = mesh.triangles;
  const SplineFit fit = fit_spline(part, strip);
  EXPECT_EQ(fit.surface.spans_x(), 400);
  for (double x = -59.9; x < 58; x += 0.123) {
    for (double y = -6.9; y < 5.5; y += 0.71) EXPECT_NEAR(fit.surface.height(x, y), cap(x, y), 0.05e-3) << x << " " << y;
  }
  EXPECT_NEAR(fit.surface.height(62, -1), cap(62, -1), 0.1);
}

TEST(FitSpline, RefusesWhatIsNoHeightField) {
  const auto plane = [](double, double) { return 10.0; };
  SurfaceMesh mesh = slid_mesh(kPatch, 10, 0, plane);
  mesh.normals[5] = Vec3(1, 0, 0);
  EXPECT_THROW(fit_spline(mesh, kPatch), InputError);
  mesh.normals.clear();
  EXPECT_THROW(fit_spline(mesh, kPatch), InputError);
  EXPECT_THROW(fit_spline(SurfaceMesh{}, kPatch), InputError);
}

TEST(FitSpline, StopsWhenAsked) {
  Monitor monitor;
  monitor.should_stop = [] { return true; };
  EXPECT_THROW(fit_spline(slid_mesh(kPatch, 10, 0, [](double, double) { return 1.0; }), kPatch, {}, monitor), Stopped);
}

}  // namespace
}  // namespace lightmill

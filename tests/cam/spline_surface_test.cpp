#include "cam/spline_surface.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

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

TEST(SplineSurface, OutsideGoesOnWithHeightAndSlopeOfTheBorder) {
  const SplineSurface surface = random_surface(2);
  const auto border = surface.sample(9, 7.3);
  const auto outside = surface.sample(11.5, 7.3);
  EXPECT_NEAR(outside.h, border.h + 2.5 * border.hx, 1e-12);
  EXPECT_NEAR(outside.hx, border.hx, 1e-12);
  EXPECT_EQ(outside.hxx, 0);
  const auto below = surface.sample(0.4, 5);
  EXPECT_NEAR(surface.height(0.4, 2), below.h - 3 * below.hy, 1e-12);
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

}  // namespace
}  // namespace lightmill

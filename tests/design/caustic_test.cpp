#include "design/caustic.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numeric>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/light_grid.h"
#include "design/surface.h"

namespace lightmill {
namespace {

using detail::LightGrid;

double any_in(double low, double high) {
  return low + (high - low) * (*rc::gen::inRange(0, 1000001)) * 1e-6;
}
Vec2 any_point(double low, double high) {
  return {any_in(low, high), any_in(low, high)};
}

double total(const Grid<double>& grid) {
  return std::accumulate(grid.values.begin(), grid.values.end(), 0.0);
}
double total(const Caustic& c) {
  return total(c.flux) + c.outside_extent + c.totally_reflected;
}

double difference(const LightGrid& a, const LightGrid& b) {
  double most = std::abs(a.outside - b.outside);
  for (std::size_t i = 0; i < a.flux.values.size(); ++i)
    most = std::max(most, std::abs(a.flux.values[i] - b.flux.values[i]));
  return most;
}

RC_GTEST_PROP(LightGrid, LosesNoLight, ()) {
  LightGrid grid(7, 4);
  const Vec2 a = any_point(-5, 12), b = any_point(-5, 12);
  // From fat to without any area, and with corners exactly on pixel lines.
  const double fat = *rc::gen::element(1.0, 1e-6, 1e-12, 0.0);
  Vec2 c = a + (b - a) * any_in(-1, 2) + fat * any_point(-5, 5);
  if (*rc::gen::inRange(0, 2)) c = c.array().round();
  grid.add_triangle(a, b, c, 2.5);
  RC_ASSERT(std::abs(total(grid.flux) + grid.outside - 2.5) < 1e-12);
  for (double f : grid.flux.values) RC_ASSERT(f >= -1e-13);
}

RC_GTEST_PROP(LightGrid, ATriangleIsTheSumOfItsParts, ()) {
  const Vec2 a = any_point(-3, 9), b = any_point(-3, 9), c = any_point(-3, 9);
  const Vec2 ab = (a + b) / 2, bc = (b + c) / 2, ca = (c + a) / 2;
  LightGrid whole(6, 5), parts(6, 5);
  whole.add_triangle(a, b, c, 1);
  parts.add_triangle(a, ab, ca, 0.25);
  parts.add_triangle(ca, bc, c, 0.25);
  parts.add_triangle(b, ab, bc, 0.25);  // clockwise if the others are not: orientation does not matter
  parts.add_triangle(ab, bc, ca, 0.25);
  const double twice_area = std::abs((b - a).x() * (c - a).y() - (b - a).y() * (c - a).x());
  RC_PRE(twice_area > 1e-3);
  RC_ASSERT(difference(whole, parts) < 1e-11);
}

TEST(LightGrid, SharesAKnownTriangleExactly) {
  LightGrid grid(2, 2);
  grid.add_triangle({0, 0}, {2, 0}, {0, 2}, 1);
  EXPECT_NEAR(grid.flux.at(0, 0), 0.5, 1e-15);
  EXPECT_NEAR(grid.flux.at(1, 0), 0.25, 1e-15);
  EXPECT_NEAR(grid.flux.at(0, 1), 0.25, 1e-15);
  EXPECT_EQ(grid.flux.at(1, 1), 0);
}

TEST(LightGrid, ACollapsedTriangleIsTheLimitOfThinOnes) {
  const Vec2 a(0.3, 0.2), b(8.7, 5.1);
  const Vec2 across = Vec2(-4.9, 8.4).normalized();
  LightGrid thin(9, 6), collapsed(9, 6);
  const Vec2 c = a + 0.3 * (b - a);
  thin.add_triangle(a, b, c + 1e-6 * across, 1);
  collapsed.add_triangle(a, b, c, 1);
  EXPECT_LT(difference(thin, collapsed), 1e-6);
  // The density peaks where the third corner lies: half of the light is on the longer side of the median.
  LightGrid row(10, 1);
  row.add_triangle({0, 0.5}, {10, 0.5}, {5, 0.5}, 1);
  for (int i = 0; i < 10; ++i) EXPECT_NEAR(row.flux.at(i, 0), (i < 5 ? 2 * i + 1 : 19 - 2 * i) / 50.0, 1e-14);
}

TEST(LightGrid, APointIsDepositedWhereItFalls) {
  LightGrid grid(3, 3);
  grid.add_triangle({1.5, 2.5}, {1.5, 2.5}, {1.5, 2.5}, 1);
  EXPECT_EQ(grid.flux.at(1, 2), 1);
  grid.add_triangle({-1, 2.5}, {-1, 2.5}, {-1, 2.5}, 1);
  EXPECT_EQ(grid.outside, 1);
}

RC_GTEST_PROP(LightGrid, SmallBoxesAreThePairOfTrianglesTheyAre, ()) {
  const Vec2 centre = any_point(-2, 6);
  const Vec2 half(any_in(0.001, 0.5), any_in(0.001, 0.5));
  LightGrid box(5, 4), triangles(5, 4);
  box.add_small_box(centre, half.x(), half.y(), 1);
  const Vec2 flip(half.x(), -half.y());
  triangles.add_triangle(centre - half, centre + flip, centre + half, 0.5);
  triangles.add_triangle(centre - half, centre + half, centre - flip, 0.5);
  RC_ASSERT(difference(box, triangles) < 1e-10);
}

/// A lens whose surface is the plane z = thickness + slope . (x, y) plus what keeps it above.
SurfaceMesh tilted(const Lens& lens, int mesh, const Vec2& slope) {
  SurfaceMesh surface = start_mesh(lens, mesh);
  for (Vec3& v : surface.vertices) v.z() += slope.dot(v.head<2>());
  surface.normals = angle_weighted_normals(surface.vertices, surface.triangles);
  return surface;
}

Lens small_lens() {
  Lens lens;
  lens.size_mm = {30, 20};
  return lens;
}

TEST(TraceMesh, AFlatLensCastsItsOutline) {
  const Box2 extent{{-25, -12}, {11, 15}};  // off-centre, and cuts off a part of the light
  const Caustic c = trace_mesh(start_mesh(small_lens(), 13), small_lens(), {}, extent, {.pixels = 36});
  ASSERT_EQ(c.flux.width, 36);
  ASSERT_EQ(c.flux.height, 27);
  for (int j = 0; j < 27; ++j) {
    for (int i = 0; i < 36; ++i) {
      const double x = -25 + i + 0.5, y = -12 + j + 0.5;
      ASSERT_NEAR(c.flux.at(i, j), std::abs(x) < 15 && std::abs(y) < 10 ? 1.0 / 600 : 0.0, 1e-14) << x << " " << y;
    }
  }
  EXPECT_NEAR(c.outside_extent, 4 * 20 / 600.0, 1e-12);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

TEST(TraceMesh, APrismMovesTheLightAsSnellSays) {
  const Vec2 slope(0.3, 0);
  const Caustic c =
      trace_mesh(tilted(small_lens(), 9, slope), small_lens(), {}, Box2::centred({200, 200}), {.pixels = 800});
  double x = 0;
  for (int j = 0; j < c.flux.height; ++j) {
    for (int i = 0; i < c.flux.width; ++i) x += c.flux.at(i, j) * (-100 + (i + 0.5) * 0.25);
  }
  // Mean over the lens: the way to the receiver is 300 mm less the height above z = thickness, whose mean is 0.
  const double tilt = std::atan(0.3);
  const double deviation = std::asin(1.49 * std::sin(tilt)) - tilt;
  EXPECT_NEAR(x, 300 * std::tan(deviation), 1e-3);  // away from the normal: the normal leans to -x
}

TEST(TraceMesh, WhatIsTotallyReflectedIsCountedAsSuch) {
  const Caustic c = trace_mesh(tilted(small_lens(), 5, {1.2, 0}), small_lens(), {}, Box2::centred({50, 50}));
  EXPECT_NEAR(c.totally_reflected, 1, 1e-12);
  EXPECT_EQ(total(c.flux), 0);
}

TEST(TraceMesh, CountsLightFromFoldsAndCreases) {
  SurfaceMesh mesh = start_mesh(small_lens(), 31);
  unsigned state = 7;
  for (Vec3& v : mesh.vertices) {
    state = state * 1664525u + 1013904223u;
    v.z() += (state >> 16) / 65536.0;  // slopes to 45 degrees and beyond: a wild scatter, some totally reflected
    v.x() += ((state >> 8) % 256) / 100.0;
  }
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  const Box2 extent = Box2::centred({100, 70});
  const Caustic c = trace_mesh(mesh, small_lens(), {}, extent);
  EXPECT_GT(count_inverted(mesh), 0);
  EXPECT_GT(c.outside_extent, 0);
  EXPECT_GT(c.totally_reflected, 0);
  EXPECT_NEAR(total(c), 1, 1e-12);
  set_thread_count(1);
  const Caustic alone = trace_mesh(mesh, small_lens(), {}, extent);
  set_thread_count(3);
  const Caustic three = trace_mesh(mesh, small_lens(), {}, extent);
  set_thread_count(0);
  EXPECT_EQ(alone.flux.values, three.flux.values);
  EXPECT_EQ(alone.outside_extent, three.outside_extent);
}

TEST(TraceMesh, AWideLightBlursByItsDisk) {
  Lens lens;
  lens.size_mm = {2, 2};
  CausticOptions options{.pixels = 200, .angular_diameter_rad = 0.02};  // radius 3 mm at 300 mm
  const Box2 extent = Box2::centred({20, 10});
  const Caustic c = trace_mesh(start_mesh(lens, 5), lens, {}, extent, options);
  double x2 = 0, y2 = 0;
  for (int j = 0; j < c.flux.height; ++j) {
    for (int i = 0; i < c.flux.width; ++i) {
      x2 += c.flux.at(i, j) * std::pow(-10 + (i + 0.5) * 0.1, 2);
      y2 += c.flux.at(i, j) * std::pow(-5 + (j + 0.5) * 0.1, 2);
    }
  }
  // Variances add: the square's a^2 / 3 with half side a, and the disk's R^2 / 4.
  EXPECT_NEAR(x2, 1.0 / 3 + 9.0 / 4, 0.01);
  EXPECT_NEAR(y2, 1.0 / 3 + 9.0 / 4, 0.01);
  EXPECT_NEAR(total(c), 1, 1e-12);
  // Light from beside the extent is blurred into it: a window beside the square sees the disk's rim.
  const Caustic window = trace_mesh(start_mesh(lens, 5), lens, {}, {{1.5, -5}, {5, 5}}, options);
  EXPECT_GT(total(window.flux), 0.1);
  EXPECT_NEAR(total(window), 1, 1e-12);
}

Grid<float> lens_heights(int width, int height, const Box2& box, double radius) {
  Grid<float> heights(width, height);
  for (int j = 0; j < height; ++j) {
    for (int i = 0; i < width; ++i) {
      const Vec2 p = box.min + box.size().cwiseProduct(Vec2(i / (width - 1.0), j / (height - 1.0)));
      heights.at(i, j) = static_cast<float>(12 - p.squaredNorm() / (2 * radius) + 0.3 * p.x() * p.y() / radius);
    }
  }
  return heights;
}

TEST(TraceHeights, AgreesWithTheMeshOfTheSameSurface) {
  const Lens lens = small_lens();
  const Box2 box = Box2::centred(lens.size_mm);
  SurfaceMesh mesh = start_mesh(lens, 301);
  for (Vec3& v : mesh.vertices) v.z() = 12 - v.head<2>().squaredNorm() / 600 + 0.3 * v.x() * v.y() / 300;
  mesh.normals.clear();
  for (const Vec3& v : mesh.vertices) {
    mesh.normals.push_back(Vec3(v.x() / 300 - 0.3 * v.y() / 300, v.y() / 300 - 0.3 * v.x() / 300, 1).normalized());
  }
  const Box2 picture{{-12, -9}, {13, 8}};
  const Caustic a = trace_mesh(mesh, lens, {}, picture, {.pixels = 50});
  const Caustic b = trace_heights(lens_heights(601, 401, box, 300), box, lens, {}, {}, picture, {.pixels = 50});
  double difference = 0;
  for (std::size_t i = 0; i < a.flux.values.size(); ++i) difference += std::abs(a.flux.values[i] - b.flux.values[i]);
  EXPECT_LT(difference, 0.003);
  EXPECT_NEAR(total(b), 1, 1e-12);
}

TEST(TraceHeights, LosesNoLightOnARoughSurfaceWithHoles) {
  const Lens lens = small_lens();
  const Box2 box = Box2::centred(lens.size_mm);
  Grid<float> heights = lens_heights(151, 101, box, 150);
  unsigned state = 3;
  for (float& h : heights.values) {
    state = state * 1664525u + 1013904223u;
    h += static_cast<float>((state >> 16) / 65536.0 * 0.12);
  }
  heights.at(20, 20) = NAN;  // not milled, or beside the outline: no light passes
  const Caustic c = trace_heights(heights, box, lens, {}, {}, Box2::centred({60, 40}));
  EXPECT_GT(c.outside_extent, 0.01);
  EXPECT_GT(c.totally_reflected, 0.0001);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

TEST(TraceHeights, ADiskLensIsLitOnItsDisk) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  lens.size_mm = {20, 20};
  const Box2 box = Box2::centred({24, 24});
  const Grid<float> flat(481, 481, 10.f);
  const Caustic c = trace_heights(flat, box, lens, {}, {}, box, {.pixels = 24});
  EXPECT_NEAR(c.flux.at(12, 12), 1 / (kPi * 100), 1e-5);
  EXPECT_EQ(c.flux.at(0, 12), 0);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

/// A target that is bright on the right half of an off-centre picture, and the light that fell there.
TargetLight half_lit() {
  TargetLight target;
  target.extent = {{-10, 5}, {30, 25}};
  target.area_flux = Grid<double>(256, 256);
  for (int j = 0; j < 256; ++j) {
    for (int i = 128; i < 256; ++i) target.area_flux.at(i, j) = 1.0 / (128 * 256);
  }
  return target;
}

TEST(Measures, APerfectCausticHasNoError) {
  const TargetLight target = half_lit();
  const CausticMeasures m = measure_caustic({target.extent, target.area_flux, 0, 0}, target);
  EXPECT_NEAR(m.l1_error, 0, 1e-12);
  EXPECT_NEAR(m.flux_outside_support, 0, 1e-12);
  EXPECT_GT(m.psnr_db, 150);
}

TEST(Measures, UniformLightOnAHalfLitTargetIsKnown) {
  const TargetLight target = half_lit();
  // Other pixels than the target's, over a larger extent: light 0.8 in the picture, 0.15 beside it, 0.05 reflected.
  Caustic c;
  c.extent = {{-50, -15}, {70, 45}};
  c.flux = Grid<double>(90, 90);
  for (int j = 30; j < 60; ++j) {
    for (int i = 30; i < 60; ++i) c.flux.at(i, j) = 0.8 / 900;
  }
  c.flux.at(0, 0) = 0.1;
  c.outside_extent = 0.05;
  c.totally_reflected = 0.05;
  const CausticMeasures m = measure_caustic(c, target);
  EXPECT_NEAR(m.l1_error, 0.5 * 0.8 + 0.5 * 1.2, 1e-9);
  EXPECT_NEAR(m.psnr_db, 10 * std::log10(4 / (0.5 * 0.64 + 0.5 * 1.44)), 1e-9);
  // The support grows by two of 256 columns to the left.
  EXPECT_NEAR(m.flux_outside_support, 0.1 + 0.05 + 0.8 * 126 / 256, 1e-9);
  EXPECT_NEAR(m.flux_totally_reflected, 0.05, 1e-15);
}

TEST(Display, IsThePictureAsItsReaderSeesIt) {
  Grid<double> flux(2, 2);
  flux.at(0, 1) = 0.5;  // at small x, large y
  const Grid<float> lens_side = display_picture(flux, ViewedFrom::kLens, 4);
  EXPECT_FLOAT_EQ(lens_side.at(1, 0), 1);  // from the lens +X is on the left: small x on the right, on top
  EXPECT_FLOAT_EQ(display_picture(flux, ViewedFrom::kBehind, 4).at(0, 0), 1);
}

}  // namespace
}  // namespace lightmill

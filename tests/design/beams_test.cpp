#include "design/beams.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/surface.h"

namespace lightmill {
namespace {

Lens small_lens() {
  Lens lens;
  lens.size_mm = {30, 20};
  return lens;
}

SurfaceMesh surface_of(const Lens& lens, int mesh, const auto& height) {
  SurfaceMesh surface = start_mesh(lens, mesh);
  for (Vec3& v : surface.vertices) v.z() = height(v.x(), v.y());
  surface.normals = angle_weighted_normals(surface.vertices, surface.triangles);
  return surface;
}

double landed(const Caustic& c) { return std::accumulate(c.flux.values.begin(), c.flux.values.end(), 0.0); }
double total(const Caustic& c) {
  return landed(c) + c.outside_extent + c.totally_reflected + c.fresnel_reflected + c.shadowed + c.through_rim;
}

Vec2 centroid(const Caustic& c) {
  Vec2 sum = Vec2::Zero();
  const Vec2 pixel = c.extent.size().cwiseQuotient(Vec2(c.flux.width, c.flux.height));
  for (int j = 0; j < c.flux.height; ++j) {
    for (int i = 0; i < c.flux.width; ++i) sum += c.flux.at(i, j) * (c.extent.min + pixel.cwiseProduct(Vec2(i + 0.5, j + 0.5)));
  }
  return sum / landed(c);
}

double variance_x(const Caustic& c) {
  const double middle = centroid(c).x();
  const double pixel = c.extent.size().x() / c.flux.width;
  double sum = 0;
  for (int j = 0; j < c.flux.height; ++j) {
    for (int i = 0; i < c.flux.width; ++i) sum += c.flux.at(i, j) * std::pow(c.extent.min.x() + (i + 0.5) * pixel - middle, 2);
  }
  return sum / landed(c);
}

TEST(TraceBeams, IsTraceMeshForLightAlongZ) {
  const Lens lens = small_lens();
  const SurfaceMesh mesh = surface_of(lens, 61, [](double x, double y) { return 12 - x * x / 300 - y * y / 500 + x * y / 900; });
  const Box2 extent{{-9, -7}, {11, 8}};
  const Caustic a = trace_mesh(mesh, lens, {}, extent, {.pixels = 60});
  const Caustic b = trace_beams(mesh, lens, {}, receiver_plane(lens, {}), extent, {.pixels = 60});
  double most = 0;
  for (std::size_t i = 0; i < a.flux.values.size(); ++i) most = std::max(most, std::abs(a.flux.values[i] - b.flux.values[i]));
  EXPECT_LT(most, 1e-12);
  EXPECT_EQ(b.shadowed, 0);
}

TEST(TraceBeams, SlantedLightThroughAPlateIsShiftedAsSnellSays) {
  const Lens lens = small_lens();
  const double slant = 0.3;
  Lamp lamp;
  lamp.direction = {std::sin(slant), 0, std::cos(slant)};
  const Caustic c = trace_beams(start_mesh(lens, 31), lens, lamp, receiver_plane(lens, {}), Box2::centred({300, 60}), {.pixels = 600});
  // Parallel faces: out as it came in. Through the top at x = 0 on the mean of what enters the back.
  const double inside = std::asin(std::sin(slant) / 1.49);
  const double cut = 10 * std::tan(inside);  // this wide a strip of the top would get its light through the side
  EXPECT_NEAR(c.through_rim, cut / 30, 0.5 / 30);
  EXPECT_NEAR(centroid(c).x(), cut / 2 + 300 * std::tan(slant), 0.3);
  EXPECT_NEAR(c.rim_from.min.x(), -15, 1e-9);
  EXPECT_LT(c.rim_from.max.x(), -15 + cut);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

TEST(TraceBeams, APrismSpreadsColoursAsSnellSaysPerWavelength) {
  const Lens lens = small_lens();
  const double tilt = std::atan(0.4);
  const SurfaceMesh mesh = surface_of(lens, 9, [](double x, double) { return 20 + 0.4 * x; });
  double before = 1e9;
  for (const double wavelength : {0.4642, 0.5491, 0.6114}) {
    const Lens coloured = lens_at(lens, wavelength);
    const Caustic c = trace_beams(mesh, coloured, {}, receiver_plane(lens, {}), Box2::centred({300, 40}), {.pixels = 600});
    const double deviation = std::asin(coloured.refractive_index * std::sin(tilt)) - tilt;
    EXPECT_NEAR(centroid(c).x(), 290 * std::tan(deviation), 1e-3) << wavelength;
    EXPECT_LT(centroid(c).x(), before);  // blue is bent most
    before = centroid(c).x();
  }
  // Published [Sultanova, Kasarova, Nikolov 2009; Kasarova et al. 2007]: measured indices, and the Abbe number of the fit.
  EXPECT_NEAR(pmma_index(0.4861), 1.497, 1e-3);
  EXPECT_NEAR(pmma_index(0.6328), 1.489, 1e-3);
  EXPECT_NEAR(pmma_index(1.052), 1.481, 1e-3);
  EXPECT_NEAR((pmma_index(0.5876) - 1) / (pmma_index(0.4861) - pmma_index(0.6563)), 52.60, 0.2);
  EXPECT_NEAR(lens_at(lens, 0.5876).refractive_index, 1.49, 1e-15);
}

TEST(TraceBeams, FresnelTakesItsShareTwiceAtNormalIncidence) {
  const Lens lens = small_lens();
  const Caustic c = trace_beams(start_mesh(lens, 9), lens, {}, receiver_plane(lens, {}), Box2::centred({60, 60}), {.fresnel = true});
  const double passes = 1 - std::pow(0.49 / 2.49, 2);
  EXPECT_NEAR(landed(c), passes * passes, 1e-12);
  EXPECT_NEAR(c.fresnel_reflected, 1 - passes * passes, 1e-12);
  // Brewster: half of what s-polarised light keeps is all that is reflected.
  const double brewster = std::atan(1.49);
  const double s = std::pow(std::cos(2 * brewster), 2);
  EXPECT_NEAR(fresnel_transmission(std::cos(brewster), {1, 1.49}), 1 - s / 2, 1e-12);
  EXPECT_EQ(fresnel_transmission(std::cos(0.9), {1.49, 1}), 0);
}

TEST(TraceBeams, ATiltedReceiverIsDimmerByTheCosine) {
  const Lens lens = small_lens();
  const double tilt = 0.6;
  const Caustic c = trace_beams(start_mesh(lens, 9), lens, {}, receiver_plane(lens, {}, {0, tilt}, {3, -2}),
                                Box2::centred({60, 60}), {.pixels = 120});
  // Irradiance at a pixel in the light: cos(tilt) of what falls on an upright wall; the shift moves the picture back.
  EXPECT_NEAR(c.flux.at(60, 60), 0.25 / 600 * std::cos(tilt), 1e-12);
  EXPECT_NEAR(centroid(c).x(), -3 / std::cos(tilt), 1e-2);
  EXPECT_NEAR(centroid(c).y(), 2, 1e-9);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

TEST(TraceBeams, ASunIsADiskAndOnATiltedWallAnEllipse) {
  Lens lens;
  lens.size_mm = {2, 2};
  lens.thickness_mm = 1;
  Lamp sun;
  sun.angular_diameter_rad = 0.02;
  for (const double tilt : {0.0, 0.8}) {
    const Caustic c = trace_beams(start_mesh(lens, 41), lens, sun, receiver_plane(lens, {}, {0, tilt}), Box2::centred({20, 20}),
                                  {.pixels = 200, .lamp_samples = 100});
    // Variances add: square a^2 / 12 and disk R^2 / 4; a plate leaves directions as they are: R = 300 tan(0.01) from where
    // the light leaves it. Tilt stretches by 1 / cos.
    const double radius = 300 * std::tan(0.01);
    EXPECT_NEAR(variance_x(c), (4.0 / 12 + radius * radius / 4) / std::pow(std::cos(tilt), 2), 0.02 * radius * radius / std::pow(std::cos(tilt), 2)) << tilt;
    EXPECT_NEAR(total(c), 1, 1e-12);
  }
}

TEST(TraceBeams, APointLampThroughAPlateCastsTheEnlargedOutline) {
  Lens lens = small_lens();
  Lamp lamp;
  lamp.kind = Lamp::Kind::kPoint;
  lamp.position_mm = {0, 0, -200};
  const Caustic c = trace_beams(start_mesh(lens, 61), lens, lamp, receiver_plane(lens, {}), Box2::centred({120, 80}), {.pixels = 480});
  // Near the axis the plate shortens the way to 10 / n; the rim of the top gets light from further in on the back.
  const double at_top = 200 + 10 / 1.49;
  const double reach = 15 * (at_top + 300) / at_top;
  double widest = 0;
  for (int i = 0; i < c.flux.width; ++i) {
    if (c.flux.at(i, c.flux.height / 2) > 0) widest = std::max(widest, std::abs(-60 + (i + 0.5) * 0.25));
  }
  EXPECT_NEAR(widest, reach, 0.4);
  EXPECT_NEAR(total(c), 1, 1e-12);
  lamp.position_mm.z() = 5;
  EXPECT_THROW(trace_beams(start_mesh(lens, 5), lens, lamp, receiver_plane(lens, {}), Box2::centred({60, 60})), InputError);
}

TEST(TraceBeams, ASphericalLensBlursAPointToItsLongitudinalAberration) {
  // A convex sphere: paraxial focus at R / (n - 1). At that plane the spot of a ray at height h follows from Snell.
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  lens.size_mm = {20, 20};
  constexpr double kRadius = 49;
  const SurfaceMesh mesh = surface_of(lens, 201, [](double x, double y) { return 12 + std::sqrt(kRadius * kRadius - x * x - y * y) - kRadius; });
  Receiver receiver;
  receiver.distance_mm = kRadius / 0.49 + 2;  // from the sphere's top at z = 12
  const Caustic c = trace_beams(mesh, lens, {}, receiver_plane(lens, receiver), Box2::centred({6, 6}), {.pixels = 600});
  const double incidence = std::asin(10 / kRadius);
  const double deviation = std::asin(1.49 * std::sin(incidence)) - incidence;
  const double sag = kRadius - std::sqrt(kRadius * kRadius - 100);
  const double spot = std::abs(10 - (kRadius / 0.49 + sag) * std::tan(deviation));
  double widest = 0;
  for (int j = 0; j < 600; ++j) {
    for (int i = 0; i < 600; ++i) {
      if (c.flux.at(i, j) > 0) widest = std::max(widest, std::hypot(-3 + (i + 0.5) * 0.01, -3 + (j + 0.5) * 0.01));
    }
  }
  EXPECT_NEAR(widest, spot, 0.03 * spot + 0.02);
  EXPECT_NEAR(landed(c), 1, 1e-12);
}

TEST(TraceBeams, LightThatMeetsTheReliefAgainIsShadowed) {
  const Lens lens = small_lens();
  // A steep flank towards +x that sends its light to the right... into a wall that stands there.
  const auto flank_and_wall = [](double x, double) { return 12 + 0.9 * std::max(0.0, -std::abs(x + 3) + 3) + (x > 2.4 ? 20.0 : 0.0); };
  const SurfaceMesh mesh = surface_of(lens, 151, flank_and_wall);
  const Caustic c = trace_beams(mesh, lens, {}, receiver_plane(lens, {}), Box2::centred({400, 60}));
  EXPECT_GT(c.shadowed, 0.02);
  // The rising flank bends light to +x, where the wall stands: only what starts beside it is lost.
  EXPECT_GT(c.shadowed_from.min.x(), -6.5);
  EXPECT_LT(c.shadowed_from.max.x(), 3.5);
  EXPECT_NEAR(total(c), 1, 1e-12);
  EXPECT_EQ(trace_beams(mesh, lens, {}, receiver_plane(lens, {}), Box2::centred({400, 60}), {.shadows = false}).shadowed, 0);
}

TEST(TraceBeams, DoesNotDependOnTheThreadCountAndLosesNoLight) {
  SurfaceMesh mesh = start_mesh(small_lens(), 31);
  unsigned state = 7;
  for (Vec3& v : mesh.vertices) {
    state = state * 1664525u + 1013904223u;
    v.z() += (state >> 16) / 65536.0;
  }
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  Lamp lamp;
  lamp.direction = {0.1, -0.2, 1};
  lamp.angular_diameter_rad = 0.01;
  const auto trace = [&] {
    return trace_beams(mesh, small_lens(), lamp, receiver_plane(small_lens(), {}, {0.2, -0.3}, {5, 1}), Box2::centred({100, 70}),
                       {.pixels = 64, .lamp_samples = 9, .fresnel = true});
  };
  set_thread_count(1);
  const Caustic one = trace();
  set_thread_count(3);
  const Caustic three = trace();
  set_thread_count(0);
  EXPECT_EQ(one.flux.values, three.flux.values);
  EXPECT_EQ(one.shadowed, three.shadowed);
  EXPECT_GT(one.shadowed + one.through_rim, 0);
  EXPECT_GT(one.totally_reflected, 0);
  EXPECT_NEAR(total(one), 1, 1e-12);
}

}  // namespace
}  // namespace lightmill

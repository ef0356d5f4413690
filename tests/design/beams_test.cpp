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
  return landed(c) + c.outside_extent + c.totally_reflected + c.fresnel_reflected + c.shadowed + c.enters_by_rim;
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
  const Caustic b = trace_beams(mesh, lens, {}, {}, extent, {.pixels = 60});
  double most = 0;
  for (std::size_t i = 0; i < a.flux.values.size(); ++i) most = std::max(most, std::abs(a.flux.values[i] - b.flux.values[i]));
  EXPECT_LT(most, 1e-12);
  EXPECT_EQ(b.shadowed, 0);
}

TEST(TraceBeams, SlantedLightThroughAPlateIsShiftedAsSnellSays) {
  const Lens lens = small_lens();
  const double slant = 0.3;
  Light lamp;
  lamp.direction = {std::sin(slant), 0, std::cos(slant)};
  const Caustic c = trace_beams(start_mesh(lens, 31), lens, lamp, {}, Box2::centred({300, 60}), {.pixels = 600});
  // Parallel faces: out as it came in. Through the top at x = 0 on the mean of what enters the back.
  const double inside = std::asin(std::sin(slant) / 1.49);
  const double cut = 10 * std::tan(inside);  // this wide a strip of the top would get its light through the side
  EXPECT_NEAR(c.enters_by_rim, cut / 30, 0.5 / 30);
  EXPECT_NEAR(centroid(c).x(), cut / 2 + 300 * std::tan(slant), 0.3);
  // As wide a strip of the back sends its light into the other side.
  EXPECT_NEAR(c.leaves_by_rim, cut / 30, 0.5 / 30);
  EXPECT_NEAR(c.leaves_rim_from.max.x(), 15, 1e-9);
  EXPECT_NEAR(c.enters_rim_from.min.x(), -15, 1e-9);
  EXPECT_LT(c.enters_rim_from.max.x(), -15 + cut);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

TEST(TraceBeams, APrismSpreadsColoursAsSnellSaysPerWavelength) {
  const Lens lens = small_lens();
  const double tilt = std::atan(0.4);
  const SurfaceMesh mesh = surface_of(lens, 9, [](double x, double) { return 20 + 0.4 * x; });
  double before = 1e9;
  for (const double wavelength : {0.4642, 0.5491, 0.6114}) {
    const Lens coloured = lens_at(lens, wavelength);
    const Caustic c = trace_beams(mesh, coloured, {}, {}, Box2::centred({300, 40}), {.pixels = 600});
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
  const Caustic c = trace_beams(start_mesh(lens, 9), lens, {}, {}, Box2::centred({60, 60}), {.fresnel = true});
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
  const Caustic c = trace_beams(start_mesh(lens, 9), lens, {}, {.shift_mm = {3, -2}, .tilt_rad = {0, tilt}},
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
  for (const double tilt : {0.0, 0.8}) {
    const Caustic c = trace_beams(start_mesh(lens, 41), lens, {}, {.tilt_rad = {0, tilt}}, Box2::centred({20, 20}),
                                  {.pixels = 200, .angular_diameter_rad = 0.02, .lamp_samples = 100});
    // Variances add: square a^2 / 12 and disk R^2 / 4; a plate leaves directions as they are: R = 300 tan(0.01) from where
    // the light leaves it. Tilt stretches by 1 / cos.
    const double radius = 300 * std::tan(0.01);
    EXPECT_NEAR(variance_x(c), (4.0 / 12 + radius * radius / 4) / std::pow(std::cos(tilt), 2), 0.02 * radius * radius / std::pow(std::cos(tilt), 2)) << tilt;
    EXPECT_NEAR(total(c), 1, 1e-12);
  }
}

TEST(TraceBeams, APointLampThroughAPlateCastsTheEnlargedOutline) {
  Lens lens = small_lens();
  Light lamp;
  lamp.kind = Light::Kind::kPoint;
  lamp.position_mm = {0, 0, -200};
  const Caustic c = trace_beams(start_mesh(lens, 61), lens, lamp, {}, Box2::centred({120, 80}), {.pixels = 480});
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
  EXPECT_THROW(trace_beams(start_mesh(lens, 5), lens, lamp, {}, Box2::centred({60, 60})), InputError);
}

/// A light mesh on z = -5 whose rays all come from a place behind it, with the flux that the place sends there.
Light mesh_of_point(const Vec3& from, int side) {
  Light light;
  light.kind = Light::Kind::kMesh;
  Lens plane;
  plane.size_mm = {50, 40};
  const SurfaceMesh grid = start_mesh(plane, side);
  light.mesh.triangles = grid.triangles;
  for (const Vec3& v : grid.vertices) {
    const Vec3 p(v.x(), v.y(), -5);
    light.mesh.positions_mm.push_back(p);
    light.mesh.directions.push_back((p - from).normalized());
    light.mesh.intensities.push_back((p - from).normalized().z() / (p - from).squaredNorm());
  }
  return light;
}

double mean_difference(const Caustic& a, const Caustic& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.flux.values.size(); ++i) sum += std::abs(a.flux.values[i] - b.flux.values[i]);
  return sum;
}

TEST(TraceBeams, AMeshLightWithAPointsRaysIsThatPoint) {
  const Lens lens = small_lens();
  const SurfaceMesh mesh = surface_of(lens, 61, [](double x, double y) { return 12 - x * x / 300 - y * y / 500 + x * y / 900; });
  Light point;
  point.kind = Light::Kind::kPoint;
  point.position_mm = {20, -10, -90};
  const Receiver receiver{.distance_mm = 60, .shift_mm = {-4, 3}, .tilt_rad = {0.3, -0.2}};
  const Box2 extent = Box2::centred({50, 40});
  const BeamOptions options{.pixels = 40, .angular_diameter_rad = 0.02, .lamp_samples = 4};
  const Caustic a = trace_beams(mesh, lens, point, receiver, extent, options);
  const Caustic b = trace_beams(mesh, lens, mesh_of_point(point.position_mm, 81), receiver, extent, {.pixels = 40});
  const Caustic sharp = trace_beams(mesh, lens, point, receiver, extent, {.pixels = 40});
  EXPECT_LT(mean_difference(sharp, b), 2e-3);
  EXPECT_GT(mean_difference(a, b), 1e-2);  // a wide lamp blurs
  EXPECT_NEAR(total(a), 1, 1e-12);
  EXPECT_NEAR(b.enters_by_rim, sharp.enters_by_rim, 1e-3);
  EXPECT_GT(sharp.enters_by_rim, 0.005);
}

TEST(TraceBeams, CarriesTheProfileOfTheLight) {
  // A plate: the picture is the light itself, a Gaussian, cut by the lens; the mean is Gauss's on a finite interval.
  const Lens lens = small_lens();
  Light light;
  light.profile.kind = Profile::Kind::kGaussian;
  light.profile.sigma_mm = 4;
  light.profile.centre_mm = {10, 0};
  const Caustic c = trace_beams(start_mesh(lens, 121), lens, light, {}, Box2::centred(lens.size_mm), {.pixels = 300});
  const double a = -25 / 4.0, b = 5 / 4.0;  // the lens's borders in sigmas from the light's centre
  const auto density = [](double t) { return std::exp(-t * t / 2) / std::sqrt(2 * kPi); };
  const double share = (std::erf(b / std::sqrt(2)) - std::erf(a / std::sqrt(2))) / 2;
  EXPECT_NEAR(centroid(c).x(), 10 - 4 * (density(b) - density(a)) / share, 2e-3);
  EXPECT_NEAR(total(c), 1, 1e-12);
}

TEST(TraceBeams, HeightsOnAGridCastTheSameUnderAnyLight) {
  const Lens lens = small_lens();
  const auto height = [](double x, double y) { return 12 - x * x / 300 - y * y / 500 + x * y / 900; };
  const SurfaceMesh mesh = surface_of(lens, 241, height);
  const Box2 box = Box2::centred(lens.size_mm);
  Grid<float> heights(481, 321);
  for (int j = 0; j < 321; ++j) {
    for (int i = 0; i < 481; ++i) heights.at(i, j) = static_cast<float>(height(-15 + i / 16.0, -10 + j / 16.0));
  }
  Light slanted;
  slanted.direction = {0.2, -0.1, 1};
  slanted.profile.kind = Profile::Kind::kGaussian;
  slanted.profile.sigma_mm = 9;
  Light point;
  point.kind = Light::Kind::kPoint;
  point.position_mm = {8, 5, -120};
  const Receiver receiver{.distance_mm = 70, .shift_mm = {9, -3}, .tilt_rad = {0.2, 0.3}};
  for (const Light& light : {slanted, point, mesh_of_point({0, 0, -300}, 41)}) {
    const Caustic a = trace_beams(mesh, lens, light, receiver, Box2::centred({60, 50}), {.pixels = 50});
    const Caustic b = trace_heights(heights, box, lens, light, receiver, Box2::centred({60, 50}), {.pixels = 50});
    EXPECT_LT(mean_difference(a, b), 0.01) << static_cast<int>(light.kind);
    EXPECT_NEAR(a.enters_by_rim, b.enters_by_rim, 2e-3);
    EXPECT_NEAR(total(b), 1, 1e-12);
  }
}

TEST(TraceBeams, LightThatMissesAPartOfTheLensIsNotMissed) {
  const Lens lens = small_lens();
  Light beam = mesh_of_point({0, 0, -1e6}, 11);
  for (Vec3& p : beam.mesh.positions_mm) p.x() = 0.4 * p.x() + 12;  // from 2 mm on
  const Caustic c = trace_beams(start_mesh(lens, 61), lens, beam, {}, Box2::centred(lens.size_mm), {.pixels = 30});
  EXPECT_NEAR(total(c), 1, 1e-12);
  EXPECT_EQ(c.flux.at(10, 10), 0);
  EXPECT_NEAR(c.flux.at(25, 10), 1.0 / (13 * 20), 0.03 / (13 * 20));  // the light's edge is resolved to one of the mesh
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
  const Caustic c = trace_beams(mesh, lens, {}, receiver, Box2::centred({6, 6}), {.pixels = 600});
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
  const Caustic c = trace_beams(mesh, lens, {}, {}, Box2::centred({400, 60}));
  EXPECT_GT(c.shadowed, 0.02);
  // The rising flank bends light to +x, where the wall stands: only what starts beside it is lost.
  EXPECT_GT(c.shadowed_from.min.x(), -6.5);
  EXPECT_LT(c.shadowed_from.max.x(), 3.5);
  EXPECT_NEAR(total(c), 1, 1e-12);
  EXPECT_EQ(trace_beams(mesh, lens, {}, {}, Box2::centred({400, 60}), {.shadows = false}).shadowed, 0);
}

TEST(TraceBeams, DoesNotDependOnTheThreadCountAndLosesNoLight) {
  SurfaceMesh mesh = start_mesh(small_lens(), 31);
  unsigned state = 7;
  for (Vec3& v : mesh.vertices) {
    state = state * 1664525u + 1013904223u;
    v.z() += (state >> 16) / 65536.0;
  }
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  Light lamp;
  lamp.direction = {0.1, -0.2, 1};
  const auto trace = [&] {
    return trace_beams(mesh, small_lens(), lamp, {.shift_mm = {5, 1}, .tilt_rad = {0.2, -0.3}}, Box2::centred({100, 70}),
                       {.pixels = 64, .angular_diameter_rad = 0.01, .lamp_samples = 9, .fresnel = true});
  };
  set_thread_count(1);
  const Caustic one = trace();
  set_thread_count(3);
  const Caustic three = trace();
  set_thread_count(0);
  EXPECT_EQ(one.flux.values, three.flux.values);
  EXPECT_EQ(one.shadowed, three.shadowed);
  EXPECT_GT(one.shadowed + one.enters_by_rim, 0);
  EXPECT_GT(one.totally_reflected, 0);
  EXPECT_NEAR(total(one), 1, 1e-12);
}

}  // namespace
}  // namespace lightmill

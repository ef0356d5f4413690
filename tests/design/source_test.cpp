#include "design/source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/mesh_sampling.h"
#include "design/transport.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;

Lens small_lens() {
  Lens lens;
  lens.size_mm = {60, 40};
  lens.thickness_mm = 8;
  return lens;
}

Light gaussian(double sigma, const Vec2& centre = {0, 0}) {
  Light light;
  light.profile.kind = Profile::Kind::kGaussian;
  light.profile.sigma_mm = sigma;
  light.profile.centre_mm = centre;
  return light;
}

std::vector<Vec2> ring(double radius, int corners, const Vec2& centre = {0, 0}) {
  std::vector<Vec2> loop;
  for (int k = 0; k < corners; ++k)
    loop.emplace_back(centre + radius * Vec2(std::cos(2 * kPi * k / corners), std::sin(2 * kPi * k / corners)));
  return loop;
}

Lens annulus(double outer, double inner) {
  Lens lens;
  lens.shape = Lens::Shape::kOutline;
  lens.size_mm = {2 * outer, 2 * outer};
  lens.outline_mm = {ring(outer, 200), ring(inner, 120)};
  return lens;
}

TEST(Source, AnEvenlyLitRectangleOrDiskStaysOne) {
  Lens lens = small_lens();
  EXPECT_EQ(trace_source(lens, {}, {}).source.shape, SourceLight::Shape::kRectangle);
  EXPECT_EQ(trace_source(lens, {}, {}).source.size_mm, lens.size_mm);
  lens.size_mm = {50, 50};
  lens.shape = Lens::Shape::kDisk;
  EXPECT_EQ(trace_source(lens, {}, {}).source.shape, SourceLight::Shape::kDisk);
}

TEST(Source, ObliqueLightThroughAFlatPlateLandsShifted) {
  const Lens lens = small_lens();
  Light light;
  light.direction = Vec3(0.2, -0.1, 1).normalized();
  Receiver receiver;
  receiver.distance_mm = 130;
  receiver.shift_mm = {3, 7};
  const TracedSource traced = trace_source(lens, light, receiver, 30);
  // A plate does not turn light: it leaves along its direction in air.
  const Vec2 shift = 130 * Vec2(0.2, -0.1) - receiver.shift_mm;
  const SourceMesh& mesh = traced.source.mesh;
  ASSERT_EQ(traced.source.shape, SourceLight::Shape::kMesh);
  EXPECT_NEAR(mesh.flux(), 1, 1e-12);
  for (std::size_t v = 0; v < mesh.vertices_mm.size(); ++v) {
    EXPECT_LT((mesh.vertices_mm[v] - mesh.lens_mm[v] - shift).norm(), 1e-10);
    EXPECT_NEAR(mesh.irradiance_per_mm2[v], 1 / (60.0 * 40), 1e-15);
  }
  EXPECT_GT(traced.report.beside_back.share, 0) << "at one border the light would come through the side";
}

TEST(Source, PointLightThroughAPlateObeysSnellAndTheSolidAngleLaw) {
  const Lens lens = small_lens();
  Light light;
  light.kind = Light::Kind::kPoint;
  light.position_mm = {5, -3, -40};
  const Illumination illumination(light, lens);
  const double n = lens.refractive_index;
  for (const double sine : {0.0, 0.01, 0.3, 0.7, 0.95}) {
    // Forward from the light, at an angle of its own.
    const Vec2 along(0.6, -0.8);
    const double inside = sine / n;
    const double radius = 40 * sine / std::sqrt(1 - sine * sine) + 8 * inside / std::sqrt(1 - inside * inside);
    const Vec2 place = light.position_mm.head<2>() + radius * along;
    const IncomingRay ray = illumination.at({place.x(), place.y(), 8});
    EXPECT_LT((ray.direction - Vec3(along.x() * inside, along.y() * inside, std::sqrt(1 - inside * inside))).norm(),
              1e-13);
    EXPECT_LT((ray.entry_mm - (light.position_mm.head<2>() + 40 * sine / std::sqrt(1 - sine * sine) * along)).norm(),
              1e-11 * (1 + radius));
  }
  // Flux within a radius is the solid angle of the cone that reaches it: 2 pi (1 - cos).
  const double sine = 0.8, inside = sine / n;
  const double radius = 40 * sine / 0.6 + 8 * inside / std::sqrt(1 - inside * inside);
  double flux = 0;
  constexpr int kRings = 4000;
  for (int k = 0; k < kRings; ++k) {
    const double r = radius * (k + 0.5) / kRings;
    flux += 2 * kPi * r * radius / kRings * illumination.at({5 + r, -3, 8}).irradiance;
  }
  EXPECT_NEAR(flux, 2 * kPi * (1 - 0.6), 1e-6);
}

TEST(Source, AMeshOfAPointsRaysIsThePoint) {
  const Lens lens = small_lens();
  Light point;
  point.kind = Light::Kind::kPoint;
  point.position_mm = {4, 2, -150};
  Light mesh;
  mesh.kind = Light::Kind::kMesh;
  constexpr int kSide = 41;
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const Vec3 p(-40 + 2.0 * i, -30 + 1.5 * j, -20);
      const Vec3 d = p - point.position_mm;
      mesh.mesh.positions_mm.push_back(p);
      mesh.mesh.directions.push_back(d);
      mesh.mesh.intensities.push_back(d.z() / std::pow(d.norm(), 3));
      if (i == 0 || j == 0) continue;
      const int v = j * kSide + i;
      mesh.mesh.triangles.push_back({v - kSide - 1, v - kSide, v});
      mesh.mesh.triangles.push_back({v - kSide - 1, v, v - 1});
    }
  }
  const Illumination one(point, lens), other(mesh, lens);
  for (const Vec3& p : {Vec3(0, 0, 8), Vec3(20, -13, 9.5), Vec3(-25, 15, 11)}) {
    const IncomingRay a = one.at(p), b = other.at(p);
    EXPECT_LT((a.direction - b.direction).norm(), 2e-5);
    EXPECT_NEAR(b.irradiance / a.irradiance, 1, 3e-3);
  }
  Light away = mesh;
  away.mesh.directions[7] = -Vec3::UnitZ();
  EXPECT_THROW((void)Illumination(away, lens), InputError);
}

/// A beam of 40 x 30 mm at z = -20 whose rays spread about the axis, with an intensity of its own at each vertex.
Light spreading_beam() {
  Light light;
  light.kind = Light::Kind::kMesh;
  constexpr int kColumns = 11, kRows = 8;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      const Vec2 p(-20 + 40.0 * i / (kColumns - 1), -15 + 30.0 * j / (kRows - 1));
      light.mesh.positions_mm.emplace_back(p.x(), p.y(), -20);
      light.mesh.directions.emplace_back(p.x() / 300, p.y() / 200, 1);
      light.mesh.intensities.push_back(2 + 0.03 * p.x() - 0.01 * p.y());
      if (i == 0 || j == 0) continue;
      const int v = j * kColumns + i;
      light.mesh.triangles.push_back({v - kColumns - 1, v - kColumns, v});
      light.mesh.triangles.push_back({v - kColumns - 1, v, v - 1});
    }
  }
  return light;
}

/// Flux through the plane z by the midpoint rule.
double flux_through(const Illumination& illumination, double z, double reach, int side) {
  double flux = 0;
  const double pitch = 2 * reach / side;
  for (int k = 0; k < side * side; ++k) {
    const Vec2 p(-reach + pitch * (k % side + 0.5), -reach + pitch * (k / side + 0.5));
    flux += illumination.at({p.x(), p.y(), z}).irradiance * pitch * pitch;
  }
  return flux;
}

TEST(Source, WhatALightSendsPassesEveryPlaneOfTheLens) {
  const Lens lens = small_lens();
  // Linear intensities over 40 x 30 mm, in flux per mm^2 of the mesh.
  const Illumination beam(spreading_beam(), lens);
  for (const double z : {0.5, 8.0, 12.0}) EXPECT_NEAR(flux_through(beam, z, 30, 150), 40 * 30 * 2, 36) << z;
  // A gaussian of peak 1, upright and slanted: 2 pi sigma^2 through any plane.
  Light light = gaussian(4, {3, -2});
  for (const Vec3& direction : {Vec3(0, 0, 1), Vec3(0.4, -0.2, 1)}) {
    light.direction = direction;
    EXPECT_NEAR(flux_through(Illumination(light, lens), 9, 40, 160), 2 * kPi * 16, 1e-6);
  }
}

TEST(Source, AnImageProfileIsItsPixelsInPlace) {
  const Lens lens = small_lens();  // 60 x 40 mm
  Light light;
  light.profile.kind = Profile::Kind::kImage;
  light.profile.image = Grid<float>(3, 2);
  light.profile.image.values = {1, 2, 4, 8, 16, 32};  // row 0 at the smallest y
  const auto at = [&](double x, double y) { return Illumination(light, lens).at({x, y, 8}).irradiance; };
  for (int row = 0; row < 2; ++row) {
    for (int column = 0; column < 3; ++column)
      EXPECT_NEAR(at(-20 + 20 * column, -10 + 20 * row), light.profile.image.at(column, row), 1e-12);
  }
  EXPECT_NEAR(at(-10, -10), 1.5, 1e-12);
  EXPECT_NEAR(at(-5, 5), 0.25 * (0.25 * 1 + 0.75 * 2) + 0.75 * (0.25 * 8 + 0.75 * 16), 1e-12);
  EXPECT_NEAR(at(29.9, 19.9), 32, 1e-12) << "even beyond the outermost centres";
  EXPECT_EQ(at(30.1, 0), 0) << "no light beside the picture";
  // Slanted light brings the picture's values along.
  light.direction = {0.3, 0, 1};
  const double inside = 0.3 / std::hypot(0.3, 1) / lens.refractive_index;
  EXPECT_NEAR(at(-20 + 8 * inside / std::sqrt(1 - inside * inside), -10), 1, 1e-9);
  // On the receiver: flux is the pixels' mean, and the brightest corner stays where it is.
  light.direction = {0, 0, 1};
  const SourceMesh mesh = trace_source(lens, light, {}, 60).source.mesh;
  EXPECT_NEAR(mesh.flux(), 1, 1e-12);
  const auto brightest = std::max_element(mesh.irradiance_per_mm2.begin(), mesh.irradiance_per_mm2.end());
  const Vec2 corner = mesh.vertices_mm[brightest - mesh.irradiance_per_mm2.begin()];
  EXPECT_GT(corner.x(), 19.9);
  EXPECT_GT(corner.y(), 9.9);
}

TEST(Source, ABeamThatCoversAPartOfTheLensDoesNotFold) {
  Lens lens = small_lens();
  Light light = spreading_beam();
  for (Vec3& d : light.mesh.directions) d = {1.5 * d.x(), -1.5 * d.y(), d.z()};
  const TracedSource traced = trace_source(lens, light, {}, 60);
  EXPECT_EQ(traced.report.folded.share, 0);
  EXPECT_GT(traced.report.unlit_share, 0.3);
  // It is 45 mm wide and 24 mm high on the lens, and ends a cell farther out at most.
  for (std::size_t v = 0; v < traced.source.mesh.vertices_mm.size(); ++v) {
    const Vec2& p = traced.source.mesh.lens_mm[v];
    EXPECT_LT(std::abs(p.x()), 22.6 + 1) << p.transpose();
    EXPECT_LT(std::abs(p.y()), 12.2 + 1) << p.transpose();
  }
}

TEST(Source, ThePictureShowsEachPixelOnce) {
  // Pixels' centres lie on the triangles' edges.
  Light light;
  light.direction = {0.2, -0.1, 1};
  const Lens lens = small_lens();
  const SourceLight source = trace_source(lens, light, {}, 30).source;
  Box2 box;
  for (const Vec2& p : source.mesh.vertices_mm) box.include(p);
  for (const int pixels : {30, 45, 60}) {
    const Grid<float> picture = rasterise_source(source, box, pixels, pixels * 2 / 3);
    for (const float e : picture.values) EXPECT_NEAR(e, 1 / 2400.0, 1e-9) << pixels;
  }
}

TEST(Source, ASphericalBaseFocusesWhereALensMakerSays) {
  Lens lens = small_lens();
  lens.size_mm = {4, 4};
  lens.base.kind = Base::Kind::kSphere;
  lens.base.radius_mm = 100;
  // Plano-convex, light along the axis: f = R / (n - 1); at half of it the beam is half as wide.
  Receiver receiver;
  receiver.distance_mm = 100 / (lens.refractive_index - 1) / 2;
  const TracedSource traced = trace_source(lens, {}, receiver, 20);
  const SourceMesh& mesh = traced.source.mesh;
  EXPECT_NEAR(mesh.flux(), 1, 1e-12);
  for (std::size_t v = 0; v < mesh.vertices_mm.size(); ++v)
    EXPECT_LT((mesh.vertices_mm[v] - mesh.lens_mm[v] / 2).norm(), 1e-3 * mesh.lens_mm[v].norm() + 1e-12);
  EXPECT_EQ(traced.report.folded.share, 0);
  // A cylinder past its line focus mirrors the light in one direction: no fold.
  lens.base.kind = Base::Kind::kCylinder;
  receiver.distance_mm *= 3;
  const TracedSource mirrored = trace_source(lens, {}, receiver, 20);
  EXPECT_EQ(mirrored.report.folded.share, 0);
  EXPECT_NEAR(mirrored.source.mesh.flux(), 1, 1e-12);
  EXPECT_LT((mirrored.source.mesh.vertices_mm[0] - mirrored.source.mesh.lens_mm[0].cwiseProduct(Vec2(1, -0.5))).norm(),
            3e-3);
}

TEST(Source, TotalReflectionFoldsAndLostLightAreNamedWithTheirPlace) {
  Lens lens;
  lens.size_mm = {60, 60};
  lens.base.kind = Base::Kind::kSphere;
  lens.base.radius_mm = 50;
  // sin at the surface is r / R: total reflection beyond r = R / n = 33.6 mm, in the corners only.
  TracedSource traced = trace_source(lens, {}, {}, 60);
  EXPECT_GT(traced.report.totally_reflected.share, 0.001);
  const double r = 50 / lens.refractive_index;
  const double angle = std::acos(30 / r);
  const double inside = kPi * r * r - 4 * r * r * (angle - std::sin(angle) * std::cos(angle));
  EXPECT_NEAR(traced.report.totally_reflected.share, 1 - inside / 3600, 0.02) << "whole triangles are dropped";
  EXPECT_GT(traced.report.totally_reflected.lens_mm.norm(), 50 / lens.refractive_index);
  EXPECT_THAT(traced.report.words().at(0), HasSubstr("x = "));
  EXPECT_NEAR(traced.source.mesh.flux(), 1, 1e-12);
  // Spherical aberration: between the focus of the rim and that of the axis the light folds over itself.
  lens.size_mm = {40, 40};
  Receiver receiver;
  receiver.distance_mm = 90;
  traced = trace_source(lens, {}, receiver, 60);
  EXPECT_GT(traced.report.folded.share, 0.05);
  EXPECT_THAT(traced.report.words().at(0), HasSubstr("folds"));
  // A receiver turned so far that its plane cuts the oblique light's way.
  Light light;
  light.direction = {1, 0, 1};
  receiver.tilt_rad = {0, -60 * kPi / 180};
  EXPECT_THROW((void)trace_source(small_lens(), light, receiver, 20), InputError);
}

TEST(Source, ATiltedReceiverReceivesTheSameFluxOverALargerArea) {
  Receiver receiver;
  receiver.tilt_rad = {0, kPi / 3};
  const TracedSource traced = trace_source(small_lens(), {}, receiver, 20);
  EXPECT_NEAR(traced.source.size_mm.x(), 120, 1e-9);
  EXPECT_NEAR(traced.source.size_mm.y(), 40, 1e-9);
  EXPECT_NEAR(traced.source.mesh.irradiance_per_mm2[5], 1 / (120.0 * 40), 1e-14);
}

TEST(Source, AHeightImageAndAMeshAreBases) {
  // The same tilted plane thrice: image, mesh, and a prism's closed form.
  Lens lens = small_lens();
  lens.base.kind = Base::Kind::kImage;
  lens.base.extent = Box2::centred(lens.size_mm);
  lens.base.heights_mm = Grid<float>(6, 4);
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 6; ++i) lens.base.heights_mm.at(i, j) = static_cast<float>(1.25 * (i + 0.5));  // slope 1/8
  }
  const TracedSource image = trace_source(lens, {}, {}, 12);
  lens.base.kind = Base::Kind::kMesh;
  const Vec3 normal = Vec3(-0.125, 0, 1).normalized();
  lens.base.mesh.vertices = {{-40, -30, 0}, {40, -30, 10}, {40, 30, 10}, {-40, 30, 0}};
  lens.base.mesh.normals.assign(4, normal);
  lens.base.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  const TracedSource mesh = trace_source(lens, {}, {}, 12);
  Vec3 out;
  ASSERT_TRUE(refract(Vec3::UnitZ(), normal, {lens.refractive_index, 1}, out));
  for (std::size_t v = 0; v < image.source.mesh.vertices_mm.size(); ++v) {
    const Vec2 from = mesh.source.mesh.lens_mm[v];
    const double height = (from.x() + 30) / 8;
    const Vec2 expected = from + (300 - height) / out.z() * out.head<2>();
    EXPECT_LT((mesh.source.mesh.vertices_mm[v] - expected).norm(), 1e-9);
    EXPECT_LT((image.source.mesh.vertices_mm[v] - expected).norm(), 1e-4);
  }
  lens.base.mesh.vertices[1].x() = lens.base.mesh.vertices[2].x() = 10;
  EXPECT_THROW((void)trace_source(lens, {}, {}, 12), InputError);
}

void expect_good_sampling(const SourceLight& source, const std::vector<detail::Sampling>& levels, double spread) {
  for (const auto& s : levels) {
    double sum = 0;
    Vec2 mean(0, 0);
    for (std::size_t i = 0; i < s.sites.size(); ++i) {
      ASSERT_GT(s.masses[i], 0);
      sum += s.masses[i];
      mean += s.masses[i] * s.centroids[i];
    }
    EXPECT_NEAR(sum, 1, 1e-12);
    // Sums over cells are integrals over the mesh: nothing is lost between triangle and cell.
    EXPECT_LT(mean.norm(), 1e-9 * source.size_mm.norm());
    EXPECT_LT(s.flux_spread, spread);
    EXPECT_LT(s.way, 0.01) << "mean way to the centroid, in cell sizes";
  }
}

TEST(SourceSampling, GaussianSamplesCarryTheSameFluxPerSeedAndThreadCount) {
  const SourceLight source = trace_source(small_lens(), gaussian(12, {8, -5}), {}, 40).source;
  const auto levels = detail::sample_mesh(source.mesh, 4096, 7, {});
  ASSERT_EQ(levels.front().sites.size(), 4096U);
  expect_good_sampling(source, levels, 0.005);
  const int threads = thread_count();
  set_thread_count(3);
  const auto again = detail::sample_mesh(source.mesh, 4096, 7, {});
  set_thread_count(1);
  const auto alone = detail::sample_mesh(source.mesh, 4096, 7, {});
  set_thread_count(threads);
  EXPECT_EQ(levels.front().sites, again.front().sites);
  EXPECT_EQ(levels.front().masses, alone.front().masses);
  EXPECT_NE(levels.front().sites, detail::sample_mesh(source.mesh, 4096, 8, {}).front().sites);
}

TEST(SourceSampling, HolesStayEmptyAndPartsAreJoined) {
  Lens lens = annulus(30, 15);
  lens.outline_mm.push_back(ring(10, 60));  // an island
  const SourceLight source = trace_source(lens, {}, {}, 40).source;
  const auto levels = detail::sample_mesh(source.mesh, 2048, 1, {});
  expect_good_sampling(source, levels, 0.012);  // a part's flux is no whole number of samples
  for (const Vec2& relative : levels.front().sites) {
    const double r = (relative + levels.front().centre).norm();
    EXPECT_TRUE(r < 10 || (r > 15 * std::cos(kPi / 120) && r < 30)) << r;
  }
  // The same for a seed, whatever the number of threads.
  const int threads = thread_count();
  set_thread_count(threads + 1);
  EXPECT_EQ(levels.front().sites, detail::sample_mesh(source.mesh, 2048, 1, {}).front().sites);
  set_thread_count(1);
  EXPECT_EQ(levels.front().masses, detail::sample_mesh(source.mesh, 2048, 1, {}).front().masses);
  set_thread_count(threads);
  EXPECT_NE(levels.front().sites, detail::sample_mesh(source.mesh, 2048, 2, {}).front().sites);
}

TEST(Source, AnOutlineSaysWhatOfItsDrawingWasLeftOut) {
  const auto file = std::filesystem::temp_directory_path() / ("outline_" + std::to_string(getpid()) + ".svg");
  std::ofstream(file) << "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 4 2'>\n"
                         "<text x='1' y='1'>lens</text>\n<path d='M0 0H4V2H0Z'/>\n</svg>\n";
  const LensOutline outline = read_outline(file.string(), {40, 20});
  std::filesystem::remove(file);
  ASSERT_EQ(outline.loops_mm.size(), 1U);
  const std::vector<Vec2>& loop = outline.loops_mm[0];  // its first corner may stand at its end again
  double doubled_area = 0;
  for (std::size_t k = 0; k < loop.size(); ++k) {
    const Vec2 &a = loop[k], &b = loop[(k + 1) % loop.size()];
    doubled_area += a.x() * b.y() - a.y() * b.x();
  }
  EXPECT_NEAR(std::abs(doubled_area) / 2, 40 * 20, 1e-9);
  ASSERT_EQ(outline.warnings.size(), 1U);
  EXPECT_THAT(outline.warnings[0], HasSubstr("2"));
  EXPECT_THAT(outline.warnings[0], HasSubstr("text"));
}

TEST(SourceSampling, PartsFarApartGetTheirSharesOfTheSamples) {
  Lens lens;
  lens.shape = Lens::Shape::kOutline;
  lens.size_mm = {100, 60};
  lens.outline_mm = {ring(25, 100, {-25, 0}), ring(6, 40, {40, 20}), ring(9, 60, {30, -15})};
  const SourceLight source = trace_source(lens, {}, {}, 60).source;
  for (const int seed : {1, 2, 3}) {
    const auto levels = detail::sample_mesh(source.mesh, 2000, seed, {});
    expect_good_sampling(source, levels, 0.012);
  }
}

RC_GTEST_PROP(SourceSampling, RandomOutlinesAreSampledWithoutLoss, ()) {
  const int corners = *rc::gen::inRange(3, 24);
  Lens lens;
  lens.shape = Lens::Shape::kOutline;
  lens.outline_mm.resize(1);
  for (int k = 0; k < corners; ++k) {
    const double radius = *rc::gen::inRange(10, 50);
    lens.outline_mm[0].emplace_back(radius * Vec2(std::cos(2 * kPi * k / corners), std::sin(2 * kPi * k / corners)));
  }
  double area = 0;
  for (int k = 0; k < corners; ++k) {
    const Vec2 &a = lens.outline_mm[0][k], &b = lens.outline_mm[0][(k + 1) % corners];
    area += (a.x() * b.y() - a.y() * b.x()) / 2;
  }
  const SourceLight source = trace_source(lens, {}, {}, 20).source;
  RC_ASSERT(std::abs(source.mesh.flux() - 1) < 1e-9);
  RC_ASSERT(std::abs(source.mesh.irradiance_per_mm2[0] * area - 1) < 1e-9);
  const auto levels = detail::sample_mesh(source.mesh, 300, 1, {});
  double sum = 0;
  Vec2 mean(0, 0);
  for (std::size_t i = 0; i < levels[0].sites.size(); ++i) {
    sum += levels[0].masses[i];
    mean += levels[0].masses[i] * levels[0].centroids[i];
  }
  RC_ASSERT(std::abs(sum - 1) < 1e-9);
  RC_ASSERT(mean.norm() < 1e-9);
}

TargetLight even_target(const Vec2& size) {
  TargetLight target;
  target.extent = Box2::centred(size);
  target.area_flux = Grid<double>(64, 64, 1.0);
  target.normalise();
  return target;
}

TEST(SourceTransport, AGaussianBecomesASquareByTwoErrorFunctions) {
  Lens lens;
  lens.size_mm = {50, 50};
  const SourceLight source = trace_source(lens, gaussian(15), {}, 100).source;
  TransportOptions options;
  options.samples = 4096;
  const TransportMap map = solve_transport(source, even_target({40, 40}), options);
  EXPECT_TRUE(map.summary.converged);
  EXPECT_EQ(map.summary.empty_cells, 0);
  EXPECT_LE(map.summary.l1_mass_error, 1e-4);
  EXPECT_LE(map.summary.max_mass_error, 1e-2);
  double squares = 0;
  const double edge = std::erf(25 / (15 * std::sqrt(2.0)));
  for (std::size_t i = 0; i < map.sites_mm.size(); ++i) {
    const Vec2 c = map.source_centroids_mm[i];
    const Vec2 expected(20 * std::erf(c.x() / (15 * std::sqrt(2.0))) / edge,
                        20 * std::erf(c.y() / (15 * std::sqrt(2.0))) / edge);
    squares += (map.target_centroids_mm[i] - expected).squaredNorm() / static_cast<double>(map.sites_mm.size());
  }
  EXPECT_LT(std::sqrt(squares), 40.0 / 64 / 4) << "a quarter of a cell";
}

TEST(SourceTransport, AnAnnulusAndShiftedLightReachASquare) {
  for (const Vec2& shift : {Vec2(0, 0), Vec2(12, -40)}) {
    Receiver receiver;
    receiver.shift_mm = shift;
    const SourceLight source = trace_source(annulus(30, 15), {}, receiver, 50).source;
    TransportOptions options;
    options.samples = 2048;
    const TransportMap map = solve_transport(source, even_target({40, 30}), options);
    EXPECT_LE(map.summary.l1_mass_error, 1e-4);
    EXPECT_LE(map.summary.max_mass_error, 1e-2);
    EXPECT_EQ(map.summary.empty_cells, 0);
    for (const Vec2& site : map.sites_mm) EXPECT_GT((site + shift).norm(), 14.9);
    // The square's quarters get the light of the ring's quarters, whatever the shift.
    Vec2 mean(0, 0);
    for (std::size_t i = 0; i < map.sites_mm.size(); ++i) mean += map.target_masses[i] * map.target_centroids_mm[i];
    EXPECT_LT(mean.norm(), 1e-3);
  }
}

}  // namespace
}  // namespace lightmill

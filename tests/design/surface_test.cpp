#include "design/surface.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "design/caustic.h"
#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/compound_energy.h"
#include "design/detail/height_settling.h"
#include "design/detail/one_ring.h"

namespace lightmill {
namespace {

double any_in(double low, double high) {
  return low + (high - low) * (*rc::gen::inRange(0, 1000001)) * 1e-6;
}

double planar_area(const SurfaceMesh& mesh) {
  double area = 0;
  for (const auto& t : mesh.triangles) {
    const Vec3 ab = mesh.vertices[t[1]] - mesh.vertices[t[0]];
    const Vec3 ac = mesh.vertices[t[2]] - mesh.vertices[t[0]];
    area += (ab.x() * ac.y() - ab.y() * ac.x()) / 2;
  }
  return area;
}

double least_angle(const SurfaceMesh& mesh) {
  double least = kPi;
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      const Vec3 u = mesh.vertices[t[(k + 1) % 3]] - mesh.vertices[t[k]];
      const Vec3 w = mesh.vertices[t[(k + 2) % 3]] - mesh.vertices[t[k]];
      least = std::min(least, std::atan2(u.cross(w).norm(), u.dot(w)));
    }
  }
  return least;
}

TEST(StartMesh, ARectangleIsFilledWithSquareCells) {
  Lens lens;
  lens.size_mm = {60, 40};
  const SurfaceMesh mesh = start_mesh(lens, 31);
  EXPECT_EQ(mesh.vertices.size(), 31u * 21u);
  EXPECT_NEAR(planar_area(mesh), 2400, 1e-9);
  EXPECT_EQ(count_inverted(mesh), 0);
  EXPECT_NEAR(least_angle(mesh), kPi / 4, 1e-12);
  for (const Vec3& v : mesh.vertices) EXPECT_EQ(v.z(), lens.thickness_mm);
}

TEST(StartMesh, ADiskHasARoundBorderAndNoSlivers) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  lens.size_mm = {50, 50};
  const SurfaceMesh mesh = start_mesh(lens, 41);
  EXPECT_EQ(mesh.vertices.size(), 1u + 3 * 20 * 21);
  EXPECT_EQ(count_inverted(mesh), 0);
  EXPECT_GT(least_angle(mesh), 30 * kPi / 180);
  EXPECT_NEAR(planar_area(mesh), 120 * 0.5 * 25 * 25 * std::sin(2 * kPi / 120), 1e-9);  // the regular 120-gon
  const std::vector<bool> border = border_vertices(mesh);
  EXPECT_EQ(std::count(border.begin(), border.end(), true), 120);
  for (std::size_t v = 0; v < border.size(); ++v) {
    if (border[v]) {
      EXPECT_NEAR(mesh.vertices[v].head<2>().norm(), 25, 1e-12);
    }
  }
  EXPECT_THROW(start_mesh(lens, 2), InputError);
}

TEST(StartMesh, AnOutlineIsFollowedByARegularMesh) {
  // A rounded triangle with a square hole, and a small part of its own.
  Lens lens;
  lens.shape = Lens::Shape::kOutline;
  lens.size_mm = {80, 60};
  std::vector<Vec2> rim, part;
  for (int k = 0; k < 3000; ++k) {
    const double angle = 2 * kPi * k / 3000;
    rim.emplace_back((25 + 4 * std::cos(3 * angle)) * Vec2(std::cos(angle), std::sin(angle)) - Vec2(10, 0));
    part.emplace_back(Vec2(32, 10) + 6 * Vec2(std::cos(angle), std::sin(angle)));
  }
  const std::vector<Vec2> hole{{-15, -5}, {-5, -5}, {-5, 5}, {-15, 5}};
  lens.outline_mm = {rim, hole, part};
  const SurfaceMesh mesh = start_mesh(lens, 81);
  EXPECT_EQ(count_inverted(mesh), 0);
  EXPECT_GT(least_angle(mesh), 20 * kPi / 180);
  EXPECT_NEAR(planar_area(mesh), kPi * (25 * 25 + 8) - 100 + kPi * 36, 2);
  // The border is on the outline, and the hole's corners are there.
  const std::vector<bool> border = border_vertices(mesh);
  int corners = 0, regular = 0;
  const auto rings = detail::one_rings(static_cast<int>(mesh.vertices.size()), mesh.triangles);
  for (std::size_t v = 0; v < border.size(); ++v) {
    const Vec2 p = mesh.vertices[v].head<2>();
    regular += rings[v].closed && (rings[v].neighbours.size() == 4 || rings[v].neighbours.size() == 8);
    if (!border[v]) continue;
    const Vec2 c = p + Vec2(10, 0);
    const double off_rim = std::abs(c.norm() - 25 - 4 * std::cos(3 * std::atan2(c.y(), c.x())));
    const double off_hole = std::abs((p - Vec2(-10, 0)).cwiseAbs().maxCoeff() - 5);
    const double off_part = std::abs((p - Vec2(32, 10)).norm() - 6);
    ASSERT_LT(std::min({off_rim, off_hole, off_part}), 0.02);
    for (const Vec2& corner : hole) corners += (p - corner).norm() < 1e-9;
  }
  EXPECT_EQ(corners, 4);
  EXPECT_GT(regular, 0.75 * static_cast<double>(border.size()));
}

/// Cells of a regular grid of sites, with the map given at the centroids. `potential` is the convex function whose
/// gradient the map is, for maps that are torn.
TransportMap synthetic_map(
    const Vec2& size, int columns, int rows, const std::function<Vec2(const Vec2&)>& target,
    const std::function<double(const Vec2&)>& potential = [](const Vec2&) { return 0.0; }) {
  TransportMap map;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const Vec2 centroid = size.cwiseProduct(Vec2((i + 0.5) / columns - 0.5, (j + 0.5) / rows - 0.5));
      map.source_centroids_mm.push_back(centroid);
      map.sites_mm.push_back(centroid);
      map.source_masses.push_back(1.0 / (columns * rows));
      map.target_masses.push_back(1.0 / (columns * rows));
      map.weights_mm2.push_back(centroid.squaredNorm() - 2 * potential(centroid));
      map.target_centroids_mm.push_back(target(centroid));
    }
  }
  return map;
}

TEST(InterpolateMap, IsExactForLinearMapsUpToTheCorners) {
  const SourceLight source{SourceLight::Shape::kRectangle, {60, 40}};
  const auto linear = [](const Vec2& p) { return Vec2(3 + 0.5 * p.x() - 0.2 * p.y(), -7 - 0.2 * p.x() + 1.3 * p.y()); };
  Lens lens;
  lens.size_mm = source.size_mm;
  std::vector<Vec2> points;
  for (const Vec3& v : start_mesh(lens, 41).vertices) points.emplace_back(v.head<2>());
  const std::vector<Vec2> values = interpolate_map(synthetic_map(source.size_mm, 30, 20, linear), source, points);
  for (std::size_t p = 0; p < points.size(); ++p) {
    ASSERT_LT((values[p] - linear(points[p])).norm(), 1e-9) << points[p].transpose();
  }
}

TEST(InterpolateMap, TearsWhereThePotentialsBranchesMeet) {
  // All light goes to one of two points: every place belongs to the nearer branch, and none in between.
  const SourceLight source{SourceLight::Shape::kRectangle, {60, 40}};
  const Vec2 left(-20, 5), right(20, -7);
  const auto branch = [&](const Vec2& p) { return std::array{left.dot(p) + 160, right.dot(p)}; };
  const auto torn = [&](const Vec2& p) { return branch(p)[0] > branch(p)[1] ? left : right; };
  const auto potential = [&](const Vec2& p) { return std::max(branch(p)[0], branch(p)[1]); };
  Lens lens;
  lens.size_mm = source.size_mm;
  std::vector<Vec2> points;
  for (const Vec3& v : start_mesh(lens, 41).vertices) points.emplace_back(v.head<2>());
  const TransportMap map = synthetic_map(source.size_mm, 30, 20, torn, potential);
  const std::vector<Vec2> values = interpolate_map(map, source, points);
  for (std::size_t p = 0; p < points.size(); ++p) {
    ASSERT_LT((values[p] - torn(points[p])).norm(), 1e-9) << points[p].transpose();
  }
}

TEST(InterpolateMap, WorksOnADisk) {
  const SourceLight source{SourceLight::Shape::kDisk, {40, 40}};
  TransportMap map =
      synthetic_map({40, 40}, 30, 30, [](const Vec2& p) { return Vec2(1 - 0.5 * p.x(), 2 + 0.7 * p.y()); });
  TransportMap disk;
  for (std::size_t i = 0; i < map.source_masses.size(); ++i) {
    if (map.source_centroids_mm[i].norm() > 19.6) continue;
    disk.source_centroids_mm.push_back(map.source_centroids_mm[i]);
    disk.target_centroids_mm.push_back(map.target_centroids_mm[i]);
    disk.sites_mm.push_back(map.sites_mm[i]);
    disk.weights_mm2.push_back(map.weights_mm2[i]);
  }
  disk.source_masses.assign(disk.source_centroids_mm.size(), 1.0 / disk.source_centroids_mm.size());
  std::vector<Vec2> points;
  for (int k = 0; k < 360; ++k) points.emplace_back(20 * std::cos(k * kPi / 180), 20 * std::sin(k * kPi / 180));
  const std::vector<Vec2> values = interpolate_map(disk, source, points);
  for (std::size_t p = 0; p < points.size(); ++p) {
    EXPECT_LT((values[p] - Vec2(1 - 0.5 * points[p].x(), 2 + 0.7 * points[p].y())).norm(), 0.3)
        << points[p].transpose();
  }
}

RC_GTEST_PROP(RingNormal, DerivativesAreThoseOfFiniteDifferences, ()) {
  const bool closed = *rc::gen::inRange(0, 2);
  const int count = *rc::gen::inRange(3, 9);
  const auto crossed = static_cast<std::uint32_t>(*rc::gen::inRange(0, 1 << count));
  Vec3 centre(any_in(-0.1, 0.1), any_in(-0.1, 0.1), any_in(-0.3, 0.3));
  std::vector<Vec3> ring;
  for (int k = 0; k < count; ++k) {
    const double angle = (closed ? 2 * kPi : kPi) * (k + any_in(-0.3, 0.3)) / count;
    ring.emplace_back(any_in(0.6, 1.5) * std::cos(angle), any_in(0.6, 1.5) * std::sin(angle), any_in(-0.4, 0.4));
  }
  std::vector<Eigen::Matrix3d> jacobians;
  detail::ring_normal(centre, ring, closed, crossed, &jacobians);
  constexpr double kStep = 1e-6;
  for (int k = 0; k <= count; ++k) {
    Vec3& moved = k == 0 ? centre : ring[k - 1];
    for (int axis = 0; axis < 3; ++axis) {
      const double here = moved[axis];
      moved[axis] = here + kStep;
      const Vec3 after = detail::ring_normal(centre, ring, closed, crossed, nullptr);
      moved[axis] = here - kStep;
      const Vec3 before = detail::ring_normal(centre, ring, closed, crossed, nullptr);
      moved[axis] = here;
      RC_ASSERT(((after - before) / (2 * kStep) - jacobians[k].col(axis)).norm() < 1e-6);
    }
  }
}

TargetFunction fixed_targets(const std::vector<Vec2>& targets) {
  return [targets](const std::vector<Vec2>&) { return targets; };
}

RC_GTEST_PROP(CompoundEnergy, GradientIsThatOfFiniteDifferences, ()) {
  Lens lens;
  lens.size_mm = {6, 4};
  SurfaceMesh mesh = start_mesh(lens, 7);
  const auto count = mesh.vertices.size();
  std::vector<Vec3> start = mesh.vertices;
  std::vector<detail::VertexLight> light(count);
  std::vector<Vec3> normals;
  for (std::size_t v = 0; v < count; ++v) {
    start[v].z() += any_in(0, 0.3);
    mesh.vertices[v] = start[v] + Vec3(any_in(-0.2, 0.2), any_in(-0.2, 0.2), any_in(-0.3, 0.3));
    light[v].direction = Vec3(any_in(-0.2, 0.2), any_in(-0.2, 0.2), 1).normalized();
    light[v].flux = any_in(0.5, 2) * light[v].direction;
    normals.push_back(Vec3(any_in(-0.3, 0.3), any_in(-0.3, 0.3), 1).normalized());
  }
  const auto rings = detail::one_rings(static_cast<int>(count), mesh.triangles);
  const std::vector<detail::Freedom> freedom(count, detail::Freedom::kAll);
  const std::vector<Vec2> sides(count, Vec2::Zero());
  const detail::Creases creases{{{detail::Creases::key(8, 9), 0.3}}, std::vector<std::uint32_t>(count, 5)};
  detail::CompoundEnergy energy{mesh.triangles, rings, start, light, freedom, creases, sides, normals, {}, {}};
  for (const Vec3& n : normals) energy.target_slopes.emplace_back(-n.head<2>() / n.z());
  // Each term in turn alone, then all.
  const int term = *rc::gen::inRange(0, 6);
  double* const weights[5] = {&energy.weights.integration, &energy.weights.barrier, &energy.weights.direction,
                              &energy.weights.flux, &energy.weights.smoothness};
  for (int k = 0; k < 5; ++k) *weights[k] = term == k || term == 5 ? any_in(0.5, 2) : 0;
  energy.floor_mm = lens.thickness_mm + 0.1;
  std::vector<Vec3> gradient, ignored;
  detail::energy_at(energy, mesh.vertices, gradient);
  constexpr double kStep = 1e-6;
  for (int k = 0; k < 12; ++k) {
    const int v = *rc::gen::inRange(0, static_cast<int>(count));
    const int axis = *rc::gen::inRange(0, 3);
    const double here = mesh.vertices[v][axis];
    mesh.vertices[v][axis] = here + kStep;
    const double above = detail::energy_at(energy, mesh.vertices, ignored);
    mesh.vertices[v][axis] = here - kStep;
    const double below = detail::energy_at(energy, mesh.vertices, ignored);
    mesh.vertices[v][axis] = here;
    const double slope = (above - below) / (2 * kStep);
    RC_ASSERT(std::abs(slope - gradient[v][axis]) < 1e-5 * (1 + std::abs(slope)) + 1e-9 * above / kStep);
  }
}

RC_GTEST_PROP(HeightSettling, AtRestNoHeightLowersTheEnergy, ()) {
  Lens lens;
  lens.size_mm = {6, 4};
  SurfaceMesh mesh = start_mesh(lens, 13);
  const auto count = mesh.vertices.size();
  const std::vector<detail::VertexLight> light(count);
  const auto rings = detail::one_rings(static_cast<int>(count), mesh.triangles);
  const std::vector<detail::Freedom> freedom(count, detail::Freedom::kHeight);
  const std::vector<Vec2> sides(count, Vec2::Zero());
  detail::Creases creases{{}, std::vector<std::uint32_t>(count, 0)};
  creases.shares = {{detail::Creases::key(20, 21), 0.3}};
  creases.crossed[20] = creases.crossed[21] = 3;
  detail::CompoundEnergy energy{mesh.triangles, rings, mesh.vertices, light, freedom, creases, sides, {}, {}, {}};
  energy.weights.barrier = 0;  // left to others
  detail::HeightSettling settling(energy);
  // Normals of no surface at all, and others later: what the settling keeps from before is only help.
  for (int turn = 0; turn < 2; ++turn) {
    energy.target_normals.clear();
    energy.target_slopes.clear();
    for (const Vec3& p : mesh.vertices) {
      const Vec2 slope(0.1 * p.x() + any_in(-0.05, 0.05), 0.1 * turn * p.y() + any_in(-0.05, 0.05));
      energy.target_slopes.push_back(slope);
      energy.target_normals.push_back(Vec3(-slope.x(), -slope.y(), 1).normalized());
    }
    std::vector<Vec3> before, after;
    detail::energy_at(energy, mesh.vertices, before);
    settling.settle(1e-8, mesh.vertices, {});
    detail::energy_at(energy, mesh.vertices, after);
    double largest_before = 0, largest_after = 0;
    for (std::size_t v = 0; v < count; ++v) {
      largest_before = std::max(largest_before, std::abs(before[v].z()));
      largest_after = std::max(largest_after, std::abs(after[v].z()));
    }
    RC_ASSERT(largest_after < 1e-4 * largest_before);
  }
}

/// RMS distance in z from the Cartesian oval n z + sqrt(d^2 + (zr - z)^2) = C, with C fitted to the surface;
/// `distance(p)` is how far from p, in the plane, its light shall go. This is the equation of equal optical paths, not
/// our code.
double oval_rms_mm(const std::vector<Vec3>& vertices, double n, double zr,
                   const std::function<double(const Vec3&)>& distance) {
  double constant = 0;
  for (const Vec3& v : vertices) constant += (n * v.z() + std::hypot(distance(v), zr - v.z())) / vertices.size();
  double rms = 0;
  for (int turn = 0; turn < 20; ++turn) {
    double sum = 0, squares = 0, shift = 0;
    for (const Vec3& v : vertices) {
      double z = v.z(), slope = 1;
      for (int k = 0; k < 20; ++k) {
        const double way = std::hypot(distance(v), zr - z);
        slope = n - (zr - z) / way;
        z -= (n * z + way - constant) / slope;
      }
      sum += v.z() - z;
      squares += (v.z() - z) * (v.z() - z);
      shift += 1 / slope;
    }
    rms = std::sqrt(squares / vertices.size());
    constant += sum / shift;
  }
  return rms;
}

TEST(SolveSurface, APointTargetAsksForTheCartesianOval) {
  Lens lens;
  lens.size_mm = {100, 70};
  const Receiver receiver;
  SurfaceOptions options;
  options.mesh = 101;
  const Vec2 point(12, -5);  // off-centre
  const std::vector<Vec2> targets(start_mesh(lens, options.mesh).vertices.size(), point);
  const OpticalSurface surface = solve_surface(lens, {}, receiver, fixed_targets(targets), options);
  const double zr = lens.thickness_mm + receiver.distance_mm;
  const double rms = oval_rms_mm(surface.mesh.vertices, lens.refractive_index, zr,
                                 [&](const Vec3& v) { return (v.head<2>() - point).norm(); });
  EXPECT_LT(rms, 1e-3);
  EXPECT_EQ(surface.summary.reason, "heights at rest");
  EXPECT_EQ(surface.summary.inverted_triangles, 0);
  // The height gauge: the thinnest place is as thick as asked for.
  double lowest = 1e9;
  for (const Vec3& v : surface.mesh.vertices) lowest = std::min(lowest, v.z());
  EXPECT_NEAR(lowest, lens.thickness_mm, 1e-12);
  EXPECT_GT(surface.summary.height_range_mm, 5);
  EXPECT_TRUE(std::isinf(surface.summary.min_concave_radius_mm));
  // The outline is where it was, and the light arrives: 99 % of it within a quarter of a millimetre.
  for (std::size_t v = 0; v < targets.size(); ++v) {
    EXPECT_EQ(surface.mesh.vertices[v].head<2>(), surface.entry_mm[v]);
  }
  const Caustic c = trace_mesh(surface.mesh, lens, receiver, {point - Vec2(0.25, 0.25), point + Vec2(0.25, 0.25)});
  EXPECT_LT(c.outside_extent, 0.01);
}

/// How far vertices stand off the surface on which all optical paths from the light to the targets are as long as one
/// another (RMS, mm): the law of equal paths knows nothing of normals or of our code.
double equal_path_rms_mm(const std::vector<Vec3>& vertices, const Lens& lens, const Light& light,
                         const Receiver& receiver, const std::vector<Vec2>& targets_mm) {
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  const Illumination illumination(light, lens);
  std::vector<double> paths, rises;
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const Vec3& p = vertices[v];
    const Vec3 target = frame.origin_mm + targets_mm[v].x() * frame.x_axis + targets_mm[v].y() * frame.y_axis;
    const IncomingRay ray = illumination.at(p);
    const Vec3 entry(ray.entry_mm.x(), ray.entry_mm.y(), 0);
    const double before = light.kind == Light::Kind::kPoint ? (entry - light.position_mm).norm()
                                                            : light.direction.normalized().dot(entry);
    paths.push_back(before + lens.refractive_index * (p - entry).norm() + (target - p).norm());
    rises.push_back(lens.refractive_index * ray.direction.z() - (target - p).normalized().z());
  }
  double constant = 0, weights = 0, squares = 0;
  for (std::size_t v = 0; v < paths.size(); ++v) {
    constant += paths[v] / (rises[v] * rises[v]);
    weights += 1 / (rises[v] * rises[v]);
  }
  for (std::size_t v = 0; v < paths.size(); ++v)
    squares += std::pow((paths[v] - constant / weights) / rises[v], 2) / static_cast<double>(paths.size());
  return std::sqrt(squares);
}

Lens any_lens() {
  Lens lens;
  lens.size_mm = {any_in(30, 60), any_in(30, 60)};
  lens.thickness_mm = any_in(3, 20);
  lens.refractive_index = any_in(1.4, 1.7);
  const int base = *rc::gen::inRange(0, 3);
  lens.base.kind = base == 1 ? Base::Kind::kSphere : base == 2 ? Base::Kind::kCylinder : Base::Kind::kFlat;
  lens.base.radius_mm = any_in(150, 400) * (*rc::gen::inRange(0, 2) == 0 ? 1 : -1);
  lens.base.axis_rad = any_in(0, kPi);
  const int shape = *rc::gen::inRange(0, 3);
  if (shape == 1) {
    lens.shape = Lens::Shape::kDisk;
    lens.size_mm.y() = lens.size_mm.x();
  }
  if (shape == 2) {  // a heart-like outline with a hole
    lens.shape = Lens::Shape::kOutline;
    std::vector<Vec2> rim, hole;
    for (int k = 0; k < 200; ++k) {
      const double angle = 2 * kPi * k / 200;
      const Vec2 out(std::cos(angle), std::sin(angle));
      rim.emplace_back((0.42 + 0.08 * std::cos(3 * angle)) * out.cwiseProduct(lens.size_mm));
      hole.emplace_back(0.1 * out.cwiseProduct(lens.size_mm) + Vec2(2, 1));
    }
    lens.outline_mm = {rim, hole};
  }
  return lens;
}

RC_GTEST_PROP(SolveSurface, AnyLightIntoAPointHasEqualPaths, ()) {
  const Lens lens = any_lens();
  Receiver receiver;
  receiver.distance_mm = any_in(250, 500);
  receiver.shift_mm = {any_in(-20, 20), any_in(-20, 20)};
  receiver.tilt_rad = {any_in(-0.4, 0.4), any_in(-0.4, 0.4)};
  Light light;
  if (*rc::gen::inRange(0, 2) == 0) {
    light.direction = {any_in(-0.2, 0.2), any_in(-0.2, 0.2), 1};
  } else {
    light.kind = Light::Kind::kPoint;
    light.position_mm = {any_in(-50, 50), any_in(-50, 50), -any_in(300, 900)};
  }
  const Vec2 point(any_in(-30, 30), any_in(-30, 30));
  SurfaceOptions options;
  options.mesh = 41;
  const OpticalSurface surface = solve_surface(
      lens, light, receiver, [&](const std::vector<Vec2>& places) { return std::vector<Vec2>(places.size(), point); },
      options);
  RC_ASSERT(equal_path_rms_mm(surface.mesh.vertices, lens, light, receiver, surface.targets_mm) < 2e-3);
  RC_ASSERT(surface.summary.inverted_triangles == 0);
  double lowest = 1e9;
  for (const Vec3& v : surface.mesh.vertices) lowest = std::min(lowest, v.z());
  RC_ASSERT(std::abs(lowest - lens.thickness_mm) < 1e-9);
}

/// A beam that leaves a plane behind the lens with a direction of its own at each vertex: the rays of a point.
Light mesh_of_point(const Vec3& from, const Vec2& size_mm, int side) {
  Light light;
  light.kind = Light::Kind::kMesh;
  Lens plane;
  plane.size_mm = size_mm;
  const SurfaceMesh grid = start_mesh(plane, side);
  light.mesh.triangles = grid.triangles;
  for (const Vec3& v : grid.vertices) {
    const Vec3 p(v.x(), v.y(), -5);
    const Vec3 ray = p - from;
    light.mesh.positions_mm.push_back(p);
    light.mesh.directions.push_back(ray.normalized());
    light.mesh.intensities.push_back(ray.z() / std::pow(ray.norm(), 3));
  }
  return light;
}

TEST(SolveSurface, ABeamOfManyDirectionsIntoAPointHasThePathsOfItsSource) {
  Lens lens;
  lens.size_mm = {50, 40};
  Light point;
  point.kind = Light::Kind::kPoint;
  point.position_mm = {20, -10, -250};
  const Receiver receiver{.distance_mm = 280, .shift_mm = {5, -8}, .tilt_rad = {0.2, -0.3}};
  const auto into_point = [](const std::vector<Vec2>& places) { return std::vector<Vec2>(places.size(), Vec2(6, 4)); };
  SurfaceOptions options;
  options.mesh = 61;
  const Light beam = mesh_of_point(point.position_mm, {70, 60}, 15);
  const OpticalSurface surface = solve_surface(lens, beam, receiver, into_point, options);
  EXPECT_EQ(surface.summary.inverted_triangles, 0);
  EXPECT_EQ(surface.summary.unmapped_vertices, 0);
  EXPECT_LT(equal_path_rms_mm(surface.mesh.vertices, lens, point, receiver, surface.targets_mm), 1e-3);
  // The law sees whose rays they are: not those of a lamp 10 mm further away.
  point.position_mm.z() -= 10;
  EXPECT_GT(equal_path_rms_mm(surface.mesh.vertices, lens, point, receiver, surface.targets_mm), 1e-2);
}

TEST(SolveSurface, ABaseOfTrianglesOrPixelsIsTheSphereItStandsFor) {
  // What light would do unbent depends on the base, and with it where each vertex aims.
  Lens lens;
  lens.size_mm = {40, 30};
  Light light;
  light.direction = {0.1, -0.05, 1};
  const Receiver receiver{.distance_mm = 200, .tilt_rad = {0.1, 0.2}};
  const auto narrowed = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.push_back(0.8 * p);
    return targets;
  };
  SurfaceOptions options;
  options.mesh = 61;
  constexpr double kRadius = 150;
  const auto height = [](const Vec2& p) { return std::sqrt(kRadius * kRadius - p.squaredNorm()); };
  lens.base.radius_mm = kRadius;
  Lens plate;
  plate.size_mm = {44, 33};
  lens.base.mesh = start_mesh(plate, 89);
  for (std::size_t v = 0; v < lens.base.mesh.vertices.size(); ++v) {
    Vec3& p = lens.base.mesh.vertices[v];
    p.z() = height(p.head<2>());
    lens.base.mesh.normals[v] = p / kRadius;
  }
  lens.base.extent = Box2::centred(plate.size_mm);
  lens.base.heights_mm = Grid<float>(440, 330);
  for (int j = 0; j < 330; ++j) {
    for (int i = 0; i < 440; ++i)
      lens.base.heights_mm.at(i, j) = static_cast<float>(height({-22 + (i + 0.5) / 10, -16.5 + (j + 0.5) / 10}));
  }
  std::vector<OpticalSurface> surfaces;
  for (const Base::Kind kind : {Base::Kind::kSphere, Base::Kind::kMesh, Base::Kind::kImage, Base::Kind::kFlat}) {
    lens.base.kind = kind;
    surfaces.push_back(solve_surface(lens, light, receiver, narrowed, options));
    EXPECT_EQ(surfaces.back().summary.inverted_triangles, 0);
  }
  const auto most_apart = [&](const OpticalSurface& other) {
    double most = 0;
    for (std::size_t v = 0; v < other.mesh.vertices.size(); ++v)
      most = std::max(most, (other.mesh.vertices[v] - surfaces[0].mesh.vertices[v]).norm());
    return most;
  };
  EXPECT_LT(most_apart(surfaces[1]), 1e-4);
  EXPECT_LT(most_apart(surfaces[2]), 2e-3);
  EXPECT_GT(most_apart(surfaces[3]), 0.1);
}

TEST(SolveSurface, ACircleTargetAsksForTheRotatedOval) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  const Receiver receiver;
  SurfaceOptions options;
  options.mesh = 121;
  options.min_concave_radius_mm = 10;
  constexpr double kRho = 25;
  std::vector<Vec2> targets;
  for (const Vec3& p : start_mesh(lens, options.mesh).vertices) {
    const double r = p.head<2>().norm();
    targets.push_back(r > 0 ? Vec2(p.head<2>() * (kRho / r)) : Vec2(0, 0));
  }
  const OpticalSurface surface = solve_surface(lens, {}, receiver, fixed_targets(targets), options);
  EXPECT_LT(oval_rms_mm(surface.mesh.vertices, lens.refractive_index, lens.thickness_mm + receiver.distance_mm,
                        [&](const Vec3& v) { return v.head<2>().norm() - kRho; }),
            2e-3);
  EXPECT_EQ(surface.summary.inverted_triangles, 0);
  EXPECT_LT(surface.summary.min_concave_radius_mm, 1000);  // the tip in the middle is a dent
  EXPECT_GT(surface.summary.sharper_light_share, 0);
  EXPECT_LT(surface.summary.sharper_area_share, 0.002);
}

TEST(SolveSurface, FivePointsAskForOvalsThatMeetInCreases) {
  // Each place's light goes to the nearest of five points: five equal ovals, which meet along straight lines.
  Lens lens;
  lens.size_mm = {60, 50};
  const Receiver receiver;
  SurfaceOptions options;
  options.mesh = 81;
  const Vec2 points[5] = {{-18, -12}, {17, -14}, {1, 2}, {-16, 15}, {20, 16}};
  const auto nearest = [&](const Vec2& p) {
    int best = 0;
    for (int k = 1; k < 5; ++k) {
      if ((p - points[k]).norm() < (p - points[best]).norm()) best = k;
    }
    return best;
  };
  const OpticalSurface surface = solve_surface(
      lens, {}, receiver,
      [&](const std::vector<Vec2>& places) {
        std::vector<Vec2> targets;
        for (const Vec2& p : places) targets.push_back(points[nearest(p)]);
        return targets;
      },
      options);
  EXPECT_EQ(surface.summary.inverted_triangles, 0);
  EXPECT_LT(equal_path_rms_mm(surface.mesh.vertices, lens, {}, receiver, surface.targets_mm), 2e-3);
  // Nearly all light is at the points.
  const Caustic c = trace_mesh(surface.mesh, lens, receiver, Box2::centred({60, 50}), {.pixels = 300});
  double at_points = 0;
  for (int j = 0; j < c.flux.height; ++j) {
    for (int i = 0; i < c.flux.width; ++i) {
      const Vec2 p(-30 + (i + 0.5) * 0.2, -25 + (j + 0.5) * 0.2);
      if ((p - points[nearest(p)]).norm() < 1) at_points += c.flux.at(i, j);
    }
  }
  EXPECT_GT(at_points, 0.98);
}

TEST(SolveSurface, AllCoordinatesInCeresFindTheSameOval) {
  Lens lens;
  lens.size_mm = {60, 50};
  SurfaceOptions options;
  options.mesh = 31;
  const auto point = [](const std::vector<Vec2>& places) { return std::vector<Vec2>(places.size(), Vec2(5, -3)); };
  const OpticalSurface quick = solve_surface(lens, {}, {}, point, options);
  options.solver = SurfaceSolver::kEverywhere;
  const OpticalSurface full = solve_surface(lens, {}, {}, point, options);
  EXPECT_GT(full.summary.sliding_vertices, 700);
  EXPECT_EQ(full.summary.inverted_triangles, 0);
  EXPECT_LT(equal_path_rms_mm(full.mesh.vertices, lens, {}, {}, full.targets_mm), 2e-3);
  EXPECT_LT(equal_path_rms_mm(quick.mesh.vertices, lens, {}, {}, quick.targets_mm), 2e-3);
}

TEST(SolveSurface, CreasesKeepLightOutOfTheDarkThatAHeightFieldSpills) {
  Lens lens;
  lens.size_mm = {40, 30};
  SurfaceOptions options;
  options.mesh = 61;
  const auto halves = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.emplace_back(p.x() + 0.4 * p.y() < 0.13 ? Vec2(-10, -4) : Vec2(10, 4));
    return targets;
  };
  double between[2];
  for (const bool smooth : {false, true}) {
    options.solver = smooth ? SurfaceSolver::kHeightField : SurfaceSolver::kCreases;
    const OpticalSurface surface = solve_surface(lens, {}, {}, halves, options);
    const Caustic c = trace_mesh(surface.mesh, lens, {}, Box2::centred({16, 30}), {.pixels = 60});
    between[smooth ? 1 : 0] = 0;
    for (double f : c.flux.values) between[smooth ? 1 : 0] += f;
  }
  EXPECT_LT(between[0], 0.3 * between[1]);
}

TEST(SolveSurface, BendsOneCreaseWhereTheLightParts) {
  // Left of an oblique line the light goes to one point, right of it to another: two ovals that meet in a valley.
  Lens lens;
  lens.size_mm = {40, 30};
  Receiver receiver;
  receiver.distance_mm = 200;
  SurfaceOptions options;
  options.mesh = 61;
  std::vector<Vec2> targets;
  // The transport map to two points of equal light: cells part along a line across the way between the points.
  for (const Vec3& p : start_mesh(lens, options.mesh).vertices) {
    targets.push_back(p.x() + 0.4 * p.y() < 0.13 ? Vec2(-10, -4) : Vec2(10, 4));
  }
  const OpticalSurface surface = solve_surface(lens, {}, receiver, fixed_targets(targets), options);
  EXPECT_EQ(surface.summary.inverted_triangles, 0);
  const Caustic c = trace_mesh(surface.mesh, lens, receiver, Box2::centred({30, 20}), {.pixels = 60});
  double near_points = 0, everything = c.outside_extent + c.totally_reflected;
  for (int j = 0; j < c.flux.height; ++j) {
    for (int i = 0; i < c.flux.width; ++i) {
      const Vec2 p(-15 + (i + 0.5) * 0.5, -10 + (j + 0.5) * 0.5);
      everything += c.flux.at(i, j);
      if (std::min((p - Vec2(10, 4)).norm(), (p - Vec2(-10, -4)).norm()) < 1) near_points += c.flux.at(i, j);
    }
  }
  EXPECT_NEAR(everything, 1, 1e-9);
  // The valley is 32 mm long; without sliding a cell of 0.67 mm on either side of it would miss: 3.6 % of the light.
  EXPECT_GT(near_points, 0.97);
  // Vertices slid, and only near the valley; the outline kept its shape.
  double slid = 0;
  for (std::size_t v = 0; v < targets.size(); ++v) {
    const Vec2 way = surface.mesh.vertices[v].head<2>() - surface.entry_mm[v];
    const Vec2& from = surface.entry_mm[v];
    slid = std::max(slid, way.norm());
    if (std::abs(from.x() + 0.4 * from.y() - 0.13) > 8) {
      EXPECT_LT(way.norm(), 0.02);
    }
    if (std::abs(from.x()) == 20) {
      EXPECT_EQ(way.x(), 0);
    }
    if (std::abs(from.y()) == 15) {
      EXPECT_EQ(way.y(), 0);
    }
  }
  EXPECT_GT(slid, 0.02);
}

TEST(SolveSurface, ALetterIsReadableFromTheLensSide) {
  TargetSpec spec;
  spec.drawing = LIGHTMILL_FIXTURES "/pictures/letter_f.svg";
  const TargetLight target = load_target(spec);
  TransportOptions transport;
  transport.samples = 4096;
  const Lens lens;
  const TransportMap map = solve_transport({SourceLight::Shape::kRectangle, lens.size_mm}, target, transport);
  SurfaceOptions options;
  options.mesh = 81;
  const OpticalSurface surface = solve_surface(lens, {}, {}, map, options);
  EXPECT_EQ(surface.summary.inverted_triangles, 0);
  const Caustic c = trace_mesh(surface.mesh, lens, {}, target.extent, {.pixels = 128});
  const CausticMeasures m = measure_caustic(c, target);
  EXPECT_LT(m.l1_error, 0.15);
  EXPECT_LT(m.flux_outside_support, 0.04);
  // On the receiver, looking along +Z with +Y up, +X is on the left: there, and low, stands the stem. Arms reach to -X,
  // on top.
  const auto light = [&](double x0, double x1, double y0, double y1) {
    double sum = 0;
    for (int j = 0; j < c.flux.height; ++j) {
      for (int i = 0; i < c.flux.width; ++i) {
        const double x = -50 + (i + 0.5) * 100 / 128, y = -50 + (j + 0.5) * 100 / 128;
        if (x > x0 && x < x1 && y > y0 && y < y1) sum += c.flux.at(i, j);
      }
    }
    return sum / ((x1 - x0) * (y1 - y0));
  };
  const double stem = light(7, 19, -30, 30);
  const double arm = light(-20, 0, 24, 34);
  EXPECT_GT(stem, 3e-4);
  EXPECT_NEAR(arm / stem, 1, 0.1);
  EXPECT_LT(light(-19, -7, -30, -10), 0.05 * stem);  // where the mirrored letter's stem would be
  EXPECT_LT(light(-20, 0, -34, -24), 0.05 * stem);   // where the arm of the letter on its head would be
}

/// Hills of light, more on one side than on the other.
TargetLight hills(const Vec2& size_mm) {
  TargetLight target;
  target.extent = Box2::centred(size_mm);
  target.area_flux = Grid<double>(80, 60);
  for (int j = 0; j < 60; ++j) {
    for (int i = 0; i < 80; ++i)
      target.area_flux.at(i, j) = 1 + 0.6 * std::sin(0.31 * i + 0.1 * j) * std::cos(0.23 * j) + 0.004 * i;
  }
  target.normalise();
  return target;
}

TEST(SolveSurface, CorrectionsBringThePredictedPictureCloser) {
  Lens lens;
  lens.size_mm = {40, 30};
  const TargetLight target = hills({36, 30});
  TransportOptions transport;
  transport.samples = 1600;
  const TransportMap map = solve_transport({SourceLight::Shape::kRectangle, lens.size_mm}, target, transport);
  SurfaceOptions options;
  options.mesh = 121;
  double errors[2];
  for (const int turns : {0, 4}) {
    options.picture_turns = turns;
    const OpticalSurface surface = solve_surface(lens, {}, {}, map, target, options);
    EXPECT_EQ(surface.summary.inverted_triangles, 0);
    const auto& history = surface.summary.picture_errors;
    EXPECT_TRUE(std::is_sorted(history.rbegin(), history.rend()));
    errors[turns > 0] = measure_caustic(trace_mesh(surface.mesh, lens, {}, target.extent), target).l1_error;
  }
  EXPECT_LT(errors[1], 0.8 * errors[0]);
}

TEST(SolveSurface, HollowsCanBeKeptFromGettingTooSharp) {
  // Light drawn apart ever more towards a line: a valley without a crease.
  Lens lens;
  lens.size_mm = {40, 30};
  const auto valley = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.emplace_back(p.x() + 12 * std::tanh(p.x() / 4), 1.1 * p.y());
    return targets;
  };
  SurfaceOptions options;
  options.mesh = 81;
  options.min_concave_radius_mm = 100;  // the valley's bottom has 49 mm
  const OpticalSurface sharp = solve_surface(lens, {}, {}, valley, options);
  EXPECT_NEAR(sharp.summary.min_concave_radius_mm, 49, 3);
  EXPECT_GT(sharp.summary.sharper_area_share, 0.1);
  options.limit_hollows = true;
  const OpticalSurface limited = solve_surface(lens, {}, {}, valley, options);
  EXPECT_GT(limited.summary.min_concave_radius_mm, 95);
  EXPECT_LT(limited.summary.sharper_area_share, 0.2 * sharp.summary.sharper_area_share);
  // Far from the valley the light still goes where it shall.
  for (std::size_t v = 0; v < limited.mesh.vertices.size(); ++v) {
    if (std::abs(limited.mesh.vertices[v].x()) < 14) continue;
    EXPECT_LT((limited.mesh.normals[v] - sharp.mesh.normals[v]).norm(), 2e-3);
  }
}

TEST(SolveSurface, DoesNotDependOnTheThreadCount) {
  Lens lens;
  lens.size_mm = {30, 20};
  SurfaceOptions options;
  options.mesh = 31;
  options.outer_iterations = 3;
  const TransportMap map = synthetic_map(
      lens.size_mm, 24, 16,
      [](const Vec2& p) { return Vec2(p.x() < 1 ? -10 + 0.1 * p.x() : 8 + 0.2 * p.x(), 0.5 * p.y()); },
      [](const Vec2& p) {
        const double x = p.x();
        return std::max(-10 * x + 0.05 * x * x, 8 * x + 0.1 * x * x - 18.05) + 0.25 * p.y() * p.y();
      });
  set_thread_count(1);
  const OpticalSurface one = solve_surface(lens, {}, {}, map, options);
  set_thread_count(3);
  const OpticalSurface three = solve_surface(lens, {}, {}, map, options);
  set_thread_count(0);
  EXPECT_EQ(one.mesh.vertices, three.mesh.vertices);
}

TEST(SolveSurface, WeightsMeanTheSameAtEverySize) {
  // The same lens, ten times smaller in everything: the same surface, ten times smaller.
  SurfaceOptions options;
  options.mesh = 31;
  options.outer_iterations = 3;
  options.height_tolerance_mm = 0;
  std::vector<std::vector<Vec3>> surfaces;
  for (double scale : {1.0, 0.1}) {
    Lens lens;
    lens.size_mm = Vec2(40, 30) * scale;
    lens.thickness_mm = 8 * scale;
    Receiver receiver;
    receiver.distance_mm = 200 * scale;
    std::vector<Vec2> targets;
    for (const Vec3& p : start_mesh(lens, options.mesh).vertices) {
      targets.push_back(scale * (p.x() + 0.4 * p.y() < 0.13 * scale ? Vec2(-10, -4) : Vec2(10, 4)));
    }
    surfaces.push_back(solve_surface(lens, {}, receiver, fixed_targets(targets), options).mesh.vertices);
    for (Vec3& v : surfaces.back()) v /= scale;
  }
  double most = 0;
  for (std::size_t v = 0; v < surfaces[0].size(); ++v) most = std::max(most, (surfaces[0][v] - surfaces[1][v]).norm());
  EXPECT_LT(most, 1e-4);
}

TEST(SolveSurface, ThePapersWeightsServeEveryMeshSize) {
  // Two ovals that meet in a slanted crease. Twice as many vertices a side leave half the height error at most, whichever of
  // the paper's weights are asked for: no term takes over on fine meshes or on coarse ones.
  Lens lens;
  lens.size_mm = {60, 50};
  const Receiver receiver;
  const auto target = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    const Vec2 left(-9.7, -4.3), right(10.3, 3.7);
    for (const Vec2& p : places) targets.push_back((p - left).norm() < (p - right).norm() ? left : right);
    return targets;
  };
  for (const SurfaceWeights& weights : {SurfaceWeights{.direction = 1e-6, .flux = 0, .smoothness = 1e-6},
                                        SurfaceWeights{.direction = 1e-4, .flux = 1e-3, .smoothness = 1e-4}}) {
    std::vector<double> errors;
    for (const int mesh : {31, 61, 121}) {
      SurfaceOptions options;
      options.mesh = mesh;
      options.weights = weights;
      const OpticalSurface surface = solve_surface(lens, {}, receiver, target, options);
      EXPECT_EQ(surface.summary.inverted_triangles, 0);
      errors.push_back(equal_path_rms_mm(surface.mesh.vertices, lens, {}, receiver, surface.targets_mm));
    }
    EXPECT_LT(errors[1], errors[0] / 2);
    EXPECT_LT(errors[2], errors[1] / 2);
  }
}

TEST(SolveSurface, SaysWhatCannotBe) {
  Lens lens;
  lens.size_mm = {20, 20};
  SurfaceOptions options;
  options.mesh = 5;
  EXPECT_THROW(solve_surface(lens, {}, {}, fixed_targets(std::vector<Vec2>(24, Vec2(0, 0))), options),
               InputError);  // one too few
  EXPECT_THROW(solve_surface(lens, {}, {}, fixed_targets(std::vector<Vec2>(25, Vec2(400, 0))), options),
               InputError);  // 53 degrees
  SurfaceOptions negative = options;
  negative.weights.flux = -1;
  EXPECT_THROW(solve_surface(lens, {}, {}, fixed_targets(std::vector<Vec2>(25, Vec2(0, 0))), negative), InputError);
  Monitor stop;
  stop.should_stop = [] { return true; };
  EXPECT_THROW(solve_surface(lens, {}, {}, fixed_targets(std::vector<Vec2>(25, Vec2(0, 0))), options, stop), Stopped);
}

}  // namespace
}  // namespace lightmill

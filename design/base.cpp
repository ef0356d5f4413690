#include "design/base.h"

#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

[[noreturn]] void no_base(const Vec2& place, const char* why) {
  throw InputError("lens.base: there is no base surface at x = " + fixed(place.x(), 3) +
                   " mm, y = " + fixed(place.y(), 3) + " mm, " + why);
}

/// Height and normal of a circle's arc at `radial` from its axis, `along` the radial unit vector.
BasePoint arc(double radius, const Vec2& offset, const Vec2& place) {
  const double square = radius * radius - offset.squaredNorm();
  if (!(square > 0)) no_base(place, "beyond its equator; use a larger radius (base_radius_mm) or a smaller lens");
  const double root = std::sqrt(square);
  const double side = radius > 0 ? 1 : -1;
  // R - root without cancellation.
  return {-side * offset.squaredNorm() / (std::abs(radius) + root),
          Vec3(side * offset.x(), side * offset.y(), root) / std::abs(radius)};
}

BasePoint image_at(const Base& base, const Vec2& place) {
  const auto& grid = base.heights_mm;
  const Vec2 pitch = base.extent.size().cwiseQuotient(Vec2(grid.width, grid.height));
  const Vec2 at = (place - base.extent.min).cwiseQuotient(pitch) - Vec2(0.5, 0.5);
  const auto cell = [](double x, int count) {
    return std::clamp(static_cast<int>(std::floor(x)), 0, std::max(count - 2, 0));
  };
  const int i = cell(at.x(), grid.width);
  const int j = cell(at.y(), grid.height);
  const int right = std::min(i + 1, grid.width - 1);
  const int up = std::min(j + 1, grid.height - 1);
  // Linear beyond the outermost centres, as inside.
  const double u = at.x() - i;
  const double v = at.y() - j;
  const double h00 = grid.at(i, j), h10 = grid.at(right, j), h01 = grid.at(i, up), h11 = grid.at(right, up);
  const double dx = ((1 - v) * (h10 - h00) + v * (h11 - h01)) / pitch.x();
  const double dy = ((1 - u) * (h01 - h00) + u * (h11 - h10)) / pitch.y();
  return {(1 - v) * ((1 - u) * h00 + u * h10) + v * ((1 - u) * h01 + u * h11), Vec3(-dx, -dy, 1).normalized()};
}

BasePoint mesh_at(const SurfaceMesh& mesh, const detail::TriangleBuckets& triangles, const Vec2& place) {
  const auto cross = [](const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); };
  constexpr double kBeside = 1e-9;  // of a triangle's height: rounding on its edges
  for (const int k : triangles.near(place)) {
    const auto& t = mesh.triangles[k];
    const Vec2 a = mesh.vertices[t[0]].head<2>();
    const Vec2 b = mesh.vertices[t[1]].head<2>();
    const Vec2 c = mesh.vertices[t[2]].head<2>();
    const double area = cross(b - a, c - a);
    if (area == 0) continue;
    const double w1 = cross(place - a, c - a) / area;
    const double w2 = cross(b - a, place - a) / area;
    const double w0 = 1 - w1 - w2;
    if (std::min({w0, w1, w2}) < -kBeside) continue;
    return {w0 * mesh.vertices[t[0]].z() + w1 * mesh.vertices[t[1]].z() + w2 * mesh.vertices[t[2]].z(),
            (w0 * mesh.normals[t[0]] + w1 * mesh.normals[t[1]] + w2 * mesh.normals[t[2]]).normalized()};
  }
  no_base(place, "beside its mesh; the mesh must cover the lens");
}

}  // namespace

BaseSurface::BaseSurface(const Base& base) : base_(base) {
  if (base.kind != Base::Kind::kMesh) return;
  std::vector<Vec2> points;
  for (const Vec3& v : base.mesh.vertices) points.emplace_back(v.head<2>());
  triangles_ = {points, base.mesh.triangles};
}

BasePoint BaseSurface::at(const Vec2& place_mm) const {
  switch (base_.kind) {
    case Base::Kind::kFlat:
      break;
    case Base::Kind::kSphere:
      return arc(base_.radius_mm, place_mm, place_mm);
    case Base::Kind::kCylinder: {
      const Vec2 across(-std::sin(base_.axis_rad), std::cos(base_.axis_rad));
      return arc(base_.radius_mm, across * across.dot(place_mm), place_mm);
    }
    case Base::Kind::kImage:
      return image_at(base_, place_mm);
    case Base::Kind::kMesh:
      return mesh_at(base_.mesh, triangles_, place_mm);
  }
  return {};
}

}  // namespace lightmill

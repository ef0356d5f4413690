#include "design/light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include "design/core/errors.h"

namespace lightmill {

namespace {

constexpr double kBeside = -1e-12;  // weight of a corner below which a place is beside its triangle

double cross2(const Vec2& a, const Vec2& b) {
  return a.x() * b.y() - a.y() * b.x();
}

Vec3 refracted_at_back(const Vec3& in_air, double index) {
  Vec3 inside;
  refract(in_air.normalized(), Vec3::UnitZ(), {1, index}, inside);  // into the denser side: always possible
  return inside;
}

}  // namespace

Illumination::Illumination(const Light& light, const Lens& lens)
    : light_(light),
      index_(lens.refractive_index),
      reference_mm_(lens.thickness_mm),
      box_(Box2::centred(lens.size_mm)) {
  if (light.kind == Light::Kind::kParallel && !(light.direction.z() > 0 && light.direction.allFinite()))
    throw InputError("light.direction: its z must be above 0, the light travels along +Z through the lens");
  if (light.kind == Light::Kind::kPoint && !(light.position_mm.z() < 0 && light.position_mm.allFinite()))
    throw InputError("light.position_mm: its z must be below 0, behind the lens's back");
  if (light.profile.kind == Profile::Kind::kGaussian && !(light.profile.sigma_mm > 0))
    throw InputError("light.sigma_mm must be above 0");
  if (light.profile.kind == Profile::Kind::kImage && light.profile.image.empty())
    throw InputError("light.image: profile = \"image\" needs a picture");
  if (light.kind != Light::Kind::kMesh) return;

  const LightMesh& mesh = light.mesh;
  const std::size_t count = mesh.positions_mm.size();
  if (mesh.triangles.empty() || mesh.directions.size() != count || mesh.intensities.size() != count)
    throw InputError("light.mesh needs triangles, and a direction and an intensity for each vertex");
  std::vector<double> sent(count, 0.0);
  std::vector<double> arrived(count, 0.0);
  for (std::size_t v = 0; v < count; ++v) {
    const Vec3& d = mesh.directions[v];
    const Vec3& p = mesh.positions_mm[v];
    if (!(d.z() > 0) || !(p.z() <= 0) || !(mesh.intensities[v] >= 0))
      throw InputError("light.mesh, vertex " + std::to_string(v) +
                       ": must lie behind the back (z <= 0), send its light towards it (nz > 0) and have an intensity "
                       "of at least 0");
    inside_.push_back(refracted_at_back(d, index_));
    entries_.emplace_back(p.head<2>() - p.z() / d.z() * d.head<2>());
    landed_.emplace_back(entries_[v] + reference_mm_ / inside_[v].z() * inside_[v].head<2>());
  }
  for (const auto& t : mesh.triangles) {
    const double before = (mesh.positions_mm[t[1]] - mesh.positions_mm[t[0]])
                              .cross(mesh.positions_mm[t[2]] - mesh.positions_mm[t[0]])
                              .norm();
    const double after = std::abs(cross2(landed_[t[1]] - landed_[t[0]], landed_[t[2]] - landed_[t[0]]));
    for (const int v : t) {
      sent[v] += before;
      arrived[v] += after;
    }
  }
  for (std::size_t v = 0; v < count; ++v)
    densities_.push_back(arrived[v] > 0 ? mesh.intensities[v] * sent[v] / arrived[v] : 0);
  // Where the light ends: edges of one triangle only.
  std::map<std::pair<int, int>, int> single;
  for (std::size_t k = 0; k < mesh.triangles.size(); ++k) {
    const auto& t = mesh.triangles[k];
    if (cross2(landed_[t[1]] - landed_[t[0]], landed_[t[2]] - landed_[t[0]]) == 0) continue;
    for (int side = 0; side < 3; ++side) {
      const std::pair<int, int> edge = std::minmax(t[side], t[(side + 1) % 3]);
      if (const auto [known, fresh] = single.emplace(edge, static_cast<int>(k)); !fresh) single.erase(known);
    }
  }
  for (const auto& [edge, triangle] : single) rim_.push_back({edge.first, edge.second, triangle});
  if (rim_.empty()) throw InputError("light.mesh: all of its light lands on a line; spread its directions or its vertices");
  buckets_ = {landed_, mesh.triangles};
}

double Illumination::profile(const Vec2& entry) const {
  const Profile& p = light_.profile;
  if (p.kind == Profile::Kind::kUniform) return 1;
  if (p.kind == Profile::Kind::kGaussian)
    return std::exp(-(entry - p.centre_mm).squaredNorm() / (2 * p.sigma_mm * p.sigma_mm));
  if (!box_.contains(entry)) return 0;
  const Vec2 at =
      (entry - box_.min).cwiseQuotient(box_.size()).cwiseProduct(Vec2(p.image.width, p.image.height)) - Vec2(0.5, 0.5);
  const auto part = [](double x, int count, int& low, int& high) {
    x = std::clamp(x, 0.0, count - 1.0);
    low = static_cast<int>(x);
    high = std::min(low + 1, count - 1);
    return x - low;
  };
  int left = 0, right = 0, below = 0, above = 0;
  const double u = part(at.x(), p.image.width, left, right);
  const double v = part(at.y(), p.image.height, below, above);
  return (1 - v) * ((1 - u) * p.image.at(left, below) + u * p.image.at(right, below)) +
         v * ((1 - u) * p.image.at(left, above) + u * p.image.at(right, above));
}

IncomingRay Illumination::from_point(const Vec3& point) const {
  // With t = tan of the angle in air, the radius reached is r(t) = h t + z t / sqrt(q), q = n^2 + (n^2 - 1) t^2.
  const double h = -light_.position_mm.z();
  const double z = point.z();
  const double n2 = index_ * index_;
  const Vec2 offset = point.head<2>() - light_.position_mm.head<2>();
  const double radius = offset.norm();
  double t = 0;
  // r is concave and increasing: Newton from the left never passes the root. The bisection guards against rounding.
  double low = 0;
  double high = radius / h;
  for (int k = 0; k < 60; ++k) {
    const double q = n2 + (n2 - 1) * t * t;
    const double miss = h * t + z * t / std::sqrt(q) - radius;
    (miss > 0 ? high : low) = t;
    const double slope = h + z * n2 / (q * std::sqrt(q));
    double next = t - miss / slope;
    if (!(next >= low && next <= high)) next = (low + high) / 2;
    const bool rests = std::abs(next - t) <= 1e-16 * (1 + t);
    t = next;
    if (rests) break;
  }
  const double q = n2 + (n2 - 1) * t * t;
  const double root = std::sqrt(q);
  const Vec2 along = radius > 0 ? Vec2(offset / radius) : Vec2(0, 0);
  IncomingRay ray;
  ray.direction = Vec3(along.x() * t / root, along.y() * t / root, 1).normalized();
  ray.entry_mm = light_.position_mm.head<2>() + h * t * along;
  // Flux is solid angle: |d cos| = t (1 + t^2)^(-3/2) dt over r dr, where t cancels.
  ray.irradiance = profile(ray.entry_mm) / (std::pow(1 + t * t, 1.5) * (h + z / root) * (h + z * n2 / (q * root)));
  return ray;
}

int Illumination::triangle_at(const Vec2& place, Vec3& weights) const {
  const auto weigh = [&](int k) {
    const auto& t = light_.mesh.triangles[k];
    const Vec2& a = landed_[t[0]];
    const double area = cross2(landed_[t[1]] - a, landed_[t[2]] - a);
    if (area == 0) return false;
    weights[1] = cross2(place - a, landed_[t[2]] - a) / area;
    weights[2] = cross2(landed_[t[1]] - a, place - a) / area;
    weights[0] = 1 - weights[1] - weights[2];
    return true;
  };
  if (buckets_.box().contains(place)) {
    for (const int k : buckets_.near(place)) {
      if (weigh(k) && weights.minCoeff() >= kBeside) return k;
    }
  }
  int nearest = -1;
  double least = std::numeric_limits<double>::infinity();
  for (const auto& edge : rim_) {
    const Vec2 along = landed_[edge.to] - landed_[edge.from];
    const double length2 = along.squaredNorm();
    const Vec2 off = place - landed_[edge.from];
    const double t = length2 > 0 ? std::clamp(off.dot(along) / length2, 0.0, 1.0) : 0;
    const double distance2 = (off - t * along).squaredNorm();
    if (distance2 >= least) continue;
    least = distance2;
    nearest = edge.triangle;
  }
  weigh(nearest);
  return nearest;
}

IncomingRay Illumination::from_mesh(const Vec3& point) const {
  // The ray through the point, followed back to the reference height.
  const double rise = point.z() - reference_mm_;
  Vec2 place = point.head<2>();
  Vec3 weights;
  int k = -1;
  const auto slope = [&](int v) { return Vec2(inside_[v].head<2>() / inside_[v].z()); };
  for (int turn = 0; turn < 20; ++turn) {
    k = triangle_at(place, weights);
    if (rise == 0) break;
    const auto& t = light_.mesh.triangles[k];
    const Vec2 tilt = weights[0] * slope(t[0]) + weights[1] * slope(t[1]) + weights[2] * slope(t[2]);
    const Vec2 next = point.head<2>() - rise * tilt;
    if ((next - place).norm() < 1e-12 * (1 + place.norm())) break;
    place = next;
  }
  IncomingRay ray;
  const auto& t = light_.mesh.triangles[k];
  const auto mixed = [&](const auto& of) {
    using Value = decltype(of(0));  // not Eigen's expression, whose parts are gone
    return Value(weights[0] * of(t[0]) + weights[1] * of(t[1]) + weights[2] * of(t[2]));
  };
  const Vec2 tilt = mixed(slope);
  ray.direction = Vec3(tilt.x(), tilt.y(), 1).normalized();
  ray.entry_mm = mixed([&](int v) -> Vec2 { return entries_[v]; });
  if (weights.minCoeff() < kBeside) return ray;  // beside the light
  const Vec2 u0 = landed_[t[1]] - landed_[t[0]];
  const Vec2 v0 = landed_[t[2]] - landed_[t[0]];
  const Vec2 u1 = u0 + rise * (slope(t[1]) - slope(t[0]));
  const Vec2 v1 = v0 + rise * (slope(t[2]) - slope(t[0]));
  const double spread = std::abs(cross2(u1, v1) / cross2(u0, v0));
  ray.irradiance = spread > 0 ? profile(ray.entry_mm) * mixed([&](int v) { return densities_[v]; }) / spread : 0;
  return ray;
}

IncomingRay Illumination::at(const Vec3& point_mm) const {
  if (light_.kind == Light::Kind::kPoint) return from_point(point_mm);
  if (light_.kind == Light::Kind::kMesh) return from_mesh(point_mm);
  IncomingRay ray;
  ray.direction = refracted_at_back(light_.direction, index_);
  ray.entry_mm = point_mm.head<2>() - point_mm.z() / ray.direction.z() * ray.direction.head<2>();
  ray.irradiance = profile(ray.entry_mm);
  return ray;
}

}  // namespace lightmill

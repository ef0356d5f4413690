#include "design/beams.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/light_grid.h"
#include "design/detail/relief_rays.h"

namespace lightmill {

namespace {

using detail::LightGrid;
using detail::ReliefRays;

enum class Fate : char { kLands, kReflected, kShadowed, kThroughRim, kNeverArrives };

/// What becomes of the ray through one vertex.
struct Corner {
  Fate fate = Fate::kLands;
  Vec2 landed{0, 0};   // pixels
  Vec2 entry_mm{0, 0}; // on the flat back
  double passes = 1;   // share that neither entry nor exit reflects
};

/// A point of the lamp: parallel light from one direction, or from one place.
struct LampPoint {
  bool parallel = true;
  Vec3 direction;  // unit
  Vec3 position;
};

/// `count` points evenly over the unit disk: Vogel's sunflower, whose centroid is drawn onto the centre.
std::vector<Vec2> disk_points(int count) {
  if (count <= 1) return {Vec2::Zero()};
  std::vector<Vec2> points;
  Vec2 mean = Vec2::Zero();
  for (int k = 0; k < count; ++k) {
    const double angle = k * kPi * (3 - std::sqrt(5.0));
    points.push_back(std::sqrt((k + 0.5) / count) * Vec2(std::cos(angle), std::sin(angle)));
    mean += points.back() / count;
  }
  for (Vec2& p : points) p -= mean;
  return points;
}

std::vector<LampPoint> lamp_points(const Lamp& lamp, int samples) {
  const bool parallel = lamp.kind == Lamp::Kind::kParallel;
  if (parallel && !(lamp.direction.allFinite() && lamp.direction.z() > 0))
    throw InputError("light.direction: must point towards +Z, onto the lens's flat back");
  if (!parallel && !(lamp.position_mm.allFinite() && lamp.position_mm.z() < 0))
    throw InputError("light.position_mm: the lamp must stand before the flat back, at z below 0");
  if (samples < 1) throw InputError("lamp_samples is " + std::to_string(samples) + ", must be at least 1");
  const Vec3 axis = parallel ? Vec3(lamp.direction.normalized()) : Vec3((-lamp.position_mm).normalized());
  const Vec3 a = axis.unitOrthogonal();
  const Vec3 b = axis.cross(a);
  const double radius = parallel ? std::tan(lamp.angular_diameter_rad / 2) : lamp.diameter_mm / 2;
  std::vector<LampPoint> points;
  for (const Vec2& p : disk_points(radius > 0 ? samples : 1)) {
    const Vec3 aside = radius * (p.x() * a + p.y() * b);
    points.push_back({parallel, Vec3((axis + aside).normalized()), Vec3(lamp.position_mm + aside)});
    if (parallel && !(points.back().direction.z() > 0)) throw InputError("light: a part of the lamp shines along the flat back");
  }
  return points;
}

/// Where light from `from` meets the plane z = 0 so that, refracted into `index`, it reaches `to`; the entry's distance from
/// the foot of `from` by Newton's method on Fermat's condition, which is monotonic.
Vec2 entry_point(const Vec3& from, const Vec3& to, double index) {
  const Vec2 across = to.head<2>() - from.head<2>();
  const double far = across.norm();
  if (far == 0) return from.head<2>();
  const double before = -from.z();
  const double inside = to.z();
  double low = 0;
  double high = far;
  double r = far * before / (before + inside / index);
  for (int iteration = 0; iteration < 60; ++iteration) {
    const double p = std::hypot(r, before);
    const double q = std::hypot(far - r, inside);
    const double mismatch = r / p - index * (far - r) / q;
    (mismatch > 0 ? high : low) = r;
    const double slope = before * before / (p * p * p) + index * inside * inside / (q * q * q);
    double next = r - mismatch / slope;
    if (!(next >= low && next <= high)) next = (low + high) / 2;
    if (std::abs(next - r) < 1e-13 * far) {
      r = next;
      break;
    }
    r = next;
  }
  return from.head<2>() + across * (r / far);
}

/// Solid angle of a triangle [Van Oosterom and Strackee 1983].
double solid_angle(const Vec3& a, const Vec3& b, const Vec3& c) {
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  return 2 * std::atan2(std::abs(a.dot(b.cross(c))), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
}

bool enters_back(const Lens& lens, const Vec2& entry) {
  constexpr double kSlack = 1e-9;  // mm: a vertex on the rim belongs to the lens
  const Vec2 half = lens.size_mm / 2;
  if (lens.shape == Lens::Shape::kDisk) return entry.norm() <= half.x() + kSlack;
  return std::abs(entry.x()) <= half.x() + kSlack && std::abs(entry.y()) <= half.y() + kSlack;
}

struct Sums {
  double reflected = 0, fresnel = 0, shadowed = 0, rim = 0, never = 0;
};

}  // namespace

ReceiverPlane receiver_plane(const Lens& lens, const Receiver& receiver, const Vec2& tilt_rad, const Vec2& shift_mm) {
  const Eigen::Matrix3d turn =
      (Eigen::AngleAxisd(tilt_rad.y(), Vec3::UnitY()) * Eigen::AngleAxisd(tilt_rad.x(), Vec3::UnitX())).toRotationMatrix();
  return {Vec3(shift_mm.x(), shift_mm.y(), lens.thickness_mm + receiver.distance_mm), turn.col(0), turn.col(1)};
}

double fresnel_transmission(double cos_before, const Indices& indices) {
  const double ci = std::min(1.0, std::abs(cos_before));
  const double sin_after = indices.before / indices.after * std::sqrt(1 - ci * ci);
  if (sin_after >= 1) return 0;
  const double ct = std::sqrt(1 - sin_after * sin_after);
  const double s = (indices.before * ci - indices.after * ct) / (indices.before * ci + indices.after * ct);
  const double p = (indices.before * ct - indices.after * ci) / (indices.before * ct + indices.after * ci);
  return 1 - (s * s + p * p) / 2;
}

double pmma_index(double wavelength_um) {
  const double l2 = wavelength_um * wavelength_um;
  const double r2 = 1 / l2;
  return std::sqrt(2.399964 - 8.308636e-2 * l2 + r2 * (-1.919569e-1 + r2 * (8.720608e-2 + r2 * (-1.666411e-2 + r2 * 1.169519e-3))));
}

Lens lens_at(const Lens& lens, double wavelength_um) {
  constexpr double kHeliumD = 0.5876;
  Lens result = lens;
  result.refractive_index += pmma_index(wavelength_um) - pmma_index(kHeliumD);
  return result;
}

Caustic trace_beams(const SurfaceMesh& mesh, const Lens& lens, const Lamp& lamp, const ReceiverPlane& receiver, const Box2& extent,
                    const BeamOptions& options, const Monitor& monitor) {
  const Vec2 size = extent.size();
  if (options.pixels < 1) throw InputError("caustic: pixels is " + std::to_string(options.pixels) + ", must be at least 1");
  if (!(size.x() > 0 && size.y() > 0)) throw InputError("caustic: the picture's extent is empty");
  const double pixel = size.maxCoeff() / options.pixels;
  Caustic caustic;
  caustic.extent = extent;
  caustic.flux = Grid<double>(std::max(1, static_cast<int>(std::lround(size.x() / pixel))),
                              std::max(1, static_cast<int>(std::lround(size.y() / pixel))));
  const Vec2 pixels_per_mm(caustic.flux.width / size.x(), caustic.flux.height / size.y());
  const Vec3 forward = receiver.right.cross(receiver.up);
  const Indices in{1, lens.refractive_index};
  const Indices out{lens.refractive_index, 1};
  const std::vector<LampPoint> points = lamp_points(lamp, options.lamp_samples);
  const ReliefRays relief(mesh);
  std::vector<Corner> corners(mesh.vertices.size());
  std::vector<double> share(mesh.triangles.size());

  const double grid_bytes = 8.0 * static_cast<double>(caustic.flux.values.size());
  const auto most_blocks = static_cast<std::size_t>(std::clamp(256e6 / grid_bytes, 2.0, 16.0));
  const std::size_t block = std::max<std::size_t>(1, (share.size() + most_blocks - 1) / most_blocks);
  const std::size_t blocks = (share.size() + block - 1) / block;

  for (std::size_t point_number = 0; point_number < points.size(); ++point_number) {
    monitor.report("tracing light", static_cast<double>(point_number) / static_cast<double>(points.size()));
    const LampPoint& point = points[point_number];
    Vec3 slanted = Vec3::UnitZ();
    if (point.parallel) refract(point.direction, Vec3::UnitZ(), in, slanted);

    parallel_blocks(mesh.vertices.size(), 8192, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v) {
        const Vec3& p = mesh.vertices[v];
        Corner& corner = corners[v] = {};
        // From the lamp through the flat back to the vertex.
        Vec3 inside = slanted;
        double cos_entry = point.direction.z();
        if (point.parallel) {
          corner.entry_mm = p.head<2>() - slanted.head<2>() * (p.z() / slanted.z());
        } else {
          corner.entry_mm = entry_point(point.position, p, lens.refractive_index);
          const Vec3 entry(corner.entry_mm.x(), corner.entry_mm.y(), 0);
          inside = (p - entry).normalized();
          cos_entry = (entry - point.position).normalized().z();
        }
        if (!enters_back(lens, corner.entry_mm)) {
          corner.fate = Fate::kThroughRim;
          continue;
        }
        // Out of the relief and on to the receiver.
        const Vec3& n = mesh.normals[v];
        Vec3 after;
        if (!refract(inside, n, out, after)) {
          corner.fate = Fate::kReflected;
          continue;
        }
        if (options.shadows && (relief.meets(static_cast<int>(v), after) || relief.meets(static_cast<int>(v), -inside))) {
          corner.fate = Fate::kShadowed;
          continue;
        }
        if (options.fresnel) corner.passes = fresnel_transmission(cos_entry, in) * fresnel_transmission(inside.dot(n), out);
        const double towards = after.dot(forward);
        const double way = (receiver.centre_mm - p).dot(forward) / towards;
        if (!(towards > 0 && way > 0)) {
          corner.fate = Fate::kNeverArrives;
          continue;
        }
        const Vec3 place = p + way * after - receiver.centre_mm;
        corner.landed = (Vec2(place.dot(receiver.right), place.dot(receiver.up)) - extent.min).cwiseProduct(pixels_per_mm);
      }
    });

    // A triangle's light is what falls on its shadow on the flat back.
    double all = 0;
    for (std::size_t t = 0; t < share.size(); ++t) {
      const Vec2& a = corners[mesh.triangles[t][0]].entry_mm;
      const Vec2& b = corners[mesh.triangles[t][1]].entry_mm;
      const Vec2& c = corners[mesh.triangles[t][2]].entry_mm;
      if (point.parallel) {
        share[t] = std::abs((b - a).x() * (c - a).y() - (b - a).y() * (c - a).x());
      } else {
        const auto seen = [&](const Vec2& e) { return Vec3(Vec3(e.x(), e.y(), 0) - point.position); };
        share[t] = solid_angle(seen(a), seen(b), seen(c));
      }
      all += share[t];
    }
    if (!(all > 0)) throw InputError("caustic: the surface has no area");
    const double scale = 1 / (all * static_cast<double>(points.size()));

    std::vector<LightGrid> parts(blocks, LightGrid(caustic.flux.width, caustic.flux.height));
    std::vector<Sums> sums(blocks);
    parallel_blocks(share.size(), block, [&](std::size_t begin, std::size_t end) {
      LightGrid& grid = parts[begin / block];
      Sums& sum = sums[begin / block];
      for (std::size_t t = begin; t < end; ++t) {
        const double third = share[t] * scale / 3;
        std::array<Vec2, 3> landed;
        int landing = 0;
        double light = 0;
        for (const int v : mesh.triangles[t]) {
          const Corner& corner = corners[v];
          switch (corner.fate) {
            case Fate::kReflected: sum.reflected += third; break;
            case Fate::kShadowed: sum.shadowed += third; break;
            case Fate::kThroughRim: sum.rim += third; break;
            case Fate::kNeverArrives: sum.never += third; break;
            case Fate::kLands:
              landed[landing++] = corner.landed;
              light += third * corner.passes;
              sum.fresnel += third * (1 - corner.passes);
          }
        }
        if (landing == 3) grid.add_triangle(landed[0], landed[1], landed[2], light);
        if (landing == 2) grid.add_triangle(landed[0], landed[1], (landed[0] + landed[1]) / 2, light);
        if (landing == 1) grid.add_point(landed[0], light);
      }
    });
    for (std::size_t p = 0; p < blocks; ++p) {
      for (std::size_t i = 0; i < caustic.flux.values.size(); ++i) caustic.flux.values[i] += parts[p].flux.values[i];
      caustic.outside_extent += parts[p].outside + sums[p].never;
      caustic.totally_reflected += sums[p].reflected;
      caustic.fresnel_reflected += sums[p].fresnel;
      caustic.shadowed += sums[p].shadowed;
      caustic.through_rim += sums[p].rim;
    }
    // Where light is lost, for whoever has to change the lens; over the whole lamp.
    for (std::size_t v = 0; v < corners.size(); ++v) {
      const Fate fate = corners[v].fate;
      const Vec2 place = mesh.vertices[v].head<2>();
      if (fate == Fate::kReflected) caustic.reflected_from.include(place);
      if (fate == Fate::kShadowed) caustic.shadowed_from.include(place);
      if (fate == Fate::kThroughRim) caustic.rim_from.include(place);
    }
  }
  monitor.report("tracing light", 1.0);
  return caustic;
}

}  // namespace lightmill

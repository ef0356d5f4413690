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

enum class Fate : char { kLands, kUnlit, kReflected, kShadowed, kEntersByRim, kNeverArrives };

/// What becomes of the light at one vertex.
struct Corner {
  Fate fate = Fate::kLands;
  Vec3 flux = Vec3::Zero();  // along the ray inside the lens, per mm^2 of a plane at right angles
  Vec2 landed{0, 0};         // pixels
  double passes = 1;         // share that neither entry nor exit reflects
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

/// A direction tilted by `aside`, measured on a plane one unit away.
Vec3 tilted(const Vec3& direction, const Vec2& aside) {
  return Eigen::Quaterniond::FromTwoVectors(Vec3::UnitZ(), direction) * Vec3(aside.x(), aside.y(), 1);
}

/// The part of a wide light that comes from one place of its disk; `aside` as seen from the lens.
Light part_of(Light light, const Vec2& aside) {
  if (light.kind == Light::Kind::kParallel) light.direction = tilted(light.direction, aside);
  if (light.kind == Light::Kind::kPoint) light.position_mm = -light.position_mm.norm() * tilted(-light.position_mm, aside);
  for (Vec3& direction : light.mesh.directions) direction = tilted(direction, aside);
  return light;
}

/// Light on the back that meets the lens's side before the relief.
void find_leaving_by_rim(const SurfaceMesh& mesh, const Lens& lens, const Illumination& illumination, double weight, Caustic& caustic) {
  std::vector<double> light(mesh.vertices.size());
  std::vector<char> leaves(mesh.vertices.size());
  parallel_blocks(mesh.vertices.size(), 8192, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      const Vec3& p = mesh.vertices[v];
      const IncomingRay ray = illumination.at({p.x(), p.y(), 0});
      light[v] = ray.irradiance;
      const Vec2 exit = p.head<2>() + p.z() / ray.direction.z() * ray.direction.head<2>();
      leaves[v] = !enters_back(lens, exit, p.head<2>());
    }
  });
  double all = 0;
  double leaving = 0;
  for (const auto& t : mesh.triangles) {
    const Vec3 ab = mesh.vertices[t[1]] - mesh.vertices[t[0]];
    const Vec3 ac = mesh.vertices[t[2]] - mesh.vertices[t[0]];
    const double area = std::abs(ab.x() * ac.y() - ab.y() * ac.x());
    for (const int v : t) {
      all += area * light[v];
      if (!leaves[v]) continue;
      leaving += area * light[v];
      caustic.leaves_rim_from.include(mesh.vertices[v].head<2>());
    }
  }
  if (all > 0) caustic.leaves_by_rim += weight * leaving / all;
}

struct Sums {
  double reflected = 0, fresnel = 0, shadowed = 0, rim = 0, never = 0;
};

}  // namespace

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

Caustic trace_beams(const SurfaceMesh& mesh, const Lens& lens, const Light& light, const Receiver& receiver, const Box2& extent,
                    const BeamOptions& options, const Monitor& monitor) {
  const Vec2 size = extent.size();
  if (options.pixels < 1) throw InputError("caustic: pixels is " + std::to_string(options.pixels) + ", must be at least 1");
  if (options.lamp_samples < 1) throw InputError("lamp_samples is " + std::to_string(options.lamp_samples) + ", must be at least 1");
  if (!(size.x() > 0 && size.y() > 0)) throw InputError("caustic: the picture's extent is empty");
  const double pixel = size.maxCoeff() / options.pixels;
  Caustic caustic;
  caustic.extent = extent;
  caustic.flux = Grid<double>(std::max(1, static_cast<int>(std::lround(size.x() / pixel))),
                              std::max(1, static_cast<int>(std::lround(size.y() / pixel))));
  const Vec2 pixels_per_mm(caustic.flux.width / size.x(), caustic.flux.height / size.y());
  (void)Illumination(light, lens);  // refuses what a light cannot be; its parts are made into something that can
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  const double index = lens.refractive_index;
  const Indices in{1, index};
  const Indices out{index, 1};
  const bool wide = options.angular_diameter_rad > 0;
  const std::vector<Vec2> places = disk_points(wide ? options.lamp_samples : 1);
  const double weight = 1 / static_cast<double>(places.size());
  const ReliefRays relief(mesh);
  std::vector<Corner> corners(mesh.vertices.size());
  std::vector<std::array<double, 3>> shares(mesh.triangles.size());

  const double grid_bytes = 8.0 * static_cast<double>(caustic.flux.values.size());
  const auto most_blocks = static_cast<std::size_t>(std::clamp(256e6 / grid_bytes, 2.0, 16.0));
  const std::size_t block = std::max<std::size_t>(1, (shares.size() + most_blocks - 1) / most_blocks);
  const std::size_t blocks = (shares.size() + block - 1) / block;

  std::vector<LightGrid> parts(blocks, LightGrid(caustic.flux.width, caustic.flux.height));
  std::vector<Sums> sums(blocks);

  for (std::size_t place_number = 0; place_number < places.size(); ++place_number) {
    monitor.report("tracing light", static_cast<double>(place_number) * weight);
    const Illumination illumination(part_of(light, std::tan(options.angular_diameter_rad / 2) * places[place_number]), lens);

    parallel_blocks(mesh.vertices.size(), 8192, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v) {
        const Vec3& p = mesh.vertices[v];
        Corner& corner = corners[v] = {};
        const IncomingRay ray = illumination.at(p);
        corner.flux = ray.irradiance / ray.direction.z() * ray.direction;
        if (!(ray.irradiance > 0)) {
          corner.fate = Fate::kUnlit;
          continue;
        }
        if (!enters_back(lens, ray.entry_mm, p.head<2>())) {
          corner.fate = Fate::kEntersByRim;
          continue;
        }
        // Out of the relief and on to the receiver.
        const Vec3& n = mesh.normals[v];
        Vec3 after;
        if (!refract(ray.direction, n, out, after)) {
          corner.fate = Fate::kReflected;
          continue;
        }
        if (options.shadows && (relief.meets(static_cast<int>(v), after) || relief.meets(static_cast<int>(v), -ray.direction))) {
          corner.fate = Fate::kShadowed;
          continue;
        }
        if (options.fresnel) {
          const double cos_entry = std::sqrt(std::max(0.0, 1 - index * index * ray.direction.head<2>().squaredNorm()));
          corner.passes = fresnel_transmission(cos_entry, in) * fresnel_transmission(ray.direction.dot(n), out);
        }
        Vec2 landed;
        if (!frame.meet(p, after, landed)) {
          corner.fate = Fate::kNeverArrives;
          continue;
        }
        corner.landed = (landed - extent.min).cwiseProduct(pixels_per_mm);
      }
    });

    // The light through a triangle's thirds.
    double all = 0;
    for (std::size_t t = 0; t < shares.size(); ++t) {
      const auto& triangle = mesh.triangles[t];
      const Vec3& a = mesh.vertices[triangle[0]];
      const Vec3 area = (mesh.vertices[triangle[1]] - a).cross(mesh.vertices[triangle[2]] - a);
      for (int k = 0; k < 3; ++k) all += shares[t][k] = std::abs(corners[triangle[k]].flux.dot(area));
    }
    if (!(all > 0)) throw InputError("caustic: no light meets the surface, or it has no area");
    const double scale = weight / all;

    parallel_blocks(shares.size(), block, [&](std::size_t begin, std::size_t end) {
      LightGrid& grid = parts[begin / block];
      Sums& sum = sums[begin / block];
      for (std::size_t t = begin; t < end; ++t) {
        std::array<Vec2, 3> landed;
        int landing = 0;
        double landing_light = 0;
        for (int k = 0; k < 3; ++k) {
          const Corner& corner = corners[mesh.triangles[t][k]];
          const double third = shares[t][k] * scale;
          switch (corner.fate) {
            case Fate::kUnlit: break;
            case Fate::kReflected: sum.reflected += third; break;
            case Fate::kShadowed: sum.shadowed += third; break;
            case Fate::kEntersByRim: sum.rim += third; break;
            case Fate::kNeverArrives: sum.never += third; break;
            case Fate::kLands:
              landed[landing++] = corner.landed;
              landing_light += third * corner.passes;
              sum.fresnel += third * (1 - corner.passes);
          }
        }
        if (landing == 3) grid.add_triangle(landed[0], landed[1], landed[2], landing_light);
        if (landing == 2) grid.add_triangle(landed[0], landed[1], (landed[0] + landed[1]) / 2, landing_light);
        if (landing == 1) grid.add_point(landed[0], landing_light);
      }
    });
    // Where light is lost, for whoever has to change the lens; over the whole lamp.
    for (std::size_t v = 0; v < corners.size(); ++v) {
      const Fate fate = corners[v].fate;
      const Vec2 place = mesh.vertices[v].head<2>();
      if (fate == Fate::kReflected) caustic.reflected_from.include(place);
      if (fate == Fate::kShadowed) caustic.shadowed_from.include(place);
      if (fate == Fate::kEntersByRim) caustic.enters_rim_from.include(place);
    }
    find_leaving_by_rim(mesh, lens, illumination, weight, caustic);
  }
  for (std::size_t p = 0; p < blocks; ++p) {
    for (std::size_t i = 0; i < caustic.flux.values.size(); ++i) caustic.flux.values[i] += parts[p].flux.values[i];
    caustic.outside_extent += parts[p].outside + sums[p].never;
    caustic.totally_reflected += sums[p].reflected;
    caustic.fresnel_reflected += sums[p].fresnel;
    caustic.shadowed += sums[p].shadowed;
    caustic.enters_by_rim += sums[p].rim;
  }
  monitor.report("tracing light", 1.0);
  return caustic;
}

std::vector<RayEnds> ray_ends(const SurfaceMesh& mesh, const Lens& lens, const Light& light, const Receiver& receiver) {
  const Illumination illumination(light, lens);
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  std::vector<RayEnds> ends(mesh.vertices.size());
  parallel_blocks(ends.size(), 8192, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      const IncomingRay ray = illumination.at(mesh.vertices[v]);
      ends[v].entry_mm = ray.entry_mm;
      Vec3 after;
      ends[v].lands = ray.irradiance > 0 && refract(ray.direction, mesh.normals[v], {lens.refractive_index, 1}, after) &&
                      frame.meet(mesh.vertices[v], after, ends[v].landed_mm);
    }
  });
  return ends;
}

}  // namespace lightmill

// Benchmarks of the surface stage at full size: surface_bench [CASE]... [--mesh N] [--samples N] [--turns N] [--smooth]
// [--picture-turns N] [--out DIR].
//   point, slanted, near, sphere, line, two, five   against the law of equal optical paths (targets given)
//   circle                                          against its profile (targets given); circle_map: by the transport
//   portrait, horse, rings, letter                  the light behind the lens, transport included
//   heights                                         tracing of milled heights
// Prints one line per figure; pictures go to the folder named by --out, if any. --smooth: a height field without
// creases.
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "design/caustic.h"
#include "design/core/image.h"
#include "design/surface.h"

using namespace lightmill;

namespace {

struct Setting {
  int mesh = 321;
  int samples = 65536;
  SurfaceSolver solver = SurfaceSolver::kCreases;
  int turns = SurfaceOptions{}.outer_iterations;
  int picture_turns = SurfaceOptions{}.picture_turns;
  std::string out;
};

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_utime.tv_sec + usage.ru_stime.tv_sec + 1e-6 * (usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

double peak_gb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss / 1048576.0;
}

SurfaceOptions options_of(const Setting& setting) {
  SurfaceOptions options;
  options.mesh = setting.mesh;
  options.outer_iterations = setting.turns;
  options.solver = setting.solver;
  options.picture_turns = setting.picture_turns;
  return options;
}

/// How far vertices stand, in z, off the surface on which every path from the light to its target is as long as any
/// other: RMS, 99.9th percentile and maximum in micrometres. `end_of` is where the light of a vertex shall end, lens
/// frame.
void print_equal_paths(const char* name, const OpticalSurface& surface, const Lens& lens, const Light& light,
                       const std::function<Vec3(std::size_t)>& end_of) {
  const Illumination illumination(light, lens);
  const auto& vertices = surface.mesh.vertices;
  double sum = 0, weight = 0;
  std::vector<double> paths, rises;
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const Vec3& p = vertices[v];
    const IncomingRay ray = illumination.at(p);
    const Vec3 entry(ray.entry_mm.x(), ray.entry_mm.y(), 0);
    const double before = light.kind == Light::Kind::kPoint ? (entry - light.position_mm).norm()
                                                            : light.direction.normalized().dot(entry);
    const Vec3 way = end_of(v) - p;
    paths.push_back(before + lens.refractive_index * (p - entry).norm() + way.norm());
    rises.push_back(lens.refractive_index * ray.direction.z() - way.normalized().z());
    sum += paths[v] / (rises[v] * rises[v]);
    weight += 1 / (rises[v] * rises[v]);
  }
  std::vector<double> errors;
  double squares = 0;
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    errors.push_back(1000 * std::abs(paths[v] - sum / weight) / rises[v]);
    squares += errors[v] * errors[v] / static_cast<double>(vertices.size());
  }
  std::sort(errors.begin(), errors.end());
  std::printf("%s: RMS height error %.4f um, 99.9th percentile %.3f um, maximum %.3f um\n", name, std::sqrt(squares),
              errors[static_cast<std::size_t>(0.999 * static_cast<double>(errors.size() - 1))], errors.back());
}

void print_surface(const char* name, const OpticalSurface& s, double cpu) {
  std::printf(
      "%s: %d vertices, %.1f s wall, %.1f s CPU, peak %.2f GB, %d turns (%s), last change %.3g um, relief %.3f mm, "
      "concave radius %.2f mm, %d inverted, energies",
      name, s.summary.vertices, s.summary.seconds, cpu, peak_gb(), s.summary.outer_iterations, s.summary.reason.c_str(),
      s.summary.final_height_change_mm * 1000, s.summary.height_range_mm, s.summary.min_concave_radius_mm,
      s.summary.inverted_triangles);
  for (double e : s.summary.energy_history) std::printf(" %.5g", e);
  std::printf("\n");
}

/// All light into the nearest of some points of the receiver: equal ovals that meet along straight lines.
void points(const char* name, const Lens& lens, const Light& light, const Receiver& receiver,
            const std::vector<Vec2>& places, const Setting& setting) {
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  const auto nearest = [&](const Vec2& p) {
    std::size_t best = 0;
    for (std::size_t k = 1; k < places.size(); ++k) {
      if ((p - places[k]).norm() < (p - places[best]).norm()) best = k;
    }
    return best;
  };
  const auto target = [&](const std::vector<Vec2>& from) {
    std::vector<Vec2> targets;
    for (const Vec2& p : from) targets.push_back(places[nearest(p)]);
    return targets;
  };
  const double before = cpu_seconds();
  const OpticalSurface s = solve_surface(lens, light, receiver, target, options_of(setting));
  print_surface(name, s, cpu_seconds() - before);
  print_equal_paths(name, s, lens, light, [&](std::size_t v) {
    const Vec2& t = s.targets_mm[v];
    return Vec3(frame.origin_mm + t.x() * frame.x_axis + t.y() * frame.y_axis);
  });
}

void point(const std::string& name, const Setting& setting) {
  Lens lens;
  Light light;
  Receiver receiver;
  std::vector<Vec2> places{{0, 0}};
  if (name == "slanted") {
    light.direction = {0.15, -0.1, 1};
    receiver.tilt_rad = {0.2, 0.1};
    places = {{12, -30}};
  }
  if (name == "near") {
    light.kind = Light::Kind::kPoint;
    light.position_mm = {40, 10, -400};
    places = {{-12, 20}};
  }
  if (name == "sphere") {
    lens.base.kind = Base::Kind::kSphere;
    lens.base.radius_mm = 250;
  }
  if (name == "two") places = {{-25, -6}, {25, 6}};
  if (name == "five") places = {{-30, -20}, {30, -25}, {2, 3}, {-28, 27}, {33, 30}};
  points(name.c_str(), lens, light, receiver, places, setting);
}

void line(const Setting& setting) {
  const Lens lens;
  const Receiver receiver;
  const auto target = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.emplace_back(p.x(), 0);
    return targets;
  };
  const double before = cpu_seconds();
  const OpticalSurface s = solve_surface(lens, {}, receiver, target, options_of(setting));
  print_surface("line", s, cpu_seconds() - before);
  print_equal_paths("line", s, lens, {}, [&](std::size_t v) {
    return Vec3(s.mesh.vertices[v].x(), 0, lens.thickness_mm + receiver.distance_mm);
  });
}

/// A disk of light into a circle; the profile of a radius is a Cartesian oval.
void circle(bool by_transport, const Setting& setting) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  const Receiver receiver;
  constexpr double kRho = 25;
  const auto onto_circle = [](const Vec2& p) { return p.norm() > 0 ? Vec2(p * (kRho / p.norm())) : Vec2(0, 0); };
  const auto target = [&](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.push_back(onto_circle(p));
    return targets;
  };
  const char* name = by_transport ? "circle_map" : "circle";
  TransportMap map;
  if (by_transport) {
    TargetLight light;
    light.extent = Box2::centred({100, 100});
    constexpr int kSides = 3600;
    CurveLight curve;
    for (int k = 0; k <= kSides; ++k)
      curve.vertices_mm.emplace_back(kRho * std::cos(2 * kPi * k / kSides), kRho * std::sin(2 * kPi * k / kSides));
    curve.density_per_mm.assign(curve.vertices_mm.size(), 1.0);
    curve.density_per_mm.assign(curve.vertices_mm.size(), 1 / curve.flux());
    light.curves.push_back(curve);
    TransportOptions options;
    options.samples = setting.samples;
    map = solve_transport({SourceLight::Shape::kDisk, lens.size_mm}, light, options);
  }
  const double before = cpu_seconds();
  const OpticalSurface s = by_transport ? solve_surface(lens, {}, receiver, map, options_of(setting))
                                        : solve_surface(lens, {}, receiver, target, options_of(setting));
  print_surface(name, s, cpu_seconds() - before);
  if (by_transport) std::printf("%s: %zu samples\n", name, map.sites_mm.size());
  print_equal_paths(name, s, lens, {}, [&](std::size_t v) {
    const Vec2 p = s.mesh.vertices[v].head<2>();
    const Vec2 t = p.norm() > 0 ? onto_circle(p) : Vec2(kRho, 0);  // the tip belongs to every radius
    return Vec3(t.x(), t.y(), lens.thickness_mm + receiver.distance_mm);
  });
}

/// From a picture or drawing to the light behind the lens, transport included; its measures, and the picture under
/// --out.
void picture(const char* name, const std::string& image, const std::string& drawing, double white,
             const Setting& setting) {
  TargetSpec spec;
  spec.image = image;
  spec.drawing = drawing;
  const TargetLight target = load_target(spec);
  const Lens lens;
  const Receiver receiver;
  const double start = cpu_seconds();
  TransportOptions transport;
  transport.samples = setting.samples;
  const TransportMap map = solve_transport({}, target, transport);
  const double transported = cpu_seconds();
  const OpticalSurface s = solve_surface(lens, {}, receiver, map, target, options_of(setting));
  print_surface(name, s, cpu_seconds() - transported);
  const Caustic c = trace_mesh(s.mesh, lens, receiver, target.extent);
  const CausticMeasures m = measure_caustic(c, target);
  double landed = 0;
  for (double f : c.flux.values) landed += f;
  std::printf("%s: transport %.1f s CPU; l1_error %.4f, psnr %.2f dB, outside support %.4f, light - 1 = %.1e\n", name,
              transported - start, m.l1_error, m.psnr_db, m.flux_outside_support,
              landed + c.outside_extent + c.totally_reflected - 1);
  if (!setting.out.empty()) {
    write_png8(std::filesystem::path(setting.out) / (std::string(name) + ".png"),
               display_picture(c.flux, spec.viewed_from, white));
    write_ply(std::filesystem::path(setting.out) / (std::string(name) + ".ply"), s.mesh);
  }
}

void heights(const Setting&) {
  // A lens of raw-milled look: waves of 0.15 mm pitch on a sphere, 25 million nodes.
  constexpr int kNodes = 5001;
  Grid<float> smooth(kNodes, kNodes), wavy(kNodes, kNodes);
  for (int j = 0; j < kNodes; ++j) {
    for (int i = 0; i < kNodes; ++i) {
      const double x = -50 + 0.02 * i, y = -50 + 0.02 * j;
      const double z = 20 - (x * x + y * y) / 600;
      const double u = std::remainder(y, 0.155);
      smooth.at(i, j) = static_cast<float>(z);
      wavy.at(i, j) = static_cast<float>(z + u * u / 4);
    }
  }
  Lens lens;
  Receiver receiver;
  const Box2 box = Box2::centred({100, 100});
  for (const auto* grid : {&smooth, &wavy}) {
    const double before = cpu_seconds();
    const Caustic c = trace_heights(*grid, box, lens, {}, receiver, box);
    double landed = 0;
    for (double f : c.flux.values) landed += f;
    std::printf("heights (%s): %.2f s CPU, light %.15f, outside %.6f\n", grid == &smooth ? "smooth" : "milled",
                cpu_seconds() - before, landed + c.outside_extent + c.totally_reflected, c.outside_extent);
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);  // a run that is cut short has still said something
  Setting setting;
  std::vector<std::string> cases;
  for (int a = 1; a < argc; ++a) {
    const std::string word = argv[a];
    if (word == "--mesh" && a + 1 < argc) {
      setting.mesh = std::atoi(argv[++a]);
    } else if (word == "--samples" && a + 1 < argc) {
      setting.samples = std::atoi(argv[++a]);
    } else if (word == "--smooth") {
      setting.solver = SurfaceSolver::kHeightField;
    } else if (word == "--turns" && a + 1 < argc) {
      setting.turns = std::atoi(argv[++a]);
    } else if (word == "--picture-turns" && a + 1 < argc) {
      setting.picture_turns = std::atoi(argv[++a]);
    } else if (word == "--out" && a + 1 < argc) {
      setting.out = argv[++a];
    } else {
      cases.push_back(word);
    }
  }
  if (cases.empty()) cases = {"point", "circle", "portrait", "rings", "letter", "heights"};
  for (const std::string& name : cases) {
    if (name == "point" || name == "slanted" || name == "near" || name == "sphere" || name == "two" || name == "five")
      point(name, setting);
    if (name == "line") line(setting);
    if (name == "circle" || name == "circle_map") circle(name == "circle_map", setting);
    if (name == "heights") heights(setting);
    const std::string pictures = std::string(LIGHTMILL_FIXTURES) + "/pictures/";
    if (name == "portrait") picture("portrait", pictures + "astronaut.png", "", 3.4, setting);
    if (name == "horse") picture("horse", pictures + "horse.png", "", 6, setting);
    if (name == "rings") picture("rings", "", pictures + "rings.svg", 12, setting);
    if (name == "letter") picture("letter", "", pictures + "letter_f.svg", 8, setting);
  }
}

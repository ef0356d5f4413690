// Benchmarks of the surface stage at full size: surface_bench [point|circle|portrait|horse|rings|letter|heights]...
// [--mesh N]
// [--turns N] [--out DIR].
// Prints one line per figure; pictures go to the folder named by --out, if any.
#include <sys/resource.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "design/caustic.h"
#include "design/core/image.h"
#include "design/surface.h"

using namespace lightmill;

namespace {

struct Setting {
  int mesh = 321;
  int turns = SurfaceOptions{}.outer_iterations;
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

/// RMS distance in z from the Cartesian oval n z + sqrt(d^2 + (zr - z)^2) = constant, its constant fitted; d is each
/// vertex's distance from its target in the plane.
double oval_rms_um(const OpticalSurface& surface, const Lens& lens, const Receiver& receiver) {
  const double n = lens.refractive_index;
  const double zr = lens.thickness_mm + receiver.distance_mm;
  const auto& vertices = surface.mesh.vertices;
  const auto distance = [&](std::size_t v, double rho) { return std::abs(vertices[v].head<2>().norm() - rho); };
  const double rho = surface.targets_mm.back().norm();
  double constant = 0;
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    constant += n * vertices[v].z() + std::hypot(distance(v, rho), zr - vertices[v].z());
  }
  constant /= static_cast<double>(vertices.size());
  double rms = 0;
  for (int turn = 0; turn < 20; ++turn) {
    double sum = 0, squares = 0, shift = 0;
    for (std::size_t v = 0; v < vertices.size(); ++v) {
      double z = vertices[v].z();
      double slope = 1;
      for (int k = 0; k < 20; ++k) {
        const double way = std::hypot(distance(v, rho), zr - z);
        slope = n - (zr - z) / way;
        z -= (n * z + way - constant) / slope;
      }
      sum += vertices[v].z() - z;
      squares += std::pow(vertices[v].z() - z, 2);
      shift += 1 / slope;
    }
    rms = std::sqrt(squares / static_cast<double>(vertices.size()));
    constant += sum / shift;
  }
  return rms * 1000;
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

void point(const Setting& setting) {
  Lens lens;
  Receiver receiver;
  const auto target = [](const std::vector<Vec2>& places) { return std::vector<Vec2>(places.size(), Vec2(0, 0)); };
  const double before = cpu_seconds();
  SurfaceOptions options;
  options.mesh = setting.mesh;
  options.outer_iterations = setting.turns;
  const OpticalSurface s = solve_surface(lens, {}, receiver, target, options);
  print_surface("point", s, cpu_seconds() - before);
  std::printf("point: RMS height error %.4f um\n", oval_rms_um(s, lens, receiver));
}

void circle(const Setting& setting) {
  Lens lens;
  lens.shape = Lens::Shape::kDisk;
  Receiver receiver;
  constexpr double kRho = 25;
  const auto target = [](const std::vector<Vec2>& places) {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.push_back(p.norm() > 0 ? Vec2(p * (kRho / p.norm())) : Vec2(0, 0));
    return targets;
  };
  const double before = cpu_seconds();
  SurfaceOptions options;
  options.mesh = setting.mesh;
  options.outer_iterations = setting.turns;
  const OpticalSurface s = solve_surface(lens, {}, receiver, target, options);
  print_surface("circle", s, cpu_seconds() - before);
  std::printf("circle: RMS height error %.4f um\n", oval_rms_um(s, lens, receiver));
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
  const TransportMap map = solve_transport({}, target);
  const double transported = cpu_seconds();
  SurfaceOptions options;
  options.mesh = setting.mesh;
  options.outer_iterations = setting.turns;
  const OpticalSurface s = solve_surface(lens, {}, receiver, map, options);
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
    } else if (word == "--turns" && a + 1 < argc) {
      setting.turns = std::atoi(argv[++a]);
    } else if (word == "--out" && a + 1 < argc) {
      setting.out = argv[++a];
    } else {
      cases.push_back(word);
    }
  }
  if (cases.empty()) cases = {"point", "circle", "portrait", "rings", "letter", "heights"};
  for (const std::string& name : cases) {
    if (name == "point") point(setting);
    if (name == "circle") circle(setting);
    if (name == "heights") heights(setting);
    const std::string pictures = std::string(LIGHTMILL_FIXTURES) + "/pictures/";
    if (name == "portrait") picture("portrait", pictures + "astronaut.png", "", 3.4, setting);
    if (name == "horse") picture("horse", pictures + "horse.png", "", 6, setting);
    if (name == "rings") picture("rings", "", pictures + "rings.svg", 12, setting);
    if (name == "letter") picture("letter", "", pictures + "letter_f.svg", 8, setting);
  }
}

// Times the fit, the solid and the reachable surface of a lens-like surface at mesh 321 (or argv[1]), and lets FreeCAD
// (freecadcmd, or what the environment's FREECADCMD names) open, judge and tessellate the STEP file.
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>

#include "cam/reachable.h"
#include "cam/solid.h"
#include "cam/spline_surface.h"

using namespace lightmill;

namespace {

double seconds_now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

void say(const char* what, double wall, double cpu) {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::printf("%-40s %6.2f s wall %6.2f s cpu, peak %ld MB\n", what, seconds_now() - wall, cpu_seconds() - cpu,
              usage.ru_maxrss / 1024);
}

/// A focusing lens of 4 mm relief with waves and a few creases, concave ones too.
double lens_height(double x, double y) {
  const double focus = std::sqrt(320.0 * 320 - x * x - y * y) - 306;
  const double waves = 0.02 * std::sin(0.9 * x) * std::cos(0.8 * y) + 0.15 * std::sin(0.2 * x + 0.1 * y);
  const double crease = 0.1 * std::abs(0.6 * x + 0.8 * y - 13.3) - 0.08 * std::abs(x * 0.3 - y + 21.1);
  return focus + waves + crease;
}

SurfaceMesh lens_mesh(int vertices) {
  const int cells = vertices - 1;
  const double edge = 100.0 / cells;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> slide(-0.2 * edge, 0.2 * edge);
  SurfaceMesh mesh;
  for (int j = 0; j <= cells; ++j) {
    for (int i = 0; i <= cells; ++i) {
      double x = -50 + i * edge, y = -50 + j * edge;
      if (i > 0 && i < cells) x += slide(random);
      if (j > 0 && j < cells) y += slide(random);
      mesh.vertices.emplace_back(x, y, lens_height(x, y));
    }
  }
  for (int j = 0; j < cells; ++j) {
    for (int i = 0; i < cells; ++i) {
      const int a = j * vertices + i;
      mesh.triangles.push_back({a, a + 1, a + vertices + 1});
      mesh.triangles.push_back({a, a + vertices + 1, a + vertices});
    }
  }
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  return mesh;
}

/// What FreeCAD makes of the file: valid, and tessellated to 0.05 mm within 30 s.
std::string freecad_says(const std::filesystem::path& step) {
  const char* chosen = std::getenv("FREECADCMD");
  const std::string program = chosen && *chosen ? chosen : "freecadcmd";
  if (std::system(("command -v '" + program + "' > /dev/null 2>&1").c_str()) != 0) {
    return "freecadcmd is not installed (apt-get install freecad): not opened by FreeCAD";
  }
  const auto script = step.parent_path() / "look.py";
  std::ofstream(script) << "import resource, time\n"
                           "import Part\n"
                           "began = time.process_time()\n"
                           "shape = Part.Shape()\n"
                           "shape.read('" + step.string() + "')\n"
                           "opened = time.process_time()\n"
                           "valid = shape.isValid()\n"
                           "judged = time.process_time()\n"
                           "points, triangles = shape.tessellate(0.05)\n"
                           "done = time.process_time()\n"
                           "peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024\n"
                           "print('FreeCAD: %s, valid %s, %d faces; opened in %.1f s of CPU, judged in %.1f, tessellated to 0.05 mm in %.1f (%s 30), %d triangles, '\n"
                           "      'peak %d MB' % (shape.ShapeType, valid, len(shape.Faces), opened - began, judged - opened, done - judged,\n"
                           "                      'below' if done - judged < 30 else 'ABOVE', len(triangles), peak))\n";
  const std::string command = "'" + program + "' '" + script.string() + "' < /dev/null 2>&1 | grep '^FreeCAD: \\|rror'";
  return std::system(command.c_str()) == 0 ? "" : "FreeCAD said nothing of the file";
}

}  // namespace

int main(int argc, char** argv) {
  const int vertices = argc > 1 ? std::atoi(argv[1]) : 321;
  double wall = seconds_now(), cpu = cpu_seconds();
  const SurfaceMesh mesh = lens_mesh(vertices);
  say("mesh", wall, cpu);

  wall = seconds_now(), cpu = cpu_seconds();
  const SplineFit fit = fit_spline(mesh, Box2::centred({100, 100}));
  say("fit_spline", wall, cpu);
  std::printf("  rms %.4f um, max %.3f um, normals %.1f urad, crease share %.4f\n", fit.summary.rms_deviation_um,
              fit.summary.max_deviation_um, fit.summary.rms_normal_deviation_urad, fit.summary.crease_share);

  wall = seconds_now(), cpu = cpu_seconds();
  constexpr int kSide = 2000;
  double sum = 0;
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const auto s = fit.surface.sample(-50 + 100.0 * i / kSide, -50 + 100.0 * j / kSide);
      sum += s.h + s.hx + s.hy + s.hxx + s.hxy + s.hyy;
    }
  }
  const double rate = kSide * kSide / (cpu_seconds() - cpu) / 1e6;
  say("4 M samples", wall, cpu);
  std::printf("  %.1f M samples/s (sum %g)\n", rate, sum);

  const auto folder = std::filesystem::temp_directory_path() / "lightmill_solid_bench";
  const auto file = folder / "lens.step";
  wall = seconds_now(), cpu = cpu_seconds();
  Monitor phases;
  std::string phase;
  double phase_wall = 0, phase_cpu = 0;
  phases.on_progress = [&](std::string_view what, double) {
    if (!phase.empty()) say(("  " + phase).c_str(), phase_wall, phase_cpu);
    phase = what;
    phase_wall = seconds_now(), phase_cpu = cpu_seconds();
  };
  const SolidSummary solid = write_lens_step(file, fit.surface, {.product_name = "bench lens"}, phases);
  say("write_lens_step", wall, cpu);
  std::printf("  valid %d, %d faces, %d free edges, %ju bytes, volume off by %.2e, deviation %.2e um\n", solid.valid,
              solid.faces, solid.free_edges, solid.file_bytes, solid.volume_mm3 / solid.expected_volume_mm3 - 1,
              solid.max_deviation_um);

  wall = seconds_now(), cpu = cpu_seconds();
  const ReachableSurface reach = reachable_surface(fit.surface, 2.0, 0.05);
  say("reachable_surface R 2 mm, 0.05 mm", wall, cpu);
  std::printf("  unreachable %.2f mm^2, residue up to %.2f um\n", reach.unreachable_area_mm2, reach.max_residue_um);

  std::fflush(stdout);
  std::printf("%s\n", freecad_says(file).c_str());
  std::filesystem::remove_all(folder);
  return 0;
}

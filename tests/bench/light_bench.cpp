// Where a lens loses light on its way to the part: light_bench RUN_FOLDER [--out DIR]
// Light through the designed mesh; the spline fitted to it; what the finishing ball leaves of that; the spline polished;
// the machined surface raw and polished, where the folder has one. Pictures of each into --out.
#include <sys/resource.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <string>

#include "cam/reachable.h"
#include "cli/machined_light.h"
#include "cli/pictures.h"
#include "cli/stage_runs.h"
#include "design/core/image.h"
#include "machine/dry_run.h"

using namespace lightmill;
namespace fs = std::filesystem;

namespace {

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

/// The spline as triangles of `pitch` or less with its own normals, which are what bends light.
SurfaceMesh dense_mesh(const SplineSurface& surface, double pitch_mm) {
  const Box2& extent = surface.extent();
  const int nx = static_cast<int>(std::ceil(extent.size().x() / pitch_mm)), ny = static_cast<int>(std::ceil(extent.size().y() / pitch_mm));
  SurfaceMesh mesh;
  for (int j = 0; j <= ny; ++j) {
    for (int i = 0; i <= nx; ++i) {
      const Vec2 p = extent.min + extent.size().cwiseProduct(Vec2(i, j)).cwiseQuotient(Vec2(nx, ny));
      mesh.vertices.emplace_back(p.x(), p.y(), surface.height(p.x(), p.y()));
      mesh.normals.push_back(surface.normal(p.x(), p.y()));
    }
  }
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      const int a = j * (nx + 1) + i;
      mesh.triangles.push_back({a, a + 1, a + nx + 2});
      mesh.triangles.push_back({a, a + nx + 2, a + nx + 1});
    }
  }
  return mesh;
}

Grid<float> heights_of(const SplineSurface& surface, double pitch_mm) {
  const Vec2 size = surface.extent().size();
  Grid<float> heights(static_cast<int>(std::lround(size.x() / pitch_mm)) + 1, static_cast<int>(std::lround(size.y() / pitch_mm)) + 1);
  for (int j = 0; j < heights.height; ++j) {
    for (int i = 0; i < heights.width; ++i) {
      const Vec2 p = surface.extent().min + pitch_mm * Vec2(i, j);
      heights.at(i, j) = static_cast<float>(surface.height(p.x(), p.y()));
    }
  }
  return heights;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2 && !(argc == 4 && std::strcmp(argv[2], "--out") == 0)) {
    std::fprintf(stderr, "usage: light_bench RUN_FOLDER [--out DIR]\n");
    return 2;
  }
  const fs::path folder = argv[1];
  const fs::path out = argc == 4 ? argv[3] : "";
  if (!out.empty()) fs::create_directories(out);
  const Job job = read_job(folder / "job.toml");
  const SurfaceMesh mesh = read_ply(folder / "design/surface.ply");
  const TargetLight target = target_of(job);
  const Scene scene = scene_of(job);
  const auto say = [&](const std::string& what, const Caustic& caustic) {
    const CausticMeasures m = measure_caustic(caustic, target);
    std::printf("%-34s l1_error %.4f, light beside %.3f %%, psnr %.2f dB\n", what.c_str(), m.l1_error, 100 * m.flux_outside_support, m.psnr_db);
    std::fflush(stdout);
    if (!out.empty()) write_png8(out / (what + ".png"), display_picture(caustic.flux, job.receiver.viewed_from, display_white(target)));
  };
  const auto through_mesh = [&](const SurfaceMesh& m) { return cast_light(m, scene, job.receiver, target.extent, false, beam_options(job)).caustic; };
  say("mesh", through_mesh(mesh));

  const double began = cpu_seconds();
  const SplineFit fit = fit_spline(mesh, Box2::centred(job.lens.size_mm), job.spline_fit);
  std::printf("fitted in %.1f CPU s: spans of %.3f mm, rms %.3f um, normals %.0f urad\n", cpu_seconds() - began, fit.surface.span_mm().x(),
              fit.summary.rms_deviation_um, fit.summary.rms_normal_deviation_urad);
  constexpr double kPitchMm = 0.05;
  say("spline", through_mesh(dense_mesh(fit.surface, kPitchMm)));

  const ReachableSurface reachable = reachable_surface(fit.surface, job.finish.cutter.radius_mm(), kPitchMm);
  const Blank blank{job.lens.size_mm, 0, {}};
  const MachinedLight light(job, fit.surface, blank);
  say("ball", light.cast(reachable.closing_mm, reachable.extent));
  const double pitch = job.dry_run.pitch_um / 1000;
  const double sigma_um = job.dry_run.polish_sigma_um;
  say("spline polished", light.cast(polish(heights_of(fit.surface, pitch), pitch, sigma_um), fit.surface.extent()));
  if (fs::exists(folder / "dry_run/machined.tif")) {
    const MachinedSurface machined = read_machined(folder / "dry_run/machined.tif");
    say("machined", light.cast(machined.heights_mm, machined.extent));
    say("machined polished", light.cast(light.polished(machined, sigma_um), machined.extent));
  }
  return 0;
}

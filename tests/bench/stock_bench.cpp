// What the stock model costs: roughing, semi-finishing and finishing of a wavy lens at 20 um.
//   stock_bench [side_mm] [pitch_mm] [direction_deg] [stepover_mm] [solid_pitch_mm]     default 100 0.02 0 0.13 0
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "machine/dry_run.h"
#include "machine/stock_model.h"

using namespace lightmill;

namespace {

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_utime.tv_sec + usage.ru_utime.tv_usec * 1e-6 + usage.ru_stime.tv_sec + usage.ru_stime.tv_usec * 1e-6;
}

double peak_megabytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss / 1024.0;
}

double g_side = 100;

/// Relief of 4 mm, slopes to about 0.35, with a ripple.
double lens(double x, double y) {
  return 10 + 2 + 1.4 * std::sin(0.16 * x + 0.3) * std::cos(0.13 * y) + 0.6 * std::sin(0.35 * x - 0.22 * y);
}

Vec3 normal(double x, double y) {
  const double e = 1e-4;
  return Vec3(-(lens(x + e, y) - lens(x - e, y)) / (2 * e), -(lens(x, y + e) - lens(x, y - e)) / (2 * e), 1)
      .normalized();
}

struct Clock {
  const char* what;
  double cpu = cpu_seconds();
  std::chrono::steady_clock::time_point start = std::chrono::steady_clock::now();
  void stop(long moves, double metres) const {
    const double wall = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::printf("%-14s %8ld moves %7.1f m  %6.1f s CPU  %6.1f s  %6.0f MB\n", what, moves, metres, cpu_seconds() - cpu,
                wall, peak_megabytes());
    std::fflush(stdout);
  }
};

struct Feeder {
  StockModel& model;
  ToolPose last;
  long line = 0;
  double path = 0;
  void go(const ToolPose& to, bool is_rapid = false) {
    SweptMove move;
    move.line = ++line;
    move.from = last;
    move.to = to;
    move.rapid = is_rapid;
    move.spindle_on = true;
    path += (to.tip_mm - last.tip_mm).norm();
    last = to;
    model.move(move);
  }
};

void ball_passes(StockModel& model, const char* what, double stepover, double allowance, double direction) {
  Cutter cutter;
  cutter.name = what;
  cutter.diameter_mm = 4;
  cutter.corner_radius_mm = 2;
  cutter.flute_length_mm = 8;
  cutter.shank_diameter_mm = 4;
  cutter.length_mm = 60;
  cutter.holder = {{30, 40, 8, 12}, {40, 60, 15, 20}};
  model.set_cutter(cutter);
  const Clock clock{what};
  const Vec3 axis(std::sin(kPi / 6) * -std::sin(direction), std::sin(kPi / 6) * std::cos(direction), std::cos(kPi / 6));
  Feeder feeder{model, {{-g_side, -g_side, 40}, axis}};
  const double half = g_side / 2 + 2.5;
  const Vec2 along(std::cos(direction), std::sin(direction));
  const Vec2 across(-along.y(), along.x());
  for (double v = -half; v <= half; v += stepover) {
    bool first = true;
    for (double u = -half; u <= half; u += 0.15) {
      const Vec2 p = u * along + v * across;
      const Vec3 centre = Vec3(p.x(), p.y(), lens(p.x(), p.y()) + allowance) + 2 * normal(p.x(), p.y());
      Vec3 tip = centre - 2 * axis;
      for (double& c : tip) c = std::round(c * 1e5) / 1e5;
      if (first) feeder.go({tip + Vec3(0, 0, 10), axis}, true);
      feeder.go({tip, axis});
      first = false;
    }
    feeder.go({feeder.last.tip_mm + Vec3(0, 0, 10), axis}, true);
  }
  model.flush();
  clock.stop(feeder.line, feeder.path / 1000);
}

void rough(StockModel& model) {
  Cutter cutter;
  cutter.name = "rough";
  cutter.diameter_mm = 10;
  cutter.corner_radius_mm = 0.5;
  cutter.flute_length_mm = 22;
  cutter.shank_diameter_mm = 10;
  cutter.length_mm = 70;
  model.set_cutter(cutter);
  const Clock clock{"rough"};
  Feeder feeder{model, {{-g_side, -g_side, 40}, Vec3::UnitZ()}};
  const double half = g_side / 2 + 6;
  for (double z = 14; z > 10; z -= 1) {
    for (double y = -half; y <= half; y += 4) {
      feeder.go({{-half, y, 40}, Vec3::UnitZ()}, true);
      double low = z;
      for (double x = -half; x <= half; x += 0.5) {
        double stands = 0;
        for (double r = 0; r <= 5; r += 1.25) {
          for (double a = 0; a < 6.28; a += 0.5)
            stands = std::max(stands, lens(x + r * std::cos(a), y + r * std::sin(a)) + 0.3);
        }
        low = std::max(z, stands);
        feeder.go({{x, y, low}, Vec3::UnitZ()});
      }
      feeder.go({{half, y, 40}, Vec3::UnitZ()}, true);
    }
  }
  model.flush();
  clock.stop(feeder.line, feeder.path / 1000);
}

}  // namespace

int main(int argc, char** argv) {
  g_side = argc > 1 ? std::atof(argv[1]) : 100;
  const double pitch = argc > 2 ? std::atof(argv[2]) : 0.02;
  const double direction = argc > 3 ? std::atof(argv[3]) * kPi / 180 : 0;
  const double stepover = argc > 4 ? std::atof(argv[4]) : 0.13;
  StockOptions options;
  options.pitch_mm = pitch;
  options.solid_pitch_mm = argc > 5 ? std::atof(argv[5]) : 0;
  StockModel model({{g_side, g_side}, 15}, options);
  rough(model);
  ball_passes(model, "semi_finish", 0.4, 0.05, direction);
  ball_passes(model, "finish", stepover, 0, direction);
  if (const auto solid = model.solid()) {
    std::printf("solid: %.1f mm3 left, %.1f MB, %zu pieces\n", solid->volume_mm3(), static_cast<double>(solid->bytes()) / 1e6, solid->pieces().size());
  }
  for (const Fault& fault : model.faults())
    std::printf("FAULT %s line %ld: %s\n", fault.kind.c_str(), fault.line, fault.message.c_str());
  const Clock surfacing{"surface()"};
  const MachinedSurface surface = model.surface();
  surfacing.stop(0, 0);
  double highest = 0;
  double lowest = 0;
  for (int j = 2; j < surface.heights_mm.height - 2; ++j) {
    for (int i = 2; i < surface.heights_mm.width - 2; ++i) {
      const double design = lens(surface.extent.min.x() + pitch * i, surface.extent.min.y() + pitch * j);
      const Vec2 peak = surface.peak_place_mm(i, j);
      highest = std::max(highest, surface.peaks_mm.at(i, j) - lens(peak.x(), peak.y()));
      lowest = std::min(lowest, surface.heights_mm.at(i, j) - design);
    }
  }
  std::printf("peaks to %.3f um above, nodes to %.3f um below the lens; removed %.1f mm3\n", highest * 1000,
              lowest * 1000, surface.removed_mm3);
  {
    const Clock writing{"write"};
    const auto path = std::filesystem::temp_directory_path() / "stock_bench_machined.tif";
    write_machined(path, surface);
    writing.stop(0, 0);
    for (const char* name :
         {"stock_bench_machined.tif", "stock_bench_machined_peaks.tif", "stock_bench_machined_peak_offsets.tif", "stock_bench_machined.json"}) {
      std::filesystem::remove(std::filesystem::temp_directory_path() / name);
    }
  }
  for (const double sigma : {50.0, 100.0}) {
    const Clock clock{"polish"};
    const Grid<float> polished = polish(surface.heights_mm, pitch, sigma);
    clock.stop(static_cast<long>(sigma), polished.at(3, 3) * 0);
  }
}

// CPU seconds, points and lengths of the three passes of a lens; argument: its size in mm (default 100).
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>

#include "cam/detail/ball_contact.h"
#include "cam/finishing.h"
#include "cam/roughing.h"

using namespace lightmill;

namespace {

double cpu_seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

/// Relief with hills and, if `crease` is above 0, folds of that slope 8 mm apart, one span (0.31 mm) sharp.
SplineSurface lens(double size, double crease) {
  const int spans = static_cast<int>(size / 100 * 320);
  Grid<double> c(spans + 3, spans + 3);
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) {
      const double x = -size / 2 + (i - 1) * size / spans;
      const double y = -size / 2 + (j - 1) * size / spans;
      const double fold = std::abs(std::fmod(0.7 * x + 0.4 * y + 400, 8) - 4);
      c.at(i, j) = 12 + 0.0008 * (x * x + y * y) + 0.05 * std::sin(x) * std::cos(1.3 * y) + crease * fold;
    }
  }
  return SplineSurface(Box2::centred({size, size}), spans, spans, c);
}

void report(const char* what, const ToolPath& path, double seconds) {
  std::size_t links = 0;
  for (const Move& m : path.moves) links += m.kind == MoveKind::kLink;
  std::printf(
      "  %-12s %6.2f s CPU, %8zu moves, %7.2f m, %6.1f min, stepover %.4f mm, left %.3f um, %zu links, above limit "
      "%.4f mm2\n",
      what, seconds, path.moves.size(), path.length_mm() / 1e3, path.minutes(600), path.stepover_mm,
      path.predicted_cusp_um, links, path.above_limit_mm2);
}

}  // namespace

int main(int argc, char** argv) {
  const double size = argc > 1 ? std::atof(argv[1]) : 100;
  const std::filesystem::path cutters = std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters";
  for (const double crease : {0.0, 0.2}) {
    const SplineSurface surface = lens(size, crease);
    const Blank blank{{size, size}, surface.highest() + 0.3};
    std::printf("lens %.0f mm, relief %.2f mm, creases of slope %.1f\n", size, surface.highest() - surface.lowest(),
                crease);

    const detail::BallContact ball(surface, 2, 5);
    double start = cpu_seconds();
    double sum = 0;
    int count = 0;
    for (double y = -size / 2; y < size / 2; y += size / 40) {
      for (double x = -size / 2; x < size / 2; x += 0.02, ++count) sum += ball.at(x, y).z;
    }
    std::printf("  ball centres %.0f per CPU second (mean %.6f mm)\n", count / (cpu_seconds() - start), sum / count);

    start = cpu_seconds();
    const ToolPath rough_path = plan_roughing(surface, blank, read_cutter(cutters / "rough_10mm.toml"), {});
    report("rough", rough_path, cpu_seconds() - start);
    FinishOptions semi;
    semi.pass = "semi_finish";
    semi.allowance_mm = 0.05;
    semi.cusp_um = 10;
    start = cpu_seconds();
    const ToolPath semi_path = plan_finishing(surface, blank, read_cutter(cutters / "semi_finish_4mm_ball.toml"), semi);
    report("semi_finish", semi_path, cpu_seconds() - start);
    start = cpu_seconds();
    const ToolPath path = plan_finishing(surface, blank, read_cutter(cutters / "finish_4mm_ball.toml"), {});
    report("finish", path, cpu_seconds() - start);
  }
  return 0;
}

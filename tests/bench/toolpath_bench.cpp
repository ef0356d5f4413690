// Cutter locations per second beside a plain triangle drop-cutter, then the three passes, of a 641 lens of 100 mm;
// arguments: spans along a side (default 640), and "locations" to leave the passes out.
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "cam/detail/ball_contact.h"
#include "cam/finishing.h"
#include "cam/roughing.h"
#include "design/core/parallel.h"

using namespace lightmill;

namespace {

constexpr double kSizeMm = 100, kRadiusMm = 2;
constexpr double kStepoverMm = 0.155, kAlongMm = 0.1;

double wall_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

double peak_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

/// Relief with hills and, if `crease` is above 0, folds of that slope 8 mm apart, one span sharp.
SplineSurface lens(int spans, double crease) {
  Grid<double> c(spans + 3, spans + 3);
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) {
      const double x = -kSizeMm / 2 + (i - 1) * kSizeMm / spans;
      const double y = -kSizeMm / 2 + (j - 1) * kSizeMm / spans;
      const double fold = std::abs(std::fmod(0.7 * x + 0.4 * y + 400, 8) - 4);
      c.at(i, j) = 12 + 0.0008 * (x * x + y * y) + 0.05 * std::sin(x) * std::cos(1.3 * y) + crease * fold;
    }
  }
  return SplineSurface(Box2::centred({kSizeMm, kSizeMm}), spans, spans, c);
}

/// What others do: a ball dropped on the mesh of the surface's nodes, every triangle below it by face, edges and corners.
class DropCutter {
 public:
  DropCutter(const SplineSurface& surface, int spans) : spans_(spans), pitch_(kSizeMm / spans), heights_(spans + 1, spans + 1) {
    for (int j = 0; j <= spans; ++j) {
      for (int i = 0; i <= spans; ++i) heights_.at(i, j) = surface.height(i * pitch_ - kSizeMm / 2, j * pitch_ - kSizeMm / 2);
    }
  }

  /// z of the ball's centre.
  [[nodiscard]] double at(double x, double y) const {
    const auto cell = [&](double v) { return std::clamp(static_cast<int>(std::floor((v + kSizeMm / 2) / pitch_)), 0, spans_ - 1); };
    double best = -1e9;
    for (int j = cell(y - kRadiusMm); j <= cell(y + kRadiusMm); ++j) {
      for (int i = cell(x - kRadiusMm); i <= cell(x + kRadiusMm); ++i) {
        const Vec3 a = corner(i, j), b = corner(i + 1, j), c = corner(i + 1, j + 1), d = corner(i, j + 1);
        drop(a, b, c, x, y, best);
        drop(a, c, d, x, y, best);
      }
    }
    return best;
  }

 private:
  [[nodiscard]] Vec3 corner(int i, int j) const { return {i * pitch_ - kSizeMm / 2, j * pitch_ - kSizeMm / 2, heights_.at(i, j)}; }

  static void on_corner(const Vec3& p, double x, double y, double& best) {
    const double inside = kRadiusMm * kRadiusMm - (p.x() - x) * (p.x() - x) - (p.y() - y) * (p.y() - y);
    if (inside >= 0) best = std::max(best, p.z() + std::sqrt(inside));
  }

  static void on_edge(const Vec3& p, const Vec3& q, double x, double y, double& best) {
    // In the upright plane through the edge the ball is a circle about the nearest place of the centre.
    const Vec2 along = (q - p).head<2>();
    const double length = along.norm();
    const Vec2 u = along / length;
    const Vec2 to_centre = Vec2(x, y) - p.head<2>();
    const double beside = u.x() * to_centre.y() - u.y() * to_centre.x();
    const double radius2 = kRadiusMm * kRadiusMm - beside * beside;
    if (radius2 < 0) return;
    const double slope = (q.z() - p.z()) / length;
    const double at = u.dot(to_centre) + std::sqrt(radius2) * slope / std::sqrt(1 + slope * slope);
    if (at < 0 || at > length) return;
    const double from_centre = at - u.dot(to_centre);
    best = std::max(best, p.z() + slope * at + std::sqrt(std::max(0.0, radius2 - from_centre * from_centre)));
  }

  static void drop(const Vec3& a, const Vec3& b, const Vec3& c, double x, double y, double& best) {
    on_corner(a, x, y, best);
    on_corner(b, x, y, best);
    on_corner(c, x, y, best);
    on_edge(a, b, x, y, best);
    on_edge(b, c, x, y, best);
    on_edge(c, a, x, y, best);
    const Vec3 n = (b - a).cross(c - a).normalized();
    const Vec2 contact = Vec2(x, y) - kRadiusMm * n.head<2>();
    const auto left_of = [&](const Vec3& p, const Vec3& q) {
      return (q.x() - p.x()) * (contact.y() - p.y()) - (q.y() - p.y()) * (contact.x() - p.x()) >= 0;
    };
    if (!left_of(a, b) || !left_of(b, c) || !left_of(c, a)) return;
    const double z = a.z() - (n.x() * (contact.x() - a.x()) + n.y() * (contact.y() - a.y())) / n.z();
    best = std::max(best, z + kRadiusMm * n.z());
  }

  int spans_;
  double pitch_;
  Grid<double> heights_;
};

/// z of the centres on every `every`-th pass; says how fast.
template <class Ball>
std::vector<double> locations(const char* what, const Ball& ball, int threads, std::size_t every) {
  set_thread_count(threads);
  const std::size_t rows = static_cast<std::size_t>(kSizeMm / kStepoverMm) + 1, columns = static_cast<std::size_t>(kSizeMm / kAlongMm + 0.5) + 1;
  const std::size_t used = (rows + every - 1) / every;
  std::vector<double> z(used * columns);
  const double wall = wall_seconds(), cpu = cpu_seconds();
  parallel_blocks(used, 4, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const double y = -kSizeMm / 2 + kStepoverMm * static_cast<double>(k * every);
      for (std::size_t i = 0; i < columns; ++i) z[k * columns + i] = ball.at_height(-kSizeMm / 2 + kAlongMm * static_cast<double>(i), y);
    }
  });
  const double count = static_cast<double>(z.size());
  std::printf("  %-22s %d thread%s %8.0f locations: %9.0f /s wall, %9.0f /s CPU, peak %.0f MB\n", what, threads, threads > 1 ? "s," : ", ", count,
              count / (wall_seconds() - wall), count / (cpu_seconds() - cpu), peak_mb());
  return z;
}

struct OnSpline {
  const detail::BallContact& ball;
  [[nodiscard]] double at_height(double x, double y) const { return ball.at(x, y).z; }
};
struct OnMesh {
  const DropCutter& ball;
  [[nodiscard]] double at_height(double x, double y) const { return ball.at(x, y); }
};

/// On one core and on two, and how far the drop-cutter is off. What it holds is let go before passes are planned.
void compare_locations(const SplineSurface& surface, int spans) {
  const detail::BallContact ball(surface, kRadiusMm, 5);
  const std::vector<double> exact = locations("on the smooth surface", OnSpline{ball}, 1, 1);
  locations("on the smooth surface", OnSpline{ball}, 2, 1);
  constexpr std::size_t kEvery = 64;
  const DropCutter mesh(surface, spans);
  const std::vector<double> dropped = locations("triangle drop-cutter", OnMesh{mesh}, 1, kEvery);
  double most = 0, sum = 0;
  const std::size_t columns = static_cast<std::size_t>(kSizeMm / kAlongMm + 0.5) + 1;
  for (std::size_t k = 0; k < dropped.size(); ++k) {
    const double error = std::abs(dropped[k] - exact[k / columns * kEvery * columns + k % columns]);
    most = std::max(most, error);
    sum += error;
  }
  std::printf("  the drop-cutter's centres differ by %.3f um on average, %.2f um at most\n", 1e3 * sum / static_cast<double>(dropped.size()), 1e3 * most);
}

void report(const char* what, const ToolPath& path, double wall, double cpu) {
  std::size_t links = 0;
  for (const Move& m : path.moves) links += m.kind == MoveKind::kLink;
  std::printf("  %-12s %6.2f s wall %6.2f s CPU, %8zu moves, %7.2f m, %6.1f min, stepover %.4f mm, left %.3f um, %zu links, above limit %.4f mm2, peak %.0f MB\n",
              what, wall_seconds() - wall, cpu_seconds() - cpu, path.moves.size(), path.length_mm() / 1e3, path.minutes(600), path.stepover_mm,
              path.predicted_cusp_um, links, path.above_limit_mm2, peak_mb());
}

}  // namespace

int main(int argc, char** argv) {
  const int spans = argc > 1 ? std::atoi(argv[1]) : 640;
  const bool only_locations = argc > 2 && std::string(argv[2]) == "locations";
  const std::filesystem::path cutters = std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters";
  for (const double crease : {0.0, 0.2}) {
    const SplineSurface surface = lens(spans, crease);
    std::printf("lens %.0f mm, %d spans, relief %.2f mm, creases of slope %.1f\n", kSizeMm, spans, surface.highest() - surface.lowest(), crease);
    compare_locations(surface, spans);
    if (only_locations) continue;

    set_thread_count(2);
    const Blank blank{{kSizeMm, kSizeMm}, surface.highest() + 0.3};
    const double all = wall_seconds();
    double wall = wall_seconds(), cpu = cpu_seconds();
    report("rough", plan_roughing(surface, blank, read_cutter(cutters / "rough_10mm.toml"), {}), wall, cpu);
    FinishOptions semi;
    semi.pass = "semi_finish";
    semi.allowance_mm = 0.05;
    semi.cusp_um = 10;
    wall = wall_seconds(), cpu = cpu_seconds();
    report("semi_finish", plan_finishing(surface, blank, read_cutter(cutters / "semi_finish_4mm_ball.toml"), semi), wall, cpu);
    wall = wall_seconds(), cpu = cpu_seconds();
    report("finish", plan_finishing(surface, blank, read_cutter(cutters / "finish_4mm_ball.toml"), {}), wall, cpu);
    std::printf("  all three    %6.2f s wall\n", wall_seconds() - all);
  }
  return 0;
}

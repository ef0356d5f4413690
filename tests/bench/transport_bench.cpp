// Seconds by phase, evaluations, errors and memory of the transport solver, each case in a process of its own.
// transport_bench [TARGET] [SAMPLES] [rectangle|disk] [newton|lbfgs] [trace]; without arguments: all targets at 65,536 samples.
// transport_bench sizes: smooth, photo, rings and strokes at 16k, 66k, 262k and 1.05M samples as a table, and the paper's
// L-BFGS alone as a ratio of seconds as far as it should end in ten minutes.
// transport_bench separable: distances to the closed form of a separable density, by samples.
// transport_bench must-hold: the targets on which the error bounds must hold, at 65,536 samples.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <random>
#include <string>
#include <vector>

#include "design/target.h"
#include "design/transport.h"
#include "tests/design/must_hold_targets.h"
#include "tests/design/separable_light.h"

using namespace lightmill;

namespace {

TargetLight target_of(const std::string& name) {
  TargetSpec spec;
  if (name == "smooth") {
    // Five hills over a floor of 2 %.
    TargetLight target;
    target.extent = Box2::centred(spec.size_mm);
    target.area_flux = Grid<double>(512, 512);
    for (int row = 0; row < 512; ++row) {
      for (int column = 0; column < 512; ++column) {
        double light = 0.02;
        for (int hill = 0; hill < 5; ++hill) {
          const double x = column / 512.0 - 0.5 - 0.3 * std::cos(1.3 + 2.5 * hill);
          const double y = row / 512.0 - 0.5 - 0.3 * std::sin(1.3 + 2.5 * hill);
          light += std::exp(-(x * x + y * y) / (0.01 + 0.003 * hill));
        }
        target.area_flux.at(column, row) = light;
      }
    }
    target.normalise();
    return target;
  }
  if (name == "points") {
    TargetLight target;
    target.extent = Box2::centred(spec.size_mm);
    target.points = {{{-20, 5}, 0.3}, {{25, -10}, 0.7}};
    return target;
  }
  if (name == "stars") {
    // Half of the photo's light in 300 points of any strength.
    TargetLight target = test::must_hold_target("photo");
    std::mt19937 random(1);
    std::uniform_real_distribution<double> at(-48, 48), strength(0, 5);
    for (int k = 0; k < 300; ++k) target.points.push_back({{at(random), at(random)}, std::exp(strength(random))});
    double points = 0;
    for (const auto& point : target.points) points += point.flux;
    for (auto& point : target.points) point.flux /= points;
    target.normalise();
    return target;
  }
  if (std::ranges::find(test::kMustHold, name) != test::kMustHold.end()) return test::must_hold_target(name);
  // "logo-pixels": the logo on the pixels that its borders are kept in, to see what borders cost.
  const bool on_pixels = name.ends_with("-pixels");
  spec.drawing = LIGHTMILL_FIXTURES "/pictures/" + name.substr(0, name.size() - (on_pixels ? 7 : 0)) + ".svg";
  TargetLight target = load_target(spec);
  if (on_pixels) {
    target.area_flux = rasterise_area(target, 1024, 1024);
    target.area_borders.clear();
  }
  return target;
}

struct Case {
  std::string target;
  int samples = 65536;
  bool disk = false;
  bool lbfgs = false;
  bool trace = false;
};

/// Seconds it took, or less than 0.
double run(const Case& what) {
  SourceLight source;
  if (what.disk) source.shape = SourceLight::Shape::kDisk;
  TransportOptions options;
  options.samples = what.samples;
  if (what.lbfgs) options.solver = TransportSolver::kLbfgs;
  const TargetLight target = target_of(what.target);
  Monitor monitor;
  if (what.trace)
    monitor.on_progress = [](std::string_view message, double f) {
      std::fprintf(stderr, "%.3f %.*s\n", f, int(message.size()), message.data());
    };
  const std::clock_t start = std::clock();
  const auto cpu = [&] { return double(std::clock() - start) / CLOCKS_PER_SEC; };
  std::printf("| %s%s%s ", what.target.c_str(), what.disk ? ", disk" : "", what.lbfgs ? ", L-BFGS alone" : "");
  try {
    const TransportMap map = solve_transport(source, target, options, monitor);
    const auto& s = map.summary;
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    std::printf("| %d | %.2f | %.2f | %.2f | %.2f | %.2f | %.2f | %d | %.0e | %.0e | %ld |\n", s.samples, s.seconds, cpu(),
                s.phases.diagrams, s.phases.integrals, s.phases.equations, s.phases.relaxation, s.iterations, s.l1_mass_error,
                s.max_mass_error, usage.ru_maxrss / 1024);
    return s.seconds;
  } catch (const std::exception& e) {
    std::printf("| %d | - | %.2f | %s |\n", what.samples, cpu(), e.what());
    return -1;
  }
}

/// In a process of its own, so that its memory can be told.
double run_apart(const Case& what) {
  std::fflush(stdout);
  int pipe_ends[2];
  if (pipe(pipe_ends) != 0) return run(what);
  const pid_t child = fork();
  if (child == 0) {
    const double seconds = run(what);
    std::fflush(stdout);
    const auto sent = write(pipe_ends[1], &seconds, sizeof seconds);
    _exit(sent == sizeof seconds ? 0 : 1);
  }
  double seconds = -1;
  close(pipe_ends[1]);
  if (read(pipe_ends[0], &seconds, sizeof seconds) != sizeof seconds) seconds = -1;
  close(pipe_ends[0]);
  waitpid(child, nullptr, 0);
  return seconds;
}

/// How the map converges to its closed form.
void print_convergence() {
  std::printf("| samples | worst, cells | worst, mm | RMS, mm |\n|---|---|---|---|\n");
  const test::SeparableLight light;
  for (const int samples : {1000, 4000, 16000, 64000}) {
    TransportOptions options;
    options.samples = samples;
    const TransportMap map = solve_transport(light.source, light.target, options);
    const std::size_t n = map.sites_mm.size();
    double worst = 0, squares = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const double off = (map.target_centroids_mm[i] - light.goes_to(map.sites_mm[i])).norm();
      worst = std::max(worst, off);
      squares += off * off / static_cast<double>(n);
    }
    std::printf("| %zu | %.3f | %.4f | %.4f |\n", n, worst / light.cell_mm(n), worst, std::sqrt(squares));
  }
}

}  // namespace

int main(int count, char** arguments) {
  const std::vector<std::string> words(arguments + 1, arguments + count);
  if (!words.empty() && words[0] == "separable") {
    print_convergence();
    return 0;
  }
  std::printf("| target | samples | s | CPU s | diagrams s | integrals s | equations s | relaxation s | evaluations | l1 | worst cell | MB |\n");
  std::printf("|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  if (!words.empty() && words[0] == "sizes") {
    bool good = true;
    constexpr double kLongest = 600, kGrowth = 6;  // s; of L-BFGS's time from size to size
    for (const char* name : {"smooth", "photo", "rings", "strokes"}) {
      double reference = 0;
      for (const int samples : {16384, 65536, 262144, 1048576}) {
        const double seconds = run_apart({name, samples});
        good &= seconds >= 0;
        if (reference < 0 || kGrowth * reference > kLongest) continue;
        reference = run_apart({name, samples, false, true});
        if (reference > 0) std::printf("| | | L-BFGS alone takes %.1f times as long |\n", reference / seconds);
      }
    }
    return good ? 0 : 4;
  }
  if (!words.empty() && words[0] != "all" && words[0] != "must-hold") {
    Case what{words[0]};
    if (words.size() > 1) what.samples = std::atoi(words[1].c_str());
    for (std::size_t k = 2; k < words.size(); ++k) {
      what.disk |= words[k] == "disk";
      what.lbfgs |= words[k] == "lbfgs";
      what.trace |= words[k] == "trace";
    }
    return run_apart(what) >= 0 ? 0 : 4;
  }
  bool good = true;
  if (!words.empty() && words[0] == "must-hold") {
    for (const char* name : test::kMustHold) good &= run_apart({name}) >= 0;
    return good ? 0 : 4;
  }
  for (const char* name : {"photo", "rings", "strokes_over_photo", "letter_f", "point", "points", "circle"})
    good &= run_apart({name}) >= 0;
  good &= run_apart({"circle", 65536, true}) >= 0;
  return good ? 0 : 4;
}

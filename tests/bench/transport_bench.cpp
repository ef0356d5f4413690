// Seconds, evaluations and errors of the transport solver on the standard targets.
// transport_bench [target] [samples] [rectangle|disk] [trace]; without arguments: all targets at 65,536 samples.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#include <vector>

#include "design/target.h"
#include "design/transport.h"

using namespace lightmill;

namespace {

TargetLight target_of(const std::string& name) {
  TargetSpec spec;
  const std::string pictures = LIGHTMILL_FIXTURES "/pictures/";
  if (name == "points") {
    TargetLight target;
    target.extent = Box2::centred(spec.size_mm);
    target.points = {{{-20, 5}, 0.3}, {{25, -10}, 0.7}};
    return target;
  }
  if (name == "photo" || name == "portrait") spec.image = pictures + "astronaut.png";
  if (name == "portrait") spec.drawing = pictures + "signature.svg";
  if (name != "photo" && name != "portrait") spec.drawing = pictures + name + ".svg";
  spec.curve_flux = 0.5;
  return load_target(spec);
}

bool run(const std::string& name, int samples, bool disk, bool trace) {
  SourceLight source;
  if (disk) source.shape = SourceLight::Shape::kDisk;
  TransportOptions options;
  options.samples = samples;
  const TargetLight target = target_of(name);
  Monitor monitor;
  if (trace)
    monitor.on_progress = [](std::string_view what, double f) {
      std::fprintf(stderr, "%.3f %.*s\n", f, int(what.size()), what.data());
    };
  const std::clock_t start = std::clock();
  const auto cpu = [&] { return double(std::clock() - start) / CLOCKS_PER_SEC; };
  try {
    const TransportMap map = solve_transport(source, target, options, monitor);
    const auto& s = map.summary;
    std::printf("%-10s %-9s %7d samples  %6.2f s  %6.2f cpu s  %4d evaluations  l1 %.1e  max %.1e  empty %d\n",
                name.c_str(), disk ? "disk" : "rectangle", s.samples, s.seconds, cpu(), s.iterations, s.l1_mass_error,
                s.max_mass_error, s.empty_cells);
    std::fflush(stdout);
    return true;
  } catch (const std::exception& e) {
    std::printf("%-10s %-9s %7d samples  %6.2f cpu s: %s\n", name.c_str(), disk ? "disk" : "rectangle", samples, cpu(),
                e.what());
    std::fflush(stdout);
    return false;
  }
}

}  // namespace

int main(int count, char** arguments) {
  const int samples = count > 2 ? std::atoi(arguments[2]) : 65536;
  const bool disk = count > 3 && !std::strcmp(arguments[3], "disk");
  if (count > 1 && std::strcmp(arguments[1], "all") != 0) return run(arguments[1], samples, disk, count > 4) ? 0 : 4;
  bool good = true;
  for (const char* name : {"photo", "rings", "portrait", "letter_f", "point", "points", "circle"})
    good &= run(name, samples, disk, false);
  if (!disk) good &= run("circle", samples, true, false);
  return good ? 0 : 4;
}

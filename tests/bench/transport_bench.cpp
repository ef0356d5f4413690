// Seconds, evaluations and errors of the transport solver on the standard targets.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>

#include "design/target.h"
#include "design/transport.h"

using namespace lightmill;

namespace {

Grid<double> five_rings(int n) {
  Grid<double> flux(n, n);
  const double centres[5][2] = {{0.25, 0.58}, {0.5, 0.58}, {0.75, 0.58}, {0.375, 0.42}, {0.625, 0.42}};
  for (int row = 0; row < n; ++row) {
    for (int column = 0; column < n; ++column) {
      for (const auto& c : centres) {
        const double r = std::hypot((column + 0.5) / n - c[0], (row + 0.5) / n - c[1]);
        flux.at(column, row) =
            std::max(flux.at(column, row), std::clamp(0.5 + (0.012 - std::abs(r - 0.11)) * n, 0.0, 1.0));
      }
    }
  }
  return flux;
}

TargetLight target_of(const char* name, const SourceLight& source) {
  TargetLight target;
  target.extent = Box2::centred(source.size_mm);
  const auto photo = [&] {
    TargetSpec spec;
    spec.image = LIGHTMILL_FIXTURES "/pictures/astronaut.png";
    spec.size_mm = source.size_mm;
    return load_target(spec);
  };
  if (!std::strcmp(name, "photo")) return photo();
  if (!std::strcmp(name, "rings")) target.area_flux = five_rings(256);
  if (!std::strcmp(name, "point")) target.points = {{{7, -13}, 1}};
  if (!std::strcmp(name, "points")) target.points = {{{-20, 5}, 0.3}, {{25, -10}, 0.7}};
  if (!std::strcmp(name, "circle")) {
    CurveLight circle;
    for (int k = 0; k <= 720; ++k) {
      circle.vertices_mm.emplace_back(30 * std::cos(k * kPi / 360), 30 * std::sin(k * kPi / 360));
      circle.density_per_mm.push_back(1);
    }
    target.curves = {circle};
  }
  if (!std::strcmp(name, "signature")) {
    target = photo();
    CurveLight wave;
    for (int k = 0; k <= 720; ++k) {
      wave.vertices_mm.emplace_back(10 + 35.0 * k / 720 + 3 * std::sin(k * 0.1),
                                    -35 + 5 * std::sin(k * 0.06) + 2 * std::cos(k * 0.1));
      wave.density_per_mm.push_back(1);
    }
    const double scale = 1 / wave.flux();
    for (double& d : wave.density_per_mm) d *= scale;
    target.curves = {wave};
  }
  target.normalise();
  return target;
}

}  // namespace

int main(int count, char** arguments) {
  const char* name = count > 1 ? arguments[1] : "photo";
  SourceLight source;
  if (count > 3 && !std::strcmp(arguments[3], "disk")) source.shape = SourceLight::Shape::kDisk;
  TransportOptions options;
  if (count > 2) options.samples = std::atoi(arguments[2]);
  const TargetLight target = target_of(name, source);
  const std::clock_t start = std::clock();
  try {
    const TransportMap map = solve_transport(source, target, options);
    const auto& s = map.summary;
    std::printf("%-10s %7d samples  %6.2f s  %6.2f cpu s  %4d evaluations  l1 %.2e  max %.2e  empty %d\n", name,
                s.samples, s.seconds, double(std::clock() - start) / CLOCKS_PER_SEC, s.iterations, s.l1_mass_error,
                s.max_mass_error, s.empty_cells);
  } catch (const std::exception& e) {
    std::printf("%-10s %6.2f cpu s: %s\n", name, double(std::clock() - start) / CLOCKS_PER_SEC, e.what());
    return 4;
  }
}

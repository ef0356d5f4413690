// Seconds, flux spread and Lloyd's iterations of sampling a gaussian source.
#include <chrono>
#include <cstdio>
#include <ctime>

#include "design/detail/mesh_sampling.h"
#include "design/source.h"

using namespace lightmill;

int main() {
  Light light;
  light.profile.kind = Profile::Kind::kGaussian;
  light.profile.sigma_mm = 35;
  const SourceLight source = trace_source({}, light, {}).source;
  for (const int count : {16384, 65536, 262144}) {
    const auto start = std::chrono::steady_clock::now();
    const std::clock_t cpu = std::clock();
    const auto levels = detail::sample_mesh(source.mesh, count, 1, {});
    std::printf("%7d samples  %6.2f s  %6.2f cpu s  finest: %d iterations, way %.4f cells, flux spread %.3f\n", count,
                std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(),
                double(std::clock() - cpu) / CLOCKS_PER_SEC, levels[0].iterations, levels[0].way,
                levels[0].flux_spread);
  }
}

// Samples of a piecewise linear irradiance by Lloyd's iteration, with exact integrals over Voronoi cells clipped to the
// mesh.
#pragma once

#include <cstdint>
#include <vector>

#include "design/detail/sampling.h"

namespace lightmill::detail {

/// The finest sampling first, then coarser ones by factors of four. Every sample has about the same flux: Voronoi cells
/// of Lloyd's iteration under a density q have flux densities as sqrt(q) [Gersho 1979], so it runs under the irradiance
/// squared.
std::vector<Sampling> sample_mesh(const SourceMesh& mesh, int samples, std::uint64_t seed, const Monitor& monitor);

}  // namespace lightmill::detail

// Sites on the source: equal cells of a rectangle, nearly equal ones of a disk or of any irradiance on a mesh, with exact masses and centroids.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "design/core/monitor.h"
#include "design/detail/laplacian.h"
#include "design/source.h"

namespace lightmill::detail {

/// Voronoi cells of sites, clipped to the source; coordinates relative to the source's centre.
struct Sampling {
  std::vector<Vec2> sites;
  std::vector<double> masses;  ///< sum 1
  std::vector<Vec2> centroids;
  std::vector<GraphEdge>
      edges;        ///< between neighbours: source flux per mm^2 of the potential's difference (len / distance / area)
  Vec2 spread;      ///< standard deviation of the source in x and y
  Vec2 centre{0, 0};       ///< of the source, in receiver coordinates
  double flux_spread = 0;  ///< standard deviation of the masses over their mean
  double way = 0;          ///< Lloyd: mean way from site to centroid of the squared irradiance, in cell sizes
  int iterations = 0;      ///< of Lloyd's
  int columns = 0;  ///< of the grid, row by row; 0 when there is none
  int rows = 0;
};

/// The finest sampling first, then coarser ones by factors of four down to about 16 x 16.
std::vector<Sampling> sample_source(const SourceLight& source, int samples, std::uint64_t seed, const Monitor& monitor);

/// Carries a smooth function from the sites of a coarse sampling to those of a fine one; exact for linear functions.
std::vector<double> prolong(const Sampling& coarse, const std::vector<double>& values, const Sampling& fine);

}  // namespace lightmill::detail

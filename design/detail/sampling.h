// Sites on the source: equal cells of a rectangle or nearly equal ones of a disk, with exact masses and centroids.
#pragma once

#include <memory>
#include <vector>

#include "design/core/monitor.h"
#include "design/detail/laplacian.h"
#include "design/transport.h"

namespace lightmill::detail {

/// Voronoi cells of sites, clipped to the source; coordinates relative to the source's centre.
struct Sampling {
  std::vector<Vec2> sites;
  std::vector<double> masses;  ///< sum 1
  std::vector<Vec2> centroids;
  std::vector<GraphEdge>
      edges;        ///< between neighbours: source flux per mm^2 of the potential's difference (len / distance / area)
  Vec2 spread;      ///< standard deviation of the source in x and y
  int columns = 0;  ///< of the grid, row by row; 0 when there is none
  int rows = 0;
};

/// The finest sampling first, then coarser ones by factors of four down to about 16 x 16.
std::vector<Sampling> sample_source(const SourceLight& source, int samples, const Monitor& monitor);

/// Carries a smooth function from the sites of a coarse sampling to those of a fine one; exact for linear functions.
std::vector<double> prolong(const Sampling& coarse, const std::vector<double>& values, const Sampling& fine);

}  // namespace lightmill::detail

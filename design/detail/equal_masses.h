// Power cells of equal mass around given sites: what makes samples of a source carry the same flux.
#pragma once

#include <functional>
#include <vector>

#include "design/detail/laplacian.h"

namespace lightmill::detail {

/// Cells of sites on a source, for a potential.
struct SourceCells {
  std::vector<double> psi;
  std::vector<double> masses;    ///< sum 1
  std::vector<GraphEdge> edges;  ///< between neighbours: flux along their border / distance of the sites; may be 0
};

/// Standard deviation of the masses over their mean.
double flux_spread_of(const std::vector<double>& masses);

/// The same edges, none without weight, so that parts of a source that no light joins are joined.
std::vector<GraphEdge> bridged(std::vector<GraphEdge> edges);

/// Damped Newton steps from `cells` until the masses of each connected part of the source spread by less than
/// `enough`, or no step helps. `measure` gives the cells at a potential; a measured one becomes the result or is
/// dropped.
SourceCells with_equal_masses(const std::vector<Vec2>& sites, SourceCells cells, double enough,
                              const std::function<SourceCells(std::vector<double> psi)>& measure);

}  // namespace lightmill::detail

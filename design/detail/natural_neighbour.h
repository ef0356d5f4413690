// Natural neighbour (Sibson) interpolation of scattered vectors in the plane.
#pragma once

#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// Interpolates `values` given at `sites` to `queries` [Sibson 1981]: each neighbour's weight is the area that the
/// query's Voronoi cell would take from it. Exact for linear data within the hull of the sites; a query outside gets
/// the value of the nearest site. Needs three sites that are not on a line.
std::vector<Vec2> natural_neighbour_interpolation(const std::vector<Vec2>& sites, const std::vector<Vec2>& values,
                                                  const std::vector<Vec2>& queries);

}  // namespace lightmill::detail

// What there is to see in a map and a surface: where they bend, and how they carry places.
#pragma once

#include <array>
#include <vector>

#include "design/mesh.h"
#include "design/transport.h"

namespace lightmill {

/// Mean curvature of each triangle in 1/mm from its corners' normals, above 0 where the surface bulges towards +Z.
std::vector<double> mean_curvatures(const SurfaceMesh& mesh);

/// The borders between the map's power cells, cut off where they leave `box`.
std::vector<std::array<Vec2, 2>> power_cell_borders(const std::vector<Vec2>& sites_mm, const std::vector<double>& weights_mm2,
                                                    const Box2& box);

/// The sample whose source centroid is nearest to each place.
std::vector<int> nearest_samples(const TransportMap& map, const std::vector<Vec2>& places_mm);

}  // namespace lightmill

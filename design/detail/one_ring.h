// Neighbourhoods of vertices in a triangle mesh, in counter-clockwise order.
#pragma once

#include <array>
#include <vector>

namespace lightmill::detail {

/// The neighbours of a vertex, counter-clockwise. A border vertex's ring is open: its first and last neighbour are on
/// the border too, and there is one triangle fewer than neighbours.
struct OneRing {
  std::vector<int> neighbours;
  bool closed = true;

  [[nodiscard]] int triangle_count() const { return static_cast<int>(neighbours.size()) - (closed ? 0 : 1); }
};

/// The rings of all vertices of a manifold mesh with counter-clockwise triangles.
std::vector<OneRing> one_rings(int vertex_count, const std::vector<std::array<int, 3>>& triangles);

}  // namespace lightmill::detail

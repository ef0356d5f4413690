// Where the wanted light parts: edges of the mesh that a crease of the surface crosses, and vertices moved up to it.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <unordered_map>
#include <vector>

#include "design/core/geometry.h"
#include "design/detail/one_ring.h"

namespace lightmill::detail {

/// Neighbours whose targets are farther apart than this many times the stretch of the map around them are torn apart.
/// (Between the brightest and the darkest parts of a photo, neighbouring cells stretch by 2 or 3 times as much as one
/// another.)
inline constexpr double kTear = 3.5;

/// `values` on the nodes of a graph, without what is high only in bands of at most four nodes: the least of two rings around,
/// then the greatest of two. Light that parts around something dark leaves it a strip of the lens that narrow, across which the
/// map stretches: that stretch is the crease's, not that of the map around it.
template <typename NeighboursOf>
std::vector<double> without_narrow_peaks(std::vector<double> values, const NeighboursOf& neighbours_of) {
  constexpr int kRings = 2;
  for (int ring = 0; ring < 2 * kRings; ++ring) {
    const std::vector<double> before = values;
    for (std::size_t v = 0; v < values.size(); ++v) {
      for (int n : neighbours_of(v)) values[v] = ring < kRings ? std::min(values[v], before[n]) : std::max(values[v], before[n]);
    }
  }
  return values;
}

struct Creases {
  /// Torn edges, by key(a, b) with a < b: how much of the way from a to b is on a's side.
  std::unordered_map<std::uint64_t, double> shares;
  /// A bit per triangle of each vertex's ring, in ring order, that is set where a crease crosses the triangle.
  std::vector<std::uint32_t> crossed;

  [[nodiscard]] static std::uint64_t key(int a, int b) {
    return static_cast<std::uint64_t>(std::min(a, b)) << 32 | static_cast<std::uint32_t>(std::max(a, b));
  }
  [[nodiscard]] bool torn(int a, int b) const { return !shares.empty() && shares.contains(key(a, b)); }
  /// How much of the way from v to its neighbour n is on v's side: half, unless the edge is torn.
  [[nodiscard]] double share(int v, int n) const {
    const auto found = shares.find(key(v, n));
    return found == shares.end() ? 0.5 : v < n ? found->second : 1 - found->second;
  }
};

/// `targets_of` tells the targets of places; `places` and `targets` are the vertices' own.
Creases find_creases(const std::vector<OneRing>& rings, const std::vector<Vec2>& places,
                     const std::vector<Vec2>& targets,
                     const std::function<std::vector<Vec2>(const std::vector<Vec2>&)>& targets_of);

/// The mesh with vertices on both sides of a crease moved up to it, across it, and those around giving way: what is
/// between the two sides, and belongs to neither, becomes narrow. No triangle gets smaller than a tenth of what it was.
/// `slopes` are the wanted ones; `sides` say along which line a border vertex may move (zero: not at all).
std::vector<Vec2> drawn_to_creases(const Creases& creases, const std::vector<OneRing>& rings,
                                   const std::vector<std::array<int, 3>>& triangles, const std::vector<Vec2>& xy,
                                   const std::vector<Vec2>& slopes, const std::vector<Vec2>& sides);

}  // namespace lightmill::detail

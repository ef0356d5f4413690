#include "design/detail/one_ring.h"

#include <utility>

namespace lightmill::detail {

std::vector<OneRing> one_rings(int vertex_count, const std::vector<std::array<int, 3>>& triangles) {
  // Every triangle gives each of its corners one arc of the ring: from the next corner to the one after.
  std::vector<std::vector<std::pair<int, int>>> arcs(vertex_count);
  for (const auto& t : triangles) {
    for (int k = 0; k < 3; ++k) arcs[t[k]].emplace_back(t[(k + 1) % 3], t[(k + 2) % 3]);
  }
  std::vector<OneRing> rings(vertex_count);
  for (int v = 0; v < vertex_count; ++v) {
    const auto& own = arcs[v];
    if (own.empty()) continue;
    // An open ring starts at the arc whose start no other arc ends on.
    int start = own.front().first;
    bool closed = true;
    for (const auto& [from, to] : own) {
      bool reached = false;
      for (const auto& other : own) reached |= other.second == from;
      if (!reached) {
        start = from;
        closed = false;
      }
    }
    rings[v].closed = closed;
    rings[v].neighbours.push_back(start);
    int here = start;
    for (std::size_t step = 0; step < own.size(); ++step) {
      for (const auto& [from, to] : own) {
        if (from == here) {
          here = to;
          break;
        }
      }
      if (here == start) break;
      rings[v].neighbours.push_back(here);
    }
  }
  return rings;
}

}  // namespace lightmill::detail

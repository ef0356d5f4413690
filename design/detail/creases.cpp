#include "design/detail/creases.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace lightmill::detail {

namespace {

double doubled_area(const std::vector<Vec2>& p, const std::array<int, 3>& t) {
  const Vec2 ab = p[t[1]] - p[t[0]];
  const Vec2 ac = p[t[2]] - p[t[0]];
  return ab.x() * ac.y() - ab.y() * ac.x();
}

/// How far apart targets are over how far places are: what all but the torn edges of each vertex stay below.
std::vector<double> stretches(const std::vector<OneRing>& rings, const std::vector<Vec2>& places,
                              const std::vector<Vec2>& targets) {
  Box2 box, target_box;
  for (const Vec2& p : places) box.include(p);
  for (const Vec2& t : targets) target_box.include(t);
  const double mean = target_box.size().maxCoeff() / box.size().maxCoeff();
  std::vector<double> result(rings.size(), mean);
  std::vector<double> around;
  for (std::size_t v = 0; v < rings.size(); ++v) {
    around.clear();
    for (int n : rings[v].neighbours) {
      const double way = (places[n] - places[v]).norm();
      if (way > 0) around.push_back((targets[n] - targets[v]).norm() / way);
    }
    if (around.empty()) continue;
    // A crease beside the vertex takes at most about half of its neighbours away.
    const auto middle = around.begin() + static_cast<std::ptrdiff_t>((around.size() - 1) * 2 / 5);
    std::nth_element(around.begin(), middle, around.end());
    result[v] = std::max(mean, *middle);
  }
  return without_narrow_peaks(std::move(result), [&](std::size_t v) -> const std::vector<int>& { return rings[v].neighbours; });
}

}  // namespace

Creases find_creases(const std::vector<OneRing>& rings, const std::vector<Vec2>& places,
                     const std::vector<Vec2>& targets,
                     const std::function<std::vector<Vec2>(const std::vector<Vec2>&)>& targets_of) {
  const std::vector<double> stretch = stretches(rings, places, targets);
  struct Edge {
    int a, b;
    double low = 0, high = 1;  // the crease is between
  };
  std::vector<Edge> edges;
  for (std::size_t v = 0; v < rings.size(); ++v) {
    const int a = static_cast<int>(v);
    for (int b : rings[v].neighbours) {
      const double most = kTear * std::max(stretch[a], stretch[b]) * (places[b] - places[a]).norm();
      if (a < b && (targets[b] - targets[a]).norm() > most) edges.push_back({a, b});
    }
  }
  constexpr int kHalvings = 7;
  for (int halving = 0; halving < kHalvings && !edges.empty(); ++halving) {
    std::vector<Vec2> middles;
    for (const Edge& e : edges) middles.push_back(places[e.a] + (e.low + e.high) / 2 * (places[e.b] - places[e.a]));
    const std::vector<Vec2> there = targets_of(middles);
    for (std::size_t k = 0; k < edges.size(); ++k) {
      Edge& e = edges[k];
      const bool on_a_side = (there[k] - targets[e.a]).norm() < (there[k] - targets[e.b]).norm();
      (on_a_side ? e.low : e.high) = (e.low + e.high) / 2;
    }
  }
  Creases creases;
  for (const Edge& e : edges) creases.shares.emplace(Creases::key(e.a, e.b), (e.low + e.high) / 2);
  std::vector<char> concerned(rings.size(), 0);
  for (const Edge& e : edges) {
    concerned[e.a] = concerned[e.b] = 1;
    // The corners opposite the edge.
    for (int n : rings[e.a].neighbours) concerned[n] = 1;
  }
  creases.crossed.assign(rings.size(), 0);
  for (std::size_t v = 0; v < rings.size(); ++v) {
    if (!concerned[v]) continue;
    const auto& around = rings[v].neighbours;
    const int centre = static_cast<int>(v);
    for (int k = 0; k < rings[v].triangle_count(); ++k) {
      const int a = around[k];
      const int b = around[(k + 1) % around.size()];
      if (creases.torn(centre, a) || creases.torn(centre, b) || creases.torn(a, b))
        creases.crossed[v] |= std::uint32_t{1} << (k % 32);
    }
  }
  return creases;
}

std::vector<Vec2> drawn_to_creases(const Creases& creases, const std::vector<OneRing>& rings,
                                   const std::vector<std::array<int, 3>>& triangles, const std::vector<Vec2>& xy,
                                   const std::vector<Vec2>& slopes, const std::vector<Vec2>& sides) {
  constexpr double kApart = 0.12;  // of an edge, that vertices keep from the crease
  constexpr double kMost = 0.9;    // of an edge, that a vertex moves
  constexpr int kGivingRings = 6;
  constexpr double kLeastArea = 0.1;
  const std::size_t count = xy.size();
  std::vector<Vec2> move(count, Vec2::Zero());
  std::vector<char> drawn(count, 0);
  for (std::size_t v = 0; v < count; ++v) {
    double nearest = std::numeric_limits<double>::infinity();
    for (int n : rings[v].neighbours) {
      const auto found = creases.shares.find(Creases::key(static_cast<int>(v), n));
      if (found == creases.shares.end()) continue;
      // Both sides meet at the same height: the crease runs at right angles to the jump of the slopes.
      const Vec2 jump = slopes[n] - slopes[v];
      if (!(jump.norm() > 0)) continue;
      const Vec2 edge = xy[n] - xy[v];
      Vec2 across = jump.normalized();
      if (across.dot(edge) < 0) across = -across;
      const double way = creases.share(static_cast<int>(v), n) * edge.dot(across);
      if (way >= nearest) continue;
      nearest = way;
      const double length = std::clamp(way - kApart * edge.norm(), 0.0, kMost * edge.norm());
      move[v] = length * across;
      drawn[v] = 1;
    }
  }
  const auto allowed = [&](std::size_t v, const Vec2& way) {
    return rings[v].closed ? way : Vec2(sides[v] * sides[v].dot(way));
  };
  for (std::size_t v = 0; v < count; ++v) move[v] = allowed(v, move[v]);

  // Those around give way: the movement dies out over a few rings.
  std::vector<int> distance(count, kGivingRings + 1);
  std::vector<int> front;
  for (std::size_t v = 0; v < count; ++v) {
    if (!drawn[v]) continue;
    distance[v] = 0;
    front.push_back(static_cast<int>(v));
  }
  for (std::size_t k = 0; k < front.size(); ++k) {
    const int v = front[k];
    for (int n : rings[v].neighbours) {
      if (distance[n] <= distance[v] + 1 || distance[v] + 1 > kGivingRings) continue;
      distance[n] = distance[v] + 1;
      front.push_back(n);
    }
  }
  constexpr int kSweeps = 4 * kGivingRings;
  std::vector<Vec2> next = move;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (int v : front) {
      if (drawn[v]) continue;
      Vec2 sum = Vec2::Zero();
      for (int n : rings[v].neighbours) sum += move[n];
      next[v] = allowed(v, sum / static_cast<double>(rings[v].neighbours.size()));
    }
    std::swap(move, next);
    for (int v : front) {
      if (drawn[v]) move[v] = next[v];
    }
  }

  // Where the sides are too narrow for that, less of it.
  std::vector<Vec2> result(count);
  constexpr int kHalvings = 20;
  for (int halving = 0; halving <= kHalvings; ++halving) {
    for (std::size_t v = 0; v < count; ++v) result[v] = xy[v] + move[v];
    std::vector<char> back(count, 0);
    bool any = false;
    for (const auto& t : triangles) {
      if (doubled_area(result, t) >= kLeastArea * doubled_area(xy, t)) continue;
      for (int corner : t) back[corner] = 1;
      any = true;
    }
    if (!any) break;
    for (std::size_t v = 0; v < count; ++v) {
      if (back[v]) move[v] *= halving + 1 < kHalvings ? 0.7 : 0.0;
    }
  }
  return result;
}

}  // namespace lightmill::detail

#include "design/detail/power_diagram.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kBlock = 4096;
constexpr int kGhosts = 8;

std::vector<Vec2> with_ghosts(std::vector<Vec2> sites, double reach) {
  double site_reach = 0;
  for (const auto& s : sites) site_reach = std::max(site_reach, s.norm());
  // With the largest weight at 0, the power distance of a point of interest to some site is at most (site_reach +
  // reach)^2; to a ghost of weight 0 at distance d it is at least (d - reach)^2. Hence d > site_reach + 2 reach.
  const double distance = 4 * (site_reach + reach);
  for (int k = 0; k < kGhosts; ++k) {
    const double angle = 2 * kPi * (k + 0.31) / kGhosts;
    sites.emplace_back(distance * std::cos(angle), distance * std::sin(angle));
  }
  return sites;
}

}  // namespace

PowerDiagramBuilder::PowerDiagramBuilder(const std::vector<Vec2>& sites, double reach)
    : sites_(static_cast<int>(sites.size())), triangulation_(with_ghosts(sites, reach), kGhosts) {}

PowerDiagram PowerDiagramBuilder::build(const std::vector<double>& psi) {
  const int n = sites_;
  const std::vector<Vec2>& sites = triangulation_.sites();

  // Weights from potentials, shifted so that the largest is 0, as the ghosts' are.
  double largest = -std::numeric_limits<double>::infinity();
  std::vector<double> weights(sites.size(), 0);
  for (int i = 0; i < n; ++i) {
    weights[i] = sites[i].squaredNorm() - 2 * psi[i];
    largest = std::max(largest, weights[i]);
  }
  for (int i = 0; i < n; ++i) weights[i] -= largest;
  triangulation_.update(weights);
  const auto& triangles = triangulation_.triangles();
  const auto potential = [&](int i) { return i < n ? psi[i] : (sites[i].squaredNorm() - largest) / 2; };
  const auto is_border = [&](int t, int k) {
    const auto& triangle = triangles[t];
    return triangle.neighbours[k] > t && (triangle.corners[(k + 1) % 3] < n || triangle.corners[(k + 2) % 3] < n);
  };

  // Dual vertex of a triangle: x.(s_j - s_i) = psi_j - psi_i for its three sites; differences keep it accurate.
  PowerDiagram diagram;
  diagram.vertices.resize(triangles.size());
  const std::size_t blocks = (triangles.size() + kBlock - 1) / kBlock;
  std::vector<std::size_t> first(blocks + 1, 0);
  parallel_blocks(triangles.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    std::size_t borders = 0;
    for (std::size_t t = begin; t < end; ++t) {
      diagram.vertices[t] = Vec2(0, 0);
      if (!triangles[t].alive()) continue;
      const auto [i, j, k] = triangles[t].corners;
      const Vec2 u = sites[j] - sites[i];
      const Vec2 v = sites[k] - sites[i];
      const double p = potential(j) - potential(i);
      const double q = potential(k) - potential(i);
      const double det = u.x() * v.y() - u.y() * v.x();
      diagram.vertices[t] = {(p * v.y() - q * u.y()) / det, (u.x() * q - v.x() * p) / det};
      for (int side = 0; side < 3; ++side) borders += is_border(static_cast<int>(t), side);
    }
    first[begin / kBlock + 1] = borders;
  });
  std::partial_sum(first.begin(), first.end(), first.begin());

  // Each border once, from the triangle of lower number.
  diagram.edges.resize(first.back());
  diagram.site_distance.resize(first.back());
  parallel_blocks(triangles.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    std::size_t at = first[begin / kBlock];
    for (std::size_t t = begin; t < end; ++t) {
      if (!triangles[t].alive()) continue;
      for (int side = 0; side < 3; ++side) {
        if (!is_border(static_cast<int>(t), side)) continue;
        const int a = triangles[t].corners[(side + 1) % 3];
        const int b = triangles[t].corners[(side + 2) % 3];
        // The triangle lies left of a -> b, so that its dual vertex ends the border counter-clockwise about a.
        diagram.edges[at] = {a, b, triangles[t].neighbours[side], static_cast<int>(t)};
        diagram.site_distance[at++] = (sites[a] - sites[b]).norm();
      }
    }
  });

  diagram.first_edge.assign(n + 1, 0);
  for (const auto& edge : diagram.edges) {
    if (edge.a < n) ++diagram.first_edge[edge.a + 1];
    if (edge.b < n) ++diagram.first_edge[edge.b + 1];
  }
  std::partial_sum(diagram.first_edge.begin(), diagram.first_edge.end(), diagram.first_edge.begin());
  diagram.incident_edges.resize(diagram.first_edge.back());
  std::vector<std::size_t> next(diagram.first_edge.begin(), diagram.first_edge.end() - 1);
  for (std::size_t e = 0; e < diagram.edges.size(); ++e) {
    const auto& edge = diagram.edges[e];
    if (edge.a < n) diagram.incident_edges[next[edge.a]++] = static_cast<int>(e);
    if (edge.b < n) diagram.incident_edges[next[edge.b]++] = static_cast<int>(e);
  }
  for (const auto& [site, triangle] : triangulation_.hidden()) {
    const auto& corners = triangles[triangle].corners;
    const auto near = std::find_if(corners.begin(), corners.end(), [n](int s) { return s < n; });
    if (near != corners.end()) diagram.hidden.push_back({site, *near, triangle});
  }
  return diagram;
}

int cell_at(const PowerDiagram& diagram, const std::vector<Vec2>& sites, const std::vector<double>& psi, const Vec2& x,
            int hint) {
  const int n = static_cast<int>(sites.size());
  int cell = hint;
  double value = x.dot(sites[cell]) - psi[cell];
  for (;;) {
    int best = cell;
    for (std::size_t k = diagram.first_edge[cell]; k < diagram.first_edge[cell + 1]; ++k) {
      const DualEdge& edge = diagram.edges[diagram.incident_edges[k]];
      const int other = edge.a == cell ? edge.b : edge.a;
      if (other >= n) continue;
      const double v = x.dot(sites[other]) - psi[other];
      if (v > value) {
        value = v;
        best = other;
      }
    }
    if (best == cell) return cell;
    cell = best;
  }
}

}  // namespace lightmill::detail

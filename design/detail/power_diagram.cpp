#include "design/detail/power_diagram.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Regular_triangulation_2.h>
#include <CGAL/Spatial_sort_traits_adapter_2.h>
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/property_map.h>
#include <CGAL/spatial_sort.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;

/// The kernel with a floating-point filter before its power test, which has none of its own but interval arithmetic.
struct FilteredTraits : Kernel {
  struct Power_side_of_oriented_power_circle_2 : Kernel::Power_side_of_oriented_power_circle_2 {
    using Base = Kernel::Power_side_of_oriented_power_circle_2;
    using Base::operator();
    CGAL::Oriented_side operator()(const Kernel::Weighted_point_2& p, const Kernel::Weighted_point_2& q,
                                   const Kernel::Weighted_point_2& r, const Kernel::Weighted_point_2& t) const {
      struct Row {
        double x, y, z;
        double largest;  // of the terms that z is summed from, added up
      };
      const auto row = [&t](const Kernel::Weighted_point_2& a) -> Row {
        const double x = a.x() - t.x();
        const double y = a.y() - t.y();
        const double square = x * x + y * y;
        return {x, y, square - a.weight() + t.weight(), square + std::abs(a.weight()) + std::abs(t.weight())};
      };
      const Row a = row(p);
      const Row b = row(q);
      const Row c = row(r);
      const double determinant =
          a.z * (b.x * c.y - b.y * c.x) + b.z * (c.x * a.y - c.y * a.x) + c.z * (a.x * b.y - a.y * b.x);
      const double x = std::max({std::abs(a.x), std::abs(b.x), std::abs(c.x)});
      const double y = std::max({std::abs(a.y), std::abs(b.y), std::abs(c.y)});
      const double z = std::max({a.largest, b.largest, c.largest});
      // Six products of at most x y z, each with at most twelve roundings of 2^-53 relative to that bound, make 8e-15.
      const double bound = 2e-14 * x * y * z;
      if (determinant > bound) return CGAL::ON_POSITIVE_SIDE;
      if (determinant < -bound) return CGAL::ON_NEGATIVE_SIDE;
      return Base::operator()(p, q, r, t);
    }
  };
  [[nodiscard]] Power_side_of_oriented_power_circle_2 power_side_of_oriented_power_circle_2_object() const {
    return {};
  }
};

using VertexBase =
    CGAL::Regular_triangulation_vertex_base_2<FilteredTraits, CGAL::Triangulation_vertex_base_with_info_2<int, Kernel>>;
using FaceBase =
    CGAL::Regular_triangulation_face_base_2<FilteredTraits, CGAL::Triangulation_face_base_with_info_2<int, Kernel>>;
using Triangulation =
    CGAL::Regular_triangulation_2<FilteredTraits, CGAL::Triangulation_data_structure_2<VertexBase, FaceBase>>;

constexpr std::size_t kBlock = 4096;

}  // namespace

PowerDiagramBuilder::PowerDiagramBuilder(std::vector<Vec2> sites, double reach) : sites_(std::move(sites)) {
  double site_reach = 0;
  for (const auto& s : sites_) site_reach = std::max(site_reach, s.norm());
  // With the largest weight at 0, the power distance of a point of interest to some site is at most (site_reach +
  // reach)^2; to a ghost of weight 0 at distance d it is at least (d - reach)^2. Hence d > site_reach + 2 reach.
  const double distance = 4 * (site_reach + reach);
  for (int k = 0; k < 8; ++k) {
    const double angle = 2 * kPi * (k + 0.31) / 8;
    ghosts_.emplace_back(distance * std::cos(angle), distance * std::sin(angle));
  }

  std::vector<Kernel::Point_2> points;
  for (const auto& s : sites_) points.emplace_back(s.x(), s.y());
  order_.resize(sites_.size());
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  using Map = CGAL::Pointer_property_map<Kernel::Point_2>::type;
  using Traits = CGAL::Spatial_sort_traits_adapter_2<Kernel, Map>;
  CGAL::spatial_sort(order_.begin(), order_.end(), Traits(CGAL::make_property_map(points)));
}

PowerDiagram PowerDiagramBuilder::build(const std::vector<double>& psi) const {
  const int n = static_cast<int>(sites_.size());
  const int all = n + static_cast<int>(ghosts_.size());

  // Weights from potentials, shifted so that the largest is 0.
  double largest = -std::numeric_limits<double>::infinity();
  std::vector<double> weight(n);
  for (int i = 0; i < n; ++i) {
    weight[i] = sites_[i].squaredNorm() - 2 * psi[i];
    largest = std::max(largest, weight[i]);
  }
  std::vector<double> potential(psi);
  for (const auto& g : ghosts_) potential.push_back((g.squaredNorm() - largest) / 2);
  const auto site = [&](int i) -> const Vec2& { return i < n ? sites_[i] : ghosts_[i - n]; };

  Triangulation triangulation;
  Triangulation::Face_handle hint;
  const auto insert = [&](int i, double w) {
    const auto vertex = triangulation.insert({Kernel::Point_2(site(i).x(), site(i).y()), w}, hint);
    if (vertex == Triangulation::Vertex_handle()) return;
    vertex->info() = i;
    if (!vertex->is_hidden()) hint = vertex->face();
  };
  for (int i = n; i < all; ++i) insert(i, 0);
  for (const std::size_t i : order_) insert(static_cast<int>(i), weight[i] - largest);

  // Dual vertex of a face: x.(s_j - s_i) = psi_j - psi_i for its three sites; differences keep it accurate.
  PowerDiagram diagram;
  std::vector<std::array<int, 3>> corners;
  corners.reserve(2 * all);
  for (const auto face : triangulation.all_face_handles()) face->info() = -1;
  for (const auto face : triangulation.finite_face_handles()) {
    face->info() = static_cast<int>(corners.size());
    corners.push_back({face->vertex(0)->info(), face->vertex(1)->info(), face->vertex(2)->info()});
  }
  diagram.vertices.resize(corners.size());
  parallel_blocks(corners.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    for (std::size_t f = begin; f < end; ++f) {
      const auto [i, j, k] = corners[f];
      const Vec2 u = site(j) - site(i);
      const Vec2 v = site(k) - site(i);
      const double p = potential[j] - potential[i];
      const double q = potential[k] - potential[i];
      const double det = u.x() * v.y() - u.y() * v.x();
      diagram.vertices[f] = {(p * v.y() - q * u.y()) / det, (u.x() * q - v.x() * p) / det};
    }
  });

  // Each border once, from the face of lower number: CGAL's own order of edges depends on addresses in memory.
  diagram.edges.reserve(corners.size() * 3 / 2);
  for (const auto face : triangulation.finite_face_handles()) {
    for (int opposite = 0; opposite < 3; ++opposite) {
      const int neighbour = face->neighbor(opposite)->info();
      if (neighbour < face->info()) continue;
      const int a = face->vertex(Triangulation::ccw(opposite))->info();
      const int b = face->vertex(Triangulation::cw(opposite))->info();
      if (a >= n && b >= n) continue;
      // The face lies left of a -> b, so that its dual vertex ends the border counter-clockwise about a.
      diagram.edges.push_back({a, b, neighbour, face->info()});
    }
  }

  diagram.first_edge.assign(n + 1, 0);
  for (const auto& edge : diagram.edges) {
    if (edge.a < n) ++diagram.first_edge[edge.a + 1];
    if (edge.b < n) ++diagram.first_edge[edge.b + 1];
  }
  std::partial_sum(diagram.first_edge.begin(), diagram.first_edge.end(), diagram.first_edge.begin());
  diagram.incident_edges.resize(diagram.first_edge.back());
  diagram.site_distance.resize(diagram.edges.size());
  std::vector<std::size_t> next(diagram.first_edge.begin(), diagram.first_edge.end() - 1);
  for (std::size_t e = 0; e < diagram.edges.size(); ++e) {
    const auto& edge = diagram.edges[e];
    if (edge.a < n) diagram.incident_edges[next[edge.a]++] = static_cast<int>(e);
    if (edge.b < n) diagram.incident_edges[next[edge.b]++] = static_cast<int>(e);
    diagram.site_distance[e] = (site(edge.a) - site(edge.b)).norm();
  }
  return diagram;
}

}  // namespace lightmill::detail

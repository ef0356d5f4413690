#include "design/detail/natural_neighbour.h"

// CGAL's own checks look every face up in the whole triangulation: a millisecond per query.
#ifndef CGAL_NDEBUG
#define CGAL_NDEBUG
#endif
#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/natural_neighbor_coordinates_2.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "design/core/errors.h"
#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using VertexBase = CGAL::Triangulation_vertex_base_with_info_2<int, Kernel>;
using Triangulation = CGAL::Delaunay_triangulation_2<Kernel, CGAL::Triangulation_data_structure_2<VertexBase>>;
using Point = Kernel::Point_2;

struct SiteOf {
  SiteShare operator()(const std::pair<Triangulation::Vertex_handle, double>& neighbour) const {
    return {neighbour.first->info(), neighbour.second};
  }
};

}  // namespace

struct NaturalNeighbours::Delaunay {
  Triangulation triangulation;
  std::size_t sites = 0;
};

NaturalNeighbours::NaturalNeighbours(const std::vector<Vec2>& sites) : delaunay_(std::make_unique<Delaunay>()) {
  std::vector<std::pair<Point, int>> points;
  points.reserve(sites.size());
  for (std::size_t i = 0; i < sites.size(); ++i)
    points.emplace_back(Point(sites[i].x(), sites[i].y()), static_cast<int>(i));
  delaunay_->triangulation.insert(points.begin(), points.end());
  delaunay_->sites = sites.size();
  if (delaunay_->triangulation.dimension() != 2) {
    throw NumericalError("natural neighbour interpolation: the " + std::to_string(sites.size()) +
                         " sites lie on a line");
  }
}

NaturalNeighbours::~NaturalNeighbours() = default;
NaturalNeighbours::NaturalNeighbours(NaturalNeighbours&&) noexcept = default;

void NaturalNeighbours::each(const std::vector<Vec2>& queries,
                             const std::function<void(std::size_t, const std::vector<SiteShare>&)>& visit) const {
  const Triangulation& triangulation = delaunay_->triangulation;
  parallel_blocks(queries.size(), 2048, [&](std::size_t begin, std::size_t end) {
    std::vector<SiteShare> shares;
    Triangulation::Face_handle near;
    for (std::size_t q = begin; q < end; ++q) {
      const Point query(queries[q].x(), queries[q].y());
      near = triangulation.locate(query, near);  // queries come in rows: the walk from the last face is short
      shares.clear();
      const bool within =
          CGAL::natural_neighbor_coordinates_2(triangulation, query, std::back_inserter(shares), SiteOf(), near).third;
      double sum = 0;
      for (const SiteShare& share : shares) sum += share.second;
      // A query on a site's doorstep makes circumcentres of nearly collinear points: then the site itself is the
      // answer.
      if (within && sum > 0 && std::isfinite(sum)) {
        for (SiteShare& share : shares) share.second /= sum;
      } else {
        shares.assign(1, {triangulation.nearest_vertex(query, near)->info(), 1.0});
      }
      visit(q, shares);
    }
  });
}

std::vector<std::vector<int>> NaturalNeighbours::adjacent() const {
  std::vector<std::vector<int>> result(delaunay_->sites);
  const Triangulation& triangulation = delaunay_->triangulation;
  for (const auto& edge : triangulation.finite_edges()) {
    const int a = edge.first->vertex(Triangulation::cw(edge.second))->info();
    const int b = edge.first->vertex(Triangulation::ccw(edge.second))->info();
    result[a].push_back(b);
    result[b].push_back(a);
  }
  for (auto& sites : result) std::sort(sites.begin(), sites.end());
  return result;
}

std::vector<Vec2> natural_neighbour_interpolation(const std::vector<Vec2>& sites, const std::vector<Vec2>& values,
                                                  const std::vector<Vec2>& queries) {
  std::vector<Vec2> result(queries.size());
  NaturalNeighbours(sites).each(queries, [&](std::size_t q, const std::vector<SiteShare>& shares) {
    result[q].setZero();
    for (const auto& [site, share] : shares) result[q] += share * values[site];
  });
  return result;
}

}  // namespace lightmill::detail

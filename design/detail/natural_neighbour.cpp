#include "design/detail/natural_neighbour.h"

// CGAL's own checks look every face up in the whole triangulation: a millisecond per query.
#ifndef CGAL_NDEBUG
#define CGAL_NDEBUG
#endif
#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <CGAL/natural_neighbor_coordinates_2.h>

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

using SiteWeight = std::pair<int, double>;

struct SiteOf {
  SiteWeight operator()(const std::pair<Triangulation::Vertex_handle, double>& neighbour) const {
    return {neighbour.first->info(), neighbour.second};
  }
};

}  // namespace

std::vector<Vec2> natural_neighbour_interpolation(const std::vector<Vec2>& sites, const std::vector<Vec2>& values,
                                                  const std::vector<Vec2>& queries) {
  std::vector<std::pair<Point, int>> points;
  points.reserve(sites.size());
  for (std::size_t i = 0; i < sites.size(); ++i)
    points.emplace_back(Point(sites[i].x(), sites[i].y()), static_cast<int>(i));
  Triangulation triangulation;
  triangulation.insert(points.begin(), points.end());
  if (triangulation.dimension() != 2) {
    throw NumericalError("natural neighbour interpolation: the " + std::to_string(sites.size()) +
                         " sites lie on a line");
  }

  std::vector<Vec2> result(queries.size());
  parallel_blocks(queries.size(), 2048, [&](std::size_t begin, std::size_t end) {
    std::vector<SiteWeight> neighbours;
    Triangulation::Face_handle near;
    for (std::size_t q = begin; q < end; ++q) {
      const Point query(queries[q].x(), queries[q].y());
      near = triangulation.locate(query, near);  // queries come in rows: the walk from the last face is short
      neighbours.clear();
      const bool within =
          CGAL::natural_neighbor_coordinates_2(triangulation, query, std::back_inserter(neighbours), SiteOf(), near)
              .third;
      Vec2 sum = Vec2::Zero();
      double weight_sum = 0;
      for (const auto& [site, weight] : neighbours) {
        sum += weight * values[site];
        weight_sum += weight;
      }
      // A query on a site's doorstep makes circumcentres of nearly collinear points: then the site itself is the
      // answer.
      if (within && weight_sum > 0 && std::isfinite(weight_sum) && sum.allFinite()) {
        result[q] = sum / weight_sum;
      } else {
        result[q] = values[triangulation.nearest_vertex(query, near)->info()];
      }
    }
  });
  return result;
}

}  // namespace lightmill::detail

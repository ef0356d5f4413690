#include "design/detail/outline_mesh.h"

#include <CGAL/Constrained_Delaunay_triangulation_2.h>
#include <CGAL/Delaunay_mesh_face_base_2.h>
#include <CGAL/Delaunay_mesh_size_criteria_2.h>
#include <CGAL/Delaunay_mesh_vertex_base_2.h>
#include <CGAL/Delaunay_mesher_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>

namespace lightmill::detail {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Structure = CGAL::Triangulation_data_structure_2<CGAL::Delaunay_mesh_vertex_base_2<Kernel>,
                                                       CGAL::Delaunay_mesh_face_base_2<Kernel>>;
using Triangulation = CGAL::Constrained_Delaunay_triangulation_2<Kernel, Structure, CGAL::Exact_predicates_tag>;
using Criteria = CGAL::Delaunay_mesh_size_criteria_2<Triangulation>;
using Mesher = CGAL::Delaunay_mesher_2<Triangulation, Criteria>;
using Point = Kernel::Point_2;

}  // namespace

bool inside_outline(const std::vector<std::vector<Vec2>>& loops, const Vec2& place) {
  bool inside = false;
  for (const auto& loop : loops) {
    for (std::size_t k = 0; k < loop.size(); ++k) {
      const Vec2& a = loop[k];
      const Vec2& b = loop[(k + 1) % loop.size()];
      if ((a.y() > place.y()) == (b.y() > place.y())) continue;
      if (a.x() + (place.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x()) > place.x()) inside = !inside;
    }
  }
  return inside;
}

std::vector<Vec2> resampled(const std::vector<Vec2>& loop, double pitch_mm) {
  constexpr double kCorner = 0.35;   // rad
  constexpr double kNearest = 0.25;  // of the pitch, between two corners
  constexpr int kFewest = 6;         // for what is smaller than the pitch
  std::vector<Vec2> points;
  for (const Vec2& p : loop) {
    if (points.empty() || p != points.back()) points.push_back(p);
  }
  while (points.size() > 1 && points.front() == points.back()) points.pop_back();
  const std::size_t count = points.size();
  if (count < 3) return points;
  std::vector<double> along(count + 1, 0.0);  // arc length
  for (std::size_t k = 0; k < count; ++k) along[k + 1] = along[k] + (points[(k + 1) % count] - points[k]).norm();
  std::vector<std::size_t> corners;
  for (std::size_t k = 0; k < count; ++k) {
    const Vec2 before = points[k] - points[(k + count - 1) % count];
    const Vec2 after = points[(k + 1) % count] - points[k];
    const double turn = std::abs(std::atan2(before.x() * after.y() - before.y() * after.x(), before.dot(after)));
    const bool apart = corners.empty() || along[k] - along[corners.back()] > kNearest * pitch_mm;
    if (turn > kCorner && apart) corners.push_back(k);
  }
  if (corners.empty()) corners.push_back(0);
  std::vector<Vec2> result;
  for (std::size_t c = 0; c < corners.size(); ++c) {
    // From this corner to the next, around the loop's end for the last.
    const double from = along[corners[c]];
    const double to = c + 1 < corners.size() ? along[corners[c + 1]] : along[corners.front()] + along[count];
    const int fewest = corners.size() < 3 ? kFewest : 1;
    const int steps = std::max(fewest, static_cast<int>(std::lround((to - from) / pitch_mm)));
    std::size_t k = corners[c];
    for (int step = 0; step < steps; ++step) {
      const double place = from + (to - from) * step / steps;
      const auto end_of = [&](std::size_t edge) {
        return along[edge % count + 1] + (edge >= count ? along[count] : 0);
      };
      while (end_of(k) <= place && k + 1 < 2 * count) ++k;
      const Vec2& a = points[k % count];
      const Vec2& b = points[(k + 1) % count];
      const double length = (b - a).norm();
      const double share = 1 - (end_of(k) - place) / length;
      result.emplace_back(step == 0 ? points[corners[c]] : Vec2(a + share * (b - a)));
    }
  }
  return result;
}

PlanarMesh outline_mesh(const std::vector<std::vector<Vec2>>& loops, double edge_mm, const std::vector<Vec2>& inner) {
  Triangulation triangulation;
  for (const auto& loop : loops) {
    for (std::size_t k = 0; k < loop.size(); ++k) {
      const Vec2& a = loop[k];
      const Vec2& b = loop[(k + 1) % loop.size()];
      if (a != b) triangulation.insert_constraint(Point(a.x(), a.y()), Point(b.x(), b.y()));
    }
  }
  PlanarMesh mesh;
  if (triangulation.dimension() < 2) return mesh;

  // A seed in every bounded region that is not lens; regions are bordered by constraints.
  std::vector<Point> seeds;
  std::map<Triangulation::Face_handle, bool> seen;
  for (const auto start : triangulation.finite_face_handles()) {
    if (seen[start]) continue;
    const Point middle =
        CGAL::centroid(start->vertex(0)->point(), start->vertex(1)->point(), start->vertex(2)->point());
    const bool lens = inside_outline(loops, {middle.x(), middle.y()});
    bool bounded = true;
    std::deque<Triangulation::Face_handle> front{start};
    seen[start] = true;
    while (!front.empty()) {
      const auto face = front.front();
      front.pop_front();
      for (int k = 0; k < 3; ++k) {
        if (face->is_constrained(k)) continue;
        const auto next = face->neighbor(k);
        if (triangulation.is_infinite(next)) {
          bounded = false;
        } else if (!seen[next]) {
          seen[next] = true;
          front.push_back(next);
        }
      }
    }
    if (!lens && bounded) seeds.push_back(middle);
  }

  std::vector<Point> points;
  for (const Vec2& p : inner) points.emplace_back(p.x(), p.y());
  triangulation.insert(points.begin(), points.end());

  // Shape bound 1/8 (angles above 20.7 degrees where the outline allows it), for which refinement provably ends.
  Mesher mesher(triangulation, Criteria(0.125, edge_mm));
  mesher.set_seeds(seeds.begin(), seeds.end());
  mesher.refine_mesh();

  // Vertices by place: CGAL's own order may depend on addresses in memory.
  std::vector<Triangulation::Vertex_handle> order;
  for (const auto vertex : triangulation.finite_vertex_handles()) order.push_back(vertex);
  std::sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a->point() < b->point(); });
  std::map<Triangulation::Vertex_handle, int> number;
  for (const auto face : triangulation.finite_face_handles()) {
    if (!face->is_in_domain()) continue;
    for (int k = 0; k < 3; ++k) number[face->vertex(k)] = 0;
  }
  for (const auto& vertex : order) {
    const auto found = number.find(vertex);
    if (found == number.end()) continue;
    found->second = static_cast<int>(mesh.vertices.size());
    mesh.vertices.emplace_back(vertex->point().x(), vertex->point().y());
  }
  for (const auto face : triangulation.finite_face_handles()) {
    if (!face->is_in_domain()) continue;
    std::array<int, 3> t{number[face->vertex(0)], number[face->vertex(1)], number[face->vertex(2)]};
    std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
    mesh.triangles.push_back(t);
  }
  std::sort(mesh.triangles.begin(), mesh.triangles.end());
  return mesh;
}

}  // namespace lightmill::detail

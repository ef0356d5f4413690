#include "design/diagnostics.h"

#include <algorithm>
#include <cmath>

#include "design/detail/power_diagram.h"

namespace lightmill {

std::vector<double> mean_curvatures(const SurfaceMesh& mesh) {
  std::vector<double> curvatures;
  curvatures.reserve(mesh.triangles.size());
  for (const auto& t : mesh.triangles) {
    // Half the divergence of the normal, which is linear on the triangle.
    const Vec2 u = (mesh.vertices[t[1]] - mesh.vertices[t[0]]).head<2>();
    const Vec2 v = (mesh.vertices[t[2]] - mesh.vertices[t[0]]).head<2>();
    const Vec2 nu = (mesh.normals[t[1]] - mesh.normals[t[0]]).head<2>();
    const Vec2 nv = (mesh.normals[t[2]] - mesh.normals[t[0]]).head<2>();
    const double area = u.x() * v.y() - u.y() * v.x();
    const double divergence = (nu.x() * v.y() - nv.x() * u.y() + u.x() * nv.y() - v.x() * nu.y()) / area;
    curvatures.push_back(std::isfinite(divergence) ? divergence / 2 : 0);
  }
  return curvatures;
}

std::vector<std::array<Vec2, 2>> power_cell_borders(const std::vector<Vec2>& sites_mm, const std::vector<double>& weights_mm2,
                                                    const Box2& box) {
  double reach = std::max(box.min.norm(), box.max.norm()) * 2;
  std::vector<double> psi(sites_mm.size());
  for (std::size_t i = 0; i < psi.size(); ++i) {
    psi[i] = (sites_mm[i].squaredNorm() - weights_mm2[i]) / 2;
    reach = std::max(reach, sites_mm[i].norm());
  }
  const detail::PowerDiagram diagram = detail::PowerDiagramBuilder(sites_mm, reach).build(psi);
  std::vector<std::array<Vec2, 2>> borders;
  for (const detail::DualEdge& edge : diagram.edges) {
    if (std::max(edge.a, edge.b) >= static_cast<int>(sites_mm.size())) continue;
    // Cut by the box, side by side [Liang and Barsky 1984].
    const Vec2 from = diagram.vertices[edge.from];
    const Vec2 along = diagram.vertices[edge.to] - from;
    double first = 0;
    double last = 1;
    for (int axis = 0; axis < 2; ++axis) {
      for (const double side : {-1.0, 1.0}) {
        const double room = side < 0 ? from[axis] - box.min[axis] : box.max[axis] - from[axis];
        const double outwards = side * along[axis];
        if (outwards > 0) last = std::min(last, room / outwards);
        if (outwards < 0) first = std::max(first, room / outwards);
        if (outwards == 0 && room < 0) last = -1;
      }
    }
    if (first < last) borders.push_back({Vec2(from + first * along), Vec2(from + last * along)});
  }
  return borders;
}

std::vector<int> nearest_samples(const TransportMap& map, const std::vector<Vec2>& places) {
  const std::vector<Vec2>& samples = map.source_centroids_mm;
  Box2 box;
  for (const Vec2& p : samples) box.include(p);
  const int side = std::max(1, static_cast<int>(std::sqrt(static_cast<double>(samples.size()) / 2)));
  const Vec2 cell = (box.size() / side).cwiseMax(1e-9);
  const auto bucket = [&](const Vec2& p, int axis) {
    return static_cast<int>(std::clamp((p[axis] - box.min[axis]) / cell[axis], 0.0, side - 1.0));
  };
  std::vector<std::vector<int>> buckets(static_cast<std::size_t>(side) * side);
  for (std::size_t i = 0; i < samples.size(); ++i)
    buckets[static_cast<std::size_t>(bucket(samples[i], 1)) * side + bucket(samples[i], 0)].push_back(
        static_cast<int>(i));
  std::vector<int> nearest;
  for (const Vec2& p : places) {
    int best = -1;
    double least = std::numeric_limits<double>::infinity();
    const int column = bucket(p, 0);
    const int row = bucket(p, 1);
    // Rings of buckets until the next ring cannot hold a nearer one.
    for (int ring = 0; ring <= side; ++ring) {
      if (best >= 0 && std::sqrt(least) < (ring - 1) * cell.minCoeff()) break;
      for (int j = row - ring; j <= row + ring; ++j) {
        for (int i = column - ring; i <= column + ring; ++i) {
          if (std::max(std::abs(i - column), std::abs(j - row)) != ring || i < 0 || j < 0 || i >= side || j >= side)
            continue;
          for (const int s : buckets[static_cast<std::size_t>(j) * side + i]) {
            const double d = (samples[s] - p).squaredNorm();
            if (d < least) {
              least = d;
              best = s;
            }
          }
        }
      }
    }
    nearest.push_back(best);
  }
  return nearest;
}

}  // namespace lightmill

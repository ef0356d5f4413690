// Power diagrams of planar sites with exact predicates, as flat arrays of dual vertices and edges.
#pragma once

#include <cstddef>
#include <vector>

#include "design/core/geometry.h"
#include "design/detail/regular_triangulation.h"

namespace lightmill::detail {

/// The border between the cells of sites `a` and `b`, from vertex `from` to vertex `to`, counter-clockwise about `a`.
/// At least one of the two is a real site; an index of sites.size() or more is a ghost outside everything.
struct DualEdge {
  int a;
  int b;
  int from;
  int to;
};

/// A site without a cell: it lies above the triangle of visible sites that has this dual vertex.
struct HiddenSite {
  int site;
  int near;    ///< a visible real site of that triangle
  int vertex;
};

/// Cells {x : x.s_i - psi_i is largest}; a site without edges has an empty cell.
struct PowerDiagram {
  std::vector<Vec2> vertices;
  std::vector<DualEdge> edges;
  std::vector<double> site_distance;    ///< |s_a - s_b| per edge
  std::vector<std::size_t> first_edge;  ///< edges of site i: incident_edges[first_edge[i] .. first_edge[i + 1])
  std::vector<int> incident_edges;
  std::vector<HiddenSite> hidden;       ///< sites without a cell
};

/// The cell that contains x, by steepest ascent of x.s - psi over neighbours from `hint`, a site that has a cell.
int cell_at(const PowerDiagram& diagram, const std::vector<Vec2>& sites, const std::vector<double>& psi, const Vec2& x,
            int hint);

/// Builds power diagrams of fixed sites for varying potentials psi = (|s|^2 - w) / 2.
class PowerDiagramBuilder {
 public:
  /// `reach`: no point of interest x is farther than this from the origin.
  PowerDiagramBuilder(const std::vector<Vec2>& sites, double reach);

  /// Quick when psi differs little from the last one.
  [[nodiscard]] PowerDiagram build(const std::vector<double>& psi);

 private:
  int sites_;
  RegularTriangulation triangulation_;  // of the sites and, last, ghosts far away: they bound every real cell and never
                                        // reach a point of interest
};

}  // namespace lightmill::detail

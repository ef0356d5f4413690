// Regular triangulations of fixed sites under changing weights: built once, then repaired by flips.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// The regular triangulation of weighted sites in the plane, with exact predicates. Weights that change a little between
/// two calls cost a pass over all edges and the flips they ask for [Edelsbrunner and Shah 1996]; where flips do not lead to a
/// regular triangulation it is built anew.
class RegularTriangulation {
 public:
  /// The last `corners` sites are the convex hull of all, counter-clockwise; they shall never be hidden.
  RegularTriangulation(std::vector<Vec2> sites, int corners);

  /// Corner sites are counter-clockwise; neighbour k is opposite corner k, -1 outside the hull.
  struct Triangle {
    std::array<int, 3> corners;
    std::array<int, 3> neighbours;
    [[nodiscard]] bool alive() const { return corners[0] >= 0; }
  };

  /// Makes the triangulation regular for these weights.
  void update(const std::vector<double>& weights);

  /// Some may be dead: places that flips have left.
  [[nodiscard]] const std::vector<Triangle>& triangles() const { return triangles_; }
  [[nodiscard]] const std::vector<Vec2>& sites() const { return sites_; }
  /// Sites that are not part of it, each with the triangle that it lies in.
  struct Hidden {
    int site;
    int triangle;
  };
  [[nodiscard]] std::vector<Hidden> hidden() const;

 private:
  struct Edge {
    int triangle;
    int opposite;  // corner of the triangle
  };

  void build();
  bool repair();
  bool legalise();
  bool insert_hidden();
  [[nodiscard]] std::vector<Edge> irregular_edges() const;
  [[nodiscard]] bool in_conflict(const Triangle& t, int site) const;
  [[nodiscard]] bool regular(int triangle, int opposite) const;
  [[nodiscard]] int orientation(int a, int b, int c) const;
  [[nodiscard]] int degree(int site, int triangle) const;
  [[nodiscard]] int locate(int site) const;
  [[nodiscard]] int add(const Triangle& t);
  void place(int slot, const Triangle& t);
  void join(int triangle, int before, int after);
  void flip(int t, int k);
  void remove(int site, int triangle);
  void split(int t, int site);
  void push(int triangle);

  std::vector<Vec2> sites_;
  int corners_;
  std::vector<std::size_t> order_;  // of insertion, along a space-filling curve
  std::vector<double> weights_;
  std::vector<Triangle> triangles_;
  std::vector<int> free_;
  std::vector<int> triangle_of_;  // one at each visible site; -1 - (a site that was near) for hidden ones
  std::vector<int> hidden_;
  std::vector<Edge> queue_;
  bool stuck_ = false;  // an irregular edge could not be flipped at some time
};

}  // namespace lightmill::detail

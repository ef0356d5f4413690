// Sparse symmetric systems of graph Laplacians, by CHOLMOD's supernodal Cholesky factorisation.
#pragma once

#include <memory>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// A weighted edge between nodes a and b.
struct GraphEdge {
  int a;
  int b;
  double weight;
};

/// Factorised Laplacian (L x)_i = sum_j weight_ij (x_i - x_j) of a graph in the plane; constants are its kernel. Weights may
/// be below zero as long as x^T L x is not.
class Laplacian {
 public:
  /// Factorises. At least two nodes; the places need only be such that edges are short: the order of elimination is a nested
  /// dissection of the plane [George 1973]. Edges may lead to `hubs` more nodes, numbered after the others, which have any
  /// number of neighbours and are eliminated last. `rings`: how far edges reach, in neighbours of the plane. Throws
  /// NumericalError if the graph is not connected.
  Laplacian(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges, int hubs = 0, int rings = 1);
  ~Laplacian();
  Laplacian(Laplacian&&) noexcept;
  Laplacian& operator=(Laplacian&&) noexcept;

  /// The solution of mean zero, hubs left out; `rhs` must sum to zero and is zero at hubs.
  [[nodiscard]] std::vector<double> solve(const std::vector<double>& rhs) const;

 private:
  struct Factor;
  std::unique_ptr<Factor> factor_;
};

/// The connected component of every node, as the smallest node of it.
std::vector<int> connected_components(int nodes, const std::vector<GraphEdge>& edges);

/// Joins the first nodes of all components, by edges of this weight. It does not matter if what is solved for sums to zero on
/// each component.
void tie_parts(int nodes, double weight, std::vector<GraphEdge>& edges);

}  // namespace lightmill::detail

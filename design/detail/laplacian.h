// Sparse symmetric systems of graph Laplacians, by CHOLMOD's supernodal Cholesky factorisation.
#pragma once

#include <memory>
#include <vector>

namespace lightmill::detail {

/// A weighted edge between nodes a and b.
struct GraphEdge {
  int a;
  int b;
  double weight;
};

/// Factorised Laplacian (L x)_i = sum_j weight_ij (x_i - x_j) of a graph; constants are its kernel.
class Laplacian {
 public:
  /// Factorises. `nodes` >= 2. Throws NumericalError if the graph is not connected.
  Laplacian(int nodes, const std::vector<GraphEdge>& edges);
  ~Laplacian();
  Laplacian(Laplacian&&) noexcept;
  Laplacian& operator=(Laplacian&&) noexcept;

  /// The solution of mean zero; `rhs` must sum to zero.
  [[nodiscard]] std::vector<double> solve(const std::vector<double>& rhs) const;

 private:
  struct Factor;
  std::unique_ptr<Factor> factor_;
};

}  // namespace lightmill::detail

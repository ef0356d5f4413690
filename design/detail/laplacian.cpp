#include "design/detail/laplacian.h"

#include <Eigen/CholmodSupport>
#include <Eigen/SparseCore>

#include "design/core/errors.h"

namespace lightmill::detail {

struct Laplacian::Factor {
  int nodes = 0;
  Eigen::CholmodSupernodalLLT<Eigen::SparseMatrix<double>, Eigen::Lower> cholesky;
};

Laplacian::Laplacian(int nodes, const std::vector<GraphEdge>& edges) : factor_(std::make_unique<Factor>()) {
  factor_->nodes = nodes;
  // The last node is held at zero: a Laplacian is singular, without one node it is not.
  const int n = nodes - 1;
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(edges.size() + n);
  std::vector<double> diagonal(nodes, 0);
  for (const auto& [a, b, weight] : edges) {
    diagonal[a] += weight;
    diagonal[b] += weight;
    if (a < n && b < n) entries.emplace_back(std::max(a, b), std::min(a, b), -weight);
  }
  for (int i = 0; i < n; ++i) entries.emplace_back(i, i, diagonal[i]);
  Eigen::SparseMatrix<double> matrix(n, n);
  matrix.setFromTriplets(entries.begin(), entries.end());
  factor_->cholesky.cholmod().print = 0;
  factor_->cholesky.cholmod().quick_return_if_not_posdef = 1;
  factor_->cholesky.compute(matrix);
  if (factor_->cholesky.info() != Eigen::Success) throw NumericalError("a graph Laplacian is not positive definite");
}

Laplacian::~Laplacian() = default;
Laplacian::Laplacian(Laplacian&&) noexcept = default;
Laplacian& Laplacian::operator=(Laplacian&&) noexcept = default;

std::vector<double> Laplacian::solve(const std::vector<double>& rhs) const {
  const int n = factor_->nodes - 1;
  const Eigen::VectorXd x = factor_->cholesky.solve(Eigen::Map<const Eigen::VectorXd>(rhs.data(), n));
  const double mean = x.sum() / (n + 1);
  std::vector<double> result(n + 1, -mean);
  for (int i = 0; i < n; ++i) result[i] = x[i] - mean;
  return result;
}

}  // namespace lightmill::detail

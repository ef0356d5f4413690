#include "design/detail/laplacian.h"

#include <Eigen/CholmodSupport>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "design/core/errors.h"

namespace lightmill::detail {

namespace {

using Matrix = Eigen::SparseMatrix<double>;

constexpr double kMostFill = 4;  // entries of the factor over n log2 n; near 2.7 on neighbours in the plane

/// Orders the nodes of a graph for elimination: one half of the plane, the other half, then what separates them.
class NestedDissection {
 public:
  NestedDissection(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges) : nodes_(nodes) {
    first_.assign(nodes.size() + 1, 0);
    const int n = static_cast<int>(nodes.size());
    const auto to_hub = [n](const GraphEdge& edge) { return std::max(edge.a, edge.b) >= n; };
    for (const auto& edge : edges) {
      if (to_hub(edge)) continue;
      ++first_[edge.a + 1];
      ++first_[edge.b + 1];
    }
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    adjacent_.resize(first_.back());
    std::vector<int> next(first_.begin(), first_.end() - 1);
    for (const auto& edge : edges) {
      if (to_hub(edge)) continue;
      adjacent_[next[edge.a]++] = edge.b;
      adjacent_[next[edge.b]++] = edge.a;
    }
    part_.assign(nodes.size(), 0);
    order_.resize(nodes.size());
    std::iota(order_.begin(), order_.end(), 0);
    divide(order_.begin(), order_.end());
  }

  [[nodiscard]] std::vector<int> order() && { return std::move(order_); }

 private:
  using Place = std::vector<int>::iterator;
  static constexpr int kLeaf = 48;

  void divide(Place begin, Place end) {
    if (end - begin <= kLeaf) return;
    Box2 box;
    for (Place i = begin; i != end; ++i) box.include(nodes_[*i]);
    const int axis = box.size().x() >= box.size().y() ? 0 : 1;
    const Place middle = begin + (end - begin) / 2;
    std::nth_element(begin, middle, end, [&](int a, int b) {
      return std::pair(nodes_[a][axis], a) < std::pair(nodes_[b][axis], b);
    });
    ++stamp_;
    for (Place i = middle; i != end; ++i) part_[*i] = stamp_;
    // Nodes of the first half with a neighbour in the second separate the two; they go last.
    const auto separates = [&](int node) {
      return std::any_of(adjacent_.begin() + first_[node], adjacent_.begin() + first_[node + 1],
                         [&](int other) { return part_[other] == stamp_; });
    };
    const Place separator = std::stable_partition(begin, middle, [&](int node) { return !separates(node); });
    const Place last = std::rotate(separator, middle, end);
    std::sort(last, end, [&](int a, int b) {
      return std::pair(nodes_[a][1 - axis], a) < std::pair(nodes_[b][1 - axis], b);
    });
    divide(begin, separator);
    divide(separator, last);
  }

  const std::vector<Vec2>& nodes_;
  std::vector<int> first_;
  std::vector<int> adjacent_;
  std::vector<int> part_;
  std::vector<int> order_;
  int stamp_ = 0;
};

/// The lower half of the Laplacian in the given order, without its last node: a Laplacian is singular, without one node
/// it is not.
Matrix lower_half(const std::vector<GraphEdge>& edges, const std::vector<int>& place) {
  const int n = static_cast<int>(place.size()) - 1;
  std::vector<double> diagonal(n + 1, 0);
  std::vector<int> first(n + 2, 0);
  for (const auto& [a, b, weight] : edges) {
    const int column = std::min(place[a], place[b]);
    diagonal[place[a]] += weight;
    diagonal[place[b]] += weight;
    if (std::max(place[a], place[b]) < n) ++first[column + 1];
  }
  for (int i = 0; i < n; ++i) ++first[i + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  std::vector<std::pair<int, double>> entries(first[n]);
  std::vector<int> next(first.begin(), first.end() - 1);
  for (int i = 0; i < n; ++i) entries[next[i]++] = {i, diagonal[i]};
  for (const auto& [a, b, weight] : edges) {
    const int column = std::min(place[a], place[b]);
    const int row = std::max(place[a], place[b]);
    if (row < n) entries[next[column]++] = {row, -weight};
  }
  Matrix matrix(n, n);
  matrix.resizeNonZeros(static_cast<Eigen::Index>(entries.size()));
  int count = 0;
  for (int column = 0; column < n; ++column) {
    matrix.outerIndexPtr()[column] = count;
    const auto begin = entries.begin() + first[column];
    const auto end = entries.begin() + first[column + 1];
    std::sort(begin, end, [](const auto& x, const auto& y) { return x.first < y.first; });
    for (auto entry = begin; entry != end; ++entry) {
      if (entry != begin && matrix.innerIndexPtr()[count - 1] == entry->first) {
        matrix.valuePtr()[count - 1] += entry->second;
      } else {
        matrix.innerIndexPtr()[count] = entry->first;
        matrix.valuePtr()[count++] = entry->second;
      }
    }
  }
  matrix.outerIndexPtr()[n] = count;
  matrix.resizeNonZeros(count);
  return matrix;
}

}  // namespace

struct Laplacian::Factor {
  std::vector<int> order;
  Eigen::CholmodSupernodalLLT<Matrix, Eigen::Lower> cholesky;
};

Laplacian::Laplacian(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges, int hubs)
    : factor_(std::make_unique<Factor>()) {
  factor_->order = NestedDissection(nodes, edges).order();
  for (int k = 0; k < hubs; ++k) factor_->order.push_back(static_cast<int>(nodes.size()) + k);
  std::vector<int> place(factor_->order.size());
  for (std::size_t k = 0; k < place.size(); ++k) place[factor_->order[k]] = static_cast<int>(k);
  const Matrix matrix = lower_half(edges, place);
  auto& common = factor_->cholesky.cholmod();
  common.print = 0;
  common.quick_return_if_not_posdef = 1;
  common.nmethods = 1;
  common.method[0].ordering = CHOLMOD_NATURAL;
  common.postorder = 1;
  factor_->cholesky.analyzePattern(matrix);
  // Cells drawn out across black have neighbours far away on the source, where no straight cut is short.
  const auto n = static_cast<double>(nodes.size());
  if (common.lnz > kMostFill * n * std::log2(n)) {
    common.method[0].ordering = CHOLMOD_AMD;
    factor_->cholesky.analyzePattern(matrix);
  }
  factor_->cholesky.factorize(matrix);
  if (factor_->cholesky.info() != Eigen::Success) throw NumericalError("a graph Laplacian is not positive definite");
}

Laplacian::~Laplacian() = default;
Laplacian::Laplacian(Laplacian&&) noexcept = default;
Laplacian& Laplacian::operator=(Laplacian&&) noexcept = default;

std::vector<double> Laplacian::solve(const std::vector<double>& rhs) const {
  const std::vector<int>& order = factor_->order;
  const int nodes = static_cast<int>(rhs.size());
  const int n = static_cast<int>(order.size()) - 1;
  Eigen::VectorXd ordered(n);
  for (int k = 0; k < n; ++k) ordered[k] = order[k] < nodes ? rhs[order[k]] : 0;
  const Eigen::VectorXd x = factor_->cholesky.solve(ordered);
  std::vector<double> result(nodes, 0.0);
  for (int k = 0; k < n; ++k) {
    if (order[k] < nodes) result[order[k]] = x[k];
  }
  const double mean = std::accumulate(result.begin(), result.end(), 0.0) / nodes;
  for (double& value : result) value -= mean;
  return result;
}

std::vector<int> connected_components(int nodes, const std::vector<GraphEdge>& edges) {
  std::vector<int> root(nodes);
  std::iota(root.begin(), root.end(), 0);
  const auto find = [&](int i) {
    while (root[i] != i) i = root[i] = root[root[i]];
    return i;
  };
  for (const auto& edge : edges) {
    const int a = find(edge.a);
    const int b = find(edge.b);
    root[std::max(a, b)] = std::min(a, b);
  }
  for (int i = 0; i < nodes; ++i) root[i] = find(i);
  return root;
}

}  // namespace lightmill::detail

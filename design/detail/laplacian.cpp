#include "design/detail/laplacian.h"

#include <cholmod.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <iterator>
#include <numeric>
#include <utility>

#include "design/core/errors.h"
#include "design/core/one_blas_thread.h"
#include "design/core/parallel.h"

// The reference BLAS and LAPACK: C <- alpha A A^T + beta C, Cholesky's factor, and solutions with it.
extern "C" {
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha, const double* a,
            const int* lda, const double* beta, double* c, const int* ldc);
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dpotrs_(const char* uplo, const int* n, const int* nrhs, const double* a, const int* lda, double* b, const int* ldb,
             int* info);
}

namespace lightmill::detail {

namespace {

constexpr double kMostFill = 4;     // entries of the factor over rings^2 n log2 n; near 2.7 on neighbours in the plane
constexpr int kLeastForTwo = 4096;  // nodes, from which two halves are worth their border
constexpr double kWidestBorder = 6; // times sqrt(n): a wider one costs more than the second core saves

/// Orders the nodes of a graph for elimination: one half of the plane, the other half, then what separates them.
class NestedDissection {
 public:
  NestedDissection(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges) : nodes_(nodes) {
    first_.assign(nodes.size() + 1, 0);
    for (const auto& edge : edges) {
      ++first_[edge.a + 1];
      ++first_[edge.b + 1];
    }
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    adjacent_.resize(first_.back());
    std::vector<int> next(first_.begin(), first_.end() - 1);
    for (const auto& edge : edges) {
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

/// Where the nodes of a graph go: a half, the border between the halves that no edge crosses, or nowhere.
struct Halves {
  enum Side : char { kFirst, kSecond, kBorder, kGround };
  std::vector<Side> side;
  std::array<std::vector<int>, 2> inside;
  std::vector<int> border;
};

/// Cuts the graph at the median of its longer side; hubs are on the border. The last node is grounded: a Laplacian is
/// singular, without one node it is not.
Halves halves_of(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges, int hubs) {
  const int n = static_cast<int>(nodes.size());
  Halves halves;
  halves.side.assign(n + hubs, Halves::kFirst);
  std::fill(halves.side.begin() + n, halves.side.end(), Halves::kBorder);
  halves.side.back() = Halves::kGround;
  if (n >= kLeastForTwo) {
    Box2 box;
    for (const Vec2& node : nodes) box.include(node);
    const int axis = box.size().x() >= box.size().y() ? 0 : 1;
    const auto before = [&](int a, int b) { return std::pair(nodes[a][axis], a) < std::pair(nodes[b][axis], b); };
    std::vector<int> order(n);
    std::iota(order.begin(), order.end(), 0);
    std::nth_element(order.begin(), order.begin() + n / 2, order.end(), before);
    std::vector<Halves::Side> side = halves.side;
    for (int k = n / 2; k < n; ++k) {
      if (side[order[k]] == Halves::kFirst) side[order[k]] = Halves::kSecond;
    }
    int width = 0;
    for (auto [a, b, weight] : edges) {
      if (side[a] == Halves::kSecond) std::swap(a, b);
      if (side[a] != Halves::kFirst || side[b] != Halves::kSecond) continue;
      side[a] = Halves::kBorder;
      ++width;
    }
    if (width < kWidestBorder * std::sqrt(n)) halves.side = std::move(side);
  }
  for (int i = 0; i < n + hubs; ++i) {
    if (halves.side[i] == Halves::kBorder) halves.border.push_back(i);
    if (halves.side[i] <= Halves::kSecond) halves.inside[halves.side[i]].push_back(i);
  }
  return halves;
}

/// CHOLMOD's working state; its objects live as long as it.
class Workspace {
 public:
  Workspace() {
    cholmod_start(&common_);
    common_.print = 0;
    common_.quick_return_if_not_posdef = 1;
    common_.nmethods = 1;
  }
  ~Workspace() {
    cholmod_free_factor(&factor_, &common_);
    cholmod_finish(&common_);
  }
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  /// Orders and counts. Returns the order of elimination; `fill` becomes the number of entries of the factor.
  std::vector<int> ordered(cholmod_sparse* matrix, int ordering, double& fill) {
    analyse(matrix, ordering, 1, CHOLMOD_SIMPLICIAL);  // which is the quicker analysis
    fill = common_.lnz;
    const int* permutation = static_cast<const int*>(factor_->Perm);
    return {permutation, permutation + factor_->n};
  }
  /// Factorises in the order that the matrix has.
  void factorise(cholmod_sparse* matrix) {
    analyse(matrix, CHOLMOD_NATURAL, 0, CHOLMOD_SUPERNODAL);
    cholmod_factorize(matrix, factor_, &common_);
    if (common_.status != CHOLMOD_OK) throw NumericalError("a graph Laplacian is not positive definite");
  }
  [[nodiscard]] const cholmod_factor& factor() const { return *factor_; }
  /// In place: L^-1 b, or L^-T b.
  void solve(int system, std::vector<double>& b) {
    cholmod_dense right{};
    right.nrow = right.nzmax = right.d = b.size();
    right.ncol = 1;
    right.x = b.data();
    right.xtype = CHOLMOD_REAL;
    right.dtype = CHOLMOD_DOUBLE;
    cholmod_dense* x = cholmod_solve(system, factor_, &right, &common_);
    if (!x) throw NumericalError("out of memory while solving a graph Laplacian");
    std::copy_n(static_cast<const double*>(x->x), b.size(), b.begin());
    cholmod_free_dense(&x, &common_);
  }

 private:
  void analyse(cholmod_sparse* matrix, int ordering, int postorder, int kind) {
    cholmod_free_factor(&factor_, &common_);
    common_.supernodal = kind;
    common_.method[0].ordering = ordering;
    common_.postorder = postorder;
    factor_ = cholmod_analyze(matrix, &common_);
    if (!factor_) throw NumericalError("a graph Laplacian cannot be analysed");
  }
  cholmod_common common_{};
  cholmod_factor* factor_ = nullptr;
};

/// The lower half of a symmetric matrix by columns.
struct LowerHalf {
  std::vector<int> first;
  std::vector<int> rows;
  std::vector<double> values;

  [[nodiscard]] cholmod_sparse view() {
    cholmod_sparse matrix{};
    matrix.nrow = matrix.ncol = first.size() - 1;
    matrix.nzmax = rows.size();
    matrix.p = first.data();
    matrix.i = rows.data();
    matrix.x = values.data();
    matrix.stype = -1;
    matrix.itype = CHOLMOD_INT;
    matrix.xtype = CHOLMOD_REAL;
    matrix.dtype = CHOLMOD_DOUBLE;
    matrix.sorted = matrix.packed = 1;
    return matrix;
  }
};

/// Edges that are given twice add up.
LowerHalf lower_half(const std::vector<double>& diagonal, const std::vector<GraphEdge>& edges) {
  const int n = static_cast<int>(diagonal.size());
  LowerHalf matrix;
  std::vector<int> first(n + 1, 0);
  for (const auto& edge : edges) ++first[std::min(edge.a, edge.b) + 1];
  for (int i = 0; i < n; ++i) ++first[i + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  std::vector<std::pair<int, double>> entries(first[n]);
  std::vector<int> next(first.begin(), first.end() - 1);
  for (int i = 0; i < n; ++i) entries[next[i]++] = {i, diagonal[i]};
  for (const auto& [a, b, weight] : edges) entries[next[std::min(a, b)]++] = {std::max(a, b), -weight};
  matrix.first.reserve(n + 1);
  matrix.rows.reserve(entries.size());
  matrix.values.reserve(entries.size());
  for (int column = 0; column < n; ++column) {
    matrix.first.push_back(static_cast<int>(matrix.rows.size()));
    const auto begin = entries.begin() + first[column];
    const auto end = entries.begin() + first[column + 1];
    std::sort(begin, end, [](const auto& x, const auto& y) { return x.first < y.first; });
    for (auto entry = begin; entry != end; ++entry) {
      if (entry != begin && matrix.rows.back() == entry->first) {
        matrix.values.back() += entry->second;
      } else {
        matrix.rows.push_back(entry->first);
        matrix.values.push_back(entry->second);
      }
    }
  }
  matrix.first.push_back(static_cast<int>(matrix.rows.size()));
  return matrix;
}

/// The factor of one half and, behind it, of the border as this half alone changes it.
class HalfFactor {
 public:
  HalfFactor(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges, const std::vector<double>& diagonal,
             const Halves& halves, int which, int rings)
      : inside_(halves.inside[which]) {
    const OneBlasThread here_too;  // OpenMP's levels are each thread's own
    const int n = static_cast<int>(inside_.size());
    const int border = static_cast<int>(halves.border.size());
    std::vector<int> place(halves.side.size(), -1);
    std::vector<Vec2> places;
    places.reserve(n);
    for (const int node : inside_) {
      place[node] = static_cast<int>(places.size());
      places.push_back(nodes[node]);
    }
    for (int k = 0; k < border; ++k) place[halves.border[k]] = n + k;
    std::vector<GraphEdge> own;
    for (const auto& [a, b, weight] : edges) {
      if (place[a] >= 0 && place[b] >= 0) own.push_back({place[a], place[b], weight});
    }

    // First the half's own order, then the factor with the border behind it.
    const std::vector<int> order = order_of(places, own, rings);
    renumber(own, order, n);
    std::vector<int> reordered(n);
    for (int k = 0; k < n; ++k) reordered[k] = inside_[order[k]];
    inside_ = std::move(reordered);
    std::vector<double> pivots;
    for (const int node : inside_) pivots.push_back(diagonal[node]);
    for (const int node : halves.border) pivots.push_back(diagonal[node]);
    LowerHalf matrix = lower_half(pivots, own);
    own = {};
    cholmod_sparse view = matrix.view();
    workspace_.factorise(&view);
    keep_border(border);
  }

  /// Adds this half's own matrix of the border, lower half: B = L L^T.
  void add_border(std::vector<double>& sum, int border) const {
    const double one = 1;
    dsyrk_("L", "N", &border, &border, &one, border_.data(), &border, &one, sum.data(), &border);
  }
  /// Forward substitution; returns what it adds to the border's right side.
  std::vector<double> forward(const std::vector<double>& rhs, int border) {
    const OneBlasThread here_too;
    work_.assign(inside_.size() + border, 0.0);
    for (std::size_t k = 0; k < inside_.size(); ++k) work_[k] = inside_[k] < static_cast<int>(rhs.size()) ? rhs[inside_[k]] : 0;
    workspace_.solve(CHOLMOD_L, work_);
    // CHOLMOD has solved L_b z_b = -L_bi z_i; the left side is what the border gets.
    std::vector<double> added(border, 0.0);
    for (int column = 0; column < border; ++column) {
      const double z = work_[inside_.size() + column];
      for (int row = column; row < border; ++row) added[row] += entry(row, column, border) * z;
    }
    return added;
  }
  /// Back substitution, given the border's solution.
  void backward(const std::vector<double>& on_border, std::vector<double>& solution) {
    const OneBlasThread here_too;
    const int border = static_cast<int>(on_border.size());
    for (int column = 0; column < border; ++column) {
      double sum = 0;
      for (int row = column; row < border; ++row) sum += entry(row, column, border) * on_border[row];
      work_[inside_.size() + column] = sum;
    }
    workspace_.solve(CHOLMOD_Lt, work_);
    for (std::size_t k = 0; k < inside_.size(); ++k) {
      if (inside_[k] < static_cast<int>(solution.size())) solution[inside_[k]] = work_[k];
    }
  }

 private:
  /// The order in which the nodes are best eliminated; edges lead to the border too.
  std::vector<int> order_of(const std::vector<Vec2>& places, const std::vector<GraphEdge>& edges, int rings) {
    const int n = static_cast<int>(places.size());
    std::vector<GraphEdge> within;
    std::copy_if(edges.begin(), edges.end(), std::back_inserter(within),
                 [n](const GraphEdge& edge) { return std::max(edge.a, edge.b) < n; });
    const std::vector<int> order = NestedDissection(places, within).order();
    renumber(within, order, n);
    LowerHalf pattern = lower_half(std::vector<double>(n, 1.0), within);
    within = {};
    cholmod_sparse view = pattern.view();
    double fill = 0;
    std::vector<int> better = workspace_.ordered(&view, CHOLMOD_NATURAL, fill);
    // Cells drawn out across black have neighbours far away on the source, where no straight cut is short.
    if (fill > kMostFill * rings * rings * n * std::log2(n + 1.0)) better = workspace_.ordered(&view, CHOLMOD_AMD, fill);
    for (int& k : better) k = order[k];
    return better;
  }
  static void renumber(std::vector<GraphEdge>& edges, const std::vector<int>& order, int n) {
    std::vector<int> place(n);
    for (int k = 0; k < n; ++k) place[order[k]] = k;
    for (auto& edge : edges) {
      if (edge.a < n) edge.a = place[edge.a];
      if (edge.b < n) edge.b = place[edge.b];
    }
  }
  /// Takes the border's own triangle out of CHOLMOD's supernodes.
  void keep_border(int border) {
    border_.assign(static_cast<std::size_t>(border) * border, 0.0);
    const cholmod_factor& factor = workspace_.factor();
    const int n = static_cast<int>(factor.n) - border;
    const auto* super = static_cast<const int*>(factor.super);
    const auto* pattern = static_cast<const int*>(factor.pi);
    const auto* start = static_cast<const int*>(factor.px);
    const auto* rows = static_cast<const int*>(factor.s);
    const auto* values = static_cast<const double*>(factor.x);
    for (std::size_t s = factor.nsuper; s-- > 0 && super[s + 1] > n;) {
      const int height = pattern[s + 1] - pattern[s];
      for (int column = std::max(super[s], n); column < super[s + 1]; ++column) {
        const int across = column - super[s];
        for (int k = across; k < height; ++k) {
          const int row = rows[pattern[s] + k];
          border_[static_cast<std::size_t>(column - n) * border + (row - n)] =
              values[start[s] + static_cast<std::size_t>(across) * height + k];
        }
      }
    }
  }
  [[nodiscard]] double entry(int row, int column, int border) const {
    return border_[static_cast<std::size_t>(column) * border + row];
  }

  std::vector<int> inside_;  // in the order of elimination
  Workspace workspace_;
  std::vector<double> border_;  // lower triangle, by columns
  std::vector<double> work_;
};

}  // namespace

struct Laplacian::Factor {
  int nodes;
  std::vector<int> border;
  std::array<std::unique_ptr<HalfFactor>, 2> halves;  // the second may be missing
  std::vector<double> border_factor;                  // Cholesky's, by columns

  void for_each_half(const std::function<void(HalfFactor&, std::size_t)>& action) {
    parallel_blocks(halves.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        if (halves[k]) action(*halves[k], k);
      }
    });
  }
};

Laplacian::Laplacian(const std::vector<Vec2>& nodes, const std::vector<GraphEdge>& edges, int hubs, int rings)
    : factor_(std::make_unique<Factor>()) {
  const OneBlasThread one_blas_thread;
  const Halves halves = halves_of(nodes, edges, hubs);
  std::vector<double> diagonal(halves.side.size(), 0.0);
  for (const auto& [a, b, weight] : edges) {
    diagonal[a] += weight;
    diagonal[b] += weight;
  }
  factor_->nodes = static_cast<int>(nodes.size());
  factor_->border = halves.border;
  parallel_blocks(2, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      if (!halves.inside[k].empty())
        factor_->halves[k] = std::make_unique<HalfFactor>(nodes, edges, diagonal, halves, static_cast<int>(k), rings);
    }
  });
  // Each half has taken its part from the border's own matrix B; together they leave B1 + B2 - B.
  const int border = static_cast<int>(halves.border.size());
  if (border == 0) return;
  std::vector<double>& sum = factor_->border_factor;
  sum.assign(static_cast<std::size_t>(border) * border, 0.0);
  int count = 0;
  for (const auto& half : factor_->halves) {
    if (!half) continue;
    half->add_border(sum, border);
    ++count;
  }
  if (count != 1) {
    std::vector<int> place(halves.side.size(), -1);
    for (int k = 0; k < border; ++k) {
      place[halves.border[k]] = k;
      sum[static_cast<std::size_t>(k) * (border + 1)] -= (count - 1) * diagonal[halves.border[k]];
    }
    for (const auto& [a, b, weight] : edges) {
      if (place[a] < 0 || place[b] < 0) continue;
      const auto [low, high] = std::minmax(place[a], place[b]);
      sum[static_cast<std::size_t>(low) * border + high] += (count - 1) * weight;
    }
  }
  int info = 0;
  dpotrf_("L", &border, sum.data(), &border, &info);
  if (info != 0) throw NumericalError("a graph Laplacian is not positive definite");
}

Laplacian::~Laplacian() = default;
Laplacian::Laplacian(Laplacian&&) noexcept = default;
Laplacian& Laplacian::operator=(Laplacian&&) noexcept = default;

std::vector<double> Laplacian::solve(const std::vector<double>& rhs) const {
  const OneBlasThread one_blas_thread;
  const int border = static_cast<int>(factor_->border.size());
  std::array<std::vector<double>, 2> added;
  factor_->for_each_half([&](HalfFactor& half, std::size_t k) { added[k] = half.forward(rhs, border); });
  std::vector<double> on_border(border);
  for (int k = 0; k < border; ++k) {
    const int node = factor_->border[k];
    on_border[k] = node < factor_->nodes ? rhs[node] : 0;
    for (const auto& half : added) {
      if (!half.empty()) on_border[k] += half[k];
    }
  }
  if (border > 0) {
    const int one = 1;
    int info = 0;
    dpotrs_("L", &border, &one, factor_->border_factor.data(), &border, on_border.data(), &border, &info);
  }
  std::vector<double> solution(factor_->nodes, 0.0);
  for (int k = 0; k < border; ++k) {
    if (factor_->border[k] < factor_->nodes) solution[factor_->border[k]] = on_border[k];
  }
  factor_->for_each_half([&](HalfFactor& half, std::size_t) { half.backward(on_border, solution); });
  const double mean = std::accumulate(solution.begin(), solution.end(), 0.0) / factor_->nodes;
  for (double& value : solution) value -= mean;
  return solution;
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

void tie_parts(int nodes, double weight, std::vector<GraphEdge>& edges) {
  const std::vector<int> part = connected_components(nodes, edges);
  for (int node = 1; node < nodes; ++node) {
    if (part[node] == node) edges.push_back({0, node, weight});
  }
}

}  // namespace lightmill::detail

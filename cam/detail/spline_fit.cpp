// Fits the spline surface to the mesh: sparse normal equations, factorised in nested-dissection order.
#include <Eigen/CholmodSupport>
#include <Eigen/Geometry>
#include <Eigen/SparseCore>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <string>
#include <vector>

#include "cam/detail/spline_basis.h"
#include "cam/detail/spline_refinement.h"
#include "cam/spline_surface.h"
#include "design/core/one_blas_thread.h"
#include "design/core/parallel.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

// Of a slope times the edge length, against 1 for a height. The optimiser bends light at the vertex normals, so that
// normals are what the lens is made for; but angle-weighted normals differ from those of any smooth surface through the
// vertices by (edge / wavelength)^2, and heights must be kept, too. Measured on the portrait at mesh 321, with light
// traced through the spline's heights at 0.1 mm (the mesh itself: l1_error 0.0986):
//   weight  rms height  rms normal  l1_error   height beside a crease of jump 0.3, 1.5 edges off
//   0.1     0.07 um     977 urad    0.1066     1.6 um
//   1       0.17 um     385 urad    0.0987     4.1 um
//   10      0.24 um     158 urad    0.0969     (at 3: 4.4 um)
constexpr double kSlopeWeight = 1;
// No C2 surface of this resolution follows a crease: vertices that a first fit misses by more than about this slope over
// an edge (or kOffMedians times what half of the vertices are off) hardly count in the second, each by
// 1 / (1 + (miss / kOffSlope)^2)^2. Then the surface goes over from one side to the other within two edges, and nothing is
// pulled off farther away. The same light as above, in the five rings (l1_error of the mesh 0.029) and the portrait (0.092):
//   fits  rings   portrait  off by more than 1.5, 2, 2.5 edges beside a crease of jump 0.3, um
//   1     0.0745  0.0975    3.6    1.6    1.1
//   2     0.0460  0.0938    0.91   0.16   0.03
//   3     0.0450  0.0936    0.38   0.05   0.02
constexpr double kOffSlope = 1.6e-3;
constexpr double kOffMedians = 3;
constexpr int kFits = 2;
// With finer creases: vertices that weigh less than kMissed after that, and kAroundMissed edges around them, get spans of half an
// edge, where the whole surface then has at most kMostSpans along its longer side (what a mesh of 641 has). Light through the
// spline of the main job at mesh 321 (l1_error and light beside: mesh 0.0749, 0.107 %; spans of an edge 0.0955, 0.230 %):
//   finer fits  1: 0.0934, 0.150 %   2: 0.0877, 0.149 %   3: 0.0869, 0.154 %   4: 0.0868, 0.156 %
constexpr double kMissed = 0.25;
constexpr int kAroundMissed = 2;
constexpr int kMostSpans = 650;
constexpr int kFinerFits = 3;
// Neighbours whose slopes differ by so many times more than those around them are on two sides of a crease.
constexpr double kParted = 3.5;
// Second differences of the coefficients, against 1 for a vertex's height: decides only where no vertex does. The bias
// it brings where there are vertices is below 1e-6 of a coefficient's second difference.
constexpr double kSmoothing = 1e-6;
// Weight of "not a knot" at the lens's border. Any value from 1e-3 up gives the same surface.
constexpr double kEndCondition = 0.01;
// A vertex is a crease where the mesh's slopes within two edges leave a quadratic function of x and y by more than
// this, or where a vertex at most two edges away is one. A jump of slopes by a leaves 0.25 a (a is 0.16 at this
// threshold), a wave of slopes of amplitude S and length L leaves 0.4 S (2 pi edge / L)^3.
constexpr double kCreaseResidual = 0.04;

/// A coefficient meets others up to kReach away along one axis in the data, one more in the end conditions.
constexpr int kReach = 3;
constexpr int kFar = kReach + 1;
constexpr int kRow = 2 * kFar + 1;
/// Coefficients are solved for in squares of so many, each with so many more around it, all beyond as they were guessed: what is
/// wrong there (micrometres) fades by 0.4 a coefficient, by 0.73 where vertices are few. Squares agree within 0.001 um with the
/// whole, for a fraction of its memory.
constexpr int kSquare = 160;
constexpr int kAround = 32;
/// Coefficients that vertices hold by less than this are solved for once more, all together: there nothing fades.
constexpr double kHeld = 1e-3;
/// Of a symmetric stencil: from the middle on, row by row.
constexpr int kHalfStencil = kRow * kFar + kFar + 1;

double square(double x) {
  return x * x;
}

void check_mesh(const SurfaceMesh& mesh, const Box2& extent) {
  if (mesh.vertices.size() < 4 || mesh.triangles.empty()) throw InputError("spline fit: the mesh has no triangles");
  if (mesh.normals.size() != mesh.vertices.size()) throw InputError("spline fit: the mesh has no vertex normals");
  if (!(extent.size().x() > 0 && extent.size().y() > 0)) throw InputError("spline fit: the lens extent is empty");
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
    if (!mesh.vertices[v].allFinite() || !mesh.normals[v].allFinite()) {
      throw InputError("spline fit: vertex " + std::to_string(v) + " is not finite");
    }
    if (!(mesh.normals[v].z() > 0.05)) {
      throw InputError("spline fit: the normal of vertex " + std::to_string(v) + " leans over (z must be above 0.05) at x " +
                       fixed(mesh.vertices[v].x(), 2) + ", y " + fixed(mesh.vertices[v].y(), 2) +
                       " mm: the surface must be a height field; take another surface.mesh, or blunt lens.outline there");
    }
  }
}

/// Length of a square grid's edges that has as many triangles on the mesh's area over z = 0.
double mean_edge_mm(const SurfaceMesh& mesh) {
  double area = 0;
  for (const auto& t : mesh.triangles) {
    const Vec2 a = mesh.vertices[t[0]].head<2>();
    const Vec2 ab = mesh.vertices[t[1]].head<2>() - a;
    const Vec2 ac = mesh.vertices[t[2]].head<2>() - a;
    area += std::abs(ab.x() * ac.y() - ab.y() * ac.x()) / 2;
  }
  return std::sqrt(2 * area / static_cast<double>(mesh.triangles.size()));
}

/// Neighbours of every vertex along edges, sorted, as one array with offsets.
struct Adjacency {
  std::vector<int> offsets;
  std::vector<int> neighbours;
};

Adjacency adjacency(const SurfaceMesh& mesh) {
  const std::size_t count = mesh.vertices.size();
  std::vector<std::vector<int>> lists(count);
  for (const auto& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      lists[t[k]].push_back(t[(k + 1) % 3]);
      lists[t[k]].push_back(t[(k + 2) % 3]);
    }
  }
  Adjacency result;
  result.offsets.push_back(0);
  for (auto& list : lists) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    result.neighbours.insert(result.neighbours.end(), list.begin(), list.end());
    result.offsets.push_back(static_cast<int>(result.neighbours.size()));
  }
  return result;
}

/// Vertices near which the mesh's slopes jump (see kCreaseResidual).
std::vector<bool> crease_vertices(const SurfaceMesh& mesh, const std::vector<Vec2>& slopes, double edge_mm) {
  const Adjacency edges = adjacency(mesh);
  const int count = static_cast<int>(mesh.vertices.size());
  std::vector<bool> jump(count, false);
  std::vector<int> ring;
  for (int v = 0; v < count; ++v) {
    ring.assign(1, v);
    for (std::size_t done = 0, level = 0; level < 2; ++level) {
      const std::size_t end = ring.size();
      for (; done < end; ++done) {
        const int w = ring[done];
        for (int e = edges.offsets[w]; e < edges.offsets[w + 1]; ++e) ring.push_back(edges.neighbours[e]);
      }
    }
    std::sort(ring.begin(), ring.end());
    ring.erase(std::unique(ring.begin(), ring.end()), ring.end());

    // Quadratic least squares of the slopes over the ring, in edges about the vertex.
    using Row = Eigen::Matrix<double, 6, 1>;
    const auto row_of = [&](int w) {
      const Vec2 p = (mesh.vertices[w] - mesh.vertices[v]).head<2>() / edge_mm;
      return Row(1, p.x(), p.y(), p.x() * p.x(), p.x() * p.y(), p.y() * p.y());
    };
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 2> right = Eigen::Matrix<double, 6, 2>::Zero();
    for (const int w : ring) {
      const Row row = row_of(w);
      normal += row * row.transpose();
      right += row * (slopes[w] - slopes[v]).transpose();
    }
    normal.diagonal().array() += 1e-6;  // a mesh one cell wide
    const Eigen::Matrix<double, 6, 2> quadratic = normal.llt().solve(right);
    double worst = 0;
    for (const int w : ring) {
      worst = std::max(worst, (slopes[w] - slopes[v] - quadratic.transpose() * row_of(w)).norm());
    }
    jump[v] = worst > kCreaseResidual;
  }
  // What jumps here is felt two edges on.
  std::vector<bool> crease = jump;
  for (int level = 0; level < 2; ++level) {
    const std::vector<bool> before = crease;
    for (int v = 0; v < count; ++v) {
      for (int e = edges.offsets[v]; e < edges.offsets[v + 1] && !crease[v]; ++e)
        crease[v] = before[edges.neighbours[e]];
    }
  }
  return crease;
}

/// Order of elimination of a width x height grid of coefficients by nested dissection: separators as wide as the reach.
void dissect(int i0, int i1, int j0, int j1, int width, std::vector<int>& order) {
  const int ni = i1 - i0;
  const int nj = j1 - j0;
  if (ni <= 0 || nj <= 0) return;
  if (std::max(ni, nj) <= 4 * kReach) {
    for (int j = j0; j < j1; ++j) {
      for (int i = i0; i < i1; ++i) order.push_back(j * width + i);
    }
    return;
  }
  if (ni >= nj) {
    const int cut = i0 + (ni - kReach) / 2;
    dissect(i0, cut, j0, j1, width, order);
    dissect(cut + kReach, i1, j0, j1, width, order);
    for (int j = j0; j < j1; ++j) {
      for (int i = cut; i < cut + kReach; ++i) order.push_back(j * width + i);
    }
  } else {
    const int cut = j0 + (nj - kReach) / 2;
    dissect(i0, i1, j0, cut, width, order);
    dissect(i0, i1, cut + kReach, j1, width, order);
    for (int j = cut; j < cut + kReach; ++j) {
      for (int i = i0; i < i1; ++i) order.push_back(j * width + i);
    }
  }
}

using SparseMatrix = Eigen::SparseMatrix<double>;

/// Cholesky factor of a matrix given by its lower half, in the order of its rows.
class Factor : private Eigen::CholmodSupernodalLLT<SparseMatrix, Eigen::Lower> {
 public:
  explicit Factor(const SparseMatrix& matrix) {
    cholmod().nmethods = 1;
    cholmod().method[0].ordering = CHOLMOD_NATURAL;
    cholmod().postorder = 1;
    cholmod().print = 0;
    compute(matrix);
    if (info() != Eigen::Success) throw NumericalError("spline fit: the normal equations are not positive definite");
  }

  [[nodiscard]] Eigen::VectorXd solve(const Eigen::VectorXd& right) const { return CholmodSupernodalLLT::solve(right); }
};

/// The normal matrix as half a stencil per coefficient, and the right side.
struct NormalEquations {
  int width, height;
  std::vector<std::array<double, kHalfStencil>> stencils;
  Eigen::VectorXd right;
  const std::vector<bool>& free;  ///< coefficients to solve for; the others stay as guessed
  std::vector<bool> open;

  NormalEquations(int w, int h, const std::vector<bool>& to_solve_for)
      : width(w), height(h), stencils(static_cast<std::size_t>(w) * h), right(Eigen::VectorXd::Zero(w * h)), free(to_solve_for) {
    for (auto& s : stencils) s.fill(0);
  }

  /// Of (i, j) and (i + di, j + dj), which come in this order row by row: dj > 0, or dj = 0 and di >= 0.
  double& at(int i, int j, int di, int dj) { return stencils[static_cast<std::size_t>(j) * width + i][dj * kRow + di]; }
  [[nodiscard]] double at(int i, int j, int di, int dj) const { return stencils[static_cast<std::size_t>(j) * width + i][dj * kRow + di]; }

  /// Adds weight * (row . c - value)^2, row being the product of factors on 4 x 4 coefficients.
  void add(int i, int j, const double (&x)[4], const double (&y)[4], double value, double weight) {
    for (int b = 0; b < 4; ++b) {
      for (int a = 0; a < 4; ++a) {
        const double row = weight * x[a] * y[b];
        right[(j + b) * width + i + a] += row * value;
        double* stencil = &at(i + a, j + b, 0, 0);
        for (int c = a; c < 4; ++c) stencil[c - a] += row * x[c] * y[b];
        for (int d = b + 1; d < 4; ++d) {
          stencil += kRow;
          for (int c = 0; c < 4; ++c) stencil[c - a] += row * x[c] * y[d];
        }
      }
    }
  }

  /// Adds weight * (sum of factors * coefficients)^2 for places that come row by row.
  template <std::size_t N>
  void smooth(const std::array<std::array<int, 2>, N>& at_ij, const std::array<double, N>& factors, double weight) {
    for (std::size_t a = 0; a < N; ++a) {
      for (std::size_t b = a; b < N; ++b) {
        at(at_ij[a][0], at_ij[a][1], at_ij[b][0] - at_ij[a][0], at_ij[b][1] - at_ij[a][1]) += weight * factors[a] * factors[b];
      }
    }
  }

  /// Thin-plate energy of the coefficients.
  void add_smoothing(double weight) {
    for (int j = 0; j < height; ++j) {
      for (int i = 0; i < width; ++i) {
        if (i + 2 < width) {
          smooth<3>({{{i, j}, {i + 1, j}, {i + 2, j}}}, {1, -2, 1}, weight);
        }
        if (j + 2 < height) {
          smooth<3>({{{i, j}, {i, j + 1}, {i, j + 2}}}, {1, -2, 1}, weight);
        }
        if (i + 1 < width && j + 1 < height) {
          smooth<4>({{{i, j}, {i + 1, j}, {i, j + 1}, {i + 1, j + 1}}}, {1, -1, -1, 1}, 2 * weight);
        }
      }
    }
  }

  /// weight * (fourth difference)^2 of the five outermost coefficients of every row and column: the end condition "not
  /// a knot", where heights alone leave one coefficient open.
  void add_end_conditions(double weight) {
    const auto add_line = [&](int i, int j, int di, int dj) {
      std::array<std::array<int, 2>, 5> line;
      for (int a = 0; a < 5; ++a) line[a] = {i + a * di, j + a * dj};
      smooth<5>(line, {1, -4, 6, -4, 1}, weight);
    };
    for (int j = 0; j < height && width >= 5; ++j) {
      add_line(0, j, 1, 0);
      add_line(width - 5, j, 1, 0);
    }
    for (int i = 0; i < width && height >= 5; ++i) {
      add_line(i, 0, 0, 1);
      add_line(i, height - 5, 0, 1);
    }
  }

  /// Before smoothing and end conditions come in: which coefficients no vertex holds.
  void note_open() {
    open.resize(stencils.size());
    for (std::size_t k = 0; k < stencils.size(); ++k) open[k] = free[k] && stencils[k][0] < kHeld;
  }

  [[nodiscard]] Grid<double> solve(const Grid<double>& guess) const {
    const OneBlasThread one_blas_thread;
    Grid<double> coefficients = guess;
    Eigen::VectorXd missing = right - times(guess);
    const int across = std::max(1, width / kSquare), along = std::max(1, height / kSquare);
    parallel_blocks(static_cast<std::size_t>(across) * along, 1, [&](std::size_t begin, std::size_t end) {
      const OneBlasThread here_too;  // OpenMP's levels are each thread's own
      for (int square = static_cast<int>(begin); square < static_cast<int>(end); ++square) {
        const int a = square % across, b = square / across;
        const int i0 = width * a / across, i1 = width * (a + 1) / across, j0 = height * b / along, j1 = height * (b + 1) / along;
        std::vector<int> order;
        dissect(std::max(0, i0 - kAround), std::min(width, i1 + kAround), std::max(0, j0 - kAround), std::min(height, j1 + kAround), width, order);
        std::erase_if(order, [&](int k) { return !free[k]; });
        if (order.empty()) continue;
        const Eigen::VectorXd change = Factor(permuted_matrix(order)).solve(picked(missing, order));
        for (std::size_t k = 0; k < order.size(); ++k) {
          const int i = order[k] % width, j = order[k] / width;
          if (i >= i0 && i < i1 && j >= j0 && j < j1) coefficients.values[order[k]] += change[static_cast<Eigen::Index>(k)];
        }
      }
    });
    std::vector<int> order;
    dissect(0, width, 0, height, width, order);
    std::erase_if(order, [&](int k) { return !open[k]; });
    if (across * along == 1 || order.empty()) return coefficients;
    missing = right - times(coefficients);
    const Eigen::VectorXd change = Factor(permuted_matrix(order)).solve(picked(missing, order));
    for (std::size_t k = 0; k < order.size(); ++k) coefficients.values[order[k]] += change[static_cast<Eigen::Index>(k)];
    return coefficients;
  }

 private:
  /// The matrix times these coefficients.
  [[nodiscard]] Eigen::VectorXd times(const Grid<double>& coefficients) const {
    Eigen::VectorXd product = Eigen::VectorXd::Zero(right.size());
    for (int j = 0; j < height; ++j) {
      for (int i = 0; i < width; ++i) {
        for (int dj = 0; dj <= std::min(kFar, height - 1 - j); ++dj) {
          for (int di = std::max(dj > 0 ? -kFar : 0, -i); di <= std::min(kFar, width - 1 - i); ++di) {
            const double value = at(i, j, di, dj);
            const int here = j * width + i, there = here + dj * width + di;
            product[here] += value * coefficients.values[there];
            if (there != here) product[there] += value * coefficients.values[here];
          }
        }
      }
    }
    return product;
  }

  /// The lower half of these coefficients' equations, in their order.
  [[nodiscard]] SparseMatrix permuted_matrix(const std::vector<int>& order) const {
    std::vector<int> place(stencils.size(), -1);
    for (std::size_t k = 0; k < order.size(); ++k) place[order[k]] = static_cast<int>(k);
    const int count = static_cast<int>(order.size());
    SparseMatrix matrix(count, count);
    matrix.reserve(static_cast<Eigen::Index>(count) * (kReach * (2 * kReach + 1) + kReach + 1));
    std::vector<std::pair<int, double>> column;
    for (int k = 0; k < count; ++k) {
      const int i = order[k] % width, j = order[k] / width;
      column.clear();
      for (int dj = std::max(-kFar, -j); dj <= std::min(kFar, height - 1 - j); ++dj) {
        for (int di = std::max(-kFar, -i); di <= std::min(kFar, width - 1 - i); ++di) {
          const int row = place[(j + dj) * width + i + di];
          if (row < k) continue;
          const bool forward = dj > 0 || (dj == 0 && di >= 0);
          const double value = forward ? at(i, j, di, dj) : at(i + di, j + dj, -di, -dj);
          if (value != 0) column.emplace_back(row, value);
        }
      }
      std::sort(column.begin(), column.end());
      matrix.startVec(k);
      for (const auto& [row, value] : column) matrix.insertBack(row, k) = value;
    }
    matrix.finalize();
    return matrix;
  }

  static Eigen::VectorXd picked(const Eigen::VectorXd& all, const std::vector<int>& order) {
    Eigen::VectorXd some(static_cast<Eigen::Index>(order.size()));
    for (std::size_t k = 0; k < order.size(); ++k) some[static_cast<Eigen::Index>(k)] = all[order[k]];
    return some;
  }
};

/// Coefficients to begin with: the mean of the heights nearby, less `mean`.
Grid<double> nearby_heights(const SurfaceMesh& mesh, const Box2& extent, int spans_x, int spans_y, double mean) {
  const Vec2 per_mm(spans_x / extent.size().x(), spans_y / extent.size().y());
  Grid<double> sums(spans_x + 3, spans_y + 3, 0), shares(spans_x + 3, spans_y + 3, 0);
  for (const Vec3& p : mesh.vertices) {
    const detail::SplineBasis x = detail::spline_basis(p.x() - extent.min.x(), per_mm.x(), spans_x);
    const detail::SplineBasis y = detail::spline_basis(p.y() - extent.min.y(), per_mm.y(), spans_y);
    for (int b = 0; b < 4; ++b) {
      for (int a = 0; a < 4; ++a) {
        const double share = x.value[a] * y.value[b];
        sums.at(x.first + a, y.first + b) += share * (p.z() - mean);
        shares.at(x.first + a, y.first + b) += share;
      }
    }
  }
  for (std::size_t k = 0; k < sums.values.size(); ++k) sums.values[k] = shares.values[k] > 0 ? sums.values[k] / shares.values[k] : 0;
  return sums;
}

/// Where the surface shall be how high and how steep.
struct Place {
  Vec2 at;
  double height;
  Vec2 slope;
  bool slope_counts;  ///< a border vertex's leans on one side's triangles only: wrong by half an edge's curvature
};

std::vector<Place> vertex_places(const SurfaceMesh& mesh, const std::vector<Vec2>& slopes, const std::vector<bool>& border) {
  std::vector<Place> places;
  for (std::size_t v = 0; v < slopes.size(); ++v) {
    places.push_back({mesh.vertices[v].head<2>(), mesh.vertices[v].z(), slopes[v], !border[v]});
  }
  return places;
}

/// How far a surface misses a place in height and, times an edge, in slope.
double miss_mm(const Place& place, const SplineSurface& surface, double edge_mm) {
  const auto s = surface.sample(place.at.x(), place.at.y());
  return std::hypot(s.h - place.height, place.slope_counts ? edge_mm * (Vec2(s.hx, s.hy) - place.slope).norm() : 0);
}

/// How much a place counts, given how far a fit misses it (kOffSlope).
std::vector<double> weights_by_miss(const std::vector<Place>& places, const SplineSurface& surface, double edge_mm) {
  std::vector<double> miss(places.size());
  for (std::size_t k = 0; k < miss.size(); ++k) miss[k] = miss_mm(places[k], surface, edge_mm);
  std::vector<double> sorted = miss;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const double off = std::max(kOffSlope * edge_mm, kOffMedians * *middle);
  std::vector<double> weights(miss.size());
  for (std::size_t k = 0; k < miss.size(); ++k) weights[k] = 1 / square(1 + square(miss[k] / off));
  return weights;
}

/// A surface on its way: coefficients about a mean height, so that smoothing and rounding see the relief only.
struct Fit {
  Box2 extent;
  int spans_x, spans_y;
  double mean_mm;
  Grid<double> coefficients;
  std::vector<bool> free;  ///< coefficients to solve for

  [[nodiscard]] SplineSurface surface() const {
    Grid<double> heights = coefficients;
    for (double& c : heights.values) c += mean_mm;
    return {extent, spans_x, spans_y, std::move(heights)};
  }

  /// Of the coefficients that meet in a span.
  [[nodiscard]] bool any_free(int i, int j) const {
    for (int b = j; b < j + 4; ++b) {
      const auto row = free.begin() + static_cast<std::ptrdiff_t>(b) * coefficients.width + i;
      if (std::find(row, row + 4, true) != row + 4) return true;
    }
    return false;
  }

  /// Least squares over places that count by these weights.
  void solve(const std::vector<Place>& places, const std::vector<double>& weights, double slope_weight) {
    const Vec2 per_mm(spans_x / extent.size().x(), spans_y / extent.size().y());
    NormalEquations equations(spans_x + 3, spans_y + 3, free);
    for (std::size_t k = 0; k < places.size(); ++k) {
      const Place& place = places[k];
      const detail::SplineBasis x = detail::spline_basis(place.at.x() - extent.min.x(), per_mm.x(), spans_x);
      const detail::SplineBasis y = detail::spline_basis(place.at.y() - extent.min.y(), per_mm.y(), spans_y);
      if (!any_free(x.first, y.first)) continue;
      equations.add(x.first, y.first, x.value, y.value, place.height - mean_mm, weights[k]);
      if (!place.slope_counts) continue;
      equations.add(x.first, y.first, x.slope, y.value, place.slope.x(), weights[k] * slope_weight);
      equations.add(x.first, y.first, x.value, y.slope, place.slope.y(), weights[k] * slope_weight);
    }
    equations.note_open();
    equations.add_smoothing(kSmoothing);
    equations.add_end_conditions(kEndCondition);
    coefficients = equations.solve(coefficients);
  }
};

/// Places in the middle of edges, none across a crease: heights and slopes between those of the ends. Where `coarse` misses
/// neither end, what it is off by is interpolated rather than the surface itself, so that no detail is flattened. (Vertices alone
/// say three things of every four coefficients.)
std::vector<Place> edge_middles(const std::vector<Place>& vertices, const Adjacency& edges, const SplineSurface& coarse,
                                const std::vector<bool>& missed, double edge_mm) {
  std::vector<SplineSurface::Sample> samples;
  std::vector<Vec2> slopes;
  for (const Place& v : vertices) {
    samples.push_back(coarse.sample(v.at.x(), v.at.y()));
    slopes.push_back(v.slope_counts ? v.slope : Vec2(samples.back().hx, samples.back().hy));
  }
  const auto bend = [&](int a, int b) { return (slopes[b] - slopes[a]).norm() / (vertices[b].at - vertices[a].at).norm(); };
  std::vector<double> usual(vertices.size()), around;
  for (int v = 0; v < static_cast<int>(vertices.size()); ++v) {
    around.clear();
    for (int e = edges.offsets[v]; e < edges.offsets[v + 1]; ++e) around.push_back(bend(v, edges.neighbours[e]));
    if (around.empty()) continue;
    const auto low = around.begin() + static_cast<std::ptrdiff_t>((around.size() - 1) / 5);
    std::nth_element(around.begin(), low, around.end());
    usual[v] = std::max(*low, kOffSlope / edge_mm);
  }
  std::vector<Place> places;
  for (int a = 0; a < static_cast<int>(vertices.size()); ++a) {
    for (int e = edges.offsets[a]; e < edges.offsets[a + 1]; ++e) {
      const int b = edges.neighbours[e];
      if (b < a || bend(a, b) > kParted * std::max(usual[a], usual[b])) continue;
      const Vec2 way = vertices[b].at - vertices[a].at;
      Place middle{(vertices[a].at + vertices[b].at) / 2, (vertices[a].height + vertices[b].height) / 2 + (slopes[a] - slopes[b]).dot(way) / 8,
                   (slopes[a] + slopes[b]) / 2, true};
      if (!missed[a] && !missed[b]) {
        const auto at = [&](int v) { return Vec2(samples[v].hx, samples[v].hy); };
        const auto s = coarse.sample(middle.at.x(), middle.at.y());
        middle.height += s.h - (samples[a].h + samples[b].h) / 2 - (at(a) - at(b)).dot(way) / 8;
        middle.slope += Vec2(s.hx, s.hy) - (at(a) + at(b)) / 2;
      }
      places.push_back(middle);
    }
  }
  return places;
}

/// The coefficients within kAroundMissed edges of places that are missed.
std::vector<bool> coefficients_around(const std::vector<Place>& vertices, const std::vector<bool>& missed, const Fit& fit, double edge_mm) {
  const Vec2 span = fit.extent.size().cwiseQuotient(Vec2(fit.spans_x, fit.spans_y));
  const int width = fit.coefficients.width, height = fit.coefficients.height;
  std::vector<bool> result(fit.coefficients.values.size(), false);
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    if (!missed[v]) continue;
    const Vec2 low = (vertices[v].at - fit.extent.min - Vec2::Constant(kAroundMissed * edge_mm)).cwiseQuotient(span);
    const Vec2 high = (vertices[v].at - fit.extent.min + Vec2::Constant(kAroundMissed * edge_mm)).cwiseQuotient(span);
    for (int j = std::max(0, static_cast<int>(std::ceil(low.y())) + 1); j <= std::min(height - 1, static_cast<int>(high.y()) + 1); ++j) {
      for (int i = std::max(0, static_cast<int>(std::ceil(low.x())) + 1); i <= std::min(width - 1, static_cast<int>(high.x()) + 1); ++i) {
        result[static_cast<std::size_t>(j) * width + i] = true;
      }
    }
  }
  return result;
}

SplineFitSummary summed_up(const FitErrors& errors, const std::vector<bool>& crease, const std::vector<bool>& border) {
  SplineFitSummary summary;
  double height_sum = 0, normal_sum = 0;
  std::size_t smooth = 0, smooth_inside = 0;
  for (std::size_t v = 0; v < errors.height_um.size(); ++v) {
    summary.max_deviation_um = std::max(summary.max_deviation_um, std::abs(errors.height_um[v]));
    if (crease[v]) continue;
    ++smooth;
    height_sum += errors.height_um[v] * errors.height_um[v];
    if (border[v]) continue;
    ++smooth_inside;
    normal_sum += errors.normal_urad[v] * errors.normal_urad[v];
  }
  summary.crease_share = 1 - static_cast<double>(smooth) / static_cast<double>(errors.height_um.size());
  if (smooth > 0) summary.rms_deviation_um = std::sqrt(height_sum / static_cast<double>(smooth));
  if (smooth_inside > 0) summary.rms_normal_deviation_urad = std::sqrt(normal_sum / static_cast<double>(smooth_inside));
  return summary;
}

}  // namespace

FitErrors fit_errors(const SurfaceMesh& mesh, const SplineSurface& surface) {
  FitErrors errors;
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
    const Vec3& p = mesh.vertices[v];
    const auto s = surface.sample(p.x(), p.y());
    const Vec3 own(-s.hx, -s.hy, 1);
    errors.height_um.push_back(1e3 * (s.h - p.z()));
    errors.normal_urad.push_back(1e6 * std::atan2(own.cross(mesh.normals[v]).norm(), own.dot(mesh.normals[v])));
  }
  return errors;
}

SplineFit fit_spline(const SurfaceMesh& mesh, const Box2& extent, const SplineFitOptions& options, const Monitor& monitor) {
  const auto start = std::chrono::steady_clock::now();
  check_mesh(mesh, extent);
  monitor.report("fitting the spline surface", 0);

  // One span per edge of the mesh.
  const double edge_mm = mean_edge_mm(mesh);
  if (!(edge_mm > 0)) throw InputError("spline fit: the mesh has no area over z = 0");
  const int spans_x = std::max(1, static_cast<int>(std::lround(extent.size().x() / edge_mm)));
  const int spans_y = std::max(1, static_cast<int>(std::lround(extent.size().y() / edge_mm)));

  std::vector<Vec2> slopes(mesh.vertices.size());
  for (std::size_t v = 0; v < slopes.size(); ++v) slopes[v] = -mesh.normals[v].head<2>() / mesh.normals[v].z();
  double mean = 0;
  for (const Vec3& p : mesh.vertices) mean += p.z();
  mean /= static_cast<double>(mesh.vertices.size());

  const std::vector<bool> border = border_vertices(mesh);
  const std::vector<Place> vertices = vertex_places(mesh, slopes, border);
  std::vector<double> weights(vertices.size(), 1.0);
  Fit solution{extent, spans_x, spans_y, mean, nearby_heights(mesh, extent, spans_x, spans_y, mean), {}};
  solution.free.assign(solution.coefficients.values.size(), true);
  for (int n = 0; n < kFits; ++n) {
    solution.solve(vertices, weights, kSlopeWeight * edge_mm * edge_mm);
    monitor.report("fitting the spline surface", 0.25 * (n + 1));
    weights = weights_by_miss(vertices, solution.surface(), edge_mm);
  }
  std::vector<bool> missed(vertices.size());
  for (std::size_t v = 0; v < missed.size(); ++v) missed[v] = weights[v] < kMissed;
  if (options.finer_creases && 2 * std::max(spans_x, spans_y) <= kMostSpans && std::find(missed.begin(), missed.end(), true) != missed.end()) {
    const SplineSurface coarse = solution.surface();
    std::vector<Place> places = edge_middles(vertices, adjacency(mesh), coarse, missed, edge_mm);
    places.insert(places.end(), vertices.begin(), vertices.end());
    solution = {extent, 2 * spans_x, 2 * spans_y, mean, detail::with_spans_halved(solution.coefficients), {}};
    solution.free = coefficients_around(vertices, missed, solution, edge_mm);
    weights.assign(places.size(), 1.0);
    for (int n = 0; n < kFinerFits; ++n) {
      if (n > 0) weights = weights_by_miss(places, solution.surface(), edge_mm / 2);
      solution.solve(places, weights, kSlopeWeight * edge_mm * edge_mm / 4);
      monitor.report("fitting the spline surface", 0.5 + 0.5 * (n + 1) / kFinerFits);
    }
  }

  SplineFit fit{solution.surface(), {}};
  fit.summary = summed_up(fit_errors(mesh, fit.surface), crease_vertices(mesh, slopes, edge_mm), border);
  fit.summary.crease_width_mm = 2 * fit.surface.span_mm().maxCoeff();
  fit.summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  monitor.report("fitting the spline surface", 1);
  return fit;
}

}  // namespace lightmill

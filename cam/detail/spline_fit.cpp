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
#include "cam/spline_surface.h"

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
constexpr int kStencil = 2 * kFar + 1;

void check_mesh(const SurfaceMesh& mesh, const Box2& extent) {
  if (mesh.vertices.size() < 4 || mesh.triangles.empty()) throw InputError("spline fit: the mesh has no triangles");
  if (mesh.normals.size() != mesh.vertices.size()) throw InputError("spline fit: the mesh has no vertex normals");
  if (!(extent.size().x() > 0 && extent.size().y() > 0)) throw InputError("spline fit: the lens extent is empty");
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
    if (!mesh.vertices[v].allFinite() || !mesh.normals[v].allFinite()) {
      throw InputError("spline fit: vertex " + std::to_string(v) + " is not finite");
    }
    if (!(mesh.normals[v].z() > 0.05)) {
      throw InputError("spline fit: the normal of vertex " + std::to_string(v) +
                       " leans over (z must be above 0.05): the surface must be a height field");
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

/// The normal matrix as a stencil per coefficient, and the right side.
struct NormalEquations {
  int width, height;
  std::vector<std::array<double, kStencil * kStencil>> stencils;
  Eigen::VectorXd right;

  NormalEquations(int w, int h)
      : width(w), height(h), stencils(static_cast<std::size_t>(w) * h), right(Eigen::VectorXd::Zero(w * h)) {
    for (auto& s : stencils) s.fill(0);
  }

  double& at(int i, int j, int di, int dj) {
    return stencils[static_cast<std::size_t>(j) * width + i][(dj + kFar) * kStencil + di + kFar];
  }

  /// Adds weight * (row . c - value)^2, row being the product of factors on 4 x 4 coefficients.
  void add(int i, int j, const double (&x)[4], const double (&y)[4], double value, double weight) {
    for (int b = 0; b < 4; ++b) {
      for (int a = 0; a < 4; ++a) {
        const double row = weight * x[a] * y[b];
        right[(j + b) * width + i + a] += row * value;
        double* stencil = &at(i + a, j + b, -a, -b);
        for (int d = 0; d < 4; ++d, stencil += kStencil) {
          for (int c = 0; c < 4; ++c) stencil[c] += row * x[c] * y[d];
        }
      }
    }
  }

  /// Adds weight * (sum of factors * coefficients)^2 for three coefficients.
  void smooth(const std::array<std::array<int, 2>, 4>& at_ij, const std::array<double, 4>& factors, double weight) {
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        if (factors[a] == 0 || factors[b] == 0) continue;
        at(at_ij[a][0], at_ij[a][1], at_ij[b][0] - at_ij[a][0], at_ij[b][1] - at_ij[a][1]) +=
            weight * factors[a] * factors[b];
      }
    }
  }

  /// Thin-plate energy of the coefficients.
  void add_smoothing(double weight) {
    for (int j = 0; j < height; ++j) {
      for (int i = 0; i < width; ++i) {
        if (i + 2 < width) {
          smooth({{{i, j}, {i + 1, j}, {i + 2, j}, {i, j}}}, {1, -2, 1, 0}, weight);
        }
        if (j + 2 < height) {
          smooth({{{i, j}, {i, j + 1}, {i, j + 2}, {i, j}}}, {1, -2, 1, 0}, weight);
        }
        if (i + 1 < width && j + 1 < height) {
          smooth({{{i, j}, {i + 1, j}, {i, j + 1}, {i + 1, j + 1}}}, {1, -1, -1, 1}, 2 * weight);
        }
      }
    }
  }

  /// weight * (fourth difference)^2 of the five outermost coefficients of every row and column: the end condition "not
  /// a knot", where heights alone leave one coefficient open.
  void add_end_conditions(double weight) {
    constexpr double kFactors[5] = {1, -4, 6, -4, 1};
    const auto add_line = [&](int i, int j, int di, int dj) {
      for (int a = 0; a < 5; ++a) {
        for (int b = 0; b < 5; ++b) {
          at(i + a * di, j + a * dj, (b - a) * di, (b - a) * dj) += weight * kFactors[a] * kFactors[b];
        }
      }
    };
    for (int j = 0; j < height && width >= 5; ++j) {
      add_line(0, j, 1, 0);
      add_line(width - 1, j, -1, 0);
    }
    for (int i = 0; i < width && height >= 5; ++i) {
      add_line(i, 0, 0, 1);
      add_line(i, height - 1, 0, -1);
    }
  }

  [[nodiscard]] Grid<double> solve() const {
    std::vector<int> order;
    order.reserve(stencils.size());
    dissect(0, width, 0, height, width, order);
    std::vector<int> place(order.size());
    for (std::size_t k = 0; k < order.size(); ++k) place[order[k]] = static_cast<int>(k);

    const int count = width * height;
    std::vector<Eigen::Triplet<double>> entries;
    entries.reserve(stencils.size() * (kStencil * kStencil / 2 + 1));
    for (int j = 0; j < height; ++j) {
      for (int i = 0; i < width; ++i) {
        const int column = place[j * width + i];
        for (int dj = -kFar; dj <= kFar; ++dj) {
          for (int di = -kFar; di <= kFar; ++di) {
            const double value = stencils[static_cast<std::size_t>(j) * width + i][(dj + kFar) * kStencil + di + kFar];
            if (value == 0) continue;
            const int row = place[(j + dj) * width + i + di];
            if (row >= column) entries.emplace_back(row, column, value);
          }
        }
      }
    }
    Eigen::SparseMatrix<double> matrix(count, count);
    matrix.setFromTriplets(entries.begin(), entries.end());
    entries = {};

    Eigen::CholmodSupernodalLLT<Eigen::SparseMatrix<double>, Eigen::Lower> solver;
    solver.cholmod().nmethods = 1;
    solver.cholmod().method[0].ordering = CHOLMOD_NATURAL;
    solver.cholmod().postorder = 1;
    solver.cholmod().print = 0;
    solver.compute(matrix);
    if (solver.info() != Eigen::Success)
      throw NumericalError("spline fit: the normal equations are not positive definite");
    Eigen::VectorXd permuted(count);
    for (int k = 0; k < count; ++k) permuted[k] = right[order[k]];
    const Eigen::VectorXd solution = solver.solve(permuted);
    Grid<double> coefficients(width, height);
    for (int k = 0; k < count; ++k) coefficients.values[order[k]] = solution[k];
    return coefficients;
  }
};

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

SplineFit fit_spline(const SurfaceMesh& mesh, const Box2& extent, const Monitor& monitor) {
  const auto start = std::chrono::steady_clock::now();
  check_mesh(mesh, extent);
  monitor.report("fitting the spline surface", 0);

  // One span per edge of the mesh.
  const double edge_mm = mean_edge_mm(mesh);
  if (!(edge_mm > 0)) throw InputError("spline fit: the mesh has no area over z = 0");
  const int spans_x = std::max(1, static_cast<int>(std::lround(extent.size().x() / edge_mm)));
  const int spans_y = std::max(1, static_cast<int>(std::lround(extent.size().y() / edge_mm)));
  const Vec2 per_mm(spans_x / extent.size().x(), spans_y / extent.size().y());

  std::vector<Vec2> slopes(mesh.vertices.size());
  for (std::size_t v = 0; v < slopes.size(); ++v) slopes[v] = -mesh.normals[v].head<2>() / mesh.normals[v].z();

  // Heights about their mean, so that the smoothing and rounding see the relief only.
  double mean = 0;
  for (const Vec3& p : mesh.vertices) mean += p.z();
  mean /= static_cast<double>(mesh.vertices.size());

  const std::vector<bool> border = border_vertices(mesh);
  NormalEquations equations(spans_x + 3, spans_y + 3);
  const double slope_weight = kSlopeWeight * edge_mm * edge_mm;
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
    const Vec3& p = mesh.vertices[v];
    const detail::SplineBasis x = detail::spline_basis(p.x() - extent.min.x(), per_mm.x(), spans_x);
    const detail::SplineBasis y = detail::spline_basis(p.y() - extent.min.y(), per_mm.y(), spans_y);
    equations.add(x.first, y.first, x.value, y.value, p.z() - mean, 1);
    if (border[v]) continue;  // its normal leans on one side's triangles only: wrong by half an edge's curvature
    equations.add(x.first, y.first, x.slope, y.value, slopes[v].x(), slope_weight);
    equations.add(x.first, y.first, x.value, y.slope, slopes[v].y(), slope_weight);
  }
  equations.add_smoothing(kSmoothing);
  equations.add_end_conditions(kEndCondition);
  monitor.report("fitting the spline surface", 0.2);

  Grid<double> coefficients = equations.solve();
  for (double& c : coefficients.values) c += mean;
  monitor.report("fitting the spline surface", 0.8);

  SplineFit fit{SplineSurface(extent, spans_x, spans_y, std::move(coefficients)), {}};
  fit.summary = summed_up(fit_errors(mesh, fit.surface), crease_vertices(mesh, slopes, edge_mm), border);
  fit.summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  monitor.report("fitting the spline surface", 1);
  return fit;
}

}  // namespace lightmill

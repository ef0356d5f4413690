#include "design/detail/height_settling.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "design/core/errors.h"
#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kBlock = 4096;  // vertices

double dot(const std::vector<double>& a, const std::vector<double>& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

}  // namespace

HeightSettling::HeightSettling(const CompoundEnergy& energy) : energy_(energy), scales_(energy) {
  const int count = static_cast<int>(energy.rings.size());
  first_.assign(1, 0);
  for (const OneRing& ring : energy.rings)
    first_.push_back(first_.back() + 1 + static_cast<int>(ring.neighbours.size()));
  rows_.resize(first_.back());
  residuals_.resize(count);
  // Which rows name a vertex: its own, and each of its neighbours'.
  column_first_.assign(count + 1, 0);
  const auto each = [&](const auto& visit) {
    for (int v = 0; v < count; ++v) {
      visit(v, v, first_[v]);
      for (std::size_t k = 0; k < energy.rings[v].neighbours.size(); ++k)
        visit(v, energy.rings[v].neighbours[k], first_[v] + 1 + static_cast<int>(k));
    }
  };
  each([&](int, int column, int) { ++column_first_[column + 1]; });
  for (int v = 0; v < count; ++v) column_first_[v + 1] += column_first_[v];
  columns_.resize(first_.back());
  std::vector<int> next(column_first_.begin(), column_first_.end() - 1);
  each([&](int row, int column, int slot) { columns_[next[column]++] = {row, slot}; });
}

/// Residuals and their derivatives at these positions; returns half the residuals' square.
double HeightSettling::evaluate(const std::vector<Vec3>& positions) {
  std::vector<double> sums((positions.size() + kBlock - 1) / kBlock, 0.0);
  parallel_blocks(positions.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    std::vector<Vec3> around;
    std::vector<Eigen::Matrix3d> turns;
    double sum = 0;
    for (std::size_t v = begin; v < end; ++v) {
      const OneRing& ring = energy_.rings[v];
      around.clear();
      for (int n : ring.neighbours) around.push_back(positions[n]);
      const Vec3 normal = ring_normal(positions[v], around, ring.closed, energy_.creases.crossed[v], &turns);
      double rise = 0;
      for (std::size_t k = 0; k < around.size(); ++k) {
        const Vec3 way = around[k] - positions[v];
        const Vec2 slope = energy_.mean_slope(static_cast<int>(v), ring.neighbours[k]);
        rise += way.z() - slope.dot(way.head<2>());
      }
      residuals_[v] << scales_.integration * (normal - energy_.target_normals[v]), scales_.height_smoothness * rise;
      sum += residuals_[v].squaredNorm() / 2;
      for (std::size_t k = 0; k <= around.size(); ++k) {
        rows_[first_[v] + k] << scales_.integration * turns[k].col(2),
            scales_.height_smoothness * (k == 0 ? -static_cast<double>(around.size()) : 1.0);
      }
    }
    sums[begin / kBlock] = sum;
  });
  return std::accumulate(sums.begin(), sums.end(), 0.0);
}

/// The derivatives times heights.
void HeightSettling::forward(const std::vector<double>& heights, std::vector<Eigen::Vector4d>& result) const {
  result.resize(residuals_.size());
  parallel_blocks(result.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      Eigen::Vector4d sum = rows_[first_[v]] * heights[v];
      const auto& neighbours = energy_.rings[v].neighbours;
      for (std::size_t k = 0; k < neighbours.size(); ++k) sum += rows_[first_[v] + 1 + k] * heights[neighbours[k]];
      result[v] = sum;
    }
  });
}

/// Their transpose times a value per residual.
std::vector<double> HeightSettling::backward(const std::vector<Eigen::Vector4d>& values) const {
  std::vector<double> result(values.size());
  parallel_blocks(values.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      double sum = 0;
      for (int c = column_first_[v]; c < column_first_[v + 1]; ++c)
        sum += rows_[columns_[c].second].dot(values[columns_[c].first]);
      result[v] = sum;
    }
  });
  return result;
}

/// Gauss and Newton's matrix of the derivatives as they are. A shift of all heights changes no residual: it is the
/// Laplacian of a graph that joins vertices up to two rings apart, some of its weights below zero.
void HeightSettling::factorise(const std::vector<Vec3>& positions) {
  constexpr double kHold = 1e-9;  // of the mean weight: holds what no residual knows
  const std::size_t count = residuals_.size();
  std::vector<std::vector<GraphEdge>> blocks((count + kBlock - 1) / kBlock);
  parallel_blocks(count, kBlock, [&](std::size_t begin, std::size_t end) {
    std::vector<GraphEdge>& edges = blocks[begin / kBlock];
    for (std::size_t v = begin; v < end; ++v) {
      const int a = static_cast<int>(v);
      const std::size_t own = edges.size();
      for (int c = column_first_[v]; c < column_first_[v + 1]; ++c) {
        const auto [row, slot] = columns_[c];
        const auto& ring = energy_.rings[row].neighbours;
        for (std::size_t k = 0; k <= ring.size(); ++k) {
          const int b = k == 0 ? row : ring[k - 1];
          if (b <= a) continue;
          const double weight = -rows_[slot].dot(rows_[first_[row] + k]);
          const auto found = std::find_if(edges.begin() + static_cast<std::ptrdiff_t>(own), edges.end(),
                                          [b](const GraphEdge& edge) { return edge.b == b; });
          if (found == edges.end()) {
            edges.push_back({a, b, weight});
          } else {
            found->weight += weight;
          }
        }
      }
    }
  });
  std::vector<GraphEdge> edges;
  std::size_t all = count;
  for (const auto& block : blocks) all += block.size();
  edges.reserve(all);
  double sum = 0;
  for (auto& block : blocks) {
    for (const GraphEdge& edge : block) sum += std::abs(edge.weight);
    edges.insert(edges.end(), block.begin(), block.end());
    block = {};
  }
  const double mean = sum / static_cast<double>(edges.size());
  for (GraphEdge& edge : edges) edge.weight += kHold * mean;
  tie_parts(static_cast<int>(count), mean, edges);
  std::vector<Vec2> places;
  places.reserve(count);
  for (const Vec3& p : positions) places.emplace_back(p.head<2>());
  factor_.reset();  // its memory is needed
  factor_.emplace(places, edges, 0, 2);
}

/// By conjugate gradients; the factorised matrix of this step or of an earlier one is as good as the inverse.
std::vector<double> HeightSettling::step(const Monitor& monitor, MinimiserReport& report) {
  constexpr int kMostInner = 80;
  constexpr double kInnerTolerance = 1e-2;  // of the first residual, in the preconditioner's norm
  std::vector<double> heights(residuals_.size(), 0.0);
  std::vector<double> rest = backward(residuals_);
  for (double& r : rest) r = -r;
  std::vector<double> guided = factor_->solve(rest);
  std::vector<double> way = guided;
  std::vector<Eigen::Vector4d> image;
  double product = dot(rest, guided);
  const double first = product;
  for (int inner = 0; inner < kMostInner && product > kInnerTolerance * kInnerTolerance * first; ++inner) {
    monitor.check();
    forward(way, image);
    const std::vector<double> curved = backward(image);
    const double bend = dot(way, curved);
    if (!(bend > 0)) break;
    const double length = product / bend;
    for (std::size_t v = 0; v < heights.size(); ++v) {
      heights[v] += length * way[v];
      rest[v] -= length * curved[v];
    }
    guided = factor_->solve(rest);
    const double next = dot(rest, guided);
    for (std::size_t v = 0; v < way.size(); ++v) way[v] = guided[v] + next / product * way[v];
    product = next;
    ++report.inner_iterations;
  }
  const double mean = std::accumulate(heights.begin(), heights.end(), 0.0) / static_cast<double>(heights.size());
  if (!std::isfinite(mean)) throw NumericalError("surface: the heights have no finite solution");
  for (double& h : heights) h -= mean;  // a shift changes nothing
  return heights;
}

MinimiserReport HeightSettling::settle(double tolerance_mm, std::vector<Vec3>& positions, const Monitor& monitor) {
  constexpr int kSteps = 6;
  constexpr int kStale =
      8;  // iterations of a step with an earlier one's matrix, from which a new one is worth its time
  MinimiserReport report;
  double now = evaluate(positions);
  report.initial_energy = now;
  report.message = "steps used up";
  int inner_before = 0;
  for (; report.iterations < kSteps; ++report.iterations) {
    monitor.report("settling the heights", static_cast<double>(report.iterations) / kSteps);
    if (!factor_ || report.inner_iterations - inner_before > kStale) factorise(positions);
    inner_before = report.inner_iterations;
    const std::vector<double> heights = step(monitor, report);
    const std::vector<Vec3> before = positions;
    const double energy_before = now;
    double change = 0;
    for (double h : heights) change = std::max(change, std::abs(h));
    for (double share = 1; share > 1e-3; share /= 2) {
      for (std::size_t v = 0; v < positions.size(); ++v) positions[v].z() = before[v].z() + share * heights[v];
      now = evaluate(positions);
      if (now <= energy_before) break;
    }
    if (now > energy_before) {
      positions = before;
      now = energy_before;
      report.message = "no step lowers the energy";
      break;
    }
    if (change <= tolerance_mm) {
      report.message = "at rest";
      ++report.iterations;
      break;
    }
  }
  report.final_energy = now;
  return report;
}

}  // namespace lightmill::detail

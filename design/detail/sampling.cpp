#include "design/detail/sampling.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "design/core/parallel.h"
#include "design/detail/equal_masses.h"
#include "design/detail/mesh_sampling.h"
#include "design/detail/power_diagram.h"
#include "design/detail/target_measure.h"

namespace lightmill::detail {

namespace {

constexpr int kCoarsest = 256;        // sites of the coarsest sampling, about
constexpr int kLloydIterations = 12;  // on a sunflower the cells are nearly equal from the start
constexpr double kEqual = 0.005;      // spread of the samples' flux that is equal enough

Sampling sample_rectangle(const Vec2& size, int columns, int rows) {
  Sampling sampling;
  sampling.columns = columns;
  sampling.rows = rows;
  const Vec2 pitch(size.x() / columns, size.y() / rows);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      sampling.sites.emplace_back(-size.x() / 2 + (column + 0.5) * pitch.x(), -size.y() / 2 + (row + 0.5) * pitch.y());
      const int i = row * columns + column;
      const double area = size.x() * size.y();
      if (column + 1 < columns) sampling.edges.push_back({i, i + 1, pitch.y() / pitch.x() / area});
      if (row + 1 < rows) sampling.edges.push_back({i, i + columns, pitch.x() / pitch.y() / area});
    }
  }
  sampling.centroids = sampling.sites;
  sampling.masses.assign(sampling.sites.size(), 1.0 / static_cast<double>(sampling.sites.size()));
  sampling.spread = size / std::sqrt(12.0);
  return sampling;
}

Sampling sample_disk(double radius, int count, const Monitor& monitor) {
  Sampling sampling;
  // A sunflower: equal areas from ring to ring.
  const double golden = kPi * (3 - std::sqrt(5.0));
  for (int i = 0; i < count; ++i) {
    const double r = radius * std::sqrt((i + 0.5) / count);
    sampling.sites.emplace_back(r * std::cos(golden * i), r * std::sin(golden * i));
  }
  TargetMeasure disk;
  disk.disks = {{Vec2(0, 0), 1.0}};
  disk.radius = radius;
  CellIntegrals cells;
  PowerDiagram diagram;
  std::vector<int> starts;
  std::vector<double> last;
  const auto measure = [&](PowerDiagramBuilder& builder, std::vector<double> psi) {
    monitor.check();
    diagram = builder.build(psi);
    cells = integrate_cells(disk, diagram, sampling.sites, psi, starts);
    last = std::move(psi);
  };
  const auto voronoi = [&] {
    std::vector<double> psi;
    for (const Vec2& site : sampling.sites) psi.push_back(site.squaredNorm() / 2);
    return psi;
  };
  const auto centroids = [&] {
    std::vector<Vec2> result;
    for (int i = 0; i < count; ++i) result.emplace_back(cells.moments[i] / cells.masses[i]);
    return result;
  };
  for (int iteration = 0; iteration < kLloydIterations; ++iteration) {
    PowerDiagramBuilder builder(sampling.sites, radius);
    measure(builder, voronoi());
    sampling.sites = centroids();
  }
  // Then borders are moved, not sites, until the cells are equal.
  PowerDiagramBuilder builder(sampling.sites, radius);
  const auto summary = [&] {
    SourceCells result{last, cells.masses, {}};
    for (std::size_t e = 0; e < diagram.edges.size(); ++e) {
      const auto& edge = diagram.edges[e];
      if (cells.edge_slopes[e] > 0) result.edges.push_back({edge.a, edge.b, cells.edge_slopes[e]});
    }
    return result;
  };
  measure(builder, voronoi());
  const SourceCells equal = with_equal_masses(sampling.sites, summary(), kEqual, [&](std::vector<double> psi) {
    measure(builder, std::move(psi));
    return summary();
  });
  if (equal.psi != last) measure(builder, equal.psi);
  sampling.masses = cells.masses;
  sampling.centroids = centroids();
  sampling.edges = equal.edges;
  sampling.flux_spread = flux_spread_of(sampling.masses);
  const double total = std::accumulate(sampling.masses.begin(), sampling.masses.end(), 0.0);
  for (double& mass : sampling.masses) mass /= total;
  sampling.spread = Vec2(radius / 2, radius / 2);
  return sampling;
}

/// Bilinear on the grid of cell centres, linear beyond the outermost of them.
std::vector<double> prolong_grid(const Sampling& coarse, const std::vector<double>& values, const Sampling& fine) {
  std::vector<double> result(fine.sites.size());
  const auto place = [](double fine_index, int fine_count, int coarse_count, int& cell, double& part) {
    const double at = (fine_index + 0.5) * coarse_count / fine_count - 0.5;
    cell = std::clamp(static_cast<int>(std::floor(at)), 0, std::max(coarse_count - 2, 0));
    part = coarse_count > 1 ? at - cell : 0;
  };
  for (int row = 0; row < fine.rows; ++row) {
    int j = 0;
    double v = 0;
    place(row, fine.rows, coarse.rows, j, v);
    const int up = coarse.rows > 1 ? coarse.columns : 0;
    for (int column = 0; column < fine.columns; ++column) {
      int i = 0;
      double u = 0;
      place(column, fine.columns, coarse.columns, i, u);
      const int right = coarse.columns > 1 ? 1 : 0;
      const double* at = &values[static_cast<std::size_t>(j) * coarse.columns + i];
      result[static_cast<std::size_t>(row) * fine.columns + column] =
          (1 - v) * ((1 - u) * at[0] + u * at[right]) + v * ((1 - u) * at[up] + u * at[up + right]);
    }
  }
  return result;
}

/// A plane fitted to the nearest coarse sites by moving least squares.
std::vector<double> prolong_scattered(const Sampling& coarse, const std::vector<double>& values, const Sampling& fine) {
  // Buckets of about two coarse sites.
  Box2 box;
  for (const auto& s : coarse.sites) box.include(s);
  const int side = std::max(1, static_cast<int>(std::sqrt(coarse.sites.size() / 2.0)));
  const Vec2 pitch = box.size() / side;
  const auto bucket = [&](const Vec2& s, int axis) {
    return std::clamp(static_cast<int>((s[axis] - box.min[axis]) / pitch[axis]), 0, side - 1);
  };
  std::vector<std::vector<int>> buckets(static_cast<std::size_t>(side) * side);
  for (std::size_t i = 0; i < coarse.sites.size(); ++i) {
    buckets[static_cast<std::size_t>(bucket(coarse.sites[i], 1)) * side + bucket(coarse.sites[i], 0)].push_back(
        static_cast<int>(i));
  }
  const double spacing2 = 4 * coarse.spread.x() * coarse.spread.y() * kPi / static_cast<double>(coarse.sites.size());
  std::vector<double> result(fine.sites.size());
  parallel_blocks(fine.sites.size(), 1024, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const Vec2& s = fine.sites[k];
      Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
      Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
      // Where light is thin or the source has gaps, buckets are empty: look farther until there is a plane.
      int seen = 0;
      for (int reach = 2; seen < 6; reach *= 2) {
        seen = 0;
        normal.setZero();
        rhs.setZero();
        double nearest = std::numeric_limits<double>::infinity();
        const auto around = [&](const auto& visit) {
          for (int j = std::max(0, bucket(s, 1) - reach); j <= std::min(side - 1, bucket(s, 1) + reach); ++j) {
            for (int i = std::max(0, bucket(s, 0) - reach); i <= std::min(side - 1, bucket(s, 0) + reach); ++i) {
              for (const int c : buckets[static_cast<std::size_t>(j) * side + i]) {
                visit(c, Vec2(coarse.sites[c] - s));
              }
            }
          }
        };
        around([&](int, const Vec2& d) {
          ++seen;
          nearest = std::min(nearest, d.squaredNorm());
        });
        const double width2 = std::max(spacing2, 4 * nearest);
        around([&](int c, const Vec2& d) {
          const double weight = std::exp(-2 * d.squaredNorm() / width2);
          const Eigen::Vector3d basis(1, d.x(), d.y());
          normal += weight * basis * basis.transpose();
          rhs += weight * values[c] * basis;
        });
        if (reach > side) break;
      }
      result[k] = normal.ldlt().solve(rhs)[0];
    }
  });
  return result;
}

}  // namespace

std::vector<Sampling> sample_source(const SourceLight& source, int samples, std::uint64_t seed,
                                    const Monitor& monitor) {
  if (source.shape == SourceLight::Shape::kMesh) return sample_mesh(source.mesh, samples, seed, monitor);
  std::vector<Sampling> levels;
  if (source.shape == SourceLight::Shape::kDisk) {
    for (int count = samples;; count /= 4) {
      levels.push_back(sample_disk(source.size_mm.x() / 2, count, monitor));
      if (count <= 2 * kCoarsest) break;
    }
    return levels;
  }
  // Cells as square as can be, a row at least.
  const bool wide = source.size_mm.x() > source.size_mm.y();
  const double aspect = source.size_mm.maxCoeff() / source.size_mm.minCoeff();
  int across = std::max(1, static_cast<int>(std::lround(std::sqrt(samples / aspect))));
  int along = std::max(1, static_cast<int>(std::lround(static_cast<double>(samples) / across)));
  for (;;) {
    levels.push_back(sample_rectangle(source.size_mm, wide ? along : across, wide ? across : along));
    if (along * across <= 2 * kCoarsest) break;
    const int shrink = across < 4 ? 4 : 2;
    if (shrink == 2) across = (across + 1) / 2;
    along = (along + shrink - 1) / shrink;
  }
  return levels;
}

std::vector<double> prolong(const Sampling& coarse, const std::vector<double>& values, const Sampling& fine) {
  return coarse.columns > 0 ? prolong_grid(coarse, values, fine) : prolong_scattered(coarse, values, fine);
}

}  // namespace lightmill::detail

// What every transport map must hold, checked from the map alone.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <vector>

#include "design/transport.h"

namespace lightmill::test {

inline TransportOptions samples(int count) {
  TransportOptions options;
  options.samples = count;
  return options;
}

/// Masses, errors by their definition, and cyclical monotonicity over pairs and triples.
inline void expect_sound(const TransportMap& map, const TransportOptions& options) {
  const auto& s = map.summary;
  const std::size_t n = map.sites_mm.size();
  EXPECT_TRUE(s.converged);
  EXPECT_EQ(s.empty_cells, 0);
  EXPECT_EQ(static_cast<std::size_t>(s.samples), n);
  EXPECT_NEAR(std::accumulate(map.source_masses.begin(), map.source_masses.end(), 0.0), 1, 1e-12);
  EXPECT_NEAR(std::accumulate(map.target_masses.begin(), map.target_masses.end(), 0.0), 1, 1e-9);
  double l1 = 0;
  double most = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double error = std::abs(map.target_masses[i] - map.source_masses[i]);
    l1 += error;
    most = std::max(most, error / map.source_masses[i]);
  }
  EXPECT_NEAR(s.l1_mass_error, l1, 1e-12);
  EXPECT_NEAR(s.max_mass_error, most, 1e-9);
  EXPECT_LE(l1, options.l1_tolerance);
  EXPECT_LE(most, options.max_tolerance);
  // No exchange of targets is shorter. Strips are drawn together to their axes in the centroids, which moves them by at most
  // their radius.
  std::mt19937 random(11);
  std::uniform_int_distribution<std::size_t> any(0, n - 1);
  for (int trial = 0; trial < 20000; ++trial) {
    const std::size_t i = any(random);
    const std::size_t j = any(random);
    const std::size_t k = any(random);
    const Vec2& si = map.sites_mm[i];
    const Vec2& sj = map.sites_mm[j];
    const Vec2& sk = map.sites_mm[k];
    const Vec2& ti = map.target_centroids_mm[i];
    const Vec2& tj = map.target_centroids_mm[j];
    const Vec2& tk = map.target_centroids_mm[k];
    const double slack = options.point_radius_mm * ((si - sj).norm() + (sj - sk).norm() + (sk - si).norm()) + 1e-9;
    ASSERT_GE((si - sj).dot(ti - tj), -slack) << "seed 11, trial " << trial;
    ASSERT_GE(si.dot(ti - tj) + sj.dot(tj - tk) + sk.dot(tk - ti), -slack) << "seed 11, trial " << trial;
  }
}

/// Light of the target in small portions, points aside. `part` counts its parts: the area light, the pieces of each
/// curve.
struct Portion {
  Vec2 place;
  double flux;
  int part;
};

/// A raster of the target that shares no code with the solver: each pixel in `fine` x `fine` portions; curves as the strips
/// of half width `radius` that README.md, "Transport", says they are.
inline std::vector<Portion> portions_of(const TargetLight& target, int fine, double radius) {
  EXPECT_TRUE(target.area_borders.empty()) << "filled shapes are not rastered here";
  std::vector<Portion> portions;
  int part = 0;
  if (!target.area_flux.empty()) {
    const Vec2 pitch = target.extent.size().cwiseQuotient(Vec2(target.area_flux.width, target.area_flux.height));
    for (int row = 0; row < fine * target.area_flux.height; ++row) {
      for (int column = 0; column < fine * target.area_flux.width; ++column) {
        const double flux = target.area_flux.at(column / fine, row / fine) / (fine * fine);
        if (flux > 0)
          portions.push_back(
              {target.extent.min + pitch.cwiseProduct(Vec2(column + 0.5, row + 0.5)) / fine, flux, part});
      }
    }
    ++part;
  }
  constexpr int kAlong = 4000;
  constexpr int kAcross = 41;
  for (const auto& curve : target.curves) {
    for (std::size_t k = 0; k + 1 < curve.vertices_mm.size(); ++k, ++part) {
      const Vec2 way = curve.vertices_mm[k + 1] - curve.vertices_mm[k];
      const Vec2 across = Vec2(-way.y(), way.x()).normalized() * radius;
      const int along = std::max(20, static_cast<int>(kAlong / curve.vertices_mm.size()));
      for (int i = 0; i < along; ++i) {
        const double u = (i + 0.5) / along;
        const double density = curve.density_per_mm[k] + u * (curve.density_per_mm[k + 1] - curve.density_per_mm[k]);
        for (int j = 0; j < kAcross; ++j)
          portions.push_back({curve.vertices_mm[k] + u * way + ((2 * j + 1.0) / kAcross - 1) * across,
                              density * way.norm() / (along * kAcross), part});
      }
    }
  }
  return portions;
}

/// What each part of the target sends to each sample, by the definition of the power cells alone: light at x belongs to
/// the sample i with the smallest |x - s_i|^2 - w_i. [part][sample]
inline std::vector<std::vector<double>> rastered_masses(const std::vector<Vec2>& sites,
                                                        const std::vector<double>& weights,
                                                        const std::vector<Portion>& portions) {
  std::vector<std::vector<double>> masses;
  for (const Portion& portion : portions) {
    std::size_t best = 0;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < sites.size(); ++i) {
      const double power = (portion.place - sites[i]).squaredNorm() - weights[i];
      if (power < least) {
        least = power;
        best = i;
      }
    }
    masses.resize(std::max<std::size_t>(masses.size(), portion.part + 1), std::vector<double>(sites.size(), 0.0));
    masses[portion.part][best] += portion.flux;
  }
  return masses;
}

/// What each point sends to each sample, by the formula of README.md, "Transport". [point][sample]
inline std::vector<std::vector<double>> masses_of_points(const TransportMap& map, const TargetLight& target, double radius) {
  std::vector<std::vector<double>> masses;
  for (const auto& point : target.points) {
    const auto power = [&](std::size_t i) {
      return (point.position_mm - map.sites_mm[i]).squaredNorm() - map.weights_mm2[i];
    };
    double least = power(0);
    for (std::size_t i = 1; i < map.sites_mm.size(); ++i) least = std::min(least, power(i));
    std::vector<double> shares;
    double sum = 0;
    for (std::size_t i = 0; i < map.sites_mm.size(); ++i) {
      shares.push_back(std::exp((least - power(i)) / (2 * radius * radius)));
      sum += shares.back();
    }
    for (double& share : shares) share *= point.flux / sum;
    masses.push_back(shares);
  }
  return masses;
}

}  // namespace lightmill::test

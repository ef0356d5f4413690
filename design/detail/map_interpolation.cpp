#include "design/detail/map_interpolation.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>

#include "design/core/errors.h"
#include "design/detail/creases.h"
#include "design/detail/near_border.h"

namespace lightmill::detail {

namespace {

/// The border of the lit part of the receiver, as segments.
std::vector<std::array<Vec2, 2>> border_of(const SourceLight& source) {
  std::vector<std::array<Vec2, 2>> border;
  const Vec2 half = source.size_mm / 2;
  if (source.shape == SourceLight::Shape::kRectangle) {
    const Vec2 corners[4] = {
        {-half.x(), -half.y()}, {half.x(), -half.y()}, {half.x(), half.y()}, {-half.x(), half.y()}};
    for (int k = 0; k < 4; ++k) border.push_back({corners[k], corners[(k + 1) % 4]});
  } else if (source.shape == SourceLight::Shape::kDisk) {
    constexpr int kSides = 2880;  // a chord is 6e-7 of the radius within the circle
    const auto corner = [&](int k) {
      return Vec2(half.x() * std::cos(2 * kPi * k / kSides), half.y() * std::sin(2 * kPi * k / kSides));
    };
    for (int k = 0; k < kSides; ++k) border.push_back({corner(k), corner(k + 1)});
  } else {
    std::vector<std::pair<int, int>> edges;
    for (const auto& t : source.mesh.triangles) {
      for (int k = 0; k < 3; ++k) edges.emplace_back(std::minmax(t[k], t[(k + 1) % 3]));
    }
    std::sort(edges.begin(), edges.end());
    for (std::size_t first = 0; first < edges.size();) {
      std::size_t last = first + 1;
      while (last < edges.size() && edges[last] == edges[first]) ++last;
      if (last - first == 1)
        border.push_back({source.mesh.vertices_mm[edges[first].first], source.mesh.vertices_mm[edges[first].second]});
      first = last;
    }
  }
  return border;
}

double minmod(double a, double b) {
  if (a * b <= 0) return 0;
  return std::abs(a) < std::abs(b) ? a : b;
}

/// Sides of squares with the cells' areas, from the spacing of their sites.
std::vector<double> cell_sizes(const std::vector<Vec2>& sites, const std::vector<std::vector<int>>& adjacent) {
  std::vector<double> sizes(sites.size());
  std::vector<double> ways;
  for (std::size_t s = 0; s < sites.size(); ++s) {
    ways.clear();
    for (int n : adjacent[s]) ways.push_back((sites[n] - sites[s]).norm());
    // The longer half may be edges along the hull, or diagonals.
    std::sort(ways.begin(), ways.end());
    const std::size_t half = std::max<std::size_t>(1, ways.size() / 2);
    for (std::size_t k = 0; k < half && k < ways.size(); ++k) sizes[s] += ways[k] / static_cast<double>(half);
  }
  return sizes;
}

}  // namespace

bool MapInterpolation::same_branch(const Site& a, const Site& b) const {
  return (a.target_mm - b.target_mm).norm() <= kTear * std::max(a.stretch, b.stretch) * (a.place_mm - b.place_mm).norm();
}

MapInterpolation::MapInterpolation(const TransportMap& map, const SourceLight& source) {
  std::vector<Vec2> places;
  std::vector<Vec2> targets;
  Box2 target_box;
  for (std::size_t i = 0; i < map.source_centroids_mm.size(); ++i) {
    if (!(map.source_masses[i] > 0)) continue;
    places.push_back(map.source_centroids_mm[i]);
    targets.push_back(map.target_centroids_mm[i]);
    target_box.include(targets.back());
    // From the site, where it is known, to the centroid, where the map is.
    const Vec2& site = map.sites_mm[i];
    const double potential = (site.squaredNorm() - map.weights_mm2[i]) / 2;
    sites_.push_back({places.back(), targets.back(), potential + targets.back().dot(places.back() - site)});
  }
  if (places.size() < 3) throw InputError("surface: a transport map of fewer than three cells cannot be interpolated");
  const double mean_stretch = target_box.size().maxCoeff() / source.size_mm.maxCoeff();

  // Centroids of border cells lie half a cell inside the border. Each is mirrored in the border, and its target is
  // carried on as it runs towards the border: by the smaller of two steps inside, so that a crease near the border is
  // not carried on.
  NaturalNeighbours inside(places);
  const std::vector<double> cell_mm = cell_sizes(places, inside.adjacent());
  struct Mirror {
    std::size_t site;
    Vec2 outwards;  // from the centroid to its mirror image
  };
  std::vector<Mirror> mirrors;
  constexpr double kBorderCells = 0.9;  // the first row's centroids are half a cell from the border, the second's 1.4
  const double longest = kBorderCells * *std::max_element(cell_mm.begin(), cell_mm.end());
  const NearBorder border(border_of(source), longest);
  for (std::size_t s = 0; s < places.size(); ++s) {
    for (const Vec2& way : border.ways(places[s], kBorderCells * cell_mm[s])) mirrors.push_back({s, 2 * way});
  }
  std::vector<Vec2> inner;
  for (const Mirror& m : mirrors) {
    inner.push_back(places[m.site] - m.outwards);
    inner.push_back(places[m.site] - 2 * m.outwards);
  }
  std::vector<Vec2> inner_targets(inner.size());
  inside.each(inner, [&](std::size_t q, const std::vector<SiteShare>& shares) {
    inner_targets[q].setZero();
    for (const auto& [site, share] : shares) inner_targets[q] += share * targets[site];
  });
  std::vector<Vec2> steps;
  for (std::size_t m = 0; m < mirrors.size(); ++m) {
    const Vec2 first = targets[mirrors[m].site] - inner_targets[2 * m];
    const Vec2 second = inner_targets[2 * m] - inner_targets[2 * m + 1];
    steps.emplace_back(minmod(first.x(), second.x()), minmod(first.y(), second.y()));
  }
  const auto mirrored = [&](std::size_t site, const Vec2& outwards, const Vec2& step) {
    const Vec2 target = targets[site] + step;
    places.push_back(places[site] + outwards);
    sites_.push_back({places.back(), target, sites_[site].potential_mm2 + (targets[site] + target).dot(outwards) / 2});
  };
  for (std::size_t m = 0; m < mirrors.size(); ++m) {
    mirrored(mirrors[m].site, mirrors[m].outwards, steps[m]);
    // A cell in a corner is mirrored in both sides, and in the corner.
    if (m > 0 && mirrors[m - 1].site == mirrors[m].site) {
      const double cosine = mirrors[m - 1].outwards.normalized().dot(mirrors[m].outwards.normalized());
      if (std::abs(cosine) < std::sqrt(0.5))
        mirrored(mirrors[m].site, mirrors[m - 1].outwards + mirrors[m].outwards, steps[m - 1] + steps[m]);
    }
  }

  neighbours_ = std::make_unique<NaturalNeighbours>(places);
  const auto adjacent = neighbours_->adjacent();
  std::vector<double> site_stretches(sites_.size(), mean_stretch);
  std::vector<double> stretches;
  for (std::size_t s = 0; s < sites_.size(); ++s) {
    stretches.clear();
    for (int n : adjacent[s]) {
      const double way = (places[n] - places[s]).norm();
      if (way > 0) stretches.push_back((sites_[n].target_mm - sites_[s].target_mm).norm() / way);
    }
    if (stretches.empty()) continue;
    // A crease beside the site takes at most about half of its neighbours away.
    const std::size_t rank = (stretches.size() - 1) * 2 / 5;
    std::nth_element(stretches.begin(), stretches.begin() + static_cast<std::ptrdiff_t>(rank), stretches.end());
    site_stretches[s] = std::max(mean_stretch, stretches[rank]);
  }
  site_stretches =
      without_narrow_peaks(std::move(site_stretches), [&](std::size_t s) -> const std::vector<int>& { return adjacent[s]; });
  for (std::size_t s = 0; s < sites_.size(); ++s) sites_[s].stretch = site_stretches[s];
  for (std::size_t s = 0; s < sites_.size(); ++s) {
    constexpr double kRidge = 0.05;  // where neighbours lie in a row the map is not known across it
    Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
    Eigen::Matrix2d drift = Eigen::Matrix2d::Zero();
    for (int n : adjacent[s]) {
      if (!same_branch(sites_[s], sites_[n])) continue;
      const Vec2 way = places[n] - places[s];
      spread += way * way.transpose();
      drift += (sites_[n].target_mm - sites_[s].target_mm) * way.transpose();
    }
    const double ridge = kRidge * spread.trace();
    if (ridge > 0) sites_[s].gradient = drift * (spread + ridge * Eigen::Matrix2d::Identity()).inverse();
  }
}

std::vector<Vec2> MapInterpolation::at(const std::vector<Vec2>& places) const {
  std::vector<Vec2> result(places.size());
  neighbours_->each(places, [&](std::size_t q, const std::vector<SiteShare>& shares) {
    // Branches among the neighbours.
    thread_local std::vector<int> branch;
    branch.resize(shares.size());
    int branches = 0;
    for (std::size_t k = 0; k < shares.size(); ++k) {
      branch[k] = branches++;
      for (std::size_t m = 0; m < k; ++m) {
        if (branch[m] == branch[k] || !same_branch(sites_[shares[k].first], sites_[shares[m].first])) continue;
        const int joined = branch[m];
        std::replace(branch.begin(), branch.begin() + static_cast<std::ptrdiff_t>(k) + 1, joined, branch[k]);
      }
    }
    const bool torn = std::any_of(branch.begin(), branch.end(), [&](int b) { return b != branch.front(); });
    int highest = -1;
    double height = -std::numeric_limits<double>::infinity();
    for (int b = 0; torn && b < branches; ++b) {
      double sum = 0, weight = 0;
      for (std::size_t k = 0; k < shares.size(); ++k) {
        if (branch[k] != b) continue;
        const Site& site = sites_[shares[k].first];
        const Vec2 way = places[q] - site.place_mm;
        sum += shares[k].second * (site.potential_mm2 + site.target_mm.dot(way) + way.dot(site.gradient * way) / 2);
        weight += shares[k].second;
      }
      if (weight > 0 && sum / weight > height) {
        height = sum / weight;
        highest = b;
      }
    }
    Vec2 sum = Vec2::Zero();
    double weight = 0;
    for (std::size_t k = 0; k < shares.size(); ++k) {
      if (torn && branch[k] != highest) continue;
      const Site& site = sites_[shares[k].first];
      const Vec2 target = torn ? Vec2(site.target_mm + site.gradient * (places[q] - site.place_mm)) : site.target_mm;
      sum += shares[k].second * target;
      weight += shares[k].second;
    }
    result[q] = sum / weight;
  });
  return result;
}

}  // namespace lightmill::detail

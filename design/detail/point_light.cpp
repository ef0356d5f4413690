#include "design/detail/point_light.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "design/core/parallel.h"
#include "design/detail/target_measure.h"

namespace lightmill::detail {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kFaint = 40;      // exponents this far below the sum's are lost in rounding
constexpr double kFarTooMuch = 4;  // times its share, from which a site is levelled

double log_sum(double a, double b) {
  const double high = std::max(a, b);
  return high == -kInfinity ? high : high + std::log1p(std::exp(std::min(a, b) - high));
}

/// (x.s_i - psi_i - origin) / softness, where the origin is the largest x.s_i - psi_i: small numbers are exact ones.
struct Exponents {
  double origin;
  std::vector<double> t;
};
Exponents exponents(const Vec2& place, double softness, const std::vector<Vec2>& sites, const std::vector<double>& psi) {
  Exponents result{-kInfinity, std::vector<double>(sites.size())};
  for (std::size_t i = 0; i < sites.size(); ++i) {
    result.t[i] = place.dot(sites[i]) - psi[i];
    result.origin = std::max(result.origin, result.t[i]);
  }
  for (double& t : result.t) t = (t - result.origin) / softness;
  return result;
}

double log_sum(const std::vector<double>& t) {
  const double high = *std::max_element(t.begin(), t.end());
  double sum = 0;
  for (const double x : t) {
    if (x > high - kFaint) sum += std::exp(x - high);
  }
  return high + std::log(sum);
}

}  // namespace

double softness(const TargetMeasure& measure) {
  return measure.radius * measure.radius;
}

std::vector<PointShare> share_points(const TargetMeasure& measure, const std::vector<Vec2>& sites,
                                     const std::vector<double>& psi) {
  std::vector<std::vector<PointShare>> shares(measure.points.size());
  parallel_blocks(measure.points.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      const auto& point = measure.points[p];
      const auto [origin, t] = exponents(point.place, softness(measure), sites, psi);
      const double level = log_sum(t);
      for (std::size_t i = 0; i < t.size(); ++i) {
        if (t[i] > level - kFaint)
          shares[p].push_back({static_cast<int>(p), static_cast<int>(i), point.flux * std::exp(t[i] - level)});
      }
    }
  });
  std::vector<PointShare> all;
  for (const auto& of_point : shares) all.insert(all.end(), of_point.begin(), of_point.end());
  return all;
}

double points_entropy(const TargetMeasure& measure, const std::vector<PointShare>& shares) {
  double sum = 0;
  for (const auto& [point, site, mass] : shares) sum -= mass * std::log(mass / measure.points[point].flux);
  return softness(measure) * sum;
}

bool level_points(const TargetMeasure& measure, const std::vector<Vec2>& sites, const std::vector<double>& wanted,
                  const std::vector<PointShare>& shares, std::vector<double>& psi) {
  std::vector<char> uneven(measure.points.size(), 0);
  for (const auto& share : shares) uneven[share.point] |= share.mass > kFarTooMuch * wanted[share.site];
  const std::size_t n = sites.size();
  bool any = false;
  for (std::size_t p = 0; p < uneven.size(); ++p) {
    if (!uneven[p]) continue;
    any = true;
    const auto& point = measure.points[p];
    const double flux = std::min(point.flux, 1 - 1e-9);  // all sites together take no more
    const auto [origin, t] = exponents(point.place, softness(measure), sites, psi);
    std::vector<double> pull(n);
    for (std::size_t i = 0; i < n; ++i) pull[i] = t[i] - std::log(wanted[i]);
    std::vector<int> order(n);
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int a, int b) { return std::pair(-pull[a], a) < std::pair(-pull[b], b); });
    std::vector<double> rest(n + 1, -kInfinity);  // log sum exp from the k-th on
    for (std::size_t k = n; k-- > 0;) rest[k] = log_sum(rest[k + 1], t[order[k]]);
    double full = 0;
    double level = rest[0];
    std::size_t count = 0;
    while (count < n && pull[order[count]] > level - std::log(flux)) {
      const double next = full + wanted[order[count]];
      if (next >= flux) break;
      full = next;
      ++count;
      level = rest[count] + std::log(flux / (flux - full));
    }
    for (std::size_t k = 0; k < count; ++k) {
      const int i = order[k];
      psi[i] = point.place.dot(sites[i]) - origin - softness(measure) * (level + std::log(wanted[i] / flux));
    }
  }
  return any;
}

PointPull::PointPull(const TargetMeasure& measure, const std::vector<Vec2>& sites, const std::vector<double>& psi)
    : measure_(measure), sites_(sites), softness_(softness(measure)) {
  for (const auto& point : measure.points) {
    const auto [origin, t] = exponents(point.place, softness_, sites, psi);
    level_.push_back(origin / softness_ + log_sum(t));
  }
}

double PointPull::pull(std::size_t point, int site, double potential) const {
  return (measure_.points[point].place.dot(sites_[site]) - potential) / softness_;
}

double PointPull::others(std::size_t point, int site, double psi) const {
  const double mine = pull(point, site, psi) - level_[point];
  return mine < 0 ? level_[point] + std::log1p(-std::exp(mine)) : -kInfinity;
}

double PointPull::mass(int site, double psi, double potential) const {
  double sum = 0;
  for (std::size_t p = 0; p < level_.size(); ++p) {
    const double t = pull(p, site, potential);
    if (t > level_[p] - kFaint) sum += measure_.points[p].flux / (1 + std::exp(others(p, site, psi) - t));
  }
  return sum;
}

double PointPull::potential_for(int site, double psi, double wanted) const {
  double highest = -kInfinity;
  for (std::size_t p = 0; p < level_.size(); ++p) {
    const double part = wanted / measure_.points[p].flux;
    if (part >= 1) continue;
    const double t = others(p, site, psi) + std::log(part / (1 - part));
    highest = std::max(highest, measure_.points[p].place.dot(sites_[site]) - softness_ * t);
  }
  return highest;
}

void PointPull::move(int site, double psi, double potential) {
  for (std::size_t p = 0; p < level_.size(); ++p)
    level_[p] = log_sum(others(p, site, psi), pull(p, site, potential));
}

}  // namespace lightmill::detail

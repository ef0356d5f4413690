// Points of light inside the solver: the softmax that shares them is the gradient of its dual, and no site gets too much.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numeric>
#include <random>

#include "design/detail/laplacian.h"
#include "design/detail/point_light.h"
#include "design/detail/target_measure.h"

namespace lightmill::detail {
namespace {

struct Scene {
  explicit Scene(unsigned seed, double radius) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> at(-5, 5), some(0.1, 1);
    for (int i = 0; i < 40; ++i) sites.emplace_back(at(random), at(random));
    for (const Vec2& s : sites) psi.push_back(s.squaredNorm() / 2 + 0.2 * at(random));
    measure.points = {{{at(random), at(random)}, 0.7}, {{at(random), at(random)}, 0.3}};
    measure.radius = radius;
    double sum = 0;
    for (std::size_t i = 0; i < sites.size(); ++i) sum += wanted.emplace_back(some(random));
    for (double& w : wanted) w /= sum;
  }
  TargetMeasure measure;
  std::vector<Vec2> sites;
  std::vector<double> psi;
  std::vector<double> wanted;
};

std::vector<double> masses(const Scene& scene, const std::vector<double>& psi) {
  std::vector<double> sum(psi.size(), 0);
  for (const auto& share : share_points(scene.measure, scene.sites, psi)) sum[share.site] += share.mass;
  return sum;
}

/// sum over points of f e log sum exp((x.s - psi) / e), by its definition.
double dual(const Scene& scene, const std::vector<double>& psi) {
  const double e = scene.measure.radius * scene.measure.radius;
  double value = 0;
  for (const auto& point : scene.measure.points) {
    double sum = 0;
    for (std::size_t i = 0; i < psi.size(); ++i) sum += std::exp((point.place.dot(scene.sites[i]) - psi[i]) / e);
    value += point.flux * e * std::log(sum);
  }
  return value;
}

RC_GTEST_PROP(PointLight, SharesAreTheDualsGradientAndAddUp, (unsigned seed)) {
  const Scene scene(seed, 1.5);
  const std::vector<double> now = masses(scene, scene.psi);
  RC_ASSERT(std::abs(std::accumulate(now.begin(), now.end(), 0.0) - 1) < 1e-12);
  double value = points_entropy(scene.measure, share_points(scene.measure, scene.sites, scene.psi));
  for (const auto& share : share_points(scene.measure, scene.sites, scene.psi))
    value += share.mass * (scene.measure.points[share.point].place.dot(scene.sites[share.site]) - scene.psi[share.site]);
  RC_ASSERT(std::abs(value - dual(scene, scene.psi)) < 1e-10);
  constexpr double kStep = 1e-4;
  for (std::size_t i = 0; i < 5; ++i) {
    std::vector<double> psi = scene.psi;
    psi[i] += kStep;
    const double above = dual(scene, psi);
    psi[i] -= 2 * kStep;
    RC_ASSERT(std::abs((dual(scene, psi) - above) / (2 * kStep) - now[i]) < 1e-6);
  }
}

RC_GTEST_PROP(PointLight, ASharpPointGoesToTheSiteWhoseCellItIsIn, (unsigned seed)) {
  const Scene scene(seed, 0.001);
  for (const auto& share : share_points(scene.measure, scene.sites, scene.psi)) {
    const auto& point = scene.measure.points[share.point];
    if (share.mass < 0.6 * point.flux) continue;
    const auto lead = [&](std::size_t i) { return point.place.dot(scene.sites[i]) - scene.psi[i]; };
    for (std::size_t i = 0; i < scene.sites.size(); ++i) RC_ASSERT(lead(i) <= lead(share.site));
  }
}

RC_GTEST_PROP(PointLight, LevellingLeavesNoSiteMoreThanItIsToHaveOfAPoint, (unsigned seed)) {
  const Scene scene(seed, 0.01);
  std::vector<double> psi = scene.psi;
  const auto before = share_points(scene.measure, scene.sites, psi);
  RC_ASSERT(level_points(scene.measure, scene.sites, scene.wanted, before, psi));
  for (std::size_t i = 0; i < psi.size(); ++i) RC_ASSERT(psi[i] >= scene.psi[i] - 1e-12);
  const auto after = share_points(scene.measure, scene.sites, psi);
  double total = 0;
  for (const auto& share : after) {
    RC_ASSERT(share.mass <= scene.wanted[share.site] * (share.point == 1 ? 1 + 1e-6 : 2.0));
    total += share.mass;
  }
  RC_ASSERT(std::abs(total - 1) < 1e-9);
}

RC_GTEST_PROP(PointLight, OneSiteAfterTheOtherIsFoundAsAllTogether, (unsigned seed)) {
  const Scene scene(seed, 0.5);
  PointPull pull(scene.measure, scene.sites, scene.psi);
  std::vector<double> psi = scene.psi;
  for (const int site : {3, 17, 3, 29}) {
    const double wanted = 0.05;
    const double potential = pull.potential_for(site, psi[site], wanted);
    const double expected = pull.mass(site, psi[site], potential);
    pull.move(site, psi[site], potential);
    psi[site] = potential;
    RC_ASSERT(expected >= wanted * (1 - 1e-9));
    RC_ASSERT(std::abs(masses(scene, psi)[site] - expected) < 1e-9);
    RC_ASSERT(std::abs(pull.mass(site, potential, potential) - expected) < 1e-9);
  }
}

TEST(PointLight, AStarAboutAHubIsTheDerivativeOfShares) {
  // -d m_i / d psi_j of the shares is what is left of a star when its hub is eliminated.
  const Scene scene(7, 1.5);
  const double e = softness(scene.measure);
  const int n = static_cast<int>(scene.sites.size());
  std::vector<GraphEdge> edges;
  for (int i = 0; i + 1 < n; ++i) edges.push_back({i, i + 1, 0.01});
  for (const auto& share : share_points(scene.measure, scene.sites, scene.psi))
    edges.push_back({share.site, n + share.point, share.mass / e});
  std::vector<double> direction(n);
  for (int i = 0; i < n; ++i) direction[i] = std::sin(1.0 + i);
  const double mean = std::accumulate(direction.begin(), direction.end(), 0.0) / n;
  for (double& d : direction) d -= mean;
  constexpr double kStep = 1e-5;
  std::vector<double> up = scene.psi, down = scene.psi;
  for (int i = 0; i < n; ++i) {
    up[i] += kStep * direction[i];
    down[i] -= kStep * direction[i];
  }
  const std::vector<double> less = masses(scene, up), more = masses(scene, down);
  std::vector<double> rhs(n);
  for (int i = 0; i < n; ++i) {
    rhs[i] = (more[i] - less[i]) / (2 * kStep);
    if (i > 0) rhs[i] += 0.01 * (direction[i] - direction[i - 1]);
    if (i + 1 < n) rhs[i] += 0.01 * (direction[i] - direction[i + 1]);
  }
  const std::vector<double> found = Laplacian(scene.sites, edges, 2).solve(rhs);
  for (int i = 0; i < n; ++i) EXPECT_NEAR(found[i], direction[i], 1e-6);
}

}  // namespace
}  // namespace lightmill::detail

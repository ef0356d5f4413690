// Laws of the transport on the targets it is made for: exact masses, shares of singular light, invariance.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "design/core/parallel.h"
#include "design/detail/sampled_transport.h"
#include "tests/design/must_hold_targets.h"
#include "tests/design/transport_checks.h"

namespace lightmill {
namespace {

using test::expect_sound;
using test::portions_of;
using test::rastered_masses;
using test::samples;

class MustHold : public ::testing::TestWithParam<const char*> {};

TEST_P(MustHold, ErrorsAreBelowTheBoundsAndNoCellIsEmpty) {
  const TransportOptions options = samples(2304);
  EXPECT_EQ(options.l1_tolerance, 1e-4);
  EXPECT_EQ(options.max_tolerance, 1e-2);
  expect_sound(solve_transport(SourceLight{}, test::must_hold_target(GetParam()), options), options);
}

INSTANTIATE_TEST_SUITE_P(Targets, MustHold, ::testing::ValuesIn(test::kMustHold),
                         [](const auto& test) { return test.param; });

/// Area light, a bent stroke of varying density and two points, a quarter, a half and the rest of the light.
TargetLight mixed_light() {
  TargetLight target;
  target.extent = {{-40, -35}, {50, 25}};
  target.area_flux = Grid<double>(9, 6);
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 9; ++column)
      target.area_flux.at(column, row) = (column + 2 * row) % 5 == 0 ? 0 : 0.25 * (1 + column) / 210.0;
  }
  CurveLight curve;
  curve.vertices_mm = {{-30, -20}, {5, -25}, {40, 5}, {10, 20}};
  curve.density_per_mm = {0.001, 0.006, 0.003, 0.008};
  target.curves = {curve};
  target.points = {{{-20, 10}, 0.06}, {{25, -20}, 0.19}};
  target.normalise();
  return target;
}

TEST(TransportMasses, AreThoseOfTheCellsThatWeightsAndSitesDefine) {
  SourceLight source;
  source.size_mm = {90, 60};
  const TargetLight target = mixed_light();
  TransportOptions options = samples(216);
  options.l1_tolerance = 1e-9;
  const TransportMap map = solve_transport(source, target, options);
  expect_sound(map, options);
  auto parts = rastered_masses(map.sites_mm, map.weights_mm2, portions_of(target, 50, options.point_radius_mm));
  for (auto& point : test::masses_of_points(map, target, options.point_radius_mm)) parts.push_back(std::move(point));
  ASSERT_EQ(parts.size(), 1U + 3 + 2);
  const double per_sample = 1.0 / static_cast<double>(map.sites_mm.size());
  std::vector<double> masses(map.sites_mm.size(), 0.0);
  for (const auto& part : parts) {
    for (std::size_t i = 0; i < masses.size(); ++i) masses[i] += part[i];
  }
  double squares = 0;
  for (std::size_t i = 0; i < masses.size(); ++i) {
    const double off = (masses[i] - map.source_masses[i]) / per_sample;
    EXPECT_LT(std::abs(off), 0.1) << i;
    squares += off * off * per_sample;
  }
  EXPECT_LT(std::sqrt(squares), 0.015) << "the raster's own noise";

  // Each part of the light gets its share of the samples: those that it fills aim at it exactly, and with those that it
  // shares with other parts they are its flux, to less than one sample's.
  const auto on_piece = [&](std::size_t k, const Vec2& p) {
    const Vec2& a = target.curves[0].vertices_mm[k];
    const Vec2 way = target.curves[0].vertices_mm[k + 1] - a;
    const double along = std::clamp((p - a).dot(way) / way.squaredNorm(), 0.0, 1.0);
    return (p - a - along * way).norm();
  };
  for (std::size_t part = 1; part < parts.size(); ++part) {
    double flux = part < 4 ? 0 : target.points[part - 4].flux;
    if (part < 4) {
      const auto& curve = target.curves[0];
      flux = (curve.vertices_mm[part] - curve.vertices_mm[part - 1]).norm() *
             (curve.density_per_mm[part] + curve.density_per_mm[part - 1]) / 2;
    }
    double sent = 0;  // samples, in fractions
    int whole = 0;
    for (std::size_t i = 0; i < masses.size(); ++i) {
      const double share = parts[part][i] / masses[i];
      sent += share;
      const Vec2& at = map.target_centroids_mm[i];
      const double off = part < 4 ? on_piece(part - 1, at) : (at - target.points[part - 4].position_mm).norm();
      if (off > 1e-8) continue;
      ++whole;
      EXPECT_NEAR(share, 1, 1e-9) << "part " << part << ", sample " << i;
    }
    EXPECT_NEAR(sent, flux / per_sample, 0.5) << "part " << part;
    EXPECT_LE(whole, flux / per_sample + 0.5) << "part " << part;
    EXPECT_GT(whole, 0) << "part " << part;
  }
}

TEST(TransportMasses, PointsShareOnlyTheSamplesBetweenThem) {
  // Sites are points themselves: of k points of light, k - 1 samples at most are shared; no other is split.
  std::mt19937 random(3);
  std::uniform_real_distribution<double> at(-45, 45);
  std::uniform_real_distribution<double> some(0.1, 1);
  TargetLight target;
  target.extent = Box2::centred({100, 100});
  for (int k = 0; k < 6; ++k) target.points.push_back({{at(random), at(random)}, some(random)});
  target.normalise();
  TransportOptions options = samples(400);
  const TransportMap map = solve_transport(SourceLight{}, target, options);
  expect_sound(map, options);
  int shared = 400;
  for (const auto& point : target.points) {
    int whole = 0;
    for (const Vec2& c : map.target_centroids_mm) whole += (c - point.position_mm).norm() < 1e-9;
    EXPECT_LE(whole, 400 * point.flux * 1.0001 + 0.01);
    EXPECT_GT(whole, 400 * point.flux - 6);
    shared -= whole;
  }
  EXPECT_LE(shared, 5);
}

TEST(TransportMasses, PiecesOfACurveGetTheirShareOfTheSamples) {
  // A disk onto a circle of density 1 + 0.8 cos: every arc gets the samples that its flux asks for.
  SourceLight source;
  source.shape = SourceLight::Shape::kDisk;
  TargetLight target;
  target.extent = Box2::centred({100, 100});
  CurveLight curve;
  constexpr int kCorners = 240;
  for (int k = 0; k <= kCorners; ++k) {
    const double angle = 2 * kPi * k / kCorners;
    curve.vertices_mm.emplace_back(30 * std::cos(angle), 30 * std::sin(angle));
    curve.density_per_mm.push_back(1 + 0.8 * std::cos(angle));
  }
  target.curves = {curve};
  target.normalise();
  const TransportOptions options = samples(2000);
  const TransportMap map = solve_transport(source, target, options);
  expect_sound(map, options);
  constexpr int kArcs = 12;
  std::vector<double> sent(kArcs, 0.0);
  std::vector<double> flux(kArcs, 0.0);
  for (std::size_t i = 0; i < map.sites_mm.size(); ++i) {
    const Vec2& c = map.target_centroids_mm[i];
    const double turn = std::atan2(c.y(), c.x()) / (2 * kPi);
    sent[static_cast<int>((turn - std::floor(turn)) * kArcs)] += map.source_masses[i];
  }
  for (int k = 0; k < kCorners; ++k)
    flux[k * kArcs / kCorners] += (target.curves[0].density_per_mm[k] + target.curves[0].density_per_mm[k + 1]) / 2 *
                                  (curve.vertices_mm[k + 1] - curve.vertices_mm[k]).norm();
  for (int arc = 0; arc < kArcs; ++arc) EXPECT_NEAR(sent[arc] * 2000, flux[arc] * 2000, 4) << arc;
}

/// The samples in another order, as scattered ones are.
detail::Sampling shuffled(const detail::Sampling& sampling, std::mt19937& random, std::vector<int>& order) {
  const std::size_t n = sampling.sites.size();
  order.resize(n);
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), random);
  detail::Sampling result = sampling;
  result.columns = result.rows = 0;
  std::vector<int> place(n);
  for (std::size_t k = 0; k < n; ++k) {
    place[order[k]] = static_cast<int>(k);
    result.sites[k] = sampling.sites[order[k]];
    result.masses[k] = sampling.masses[order[k]];
    result.centroids[k] = sampling.centroids[order[k]];
  }
  for (auto& edge : result.edges) {
    edge.a = place[edge.a];
    edge.b = place[edge.b];
  }
  std::shuffle(result.edges.begin(), result.edges.end(), random);
  return result;
}

TEST(TransportInvariance, TheOrderOfTheSamplesChangesNothing) {
  for (const char* name : {"photo", "strokes_over_photo", "disks"}) {
    const TargetLight target = test::must_hold_target(name);
    TransportOptions options = samples(1024);
    options.l1_tolerance = 1e-10;
    const auto levels = detail::sample_source(SourceLight{}, 1024, 1, {});
    const TransportMap map = detail::solve_sampled(levels, target, options, {});
    std::mt19937 random(23);
    std::vector<int> order;
    std::vector<detail::Sampling> mixed(levels.size());
    for (std::size_t k = levels.size(); k-- > 0;) mixed[k] = shuffled(levels[k], random, order);
    const TransportMap other = detail::solve_sampled(mixed, target, options, {});
    expect_sound(other, options);
    for (std::size_t k = 0; k < order.size(); ++k) {
      const int i = order[k];
      EXPECT_LT((other.target_centroids_mm[k] - map.target_centroids_mm[i]).norm(), 1e-5) << name;
      EXPECT_NEAR(other.weights_mm2[k] - other.weights_mm2[0], map.weights_mm2[i] - map.weights_mm2[order[0]], 1e-4)
          << name;
    }
  }
}

TEST(TransportInvariance, RunsAndThreadCountsGiveTheSameBits) {
  Light light;
  light.profile.kind = Profile::Kind::kGaussian;
  const SourceLight gaussian = trace_source({}, light, {}, 24).source;
  const int threads = thread_count();
  for (const char* name : {"photo", "strokes_over_photo", "point_in_the_dark"}) {
    const TargetLight target = test::must_hold_target(name);
    for (const SourceLight& source : {SourceLight{}, gaussian}) {
      set_thread_count(1);
      const TransportMap one = solve_transport(source, target, samples(300));
      for (const int count : {1, 2, 3}) {
        set_thread_count(count);
        const TransportMap again = solve_transport(source, target, samples(300));
        EXPECT_EQ(one.sites_mm, again.sites_mm) << name << ", threads " << count;
        EXPECT_EQ(one.source_masses, again.source_masses) << name << ", threads " << count;
        EXPECT_EQ(one.weights_mm2, again.weights_mm2) << name << ", threads " << count;
        EXPECT_EQ(one.target_masses, again.target_masses) << name << ", threads " << count;
        EXPECT_EQ(one.target_centroids_mm, again.target_centroids_mm) << name << ", threads " << count;
      }
    }
  }
  set_thread_count(threads);
}

}  // namespace
}  // namespace lightmill

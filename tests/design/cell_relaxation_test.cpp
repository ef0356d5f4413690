// Growing single cells of a power diagram: the dual falls, and cells get the light they are promised.
#include "design/detail/cell_relaxation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <random>

namespace lightmill::detail {
namespace {

constexpr double kReach = 12;

/// A pattern with black parts, a stroke and a point of light, off centre.
TargetMeasure measure() {
  Grid<double> flux(24, 16);
  for (int row = 0; row < 16; ++row) {
    for (int column = 0; column < 24; ++column) {
      const bool black = (column / 4 + row / 4) % 3 == 0;
      flux.at(column, row) = black ? 0 : 1 + column + 2 * row;
    }
  }
  const double total = std::accumulate(flux.values.begin(), flux.values.end(), 0.0);
  for (double& f : flux.values) f *= 0.6 / total;
  TargetMeasure measure;
  measure.pixels = PixelDensity(flux, Box2{{-9, -5}, {11, 7}});
  measure.strips.push_back({{-6, -3}, Vec2(0.8, 0.6), 10, 0.02, 0.04});
  measure.points.push_back({{4, -2}, 0.1});
  measure.radius = 0.3;
  return measure;
}

struct Start {
  explicit Start(unsigned seed, int count) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> x(-9, 11), y(-5, 7), raise(0, 1);
    for (int i = 0; i < count; ++i) sites.emplace_back(x(random), y(random));
    for (const Vec2& s : sites) psi.push_back(s.squaredNorm() / 2);
    // Some sites are raised until they are hidden or thin.
    for (int i = 0; i < count; i += 7) psi[i] += raise(random);
    wanted.assign(count, 1.0 / count);
  }
  std::vector<Vec2> sites;
  std::vector<double> psi;
  std::vector<double> wanted;
};

struct State {
  PowerDiagram diagram;
  CellIntegrals cells;
  double dual = 0;
};

State state_of(const TargetMeasure& measure, const Start& start, const std::vector<double>& psi) {
  State state;
  state.diagram = PowerDiagramBuilder(start.sites, kReach).build(psi);
  std::vector<int> starts;
  state.cells = integrate_cells(measure, state.diagram, start.sites, psi, starts);
  add_points(measure, share_points(measure, start.sites, psi), state.cells);
  state.dual = points_entropy(measure, state.cells.point_shares);
  for (std::size_t i = 0; i < psi.size(); ++i) {
    state.dual += start.wanted[i] * psi[i] + start.sites[i].dot(state.cells.moments[i]) - psi[i] * state.cells.masses[i];
  }
  return state;
}

int thin_cells(const State& state, const Start& start, double below) {
  int count = 0;
  for (std::size_t i = 0; i < start.wanted.size(); ++i) count += state.cells.masses[i] < below * start.wanted[i];
  return count;
}

TEST(CellRelaxation, GrowingCellsLowersTheDual) {
  const TargetMeasure light = measure();
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    const Start start(seed, 200);
    const State before = state_of(light, start, start.psi);
    ASSERT_FALSE(before.diagram.hidden.empty());
    const RelaxationOptions options{.moves_per_cell = 20, .reach = kReach};
    const std::vector<double> psi =
        relax_cells(light, before.diagram, start.sites, start.psi, before.cells.masses, start.wanted, options);
    const State after = state_of(light, start, psi);
    EXPECT_LT(after.dual, before.dual);
    // Neighbours are looked for in a diagram that ages: a few may be left.
    EXPECT_LE(2 * thin_cells(after, start, options.below), thin_cells(before, start, options.below));
  }
}

TEST(CellRelaxation, ACellAloneGetsWhatItWasPromised) {
  const TargetMeasure light = measure();
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    Start start(seed, 150);
    const State before = state_of(light, start, start.psi);
    const int site = before.diagram.hidden.front().site;
    // All others seem to have enough.
    std::vector<double> masses = start.wanted;
    masses[site] = 0;
    const RelaxationOptions options{.moves_per_cell = 1, .reach = kReach};
    const std::vector<double> psi =
        relax_cells(light, before.diagram, start.sites, start.psi, masses, start.wanted, options);
    const State after = state_of(light, start, psi);
    const double share = after.cells.masses[site] / start.wanted[site];
    EXPECT_GE(share, options.least * (1 - 1e-9));
    EXPECT_LE(share, options.most * (1 + 1e-9));
    for (std::size_t i = 0; i < psi.size(); ++i) {
      if (static_cast<int>(i) == site) continue;
      EXPECT_EQ(psi[i], start.psi[i]);
    }
  }
}

TEST(CellRelaxation, NothingMovesWhereEveryCellHasEnough) {
  const TargetMeasure light = measure();
  const Start start(3, 100);
  const State before = state_of(light, start, start.psi);
  EXPECT_EQ(relax_cells(light, before.diagram, start.sites, start.psi, start.wanted, start.wanted, {.reach = kReach}),
            start.psi);
}

TEST(PolygonMeasure, PartsOfASquareAddUpToTheWhole) {
  const TargetMeasure light = measure();
  const PolygonMeasure polygons(light);
  const std::vector<Vec2> square = {{-kReach, -kReach}, {kReach, -kReach}, {kReach, kReach}, {-kReach, kReach}};
  EXPECT_NEAR(polygons.mass(square), 0.6 + 10 * 0.03, 1e-12);
  // Cut by a line through both, again and again.
  std::mt19937 random(5);
  std::uniform_real_distribution<double> cut(-kReach, kReach);
  for (int k = 0; k < 50; ++k) {
    const Vec2 low(cut(random), -kReach);
    const Vec2 high(cut(random), kReach);
    EXPECT_NEAR(polygons.mass({square[0], low, high, square[3]}) + polygons.mass({low, square[1], square[2], high}),
                polygons.mass(square), 1e-12);
  }
}

}  // namespace
}  // namespace lightmill::detail

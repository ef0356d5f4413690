#include "design/detail/pixel_density.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "design/detail/fills.h"
#include "design/detail/power_diagram.h"
#include "design/detail/target_measure.h"
#include "design/transport.h"

namespace lightmill::detail {
namespace {

using Polygon = std::vector<Vec2>;

double cross(const Vec2& a, const Vec2& b) {
  return a.x() * b.y() - a.y() * b.x();
}

/// What a viewer shows at a place: pixels plus fills, each over those before it.
struct Scene {
  Box2 extent;
  Grid<double> flux;
  std::vector<Fill> fills;

  [[nodiscard]] double density(const Vec2& p) const {
    if (!extent.contains(p)) return 0;
    double sum = 0;
    for (const Fill& fill : fills) {
      int winding = 0;
      for (const Polygon& outline : fill.shape.outlines_mm) {
        for (std::size_t k = 0; k < outline.size(); ++k) {
          const Vec2& a = outline[k];
          const Vec2& b = outline[(k + 1) % outline.size()];
          if ((a.y() <= p.y()) == (b.y() <= p.y())) continue;
          if (a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x()) < p.x()) winding += a.y() < b.y() ? 1 : -1;
        }
      }
      if (fill.shape.rule == FillRule::kNonZero ? winding != 0 : winding % 2 != 0)
        sum += fill.opacity * (fill.light - sum);
    }
    const Vec2 pitch = extent.size().cwiseQuotient(Vec2(flux.width, flux.height));
    const Vec2 at = (p - extent.min).cwiseQuotient(pitch);
    return sum + flux.at(std::min(static_cast<int>(at.x()), flux.width - 1),
                         std::min(static_cast<int>(at.y()), flux.height - 1)) /
                     pitch.prod();
  }
  /// Every line along which the density may change.
  [[nodiscard]] std::vector<std::pair<Vec2, Vec2>> segments() const {
    std::vector<std::pair<Vec2, Vec2>> all;
    for (const Fill& fill : fills) {
      for (const Polygon& outline : fill.shape.outlines_mm) {
        for (std::size_t k = 0; k < outline.size(); ++k)
          all.emplace_back(outline[k], outline[(k + 1) % outline.size()]);
      }
    }
    const Vec2 pitch = extent.size().cwiseQuotient(Vec2(flux.width, flux.height));
    for (int k = 0; k <= flux.width; ++k) {
      const double x = extent.min.x() + k * pitch.x();
      all.emplace_back(Vec2(x, extent.min.y()), Vec2(x, extent.max.y()));
    }
    for (int k = 0; k <= flux.height; ++k) {
      const double y = extent.min.y() + k * pitch.y();
      all.emplace_back(Vec2(extent.min.x(), y), Vec2(extent.max.x(), y));
    }
    return all;
  }
  [[nodiscard]] PixelDensity measured() const { return {flux, extent, borders_of({fills, {}, {}}, extent)}; }
};

struct Truth {
  double mass = 0;
  Vec2 moment{0, 0};
};

/// Integral over a polygon, line by line: between the heights where anything begins, ends or crosses, it is a
/// polynomial in y that three places of Gauss see exactly.
Truth integral(const Scene& scene, const Polygon& cell) {
  auto segments = scene.segments();
  const std::size_t of_scene = segments.size();
  for (std::size_t k = 0; k < cell.size(); ++k) segments.emplace_back(cell[k], cell[(k + 1) % cell.size()]);
  std::vector<double> heights;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const auto& [a, b] = segments[i];
    heights.push_back(a.y());
    heights.push_back(b.y());
    for (std::size_t j = 0; j < i; ++j) {
      const auto& [c, d] = segments[j];
      const double denominator = cross(b - a, d - c);
      if (denominator == 0) continue;
      const double s = cross(c - a, d - c) / denominator;
      const double t = cross(c - a, b - a) / denominator;
      if (s >= 0 && s <= 1 && t >= 0 && t <= 1) heights.push_back(a.y() + s * (b.y() - a.y()));
    }
  }
  std::sort(heights.begin(), heights.end());
  Truth truth;
  for (std::size_t l = 0; l + 1 < heights.size(); ++l) {
    const double step = heights[l + 1] - heights[l];
    if (step < 1e-13) continue;
    for (const auto& [t, weight] :
         {std::pair(-std::sqrt(0.6), 5.0 / 18), std::pair(0.0, 8.0 / 18), std::pair(std::sqrt(0.6), 5.0 / 18)}) {
      const double y = heights[l] + step * (0.5 + 0.5 * t);
      std::vector<double> xs;
      double from = 1e300;
      double to = -1e300;
      for (std::size_t k = 0; k < segments.size(); ++k) {
        const auto& [a, b] = segments[k];
        if ((a.y() <= y) == (b.y() <= y)) continue;
        const double x = a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
        xs.push_back(x);
        if (k < of_scene) continue;
        from = std::min(from, x);
        to = std::max(to, x);
      }
      std::sort(xs.begin(), xs.end());
      for (std::size_t k = 0; k + 1 < xs.size(); ++k) {
        const double middle = (xs[k] + xs[k + 1]) / 2;
        if (middle <= from || middle >= to) continue;
        const double m = scene.density({middle, y}) * (xs[k + 1] - xs[k]) * step * weight;
        truth.mass += m;
        truth.moment += m * Vec2(middle, y);
      }
    }
  }
  return truth;
}

/// Mean density along an edge times its length.
double along(const Scene& scene, const Vec2& p, const Vec2& q) {
  std::vector<double> cuts{0, 1};
  for (const auto& [a, b] : scene.segments()) {
    const double denominator = cross(q - p, b - a);
    if (denominator == 0) continue;
    const double s = cross(a - p, b - a) / denominator;
    if (s > 0 && s < 1) cuts.push_back(s);
  }
  std::sort(cuts.begin(), cuts.end());
  double sum = 0;
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k)
    sum += (cuts[k + 1] - cuts[k]) * scene.density(p + (cuts[k] + cuts[k + 1]) / 2 * (q - p));
  return sum * (q - p).norm();
}

Truth contour(const PixelDensity& density, const Polygon& cell) {
  Truth sum;
  for (std::size_t k = 0; k < cell.size(); ++k) {
    const auto part = density.along(cell[k], cell[(k + 1) % cell.size()]);
    sum.mass += part.mass;
    sum.moment += part.moment;
  }
  return sum;
}

void expect_equal(const Truth& found, const Truth& wanted, double scale, const std::string& what) {
  EXPECT_NEAR(found.mass, wanted.mass, 1e-11 * scale) << what;
  EXPECT_NEAR(found.moment.x(), wanted.moment.x(), 1e-10 * scale) << what;
  EXPECT_NEAR(found.moment.y(), wanted.moment.y(), 1e-10 * scale) << what;
}

/// Numbers anywhere, or on a lattice of half pixels, where borders of pixels, of fills and of cells meet and coincide.
struct Places {
  std::mt19937 random;
  bool lattice;
  Vec2 operator()(const Vec2& from, const Vec2& to) {
    const auto pick = [&](int axis) {
      if (lattice) {
        return std::uniform_int_distribution<int>(static_cast<int>(2 * from[axis]),
                                                  static_cast<int>(2 * to[axis]))(random) /
               2.0;
      }
      return std::uniform_real_distribution<double>(from[axis], to[axis])(random);
    };
    const double x = pick(0);
    return {x, pick(1)};
  }
};

/// A counter-clockwise convex polygon: the hull of a few points (Andrew's chain).
Polygon hull(std::vector<Vec2> points) {
  const auto before = [](const Vec2& a, const Vec2& b) { return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y()); };
  std::sort(points.begin(), points.end(), before);
  Polygon chain;
  for (int pass = 0; pass < 2; ++pass) {
    const std::size_t start = chain.size();
    for (const Vec2& p : points) {
      while (chain.size() >= start + 2 && cross(chain.back() - chain[chain.size() - 2], p - chain.back()) <= 0)
        chain.pop_back();
      chain.push_back(p);
    }
    chain.pop_back();
    std::reverse(points.begin(), points.end());
  }
  return chain;
}

Scene random_scene(Places& places, int trial) {
  Scene scene;
  scene.extent = {{-2, 1}, {4, 5}};  // of 6 x 4 pixels, 1 mm each, or others
  const int shapes[][2] = {{6, 4}, {1, 1}, {12, 4}, {3, 8}};
  scene.flux = Grid<double>(shapes[trial % 4][0], shapes[trial % 4][1]);
  if (trial % 3 == 0) {
    for (double& f : scene.flux.values) f = std::uniform_real_distribution<double>(0, 1)(places.random);
  }
  const int count = 1 + trial % 3;
  for (int k = 0; k < count; ++k) {
    Fill fill;
    fill.shape.rule = (trial + k) % 2 == 0 ? FillRule::kEvenOdd : FillRule::kNonZero;
    fill.light = k % 2 == 0 ? 1 + k : 0.3;
    fill.opacity = trial % 5 == 0 ? 1 : 0.6;
    fill.shape.outlines_mm.resize(1 + trial % 2);
    for (Polygon& outline : fill.shape.outlines_mm) {
      for (int v = 0; v < 3 + trial % 5; ++v) outline.push_back(places({-3, 0}, {5, 6}));  // partly outside
    }
    scene.fills.push_back(fill);
  }
  return scene;
}

TEST(PixelDensity, FillsOverConvexCellsAreWhatIntegrationLineByLineFinds) {
  for (const bool lattice : {false, true}) {
    Places places{std::mt19937(lattice ? 5 : 4), lattice};
    for (int trial = 0; trial < 60; ++trial) {
      const Scene scene = random_scene(places, trial);
      const PixelDensity density = scene.measured();
      const std::string what = "seed " + std::to_string(lattice ? 5 : 4) + ", trial " + std::to_string(trial);
      for (int c = 0; c < 3; ++c) {
        std::vector<Vec2> corners;
        for (int k = 0; k < 3 + c; ++k) corners.push_back(places({-3, 0}, {5, 6}));
        const Polygon cell = hull(corners);
        if (cell.size() < 3) continue;
        expect_equal(contour(density, cell), integral(scene, cell), 50, what);
        const auto there = density.along(cell[0], cell[1]);
        const auto back = density.along(cell[1], cell[0]);
        EXPECT_EQ(there.mass, -back.mass) << what;
        EXPECT_EQ(there.moment, -back.moment) << what;
        if (!lattice) {  // off every border
          EXPECT_NEAR(there.line, along(scene, cell[0], cell[1]), 1e-10) << what;
        }
      }
    }
  }
}

TEST(PixelDensity, TinyCellsInsideAPixelAreExactToo) {
  Places places{std::mt19937(8), false};
  for (int trial = 0; trial < 30; ++trial) {
    const Scene scene = random_scene(places, trial);
    const PixelDensity density = scene.measured();
    const Vec2 centre = places({-2, 1}, {4, 5});
    std::vector<Vec2> corners;
    for (int k = 0; k < 5; ++k) corners.push_back(centre + 0.02 * places({-1, -1}, {1, 1}));
    const Polygon cell = hull(corners);
    expect_equal(contour(density, cell), integral(scene, cell), 1, "seed 8, trial " + std::to_string(trial));
  }
}

TEST(PixelDensity, ShapesThinnerThanAPixelKeepTheirPlace) {
  Scene scene;
  scene.extent = {{0, 0}, {10, 10}};
  scene.flux = Grid<double>(5, 5);
  // A needle within one column of pixels, and a hair across many.
  scene.fills.push_back({{{{{2.3, 0.7}, {2.31, 9.6}, {2.305, 9.6}}}}, 1, 1, -1, {}});
  scene.fills.push_back({{{{{0.1, 4.1}, {9.9, 4.9}, {9.9, 4.901}}}}, 2, 1, -1, {}});
  const PixelDensity density = scene.measured();
  for (const Polygon& cell :
       {Polygon{{2.2, 1}, {2.304, 1}, {2.304, 9}, {2.2, 9}}, Polygon{{2.25, 3}, {2.9, 4}, {2.6, 5}},
        Polygon{{8, 4}, {9.5, 4.5}, {9.7, 4.89}, {8, 4.75}}}) {
    const Truth wanted = integral(scene, cell);
    EXPECT_GT(wanted.mass, 0);
    expect_equal(contour(density, cell), wanted, 0.1, "");
  }
}

TEST(PixelDensity, WhatLiesBetweenFillsIsExactlyBlack) {
  Scene scene;
  scene.extent = {{0, 0}, {9, 7}};
  scene.flux = Grid<double>(90, 70);
  Polygon circle;
  for (int k = 0; k < 97; ++k)
    circle.emplace_back(2 + 1.37 * std::cos(2 * kPi * k / 97), 3 + 1.37 * std::sin(2 * kPi * k / 97));
  scene.fills.push_back({{{circle}}, 1.0 / 3, 0.7, -1, {}});
  scene.fills.push_back({{{{{5.01, 1.3}, {8.3, 2.2}, {6.1, 6.33}}}}, 0.1, 1, -1, {}});
  const PixelDensity density = scene.measured();
  for (const Polygon& cell :
       {Polygon{{3.6, 0.3}, {4.9, 0.3}, {4.9, 6}, {3.6, 6}}, Polygon{{8.5, 0}, {9, 0}, {9, 7}, {8.5, 7}}}) {
    const Truth sum = contour(density, cell);
    EXPECT_LT(std::abs(sum.mass), 1e-13);
    for (std::size_t k = 0; k < cell.size(); ++k)
      EXPECT_EQ(density.along(cell[k], cell[(k + 1) % cell.size()]).line, 0);
  }
}

TEST(PixelDensity, PowerDiagramsShareOutAllLight) {
  Places places{std::mt19937(21), false};
  for (int trial = 0; trial < 6; ++trial) {
    const Scene scene = random_scene(places, trial);
    TargetLight target;
    target.extent = scene.extent;
    target.area_flux = scene.flux;
    target.area_borders = borders_of({scene.fills, {}, {}}, scene.extent);
    target.normalise();
    std::vector<Vec2> sites;
    std::vector<double> psi;
    for (int k = 0; k < 400; ++k) {
      sites.push_back(places({-2, 1}, {4, 5}));
      psi.push_back(sites.back().squaredNorm() / 2 +
                    std::uniform_real_distribution<double>(-0.02, 0.02)(places.random));
    }
    PowerDiagramBuilder builder(sites, 100);
    std::vector<int> starts;
    const auto cells = integrate_cells(measure_of(target, {0, 0}, 0), builder.build(psi), sites, psi, starts);
    double mass = 0;
    Vec2 moment(0, 0);
    for (std::size_t k = 0; k < sites.size(); ++k) {
      mass += cells.masses[k];
      moment += cells.moments[k];
      EXPECT_GT(cells.masses[k], -1e-14) << "seed 21, trial " << trial;
    }
    EXPECT_NEAR(mass, 1, 1e-12) << "seed 21, trial " << trial;
    EXPECT_LT((moment - spread_of(target, 0).mean).norm(), 1e-11) << "seed 21, trial " << trial;
  }
}

TEST(PixelDensity, AFilledRectangleIsReachedByAnAffineMap) {
  // Whatever the pixels: its sides lie on none of their borders.
  SourceLight source;
  source.size_mm = {60, 40};
  TargetLight target;
  target.extent = {{-50, -50}, {50, 50}};
  const Box2 lit{{-13.377, -41.0331}, {28.613, 22.719}};
  target.area_borders = borders_of(
      {{{{{{lit.min, {lit.max.x(), lit.min.y()}, lit.max, {lit.min.x(), lit.max.y()}}}}, 1, 1, -1, {}}}, {}, {}},
      target.extent);
  target.normalise();
  TransportOptions options;
  options.samples = 384;
  options.l1_tolerance = options.max_tolerance = 1e-10;
  const TransportMap map = solve_transport(source, target, options);
  for (std::size_t k = 0; k < map.sites_mm.size(); ++k) {
    const Vec2 wanted = lit.centre() + map.sites_mm[k].cwiseProduct(lit.size().cwiseQuotient(source.size_mm));
    EXPECT_LT((map.target_centroids_mm[k] - wanted).norm(), 1e-7);
  }
}

}  // namespace
}  // namespace lightmill::detail

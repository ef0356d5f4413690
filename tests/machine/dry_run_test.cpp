#include "machine/dry_run.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <random>

#include "cam/finishing.h"
#include "design/core/errors.h"
#include "design/core/parallel.h"

namespace lightmill {
namespace {

/// A spline that follows f: coefficients f - span^2 f'' / 6 reproduce cubics, the rest is of fourth order in the span.
template <typename F>
SplineSurface spline_of(const Box2& extent, int spans_x, int spans_y, F&& f) {
  Grid<double> coefficients(spans_x + 3, spans_y + 3);
  const double px = extent.size().x() / spans_x;
  const double py = extent.size().y() / spans_y;
  for (int j = 0; j < spans_y + 3; ++j) {
    for (int i = 0; i < spans_x + 3; ++i) {
      const double x = extent.min.x() + (i - 1) * px;
      const double y = extent.min.y() + (j - 1) * py;
      const double f0 = f(x, y);
      const double xx = f(x + px, y) - 2 * f0 + f(x - px, y);
      const double yy = f(x, y + py) - 2 * f0 + f(x, y - py);
      coefficients.at(i, j) = f0 - xx / 6 - yy / 6;
    }
  }
  return {extent, spans_x, spans_y, coefficients};
}

MachinedSurface exactly(const SplineSurface& design, const Box2& extent, double pitch) {
  MachinedSurface surface;
  surface.extent = extent;
  surface.pitch_mm = pitch;
  const int width = static_cast<int>(std::lround(extent.size().x() / pitch)) + 1;
  const int height = static_cast<int>(std::lround(extent.size().y() / pitch)) + 1;
  surface.heights_mm = Grid<float>(width, height);
  for (int j = 0; j < height; ++j) {
    for (int i = 0; i < width; ++i) {
      surface.heights_mm.at(i, j) =
          static_cast<float>(design.height(extent.min.x() + pitch * i, extent.min.y() + pitch * j));
    }
  }
  surface.peaks_mm = surface.heights_mm;
  surface.peak_offsets = Grid<PeakOffset>(width, height);
  return surface;
}

TEST(Deviation, FindsAGougeAndACuspWithPlaceAndSize) {
  const Box2 extent{{-4, -2.5}, {4, 2.5}};
  const SplineSurface design = spline_of(
      extent, 80, 50, [](double x, double y) { return 9 + 0.3 * std::sin(0.5 * x) * std::cos(0.4 * y + 0.2); });
  MachinedSurface machined = exactly(design, extent, 0.05);
  Deviation deviation = measure_deviation(machined, design, {});
  EXPECT_LT(deviation.max_gouge_um, 0.02) << "nothing but float heights";
  EXPECT_LT(deviation.max_cusp_um, 0.02);
  EXPECT_EQ(deviation.gouged_area_mm2, 0);
  EXPECT_EQ(deviation.unreachable_area_mm2, 0);

  // 12.5 um too deep over 3 nodes, a ridge of 2.25 um of which the node itself sees only 1.5, and 1 um over 5 % of the
  // part.
  for (int i = 30; i < 33; ++i) {
    machined.heights_mm.at(i, 20) -= i == 31 ? 0.0125F : 0.004F;
    machined.peaks_mm.at(i, 20) = machined.heights_mm.at(i, 20);
  }
  machined.heights_mm.at(110, 77) += 0.0015F;
  machined.peaks_mm.at(110, 77) += 0.00225F;
  for (int j = 40; j < 46; ++j) {
    for (int i = 0; i < machined.heights_mm.width; ++i) machined.peaks_mm.at(i, j) += 0.001F;
  }
  deviation = measure_deviation(machined, design, {});
  EXPECT_NEAR(deviation.max_gouge_um, 12.5, 0.02);
  EXPECT_NEAR((deviation.gouge_place_mm - Vec2(-4 + 31 * 0.05, -2.5 + 20 * 0.05)).norm(), 0, 1e-9);
  EXPECT_NEAR(deviation.gouged_area_mm2, 3 * 0.05 * 0.05, 1e-9);
  EXPECT_NEAR(deviation.max_cusp_um, 2.25, 0.02);
  EXPECT_NEAR((deviation.cusp_place_mm - Vec2(-4 + 110 * 0.05, -2.5 + 77 * 0.05)).norm(), 0, 1e-9);
  EXPECT_NEAR(deviation.p99_cusp_um, 1, 0.02);
  EXPECT_EQ(deviation.residue_um, 0);
  EXPECT_NEAR(deviation.deviation_um.at(31, 20), -12.5, 0.02);
  EXPECT_NEAR(deviation.deviation_um.at(110, 77), 1.5, 0.02);

  // A rim that holds both is left out of the measures, not of the map.
  DeviationOptions inner;
  inner.border_mm = 1.2;
  const Deviation within = measure_deviation(machined, design, inner);
  EXPECT_LT(within.max_gouge_um, 0.02);
  EXPECT_NEAR(within.max_cusp_um, 1, 0.02);
  EXPECT_EQ(within.deviation_um.values, deviation.deviation_um.values);
}

double sum(const DeviationHistogram& h) {
  return std::accumulate(h.area_mm2.begin(), h.area_mm2.end(), h.below_mm2 + h.above_mm2);
}

// Its bins hold all of the area, each height where it belongs: a plane with a quarter of it 2.2 um low and another 1.3 um high.
TEST(Deviation, TheHistogramHoldsTheAreaByHeight) {
  const Box2 extent{{-4, -2.5}, {4, 2.5}};
  const SplineSurface design = spline_of(extent, 8, 5, [](double, double) { return 9.0; });
  MachinedSurface machined = exactly(design, extent, 0.05);
  const auto area_in = [](const DeviationHistogram& h, double from_um, double to_um) {
    double area = 0;
    for (std::size_t k = 0; k < h.area_mm2.size(); ++k) {
      const double middle = h.first_um + (static_cast<double>(k) + 0.5) * h.bin_um;
      if (middle > from_um && middle < to_um) area += h.area_mm2[k];
    }
    return area;
  };
  for (float& height : machined.heights_mm.values) height += 1e-5F;  // off a bin's edge
  EXPECT_NEAR(sum(measure_deviation(machined, design, {}).histogram), 40, 1e-6);
  for (int j = 0; j < machined.heights_mm.height; ++j) {
    for (int i = 0; i < 40; ++i) machined.heights_mm.at(i, j) -= 2.21e-3F;
    for (int i = 120; i < machined.heights_mm.width; ++i) machined.heights_mm.at(i, j) += 1.31e-3F;
  }
  const DeviationHistogram histogram = measure_deviation(machined, design, {}).histogram;
  EXPECT_NEAR(sum(histogram), 40, 1e-6);
  EXPECT_LE(histogram.bin_um, 0.1);
  EXPECT_EQ(std::round(histogram.first_um / histogram.bin_um) * histogram.bin_um, histogram.first_um) << "zero is an edge";
  EXPECT_NEAR(area_in(histogram, -2.3, -2.1), 10, 0.2) << "a row of nodes";
  EXPECT_NEAR(area_in(histogram, 1.2, 1.4), 10, 0.2);
  EXPECT_NEAR(area_in(histogram, -0.1, 0.1), 20, 0.2);

  // What is far off keeps the rest readable, and is not lost.
  machined.heights_mm.at(80, 50) -= 3;
  const DeviationHistogram far = measure_deviation(machined, design, {}).histogram;
  EXPECT_EQ(far.bin_um, histogram.bin_um);
  EXPECT_NEAR(far.below_mm2, 0.05 * 0.05, 1e-9);
  EXPECT_NEAR(sum(far), 40, 1e-6);
}

TEST(Deviation, JudgesAConcaveCreaseByWhatTheBallCanReach) {
  // A valley of slopes -+0.2 along y: the ball (R 2) leaves an arc of R tan(half the angle) 0.392 to both sides, 39.6
  // um high.
  const double slope = 0.2;
  const double r = 2;
  const Box2 extent{{-3, -1}, {3, 1}};
  const SplineSurface design = spline_of(extent, 240, 80, [&](double x, double) { return 5 + slope * std::abs(x); });
  const double reach = r * slope / std::sqrt(1 + slope * slope);
  MachinedSurface machined = exactly(design, extent, 0.02);
  for (int j = 0; j < machined.heights_mm.height; ++j) {
    for (int i = 0; i < machined.heights_mm.width; ++i) {
      const double x = -3 + 0.02 * i;
      if (std::abs(x) < reach) {
        machined.heights_mm.at(i, j) =
            static_cast<float>(5 + r * std::sqrt(1 + slope * slope) - std::sqrt(r * r - x * x));
      }
    }
  }
  machined.peaks_mm = machined.heights_mm;
  Deviation deviation = measure_deviation(machined, design, {});
  EXPECT_LT(deviation.max_gouge_um, 0.5);
  EXPECT_LT(deviation.max_cusp_um, 0.15) << "the arc is residue, not cusp";
  EXPECT_NEAR(deviation.residue_um, r * (std::sqrt(1 + slope * slope) - 1) * 1000 - design.height(0, 0) * 1000 + 5000,
              0.3);
  EXPECT_NEAR(deviation.unreachable_area_mm2, 2 * 2 * reach, 0.15 * 2 * 2 * reach);
  // Cut below the arc, yet above the design: a gouge by the reachable surface all the same.
  const int i = 150;
  machined.heights_mm.at(i, 33) -= 0.003F;
  deviation = measure_deviation(machined, design, {});
  EXPECT_NEAR(deviation.max_gouge_um, 3, 0.5);
  EXPECT_NEAR(deviation.gouge_place_mm.x(), 0, 1e-9);
  // Material left in the arc is residue, outside of it a cusp.
  machined.peaks_mm.at(i, 40) += 0.005F;
  machined.peaks_mm.at(250, 60) += 0.0017F;
  deviation = measure_deviation(machined, design, {});
  EXPECT_NEAR(deviation.max_cusp_um, 1.7 / std::sqrt(1 + slope * slope), 0.02) << "along the normal";
  EXPECT_GT(deviation.residue_um, 39);
}

/// A block of 9 mm after passes of a ball along y, its centre at these x and z.
MachinedSurface milled_along_y(const Vec2& size, double radius, const std::vector<Vec2>& centres) {
  StockModel model({size, 9}, {0.02, 0});
  Cutter ball;
  ball.diameter_mm = 2 * radius;
  ball.corner_radius_mm = radius;
  ball.flute_length_mm = 8;
  ball.shank_diameter_mm = 4;
  ball.length_mm = 50;
  model.set_cutter(ball);
  const Vec3 axis = Vec3(0.2, 0.4, 1).normalized();
  SweptMove move;
  move.spindle_on = true;
  for (const Vec2& centre : centres) {
    const Vec3 tip = Vec3(centre.x(), 0, centre.y()) - radius * axis;
    move.from = {tip + Vec3(0, -4, 0), axis};
    move.to = {tip + Vec3(0, 4, 0), axis};
    ++move.line;
    model.move(move);
  }
  model.flush();
  EXPECT_TRUE(model.faults().empty());
  return model.surface();
}

TEST(Deviation, OfAMilledCylinderIsItsScallops) {
  // Ball passes along y at equal angles over a convex cylinder of radius 30 whose axis lies along y.
  const double big = 30;
  const double r = 2;
  const double angle = 0.14 / big;
  const auto height = [&](double x, double) { return 8 - big + std::sqrt(big * big - x * x); };
  const Box2 extent{{-3, -1}, {3, 1}};
  const SplineSurface design = spline_of(extent, 120, 40, height);
  std::vector<Vec2> centres;
  for (int k = -40; k <= 40; ++k) {
    const double t = (k + 0.37) * angle;
    centres.emplace_back(std::sin(t) * (big + r), 8 - big + std::cos(t) * (big + r));
  }
  const Deviation deviation = measure_deviation(milled_along_y({6, 2}, r, centres), design, {});
  // Between two centres at distance big + r the ridge stands this high along the cylinder's normal.
  const double half_chord = (big + r) * std::sin(angle / 2);
  const double cusp = (big + r) * std::cos(angle / 2) - std::sqrt(r * r - half_chord * half_chord) - big;
  EXPECT_NEAR(deviation.max_cusp_um, cusp * 1000, 0.01);
  EXPECT_NEAR(deviation.p99_cusp_um, cusp * 1000, 0.01 * cusp * 1000);
  EXPECT_LT(deviation.max_gouge_um, 0.02);
  EXPECT_EQ(deviation.unreachable_area_mm2, 0);
}

// In a hollow cylinder little wider than the ball the surface bends away by more than a cusp's share between a ridge and its node.
TEST(Deviation, OfAMilledHollowIsItsScallops) {
  const double hollow = 2.4;
  const double r = 2;
  const double axis_z = 8;
  const SplineSurface design = spline_of({{-1, -0.5}, {1, 0.5}}, 160, 80, [&](double x, double) { return axis_z - std::sqrt(hollow * hollow - x * x); });
  const double to_centre = hollow - r;
  const double angle = 0.31;
  std::vector<Vec2> centres;
  for (int k = -4; k <= 4; ++k) {
    const double t = (k + 0.37) * angle;
    centres.emplace_back(std::sin(t) * to_centre, axis_z - std::cos(t) * to_centre);
  }
  const Deviation deviation = measure_deviation(milled_along_y({2, 1}, r, centres), design, {});
  const double half_chord = to_centre * std::sin(angle / 2);
  const double cusp = hollow - to_centre * std::cos(angle / 2) - std::sqrt(r * r - half_chord * half_chord);
  EXPECT_NEAR(deviation.max_cusp_um, cusp * 1000, 0.005);
  const double from_ridge = std::remainder(std::asin(deviation.cusp_place_mm.x() / (hollow - cusp)) - 0.87 * angle, angle);
  EXPECT_NEAR(from_ridge * hollow, 0, 2e-4) << "told where it stands, not at its node";
}

// Along a fold oblique to the passes contacts move fast: the chords' heights show in the cusps, and a ridge is not half-way.
TEST(Deviation, HasTheHighestCuspThatWasPlanned) {
  const Box2 extent{{-3, -2}, {3, 2}};
  for (const double phase : {1.5, 2.1, 2.7}) {
    const SplineSurface design = spline_of(extent, 48, 32, [&](double x, double y) {
      return 8 + 0.03 * x + 0.08 * std::hypot(y - 0.4 * x - 0.3, 0.4) + 0.07 * std::sin(0.5 * x + y + phase);
    });
    const Blank blank{extent.size(), design.highest() + 0.1};
    const ToolPath path = plan_finishing(design, blank, read_cutter(LIGHTMILL_FIXTURES "/cutters/finish_4mm_ball.toml"), {});
    StockModel model(blank, {0.02, 0});
    model.lower_to([&](const Vec2& p) { return design.height(p.x(), p.y()) + 0.06; });
    model.set_cutter(path.cutter);
    SweptMove move;
    move.spindle_on = true;
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      move.from = path.moves[k - 1].pose;
      move.to = path.moves[k].pose;
      if (path.moves[k].kind != MoveKind::kRapid) model.move(move);
    }
    model.flush();
    const Deviation deviation = measure_deviation(model.surface(), design, {});
    EXPECT_EQ(path.above_limit_mm2, 0);
    EXPECT_NEAR(deviation.max_cusp_um, path.predicted_cusp_um, 0.005) << phase;
  }
}

TEST(Deviation, StopsWhenAskedAndDoesNotDependOnThreads) {
  const Box2 extent{{-2, -1.5}, {2, 1.5}};
  const SplineSurface design = spline_of(extent, 20, 15, [](double x, double y) { return 5 + 0.1 * x * y; });
  const MachinedSurface machined = exactly(design, extent, 0.05);
  Monitor stopping;
  stopping.should_stop = [] { return true; };
  EXPECT_THROW(measure_deviation(machined, design, {}, stopping), Stopped);
  set_thread_count(1);
  const Deviation one = measure_deviation(machined, design, {});
  set_thread_count(3);
  const Deviation three = measure_deviation(machined, design, {});
  set_thread_count(0);
  EXPECT_EQ(one.deviation_um.values, three.deviation_um.values);
  EXPECT_EQ(one.p99_cusp_um, three.p99_cusp_um);
  EXPECT_THROW(measure_deviation(machined, design, DeviationOptions{0, 1, 0}), InputError);
}

TEST(Polish, DampsASineByTheGaussiansTransform) {
  // Sines that are odd about both ends are eigenfunctions of any symmetric filter with point-reflected borders.
  const int width = 241;
  const int height = 161;
  const double pitch = 0.02;
  for (const double sigma_um : {25.0, 50.0, 100.0}) {
    for (const auto& [m, n] : {std::pair(12, 7), std::pair(40, 1), std::pair(3, 30)}) {
      Grid<float> heights(width, height);
      for (int j = 0; j < height; ++j) {
        for (int i = 0; i < width; ++i) {
          heights.at(i, j) =
              static_cast<float>(std::sin(kPi * m * i / (width - 1)) * std::sin(kPi * n * j / (height - 1)));
        }
      }
      const Grid<float> polished = polish(heights, pitch, sigma_um);
      const double kx = kPi * m / ((width - 1) * pitch);
      const double ky = kPi * n / ((height - 1) * pitch);
      const double sigma = sigma_um / 1000;
      const double damping = std::exp(-(kx * kx + ky * ky) * sigma * sigma / 2);
      for (std::size_t k = 0; k < heights.values.size(); ++k) {
        ASSERT_NEAR(polished.values[k], damping * heights.values[k], 4e-7) << sigma_um << " " << m << " " << n;
      }
    }
  }
}

TEST(Polish, KeepsPlanesUpToTheRimAndComposes) {
  Grid<float> heights(90, 70);
  for (int j = 0; j < heights.height; ++j) {
    for (int i = 0; i < heights.width; ++i) heights.at(i, j) = static_cast<float>(12.5 + 0.01 * i - 0.007 * j);
  }
  const Grid<float> plane = polish(heights, 0.02, 100);
  for (std::size_t k = 0; k < plane.values.size(); ++k) ASSERT_NEAR(plane.values[k], heights.values[k], 3e-6);
  EXPECT_EQ(polish(heights, 0.02, 0).values, heights.values);
  std::mt19937 random(11);
  std::uniform_real_distribution<float> any(0, 1);
  for (float& value : heights.values) value = any(random);
  // Two polishes are one of the root of the sum of squares; narrow grids are reflected more than once.
  for (const double scale : {1.0, 8.0}) {
    const Grid<float> twice = polish(polish(heights, 0.02, 30 * scale), 0.02, 40 * scale);
    const Grid<float> once = polish(heights, 0.02, 50 * scale);
    for (std::size_t k = 0; k < once.values.size(); ++k) ASSERT_NEAR(twice.values[k], once.values[k], 5e-6);
  }
  set_thread_count(1);
  const Grid<float> one = polish(heights, 0.02, 70);
  set_thread_count(0);
  EXPECT_EQ(one.values, polish(heights, 0.02, 70).values);
  EXPECT_THROW(polish(heights, 0.02, -1), InputError);
  EXPECT_THROW(polish(heights, 0, 1), InputError);
}

TEST(Polish, TakesAwayAtLeastWhatLiesHighestOverTheMilledSurface) {
  // One milled pit 3 um deep in a plane inside the disk, and a deep slot around it that does not count.
  MachinedSurface milled;
  milled.pitch_mm = 0.05;
  milled.extent = Box2::centred({12, 12});
  milled.heights_mm = Grid<float>(241, 241, 5);
  Grid<float> polished = milled.heights_mm;
  milled.heights_mm.at(130, 121) = 5 - 0.003F;
  for (int i = 0; i < 241; ++i) milled.heights_mm.at(i, 10) = 0;
  const Outline disk{Outline::Shape::kDisk, {10, 10}, {}};
  EXPECT_NEAR(polish_removal_um(milled, polished, disk, 0.5), 3, 1e-3);
  // In the rim it does not count, either.
  milled.heights_mm.at(130, 121) = 5;
  milled.heights_mm.at(120 + 96, 121) = 4;
  EXPECT_EQ(polish_removal_um(milled, polished, disk, 0.5), 0);
}

}  // namespace
}  // namespace lightmill

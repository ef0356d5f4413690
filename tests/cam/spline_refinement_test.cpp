#include "cam/detail/spline_refinement.h"

#include <gtest/gtest.h>

#include <random>

#include "cam/spline_surface.h"

namespace lightmill {
namespace {

const Box2 kExtent{{-3, 5}, {9, 12}};

Grid<double> random_coefficients(int spans_x, int spans_y) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(9, 11);
  Grid<double> c(spans_x + 3, spans_y + 3);
  for (double& value : c.values) value = uniform(random);
  return c;
}

TEST(SplineRefinement, HalvedSpansAreTheSameSurface) {
  for (const auto& [nx, ny] : {std::pair(11, 5), std::pair(1, 1), std::pair(2, 7)}) {
    const Grid<double> coarse = random_coefficients(nx, ny);
    const SplineSurface a(kExtent, nx, ny, coarse), b(kExtent, 2 * nx, 2 * ny, detail::with_spans_halved(coarse));
    for (double x = -3; x <= 9; x += 0.37) {
      for (double y = 5; y <= 12; y += 0.29) {
        const auto s = a.sample(x, y), t = b.sample(x, y);
        EXPECT_NEAR(s.h, t.h, 1e-13);
        EXPECT_NEAR(s.hx, t.hx, 1e-12);
        EXPECT_NEAR(s.hyy, t.hyy, 1e-11);
        EXPECT_NEAR(s.hxy, t.hxy, 1e-11);
      }
    }
  }
}

TEST(SplineRefinement, DoubledSpansUndoThat) {
  const Grid<double> coarse = random_coefficients(6, 9);
  const auto again = detail::with_spans_doubled(detail::with_spans_halved(coarse), 1e-11);
  ASSERT_TRUE(again.has_value());
  ASSERT_EQ(again->width, coarse.width);
  ASSERT_EQ(again->height, coarse.height);
  for (std::size_t k = 0; k < coarse.values.size(); ++k) EXPECT_NEAR(again->values[k], coarse.values[k], 1e-12);
}

TEST(SplineRefinement, OneCoefficientAsideIsNoCoarserSurface) {
  Grid<double> fine = detail::with_spans_halved(random_coefficients(6, 9));
  for (std::size_t k = 0; k < fine.values.size(); ++k) {
    fine.values[k] += 1e-9;
    EXPECT_FALSE(detail::with_spans_doubled(fine, 1e-11).has_value()) << k;
    fine.values[k] -= 1e-9;
  }
  EXPECT_FALSE(detail::with_spans_doubled(random_coefficients(7, 6), 1e9).has_value()) << "an odd number of spans";
}

}  // namespace
}  // namespace lightmill

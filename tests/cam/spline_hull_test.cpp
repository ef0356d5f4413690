#include "cam/detail/spline_hull.h"

#include <gtest/gtest.h>

#include <functional>
#include <random>
#include <utility>

namespace lightmill {
namespace {

const Box2 kExtent{{-3, 5}, {9, 12}};
constexpr double kMarginMm = 40;  // farther out than the padded knots: there the surface goes straight on

SplineSurface surface_of(int spans_x, int spans_y, const std::function<double(double i, double j)>& coefficient) {
  Grid<double> c(spans_x + 3, spans_y + 3);
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) c.at(i, j) = coefficient(i, j);
  }
  return {kExtent, spans_x, spans_y, c};
}

TEST(SplineHull, HoldsEverySlopeAndCurvatureOfItsCell) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> height(9, 11), share(0, 1);
  const SplineSurface s = surface_of(17, 13, [&](double, double) { return height(random); });
  const detail::SplineHull hull(s, kMarginMm);
  const auto inside = [](double v, const detail::Range& r) { return v >= r.least - 1e-9 && v <= r.most + 1e-9; };
  int off_the_padding = 0;
  for (int k = 0; k < 20000; ++k) {
    const double x = kExtent.min.x() - kMarginMm + (kExtent.size().x() + 2 * kMarginMm) * share(random);
    const double y = kExtent.min.y() - kMarginMm + (kExtent.size().y() + 2 * kMarginMm) * share(random);
    const auto at = s.sample(x, y);
    const int column = hull.column(x), row = hull.row(y);
    const auto slopes = hull.slopes(column, row);
    const auto curvatures = hull.curvatures(column, row);
    ASSERT_TRUE(inside(at.hx, slopes.x) && inside(at.hy, slopes.y)) << x << " " << y;
    ASSERT_TRUE(inside(at.hxx, curvatures.xx) && inside(at.hxy, curvatures.xy) && inside(at.hyy, curvatures.yy)) << x << " " << y;
    off_the_padding += x < kExtent.min.x() - s.padding() * s.span_mm().x();
  }
  EXPECT_GT(off_the_padding, 1000);
}

TEST(SplineHull, IsNoWiderThanThePlane) {
  const SplineSurface s = surface_of(17, 13, [](double i, double j) { return 12 + 0.3 * i - 0.2 * j; });
  const detail::SplineHull hull(s, kMarginMm);
  for (const auto& [column, row] : {std::pair(0, 0), std::pair(hull.cells_x() / 2, hull.cells_y() / 2), std::pair(hull.cells_x() - 1, 3)}) {
    const auto slopes = hull.slopes(column, row);
    const double along_x = 0.3 / s.span_mm().x(), along_y = -0.2 / s.span_mm().y();
    EXPECT_NEAR(slopes.x.least, along_x, 1e-9);
    EXPECT_NEAR(slopes.x.most, along_x, 1e-9);
    EXPECT_NEAR(slopes.y.least, along_y, 1e-9);
    EXPECT_NEAR(slopes.y.most, along_y, 1e-9);
  }
}

}  // namespace
}  // namespace lightmill

#include "cam/detail/spline_hull.h"

namespace lightmill::detail {

SplineHull::SplineHull(const SplineSurface& surface, double margin_mm) : surface_(&surface), span_mm_(surface.span_mm()) {
  const auto fill = [&](std::vector<Functionals>& cells, int spans, double span_mm) {
    const int margin = static_cast<int>(std::ceil(margin_mm / span_mm)) + 1;
    for (int k = -margin; k < spans + margin; ++k) {
      cells.push_back(functionals(k + surface.padding(), spans + 2 * surface.padding(), 1 / span_mm));
    }
    return margin * span_mm;
  };
  first_.x() = surface.extent().min.x() - fill(x_, surface.spans_x(), span_mm_.x());
  first_.y() = surface.extent().min.y() - fill(y_, surface.spans_y(), span_mm_.y());
}

/// Of a span of the padded surface, or of a cell outside of [0, spans), where it goes straight on.
SplineHull::Functionals SplineHull::functionals(int cell, int spans, double per_mm) {
  Functionals f;
  if (cell >= 0 && cell < spans) {
    f.first = cell;
    for (int i = 0; i < 4; ++i) {
      f.value.push_back({});
      f.value.back()[i] = 1;
    }
    for (int i = 0; i < 3; ++i) {
      f.slope.push_back({});
      f.slope.back()[i] = -per_mm;
      f.slope.back()[i + 1] = per_mm;
    }
    for (int i = 0; i < 2; ++i) {
      f.curvature.push_back({});
      f.curvature.back()[i] = f.curvature.back()[i + 2] = per_mm * per_mm;
      f.curvature.back()[i + 1] = -2 * per_mm * per_mm;
    }
    return f;
  }
  for (int end = 0; end < 2; ++end) {
    const SplineBasis b = spline_basis((cell + end) / per_mm, per_mm, spans);
    f.first = b.first;
    f.value.push_back({b.value[0], b.value[1], b.value[2], b.value[3]});
    if (end == 0) f.slope.push_back({b.slope[0], b.slope[1], b.slope[2], b.slope[3]});
  }
  return f;
}

Range SplineHull::range(const Functionals& x, const Combinations& along_x, const Functionals& y, const Combinations& along_y) const {
  Range r;
  if (along_x.empty() || along_y.empty()) r.include(0);
  const Grid<double>& c = surface_->padded_coefficients();
  for (const auto& fy : along_y) {
    double row[4];
    for (int i = 0; i < 4; ++i) {
      const double* at = &c.at(x.first + i, y.first);
      row[i] = fy[0] * at[0] + fy[1] * at[c.width] + fy[2] * at[2 * c.width] + fy[3] * at[3 * c.width];
    }
    for (const auto& fx : along_x) r.include(fx[0] * row[0] + fx[1] * row[1] + fx[2] * row[2] + fx[3] * row[3]);
  }
  return r;
}

SplineHull::Slopes SplineHull::slopes(int column, int row) const {
  const Functionals &x = x_[column], &y = y_[row];
  return {range(x, x.slope, y, y.value), range(x, x.value, y, y.slope)};
}

SplineHull::Curvatures SplineHull::curvatures(int column, int row) const {
  const Functionals &x = x_[column], &y = y_[row];
  return {range(x, x.curvature, y, y.value), range(x, x.slope, y, y.slope), range(x, x.value, y, y.curvature)};
}

}  // namespace lightmill::detail

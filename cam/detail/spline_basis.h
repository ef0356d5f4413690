// Uniform cubic B-splines at one coordinate.
#pragma once

namespace lightmill::detail {

/// The four basis functions that live on one span, with their derivatives by mm.
struct SplineBasis {
  int first = 0;  ///< index of the first of the four coefficients (= the span)
  double value[4], slope[4], curvature[4];
};

/// At `along_mm` from the first knot of `spans` spans of 1 / per_mm each; straight on outside of them.
inline SplineBasis spline_basis(double along_mm, double per_mm, int spans) {
  const double u = along_mm * per_mm;
  const double inside = u < 0 ? 0 : (u > spans ? spans : u);
  SplineBasis b;
  b.first = static_cast<int>(inside);
  if (b.first >= spans) b.first = spans - 1;
  const double t = inside - b.first;
  const double s = 1 - t;
  b.value[0] = s * s * s / 6;
  b.value[1] = 2.0 / 3 - t * t * (2 - t) / 2;
  b.value[2] = 2.0 / 3 - s * s * (2 - s) / 2;
  b.value[3] = t * t * t / 6;
  b.slope[0] = -s * s / 2 * per_mm;
  b.slope[1] = t * (1.5 * t - 2) * per_mm;
  b.slope[2] = s * (2 - 1.5 * s) * per_mm;
  b.slope[3] = t * t / 2 * per_mm;
  const double per_mm2 = per_mm * per_mm;
  b.curvature[0] = s * per_mm2;
  b.curvature[1] = (3 * t - 2) * per_mm2;
  b.curvature[2] = (3 * s - 2) * per_mm2;
  b.curvature[3] = t * per_mm2;
  if (u != inside) {  // outside: straight on
    const double excess_mm = (u - inside) / per_mm;
    for (int i = 0; i < 4; ++i) {
      b.value[i] += excess_mm * b.slope[i];
      b.curvature[i] = 0;
    }
  }
  return b;
}

}  // namespace lightmill::detail

// The one smooth surface that solid, tool paths and checks share: a C2 bicubic B-spline height field fitted to the
// mesh.
#pragma once

#include <filesystem>

#include "design/core/grid.h"
#include "design/core/monitor.h"
#include "design/mesh.h"

namespace lightmill {

/// z = h(x, y) over a rectangle, uniform knots, (spans_x + 3) x (spans_y + 3) coefficients. Outside the rectangle the
/// surface goes on with the height and slope of the nearest border point, axis by axis (C1 everywhere; beyond a corner
/// the two straight lines span a bilinear patch), because a cutter overlaps the border.
class SplineSurface {
 public:
  struct Sample {
    double h = 0;                      ///< mm
    double hx = 0, hy = 0;             ///< first derivatives
    double hxx = 0, hxy = 0, hyy = 0;  ///< second derivatives, 1/mm
  };

  SplineSurface() = default;
  /// `coefficients` is (spans_x + 3) x (spans_y + 3); row 0 at the smallest y. Throws InputError on sizes that do not
  /// match, an empty extent or fewer than one span.
  SplineSurface(const Box2& extent, int spans_x, int spans_y, Grid<double> coefficients);

  [[nodiscard]] const Box2& extent() const { return extent_; }
  [[nodiscard]] int spans_x() const { return spans_x_; }
  [[nodiscard]] int spans_y() const { return spans_y_; }
  [[nodiscard]] const Grid<double>& coefficients() const { return coefficients_; }
  /// Size of one span, mm.
  [[nodiscard]] Vec2 span_mm() const { return {1 / per_mm_.x(), 1 / per_mm_.y()}; }

  [[nodiscard]] double height(double x, double y) const;
  [[nodiscard]] Sample sample(double x, double y) const;
  /// Unit normal, on +Z's side.
  [[nodiscard]] Vec3 normal(double x, double y) const;
  /// Exact integral of h over the rectangle, mm^3 above z = 0.
  [[nodiscard]] double volume_mm3() const;
  [[nodiscard]] double lowest() const;  ///< over a dense scan (8 x 8 points per span), mm
  [[nodiscard]] double highest() const;

 private:
  /// The four cubic basis functions that live on one span, with their derivatives by mm, at one coordinate.
  struct Basis {
    int first = 0;
    double value[4], slope[4], curvature[4];
  };
  static Basis basis(double along_mm, double per_mm, int spans);

  Box2 extent_;
  int spans_x_ = 0;
  int spans_y_ = 0;
  Vec2 per_mm_{1, 1};  ///< spans per mm
  Grid<double> coefficients_;
};

/// How well a spline follows the mesh, off the creases and over all.
struct SplineFitSummary {
  double rms_deviation_um = 0;           ///< of vertex heights, away from creases
  double max_deviation_um = 0;           ///< everywhere
  double rms_normal_deviation_urad = 0;  ///< away from creases
  double crease_share = 0;               ///< share of vertices counted as crease
  double seconds = 0;
};

struct SplineFit {
  SplineSurface surface;
  SplineFitSummary summary;
};

/// Least squares on vertex heights and normals with one span per mesh edge length.
SplineFit fit_spline(const SurfaceMesh& mesh, const Box2& extent, const Monitor& monitor = {});

// Evaluation is what every tool path and check spends its time on: it lives here to be inlined.

inline SplineSurface::Basis SplineSurface::basis(double along_mm, double per_mm, int spans) {
  const double u = along_mm * per_mm;
  const double inside = u < 0 ? 0 : (u > spans ? spans : u);
  Basis b;
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

inline SplineSurface::Sample SplineSurface::sample(double x, double y) const {
  const Basis bx = basis(x - extent_.min.x(), per_mm_.x(), spans_x_);
  const Basis by = basis(y - extent_.min.y(), per_mm_.y(), spans_y_);
  Sample result;
  const double* c = coefficients_.values.data() + static_cast<std::size_t>(by.first) * coefficients_.width + bx.first;
  for (int j = 0; j < 4; ++j, c += coefficients_.width) {
    const double v = bx.value[0] * c[0] + bx.value[1] * c[1] + bx.value[2] * c[2] + bx.value[3] * c[3];
    const double d = bx.slope[0] * c[0] + bx.slope[1] * c[1] + bx.slope[2] * c[2] + bx.slope[3] * c[3];
    const double dd = bx.curvature[0] * c[0] + bx.curvature[1] * c[1] + bx.curvature[2] * c[2] + bx.curvature[3] * c[3];
    result.h += by.value[j] * v;
    result.hx += by.value[j] * d;
    result.hy += by.slope[j] * v;
    result.hxx += by.value[j] * dd;
    result.hxy += by.slope[j] * d;
    result.hyy += by.curvature[j] * v;
  }
  return result;
}

inline double SplineSurface::height(double x, double y) const {
  const Basis bx = basis(x - extent_.min.x(), per_mm_.x(), spans_x_);
  const Basis by = basis(y - extent_.min.y(), per_mm_.y(), spans_y_);
  double h = 0;
  const double* c = coefficients_.values.data() + static_cast<std::size_t>(by.first) * coefficients_.width + bx.first;
  for (int j = 0; j < 4; ++j, c += coefficients_.width) {
    h += by.value[j] * (bx.value[0] * c[0] + bx.value[1] * c[1] + bx.value[2] * c[2] + bx.value[3] * c[3]);
  }
  return h;
}

}  // namespace lightmill

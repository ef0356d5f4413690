// The one smooth surface that solid, tool paths and checks share: a C2 bicubic B-spline height field fitted to the
// mesh.
#pragma once

#include <vector>

#include "cam/detail/spline_basis.h"
#include "design/core/grid.h"
#include "design/core/monitor.h"
#include "design/mesh.h"

namespace lightmill {

/// z = h(x, y) over a rectangle, uniform knots, (spans_x + 3) x (spans_y + 3) coefficients. A cutter overlaps the
/// border: outside the rectangle the surface goes on C2 for padding() spans, straight but for details along the border,
/// which fade (or as it is told to), and then straight for good. (Straight on from every border point, a crease that leaves
/// the lens askew would become a step that grows with the distance.)
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
  SplineSurface(const Box2& extent, int spans_x, int spans_y, Grid<double> coefficients, int padding = kPadding);
  /// Going on outside its rectangle as told: `padded` has `padding` coefficients more on every side. Throws as above.
  static SplineSurface with_padded(const Box2& extent, int spans_x, int spans_y, int padding, Grid<double> padded);

  [[nodiscard]] const Box2& extent() const { return extent_; }
  [[nodiscard]] int spans_x() const { return spans_x_; }
  [[nodiscard]] int spans_y() const { return spans_y_; }
  [[nodiscard]] const Grid<double>& coefficients() const { return coefficients_; }
  /// Size of one span, mm.
  [[nodiscard]] Vec2 span_mm() const { return {1 / per_mm_.x(), 1 / per_mm_.y()}; }

  /// `coefficients()` and padding() more on every side, which make the surface outside the rectangle.
  [[nodiscard]] int padding() const { return padding_; }
  [[nodiscard]] const Grid<double>& padded_coefficients() const { return padded_; }

  [[nodiscard]] double height(double x, double y) const;
  [[nodiscard]] Sample sample(double x, double y) const;
  /// Unit normal, on +Z's side.
  [[nodiscard]] Vec3 normal(double x, double y) const;
  /// Exact integral of h over the rectangle, mm^3 above z = 0.
  [[nodiscard]] double volume_mm3() const;
  [[nodiscard]] double lowest() const;  ///< over a dense scan (8 x 8 points per span), mm
  [[nodiscard]] double highest() const;

 private:
  static constexpr int kPadding = 24;

  Box2 extent_;
  int spans_x_ = 0;
  int spans_y_ = 0;
  int padding_ = kPadding;
  Vec2 per_mm_{1, 1};  ///< spans per mm
  Vec2 first_{0, 0};   ///< where the padded knots begin
  Grid<double> coefficients_;
  Grid<double> padded_;
};

/// The larger principal curvature of the height field there, 1/mm: above 0 where it is hollow.
double hollow_curvature(const SplineSurface::Sample& s);

/// How well a spline follows the mesh, off the creases and over all. A vertex counts as crease when the mesh's slopes
/// jump by more than about 0.16 at it or at most two edges away (slopes within two edges off a quadratic by 0.04).
struct SplineFitSummary {
  double rms_deviation_um = 0;           ///< of vertex heights, away from creases
  double max_deviation_um = 0;           ///< everywhere
  double rms_normal_deviation_urad = 0;  ///< against vertex normals, away from creases and off the mesh's border
  double crease_share = 0;               ///< share of vertices counted as crease
  double crease_width_mm = 0;            ///< two spans, within which the surface goes over from one side of a crease to the other
  double seconds = 0;
};

struct SplineFitOptions {
  /// Around creases, spans of half a mesh edge where the whole surface then has at most 650 along x or y: they become half as
  /// wide, and sharper hollows take the ball longer.
  bool finer_creases = false;
};

struct SplineFit {
  SplineSurface surface;
  SplineFitSummary summary;
};

/// Spline minus mesh at every vertex: height along z, and the angle between the normals.
struct FitErrors {
  std::vector<double> height_um;
  std::vector<double> normal_urad;
};
FitErrors fit_errors(const SurfaceMesh& mesh, const SplineSurface& surface);

/// Least squares on vertex heights and normals with one span per mesh edge length; the mesh's vertices may lie
/// anywhere. From one side of a crease to the other within two spans, without ringing beside. Coefficients that no vertex
/// reaches go on as smoothly as a thin plate. Throws InputError for a mesh that is no height field, NumericalError when the
/// equations cannot be solved.
SplineFit fit_spline(const SurfaceMesh& mesh, const Box2& extent, const SplineFitOptions& options = {}, const Monitor& monitor = {});

// Evaluation is what every tool path and check spends its time on: it lives here to be inlined.

inline SplineSurface::Sample SplineSurface::sample(double x, double y) const {
  const detail::SplineBasis bx = detail::spline_basis(x - first_.x(), per_mm_.x(), spans_x_ + 2 * padding_);
  const detail::SplineBasis by = detail::spline_basis(y - first_.y(), per_mm_.y(), spans_y_ + 2 * padding_);
  Sample result;
  const double* c = padded_.values.data() + static_cast<std::size_t>(by.first) * padded_.width + bx.first;
  for (int j = 0; j < 4; ++j, c += padded_.width) {
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
  const detail::SplineBasis bx = detail::spline_basis(x - first_.x(), per_mm_.x(), spans_x_ + 2 * padding_);
  const detail::SplineBasis by = detail::spline_basis(y - first_.y(), per_mm_.y(), spans_y_ + 2 * padding_);
  double h = 0;
  const double* c = padded_.values.data() + static_cast<std::size_t>(by.first) * padded_.width + bx.first;
  for (int j = 0; j < 4; ++j, c += padded_.width) {
    h += by.value[j] * (bx.value[0] * c[0] + bx.value[1] * c[1] + bx.value[2] * c[2] + bx.value[3] * c[3]);
  }
  return h;
}

}  // namespace lightmill

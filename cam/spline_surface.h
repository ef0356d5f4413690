// The one smooth surface that solid, tool paths and checks share: a C2 bicubic B-spline height field fitted to the mesh.
#pragma once

#include <filesystem>

#include "design/core/grid.h"
#include "design/core/monitor.h"
#include "design/mesh.h"

namespace lightmill {

/// z = h(x, y) over a rectangle, uniform knots, (spans_x + 3) x (spans_y + 3) coefficients. Outside the rectangle the
/// surface goes on with the height and slope of the nearest border point (a cutter overlaps the border).
class SplineSurface {
 public:
  struct Sample {
    double h = 0;
    double hx = 0, hy = 0;
    double hxx = 0, hxy = 0, hyy = 0;
  };

  SplineSurface() = default;
  /// `coefficients` is (spans_x + 3) x (spans_y + 3).
  SplineSurface(const Box2& extent, int spans_x, int spans_y, Grid<double> coefficients);

  [[nodiscard]] const Box2& extent() const { return extent_; }
  [[nodiscard]] int spans_x() const { return spans_x_; }
  [[nodiscard]] int spans_y() const { return spans_y_; }
  [[nodiscard]] const Grid<double>& coefficients() const { return coefficients_; }

  [[nodiscard]] double height(double x, double y) const;
  [[nodiscard]] Sample sample(double x, double y) const;
  [[nodiscard]] Vec3 normal(double x, double y) const;
  /// Exact integral of h over the rectangle, mm^3 above z = 0.
  [[nodiscard]] double volume_mm3() const;
  [[nodiscard]] double lowest() const;   ///< over a dense scan, mm
  [[nodiscard]] double highest() const;

 private:
  Box2 extent_;
  int spans_x_ = 0;
  int spans_y_ = 0;
  Grid<double> coefficients_;
};

/// How well a spline follows the mesh, off the creases and over all.
struct SplineFitSummary {
  double rms_deviation_um = 0;          ///< of vertex heights, away from creases
  double max_deviation_um = 0;          ///< everywhere
  double rms_normal_deviation_urad = 0; ///< away from creases
  double crease_share = 0;              ///< share of vertices counted as crease
  double seconds = 0;
};

struct SplineFit {
  SplineSurface surface;
  SplineFitSummary summary;
};

/// Least squares on vertex heights and normals with one span per mesh edge length.
SplineFit fit_spline(const SurfaceMesh& mesh, const Box2& extent, const Monitor& monitor = {});

}  // namespace lightmill

// Bounds on a surface's slopes and curvatures, span by span, from the convex hull of B-splines.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "cam/spline_surface.h"

namespace lightmill::detail {

struct Range {
  double least = std::numeric_limits<double>::infinity(), most = -std::numeric_limits<double>::infinity();
  [[nodiscard]] double magnitude() const { return std::max(std::abs(least), std::abs(most)); }
  void include(double v) {
    least = std::min(least, v);
    most = std::max(most, v);
  }
  void include(const Range& other) {
    least = std::min(least, other.least);
    most = std::max(most, other.most);
  }
};

/// Cells are the surface's spans and squares of the same size up to a margin outside of its rectangle, counted from the lower
/// left one on.
class SplineHull {
 public:
  /// `surface` must outlive this.
  SplineHull(const SplineSurface& surface, double margin_mm);

  [[nodiscard]] int cells_x() const { return static_cast<int>(x_.size()); }
  [[nodiscard]] int cells_y() const { return static_cast<int>(y_.size()); }
  /// The cell over a coordinate, the outermost one for what lies farther out.
  [[nodiscard]] int column(double x) const { return cell(x, first_.x(), span_mm_.x(), cells_x()); }
  [[nodiscard]] int row(double y) const { return cell(y, first_.y(), span_mm_.y(), cells_y()); }

  struct Slopes {
    Range x, y;
    void include(const Slopes& other) {
      x.include(other.x);
      y.include(other.y);
    }
  };
  struct Curvatures {
    Range xx, xy, yy;  ///< of the second derivatives
  };
  [[nodiscard]] Slopes slopes(int column, int row) const;
  [[nodiscard]] Curvatures curvatures(int column, int row) const;

 private:
  /// Functions of x (or y) on one cell as combinations of four coefficients from `first` on: the value, the slope and the
  /// curvature at any place of the cell lie in the convex hull of theirs.
  struct Functionals {
    int first = 0;
    std::vector<std::array<double, 4>> value, slope, curvature;
  };
  using Combinations = std::vector<std::array<double, 4>>;

  static Functionals functionals(int cell, int spans, double per_mm);
  static int cell(double at, double first, double span_mm, int cells) {
    return static_cast<int>(std::clamp(std::floor((at - first) / span_mm), 0.0, cells - 1.0));
  }
  [[nodiscard]] Range range(const Functionals& x, const Combinations& along_x, const Functionals& y, const Combinations& along_y) const;

  const SplineSurface* surface_;
  Vec2 first_, span_mm_;
  std::vector<Functionals> x_, y_;  // of the columns and rows
};

}  // namespace lightmill::detail

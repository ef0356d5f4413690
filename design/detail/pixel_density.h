// Area light, pixels and filled shapes, as a density whose integrals over any polygon are closed forms along its edges.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/target.h"

namespace lightmill::detail {

/// A piecewise constant density, prepared so that Green's theorem integrates it along edges: with the flux left of a
/// point, F(x, y) = int_{-inf}^{x} rho(t, y) dt, a cell's mass is the contour integral of F dy.
///
/// Where a border of a filled shape crosses a pixel (a mixed pixel), F is the mean flux of what lies left of the pixel
/// plus what the pixel's own borders make of it. The means are right for whole pixels; what a contour right of a mixed
/// pixel owes beyond them depends on the heights at which it came over the pixel's right side, and is added there.
class PixelDensity {
 public:
  PixelDensity() = default;
  /// `flux` per pixel over `extent`, row 0 at the smallest y, plus the light between `borders`.
  PixelDensity(const Grid<double>& flux, const Box2& extent, const std::vector<AreaBorder>& borders = {});

  struct Integral {
    double mass = 0;  ///< of F dy
    Vec2 moment{0, 0};
    double line = 0;  ///< of the density along the edge, flux per mm
  };
  /// Contribution of the directed edge from p to q; antisymmetric but for `line`.
  [[nodiscard]] Integral along(const Vec2& p, const Vec2& q) const;
  [[nodiscard]] bool empty() const { return width_ == 0; }

 private:
  // Lengths in pixels from the extent's corner, or, in a mixed pixel, from the pixel's.
  struct Before {  // what lies left of a pixel in its row
    double mass;
    double moment;  // int t rho dt
  };
  struct Beyond {  // integrals over y from the bottom of F, y F and int t rho dt right of the last column
    double mass;
    double y_moment;
    double x_moment;
  };
  struct Border {  // density right of it minus left of it
    double u0, v0, u1, v1;
    double jump;
  };
  struct Sum {  // integrals of F dy, int t rho dt dy and v F dy, and of the density along an edge
    double mass = 0;
    double x = 0;
    double y = 0;
    double line = 0;
  };
  struct Mixed {
    std::size_t first_border;
    Sum whole;
    double y_before;  // of y moments, less those of even pixels with their mass, in all mixed pixels before it
  };
  struct Piece;

  [[nodiscard]] std::vector<Piece> pieces_of(const std::vector<AreaBorder>& borders) const;
  double add_row(int row, const double* flux, std::span<const Piece> pieces, double rounding, double y_before);
  [[nodiscard]] Beyond beyond(double y) const;
  [[nodiscard]] std::span<const Border> borders_of(std::int32_t mixed) const {
    return std::span(borders_).subspan(mixed_[mixed].first_border,
                                       mixed_[mixed + 1].first_border - mixed_[mixed].first_border);
  }
  static Sum sum_along(std::span<const Border> borders, double u0, double v0, double u1, double v1);
  /// What a contour right of a pixel owes beyond the pixel's mean for having come over its right side at height y.
  [[nodiscard]] Sum owed(int column, int row, double y) const;

  int width_ = 0;
  int height_ = 0;
  Vec2 origin_{0, 0};
  Vec2 pitch_{1, 1};
  std::vector<Before> before_;  // one more per row than pixels
  std::vector<Beyond> beyond_;
  std::vector<std::int32_t> mixed_before_;  // mixed pixels before a pixel; empty without borders
  std::vector<Mixed> mixed_;                // by rows; one more than there are
  std::vector<Border> borders_;
};

}  // namespace lightmill::detail

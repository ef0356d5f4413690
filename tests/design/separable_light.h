// A density that is a product over x and y: the transport is the product of two monotone rearrangements.
#pragma once

#include <cmath>

#include "design/source.h"
#include "design/target.h"

namespace lightmill::test {

/// Density (1 + 3 u) (1 - 0.8 cos 2 pi v) over 30 x 60 mm off the centre, from an even rectangle of 50 x 80 mm.
class SeparableLight {
 public:
  SeparableLight() {
    source.size_mm = {50, 80};
    target.extent = {{10, -40}, {40, 20}};
    target.area_flux = Grid<double>(90, 120);
    for (int row = 0; row < 120; ++row) {
      for (int column = 0; column < 90; ++column) {
        target.area_flux.at(column, row) =
            (below_x((column + 1) / 90.0) - below_x(column / 90.0)) * (below_y((row + 1) / 120.0) - below_y(row / 120.0));
      }
    }
    target.normalise();
  }
  [[nodiscard]] Vec2 goes_to(const Vec2& site) const {
    const Vec2 share = site.cwiseQuotient(source.size_mm) + Vec2(0.5, 0.5);
    return target.extent.min +
           target.extent.size().cwiseProduct(Vec2(inverse(below_x, share.x()), inverse(below_y, share.y())));
  }
  /// Of a cell on the target, as if all were equal.
  [[nodiscard]] double cell_mm(std::size_t samples) const {
    return std::sqrt(target.extent.size().prod() / static_cast<double>(samples));
  }

  SourceLight source;
  TargetLight target;

 private:
  static double below_x(double u) { return (u + 1.5 * u * u) / 2.5; }
  static double below_y(double v) { return v - 0.8 / (2 * kPi) * std::sin(2 * kPi * v); }
  template <typename Share>
  static double inverse(const Share& below, double value) {
    double low = 0;
    double high = 1;
    for (int k = 0; k < 60; ++k) (below((low + high) / 2) < value ? low : high) = (low + high) / 2;
    return low;
  }
};

}  // namespace lightmill::test

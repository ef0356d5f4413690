#include "cam/spline_surface.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace lightmill {

namespace {

/// Integrals of the uniform cubic basis functions over [0, spans], in spans: 1 inside, less where the border cuts them.
std::vector<double> basis_integrals(int spans) {
  // One basis function has these shares on the four spans it lives on.
  constexpr double kShare[4] = {1.0 / 24, 11.0 / 24, 11.0 / 24, 1.0 / 24};
  std::vector<double> integrals(spans + 3, 0.0);
  for (int span = 0; span < spans; ++span) {
    for (int i = 0; i < 4; ++i) integrals[span + i] += kShare[i];
  }
  return integrals;
}

template <typename Better>
double extreme(const SplineSurface& surface, Better better) {
  constexpr int kPerSpan = 8;
  const Box2& extent = surface.extent();
  const int nx = surface.spans_x() * kPerSpan;
  const int ny = surface.spans_y() * kPerSpan;
  double best = surface.height(extent.min.x(), extent.min.y());
  for (int j = 0; j <= ny; ++j) {
    const double y = extent.min.y() + extent.size().y() * j / ny;
    for (int i = 0; i <= nx; ++i) {
      const double h = surface.height(extent.min.x() + extent.size().x() * i / nx, y);
      if (better(h, best)) best = h;
    }
  }
  return best;
}

}  // namespace

SplineSurface::SplineSurface(const Box2& extent, int spans_x, int spans_y, Grid<double> coefficients)
    : extent_(extent), spans_x_(spans_x), spans_y_(spans_y), coefficients_(std::move(coefficients)) {
  if (!(extent.size().x() > 0 && extent.size().y() > 0)) throw InputError("spline surface: the extent is empty");
  if (spans_x < 1 || spans_y < 1) throw InputError("spline surface: needs at least one span along x and y");
  if (coefficients_.width != spans_x + 3 || coefficients_.height != spans_y + 3) {
    throw InputError("spline surface: " + std::to_string(coefficients_.width) + " x " +
                     std::to_string(coefficients_.height) + " coefficients, must be (spans_x + 3) x (spans_y + 3)");
  }
  per_mm_ = Vec2(spans_x / extent.size().x(), spans_y / extent.size().y());
}

Vec3 SplineSurface::normal(double x, double y) const {
  const Sample s = sample(x, y);
  return Vec3(-s.hx, -s.hy, 1) / std::sqrt(1 + s.hx * s.hx + s.hy * s.hy);
}

double SplineSurface::volume_mm3() const {
  const std::vector<double> wx = basis_integrals(spans_x_);
  const std::vector<double> wy = basis_integrals(spans_y_);
  double volume = 0;
  for (int j = 0; j < coefficients_.height; ++j) {
    double row = 0;
    for (int i = 0; i < coefficients_.width; ++i) row += wx[i] * coefficients_.at(i, j);
    volume += wy[j] * row;
  }
  return volume / (per_mm_.x() * per_mm_.y());
}

double SplineSurface::lowest() const {
  return extreme(*this, std::less<>());
}

double SplineSurface::highest() const {
  return extreme(*this, std::greater<>());
}

}  // namespace lightmill

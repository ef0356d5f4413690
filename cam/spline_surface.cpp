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

/// The line of coefficients that comes after two others on the way outwards: straight on, with the increments smoothed
/// along the line and bent by its curvature. Of a mode along the line with eigenvalue k of -difference^2, 0 <= k <= 4,
/// the amplitudes of successive lines are z^n with
///   z^2 - (2 - k / 2) z + (1 - k / 4) = 0:
/// |z| = sqrt(1 - k / 4) at most, so that details fade and nothing grows but a straight line (k = 0).
std::vector<double> next_line(const std::vector<double>& before, const std::vector<double>& last) {
  const int count = static_cast<int>(last.size());
  std::vector<double> next(count);
  const auto increment = [&](int i) { return last[i] - before[i]; };
  for (int i = 0; i < count; ++i) {
    // Beyond its ends the line is straight, and the increments stay what they are there.
    const int left = std::max(0, i - 1), right = std::min(count - 1, i + 1);
    const double bent = left < i && i < right ? last[left] - 2 * last[i] + last[right] : 0;
    next[i] = last[i] + increment(i) + (increment(left) - 2 * increment(i) + increment(right) + bent) / 4;
  }
  return next;
}

Grid<double> padded(const Grid<double>& inner, int padding) {
  Grid<double> result(inner.width + 2 * padding, inner.height + 2 * padding);
  for (int j = 0; j < inner.height; ++j) {
    for (int i = 0; i < inner.width; ++i) result.at(i + padding, j + padding) = inner.at(i, j);
  }
  // To the left and right of the inner rows, then below and above of all columns.
  const auto pad = [&](bool along_x, int from, int to, int border, int step) {
    const auto cell = [&](int across, int along) -> double& {
      return along_x ? result.at(across, along) : result.at(along, across);
    };
    std::vector<double> before(to - from), last(to - from);
    for (int k = from; k < to; ++k) {
      before[k - from] = cell(border - step, k);
      last[k - from] = cell(border, k);
    }
    for (int n = 1; n <= padding; ++n) {
      std::vector<double> next = next_line(before, last);
      for (int k = from; k < to; ++k) cell(border + n * step, k) = next[k - from];
      before = std::move(last);
      last = std::move(next);
    }
  };
  pad(true, padding, padding + inner.height, padding, -1);
  pad(true, padding, padding + inner.height, padding + inner.width - 1, 1);
  pad(false, 0, result.width, padding, -1);
  pad(false, 0, result.width, padding + inner.height - 1, 1);
  return result;
}

/// The best of 8 x 8 points a span; spans whose coefficients, between which the surface lies, are no better than that are passed over.
template <typename Better>
double extreme(const SplineSurface& surface, Better better) {
  constexpr int kPerSpan = 8;
  constexpr double kRoundedMm = 1e-9;
  const Box2& extent = surface.extent();
  const Grid<double>& c = surface.coefficients();
  const int nx = surface.spans_x() * kPerSpan;
  const int ny = surface.spans_y() * kPerSpan;
  double best = surface.height(extent.min.x(), extent.min.y());
  const auto look_at_span = [&](int column, int row) {
    double bound = c.at(column, row);
    for (int j = row; j < row + 4; ++j) {
      for (int i = column; i < column + 4; ++i) bound = better(c.at(i, j), bound) ? c.at(i, j) : bound;
    }
    if (!better(bound, best) && std::abs(bound - best) > kRoundedMm) return;
    for (int j = row * kPerSpan; j <= (row + 1) * kPerSpan; ++j) {
      const double y = extent.min.y() + extent.size().y() * j / ny;
      for (int i = column * kPerSpan; i <= (column + 1) * kPerSpan; ++i) {
        const double h = surface.height(extent.min.x() + extent.size().x() * i / nx, y);
        if (better(h, best)) best = h;
      }
    }
  };
  // Around the best coefficient first, then few spans are left to look at.
  const auto top = std::min_element(c.values.begin(), c.values.end(), better) - c.values.begin();
  look_at_span(std::min(static_cast<int>(top % c.width), surface.spans_x() - 1), std::min(static_cast<int>(top / c.width), surface.spans_y() - 1));
  for (int row = 0; row < surface.spans_y(); ++row) {
    for (int column = 0; column < surface.spans_x(); ++column) look_at_span(column, row);
  }
  return best;
}

}  // namespace

SplineSurface::SplineSurface(const Box2& extent, int spans_x, int spans_y, Grid<double> coefficients, int padding)
    : extent_(extent), spans_x_(spans_x), spans_y_(spans_y), padding_(padding), coefficients_(std::move(coefficients)) {
  if (!(extent.size().x() > 0 && extent.size().y() > 0)) throw InputError("spline surface: the extent is empty");
  if (spans_x < 1 || spans_y < 1) throw InputError("spline surface: needs at least one span along x and y");
  if (coefficients_.width != spans_x + 3 || coefficients_.height != spans_y + 3) {
    throw InputError("spline surface: " + std::to_string(coefficients_.width) + " x " +
                     std::to_string(coefficients_.height) + " coefficients, must be (spans_x + 3) x (spans_y + 3)");
  }
  per_mm_ = Vec2(spans_x / extent.size().x(), spans_y / extent.size().y());
  first_ = extent.min - padding * span_mm();
  padded_ = padded(coefficients_, padding);
}

SplineSurface SplineSurface::with_padded(const Box2& extent, int spans_x, int spans_y, int padding, Grid<double> padded) {
  Grid<double> inner(std::max(0, padded.width - 2 * padding), std::max(0, padded.height - 2 * padding));
  for (int j = 0; j < inner.height; ++j) {
    for (int i = 0; i < inner.width; ++i) inner.at(i, j) = padded.at(i + padding, j + padding);
  }
  SplineSurface surface(extent, spans_x, spans_y, std::move(inner), padding);
  surface.padded_ = std::move(padded);
  return surface;
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

double hollow_curvature(const SplineSurface::Sample& s) {
  // Of a height field: H + sqrt(H^2 - K).
  const double g = 1 + s.hx * s.hx + s.hy * s.hy;
  const double gauss = (s.hxx * s.hyy - s.hxy * s.hxy) / (g * g);
  const double mean = ((1 + s.hy * s.hy) * s.hxx - 2 * s.hx * s.hy * s.hxy + (1 + s.hx * s.hx) * s.hyy) / (2 * g * std::sqrt(g));
  return mean + std::sqrt(std::max(0.0, mean * mean - gauss));
}

}  // namespace lightmill

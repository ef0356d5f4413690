#include "design/detail/coverage.h"

#include <algorithm>
#include <cmath>

namespace lightmill::detail {

namespace {

constexpr double kRounding = 1e-11;  // of the flux of a pixel that is a sum over up to a row of them

/// Adds to a difference buffer (one column more than pixels) so that a prefix sum along rows lights what lies right of
/// the piece of border by `jump`.
void accumulate(Grid<double>& buffer, Vec2 p, Vec2 q, double jump) {
  const int width = buffer.width - 1;
  // Left of the grid everything is covered, right of it nothing: split there.
  for (const double border : {0.0, static_cast<double>(width)}) {
    if ((p.x() < border && q.x() > border) || (p.x() > border && q.x() < border)) {
      const double t = (border - p.x()) / (q.x() - p.x());
      const Vec2 mid(border, p.y() + t * (q.y() - p.y()));
      accumulate(buffer, p, mid, jump);
      accumulate(buffer, mid, q, jump);
      return;
    }
  }
  if (std::max(p.x(), q.x()) <= 0) p.x() = q.x() = 0;
  if (std::min(p.x(), q.x()) >= width) return;
  const double slope = q.y() > p.y() ? (q.x() - p.x()) / (q.y() - p.y()) : 0;
  const int first = std::max(0, static_cast<int>(std::floor(p.y())));
  const int last = std::min(buffer.height - 1, static_cast<int>(std::floor(q.y())));
  for (int row = first; row <= last; ++row) {
    const double y0 = std::max<double>(row, p.y());
    const double y1 = std::min<double>(row + 1, q.y());
    if (y1 <= y0) continue;
    double x0 = std::clamp(y0 == p.y() ? p.x() : p.x() + (y0 - p.y()) * slope, 0.0, static_cast<double>(width));
    double x1 = std::clamp(y1 == q.y() ? q.x() : p.x() + (y1 - p.y()) * slope, 0.0, static_cast<double>(width));
    if (x0 > x1) std::swap(x0, x1);
    const double rise = jump * (y1 - y0);
    const int from = std::min(width - 1, static_cast<int>(x0));
    const int to = std::min(width - 1, static_cast<int>(x1));
    for (int column = from; column <= to; ++column) {
      const double a = std::max<double>(x0, column);
      const double b = std::min<double>(x1, column + 1);
      const double part = x1 > x0 ? rise * (b - a) / (x1 - x0) : rise;
      const double inside = (a + b) / 2 - column;
      buffer.at(column, row) += part * (1 - inside);
      buffer.at(column + 1, row) += part * inside;
    }
  }
}

}  // namespace

void add_borders(Grid<double>& flux, const Box2& extent, const std::vector<AreaBorder>& borders) {
  if (borders.empty()) return;
  const Vec2 pitch = extent.size().cwiseQuotient(Vec2(flux.width, flux.height));
  Grid<double> buffer(flux.width + 1, flux.height);
  for (const auto& border : borders) {
    accumulate(buffer, (border.low - extent.min).cwiseQuotient(pitch), (border.high - extent.min).cwiseQuotient(pitch),
               border.jump * pitch.prod());
  }
  double brightest = 0;
  for (int row = 0; row < flux.height; ++row) {
    double sum = 0;
    for (int column = 0; column < flux.width; ++column) {
      sum += buffer.at(column, row);
      buffer.at(column, row) = sum;
      brightest = std::max(brightest, sum);
    }
  }
  for (int row = 0; row < flux.height; ++row) {
    for (int column = 0; column < flux.width; ++column) {
      const double sum = buffer.at(column, row);
      if (sum > kRounding * brightest) flux.at(column, row) += sum;
    }
  }
}

Grid<double> box_filtered(const Grid<double>& flux, int width, int height) {
  const auto along_rows = [](const Grid<double>& in, int out_width) {
    // The result is transposed, so that twice does both directions.
    Grid<double> out(in.height, out_width);
    const double scale = static_cast<double>(out_width) / in.width;
    for (int row = 0; row < in.height; ++row) {
      for (int column = 0; column < in.width; ++column) {
        const double value = in.at(column, row);
        if (value == 0) continue;
        const double from = column * scale;
        const double to = (column + 1) * scale;
        const int first = std::min(out_width - 1, static_cast<int>(from));
        const int last = std::min(out_width - 1, static_cast<int>(to));
        // The last pixel takes what is left, so that no flux is lost to rounding.
        double left = value;
        for (int k = first; k < last; ++k) {
          const double part = value * (std::min<double>(to, k + 1) - std::max<double>(from, k)) / scale;
          out.at(row, k) += part;
          left -= part;
        }
        out.at(row, last) += std::max(left, 0.0);
      }
    }
    return out;
  };
  return along_rows(along_rows(flux, width), height);
}

void add_segment(Grid<double>& flux, const Box2& extent, const Vec2& from, const Vec2& to, double density_from,
                 double density_to) {
  const Vec2 pitch = extent.size().cwiseQuotient(Vec2(flux.width, flux.height));
  const Vec2 a = (from - extent.min).cwiseQuotient(pitch);
  const Vec2 d = (to - from).cwiseQuotient(pitch);
  const double length = (to - from).norm();
  // Between its crossings with grid lines the segment stays in one pixel.
  std::vector<double> cuts{0, 1};
  for (int axis = 0; axis < 2; ++axis) {
    if (d[axis] == 0) continue;
    const double low = std::min(a[axis], a[axis] + d[axis]);
    const double high = std::max(a[axis], a[axis] + d[axis]);
    const int count = axis == 0 ? flux.width : flux.height;
    for (int line = std::max(0, static_cast<int>(std::ceil(low))); line <= std::min<double>(count, std::floor(high));
         ++line) {
      cuts.push_back(std::clamp((line - a[axis]) / d[axis], 0.0, 1.0));
    }
  }
  std::sort(cuts.begin(), cuts.end());
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
    const double mid = (cuts[k] + cuts[k + 1]) / 2;
    const Vec2 at = a + mid * d;
    // A piece on the very border belongs to the outermost pixels.
    if (at.x() < 0 || at.y() < 0 || at.x() > flux.width || at.y() > flux.height) continue;
    flux.at(std::min(static_cast<int>(at.x()), flux.width - 1), std::min(static_cast<int>(at.y()), flux.height - 1)) +=
        length * (cuts[k + 1] - cuts[k]) * (density_from + mid * (density_to - density_from));
  }
}

}  // namespace lightmill::detail

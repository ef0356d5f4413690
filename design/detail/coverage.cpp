#include "design/detail/coverage.h"

#include <algorithm>
#include <cmath>

namespace lightmill::detail {

namespace {

constexpr double kRounding = 1e-11;  // of a coverage that is a sum of up to a row of pixels

/// An edge in pixels, upwards.
struct Edge {
  Vec2 low;
  Vec2 high;
  int winding;
  [[nodiscard]] double x_at(double y) const {
    if (y <= low.y()) return low.x();
    if (y >= high.y()) return high.x();
    return low.x() + (high.x() - low.x()) * (y - low.y()) / (high.y() - low.y());
  }
};

/// Adds to a difference buffer (one column more than pixels) so that a prefix sum along rows covers what lies right of
/// the piece of edge; `sign` -1 takes it away again.
void accumulate(Grid<double>& buffer, Vec2 p, Vec2 q, double sign) {
  const int width = buffer.width - 1;
  // Left of the grid everything is covered, right of it nothing: split there.
  for (const double border : {0.0, static_cast<double>(width)}) {
    if ((p.x() < border && q.x() > border) || (p.x() > border && q.x() < border)) {
      const double t = (border - p.x()) / (q.x() - p.x());
      const Vec2 mid(border, p.y() + t * (q.y() - p.y()));
      accumulate(buffer, p, mid, sign);
      accumulate(buffer, mid, q, sign);
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
    const double rise = sign * (y1 - y0);
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

Grid<double> coverage(const std::vector<std::vector<Vec2>>& outlines, FillRule rule, const Box2& extent, int width,
                      int height) {
  const Vec2 pitch = extent.size().cwiseQuotient(Vec2(width, height));
  std::vector<Edge> edges;
  std::vector<double> levels;  // where the order of edges can change
  for (const auto& outline : outlines) {
    for (std::size_t k = 0; k < outline.size(); ++k) {
      const Vec2 p = (outline[k] - extent.min).cwiseQuotient(pitch);
      const Vec2 q = (outline[(k + 1) % outline.size()] - extent.min).cwiseQuotient(pitch);
      if (p.y() == q.y()) continue;
      edges.push_back(p.y() < q.y() ? Edge{p, q, 1} : Edge{q, p, -1});
      levels.push_back(p.y());
      levels.push_back(q.y());
    }
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) { return a.low.y() < b.low.y(); });

  // Crossings.
  std::vector<std::size_t> active;
  for (std::size_t e = 0; e < edges.size(); ++e) {
    const Edge& edge = edges[e];
    std::erase_if(active, [&](std::size_t k) { return edges[k].high.y() <= edge.low.y(); });
    for (const std::size_t k : active) {
      const Edge& other = edges[k];
      if (std::max(edge.low.x(), edge.high.x()) < std::min(other.low.x(), other.high.x()) ||
          std::max(other.low.x(), other.high.x()) < std::min(edge.low.x(), edge.high.x())) {
        continue;
      }
      const double y0 = edge.low.y();
      const double y1 = std::min(edge.high.y(), other.high.y());
      const double before = edge.x_at(y0) - other.x_at(y0);
      const double after = edge.x_at(y1) - other.x_at(y1);
      if ((before < 0 && after > 0) || (before > 0 && after < 0))
        levels.push_back(y0 + (y1 - y0) * before / (before - after));
    }
    active.push_back(e);
  }
  std::sort(levels.begin(), levels.end());
  levels.erase(std::unique(levels.begin(), levels.end()), levels.end());

  // In each slab between levels edges do not cross: the rule picks the borders of the inside.
  Grid<double> buffer(width + 1, height);
  active.clear();
  std::size_t next = 0;
  std::vector<std::pair<double, std::size_t>> sorted;
  for (std::size_t l = 0; l + 1 < levels.size(); ++l) {
    const double y0 = levels[l];
    const double y1 = levels[l + 1];
    std::erase_if(active, [&](std::size_t k) { return edges[k].high.y() <= y0; });
    while (next < edges.size() && edges[next].low.y() <= y0) active.push_back(next++);
    if (y1 <= 0 || y0 >= height) continue;
    sorted.clear();
    for (const std::size_t k : active) sorted.emplace_back(edges[k].x_at((y0 + y1) / 2), k);
    std::sort(sorted.begin(), sorted.end());
    int winding = 0;
    const auto inside = [&] { return rule == FillRule::kNonZero ? winding != 0 : winding % 2 != 0; };
    for (const auto& [x, k] : sorted) {
      const bool was = inside();
      winding += edges[k].winding;
      if (was == inside()) continue;
      accumulate(buffer, {edges[k].x_at(y0), y0}, {edges[k].x_at(y1), y1}, was ? -1 : 1);
    }
  }

  Grid<double> result(width, height);
  for (int row = 0; row < height; ++row) {
    double sum = 0;
    for (int column = 0; column < width; ++column) {
      sum += buffer.at(column, row);
      // Rounding is not light, and full is full.
      result.at(column, row) = sum < kRounding ? 0 : sum > 1 - kRounding ? 1 : sum;
    }
  }
  return result;
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

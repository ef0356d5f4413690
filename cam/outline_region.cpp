#include "cam/outline_region.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lightmill {

OutlineRegion::OutlineRegion(const Outline& outline, double margin_mm) {
  const std::vector<Vec2> places = outline_places(outline, kCellMm);
  Box2 box;
  for (const Vec2& p : places) box.include(p);
  const double around = std::max(margin_mm, 0.0) + 2 * kCellMm;
  first_ = box.min - Vec2::Constant(around);
  const Vec2 cells = (box.max + Vec2::Constant(around) - first_) / kCellMm;
  inside_ = Grid<char>(static_cast<int>(std::ceil(cells.x())), static_cast<int>(std::ceil(cells.y())), 0);
  // Rows by their crossings with the polygon, then a brush along it.
  std::vector<std::vector<double>> crossings(inside_.height);
  for (std::size_t k = 0; k < places.size(); ++k) {
    const Vec2& a = places[k];
    const Vec2& b = places[(k + 1) % places.size()];
    const auto row_above = [&](double y) { return static_cast<int>(std::ceil((y - first_.y()) / kCellMm - 0.5)); };
    for (int j = row_above(std::min(a.y(), b.y())); j < row_above(std::max(a.y(), b.y())); ++j) {
      const double y = first_.y() + (j + 0.5) * kCellMm;
      crossings[j].push_back(a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
    }
  }
  for (int j = 0; j < inside_.height; ++j) {
    std::sort(crossings[j].begin(), crossings[j].end());
    for (std::size_t k = 0; k + 1 < crossings[j].size(); k += 2) {
      const int from = static_cast<int>(std::ceil((crossings[j][k] - first_.x()) / kCellMm - 0.5));
      const int to = static_cast<int>(std::floor((crossings[j][k + 1] - first_.x()) / kCellMm - 0.5));
      for (int i = from; i <= to; ++i) inside_.at(i, j) = 1;
    }
  }
  const double brush = std::abs(margin_mm) / kCellMm + 1;
  const char paint = margin_mm >= 0 ? 1 : 0;
  const int reach = static_cast<int>(std::ceil(brush));
  for (const Vec2& p : places) {
    const Vec2 at = (p - first_) / kCellMm - Vec2::Constant(0.5);
    const int cj = static_cast<int>(std::lround(at.y()));
    for (int j = std::max(0, cj - reach); j <= std::min(inside_.height - 1, cj + reach); ++j) {
      const double half = std::sqrt(std::max(0.0, brush * brush - (j - at.y()) * (j - at.y())));
      const int from = std::max(0, static_cast<int>(std::ceil(at.x() - half)));
      const int to = std::min(inside_.width - 1, static_cast<int>(std::floor(at.x() + half)));
      for (int i = from; i <= to; ++i) inside_.at(i, j) = paint;
    }
  }
}

std::pair<double, double> reach_along_x(const std::vector<Vec2>& places, double margin_mm, double y) {
  double from = std::numeric_limits<double>::infinity();
  double to = -from;
  for (const Vec2& p : places) {
    const double dy = p.y() - y;
    if (std::abs(dy) > margin_mm) continue;
    const double half = std::sqrt(margin_mm * margin_mm - dy * dy);
    from = std::min(from, p.x() - half);
    to = std::max(to, p.x() + half);
  }
  return {from, to};
}

double distance_to_loop(const std::vector<Vec2>& loop, const Vec2& place) {
  double best = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < loop.size(); ++k) {
    const Vec2& a = loop[k];
    const Vec2 d = loop[(k + 1) % loop.size()] - a;
    const double length2 = d.squaredNorm();
    const double t = length2 > 0 ? std::clamp((place - a).dot(d) / length2, 0.0, 1.0) : 0;
    best = std::min(best, (a + t * d - place).squaredNorm());
  }
  return std::sqrt(best);
}

}  // namespace lightmill

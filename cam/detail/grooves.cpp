#include "cam/detail/grooves.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lightmill::detail {

namespace {

constexpr double kLegMm = 0.2;
constexpr double kCellMm = 1;
constexpr double kNearest = 0.6, kFarthest = 1.6;  ///< of kGoOverMm, to where a groove is left
constexpr double kOffLength = 0.1;                 ///< a way of half or 1.5 times the length counts as much as a bend of 0.15 rad

}  // namespace

std::vector<Vec2> bend(const Vec2& from, const Vec2& from_along, const Vec2& to, const Vec2& to_along, double reach_mm, int legs) {
  if (legs == 0) legs = std::max(1, static_cast<int>(std::ceil((to - from).norm() / kLegMm - 1e-9)));
  std::vector<Vec2> line;
  for (int k = 0; k <= legs; ++k) {
    const double t = static_cast<double>(k) / legs;
    const double s = t * t * (3 - 2 * t);
    line.push_back(from + (to - from) * s + reach_mm * (t * (1 - t) * (1 - t) * from_along - t * t * (1 - t) * to_along));
  }
  return line;
}

Grooves::Grooves(std::vector<std::vector<Vec2>> lines, std::function<bool(const Vec2&)> over_lens)
    : lines_(std::move(lines)), over_lens_(std::move(over_lens)) {
  for (const auto& line : lines_) {
    for (const Vec2& p : line) box_.include(p);
  }
  if (box_.empty()) return;
  const Eigen::Vector2i most = cell(box_.max);
  cells_ = Grid<std::vector<Vertex>>(most.x() + 1, most.y() + 1);
  for (int l = 0; l < static_cast<int>(lines_.size()); ++l) {
    for (int k = 0; k < static_cast<int>(lines_[l].size()); ++k) {
      const Eigen::Vector2i at = cell(lines_[l][k]);
      cells_.at(at.x(), at.y()).push_back({l, k});
    }
  }
}

Eigen::Vector2i Grooves::cell(const Vec2& place) const {
  return ((place - box_.min) / kCellMm).array().floor().cast<int>();
}

std::vector<Vec2> Grooves::stretch_to(const Vertex& vertex, int sense, double length_mm) const {
  const std::vector<Vec2>& line = lines_[vertex.line];
  std::vector<Vec2> result = {line[vertex.index]};
  double left = length_mm;
  const auto go_back = [&](const Vec2& to, double length) {
    result.push_back(result.back() + (to - result.back()) * (std::min(left, length) / length));
    left -= length;
  };
  for (int k = vertex.index - sense; left > 0 && k >= 0 && k < static_cast<int>(line.size()); k -= sense) {
    const double length = (line[k] - result.back()).norm();
    if (length > 0) go_back(line[k], length);
  }
  if (result.size() < 2) return {};
  if (left > 0) {
    if (over_lens_(result.back())) return {};
    const Vec2 away = (result.back() - result[result.size() - 2]).normalized();
    go_back(result.back() + left * away, left);
  }
  std::reverse(result.begin(), result.end());
  return result;
}

std::vector<Vec2> Grooves::way_to(const Vec2& place, const Vec2& along, double landing_mm) const {
  std::vector<Vec2> best;
  double least = std::numeric_limits<double>::infinity();
  if (box_.empty()) return best;
  const double reach = kFarthest * kGoOverMm;
  const Eigen::Vector2i low = cell(place - Vec2::Constant(reach)), high = cell(place + Vec2::Constant(reach));
  for (int j = std::max(0, low.y()); j <= std::min(cells_.height - 1, high.y()); ++j) {
    for (int i = std::max(0, low.x()); i <= std::min(cells_.width - 1, high.x()); ++i) {
      for (const Vertex& vertex : cells_.at(i, j)) {
        const std::vector<Vec2>& line = lines_[vertex.line];
        const Vec2 way = place - line[vertex.index];
        const double length = way.norm();
        if (length < kNearest * kGoOverMm || length > reach) continue;
        const double at_end = std::acos(std::clamp(way.dot(along) / length, -1.0, 1.0));
        const double off_length = kOffLength * (length / kGoOverMm - 1) * (length / kGoOverMm - 1);
        if (at_end > 1 || at_end * at_end + off_length >= least) continue;
        for (const int sense : {1, -1}) {
          const int before = vertex.index - sense;
          if (before < 0 || before >= static_cast<int>(line.size())) continue;
          const Vec2 out = (line[vertex.index] - line[before]).normalized();
          const double at_begin = std::acos(std::clamp(way.dot(out) / length, -1.0, 1.0));
          const double cost = at_begin * at_begin + at_end * at_end + off_length;
          if (at_begin > 1 || cost >= least) continue;
          std::vector<Vec2> stretch = stretch_to(vertex, sense, landing_mm);
          if (stretch.empty()) continue;
          least = cost;
          const std::vector<Vec2> over = bend(line[vertex.index], out, place, along, length);
          stretch.insert(stretch.end(), over.begin() + 1, over.end());
          best = std::move(stretch);
        }
      }
    }
  }
  return best;
}

}  // namespace lightmill::detail

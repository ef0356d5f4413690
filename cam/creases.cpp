#include "cam/creases.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>
#include <unordered_map>
#include <utility>

namespace lightmill {

namespace {

constexpr double kWidestMm = 5;  ///< of half a fillet that is looked for
constexpr int kBeside = 2;       ///< nodes that near to a line belong to it
constexpr int kDirections = 16;  ///< in which a fillet's width is looked for

class CreaseFinder {
 public:
  CreaseFinder(const SplineSurface& surface, const ReachableSurface& reachable)
      : surface_(surface), reachable_(reachable), width_(reachable.residue_um.width), height_(reachable.residue_um.height), on_line_(width_, height_, 0) {}

  std::vector<Crease> find(double shortest_mm) {
    for (int j = 0; j < height_; ++j) {
      for (int i = 0; i < width_; ++i) on_line_.at(i, j) = is_crest(i, j) ? 1 : 0;
    }
    std::vector<Crease> creases;
    for (int start = 0; start < width_ * height_; ++start) {
      while (on_line_.values[start]) {
        // The longest way through what hangs together, from one end to the other.
        const std::vector<int> way = from_end_to_end(start);
        Crease crease = measured(way);
        if (crease.length_mm >= shortest_mm) creases.push_back(std::move(crease));
        for (const int node : way) clear_around(node);
      }
    }
    std::stable_sort(creases.begin(), creases.end(), [](const Crease& a, const Crease& b) { return a.length_mm > b.length_mm; });
    return creases;
  }

 private:
  [[nodiscard]] Vec2 place(int i, int j) const { return reachable_.extent.min + reachable_.pitch_mm * Vec2(i, j); }
  [[nodiscard]] Vec2 place(int node) const { return place(node % width_, node / width_); }

  /// Residue between the nodes; outside, that of the border: a fillet does not end where the lens does.
  [[nodiscard]] double residue(const Vec2& p) const {
    const Vec2 last(width_ - 1, height_ - 1);
    const Vec2 at = ((p - reachable_.extent.min) / reachable_.pitch_mm).cwiseMax(Vec2::Zero()).cwiseMin(last);
    const int i = std::min(static_cast<int>(at.x()), width_ - 2), j = std::min(static_cast<int>(at.y()), height_ - 2);
    const double a = at.x() - i, b = at.y() - j;
    const Grid<float>& r = reachable_.residue_um;
    return (1 - b) * ((1 - a) * r.at(i, j) + a * r.at(i + 1, j)) + b * ((1 - a) * r.at(i, j + 1) + a * r.at(i + 1, j + 1));
  }

  /// Unit direction in which what is not reached is narrowest.
  [[nodiscard]] Vec2 across_fillet(const Vec2& p) const {
    Vec2 best(1, 0);
    double narrowest = std::numeric_limits<double>::infinity();
    for (int k = 0; k < kDirections; ++k) {
      const Vec2 direction(std::cos(kPi * k / kDirections), std::sin(kPi * k / kDirections));
      const double width = (flank(p, direction) - flank(p, -direction)).norm();
      if (width < narrowest) {
        narrowest = width;
        best = direction;
      }
    }
    return best;
  }

  /// Across the hollow no neighbour has more left.
  [[nodiscard]] bool is_crest(int i, int j) const {
    const double here = reachable_.residue_um.at(i, j);
    if (here <= reachable_.threshold_um) return false;
    const Vec2 p = place(i, j);
    const Vec2 across = reachable_.pitch_mm * across_fillet(p);
    return here >= residue(p + across) && here >= residue(p - across);
  }

  template <class Visit>
  void for_neighbours(int node, int reach, const Visit& visit) const {
    const int i = node % width_, j = node / width_;
    for (int b = std::max(0, j - reach); b <= std::min(height_ - 1, j + reach); ++b) {
      for (int a = std::max(0, i - reach); a <= std::min(width_ - 1, i + reach); ++a) {
        if (a != i || b != j) visit(b * width_ + a);
      }
    }
  }

  /// The node of the same line that is farthest from `start` along it, and the way from there.
  std::vector<int> farthest_from(int start) {
    using Entry = std::pair<double, int>;
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
    distance_.try_emplace(start, 0.0, -1);
    open.emplace(0, start);
    int last = start;
    while (!open.empty()) {
      const auto [d, node] = open.top();
      open.pop();
      if (d > distance_.at(node).first) continue;
      if (d >= distance_.at(last).first) last = node;
      for_neighbours(node, kBeside, [&](int next) {
        if (!on_line_.values[next]) return;
        const double there = d + (place(next) - place(node)).norm();
        const auto [found, fresh] = distance_.try_emplace(next, there, node);
        if (!fresh && found->second.first <= there) return;
        found->second = {there, node};
        open.emplace(there, next);
      });
    }
    std::vector<int> way;
    for (int node = last; node >= 0; node = distance_.at(node).second) way.push_back(node);
    distance_.clear();
    return way;
  }

  std::vector<int> from_end_to_end(int start) { return farthest_from(farthest_from(start).front()); }

  void clear_around(int node) {
    on_line_.values[node] = 0;
    for_neighbours(node, kBeside, [&](int next) { on_line_.values[next] = 0; });
  }

  [[nodiscard]] Crease measured(const std::vector<int>& way) const {
    Crease crease;
    // A grid's steps smoothed over five nodes.
    constexpr int kHalf = 2;
    const int count = static_cast<int>(way.size());
    for (int k = 0; k < count; ++k) {
      const int half = std::min({kHalf, k, count - 1 - k});
      Vec2 mean = Vec2::Zero();
      for (int m = k - half; m <= k + half; ++m) mean += place(way[m]);
      crease.line_mm.push_back(mean / (2 * half + 1));
    }
    double angles = 0, weights = 0;
    for (int k = 0; k < count; ++k) {
      const double piece = ((k > 0 ? (crease.line_mm[k] - crease.line_mm[k - 1]).norm() : 0) +
                            (k + 1 < count ? (crease.line_mm[k + 1] - crease.line_mm[k]).norm() : 0)) / 2;
      crease.length_mm += piece;
      const Vec2 p = place(way[k]);
      const Vec2 across = across_fillet(p);
      const Vec2 one = flank(p, across), other = flank(p, -across);
      const Vec3 n1 = surface_.normal(one.x(), one.y()), n2 = surface_.normal(other.x(), other.y());
      const double angle = std::acos(std::clamp(n1.dot(n2), -1.0, 1.0));
      crease.half_width_mm.push_back(std::max((one - p).norm(), (other - p).norm()));
      angles += piece * angle;
      weights += piece;
      crease.most_angle_rad = std::max(crease.most_angle_rad, angle);
      crease.area_mm2 += piece * (one - other).norm();
      crease.leftover_um = std::max<double>(crease.leftover_um, reachable_.residue_um.values[way[k]]);
      if (k == count / 2) {
        crease.one_normal = n1;
        crease.other_normal = n2;
      }
    }
    if (weights > 0) {
      crease.angle_rad = angles / weights;
      crease.fillet_mm = crease.area_mm2 / weights;
    }
    return crease;
  }

  /// Where the residue ends in this direction.
  [[nodiscard]] Vec2 flank(const Vec2& from, const Vec2& direction) const {
    const double step = reachable_.pitch_mm / 2;
    double way = 0;
    while (way < kWidestMm && residue(from + (way + step) * direction) > reachable_.threshold_um) way += step;
    return from + (way + step / 2) * direction;
  }

  const SplineSurface& surface_;
  const ReachableSurface& reachable_;
  int width_, height_;
  Grid<char> on_line_;
  std::unordered_map<int, std::pair<double, int>> distance_;  // along the line, and the node before
};

}  // namespace

std::vector<Crease> concave_creases(const SplineSurface& surface, const ReachableSurface& reachable, double shortest_mm) {
  if (reachable.unreachable_area_mm2 == 0 || reachable.residue_um.width < 2 || reachable.residue_um.height < 2) return {};
  return CreaseFinder(surface, reachable).find(shortest_mm);
}

}  // namespace lightmill

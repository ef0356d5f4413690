// Quick answers about an outline: what lies within a margin of it, and how far passes reach.
#pragma once

#include <cmath>
#include <utility>
#include <vector>

#include "cam/outline.h"
#include "design/core/grid.h"

namespace lightmill {

/// The inside of an outline and a margin around it (a rim less for a negative one), to a cell of 0.05 mm: what is within the
/// margin is in, what is within the rim is out.
class OutlineRegion {
 public:
  OutlineRegion(const Outline& outline, double margin_mm);
  [[nodiscard]] bool contains(const Vec2& place_mm) const {
    const int i = static_cast<int>(std::floor((place_mm.x() - first_.x()) / kCellMm));
    const int j = static_cast<int>(std::floor((place_mm.y() - first_.y()) / kCellMm));
    return i >= 0 && j >= 0 && i < inside_.width && j < inside_.height && inside_.at(i, j) != 0;
  }

 private:
  static constexpr double kCellMm = 0.05;
  Vec2 first_;
  Grid<char> inside_;
};

/// From where to where a pass along x at `y` comes within `margin_mm` of any of these places; first > second where none.
std::pair<double, double> reach_along_x(const std::vector<Vec2>& places, double margin_mm, double y);

/// Distance of a place from the closed polygon through these places.
double distance_to_loop(const std::vector<Vec2>& loop, const Vec2& place);

}  // namespace lightmill

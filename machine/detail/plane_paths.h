// Straight lines and circles in a plane that are run through, and where two of them cross.
#pragma once

#include <array>
#include <optional>

#include "design/core/geometry.h"

namespace lightmill::detail {

struct PlanePath {
  Vec2 at;                        ///< on the line, or the circle's centre
  Vec2 direction = Vec2::Zero();  ///< of the line, of length 1
  double radius = 0;              ///< of the circle
  int sense = 0;                  ///< of the circle: 1 anticlockwise, -1 clockwise; 0: a line

  static PlanePath line(const Vec2& at, const Vec2& direction) { return {at, direction}; }
  static PlanePath circle(const Vec2& centre, double radius, int sense) {
    return {centre, Vec2::Zero(), radius, sense};
  }
  /// Where it leads at a place on it.
  [[nodiscard]] Vec2 direction_at(const Vec2& p) const;
};

/// A quarter turn to the left.
inline Vec2 left_of(const Vec2& v) {
  return {-v.y(), v.x()};
}
inline double cross(const Vec2& a, const Vec2& b) {
  return a.x() * b.y() - a.y() * b.x();
}

/// Both places, the same one twice for two lines; none if the paths miss each other, are parallel or have one centre.
std::optional<std::array<Vec2, 2>> crossings(const PlanePath& a, const PlanePath& b);

}  // namespace lightmill::detail

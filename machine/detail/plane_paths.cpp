#include "machine/detail/plane_paths.h"

#include <cmath>

namespace lightmill::detail {

Vec2 PlanePath::direction_at(const Vec2& p) const {
  return sense == 0 ? direction : Vec2(sense * left_of(p - at).normalized());
}

std::optional<std::array<Vec2, 2>> crossings(const PlanePath& a, const PlanePath& b) {
  if (a.sense == 0 && b.sense == 0) {
    const double turn = cross(a.direction, b.direction);
    if (std::abs(turn) < 1e-12) return std::nullopt;
    const Vec2 p = a.at + cross(b.at - a.at, b.direction) / turn * a.direction;
    return {{p, p}};
  }
  // A foot on the line (or on the line of both centres), and as far to both sides as the circle says.
  Vec2 foot, along;
  double square = 0;
  if (a.sense == 0 || b.sense == 0) {
    const PlanePath &line = a.sense == 0 ? a : b, &circle = a.sense == 0 ? b : a;
    along = line.direction;
    foot = line.at + (circle.at - line.at).dot(along) * along;
    const double off = (circle.at - foot).norm();
    square = (circle.radius - off) * (circle.radius + off);
  } else {
    const Vec2 between = b.at - a.at;
    const double d = between.norm();
    if (!(d > 0)) return std::nullopt;
    const double t = (a.radius * a.radius + d * d - b.radius * b.radius) / (2 * d);
    along = left_of(between) / d;
    foot = a.at + t / d * between;
    square = (a.radius - t) * (a.radius + t);
  }
  if (!(square >= 0)) return std::nullopt;
  const Vec2 s = std::sqrt(square) * along;
  return {{foot + s, foot - s}};
}

}  // namespace lightmill::detail

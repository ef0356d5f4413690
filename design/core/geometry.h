// Plain geometric types that every room shares: vectors, boxes. All lengths in mm.
#pragma once

#include <Eigen/Core>
#include <limits>

namespace lightmill {

using Vec2 = Eigen::Vector2d;
using Vec3 = Eigen::Vector3d;

inline constexpr double kPi = 3.14159265358979323846;

/// Axis-aligned rectangle; an empty one is +inf..-inf and grows by include().
struct Box2 {
  Vec2 min{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  Vec2 max{-std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()};

  [[nodiscard]] static Box2 centred(const Vec2& size) { return {-size / 2, size / 2}; }
  [[nodiscard]] Vec2 size() const { return max - min; }
  [[nodiscard]] Vec2 centre() const { return (min + max) / 2; }
  [[nodiscard]] bool empty() const { return min.x() > max.x() || min.y() > max.y(); }
  [[nodiscard]] bool contains(const Vec2& p) const {
    return p.x() >= min.x() && p.x() <= max.x() && p.y() >= min.y() && p.y() <= max.y();
  }
  void include(const Vec2& p) {
    min = min.cwiseMin(p);
    max = max.cwiseMax(p);
  }
};

}  // namespace lightmill

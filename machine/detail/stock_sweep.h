// What one straight motion of a cutter leaves below it: exact lower envelopes over single points (x, y).
#pragma once

#include <limits>
#include <optional>

#include "design/core/geometry.h"

namespace lightmill {

inline constexpr double kNothing = std::numeric_limits<double>::infinity();

/// A body of revolution about a tool axis: a frustum from `from_mm` to `to_mm` above the tip.
struct Frustum {
  double from_mm = 0, to_mm = 0;
  double from_radius_mm = 0, to_radius_mm = 0;

  /// A frustum that contains every point within `distance_mm` of this one (negative: a frustum whose every point lies
  /// that deep inside this one).
  [[nodiscard]] Frustum grown(double distance_mm) const;
  [[nodiscard]] bool empty() const { return to_mm <= from_mm || (from_radius_mm <= 0 && to_radius_mm <= 0); }
};

/// Height of the frustum's underside over (x, y), the tool standing at tip with unit axis; kNothing where it has none.
/// Closed form: a vertical line meets a cone in the roots of a quadratic.
double underside(const Frustum& frustum, const Vec3& tip, const Vec3& axis, double x, double y);

/// A disk of radius `flat_mm` and the cylinder above it up to `top_mm`, both rounded by `corner_mm` (a ball: flat 0).
/// `top_mm` is the highest point of the cylinder's unrounded core above the tip, at least corner_mm. With a spread the core is a
/// cone: rounded, it is a tapered ball, the flank tangent to the ball.
struct RoundedCylinder {
  double flat_mm = 0;
  double corner_mm = 0;
  double top_mm = 0;
  double spread = 0;  ///< of the core: radius over height

  [[nodiscard]] double core_radius_mm(double height_mm) const { return flat_mm + spread * (height_mm - corner_mm); }
};

/// How far from `start`, which must lie outside, along unit `direction` a line enters a rounded cylinder that moves from tip to
/// tip + motion. The distance to a convex body that moves straight is convex in place and time together, so Newton along the
/// line comes up to the body from outside, with the nearest moment found by bisection; ends within 1e-9 mm.
std::optional<double> entry(const RoundedCylinder& body, const Vec3& tip, const Vec3& motion, const Vec3& axis, const Vec3& start,
                            const Vec3& direction);

/// The same upwards along the vertical line over (x, y): the height of the underside.
double underside(const RoundedCylinder& body, const Vec3& tip, const Vec3& motion, const Vec3& axis, double x,
                 double y);

/// One straight sweep with everything that is the same for all nodes worked out.
struct Sweep {
  enum class Shape {
    kBall,    ///< from, to: the ball's centres
    kMill,    ///< vertical axis, flat bottom with a rounded corner; from, to: tips
    kTilted,  ///< any axis; the whole cutting part, flutes included; from, to: tips
  };
  Shape shape = Shape::kBall;
  Vec3 from = Vec3::Zero(), to = Vec3::Zero();
  double radius_mm = 0;  ///< of the ball, of the mill
  double flat_mm = 0;    ///< radius of the mill's flat bottom
  double corner_mm = 0;
  /// How far behind `from` nodes must be looked at: the wedge between this motion and the one before (see
  /// stock_sweep.cpp).
  double back_mm = 0;
  /// The whole footprint must be looked at, not only the slab beside the motion.
  bool whole = false;
  RoundedCylinder body;       ///< kTilted
  double from_height_mm = 0;  ///< kTilted: what it covers below this height above the tip is left to other sweeps
  Vec3 axis = Vec3::UnitZ();  ///< kTilted

  // Worked out by prepare().
  double along_x = 1, along_y = 0;  ///< unit, direction of the motion seen from above
  double length_mm = 0;             ///< seen from above
  double inverse_length = 0;
  double rise_mm = 0;           ///< to.z - from.z
  double sine = 0, cosine = 1;  ///< of the climbing angle
  double lowest_mm = 0;         ///< nothing of the cutter is below
  Box2 reach;                   ///< seen from above

  void prepare();
  /// kTilted: a cylinder that, in the middle of the motion, contains what the sweep covers within `slack_mm` of it.
  [[nodiscard]] Frustum around(double slack_mm) const;
  /// The lowest height of the swept cutter over (x, y); kNothing beside it and, where that saves work, if not below
  /// `below`.
  [[nodiscard]] double height(double x, double y, double below = kNothing) const;
  /// No height `distance_mm` or farther from the motion (seen from above) is below this (kBall, kMill).
  [[nodiscard]] double least_height(double distance_mm) const;
  /// Places along the motion, from its start, between which it may make nodes.
  struct Slab {
    double first = -kNothing, last = kNothing;
  };
  /// The slab and `beside_mm` more on both sides, if the motion may make nodes of a rectangle that stand below `below` (kBall, kMill):
  /// a superset of those whose least height along the path is on this motion or on its first vertex.
  [[nodiscard]] std::optional<Slab> slab_over(const Vec2& centre, const Vec2& half, double below, double beside_mm = 0) const;
};

/// The wedge parameter `back_mm` for a ball's motion along unit `direction` that follows one along unit `before`.
double ball_wedge(const Vec3& before, const Vec3& direction, double radius_mm);

/// Height and slope of the surface that a swept ball leaves at (x, y). height kNothing where it does not reach.
struct SweptPoint {
  double height = kNothing;
  double slope_x = 0, slope_y = 0;
};
SweptPoint swept_ball(const Vec3& from, const Vec3& to, double radius_mm, double x, double y);

}  // namespace lightmill

// Circular arcs in the controls' planes through runs of a path's points.
#pragma once

#include <optional>
#include <span>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// An arc as G2 and G3 have it: in a plane of two axes, the third going along evenly with the angle.
struct PlaneArc {
  int normal = 2;            ///< axis across the plane: 2 G17 (X, Y), 1 G18 (Z, X), 0 G19 (Y, Z)
  Vec3 centre_mm = Vec3::Zero();  ///< its two components in the plane
  bool clockwise = false;    ///< seen against the normal
};

/// The plane's first and second axis; G3 turns from one to the other.
inline int first_axis(int normal) { return (normal + 1) % 3; }
inline int second_axis(int normal) { return (normal + 2) % 3; }

/// Greatest distance between the polyline of `points` and the arc, which need not pass through its ends exactly: then the
/// radius changes evenly. Infinite where a point lies out of the arc's order or the arc turns by more than 120 degrees.
double arc_error(const PlaneArc& arc, std::span<const Vec3> points);

/// Way along the arc from one place to another, at the first one's radius.
double arc_length(const PlaneArc& arc, const Vec3& from, const Vec3& to);

/// The arc from the first point to as many as it can stay within `tolerance_mm` of.
struct ArcRun {
  std::size_t moves = 0;  ///< that it replaces: ends at points[moves]
  PlaneArc arc;
  double error_mm = 0;
  double length_mm = 0;
};

/// Nothing if it would replace fewer than three moves. Ends and centre are on a grid of `unit_mm`, as they will be printed.
std::optional<ArcRun> longest_arc(std::span<const Vec3> points, double tolerance_mm, double unit_mm);

}  // namespace lightmill::detail

// Splines that controls read: non-uniform rational B-splines in the plane, whose Bezier curves are G5 and G5.1.
#pragma once

#include <array>
#include <vector>

namespace lightmill::detail {

struct ControlPoint {
  double x, y, weight = 1;
};

/// The point at t in [0, points - order + 1] of the spline that begins and ends at its outer points (clamped uniform
/// knots), by de Boor's recursion; as many points as `order` or more. One point more than the degree is a Bezier curve.
std::array<double, 2> spline_point(const std::vector<ControlPoint>& points, int order, double t);

}  // namespace lightmill::detail

// The rotary axes' mathematics in physical angles, shared by kinematics and motion planning.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <optional>

#include "postproc/kinematics.h"

namespace lightmill::detail {

/// Below this sine of the angle between tool and inner axis, inverse() calls a pose the pole: the inner angle has no
/// meaning.
inline constexpr double kPoleSine = 1e-12;

/// Programmed angles of both rotary axes.
struct Tilt {
  double outer_rad = 0;
  double inner_rad = 0;
};

/// `v` turned by `angle_rad` about the unit axis (Rodrigues).
inline Vec3 turned(const Vec3& v, const Vec3& axis, double angle_rad) {
  const double c = std::cos(angle_rad);
  const double s = std::sin(angle_rad);
  return c * v + s * axis.cross(v) + (1 - c) * axis.dot(v) * axis;
}

/// Sine of the angle between a unit tool axis (workpiece frame) and the inner rotary axis.
inline double pole_sine(const MachineModel& machine, const Vec3& axis) {
  return machine.inner.axis.cross(axis).norm();
}

/// The workpiece's rotation R_MW for given rotary joints, and where it puts points: p_M = rotation * p_W + translation.
struct Placement {
  Eigen::Matrix3d rotation;
  Vec3 translation;
};
Placement place_work(const MachineModel& machine, const WorkSetup& setup, const Tilt& tilt);

/// From the spindle's gauge point to the tip, machine frame: straight down unless the head is turned.
Vec3 tip_from_gauge_point(const MachineModel& machine, double tool_length_mm, const Tilt& tilt);

/// The tool's axis in the workpiece frame.
Vec3 axis_at(const MachineModel& machine, const Tilt& tilt);

/// Rotary joints that bring `axis` (unit, workpiece frame) parallel to the spindle: the one with the greater outer
/// angle first. `inner_at_pole_rad` is used where pole_sine() <= `pole_sine_limit`; there both branches are the same
/// unless the outer axis is not perpendicular to both others. Nothing if the machine cannot orient the tool so.
std::optional<std::array<Tilt, 2>> solve_tilt(const MachineModel& machine, const Vec3& axis, double inner_at_pole_rad,
                                              double pole_sine_limit = kPoleSine);

/// The joints that put the tip where it belongs, given the rotary ones.
JointPosition joints_at(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const Vec3& tip_mm,
                        const Tilt& tilt);

/// The spindle's +Z, seen from the work.
Vec3 spindle_in_work(const MachineModel& machine, const WorkSetup& setup, const Tilt& tilt);

/// The least height of the tip (workpiece frame) over the corners of the box between two positions with the same rotary
/// joints, from machine Z `z_mm` up: what rapids may pass whose axes arrive one by one.
double lowest_corner(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const JointPosition& a,
                     const JointPosition& b, double z_mm);

/// The tip alone of forward().
Vec3 tip_at(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const JointPosition& joints);

}  // namespace lightmill::detail

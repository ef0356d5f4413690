#include "postproc/kinematics.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "postproc/detail/trunnion.h"

namespace lightmill {
namespace detail {
namespace {

// Directions just outside the cone that a skew trunnion reaches are put onto it: rounding of a unit vector, not a
// demand.
constexpr double kConeSlack = 1e-12;

// The turn of the work relative to the tool: a head axis turns the tool instead, the other way round.
double relative_direction(const RotaryAxis& axis) {
  return axis.on_head ? -axis.direction : axis.direction;
}

Vec3 about(const RotaryAxis& axis, const Vec3& point, double programmed_rad) {
  return axis.point_mm + turned(point - axis.point_mm, axis.axis, programmed_rad);
}

// The angle about the unit `axis` that turns `from` to `to`, both perpendicular to it; by atan2, exact at 0 and pi too.
double angle_about(const Vec3& axis, const Vec3& from, const Vec3& to) {
  return std::atan2(axis.dot(from.cross(to)), from.dot(to));
}

Vec3 across(const Vec3& v, const Vec3& axis) {
  return v - axis.dot(v) * axis;
}

// In (-pi, pi]: atan2 may say -pi for a negative zero.
double half_open(double angle_rad) {
  return angle_rad <= -kPi ? kPi : angle_rad;
}

}  // namespace

Placement place_work(const MachineModel& machine, const WorkSetup& setup, const Tilt& tilt) {
  // p_M = P + R_o (Q + R_i (o + p_W - Q) - P); an axis of the head does not turn the work.
  Placement place{Eigen::Matrix3d::Identity(), setup.origin_mm};
  const auto turn = [&place](const RotaryAxis& axis, double programmed_rad) {
    if (axis.on_head) return;
    const Eigen::Matrix3d r = Eigen::AngleAxisd(axis.direction * programmed_rad, axis.axis).toRotationMatrix();
    place.rotation = r * place.rotation;
    place.translation = axis.point_mm + r * (place.translation - axis.point_mm);
  };
  if (machine.has_rotary()) {
    turn(machine.inner, tilt.inner_rad);
    turn(machine.outer, tilt.outer_rad);
  }
  return place;
}

Vec3 tip_from_gauge_point(const MachineModel& machine, double tool_length_mm, const Tilt& tilt) {
  Vec3 tip(0, 0, -tool_length_mm);
  if (!machine.has_rotary()) return tip;
  if (machine.outer.on_head) tip = about(machine.outer, tip, machine.outer.direction * tilt.outer_rad);
  if (machine.inner.on_head) tip = about(machine.inner, tip, machine.inner.direction * tilt.inner_rad);
  return tip;
}

std::optional<std::array<Tilt, 2>> solve_tilt(const MachineModel& machine, const Vec3& axis, double inner_at_pole_rad,
                                              double pole_sine_limit) {
  if (!machine.has_rotary()) {
    if (!(axis.z() > 0 && std::hypot(axis.x(), axis.y()) <= std::max(pole_sine_limit, kPoleSine))) return std::nullopt;
    return std::array<Tilt, 2>{};
  }
  const Vec3& a = machine.outer.axis;
  const Vec3& c = machine.inner.axis;
  const Vec3 z = Vec3::UnitZ();

  // R_o(b) R_i(g) axis = z. The vector v = R_i(g) axis = R_o(-b) z keeps axis' component along the inner axis and z's
  // component along the outer one; what is left is the sign of its component along c x a [Paden 1986, subproblem 2].
  const double along = c.dot(axis);
  const double radius = c.cross(axis).norm();  // not sqrt(1 - along^2), which loses half the digits near the pole
  const bool at_pole = radius <= pole_sine_limit;
  const Vec3 a_across = across(a, c);
  const double a_sine = a_across.norm();
  const Vec3 u = a_across / a_sine;
  const double along_u = (a.z() - along * a.dot(c)) / a_sine;
  const double rest = (radius - along_u) * (radius + along_u);
  if (rest < -kConeSlack && !(at_pole && std::abs(along_u) < 1e-9)) return std::nullopt;
  const double side = at_pole ? 0 : std::sqrt(std::max(rest, 0.0));

  std::array<Tilt, 2> tilts;
  for (int branch = 0; branch < 2; ++branch) {
    const Vec3 v =
        at_pole ? Vec3(along < 0 ? -c : c) : Vec3(along * c + along_u * u + (branch == 0 ? side : -side) * c.cross(u));
    const double outer = angle_about(a, across(v, a), across(z, a));
    const double inner = angle_about(c, across(axis, c), across(v, c));
    tilts[branch].outer_rad = half_open(relative_direction(machine.outer) * outer);
    tilts[branch].inner_rad = at_pole ? inner_at_pole_rad : half_open(relative_direction(machine.inner) * inner);
  }
  if (tilts[0].outer_rad < tilts[1].outer_rad) std::swap(tilts[0], tilts[1]);
  return tilts;
}

JointPosition joints_at(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const Vec3& tip_mm,
                        const Tilt& tilt) {
  // The same chain as place_work(), on one point and without matrices.
  Vec3 at = setup.origin_mm + tip_mm;
  if (machine.has_rotary()) {
    if (!machine.inner.on_head) at = about(machine.inner, at, machine.inner.direction * tilt.inner_rad);
    if (!machine.outer.on_head) at = about(machine.outer, at, machine.outer.direction * tilt.outer_rad);
  }
  at -= tip_from_gauge_point(machine, tool_length_mm, tilt);
  return {at.x(), at.y(), at.z(), tilt.outer_rad, tilt.inner_rad};
}

Vec3 tip_at(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const JointPosition& joints) {
  const Tilt tilt{joints.outer_rad, joints.inner_rad};
  Vec3 at = Vec3(joints.x_mm, joints.y_mm, joints.z_mm) + tip_from_gauge_point(machine, tool_length_mm, tilt);
  if (machine.has_rotary()) {
    if (!machine.outer.on_head) at = about(machine.outer, at, -machine.outer.direction * tilt.outer_rad);
    if (!machine.inner.on_head) at = about(machine.inner, at, -machine.inner.direction * tilt.inner_rad);
  }
  return at - setup.origin_mm;
}

Vec3 spindle_in_work(const MachineModel& machine, const WorkSetup& setup, const Tilt& tilt) {
  return place_work(machine, setup, tilt).rotation.transpose() * Vec3::UnitZ();
}

double lowest_corner(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const JointPosition& a,
                     const JointPosition& b, double z_mm) {
  double lowest = std::numeric_limits<double>::infinity();
  for (const double x : {a.x_mm, b.x_mm}) {
    for (const double y : {a.y_mm, b.y_mm}) {
      lowest = std::min(lowest, tip_at(machine, setup, tool_length_mm, {x, y, z_mm, b.outer_rad, b.inner_rad}).z());
    }
  }
  return lowest;
}

Vec3 axis_at(const MachineModel& machine, const Tilt& tilt) {
  if (!machine.has_rotary()) return Vec3::UnitZ();
  const Vec3 upright =
      turned(Vec3::UnitZ(), machine.outer.axis, -relative_direction(machine.outer) * tilt.outer_rad);
  return turned(upright, machine.inner.axis, -relative_direction(machine.inner) * tilt.inner_rad);
}

}  // namespace detail

WorkSetup work_on_table(const MachineModel& machine, const Vec3& offset_mm, int work_offset) {
  if (work_offset < 54 || work_offset > 59) {
    throw InputError("work offset G" + std::to_string(work_offset) + " does not exist: use 54 to 59");
  }
  if (!offset_mm.allFinite()) throw InputError("workpiece origin must be three finite numbers");
  return {machine.table_centre_mm + offset_mm, work_offset};
}

ToolPose forward(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm,
                 const JointPosition& joints) {
  return {detail::tip_at(machine, setup, tool_length_mm, joints),
          detail::axis_at(machine, {joints.outer_rad, joints.inner_rad})};
}

std::array<JointPosition, 2> inverse(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm,
                                     const ToolPose& pose, double inner_at_pole_rad) {
  const auto tilts = detail::solve_tilt(machine, pose.axis, inner_at_pole_rad);
  if (!tilts) {
    throw InputError("tool axis (" + compact(pose.axis.x(), 6) + ", " + compact(pose.axis.y(), 6) + ", " +
                     compact(pose.axis.z(), 6) + ") cannot be reached by the rotary axes of " + machine.name +
                     ": tilt the tool less");
  }
  return {detail::joints_at(machine, setup, tool_length_mm, pose.tip_mm, (*tilts)[0]),
          detail::joints_at(machine, setup, tool_length_mm, pose.tip_mm, (*tilts)[1])};
}

}  // namespace lightmill

// Tilted planes: where a program's coordinates lie in those of the work offset, and how the rotary axes turn the cutter
// into a direction.
#pragma once

#include <vector>

#include "machine/kinematics.h"

namespace lightmill::detail {

/// p_offset = turn * p_program + origin_mm.
struct WorkFrame {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  Vec3 origin_mm = Vec3::Zero();
  [[nodiscard]] bool is_identity() const { return turn.isIdentity(0) && origin_mm.isZero(0); }
};

/// `inner` as seen from inside `outer`.
WorkFrame operator*(const WorkFrame& outer, const WorkFrame& inner);

/// Right-handed about X, Y or Z (0, 1, 2); whole quarter turns are exact.
Eigen::Matrix3d turn_about(int axis, double angle_rad);

/// First about X, then about Y and Z as they stand: Heidenhain's space angles, Siemens' roll, pitch and yaw.
Eigen::Matrix3d turn_xyz(double x_rad, double y_rad, double z_rad);

/// Outer and inner angle.
struct RotaryAngles {
  double outer_rad, inner_rad;
};

/// The angles that turn the cutter into `axis_W` (of any length, workpiece frame), within the machine's limits and by
/// whole turns as near to `from` as they come; none to two. Where the inner angle is free, it stays.
std::vector<RotaryAngles> angles_for(const MachineModel& machine, WorkpieceView& view, const Vec3& axis_W,
                                     const RotaryAngles& from);

}  // namespace lightmill::detail

// Axis positions for tool poses: the post-processor's own inverse kinematics of a table/table machine.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "cam/toolpath.h"
#include "postproc/machine_model.h"

namespace lightmill {

/// Where the workpiece frame's origin sits: machine coordinates with all joints at zero, axes parallel to the machine's.
struct WorkSetup {
  Vec3 origin_mm = Vec3::Zero();
  int work_offset = 54;              ///< G54..G59; its zero is the workpiece origin with all rotary joints at zero
};

/// The table's centre plus an offset.
WorkSetup work_on_table(const MachineModel& machine, const Vec3& offset_mm, int work_offset);

ToolPose forward(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm, const JointPosition& joints);

/// Rotary joints bring the tool axis parallel to the spindle [Paden 1986, subproblem 2], then X, Y, Z bring the tip in place.
/// Both branches (outer angle positive and negative), inner angle in (-pi, pi]; at the pole (axis parallel to the inner
/// axis at outer = 0) the inner angle is `inner_at_pole_rad`. Limits are not looked at. Throws InputError when no tilt of
/// the table brings the axis parallel to the spindle (a skew trunnion only).
std::array<JointPosition, 2> inverse(const MachineModel& machine, const WorkSetup& setup, double tool_length_mm,
                                     const ToolPose& pose, double inner_at_pole_rad = 0);

}  // namespace lightmill

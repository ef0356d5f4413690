// Tool path to axis motion: branch choice, unwinding, subdivision until the tip keeps its line, feeds within axis limits.
#pragma once

#include <string>
#include <vector>

#include "design/core/monitor.h"
#include "postproc/kinematics.h"

namespace lightmill {

/// A straight move of all joints to `joints`.
struct AxisMove {
  JointPosition joints;
  MoveKind kind = MoveKind::kRapid;
  double seconds = 0;            ///< feed moves: the time the move shall take; 0 for rapids
  bool rotary_moves = false;     ///< a rotary joint changes in this move
};

struct AxisMotion {
  std::string pass;
  Cutter cutter;
  double spindle_rpm = 0;
  std::vector<AxisMove> moves;
  double max_tip_error_um = 0;       ///< of the tip between blocks against the tool path's straight line
  double max_axis_speed_ratio = 0;   ///< greatest axis speed over its limit
  std::size_t slowed_moves = 0;      ///< feeds lowered for an axis limit
};

struct MotionOptions {
  double tip_tolerance_mm = 2e-4;
};

/// Throws InputError naming the place in the path when a pose is out of reach or the tool is too long.
AxisMotion plan_motion(const MachineModel& machine, const WorkSetup& setup, const ToolPath& path,
                       const MotionOptions& options = {}, const Monitor& monitor = {});

}  // namespace lightmill

// Tool path to axis motion: branch choice, unwinding, subdivision until the tip keeps its line, feeds within axis limits.
#pragma once

#include <string>
#include <vector>

#include "design/core/monitor.h"
#include "postproc/kinematics.h"

namespace lightmill {

/// A straight move of all joints to `joints`. A rapid that moves a rotary joint stays at the machine's top (retract_z_mm).
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
  bool tcp = false;                  ///< cut for tool-centre-point control: turning moves rely on it between their ends
  double clearance_z_mm = 0;         ///< rapids keep the tip at or above this height of the workpiece frame
  std::vector<AxisMove> moves;       ///< the first is at the machine's top with the rotary joints in place
  double max_tip_error_um = 0;       ///< of the tip between blocks against the tool path's straight line
  double max_axis_speed_ratio = 0;   ///< greatest axis speed over its limit
  std::size_t rewinds = 0;           ///< times the tool leaves the cut because a rotary axis is at its limit
  std::size_t slowed_moves = 0;      ///< feeds lowered for an axis limit or the controller's block time
  double worst_slowing = 1;          ///< greatest factor by which a move takes longer, and the tip there (workpiece frame)
  Vec3 worst_slowing_at_mm = Vec3::Zero();
};

struct MotionOptions {
  double tip_tolerance_mm = 2e-4;    ///< of the tip, and of a point one cutter radius up the tool, from their even motion
  bool tcp = false;                  ///< the control keeps the point it guides on its line: moves are cut for the axis alone
};

/// A path with one tool axis keeps its rotary joints exactly constant and its moves one to one, after an approach over the
/// machine's top. Otherwise branches and turns are the cheapest way through the whole path within the limits; moves are cut
/// until the tip keeps its line; an endless axis turns the short way; on the pole, where the inner angle is free, it turns
/// while the tip stands; a limited axis unwinds in rapids, at the machine's top, and where the path has none in time the tool
/// leaves the part along its axis, turns at the top and comes back (counted). Times keep the tip's feed unless an
/// axis limit or the controller's block time asks for more. Throws InputError naming the pass, the move, the pose, the axis,
/// its value and limit and a remedy when a pose is out of reach, a rapid turns the tool axis, or the tool is too long.
AxisMotion plan_motion(const MachineModel& machine, const WorkSetup& setup, const ToolPath& path,
                       const MotionOptions& options = {}, const Monitor& monitor = {});

}  // namespace lightmill

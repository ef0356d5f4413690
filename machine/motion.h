// Motion as the simulated controller hears it: joints first, then the cutter in the workpiece frame.
#pragma once

#include <cstdint>
#include <string>

#include "cam/toolpath.h"
#include "postproc/machine_model.h"

namespace lightmill {

/// A straight move of all joints, in the order of execution.
struct Motion {
  long line = 0;                 ///< of the program text, from 1
  JointPosition from, to;        ///< machine coordinates
  bool rapid = false;
  double seconds = 0;            ///< how long it takes at the commanded feed, axis limits respected
  double stood_s = 0;            ///< dwell before it
  bool spindle_on = false;
  double spindle_rpm = 0;
  int tool = 0;                  ///< number of the tool in the spindle
  double corner_tolerance_mm = -1;  ///< how far the tip may leave the corner at its end; 0: not at all; below 0: as the control does
  bool exact_stop = false;       ///< stands at its end
};

/// The same in the workpiece frame: the tip moves on a straight line, the axis turns evenly (long rotary moves arrive in
/// pieces). What the stock sees.
struct SweptMove {
  long line = 0;
  ToolPose from, to;
  bool rapid = false;
  bool spindle_on = false;
  double seconds = 0;
  double spindle_rpm = 0;  ///< 0: not known
};

/// Something the machine or the stock noticed. All of them are reported.
struct Fault {
  std::string kind;      ///< "limit", "rapid_in_stock", "spindle_off_in_cut", "collision", "gouge", "alarm", "error", ...
  std::string program;   ///< file, if known
  long line = 0;         ///< of its text; the first, if others repeat it
  long last_line = 0;    ///< the last that repeats it; 0: no other
  long worst_line = 0;   ///< where place and amount hold; 0: `line`
  std::string message;   ///< one line for the operator, without the place in the program (see fault_words.h)
  Vec3 place_mm = Vec3::Zero();  ///< workpiece frame, if it has one
  double amount_mm = 0;  ///< depth, overtravel...
  std::string picture{}; ///< SVG: a section at the place, its top left free for a heading; empty: none
};

}  // namespace lightmill

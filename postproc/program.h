// Axis motion to program text: grblHAL's RS274 dialect.
#pragma once

#include <string>
#include <vector>

#include "postproc/axis_motion.h"

namespace lightmill {

struct ProgramOptions {
  int decimals = 5;                  ///< of mm and degrees
  bool block_numbers = false;        ///< N words (for checks)
  std::string job_name;
  std::string job_hash;
  double warm_up_s = 8;              ///< spindle dwell before the first cut
};

struct Program {
  std::string file_name;             ///< "30_finish.nc"
  std::string text;                  ///< ASCII, LF
  std::size_t blocks = 0;
};

/// Header, tool change, spindle with dwell, air, machine-top Z before any rotary move, G93 wherever a rotary axis moves,
/// footer. Checks its own finished text against the safety rules (spindle before cut, no rotary move near the part, every
/// number inside the controller's range) and throws NumericalError if one is broken.
Program write_grblhal(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                      const ProgramOptions& options = {});

}  // namespace lightmill

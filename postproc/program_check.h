// A second reading of a finished program: the safety rules, and block by block the motion it was made from.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "postproc/program.h"

namespace lightmill {

/// Faults of `text`, one line each ("line 12: ..."), empty if there are none; stops after twenty. Reads the text with its own
/// reader, from nothing but the characters. Rules: printable ASCII without the controller's real-time characters, lines of at
/// most 80 characters; the first motion is to the machine's top; tool, tool length, work offset, spindle and dwell before the
/// first feed move; no rotary word except at the machine's top or in a G93 feed move; F on every G93 block; no rapid below the
/// safe plane except straight up; every position within the travels; spindle and air off, machine's top, rotary axes at zero
/// and M30 at the end; what the dialect asks for (%, O number, decimal points, G64 P, G43 H, G5.1);
/// every block ends where `motion` says, in order and none missing, and is not faster.
std::vector<std::string> check_program_text(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                                            std::string_view text, const ProgramOptions& options = {});

}  // namespace lightmill

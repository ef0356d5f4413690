// A second reading of a finished program: the safety rules, and block by block the motion it was made from.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "postproc/program.h"

namespace lightmill {

/// Faults of `text`, one line each ("line 12: ..."), empty if there are none; stops after twenty. Reads the text with
/// its own reader, from nothing but the characters. Rules: printable ASCII (without grbl's real-time characters), lines
/// of at most 80 characters; the first motion is to the machine's top; tool, tool length, work offset, spindle and
/// dwell before the first feed move; no rotary word except at the machine's top, in a block that carries its time, or
/// under tool-centre-point control, which is off for tool changes and machine coordinates; a time on every such block;
/// no rapid below the safe plane except straight up, nor, where rapids are dog legs, any corner of one; every position
/// within the travels; spindle and air off, machine's top, rotary axes at zero and the program's end at the end; what
/// the dialect asks for (frame, block numbers, decimal points, smoothing, tool length, short way of endless axes);
/// every block ends where the plan says, in order and none missing, and is not faster.
std::vector<std::string> check_program_text(const MachineModel& machine, const WorkSetup& setup,
                                            std::span<const AxisMotion> passes, std::string_view text,
                                            const ProgramOptions& options = {});
std::vector<std::string> check_program_text(const MachineModel& machine, const WorkSetup& setup,
                                            const AxisMotion& motion, std::string_view text,
                                            const ProgramOptions& options = {});

}  // namespace lightmill

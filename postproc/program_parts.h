// The programs of a job: one per pass, or one for all, and in parts where the control's memory is too small.
#pragma once

#include <span>
#include <vector>

#include "postproc/program.h"

namespace lightmill {

/// As write_program() for each pass, or for all at once (`one_program`). A program longer than
/// machine.max_program_bytes is written pass by pass, and a pass in parts that each begin and end by themselves: it is
/// split before a rapid between two places above the safe plane, and every part comes back to the machine's top,
/// changes the tool and starts the spindle. Throws InputError naming pass and place where no such rapid comes in time.
std::vector<Program> write_programs(const MachineModel& machine, const WorkSetup& setup,
                                    std::span<const AxisMotion> passes, bool one_program = false,
                                    const ProgramOptions& options = {});

/// The moves from `begin` to before `end` as a motion of their own, which approaches the first over the machine's top.
AxisMotion part_of(const MachineModel& machine, const AxisMotion& motion, std::size_t begin, std::size_t end);

}  // namespace lightmill

// Program files on the simulated machine: what a control that runs files would do with them, and what is left of the
// blank.
#pragma once

#include <string>
#include <vector>

#include "design/core/monitor.h"
#include "machine/motion_timing.h"
#include "machine/program_reader.h"
#include "machine/simulated_machine.h"

namespace lightmill {

struct ProgramFile {
  std::string name;
  std::string text;
};

struct ProgramRun {
  long blocks = 0;             ///< executed
  std::vector<SectionTiming> timing;  ///< of every tool in every program
  std::vector<Fault> faults;   ///< of the control ("error", "limit", "no_tool", "no_program_end"), then of the stock
  MachinedSurface surface;
  std::shared_ptr<const SolidStock> solid;  ///< null unless asked for
};

/// What the operator has entered at such a control: the magazine's true lengths, the workpiece's true place in its work
/// offset; the axes at the machine's top.
ReaderSetup reader_setup(const MachineModel& machine, const OperatorSetup& setup);

/// One after the other, each from where the last has left the machine. Stops at the first thing the control does not understand or that
/// leaves the travels. Cutters cut when M3 has had `spindle_start_s` to reach its speed. `on_motion` hears every motion, `on_block`
/// every one with its time, as a MotionTimer tells them.
ProgramRun run_programs(const MachineModel& machine, ReaderDialect dialect, const OperatorSetup& setup,
                        const std::vector<ProgramFile>& programs, const StockOptions& options = {},
                        const Monitor& monitor = {}, const std::function<void(const Motion&)>& on_motion = {},
                        const std::function<void(const TimedBlock&)>& on_block = {});

}  // namespace lightmill

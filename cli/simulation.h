// A dry run of programs: the streamer and the simulated machine on one virtual clock where the line is paced, else the machine
// in a process of its own behind a pseudo-terminal, reached through libserial as if it were a real one.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "cam/blank.h"
#include "cli/stages.h"
#include "cli/timing_report.h"
#include "design/core/geometry.h"
#include "design/core/monitor.h"
#include "machine/machine_errors.h"
#include "machine/motion.h"
#include "machine/simulated_machine.h"
#include "machine/streamer.h"

namespace lightmill {

/// So long a table (6 MB) is made without being asked for.
inline constexpr std::size_t kMostTimedLines = 100'000;

/// What stands on the simulated shop floor; all files, because another process reads them.
struct SimulatedShop {
  std::filesystem::path machine_file;
  std::vector<std::filesystem::path> cutter_files;
  std::string material;  ///< whose cutting data of the cutter files count; empty: each file's first by name
  Blank blank;
  Vec3 workpiece_origin_mm = Vec3::Zero();  ///< machine frame, joints at zero
  int work_offset = 54;                     ///< the one the operator has zeroed on the workpiece
  MachineErrors errors;                     ///< how the true machine differs from its file
  double pitch_um = 20;                     ///< of the stock's grid
  double solid_pitch_um = 0;                ///< of the solid beside it; 0: none
  double starvation_mark_um = 1;            ///< left where the cutter stands in the cut
  double time_factor = 0;                   ///< 0: as fast as it can; in lockstep of the virtual clock, which changes no result
  int baud = 0;                             ///< 0: not paced
  std::string line_times = "off";           ///< "on": a table of the lines' times; "auto": of at most kMostTimedLines lines
  bool one_at_a_time = false;               ///< the sender waits for each acknowledgement
  /// Sender and machine share a virtual clock, on which motions and bytes take their time.
  [[nodiscard]] bool in_lockstep() const { return time_factor > 0 || baud > 0; }
  std::string protocol = "grblhal";         ///< of the control on the wire
  std::vector<std::string> line_faults;     ///< to plant on the line and in the control (plant_fault())
  unsigned fault_seed = 1;                  ///< chooses the place of a fault that names none
};

/// The shop floor as the job describes it, the blank as the tool paths were planned for.
SimulatedShop shop_of(const Job& job, const RunFolder& folder, const ShopOverrides& overrides = {});
/// What the operator has put on the machine; the spindle's nose ends every holder.
OperatorSetup setup_of(const SimulatedShop& shop, const MachineModel& machine);

/// What came of it. Faults of the machine, the stock and the line; the surface is in OUT/machined.tif, a solid in OUT/solid.bin,
/// the lines' times in OUT/line_times.csv.
struct SimulationOutcome {
  std::vector<Fault> faults;
  std::vector<StreamResult> streams;        ///< one per program that was started
  long lines = 0;                           ///< executed
  long bytes_received = 0;
  long bytes_lost = 0;                      ///< dropped by a full receive buffer
  int highest_buffer_fill = 0;
  long starvations = 0;                     ///< standstills in the cut because no line came; looked for in lockstep only
  double starved_seconds = 0;
  std::vector<ProgramSection> timing;
  double stream_seconds = 0;                ///< the wall's
  double removed_mm3 = 0;
  bool digest_matches = false;              ///< the machine executed exactly the lines of the programs, in order
};

/// The arguments of `lightmill machine` for this shop (without the program's name).
std::vector<std::string> machine_arguments(const SimulatedShop& shop, const std::filesystem::path& link, const std::filesystem::path& out);

/// The child's side: serves the machine behind `link` until `should_end()`, then writes OUT/machined.tif, OUT/solid.bin if there
/// is a solid, and OUT/result.json.
void serve_machine(const SimulatedShop& shop, const std::filesystem::path& link, const std::filesystem::path& out,
                   const std::function<bool()>& should_end);

/// Streams all programs in order to the simulated machine, in lockstep or in a child. Streaming stops at the first program that
/// does not end well; that is a fault of the outcome. Throws IoError if the child does not come up.
SimulationOutcome simulate_programs(const SimulatedShop& shop, const std::vector<std::filesystem::path>& programs,
                                    const std::filesystem::path& out, const Monitor& monitor);

/// The same for a control that runs files: no wire, the machine's reader of that dialect and the stock in this process.
SimulationOutcome run_program_files(const SimulatedShop& shop, const std::string& dialect,
                                    const std::vector<std::filesystem::path>& programs, const std::filesystem::path& out,
                                    const Monitor& monitor);

/// "done", "controller error", ...
std::string stream_end_name(StreamEnd end);

}  // namespace lightmill

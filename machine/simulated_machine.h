// A milling machine that exists only in memory: hears bytes, interprets, moves, removes stock.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "cam/blank.h"
#include "cam/cutter.h"
#include "machine/cable.h"
#include "machine/clock.h"
#include "machine/machine_errors.h"
#include "machine/motion.h"
#include "machine/stock_model.h"
#include "postproc/machine_model.h"

namespace lightmill {

/// What the operator has set up at the machine before the program starts; the program's text cannot know it.
struct OperatorSetup {
  std::vector<Cutter> cutters;  ///< the tool magazine, by number
  Blank blank;
  Vec3 workpiece_origin_mm = Vec3::Zero();  ///< where the blank's back centre stands: machine frame, joints at zero
  int work_offset = 54;                     ///< the offset the operator has zeroed on it; the others are zero
  MachineErrors errors{};                   ///< how the true machine differs from its file; cutters as they turn
};

/// Whose manners the control has on the wire.
enum class Personality {
  kGrbl,     ///< grbl 1.1: 128 bytes, 15 blocks, three axes; goes on executing after an error
  kGrblHal,  ///< buffer and blocks of the machine file; an error is latched: all that follows is refused
  // These two take a program as a text; what it means is read by run_programs() (program_run.h).
  kBlockwise,  ///< Heidenhain FE: asks for a program, acknowledges or refuses each block
  kDripFeed,   ///< XON and XOFF around a buffer of the machine file's size; a block every drip_block_s
};

/// "grbl", "grblhal", "fe", "drip"; throws InputError for any other name.
Personality personality(std::string_view name);

/// Faults of a control that acknowledges lines, to plant, each by a count of program lines from 1 since power-on; < 0: never.
/// Those of the line are LineFault (cable.h).
struct PlantedFaults {
  long error_at_line = -1;       ///< the line is answered with error:2 although it is good, and not executed
  long alarm_at_line = -1;       ///< a limit switch closes (ALARM:1)
  long door_at_line = -1;        ///< somebody opens the door
  long reset_at_line = -1;       ///< the controller restarts by itself
  long power_loss_at_line = -1;  ///< the controller dies and the link with it
  long drop_line_at = -1;        ///< the line is lost with its line feed: neither executed nor answered
  bool operator==(const PlantedFaults&) const = default;
};

/// Plants a fault by its name: one of the line (line_fault(), cable.h) or of the control, "reset@400" with a program line
/// or, for the seed to choose, without: error, alarm, door, reset, power-loss, lose-line. Throws InputError.
void plant_fault(std::string_view text, unsigned seed, LineOptions& line, PlantedFaults& control);

struct SimulationOptions {
  Personality personality = Personality::kGrblHal;
  /// 0: as fast as it can, motions take no time; 1: motions take the clock's time; 10: ten times faster.
  double time_factor = 0;
  const Clock* clock = nullptr;  ///< the machine's time; null: the wall's
  StockOptions stock;
  bool remove_stock = true;
  PlantedFaults planted;
  double drip_block_s = 0.01;  ///< kDripFeed: the control takes a block so often
  double least_starvation_s = 1e-3;  ///< of machine time; shorter standstills in the cut are not counted
  /// How far a cutter that stands still in the cut sinks in along its axis (a model, see the README); 0: it leaves no mark.
  double starvation_mark_mm = 1e-3;
};

/// The cutter stood still in the cut because the planner had run empty: a mark on the part.
struct Starvation {
  std::string program;
  long line = 0;                 ///< the last one that was milled
  Vec3 place_mm = Vec3::Zero();  ///< tip, workpiece frame
  double seconds = 0;
};

/// Faults: those of the controller first, then those of the stock, each in order; one "starved" for all starvations.
/// Their `line` counts program lines
/// (neither blank nor `$`, see program_lines.h) since power-on, the last reset or begin_program().
struct SimulationResult {
  long lines = 0;              ///< program lines executed
  double machine_seconds = 0;  ///< at the commanded feeds and the machine's limits
  std::vector<Fault> faults;
  long received_bytes = 0;
  long overflowed_bytes = 0;  ///< dropped because the receive buffer was full
  int highest_buffer_fill = 0;
  std::string received_program;  ///< kBlockwise, kDripFeed: the text as it came, without blank lines
  std::string received_digest;  ///< of all executed lines; equals LineDigest of the programs' lines (program_lines.h)
  JointPosition joints;         ///< where the axes stand
  int tool = 0;                 ///< in the spindle
  bool alarm = false;           ///< locked by an alarm
  long starvations = 0;         ///< only when paced
  double starved_seconds = 0;
  std::vector<Starvation> worst_starvations;  ///< longest first, at most 100
};

/// The whole machine; single-threaded towards its caller. Bytes in, bytes out. Throws InputError for planted faults of a
/// control that takes a program as a text.
class SimulatedMachine {
 public:
  SimulatedMachine(const MachineModel& machine, const OperatorSetup& setup, const SimulationOptions& options);
  ~SimulatedMachine();

  /// Power on, also after a planted loss of it: queues the welcome banner.
  void start();
  /// Bytes from the wire. Real-time bytes act at once; the rest enters the receive buffer, and what does not fit is
  /// lost.
  void receive(std::string_view bytes);
  /// Executes up to `lines` buffered lines; returns how many.
  int work(int lines);
  /// Bytes for the wire since the last call.
  std::string take_replies();
  /// Names the program that comes next in faults and starts its count of lines. Call between programs only.
  void begin_program(const std::string& name);
  /// Motions wait for their time.
  [[nodiscard]] bool busy() const;
  /// When work() is to be called next although nothing is received; kNever: not before something is.
  [[nodiscard]] ClockTime next_event() const;
  /// Removing stock is far behind the motions: work() may soon wait for it. serve() then answers real-time bytes only.
  [[nodiscard]] bool behind() const;
  /// Called for every motion before the stock sees it (for tests and drawings), from work().
  std::function<void(const Motion&, const std::vector<SweptMove>&)> on_motion;

  [[nodiscard]] bool dead() const;  ///< without power by a planted fault
  [[nodiscard]] SimulationResult result() const;
  [[nodiscard]] MachinedSurface machined();
  [[nodiscard]] std::shared_ptr<const SolidStock> solid();  ///< null unless asked for

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Serves the machine behind a pseudo-terminal until `should_end()` is true or the line is dead (then it is hung up).
/// The machine must not be touched from elsewhere meanwhile.
void serve(SimulatedMachine& machine, class PseudoTerminal& terminal, const LineOptions& line,
           const std::function<bool()>& should_end);

}  // namespace lightmill

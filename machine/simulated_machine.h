// A milling machine with grblHAL's protocol that exists only in memory: hears bytes, interprets, moves, removes stock.
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
};

/// Protocol faults to plant, each by a count from 1 since power-on; < 0: never.
struct PlantedFaults {
  long drop_ok_at = -1;       ///< the n-th ok is never sent (those of a sender's greeting count)
  long error_at_line = -1;    ///< the n-th program line is answered with error:2 although it is good, and not executed
  long garble_byte_at = -1;   ///< the n-th received byte has its lowest bit flipped (turns digits into other digits)
  long hang_up_at_line = -1;  ///< at the n-th program line the link goes dead
  long alarm_at_line = -1;    ///< at the n-th program line a limit switch closes (ALARM:1)
  long reset_at_line = -1;    ///< at the n-th program line the controller restarts by itself
  long drop_line_at =
      -1;  ///< the n-th program line is lost on the wire with its line feed: neither executed nor answered
};

struct SimulationOptions {
  double time_factor = 0;  ///< 0: as fast as it can; 1: real time; 10: ten times faster
  int baud = 0;            ///< paces received bytes; 0: not paced
  StockOptions stock;
  bool remove_stock = true;
  PlantedFaults planted;
};

/// Faults: those of the controller first, then those of the stock, each in order. Their `line` counts program lines
/// (neither blank nor `$`, see program_lines.h) since power-on, the last reset or begin_program().
struct SimulationResult {
  long lines = 0;              ///< program lines executed
  double machine_seconds = 0;  ///< at the commanded feeds and the machine's limits
  std::vector<Fault> faults;
  long received_bytes = 0;
  long overflowed_bytes = 0;  ///< dropped because the receive buffer was full
  int highest_buffer_fill = 0;
  std::string received_digest;  ///< of all executed lines; equals LineDigest of the programs' lines (program_lines.h)
  JointPosition joints;         ///< where the axes stand
  int tool = 0;                 ///< in the spindle
  bool alarm = false;           ///< locked by an alarm
};

/// The whole machine; single-threaded towards its caller. Bytes in, bytes out.
class SimulatedMachine {
 public:
  SimulatedMachine(const MachineModel& machine, const OperatorSetup& setup, const SimulationOptions& options);
  ~SimulatedMachine();

  /// Power on: queues the welcome banner.
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
  /// There are bytes on the paced wire or motions that wait for their time.
  [[nodiscard]] bool busy() const;
  /// Removing stock is far behind the motions: work() may soon wait for it. serve() then answers real-time bytes only.
  [[nodiscard]] bool behind() const;
  /// Called for every motion before the stock sees it (for tests and drawings), from work().
  std::function<void(const Motion&, const std::vector<SweptMove>&)> on_motion;

  [[nodiscard]] bool dead() const;  ///< hung up by a planted fault
  [[nodiscard]] SimulationResult result() const;
  [[nodiscard]] MachinedSurface machined();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Serves the machine behind a pseudo-terminal until `should_end()` is true or the machine is dead (then the line is
/// hung up). The machine must not be touched from elsewhere meanwhile.
void serve(SimulatedMachine& machine, class PseudoTerminal& terminal, const std::function<bool()>& should_end);

}  // namespace lightmill

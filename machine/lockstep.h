// A sender and a simulated machine in one process on one virtual clock: the same to the byte, run after run.
#pragma once

#include "machine/cable.h"
#include "machine/connection.h"
#include "machine/simulated_machine.h"

namespace lightmill {

/// The sender's end of a line to a simulated machine. Time passes only while the sender waits: then the machine works,
/// and bytes travel, until something arrives or the deadline has come. The machine must run on the same clock. Machine
/// and clock outlive the link; a new link to the same machine is the cable put in again.
class LockstepLink final : public Connection {
 public:
  LockstepLink(SimulatedMachine& machine, VirtualClock& clock, const LineOptions& line = {});

  std::size_t write_some(std::span<const char> bytes, std::chrono::milliseconds deadline) override;
  std::size_t read_some(std::span<char> buffer, std::chrono::milliseconds deadline) override;
  bool wait(bool for_room, std::chrono::milliseconds deadline) override;
  [[nodiscard]] std::size_t queued() const override { return to_machine_.waiting(); }
  [[nodiscard]] std::string name() const override { return "the simulated line"; }
  [[nodiscard]] const Clock& clock() const override { return clock_; }

  /// Lets the machine work on without the sender, for at most this long.
  void run_for(std::chrono::milliseconds time);
  [[nodiscard]] const Cable& to_machine() const { return to_machine_; }
  [[nodiscard]] const Cable& to_sender() const { return to_sender_; }

 private:
  SimulatedMachine& machine_;
  VirtualClock& clock_;
  Cable to_machine_, to_sender_;
  std::string arrived_;  ///< at the sender, not read yet
  void work();
  void step(ClockTime end);
  void check_plug() const;
};

}  // namespace lightmill

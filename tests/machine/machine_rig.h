// A simulated machine in a thread behind a pseudo-terminal, and a serial connection to it.
#pragma once

#include <unistd.h>

#include <atomic>
#include <memory>
#include <thread>

#include "machine/connection.h"
#include "machine/lockstep.h"
#include "machine/pseudo_terminal.h"
#include "machine/simulated_machine.h"

namespace lightmill::test {

/// Hostile to mix-ups: different travels per axis, pivots off centre and apart, ISO signs.
inline MachineModel skew_machine() {
  MachineModel m;
  m.name = "skew";
  m.x = {-250, 260, 600, 10000};
  m.y = {-120, 130, 500, 10000};
  m.z = {-360, 5, 400, 10000};
  m.outer.letter = 'B';
  m.outer.axis = Vec3::UnitY();
  m.outer.point_mm = {-3, 2, -380};
  m.outer.direction = -1;
  m.outer.min_rad = -110 * kPi / 180;
  m.outer.max_rad = 110 * kPi / 180;
  m.outer.max_speed_rad_per_s = 15;
  m.inner.letter = 'C';
  m.inner.axis = Vec3::UnitZ();
  m.inner.point_mm = {4, -7, -370};
  m.inner.direction = -1;
  m.inner.max_speed_rad_per_s = 25;
  m.table_centre_mm = {4, -7, -420};
  m.table_radius_mm = 100;
  m.min_spindle_rpm = 1000;
  m.max_spindle_rpm = 36000;
  m.spindle_start_s = 8;
  m.controller = "grblhal";
  return m;
}

inline Cutter ball(int number, double length_mm) {
  Cutter c;
  c.name = "ball";
  c.number = number;
  c.diameter_mm = 4;
  c.corner_radius_mm = 2;
  c.flute_length_mm = 6;
  c.shank_diameter_mm = 4;
  c.length_mm = length_mm;
  return c;
}

inline OperatorSetup skew_setup() {
  OperatorSetup setup;
  setup.cutters = {ball(1, 80), ball(3, 85)};
  setup.blank.size_mm = {40, 30};
  setup.blank.height_mm = 12;
  setup.workpiece_origin_mm = {10, -5, -400};
  return setup;
}

inline SimulationOptions no_stock() {
  SimulationOptions options;
  options.remove_stock = false;
  return options;
}

/// What SIGKILL is to a process.
struct Killed {};

/// The sender's clock jumps when so many bytes have been written: a computer that slept, or a clock that somebody set.
class JumpingLink final : public Connection {
 public:
  JumpingLink(Connection& link, long at_byte, std::chrono::hours jump) : link_(link), clock_(link.clock()), at_byte_(at_byte), jump_(jump) {}
  std::size_t write_some(std::span<const char> bytes, std::chrono::milliseconds deadline) override {
    const std::size_t written = link_.write_some(bytes, deadline);
    if ((bytes_ += static_cast<long>(written)) >= at_byte_) clock_.offset = SetClock::kStart + jump_;
    return written;
  }
  std::size_t read_some(std::span<char> buffer, std::chrono::milliseconds deadline) override { return link_.read_some(buffer, deadline); }
  bool wait(bool for_room, std::chrono::milliseconds deadline) override { return link_.wait(for_room, deadline); }
  [[nodiscard]] std::size_t queued() const override { return link_.queued(); }
  [[nodiscard]] std::string name() const override { return link_.name(); }
  [[nodiscard]] const Clock& clock() const override { return clock_; }

 private:
  struct SetClock final : Clock {
    explicit SetClock(const Clock& base) : true_clock(base) {}
    [[nodiscard]] ClockTime now() const override { return true_clock.now() + offset; }
    const Clock& true_clock;
    static constexpr ClockTime kStart = std::chrono::hours(100);  // a jump back stays above 0
    ClockTime offset = kStart;
  };
  Connection& link_;
  SetClock clock_;
  long at_byte_, bytes_ = 0;
  ClockTime jump_;
};

/// A simulated machine and a line to it in lockstep on a virtual clock.
struct Lockstep {
  explicit Lockstep(SimulationOptions options = no_stock(), const LineOptions& line = {},
                    const MachineModel& model = skew_machine(), const OperatorSetup& setup = skew_setup())
      : machine(model, setup, (options.clock = &clock, options)), link(machine, clock, line) {
    machine.start();
  }
  VirtualClock clock;
  SimulatedMachine machine;
  LockstepLink link;
};

class MachineRig {
 public:
  explicit MachineRig(const SimulationOptions& options = no_stock(), LineOptions line = {})
      : machine(skew_machine(), skew_setup(), options),
        terminal(std::make_unique<PseudoTerminal>(std::filesystem::path())),
        line_(std::move(line)) {
    machine.start();
  }
  ~MachineRig() { stop(); }

  void serve_in_thread() {
    thread_ = std::thread([this] { serve(machine, *terminal, line_, [this] { return ending_.load(); }); });
  }
  /// After this the machine may be looked at.
  void stop() {
    ending_ = true;
    if (thread_.joinable()) thread_.join();
  }
  [[nodiscard]] std::unique_ptr<Connection> connect() const { return open_serial(terminal->far_end(), 115200); }

  SimulatedMachine machine;
  std::unique_ptr<PseudoTerminal> terminal;

 private:
  LineOptions line_;
  std::atomic<bool> ending_{false};
  std::thread thread_;
};

}  // namespace lightmill::test

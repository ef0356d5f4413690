// The mill without its control: axes, spindle, tool, the queue of planned motions, the stock. Every personality drives
// this one.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "machine/clock.h"
#include "machine/detail/interpreter.h"
#include "machine/detail/stock_worker.h"
#include "machine/kinematics.h"
#include "machine/simulated_machine.h"

namespace lightmill::detail {

/// Speeds in percent, as the operator has turned them.
struct Overrides {
  int feed = 100, rapid = 100, spindle = 100;
};

class Mill {
 public:
  Mill(const MachineModel& machine, const OperatorSetup& setup, const SimulationOptions& options);

  // --- Motion: planned in order, made when their time has come (at once when not paced) ---

  void plan_move(const Joints& target, double seconds, bool rapid, long line);
  void plan_dwell(double seconds);
  /// Makes the motions whose time has come.
  void advance();
  /// When the motion that runs ends; kNever if none does.
  [[nodiscard]] ClockTime next_event() const;
  [[nodiscard]] bool moving() const { return !planner_.empty(); }
  [[nodiscard]] int planned_blocks() const { return static_cast<int>(planner_.size()); }
  /// The next motion may come when it likes: the program itself makes the mill stand here.
  void expect_standstill() { cut_ended_s_.reset(); }

  /// Stands where it is, with what it has made of the running motion cut.
  void hold();
  void go_on();
  [[nodiscard]] bool held() const { return held_; }
  /// The same, and forgets what is planned.
  void drop_motions();
  void set_overrides(const Overrides& overrides);
  [[nodiscard]] const Overrides& overrides() const { return overrides_; }

  /// What a move would pass and by how much; nothing if it stays within the travels.
  struct Overtravel {
    std::string message;
    double amount = 0;
  };
  [[nodiscard]] std::optional<Overtravel> overtravel(const Joints& target) const;

  // --- Spindle, tool ---

  void turn_spindle(bool clockwise, double rpm);
  void stop_spindle();
  /// As commanded and overridden, within the machine's limits; 0: it stands.
  [[nodiscard]] double rpm() const { return turning_rpm(rpm_); }
  /// Is the cutter (0: none) in the magazine?
  [[nodiscard]] bool has_cutter(int number) const { return number == 0 || find_cutter(number) != nullptr; }
  void change_tool(int number);

  // --- What is known of it ---

  void begin_program(const std::string& name);
  [[nodiscard]] JointPosition joints() const;                       ///< where the axes are, within the running motion too
  [[nodiscard]] const Joints& planned() const { return planned_; }  ///< where they are when all is done
  /// Of all axes along the running motion, mm and degrees alike as in grbl; 0 at rest.
  [[nodiscard]] double feed_per_min() const;
  [[nodiscard]] Vec3 tip_mm();  ///< workpiece frame
  Fault& add_fault(std::string kind, std::string message, long line);
  /// Fills in what the mill knows of a result.
  void add_to(SimulationResult& result) const;

  [[nodiscard]] const MachineModel& machine() const { return machine_; }
  [[nodiscard]] const OperatorSetup& setup() const { return setup_; }
  [[nodiscard]] const SimulationOptions& options() const { return options_; }
  [[nodiscard]] bool paced() const { return options_.time_factor > 0; }
  [[nodiscard]] const Clock& clock() const { return *clock_; }
  StockWorker* stock() { return stock_.get(); }
  std::function<void(const Motion&, const std::vector<SweptMove>&)> on_motion;

 private:
  struct Planned {
    Motion motion;
    bool dwell = false;
    double least_s = 0;            ///< at the axes' speeds
    std::vector<SweptMove> swept;  ///< what the cutter has still to sweep of an interrupted motion; empty: not interrupted
  };

  MachineModel machine_;
  OperatorSetup setup_;
  SimulationOptions options_;
  const Clock* clock_;
  WorkpieceView view_;
  std::unique_ptr<StockWorker> stock_;

  JointPosition joints_;  ///< at the end of what has been made
  Joints planned_{};
  const Cutter* tool_ = nullptr;
  int tool_number_ = 0;
  bool spindle_clockwise_ = false;
  double rpm_ = 0;  ///< as commanded
  double at_speed_s_ = 0;  ///< machine time at which the spindle has reached its speed
  double machine_seconds_ = 0;
  double stood_s_ = 0;  ///< dwell since the last motion
  std::vector<SweptMove> pieces_;
  std::vector<Fault> faults_;
  std::string program_;
  bool told_no_tool_ = false;

  std::deque<Planned> planner_;
  double head_start_s_ = 0;  ///< machine clock: the first of planner_ began
  bool held_ = false;
  Overrides overrides_;

  std::optional<double> cut_ended_s_;  ///< machine clock: the last motion was a cut, and nothing has followed it
  long cut_line_ = 0;
  long starvations_ = 0;
  double starved_seconds_ = 0;
  std::vector<Starvation> worst_starvations_;

  [[nodiscard]] double clock_s() const;
  [[nodiscard]] double duration(const Planned& planned) const;
  [[nodiscard]] double running_share() const;
  [[nodiscard]] double turning_rpm(double commanded) const;
  [[nodiscard]] double least_seconds(const Joints& from, const Joints& to) const;
  [[nodiscard]] const Cutter* find_cutter(int number) const;
  void add(Planned planned);
  void perform(const Planned& done, double seconds);
  void sweep(const Motion& motion, std::vector<SweptMove>& pieces);
  void make_running_part();
  void note_starvation(double from_s, double until_s);
  void leave_mark();
};

}  // namespace lightmill::detail

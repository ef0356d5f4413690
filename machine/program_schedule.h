// When each line of a program is due by the times of the dry run, and how long the rest takes at the pace that is seen.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "machine/simulated_machine.h"

namespace lightmill {

/// Machine time with look-ahead, accelerations and dwells (MotionTimer), from the program's beginning.
struct ProgramSchedule {
  std::vector<double> until_s;  ///< by line of program_lines(): when it is carried out

  [[nodiscard]] double total_s() const { return until_s.empty() ? 0 : until_s.back(); }
  /// When the first `lines` lines are carried out.
  [[nodiscard]] double at(long lines) const;
};

/// Runs the program without stock, as `dialect` ("grblhal" or a reader's) means it. Lines behind one that is not understood take no time.
ProgramSchedule schedule_program(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                                 std::string_view program);

/// Learns how many seconds a scheduled second takes: overrides, a slow line, a control slower than its model. What is
/// further back counts less and less, and in the beginning the schedule is believed.
class PaceEstimate {
 public:
  /// `scheduled_s` of the schedule are done at `now_s`. Time in which the machine is not `moving` (held, waiting for somebody) says nothing.
  void observe(double scheduled_s, double now_s, bool moving);
  [[nodiscard]] double factor() const { return actual_s_ / scheduled_s_; }

 private:
  static constexpr double kBelief_s = 30;   ///< of the schedule that is taken for seen at the start
  static constexpr double kMemory_s = 300;  ///< what is so old counts 1/e
  double actual_s_ = kBelief_s, scheduled_s_ = kBelief_s;
  double last_scheduled_s_ = 0, last_now_s_ = 0;
  bool begun_ = false;
};

}  // namespace lightmill

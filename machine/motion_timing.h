// How long a control takes for a program's motions: it looks ahead over its queue of blocks and keeps every axis within its
// speed, acceleration and jerk.
#pragma once

#include <array>
#include <functional>
#include <vector>

#include "machine/motion.h"

namespace lightmill {

/// What decides a control's times beside its axes.
struct ControlRules {
  int queue_blocks = 100;             ///< it can always stop at the end of the last block it holds
  double block_s = 0;                 ///< no block is quicker
  double corner_tolerance_mm = 0.01;  ///< how far the tip may leave a corner, unless the program says; 0: stops there
  bool stops_beside_rotary = false;   ///< stands between blocks of which one turns a rotary axis (LinuxCNC)
};
ControlRules control_rules(const MachineModel& machine);

/// A motion as it is made. The path's length and speed are those of all axes together, mm and degrees, as in grbl.
struct TimedBlock {
  Motion motion;                        ///< `seconds` as commanded
  int program = 0;                      ///< as SectionTiming counts them
  double seconds = 0;                   ///< as made
  double tip_mm = 0;                    ///< the tip's way over the work
  double length = 0;
  std::array<double, 5> per_length{};   ///< X, Y, Z, outer, inner; mm and rad per unit of length
  double acceleration = 0;              ///< along the path
  double entry = 0, top = 0, exit = 0;  ///< speeds
  /// Half the time in which the axes change over to the next block's direction, before its entry and after its exit; the
  /// path's speed stays meanwhile.
  double entry_blend_s = 0, exit_blend_s = 0;
};

struct MotionTiming {
  long blocks = 0;
  long stops = 0;                ///< between feed moves
  double seconds = 0;            ///< dwells included
  double commanded_seconds = 0;  ///< at the programmed feeds and the axes' speeds, as if nothing had mass
  double feed_seconds = 0;       ///< of the feed moves
  double commanded_feed_seconds = 0;
  double feed_mm = 0;                             ///< the tip's way in feed moves
  double slow_seconds = 0;                        ///< in feed moves made at less than half of the commanded speed
  long slow_line = 0;                             ///< where the longest run of such moves begins
  double slow_line_seconds = 0;                   ///< and how long it is
  double slow_line_mm = 0;
  std::array<double, 5> top_speed{};              ///< used; mm/s and rad/s
  std::array<double, 5> top_acceleration{};       ///< used, without jerk limits
  void add(const MotionTiming& other);
};

/// Of the motions of one tool in one program.
struct SectionTiming {
  long line = 0;  ///< of its first motion
  int program = 0;
  int tool = 0;
  MotionTiming timing;
};

/// Motions go in as they are executed; each with a length, or behind a dwell, comes out of on_block once what follows is known.
///
/// The path's speed rises and falls at the constant acceleration that the slowest axis allows in the block's direction. At a
/// corner the axes change from one direction to the next in the time tau = speed * max(|change| / acceleration), half of
/// it in either block; the tip's path becomes a parabola that leaves the corner by |change of the tip's speed| * tau / 8,
/// which the tolerance limits. So no axis ever exceeds its acceleration. Jerk: all axes' places are averaged over a window
/// of twice the longest acceleration / jerk of an axis (from full thrust to full braking), as controls smooth their
/// setpoints; that delays every stop by the window and rounds corners by |change of the tip's speed| * window / 8.
class MotionTimer {
 public:
  explicit MotionTimer(const MachineModel& machine);
  MotionTimer(const MachineModel& machine, const ControlRules& rules);

  /// `from`, `to`: tip and axis at the motion's first and last piece, for corners of moves that turn.
  void move(const Motion& motion, const SweptMove& first, const SweptMove& last);
  /// The machine stands where it is and another program begins.
  void begin_program();
  void finish();
  [[nodiscard]] const std::vector<SectionTiming>& sections() const { return sections_; }
  [[nodiscard]] double smoothing_s() const { return smoothing_s_; }
  std::function<void(const TimedBlock&)> on_block;

 private:
  struct Corner {
    double most2 = 0;   ///< square of the highest speed
    double s_per_speed = 0;  ///< tau / speed
  };
  struct Block {
    TimedBlock made;
    Vec3 tip_first, tip_last;  ///< the tip's way per unit of length where the block begins and ends
    double nominal = 0;        ///< commanded speed
    Corner corner;             ///< where it begins
    double entry2 = 0;         ///< square of the speed there
    int section = 0;
    double slowing = 0;        ///< sum of 2 a l up to its beginning
  };
  void stand();
  [[nodiscard]] Corner corner_between(const Block& before, const Block& after) const;
  void settle(bool all);
  void pass_on(Block& block, double exit2, double exit_blend);
  void end_slow_run();

  std::array<double, 5> top_speed_{}, top_acceleration_{};
  ControlRules rules_;
  double smoothing_s_ = 0;
  std::vector<Block> waiting_;
  double settled_entry2_ = 0;  ///< of the first of `waiting_`
  bool standing_ = true;
  bool new_section_ = true;
  int program_ = 0;
  Motion last_;
  std::vector<SectionTiming> sections_;
  struct SlowRun {
    int section = 0;
    long line = 0;
    double seconds = 0, mm = 0;
  } slow_run_;
};

}  // namespace lightmill

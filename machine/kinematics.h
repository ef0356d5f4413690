// Forward kinematics of the simulated machine: from joints to the cutter in the workpiece frame.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "machine/machine_errors.h"
#include "machine/motion.h"

namespace lightmill {

/// How finely moves in which the table turns are cut: the tip keeps its straight line and the axis turns little per
/// piece.
struct SweepTolerance {
  double tip_mm = 5e-5;               ///< of a piece's middle from its chord
  double axis_rad = 0.5 * kPi / 180;  ///< turn of the axis in one piece
};

/// Controls refuse a block that turns a rotary axis further: its pieces would take all memory.
inline constexpr double kMostTurn_rad = 1000 * 2 * kPi;

/// The axes' places in the order of readers and interpreters: X, Y, Z, outer, inner.
inline JointPosition to_position(const std::array<double, 5>& axes) {
  return {axes[0], axes[1], axes[2], axes[3], axes[4]};
}
inline std::array<double, 5> to_joints(const JointPosition& j) {
  return {j.x_mm, j.y_mm, j.z_mm, j.outer_rad, j.inner_rad};
}

/// Where the cutter stands over the work, for every chain of the machine file. It follows what each rotary axis carries: a
/// table's axis turns the workpiece, a head's axis the cutter, by direction * angle (Rodrigues' formula about the axis
/// as it lies in the machine file); then the cutter is looked at from the turned workpiece. Written from the machine file's data alone; it shares nothing with the post. Not
/// thread safe (keeps the last turns).
class WorkpieceView {
 public:
  /// `workpiece_origin_mm`: where the workpiece frame's origin stands, machine frame, all joints at zero (axes
  /// parallel).
  WorkpieceView(const MachineModel& machine, const Vec3& workpiece_origin_mm);
  /// The same for a machine with errors, which sweep() follows through the motions in their order: lost motion, drift and
  /// vibration have a history.
  WorkpieceView(const MachineModel& machine, const Vec3& workpiece_origin_mm, const MachineErrors& errors);

  /// Tip and axis in the workpiece frame for a cutter that reaches `length_mm` below the gauge point.
  ToolPose cutter(const JointPosition& joints, double length_mm);

  /// Where the axes must stand for the tip to be at `tip_mm` of the workpiece frame with the rotary axes as given.
  JointPosition joints(const Vec3& tip_mm, double outer_rad, double inner_rad, double length_mm);

  /// Appends the pieces of a straight joint move (fields line, rapid, spindle_on from `motion`, seconds shared out
  /// evenly).
  void sweep(const Motion& motion, double length_mm, const SweepTolerance& tolerance, std::vector<SweptMove>& pieces);

 private:
  struct Turn {
    Vec3 axis, point;
    double direction;
    [[nodiscard]] Eigen::Matrix3d matrix(double angle_rad) const;
  };
  Turn outer_, inner_;
  Vec3 origin_;
  double outer_rad_ = 0, inner_rad_ = 0;  ///< of the turns below
  Chain chain_;
  Eigen::Matrix3d to_work_;  ///< p_W = to_work_ * p_M + shift_
  Vec3 shift_;
  Vec3 spindle_, head_shift_;  ///< of the turned head: tip - gauge point = head_shift_ - length * spindle_
  void turn(double outer_rad, double inner_rad);

  // What the errors have made of the machine so far.
  using Axes = std::array<double, 5>;
  DrawnErrors errors_;
  bool erring_ = false;
  double elapsed_s_ = 0;
  Axes followed_{};        ///< where the axes are, lost motion included
  bool has_moved_ = false;
  [[nodiscard]] Axes play() const;
  JointPosition erred(const JointPosition& commanded, double length_mm);
  [[nodiscard]] std::vector<double> shares(const Motion& motion, int count) const;
};

}  // namespace lightmill

#include "machine/kinematics.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace lightmill {

namespace {

JointPosition between(const JointPosition& a, const JointPosition& b, double t) {
  return {a.x_mm + t * (b.x_mm - a.x_mm), a.y_mm + t * (b.y_mm - a.y_mm), a.z_mm + t * (b.z_mm - a.z_mm),
          a.outer_rad + t * (b.outer_rad - a.outer_rad), a.inner_rad + t * (b.inner_rad - a.inner_rad)};
}

/// Angle between unit vectors; atan2 keeps small angles exact where acos would lose them.
double angle_between(const Vec3& a, const Vec3& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

}  // namespace

Eigen::Matrix3d WorkpieceView::Turn::matrix(double angle_rad) const {
  // Rodrigues: v cos + (k x v) sin + k (k.v)(1 - cos), column by column.
  const double a = direction * angle_rad, c = std::cos(a), s = std::sin(a);
  Eigen::Matrix3d R;
  for (int i = 0; i < 3; ++i) {
    const Vec3 v = Vec3::Unit(i);
    R.col(i) = v * c + axis.cross(v) * s + axis * (axis.dot(v) * (1 - c));
  }
  return R;
}

WorkpieceView::WorkpieceView(const MachineModel& machine, const Vec3& workpiece_origin_mm)
    : WorkpieceView(machine, workpiece_origin_mm, {}) {}

WorkpieceView::WorkpieceView(const MachineModel& machine, const Vec3& workpiece_origin_mm, const MachineErrors& errors)
    : outer_{machine.outer.axis.normalized(), machine.outer.point_mm, machine.outer.direction},
      inner_{machine.inner.axis.normalized(), machine.inner.point_mm, machine.inner.direction},
      origin_(workpiece_origin_mm),
      chain_(machine.chain),
      errors_(drawn(errors)),
      erring_(errors.moves_the_tip()) {
  outer_.point += errors_.errors.outer_pivot_mm;
  inner_.point += errors_.errors.inner_pivot_mm;
  turn(0, 0);
}

WorkpieceView::Axes WorkpieceView::play() const {
  const MachineErrors& e = errors_.errors;
  return {e.backlash_mm.x(), e.backlash_mm.y(), e.backlash_mm.z(), e.outer_backlash_rad, e.inner_backlash_rad};
}

/// Where the axes really go, at elapsed_s_: each follows its drive once the play is taken up.
JointPosition WorkpieceView::erred(const JointPosition& commanded, double length_mm) {
  const MachineErrors& e = errors_.errors;
  Axes q{commanded.x_mm, commanded.y_mm, commanded.z_mm, commanded.outer_rad, commanded.inner_rad};
  const Axes lost = play();
  for (std::size_t i = 0; i < 5; ++i) {
    q[i] = has_moved_ ? std::clamp(followed_[i], q[i] - lost[i] / 2, q[i] + lost[i] / 2) : q[i];
  }
  followed_ = q;
  has_moved_ = true;
  // From where the workpiece was zeroed.
  const Vec3 from = Vec3(q[0], q[1], q[2] - length_mm) - origin_;
  Vec3 off = e.scale.cwiseProduct(from);
  off.x() += e.squareness_rad[0] * from.y() + e.squareness_rad[1] * from.z();
  off.y() += e.squareness_rad[2] * from.z();
  off += e.drift_mm * -std::expm1(-elapsed_s_ / (3600 * e.drift_hours));
  off += e.vibration_mm * std::sin(2 * kPi * e.vibration_hz * elapsed_s_ + errors_.phase_rad);
  return {q[0] + off.x(), q[1] + off.y(), q[2] + off.z(), q[3], q[4]};
}

/// Where a motion of at least `count` pieces is cut: evenly, as finely as a vibration asks for, and where an axis has taken
/// up its play.
std::vector<double> WorkpieceView::shares(const Motion& motion, int count) const {
  constexpr double kPiecesPerPeriod = 12;
  constexpr double kMostPieces = 100000;
  if (!errors_.errors.vibration_mm.isZero(0)) {
    count = static_cast<int>(std::min(kMostPieces, std::max<double>(count, std::ceil(motion.seconds * errors_.errors.vibration_hz * kPiecesPerPeriod))));
  }
  std::vector<double> cuts;
  for (int i = 1; i <= count; ++i) cuts.push_back(i == count ? 1 : static_cast<double>(i) / count);
  const Axes lost = play();
  const Axes a{motion.from.x_mm, motion.from.y_mm, motion.from.z_mm, motion.from.outer_rad, motion.from.inner_rad};
  const Axes b{motion.to.x_mm, motion.to.y_mm, motion.to.z_mm, motion.to.outer_rad, motion.to.inner_rad};
  for (std::size_t i = 0; i < 5; ++i) {
    const double way = b[i] - a[i];
    if (lost[i] == 0 || way == 0 || !has_moved_) continue;
    const double taken_up = (followed_[i] + (way > 0 ? lost[i] : -lost[i]) / 2 - a[i]) / way;
    if (taken_up > 1e-9 && taken_up < 1 - 1e-9) cuts.push_back(taken_up);
  }
  std::sort(cuts.begin(), cuts.end());
  return cuts;
}

void WorkpieceView::turn(double outer_rad, double inner_rad) {
  outer_rad_ = outer_rad;
  inner_rad_ = inner_rad;
  to_work_.setIdentity();
  shift_ = -origin_;
  spindle_ = Vec3::UnitZ();
  head_shift_.setZero();
  if (chain_ == Chain::kThreeAxis) return;
  const Eigen::Matrix3d Ro = outer_.matrix(outer_rad), Ri = inner_.matrix(inner_rad);
  const Vec3 &P = outer_.point, &Q = inner_.point;
  switch (chain_) {
    case Chain::kThreeAxis:
      return;
    case Chain::kTableTable:
      // A point fixed to the table at m (joints zero) stands at P + Ro (Q + Ri (m - Q) - P). Looking back from the
      // machine: m = Q + Ri^T (P + Ro^T (p_M - P) - Q), and p_W = m - origin.
      to_work_ = Ri.transpose() * Ro.transpose();
      shift_ = Q + Ri.transpose() * (P - Ro.transpose() * P - Q) - origin_;
      return;
    case Chain::kHeadTable:
      // On the head, seen from the gauge point, v goes to P + Ro (v - P); m on the table to Q + Ri (m - Q).
      spindle_ = Ro.col(2);
      head_shift_ = P - Ro * P;
      to_work_ = Ri.transpose();
      shift_ = Q - Ri.transpose() * Q - origin_;
      return;
    case Chain::kHeadHead:
      // The inner axis turns the outer one with all that it carries: v goes to Q + Ri (P + Ro (v - P) - Q).
      spindle_ = Ri * Ro.col(2);
      head_shift_ = Q + Ri * (P - Ro * P - Q);
      return;
  }
}

ToolPose WorkpieceView::cutter(const JointPosition& joints, double length_mm) {
  if (joints.outer_rad != outer_rad_ || joints.inner_rad != inner_rad_) turn(joints.outer_rad, joints.inner_rad);
  const Vec3 tip_M = Vec3(joints.x_mm, joints.y_mm, joints.z_mm) + head_shift_ - length_mm * spindle_;
  return {to_work_ * tip_M + shift_, to_work_ * spindle_};
}

JointPosition WorkpieceView::joints(const Vec3& tip_mm, double outer_rad, double inner_rad, double length_mm) {
  if (outer_rad != outer_rad_ || inner_rad != inner_rad_) turn(outer_rad, inner_rad);
  const Vec3 gauge_M = to_work_.transpose() * (tip_mm - shift_) - head_shift_ + length_mm * spindle_;
  return {gauge_M.x(), gauge_M.y(), gauge_M.z(), outer_rad, inner_rad};
}

void WorkpieceView::sweep(const Motion& motion, double length_mm, const SweepTolerance& tolerance,
                          std::vector<SweptMove>& pieces) {
  const JointPosition &a = motion.from, &b = motion.to;
  const double turn = std::abs(b.outer_rad - a.outer_rad) + std::abs(b.inner_rad - a.inner_rad);
  int count = 1;
  if (turn > 0) {
    // Chunks of at most 5 degrees, on which the middle's distance from the chord is the greatest
    // and falls with the square of the count of pieces.
    const int chunks = std::max(1, static_cast<int>(std::ceil(turn / (5 * kPi / 180))));
    double pieces_per_chunk = 1;
    ToolPose start = cutter(a, length_mm);
    for (int i = 0; i < chunks; ++i) {
      const ToolPose middle = cutter(between(a, b, (i + 0.5) / chunks), length_mm);
      const ToolPose end = cutter(between(a, b, (i + 1.0) / chunks), length_mm);
      const double deviation = (middle.tip_mm - (start.tip_mm + end.tip_mm) / 2).norm();
      const double tilt = angle_between(start.axis, middle.axis) + angle_between(middle.axis, end.axis);
      pieces_per_chunk = std::max(
          {pieces_per_chunk, std::sqrt(deviation / (0.9 * tolerance.tip_mm)), 1.05 * tilt / tolerance.axis_rad});
      start = end;
    }
    count = chunks * static_cast<int>(std::ceil(pieces_per_chunk));
  }

  SweptMove piece;
  piece.line = motion.line;
  piece.rapid = motion.rapid;
  piece.spindle_on = motion.spindle_on;
  piece.spindle_rpm = motion.spindle_rpm;
  if (erring_) {
    elapsed_s_ += motion.stood_s;
    piece.from = cutter(erred(a, length_mm), length_mm);
    const double begin_s = elapsed_s_;
    double before = 0;
    for (const double share : shares(motion, count)) {
      elapsed_s_ = begin_s + share * motion.seconds;
      piece.seconds = (share - before) * motion.seconds;
      piece.to = cutter(erred(between(a, b, share), length_mm), length_mm);
      pieces.push_back(piece);
      piece.from = piece.to;
      before = share;
    }
    return;
  }
  piece.seconds = motion.seconds / count;
  piece.from = cutter(a, length_mm);
  for (int i = 1; i <= count; ++i) {
    piece.to = cutter(i == count ? b : between(a, b, static_cast<double>(i) / count), length_mm);
    pieces.push_back(piece);
    piece.from = piece.to;
  }
}

}  // namespace lightmill

// Machines and small tool paths for the tests of this room, and a second opinion on the kinematics.
#pragma once

#include <rapidcheck.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>

#include "postproc/axis_motion.h"

namespace lightmill::test {

inline constexpr double kDeg = kPi / 180;

/// A random number evenly from [least, most], at every size of RapidCheck's.
inline double real(double least, double most) {
  return least + (most - least) * *rc::gen::resize(rc::kNominalSize, rc::gen::inRange(0, 1000001)) / 1e6;
}

inline MachineModel fixture_machine() {
  return read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/hsm400u_grblhal.toml");
}

/// The fixture with pivots that meet nowhere and lie off every plane of symmetry.
inline MachineModel hostile_machine() {
  MachineModel machine = fixture_machine();
  machine.outer.point_mm = {7.3, -3.1, -371.7};
  machine.inner.point_mm = {-4.9, 11.7, -390.2};
  return machine;
}

/// The chain of turns written out with rotation matrices for a B/C trunnion: where the tip of a tool at these joints
/// is in the workpiece frame, and the tool's axis there. Shares nothing with the code under test.
inline ToolPose pose_by_matrices(const MachineModel& m, const Vec3& origin, double length, const JointPosition& j) {
  const double b = m.outer.direction * j.outer_rad, c = m.inner.direction * j.inner_rad;
  Eigen::Matrix3d ry, rz;
  ry << std::cos(b), 0, std::sin(b), 0, 1, 0, -std::sin(b), 0, std::cos(b);
  rz << std::cos(c), -std::sin(c), 0, std::sin(c), std::cos(c), 0, 0, 0, 1;
  const Vec3 P = m.outer.point_mm, Q = m.inner.point_mm;
  const Vec3 tip(j.x_mm, j.y_mm, j.z_mm - length);
  return {Q + rz.transpose() * (P + ry.transpose() * (tip - P) - Q) - origin, (ry * rz).transpose() * Vec3::UnitZ()};
}

inline Cutter ball() {
  Cutter cutter;
  cutter.name = "4 mm ball";
  cutter.number = 3;
  cutter.diameter_mm = 4;
  cutter.corner_radius_mm = 2;
  cutter.flute_length_mm = 6;
  cutter.length_mm = 85;
  cutter.holder = {{32, 50, 8, 12}, {50, 85, 14, 25}};
  cutter.spindle_rpm = 36000;
  cutter.coolant = "air";
  cutter.source = "test";
  return cutter;
}

inline ToolPath empty_path(double clearance_z_mm) {
  ToolPath path;
  path.pass = "finish";
  path.cutter = ball();
  path.spindle_rpm = 36000;
  path.clearance_z_mm = clearance_z_mm;
  return path;
}

inline Vec3 direction(double tilt_rad, double azimuth_rad) {
  return {std::sin(tilt_rad) * std::cos(azimuth_rad), std::sin(tilt_rad) * std::sin(azimuth_rad), std::cos(tilt_rad)};
}

/// One-way rows over a wavy height field at one axis, each entered and left by rapids above it: a small 3+2 finish.
inline ToolPath fixed_rows(double tilt_rad, double azimuth_rad, int rows, int points, double size_mm = 30) {
  ToolPath path = empty_path(25);
  const Vec3 axis = direction(tilt_rad, azimuth_rad);
  for (int r = 0; r < rows; ++r) {
    const double y = size_mm * (rows > 1 ? double(r) / (rows - 1) - 0.5 : 0);
    const auto at = [&](double s) {
      const double x = size_mm * (s - 0.5);
      return Vec3(x, y, 12 + std::sin(x / 7) + std::cos(y / 5));
    };
    const Vec3 above(0, 0, 20);
    path.moves.push_back({{at(0) + above, axis}, MoveKind::kRapid, 0});
    path.moves.push_back({{at(0) + Vec3(0, 0, 3), axis}, MoveKind::kLink, 80});
    path.moves.push_back({{at(0), axis}, MoveKind::kPlunge, 5});
    for (int p = 1; p <= points; ++p) path.moves.push_back({{at(double(p) / points), axis}, MoveKind::kCut, 18});
    path.moves.push_back({{at(1) + above, axis}, MoveKind::kLink, 80});
    path.moves.push_back({{at(1) + 1.2 * above, axis}, MoveKind::kRapid, 0});
  }
  return path;
}

/// Lead/tilt finishing of a dome off the rotary centres: the axis leans `lead_rad` from the surface's normal along the
/// pass.
inline ToolPath lead_rows(double lead_rad, int rows, int points, double size_mm = 30) {
  ToolPath path = empty_path(25);
  for (int r = 0; r < rows; ++r) {
    const double y = size_mm * (rows > 1 ? double(r) / (rows - 1) - 0.5 : 0.1);
    const auto pose = [&](double s) {
      const double x = size_mm * (s - 0.5);
      const double h = 12 - x * x / 120 - y * y / 90;
      const Vec3 normal = Vec3(x / 60, y / 45, 1).normalized();
      const Vec3 along = (Vec3(1, 0, -x / 60) - Vec3(1, 0, -x / 60).dot(normal) * normal).normalized();
      const Vec3 axis = std::cos(lead_rad) * normal + std::sin(lead_rad) * along;
      const Vec3 centre = Vec3(x, y, h) + 2 * normal;
      return ToolPose{centre - 2 * axis, axis};
    };
    const ToolPose start = pose(0), end = pose(1);
    if (r == 0) path.moves.push_back({{start.tip_mm + Vec3(0, 0, 24), start.axis}, MoveKind::kRapid, 0});
    if (r > 0) path.moves.push_back({{start.tip_mm + Vec3(0, 0, 24), start.axis}, MoveKind::kLink, 80});
    path.moves.push_back({start, MoveKind::kPlunge, 5});
    for (int p = 1; p <= points; ++p) path.moves.push_back({pose(double(p) / points), MoveKind::kCut, 18});
    path.moves.push_back({{end.tip_mm + Vec3(0, 0, 24), end.axis}, MoveKind::kLink, 80});
    path.moves.push_back({{end.tip_mm + Vec3(0, 0, 28), end.axis}, MoveKind::kRapid, 0});
  }
  return path;
}

/// A cone cut round and round with the axis leaning outwards; with_rapids: lifted off after every turn.
inline ToolPath circling(int turns, int points_per_turn, bool with_rapids) {
  ToolPath path = empty_path(25);
  for (int i = 0; i <= turns * points_per_turn; ++i) {
    const double angle = 2 * kPi * i / points_per_turn;
    const ToolPose pose{{10 * std::cos(angle), 10 * std::sin(angle), 12}, direction(0.4, angle + 0.5)};
    const auto above = [&](double by) { return ToolPose{pose.tip_mm + Vec3(0, 0, by), pose.axis}; };
    if (i == 0) path.moves.push_back({above(20), MoveKind::kRapid, 0});
    path.moves.push_back({pose, MoveKind::kCut, 20});
    if (with_rapids && i > 0 && i % points_per_turn == 0) {
      path.moves.push_back({above(20), MoveKind::kLink, 80});
      path.moves.push_back({above(25), MoveKind::kRapid, 0});
      path.moves.push_back({pose, MoveKind::kPlunge, 20});
    }
  }
  return path;
}

}  // namespace lightmill::test

// A milling machine as plain data, read from its TOML file; the simulated machine reads the same data with its own mathematics.
#pragma once

#include <filesystem>
#include <limits>
#include <string>

#include "design/core/geometry.h"

namespace lightmill {

struct LinearAxis {
  double min_mm = 0;                 ///< travel in machine coordinates
  double max_mm = 0;
  double max_speed_mm_per_s = 0;
  double acceleration_mm_per_s2 = 0;
};

/// A rotary axis of the table. Programmed angle q turns the table physically by direction * q, right-handed about `axis`.
struct RotaryAxis {
  char letter = 'C';
  Vec3 axis = Vec3::UnitZ();         ///< unit, machine frame, all joints at zero
  Vec3 point_mm = Vec3::Zero();      ///< a point on the axis of rotation, machine frame, all joints at zero
  double direction = -1;             ///< -1: ISO 841 (the letter names the tool's motion relative to the work); +1: the table's
  double min_rad = -std::numeric_limits<double>::infinity();
  double max_rad = std::numeric_limits<double>::infinity();
  double max_speed_rad_per_s = 0;
  double acceleration_rad_per_s2 = 0;
};

/// Table/table trunnion: X, Y, Z move the spindle, the outer rotary axis carries the inner one, which carries the work.
/// Machine coordinates X, Y, Z are those of the spindle's gauge point (nose centre); the tip is `length` below it on -Z.
struct MachineModel {
  std::string name;
  std::string notes;                 ///< what is unverified
  LinearAxis x, y, z;
  RotaryAxis outer, inner;           ///< B (tilt about Y) and C (table about Z) on a B/C trunnion
  Vec3 table_centre_mm = Vec3::Zero();  ///< centre of the table's top, machine frame, all joints at zero
  double table_radius_mm = 0;
  double retract_z_mm = 0;           ///< machine-top Z that clears everything whatever the rotary axes do
  Vec3 tool_change_mm = Vec3::Zero();
  double max_tool_length_mm = 0;
  double min_spindle_rpm = 0;
  double max_spindle_rpm = 0;
  double spindle_start_s = 0;        ///< dwell until the spindle is at speed
  // Controller.
  std::string controller;            ///< "grblhal"
  int receive_buffer_bytes = 1024;
  int planner_blocks = 100;
  double min_block_s = 0;
};

/// Throws InputError naming file, line, key and rule (limits the wrong way round, a zero axis, parallel rotary axes...).
MachineModel read_machine(const std::filesystem::path& path);

/// Where the machine's axes stand. Not to be mixed up with a ToolPose.
struct JointPosition {
  double x_mm = 0, y_mm = 0, z_mm = 0;
  double outer_rad = 0, inner_rad = 0;   ///< as programmed (B, C)
};

}  // namespace lightmill

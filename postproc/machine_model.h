// A milling machine as plain data, read from its TOML file; the simulated machine reads the same data with its own mathematics.
#pragma once

#include <filesystem>
#include <limits>
#include <optional>
#include <string>

#include "design/core/geometry.h"

namespace lightmill {

struct LinearAxis {
  double min_mm = 0;                 ///< travel in machine coordinates
  double max_mm = 0;
  double max_speed_mm_per_s = 0;
  double acceleration_mm_per_s2 = 0;
  double jerk_mm_per_s3 = 0;         ///< 0: not limited or not known
};

/// A rotary axis of the table or of the head. Programmed angle q turns what the axis carries physically by direction * q,
/// right-handed about `axis`.
struct RotaryAxis {
  char letter = 'C';
  bool on_head = false;              ///< carries the tool; otherwise the work
  Vec3 axis = Vec3::UnitZ();         ///< unit, machine frame, all joints at zero; as measured
  Vec3 point_mm = Vec3::Zero();      ///< a point on the axis, all joints at zero: of a table axis in the machine frame, of a
                                     ///< head axis from the spindle's gauge point, with which it travels
  double direction = -1;             ///< ISO 841 (the letter names the tool's turn relative to the work): -1 on a table, +1 on a head
  double min_rad = -std::numeric_limits<double>::infinity();
  double max_rad = std::numeric_limits<double>::infinity();
  double max_speed_rad_per_s = 0;
  double acceleration_rad_per_s2 = 0;
  double jerk_rad_per_s3 = 0;
};

/// Which body each rotary axis turns.
enum class Chain {
  kThreeAxis,   ///< no rotary axis
  kTableTable,  ///< the outer axis carries the inner one, which carries the work
  kHeadTable,   ///< the outer axis carries the tool, the inner one the work
  kHeadHead,    ///< the inner axis carries the outer one, which carries the tool
};

/// X, Y, Z move the spindle. In the chain from the tool over the machine's bed to the work the `outer` axis comes first, the
/// `inner` one last, so that the pole, where the inner angle is free, is the tool parallel to the inner axis on every chain.
/// Machine coordinates X, Y, Z are those of the spindle's gauge point (nose centre) with the head's axes at zero; the tip is
/// then `length` below it on -Z.
struct MachineModel {
  std::string name;
  std::string notes;                 ///< what is unverified
  Chain chain = Chain::kTableTable;
  bool simultaneous = true;          ///< false: 3+2, the rotary axes stand while a tool cuts
  LinearAxis x, y, z;
  RotaryAxis outer, inner;           ///< B (tilt about Y) and C (table about Z) on a B/C trunnion; unused on three axes
  Vec3 table_centre_mm = Vec3::Zero();  ///< centre of the table's top, machine frame, all joints at zero
  double table_radius_mm = 0;
  double retract_z_mm = 0;           ///< machine-top Z that clears everything whatever the rotary axes do
  Vec3 tool_change_mm = Vec3::Zero();
  std::optional<Vec2> park_mm;       ///< X and Y at the machine's top where a program ends; empty: where it stands
  double max_tool_length_mm = 0;
  double spindle_nose_radius_mm = 0; ///< of the body above the gauge line; 0: not known, not checked
  double spindle_nose_length_mm = 0; ///< how far up it reaches
  double min_spindle_rpm = 0;
  double max_spindle_rpm = 0;
  double spindle_start_s = 0;        ///< dwell until the spindle is at speed
  // Controller.
  std::string controller = "grblhal";  ///< "grblhal", "linuxcnc", "heidenhain", "heidenhain_iso", "fanuc", "siemens"
  bool has_tcp = false;              ///< tool-centre-point control is installed
  int receive_buffer_bytes = 1024;
  int planner_blocks = 100;
  double min_block_s = 0;            ///< block processing time
  double corner_tolerance_mm = 0.01; ///< how far the control leaves a corner where the program does not say (grbl: $11)
  std::optional<bool> straight_rapids;  ///< G0 moves all axes in step; empty: as the control does by default
  std::size_t max_program_bytes = 0; ///< programs longer than this are split; 0: no limit

  [[nodiscard]] bool has_rotary() const { return chain != Chain::kThreeAxis; }
  /// Otherwise every axis goes at its own speed and the tip takes a dog leg: Fanuc, unless its parameter LRP is set.
  [[nodiscard]] bool has_straight_rapids() const { return straight_rapids.value_or(controller != "fanuc"); }
};

/// Throws InputError naming file, line, key and rule (limits the wrong way round, a zero axis, parallel rotary axes...).
MachineModel read_machine(const std::filesystem::path& path);

/// Where the machine's axes stand. Not to be mixed up with a ToolPose.
struct JointPosition {
  double x_mm = 0, y_mm = 0, z_mm = 0;
  double outer_rad = 0, inner_rad = 0;   ///< as programmed (B, C)
};

}  // namespace lightmill

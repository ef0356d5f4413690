// Tool paths in the workpiece frame (= lens frame): what the cutter does to the part, before any machine is known.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "cam/cutter.h"
#include "design/core/geometry.h"

namespace lightmill {

/// Where a cutter is: its tip and the unit axis from the tip towards the spindle. A ball's centre is tip + R axis.
struct ToolPose {
  Vec3 tip_mm = Vec3::Zero();
  Vec3 axis = Vec3::UnitZ();
};

enum class MoveKind : std::uint8_t {
  kRapid,   ///< as fast as the machine can, through air only, axis unchanged
  kLink,    ///< at feed through air; the axis may change
  kPlunge,  ///< into material downwards or along a ramp
  kCut,     ///< at cutting feed
};

/// A straight move of the tip from the previous move's pose to this one, the axis turning evenly.
struct Move {
  ToolPose pose;
  MoveKind kind = MoveKind::kRapid;
  double feed_mm_per_s = 0;  ///< of the tip; 0 for rapids
};

/// One pass with one cutter. The first move is a rapid to a safe place above the stock, the last one ends in one.
struct ToolPath {
  std::string pass;  ///< "rough", "semi_finish", "finish"
  Cutter cutter;
  double spindle_rpm = 0;
  std::vector<Move> moves;
  double stepover_mm = 0;        ///< the widest distance between neighbouring passes
  double predicted_cusp_um = 0;  ///< highest cusp the plan expects on the reachable surface (rough: most it leaves)
  double above_limit_mm2 = 0;    ///< reachable area where the plan expects a higher cusp than was asked for
  double clearance_z_mm = 0;     ///< rapids are at or above this height of the tip

  [[nodiscard]] double length_mm() const;  ///< of all moves
  [[nodiscard]] double minutes(double rapid_mm_per_s) const;
};

/// All passes of a job in one binary file (little-endian, versioned), whole or absent.
void write_toolpaths(const std::filesystem::path& path, const std::vector<ToolPath>& passes);
std::vector<ToolPath> read_toolpaths(const std::filesystem::path& path);

}  // namespace lightmill

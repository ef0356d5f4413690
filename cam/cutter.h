// Cutters as data: shape, cutting data, and their files under fixtures/cutters.
#pragma once

#include <cmath>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace lightmill {

/// A piece of the shank or the holder, from the tip upwards: a cone between two radii (a cylinder if equal).
struct ToolPiece {
  double from_mm = 0;  ///< above the tip
  double to_mm = 0;
  double from_radius_mm = 0;
  double to_radius_mm = 0;
};

/// A ball cutter has corner_radius == diameter / 2, a bull-nose less, a flat end mill 0. A tapered ball goes over from its ball,
/// tangentially, into a cone that cuts, too.
struct Cutter {
  std::string name;
  int number = 0;                    ///< T word, place in the tool table
  double diameter_mm = 0;
  double corner_radius_mm = 0;
  int edges = 2;
  double flute_length_mm = 0;        ///< cutting length from the tip
  double taper_rad = 0;              ///< of a tapered ball: between its axis and the cone around it, up to flute_length_mm
  double shank_diameter_mm = 0;      ///< where neither `shank` nor the holder says otherwise
  std::vector<ToolPiece> shank{};    ///< neck and cones from the flutes upwards
  double length_mm = 0;              ///< gauge line (spindle nose) to tip: the length the controller compensates
  bool centre_cutting = false;       ///< may plunge straight down
  std::vector<ToolPiece> holder;
  // Cutting data for a material, "untested on the machine" unless the file says otherwise.
  double spindle_rpm = 0;
  double feed_per_tooth_mm = 0;
  double plunge_feed_mm_per_s = 0;
  double most_stepover_mm = 0;       ///< widest engagement beside a cut; 0: not said
  double slot_depth_mm = 0;          ///< deepest cut of full width; 0: not said
  std::string coolant;               ///< "air", "mist" or "none"
  std::string source;                ///< where the data comes from

  [[nodiscard]] double radius_mm() const { return diameter_mm / 2; }
  [[nodiscard]] bool is_ball() const { return corner_radius_mm >= radius_mm(); }
  /// Of the flutes at a height above the tip, from the ball's equator or the corner's top on.
  [[nodiscard]] double flute_radius_mm(double above_tip_mm) const {
    return taper_rad > 0 ? radius_mm() / std::cos(taper_rad) + (above_tip_mm - radius_mm()) * std::tan(taper_rad) : radius_mm();
  }
  /// Height above the tip where the ball or the corner goes over into the flutes' side.
  [[nodiscard]] double side_from_mm() const { return corner_radius_mm * (1 - std::sin(taper_rad)); }
  /// Lower end of the holder; the gauge line without one.
  [[nodiscard]] double reach_mm() const { return holder.empty() ? length_mm : holder.front().from_mm; }
  [[nodiscard]] double feed_mm_per_s() const { return spindle_rpm / 60 * edges * feed_per_tooth_mm; }
};

/// The name by which cutter files know a material: "PMMA" of "PMMA, cast, annealed".
std::string material_name(std::string_view description);

/// With the cutting data of the table [material.NAME], or with those beside the shape, which are for whatever is milled. An empty name
/// takes the first table: where only the shape matters. Throws InputError naming file, line, key and rule; of a material that the
/// file has no data for, the ones it knows.
Cutter read_cutter(const std::filesystem::path& path, std::string_view material = {});

}  // namespace lightmill

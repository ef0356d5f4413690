// Cutters as data: shape, cutting data, and their files under fixtures/cutters.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace lightmill {

/// A piece of the holder above the cutter's shank, from the tip upwards: a cone between two radii (a cylinder if equal).
struct HolderPiece {
  double from_mm = 0;  ///< above the tip
  double to_mm = 0;
  double from_radius_mm = 0;
  double to_radius_mm = 0;
};

/// A ball cutter has corner_radius == diameter / 2, a bull-nose less, a flat end mill 0.
struct Cutter {
  std::string name;
  int number = 0;                    ///< T word, place in the tool table
  double diameter_mm = 0;
  double corner_radius_mm = 0;
  int edges = 2;
  double flute_length_mm = 0;        ///< cutting length from the tip
  double shank_diameter_mm = 0;
  double length_mm = 0;              ///< gauge line (spindle nose) to tip: the length the controller compensates
  bool centre_cutting = false;       ///< may plunge straight down
  std::vector<HolderPiece> holder;
  // Default cutting data for PMMA, "untested on the machine" unless the file says otherwise.
  double spindle_rpm = 0;
  double feed_per_tooth_mm = 0;
  double plunge_feed_mm_per_s = 0;
  std::string coolant;               ///< "air", "mist" or "none"
  std::string source;                ///< where the data comes from

  [[nodiscard]] double radius_mm() const { return diameter_mm / 2; }
  [[nodiscard]] bool is_ball() const { return corner_radius_mm >= radius_mm(); }
  [[nodiscard]] double feed_mm_per_s() const { return spindle_rpm / 60 * edges * feed_per_tooth_mm; }
};

/// Throws InputError naming file, line, key and rule.
Cutter read_cutter(const std::filesystem::path& path);

}  // namespace lightmill

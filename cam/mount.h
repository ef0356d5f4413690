// What holds, centres and names the part, in its land, where no light goes: an edge chamfer, dowel holes, a label of dots.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "cam/outline.h"

namespace lightmill {

struct MountOptions {
  double chamfer_mm = 0;              ///< at 45 degrees, along the outer edges of back and land; 0: none
  std::vector<Vec2> dowels_mm;        ///< middles of holes for pins
  double dowel_diameter_mm = 4;
  double dowel_depth_mm = 0;          ///< from the back; 0: through
  std::string label;                  ///< A to Z, 0 to 9, space and . , : - + / _ #; of drilled dots, 5 x 7 a letter
  bool label_on_back = false;         ///< else on the land; reads from there
  double label_height_mm = 2;
  double label_depth_mm = 0.2;
  std::optional<Vec2> label_at_mm;    ///< its middle; empty: on the land below the lens
};

/// A round hole along Z with a flat end, or two open ones.
struct RoundHole {
  Vec2 middle_mm;
  double radius_mm;
  double from_mm, to_mm;              ///< heights; the back is 0
  bool open_below, open_above;
};

/// The land's part of the solid that the features are cut into: below `land_z_mm`, between the outlines.
struct Land {
  Outline optical, part;
  double z_mm;
};

/// The holes of dowels and label. Throws InputError, with key and place, where one leaves the land, comes nearer than 0.3 mm to
/// its border or to another, or is too deep, for a chamfer that the land has no room for, and for letters that are not known.
std::vector<RoundHole> mount_holes(const MountOptions& options, const Land& land);

/// What chamfer and holes take from the solid, mm^3, the part's border being its places' chords.
double mount_volume_mm3(const MountOptions& options, const Land& land);

/// What of these somebody has to make beside the milling passes; empty where nothing.
std::string mount_words(const MountOptions& options);

}  // namespace lightmill

// Whether the shank and the holder of a tilted cutter stay clear of the part.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "cam/blank.h"
#include "cam/spline_surface.h"
#include "cam/toolpath.h"

namespace lightmill::detail {

/// Where a tool touches what it should not.
struct ToolContact {
  Vec3 place_mm = Vec3::Zero();
  bool holder = false;  ///< else the shank
};

/// Highest material over cells of the blank (the surface and what stands above it) with a pyramid of maxima.
class ToolClearance {
 public:
  /// `above_surface_mm`: how high material may stand over the surface when this pass runs.
  ToolClearance(const SplineSurface& surface, const Blank& blank, double above_surface_mm);

  /// The shank (from the ball's equator or the top of the corner upwards) and the holder (kept clear by `holder_mm`)
  /// against the material. A vertical line meets a cylinder in one interval; a column of material collides if it is
  /// higher than the interval's lower end.
  [[nodiscard]] std::optional<ToolContact> touches(const Cutter& cutter, const ToolPose& pose,
                                                   double holder_mm = 0.5) const;

 private:
  struct Level {
    double cell_mm = 0;
    Grid<float> highest;
  };
  Vec2 first_;
  std::vector<Level> levels_;  // finest first
};

}  // namespace lightmill::detail

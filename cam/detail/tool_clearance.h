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
  bool holder = false;  ///< else the shank or the flank
};

/// Highest material over cells of the blank (the surface and what stands above it) with a pyramid of maxima.
class ToolClearance {
 public:
  /// `above_surface_mm`: how high material may stand over the surface when this pass runs. What holds the blank counts too.
  /// Cells see a slope's top only: for small balls they must be small. `standing`: what of the blank stands when the pass
  /// starts; what does not cut (shank and holder) is held against that, too.
  ToolClearance(const SplineSurface& surface, const Blank& blank, double above_surface_mm, double cell_mm = 0.25,
                const RestMaterial* standing = nullptr);
  /// Of nothing but what holds the work, as columns from below up to the boxes' tops.
  explicit ToolClearance(const std::vector<KeepOut>& keep_outs);

  /// The shank (from the ball's equator or the top of the corner upwards) and the holder (kept clear by `holder_mm`), stacked
  /// cones, against the material; a tapered ball's flank against the surface, within 2 um. A vertical line meets a cone in one
  /// interval; a column of material collides if it is higher than the interval's lower end. `with_tip`: the tip's rounding
  /// too, as a cylinder.
  [[nodiscard]] std::optional<ToolContact> touches(const Cutter& cutter, const ToolPose& pose,
                                                   double holder_mm = 0.5, bool with_tip = false) const;

 private:
  struct Level {
    double cell_mm = 0;
    Grid<float> highest;
  };
  void stand_up(const std::vector<KeepOut>& keep_outs, Grid<float>& highest) const;
  static std::vector<Level> pyramid(Level finest);
  const SplineSurface* surface_ = nullptr;
  double above_mm_ = 0;
  double cell_mm_ = 0.25;
  Vec2 first_;
  std::vector<Level> levels_;    // finest first
  std::vector<Level> standing_;  // the same with what stands; empty without
};

}  // namespace lightmill::detail

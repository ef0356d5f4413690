// Roughing by levels with an end mill, leaving an allowance over the surface.
#pragma once

#include "cam/blank.h"
#include "cam/spline_surface.h"
#include "cam/toolpath.h"
#include "design/core/grid.h"
#include "design/core/monitor.h"

namespace lightmill {

enum class RoughWay {
  kLevels,  ///< level by level, then one raster over the offset surface
  kLayers,  ///< rasters over the offset surface alone, layer by layer
};

struct RoughOptions {
  RoughWay way = RoughWay::kLevels;
  double allowance_mm = 0.3;
  double stepdown_mm = 1.0;
  double stepover_mm = 4.0;
  double link_feed_mm_per_s = 80;
  double max_feed_mm_per_s = 100;
  double acceleration_mm_per_s2 = 2000;
  double clearance_mm = 5;
};

/// Vertical axis, climb milling but for slots, entered from beside the block, no plunge into material. Where the mill engages wider than the
/// stepover (a pit's first line, behind islands) it is, at half feed, no deeper than its slot_depth_mm; nowhere deeper than
/// 1.3 stepdowns. A shank wider than the mill keeps away from what stands. Without moves where the blank leaves nothing to rough.
ToolPath plan_roughing(const SplineSurface& surface, const Blank& blank, const Cutter& mill,
                       const RoughOptions& options, const Monitor& monitor = {});

/// How the mill meets the material, seen on the planner's grid.
struct RoughCutting {
  double in_material_mm = 0;   ///< way in material
  double conventional_mm = 0;  ///< of it with material on the left of the axis alone: against climb milling
  double both_sides_mm = 0;    ///< of it with material on the left and on the right: slots, which cannot climb

  [[nodiscard]] double conventional_share() const { return in_material_mm > 0 ? conventional_mm / in_material_mm : 0; }
  [[nodiscard]] double both_sides_share() const { return in_material_mm > 0 ? both_sides_mm / in_material_mm : 0; }
};

/// The faster of both ways, by planning both.
struct RoughChoice {
  RoughWay way = RoughWay::kLevels;
  ToolPath path;
  RestMaterial rest;
  RoughCutting cutting;
  double levels_minutes = 0, layers_minutes = 0;
};
RoughChoice plan_faster_roughing(const SplineSurface& surface, const Blank& blank, const Cutter& mill, RoughOptions options,
                                 const Monitor& monitor = {});

/// The deepest that a ball's cutting moves reach below what stands when they start, along Z.
double deepest_cut_mm(const RestMaterial& rest, const ToolPath& path);

/// What a ball's cutting moves leave of it.
RestMaterial after_pass(RestMaterial rest, const ToolPath& path);

}  // namespace lightmill

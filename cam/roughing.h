// Roughing by levels with an end mill, leaving an allowance over the surface.
#pragma once

#include "cam/blank.h"
#include "cam/spline_surface.h"
#include "cam/toolpath.h"
#include "design/core/monitor.h"

namespace lightmill {

struct RoughOptions {
  double allowance_mm = 0.3;
  double stepdown_mm = 1.0;
  double stepover_mm = 4.0;
  double link_feed_mm_per_s = 80;
  double max_feed_mm_per_s = 100;
  double acceleration_mm_per_s2 = 2000;
  double clearance_mm = 5;
};

/// Vertical axis, climb milling, entered from beside the block, no plunge into material.
ToolPath plan_roughing(const SplineSurface& surface, const Blank& blank, const Cutter& mill,
                       const RoughOptions& options, const Monitor& monitor = {});

}  // namespace lightmill

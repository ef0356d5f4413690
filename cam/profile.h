// Cutting the part out of its blank along its outline, tabs and a skin holding it.
#pragma once

#include "cam/blank.h"
#include "cam/outline.h"
#include "cam/toolpath.h"
#include "design/core/monitor.h"

namespace lightmill {

struct ProfileOptions {
  double stepdown_mm = 1;          ///< of the helix in one turn around the part
  double land_mm = 0;              ///< width of the flat land around the optical surface; 0: none
  double land_z_mm = 0;            ///< of the land
  int tabs = 4;
  double tab_width_mm = 4;         ///< at its top
  double tab_height_mm = 1;        ///< above the back
  double skin_mm = 0.1;            ///< left over the back everywhere, so that nothing below is cut
  double most_over_surface_mm = 1.5;  ///< earlier passes leave no more beside the optical surface
  double link_feed_mm_per_s = 80;
  double max_feed_mm_per_s = 100;
  double acceleration_mm_per_s2 = 2000;
  double clearance_mm = 5;
};

/// Where so many tabs and their ramps take more than the way around the part: three, and if those do not fit either, narrower and lower
/// ones down to 2 mm and 0.5 mm. Unchanged where even they do not fit.
ProfileOptions with_fitting_tabs(ProfileOptions options, const Outline& optical, const Cutter& mill);

/// Around `optical` down to the land if there is one, then around the part down to the skin, in a helix that takes
/// `stepdown_mm` a turn, clockwise (climb milling at the part), the land first from outside in. The feed is half the
/// cutter's, since most of it is a slot. Throws InputError where the mill does not get around, is too short, would ramp
/// down at more than 3 degrees, or the tabs do not fit on the way.
ToolPath plan_profile(const SplineSurface& surface, const Blank& blank, const Outline& optical, const Cutter& mill,
                      const ProfileOptions& options, const Monitor& monitor = {});

}  // namespace lightmill

// What the dry run's solid says about a part that is cut out of its blank: walls, tabs, loose pieces.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <vector>

#include "cam/spline_surface.h"
#include "cli/job.h"
#include "design/core/grid.h"
#include "machine/motion.h"
#include "machine/solid_stock.h"

namespace lightmill {

/// For report.json; adds faults of the kinds "wall", "tabs" and "cut_free". `surface` is the designed one.
nlohmann::json cut_out_report(const Job& job, const SplineSurface& surface, const SolidStock& solid, std::vector<Fault>& faults);

/// Height of what stands on the back, cut off a little above the tabs: slot, skin and tabs to look at. Row 0 at the smallest y.
Grid<float> tabs_from_above(const Job& job, const SolidStock& solid);

}  // namespace lightmill

// A fault as a picture: the cutter, the stock and what stands around them, cut through at the fault's place.
#pragma once

#include <string>
#include <vector>

#include "cam/blank.h"
#include "machine/detail/stock_field.h"
#include "machine/detail/stock_tool.h"

namespace lightmill {

/// An SVG, true to scale: the upright plane through `place_mm` that the cutter leans in (or moves in, if it stands upright).
std::string fault_picture(const StockField& field, const Tool& tool, const ToolPose& pose, const Vec3& motion_mm,
                          const Vec3& place_mm, const std::vector<KeepOut>& obstacles, const std::string& title);

}  // namespace lightmill

// Faults as pictures: the cutter, the stock and what stands around them, cut through at the fault's place; travels.
// Both leave their top free for a heading (fault_words.h).
#pragma once

#include <string>
#include <vector>

#include "cam/blank.h"
#include "machine/detail/stock_field.h"
#include "machine/detail/stock_tool.h"
#include "postproc/machine_model.h"

namespace lightmill {

/// An SVG, true to scale: the upright plane through `place_mm` that the cutter leans in (or moves in, if it stands upright). The
/// stock as the solid has it, if there is one (else null).
std::string fault_picture(const StockField& field, const SolidStock* solid, const Tool& tool, const ToolPose& pose, const Vec3& motion_mm,
                          const Vec3& place_mm, const std::vector<KeepOut>& obstacles);

/// An SVG of the axes' travels as bars, where each stands and where a move would take it; what passes a limit is red.
std::string travel_picture(const MachineModel& machine, const JointPosition& at, const JointPosition& target);

/// A line of words for an SVG.
std::string svg_words(double x, double y, const std::string& text, int size = 13);

}  // namespace lightmill

// Tool paths against what holds the work.
#pragma once

#include "cam/blank.h"
#include "cam/toolpath.h"

namespace lightmill {

/// Throws InputError naming pass and place where the cutter goes below the back of the blank (z = 0), or where any of the cutter,
/// its shank or its holder comes nearer than 0.5 mm to a keep-out on any move (looked at every half millimetre); the boxes count
/// as standing on the table.
void refuse_contact(const ToolPath& path, const std::vector<KeepOut>& keep_outs);

/// Height of the highest keep-out, or of the blank if that is higher: rapids stay above.
double highest_obstacle_mm(const Blank& blank);

/// Two jaws of a vise along the blank's sides at -y and +y, standing on the table: [length, thickness, height] in mm.
std::vector<KeepOut> vise_jaws(const Vec2& blank_size_mm, const Vec3& jaw_mm);

}  // namespace lightmill

// A restart to look at before anything moves.
#pragma once

#include <string>
#include <vector>

#include "machine/restart.h"

namespace lightmill {

/// SVG, two views of the tip's way around the restart place, in mm of the workpiece frame: from above, and from the
/// side on to the entry along the tool's axis. What is cut is grey, what is gone over again orange, what is left blue,
/// rapids dashed, the entry red.
std::string restart_picture(const Restart& restart, const std::vector<PathPiece>& pieces, const std::string& title);

}  // namespace lightmill

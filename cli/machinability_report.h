// Can the lens be milled as the job asks? For report.json, the report page and `lightmill check`.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "cam/outline.h"
#include "cam/reachable.h"
#include "cli/job.h"

namespace lightmill {

/// Slopes, hollows, axes, blank, what stays out of the ball's reach, and `refusals`: why planning would refuse, with remedies. Of the
/// surface alone: no pass is planned. `smaller_balls` tells what half and a quarter of the ball would leave where it leaves something.
nlohmann::json machinability_json(const Job& job, const SplineSurface& surface, const Outline& outline, const ReachableSurface& reachable);

/// A line for each pass whose axis gives way to another than asked for.
std::vector<std::string> changed_axes(const nlohmann::json& machinability);

/// The machinability as lines of text, with the creases (creases_json) and, as far as they are planned, the passes of `cam`.
std::string machinability_text(const nlohmann::json& machinability, const nlohmann::json& creases, const nlohmann::json& cam);

}  // namespace lightmill

// What the finishing ball leaves in concave creases, for report.json and for people.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "cam/creases.h"
#include "cli/job.h"

namespace lightmill {

/// All creases with their figures, the longest 200 with their lines: `{count, length_mm, light_lost_share, list}`. Where the light of a
/// fillet lands is between what the two flanks bend upright light to, in receiver coordinates.
nlohmann::json creases_json(const SplineSurface& surface, const ReachableSurface& reachable, const Job& job);

/// The same as lines of text, the longest ten.
std::string creases_text(const nlohmann::json& creases);

}  // namespace lightmill

// What is looked at before a run folder's programs go out.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "cli/job.h"

namespace lightmill {

/// What the operator confirms before the spindle turns, a line each.
std::string checklist(const Job& job);

/// Will a line of this speed starve a program of the run folder (its report.json)? Says which, and what helps; empty: no.
std::string slow_link(const nlohmann::json& report, int baud);

}  // namespace lightmill

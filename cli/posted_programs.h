// The programs of a run folder as the post writes them, in memory, and what needs no tool path to be refused.
#pragma once

#include <vector>

#include "cli/job.h"
#include "cli/run_folder.h"
#include "postproc/program.h"

namespace lightmill {

/// Throws InputError where the job asks its control for what that cannot do (decimals, arcs, tool-centre-point control).
void check_posting(const Job& job);

/// From the tool paths that are there; throws what the post throws.
std::vector<Program> posted_programs(const Job& job, const RunFolder& folder);

}  // namespace lightmill

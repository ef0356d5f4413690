// The programs of a run folder as the post writes them, in memory.
#pragma once

#include <vector>

#include "cli/job.h"
#include "cli/run_folder.h"
#include "postproc/program.h"

namespace lightmill {

/// From the tool paths that are there; throws what the post throws.
std::vector<Program> posted_programs(const Job& job, const RunFolder& folder);

}  // namespace lightmill

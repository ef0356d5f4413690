// The stages of a job as functions of job and run folder: each reads its inputs, calls the rooms, writes its files, its
// figures and its record.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "cli/job.h"
#include "cli/run_folder.h"
#include "design/core/monitor.h"

namespace lightmill {

/// What a dry run may be told about the shop floor other than what the job says: plants faults, or asks "what if".
struct ShopOverrides {
  std::optional<std::filesystem::path> machine_file;
  std::vector<std::filesystem::path> cutter_files;   ///< empty: the job's
  std::optional<int> work_offset;
  std::optional<Vec3> workpiece_origin_mm;           ///< from the table's centre
  std::optional<int> pace_baud;                      ///< of the simulated line
  bool line_times = false;                           ///< a table of them, however long
};

/// Digest of everything the stage's result depends on: options, contents of input files, results of earlier stages.
/// Empty while an earlier stage's files are missing.
std::string stage_digest(Stage stage, const Job& job, const RunFolder& folder, const ShopOverrides& overrides = {});

/// Checks before long computing starts what can be checked: cutters against the machine's reach and spindle.
/// Throws InputError.
void check_job(const Job& job);

/// Runs one stage; its files are whole or absent. Throws what the rooms throw.
void run_stage(Stage stage, const Job& job, RunFolder& folder, const Monitor& monitor, const ShopOverrides& overrides = {});

/// Faults of the folder's dry run (0 if there was none).
int count_faults(const RunFolder& folder);

}  // namespace lightmill

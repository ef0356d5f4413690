// What-if studies of a job: which cusps are good enough for its picture, which errors of a machine hurt it most.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "cli/job.h"
#include "cli/run_folder.h"
#include "design/core/monitor.h"

namespace lightmill {

struct StudyOptions {
  double pitch_um = 40;                                     ///< of the stock, at most: cusps are seen by finer ones
  std::vector<double> cusps_um{0.5, 1, 1.5, 3, 6, 12};      ///< planned
  std::vector<double> polish_sigmas_um{0, 25, 50, 100, 200};
  int seeds = 1;                                            ///< signs drawn for every error; the worst counts
};

/// Plans the finish for every cusp height, mills it and polishes it to every depth: study_cusp.json and .html in
/// FOLDER/study. The folder holds the job's tool paths.
void study_cusp(const Job& job, const RunFolder& folder, const StudyOptions& options, const Monitor& monitor);

/// Mills the finishing program with one error at a time, those of the job ([dry_run.errors]) if it has any, else those of a
/// fair machine: study_errors.json and .html. The folder holds the job's programs.
void study_errors(const Job& job, const RunFolder& folder, const StudyOptions& options, const Monitor& monitor);

}  // namespace lightmill

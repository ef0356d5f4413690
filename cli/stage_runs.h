// What run_stage() calls: one function per stage, each returning its figures and its files.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli/stages.h"
#include "design/caustic.h"

namespace lightmill {

struct StageResult {
  nlohmann::json report;           ///< as it goes into report.json
  std::vector<std::string> files;  ///< relative to the run folder
};

StageResult run_transport(const Job& job, const RunFolder& folder, const Monitor& monitor);
StageResult run_surface(const Job& job, const RunFolder& folder, const Monitor& monitor);
StageResult run_cam(const Job& job, const RunFolder& folder, const Monitor& monitor);
StageResult run_post(const Job& job, const RunFolder& folder, const Monitor& monitor);
StageResult run_dry_run(const Job& job, const RunFolder& folder, const Monitor& monitor, const ShopOverrides& overrides);

nlohmann::json to_json(const CausticMeasures& measures);

/// What counts as white in the pictures of target and caustics: 99.5 % of the area light's pixels are darker, as a multiple
/// of the mean irradiance. The same for all pictures of a job, so that they can be compared.
double display_white(const TargetLight& target);

/// Digest of what the programs are made from (not of how they are looked at or sent); programs and the setup sheet carry it.
std::string making_digest(const Job& job);

/// Where the target comes from the same way in every stage.
TargetLight target_of(const Job& job);

/// In the order of milling; the last two only where a smaller ball is to clean creases and the part is cut out of its blank.
inline constexpr const char* kPassNames[] = {"rough", "semi_finish", "finish", "rest", "profile"};

}  // namespace lightmill

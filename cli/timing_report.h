// What the planner of the simulated control found out about time, for the report.
#pragma once

#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "cam/cutter.h"
#include "machine/motion_timing.h"
#include "postproc/machine_model.h"

namespace lightmill {

/// The motions of one tool in a program; lines are the text's.
struct ProgramSection {
  std::string program;  ///< file name
  SectionTiming section;
};

/// As result.json holds it.
nlohmann::json to_json(const SectionTiming& section);
SectionTiming section_from(const nlohmann::json& record);

/// By pass: `files` says which programs a pass is in (report.json's postproc); several passes in one program follow each
/// other, a tool each. Figures in minutes, mm and degrees, with a note where the feed falls below half.
nlohmann::json pass_timings(const std::vector<ProgramSection>& sections, const nlohmann::json& postproc,
                            const MachineModel& machine);

/// A fault "feed" for each pass whose program asks for clearly less or more time at its feeds than was planned: `passes` from
/// pass_timings(), `cam` and `postproc` from report.json.
std::vector<Fault> feed_faults(const nlohmann::json& passes, const nlohmann::json& cam, const nlohmann::json& postproc);

/// A fault "wrong_tool" for each tool that cuts in the place of the one that its pass is planned for: `cutters` by pass.
std::vector<Fault> tool_faults(const std::vector<ProgramSection>& sections, const std::map<std::string, Cutter>& cutters,
                               const nlohmann::json& postproc);

/// Of all sections, dwells included.
double total_minutes(const std::vector<ProgramSection>& sections);

}  // namespace lightmill

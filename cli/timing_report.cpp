#include "cli/timing_report.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>

#include "cli/stage_runs.h"
#include "design/core/text.h"

namespace lightmill {

using nlohmann::json;

namespace {

constexpr double kDegreesPerRad = 180 / kPi;
/// A program takes the planned time within a hundredth, but for dwells and the way to the tool, which it has besides.
constexpr double kQuicker = 0.8, kSlower = 1.25;
constexpr double kBesideMinutes = 1;
/// Feeds that are slower than half for less than this share of a pass's time are its turns and ends.
constexpr double kWorthANote = 0.01;

json per_axis(const std::array<double, 5>& values, const MachineModel& machine) {
  json result = {{"X", values[0]}, {"Y", values[1]}, {"Z", values[2]}};
  if (machine.has_rotary()) {
    result[std::string(1, machine.outer.letter)] = values[3] * kDegreesPerRad;
    result[std::string(1, machine.inner.letter)] = values[4] * kDegreesPerRad;
  }
  return result;
}

/// The passes that have blocks in a program, in the order in which they are milled.
std::vector<std::string> passes_in(const std::string& program, const json& postproc) {
  std::vector<std::string> passes;
  for (const char* pass : kPassNames) {
    if (!postproc.contains(pass)) continue;
    for (const json& file : postproc.at(pass).value("files", json::array())) {
      if (file.value("file", "") == "program/" + program) passes.emplace_back(pass);
    }
  }
  return passes;
}

}  // namespace

json to_json(const SectionTiming& section) {
  const MotionTiming& t = section.timing;
  return {{"line", section.line},
          {"program", section.program},
          {"tool", section.tool},
          {"blocks", t.blocks},
          {"stops", t.stops},
          {"seconds", t.seconds},
          {"commanded_seconds", t.commanded_seconds},
          {"feed_seconds", t.feed_seconds},
          {"commanded_feed_seconds", t.commanded_feed_seconds},
          {"feed_mm", t.feed_mm},
          {"slow_seconds", t.slow_seconds},
          {"slow_line", t.slow_line},
          {"slow_line_seconds", t.slow_line_seconds},
          {"slow_line_mm", t.slow_line_mm},
          {"top_speed", t.top_speed},
          {"top_acceleration", t.top_acceleration}};
}

SectionTiming section_from(const json& record) {
  SectionTiming section;
  MotionTiming& t = section.timing;
  record.at("line").get_to(section.line);
  record.at("program").get_to(section.program);
  record.at("tool").get_to(section.tool);
  record.at("blocks").get_to(t.blocks);
  record.at("stops").get_to(t.stops);
  record.at("seconds").get_to(t.seconds);
  record.at("commanded_seconds").get_to(t.commanded_seconds);
  record.at("feed_seconds").get_to(t.feed_seconds);
  record.at("commanded_feed_seconds").get_to(t.commanded_feed_seconds);
  record.at("feed_mm").get_to(t.feed_mm);
  record.at("slow_seconds").get_to(t.slow_seconds);
  record.at("slow_line").get_to(t.slow_line);
  record.at("slow_line_seconds").get_to(t.slow_line_seconds);
  record.at("slow_line_mm").get_to(t.slow_line_mm);
  record.at("top_speed").get_to(t.top_speed);
  record.at("top_acceleration").get_to(t.top_acceleration);
  return section;
}

double total_minutes(const std::vector<ProgramSection>& sections) {
  double seconds = 0;
  for (const ProgramSection& s : sections) seconds += s.section.timing.seconds;
  return seconds / 60;
}

json pass_timings(const std::vector<ProgramSection>& sections, const json& postproc, const MachineModel& machine) {
  std::map<std::string, MotionTiming> timings;
  std::map<std::string, std::string> slow_program;
  std::map<std::string, std::pair<std::string, long>> begins;
  std::map<std::string, std::size_t> tools;  // of a program so far
  int tool = 0;
  std::string program;
  for (const ProgramSection& s : sections) {
    const std::vector<std::string> passes = passes_in(s.program, postproc);
    if (passes.empty()) continue;
    // The way to the first tool change belongs to the first pass.
    if (s.program != program) tools[s.program] = 0;
    else if (s.section.tool != tool && tool != 0) ++tools[s.program];
    program = s.program;
    tool = s.section.tool;
    const std::string& pass = passes[std::min(tools[s.program], passes.size() - 1)];
    begins.try_emplace(pass, s.program, s.section.line);
    MotionTiming& timing = timings[pass];
    const double slowest = timing.slow_line_seconds;
    timing.add(s.section.timing);
    if (timing.slow_line_seconds > slowest) slow_program[pass] = s.program;
  }

  json result = json::object();
  for (const auto& [pass, t] : timings) {
    const double feed = t.feed_seconds > 0 ? t.feed_mm / t.feed_seconds * 60 : 0;
    const double commanded = t.commanded_feed_seconds > 0 ? t.feed_mm / t.commanded_feed_seconds * 60 : 0;
    const double slow = t.feed_seconds > 0 ? t.slow_seconds / t.feed_seconds : 0;
    json& out = result[pass];
    out = {{"program", begins[pass].first},
           {"line", begins[pass].second},
           {"minutes", t.seconds / 60},
           {"commanded_minutes", t.commanded_seconds / 60},
           {"blocks", t.blocks},
           {"stops", t.stops},
           {"mean_feed_mm_per_min", feed},
           {"commanded_feed_mm_per_min", commanded},
           {"slow_share", slow},
           {"top_speed_per_s", per_axis(t.top_speed, machine)},
           {"top_acceleration_per_s2", per_axis(t.top_acceleration, machine)}};
    if (slow <= kWorthANote) continue;
    const double reached = t.slow_line_seconds > 0 ? t.slow_line_mm / t.slow_line_seconds * 60 : 0;
    out["note"] = "for " + fixed(100 * slow, 1) + " % of its cutting time the tip makes less than half of the programmed feed; longest in " +
                  slow_program[pass] + " from line " + std::to_string(t.slow_line) + ": " + fixed(t.slow_line_seconds, 1) + " s at " +
                  fixed(reached, 0) + " mm/min";
  }
  return result;
}

std::vector<Fault> feed_faults(const json& passes, const json& cam, const json& postproc) {
  std::vector<Fault> faults;
  for (const auto& [pass, timing] : passes.items()) {
    const double planned = cam.value(json::json_pointer("/" + pass + "/minutes"), 0.0);
    const double slowing = std::max(1.0, postproc.value(json::json_pointer("/" + pass + "/worst_slowing"), 1.0));
    const double commanded = timing.at("commanded_minutes");
    if (planned <= 0 || (commanded >= kQuicker * planned && commanded <= kSlower * slowing * planned + kBesideMinutes)) continue;
    Fault fault;
    fault.kind = "feed";
    fault.program = timing.at("program");
    fault.line = timing.at("line");
    fault.message = pass + ": at its feeds the program takes " + fixed(commanded, 1) + " minutes, the plan " + fixed(planned, 1) +
                    "; look at the F words, or write it again with: lightmill post";
    faults.push_back(fault);
  }
  return faults;
}

std::vector<Fault> tool_faults(const std::vector<ProgramSection>& sections, const std::map<std::string, Cutter>& cutters,
                               const json& postproc) {
  std::vector<Fault> faults;
  std::map<std::string, std::vector<int>> cut_with;  // by program, in order
  for (const auto& [program, section] : sections) {
    if (section.timing.feed_mm == 0 || section.tool == 0) continue;
    std::vector<std::string> passes;  // the first of each tool
    for (const std::string& pass : passes_in(program, postproc)) {
      if (passes.empty() || cutters.at(passes.back()).number != cutters.at(pass).number) passes.push_back(pass);
    }
    std::vector<int>& tools = cut_with[program];
    if (passes.empty() || (!tools.empty() && tools.back() == section.tool)) continue;
    tools.push_back(section.tool);
    const std::string& pass = passes[std::min(tools.size(), passes.size()) - 1];
    const Cutter& planned = cutters.at(pass);
    if (section.tool == planned.number) continue;
    const std::string number = std::to_string(planned.number);
    Fault fault;
    fault.kind = "wrong_tool";
    fault.program = program;
    fault.line = section.line;
    fault.message = pass + ": cuts with tool " + std::to_string(section.tool) + ", planned is tool " + number + " ('" + planned.name + "'); change to T" +
                    number + ", or write the program again with: lightmill post";
    faults.push_back(fault);
  }
  return faults;
}

}  // namespace lightmill

#include <algorithm>

#include "cli/digest.h"
#include "cli/posted_programs.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "postproc/data_rate.h"
#include "postproc/program_parts.h"

namespace lightmill {

using nlohmann::json;

namespace {

struct Posting {
  MachineModel machine;
  WorkSetup setup;
  ProgramOptions options;
  std::vector<AxisMotion> motions;
};

MachineModel machine_of(const Job& job) {
  MachineModel machine = read_machine(job.machine.file);
  machine.controller = job.controller.dialect;
  return machine;
}

ProgramOptions program_options(const Job& job) {
  ProgramOptions options;
  options.decimals = job.controller.decimals;
  options.tcp = job.controller.tcp;
  options.block_numbers = job.controller.block_numbers;
  options.job_name = job.name;
  options.job_hash = making_digest(job).substr(0, 16);
  if (job.controller.arcs) options.arc_tolerance_mm = job.controller.tip_tolerance_um / 1000;
  return options;
}

Posting plan_posting(const Job& job, const RunFolder& folder, const Monitor& monitor) {
  const std::vector<ToolPath> passes = read_toolpaths(folder.needed("cam/toolpaths.bin", "cam"));
  Posting posting;
  posting.machine = machine_of(job);
  posting.options = program_options(job);
  check_program_options(posting.machine, posting.options);
  posting.setup = work_on_table(posting.machine, job.machine.workpiece_origin_mm, job.machine.work_offset);
  MotionOptions motion_options;
  motion_options.tip_tolerance_mm = job.controller.tip_tolerance_um / 1000;
  motion_options.tcp = job.controller.tcp;
  for (std::size_t i = 0; i < passes.size(); ++i) {
    const double share = 1.0 / static_cast<double>(passes.size());
    posting.motions.push_back(plan_motion(posting.machine, posting.setup, passes[i], motion_options, monitor.part(share * i, share * (i + 1))));
  }
  return posting;
}

/// What the programs have for a pass, in one of them or in parts.
ProgramFigures figures_of(const std::vector<Program>& programs, const std::string& pass) {
  ProgramFigures figures;
  for (const Program& program : programs) {
    for (std::size_t k = 0; k < program.passes.size(); ++k) {
      if (program.passes[k] == pass) figures += program.by_pass[k];
    }
  }
  return figures;
}

DataRate rate_of(const MachineModel& machine, const Job& job, const ProgramFigures& figures) {
  // Only grblHAL is fed over the link while it mills; the others run files.
  return data_rate(machine, figures.feed_seconds, figures.bytes, figures.blocks, machine.controller == "grblhal" ? job.stream.baud : 0);
}

/// Would the pass, that starves, not with arcs? Found by writing it.
bool arcs_would_do(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion, ProgramOptions options, const Job& job) {
  if (job.controller.arcs) return false;
  options.arc_tolerance_mm = job.controller.tip_tolerance_um / 1000;
  try {
    const std::vector<Program> programs = write_programs(machine, setup, std::span(&motion, 1), false, options);
    return rate_of(machine, job, figures_of(programs, motion.pass)).starved_share == 0;
  } catch (const InputError&) {
    return false;  // the control has none
  }
}

}  // namespace

void check_posting(const Job& job) { check_program_options(machine_of(job), program_options(job)); }

std::vector<Program> posted_programs(const Job& job, const RunFolder& folder) {
  const Posting posting = plan_posting(job, folder, {});
  return write_programs(posting.machine, posting.setup, posting.motions, job.controller.one_program, posting.options);
}

StageResult run_post(const Job& job, const RunFolder& folder, const Monitor& monitor) {
  // All programs first, then the files: a pass that the machine cannot reach leaves no program behind.
  StageResult result;
  json& report = result.report["postproc"];
  const auto [machine, setup, options, motions] = plan_posting(job, folder, monitor.part(0, 0.7));
  const std::vector<Program> programs = write_programs(machine, setup, motions, job.controller.one_program, options);
  ProgramOptions straight = options;
  straight.arc_tolerance_mm = 0;
  const std::vector<Program> without_arcs =
      job.controller.arcs ? write_programs(machine, setup, motions, job.controller.one_program, straight)
                          : std::vector<Program>();
  monitor.report("programs", 1);
  for (const AxisMotion& motion : motions) {
    const ProgramFigures figures = figures_of(programs, motion.pass);
    json files = json::array();
    for (const Program& program : programs) {
      if (std::find(program.passes.begin(), program.passes.end(), motion.pass) == program.passes.end()) continue;
      files.push_back({{"file", "program/" + program.file_name}, {"sha256", sha256_of_text(program.text)}});
    }
    std::string names;
    for (const json& file : files) names += (names.empty() ? "" : ", ") + file["file"].get<std::string>();
    DataRate rate = rate_of(machine, job, figures);
    if (rate.starved_share > 0 && arcs_would_do(machine, setup, motion, options, job)) rate.remedy += ", or write arcs ([controller] arcs = true)";
    report[motion.pass] = {{"blocks", figures.blocks},
                           {"bytes", figures.bytes},
                           {"max_tip_error_um", std::max(motion.max_tip_error_um, 1e3 * figures.max_arc_error_mm)},
                           {"max_axis_speed_ratio", motion.max_axis_speed_ratio},
                           {"rewinds", motion.rewinds},
                           {"slowed_moves", motion.slowed_moves},
                           {"worst_slowing", motion.worst_slowing},
                           {"worst_slowing_at_mm",
                            {motion.worst_slowing_at_mm.x(), motion.worst_slowing_at_mm.y(), motion.worst_slowing_at_mm.z()}},
                           {"rounding_s", figures.rounding_s},
                           {"worst_rounding", figures.worst_rounding},
                           {"dialect", machine.controller},
                           {"tcp", uses_tcp(machine, motion, options)},
                           {"file", names},
                           {"files", files},
                           {"data_rate",
                            {{"bytes_per_block", rate.bytes_per_block},
                             {"mean_blocks_per_s", rate.mean_blocks_per_s},
                             {"peak_blocks_per_s", rate.peak_blocks_per_s},
                             {"control_blocks_per_s", rate.control_blocks_per_s},
                             {"link_blocks_per_s", rate.link_blocks_per_s},
                             {"starved_share", rate.starved_share},
                             {"remedy", rate.remedy}}}};
    if (job.controller.arcs) {
      const std::size_t straight_bytes = figures_of(without_arcs, motion.pass).bytes;
      report[motion.pass]["arcs"] = {{"count", figures.arcs},
                                     {"max_error_um", 1e3 * figures.max_arc_error_mm},
                                     {"bytes_without", straight_bytes},
                                     {"bytes_saved", static_cast<long long>(straight_bytes) - static_cast<long long>(figures.bytes)}};
    }
  }
  for (const Program& program : programs) {
    write_whole(folder.file("program/" + program.file_name), program.text);
    result.files.push_back("program/" + program.file_name);
  }
  report["setup"] = {{"work_offset", setup.work_offset},
                     {"machine", machine.name},
                     {"machine_notes", machine.notes},
                     {"workpiece_origin_mm", {setup.origin_mm.x(), setup.origin_mm.y(), setup.origin_mm.z()}}};
  return result;
}

}  // namespace lightmill

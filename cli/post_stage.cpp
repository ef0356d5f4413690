#include <algorithm>

#include "cli/digest.h"
#include "cli/stage_runs.h"
#include "design/core/files.h"
#include "postproc/data_rate.h"
#include "postproc/program_parts.h"

namespace lightmill {

using nlohmann::json;

StageResult run_post(const Job& job, const RunFolder& folder, const Monitor& monitor) {
  const std::vector<ToolPath> passes = read_toolpaths(folder.needed("cam/toolpaths.bin", "cam"));
  MachineModel machine = read_machine(job.machine.file);
  machine.controller = job.controller.dialect;
  const WorkSetup setup = work_on_table(machine, job.machine.workpiece_origin_mm, job.machine.work_offset);
  MotionOptions motion_options;
  motion_options.tip_tolerance_mm = job.controller.tip_tolerance_um / 1000;
  motion_options.tcp = job.controller.tcp && machine.has_rotary();
  ProgramOptions options;
  options.decimals = job.controller.decimals;
  options.tcp = job.controller.tcp;
  options.block_numbers = job.controller.block_numbers;
  options.job_name = job.name;
  options.job_hash = making_digest(job).substr(0, 16);

  // All programs first, then the files: a pass that the machine cannot reach leaves no program behind.
  StageResult result;
  json& report = result.report["postproc"];
  std::vector<AxisMotion> motions;
  for (std::size_t i = 0; i < passes.size(); ++i) {
    const double share = 0.7 / static_cast<double>(passes.size());
    motions.push_back(plan_motion(machine, setup, passes[i], motion_options, monitor.part(share * i, share * (i + 1))));
  }
  const std::vector<Program> programs = write_programs(machine, setup, motions, job.controller.one_program, options);
  monitor.report("programs", 1);
  for (const AxisMotion& motion : motions) {
    std::size_t blocks = 0, bytes = 0;
    json files = json::array();
    for (const Program& program : programs) {
      if (std::find(program.passes.begin(), program.passes.end(), motion.pass) == program.passes.end()) continue;
      blocks += program.blocks;
      bytes += program.text.size();
      files.push_back({{"file", "program/" + program.file_name}, {"sha256", sha256_of_text(program.text)}});
    }
    std::string names;
    for (const json& file : files) names += (names.empty() ? "" : ", ") + file["file"].get<std::string>();
    // Only grblHAL is fed over the link while it mills; the others run files.
    const DataRate rate = data_rate(machine, motion, bytes, blocks, machine.controller == "grblhal" ? job.stream.baud : 0);
    report[motion.pass] = {{"blocks", blocks},
                           {"bytes", bytes},
                           {"max_tip_error_um", motion.max_tip_error_um},
                           {"max_axis_speed_ratio", motion.max_axis_speed_ratio},
                           {"rewinds", motion.rewinds},
                           {"slowed_moves", motion.slowed_moves},
                           {"worst_slowing", motion.worst_slowing},
                           {"worst_slowing_at_mm",
                            {motion.worst_slowing_at_mm.x(), motion.worst_slowing_at_mm.y(), motion.worst_slowing_at_mm.z()}},
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

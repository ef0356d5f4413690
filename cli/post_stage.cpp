#include "cli/digest.h"
#include "cli/stage_runs.h"
#include "design/core/files.h"
#include "postproc/program.h"

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
  std::vector<Program> programs;
  for (std::size_t i = 0; i < passes.size(); ++i) {
    const double share = 1.0 / static_cast<double>(passes.size());
    const AxisMotion motion = plan_motion(machine, setup, passes[i], motion_options, monitor.part(share * i, share * (i + 0.7)));
    programs.push_back(write_program(machine, setup, motion, options));
    monitor.report("program of " + passes[i].pass, share * (i + 1));
    const Program& program = programs.back();
    report[passes[i].pass] = {{"blocks", program.blocks},
                              {"bytes", program.text.size()},
                              {"max_tip_error_um", motion.max_tip_error_um},
                              {"max_axis_speed_ratio", motion.max_axis_speed_ratio},
                              {"slowed_moves", motion.slowed_moves},
                              {"worst_slowing", motion.worst_slowing},
                              {"worst_slowing_at_mm",
                               {motion.worst_slowing_at_mm.x(), motion.worst_slowing_at_mm.y(), motion.worst_slowing_at_mm.z()}},
                              {"dialect", machine.controller},
                              {"tcp", uses_tcp(machine, motion, options)},
                              {"file", "program/" + program.file_name},
                              {"sha256", sha256_of_text(program.text)}};
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

// How fast the post-processor is: a 600,000-move 3+2 pass and a simultaneous one, user CPU seconds.
#include <cstdio>
#include <ctime>

#include "postproc/program.h"
#include "postproc/program_check.h"
#include "tests/postproc/support.h"

namespace {

using namespace lightmill;

double cpu_seconds() {
  return double(std::clock()) / CLOCKS_PER_SEC;
}

void measure(const std::string& what, const MachineModel& machine, const WorkSetup& setup, const ToolPath& path,
             bool tcp = false, bool arcs = false) {
  MotionOptions motion_options;
  motion_options.tcp = tcp;
  ProgramOptions options;
  options.decimals = machine.controller == "grblhal" ? 5 : 4;
  options.tcp = tcp;
  if (arcs) options.arc_tolerance_mm = motion_options.tip_tolerance_mm;
  const double t0 = cpu_seconds();
  const AxisMotion motion = plan_motion(machine, setup, path, motion_options);
  const double t1 = cpu_seconds();
  const Program program = write_program(machine, setup, motion, options);
  const double t2 = cpu_seconds();
  const auto faults = check_program_text(machine, setup, motion, program.text, options);
  const double t3 = cpu_seconds();
  std::printf("%s: %zu moves -> %zu axis moves, %zu blocks, %.1f MB (%.1f bytes/block)\n", what.c_str(),
              path.moves.size(), motion.moves.size(), program.blocks, program.text.size() / 1e6,
              double(program.text.size()) / double(program.blocks));
  std::printf("  plan %.2f s, write with its check %.2f s, check alone %.2f s (%zu faults): %.0f blocks/s\n", t1 - t0,
              t2 - t1, t3 - t2, faults.size(), double(program.blocks) / (t2 - t0));
  std::printf("  tip error %.3f um, axis speed ratio %.3f, slowed moves %zu\n", motion.max_tip_error_um,
              motion.max_axis_speed_ratio, motion.slowed_moves);
  if (arcs) std::printf("  %zu arcs, %.3f um from the straight moves\n", program.arcs, 1e3 * program.max_arc_error_mm);
}

}  // namespace

int main() {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {12, -17, 30}, 54);
  measure("3+2 finish", machine, setup, test::fixed_rows(30 * test::kDeg, 70 * test::kDeg, 600, 1000, 90));
  measure("3+2 finish, arcs", machine, setup, test::fixed_rows(30 * test::kDeg, 70 * test::kDeg, 600, 1000, 90), false,
          true);
  const ToolPath turning = test::lead_rows(20 * test::kDeg, 250, 400, 40);
  measure("lead/tilt finish, 40 mm lens", machine, setup, turning);
  for (const DialectFacts& dialect : dialects()) {
    if (!dialect.tcp) continue;
    MachineModel other = machine;
    other.controller = dialect.name;
    other.has_tcp = true;
    measure("the same, " + dialect.name + ", tool-centre-point control", other, setup, turning, true);
  }
}

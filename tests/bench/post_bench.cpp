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

void measure(const char* what, const MachineModel& machine, const WorkSetup& setup, const ToolPath& path) {
  const double t0 = cpu_seconds();
  const AxisMotion motion = plan_motion(machine, setup, path);
  const double t1 = cpu_seconds();
  const Program program = write_program(machine, setup, motion);
  const double t2 = cpu_seconds();
  const auto faults = check_program_text(machine, setup, motion, program.text);
  const double t3 = cpu_seconds();
  std::printf("%s: %zu moves -> %zu axis moves, %zu blocks, %.1f MB (%.1f bytes/block)\n", what, path.moves.size(),
              motion.moves.size(), program.blocks, program.text.size() / 1e6,
              double(program.text.size()) / double(program.blocks));
  std::printf("  plan %.2f s, write with its check %.2f s, check alone %.2f s (%zu faults)\n", t1 - t0, t2 - t1,
              t3 - t2, faults.size());
  std::printf("  tip error %.3f um, axis speed ratio %.3f, slowed moves %zu\n", motion.max_tip_error_um,
              motion.max_axis_speed_ratio, motion.slowed_moves);
}

}  // namespace

int main() {
  const MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {12, -17, 30}, 54);
  measure("3+2 finish", machine, setup, test::fixed_rows(30 * test::kDeg, 70 * test::kDeg, 600, 1000, 90));
  measure("lead/tilt finish, 40 mm lens", machine, setup, test::lead_rows(20 * test::kDeg, 250, 400, 40));
}

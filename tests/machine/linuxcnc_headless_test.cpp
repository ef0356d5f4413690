// LinuxCNC itself, headless, against the plan: its trunnion kinematics must bring the joints where ours do. Slow, so only on
// request: LIGHTMILL_LINUXCNC=1.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <sstream>

#include "design/core/files.h"
#include "design/core/text.h"
#include "tests/postproc/programs.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

TEST(LinuxCncHeadless, ItsKinematicsGiveThePlannedJoints) {
  if (std::getenv("LIGHTMILL_LINUXCNC") == nullptr) GTEST_SKIP() << "on request only: LIGHTMILL_LINUXCNC=1";
  const MachineModel machine =
      read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/trunnion_linuxcnc.toml");
  const WorkSetup setup = work_on_table(machine, {23, -17, 30}, 54);
  ToolPath path = test::lead_rows(20 * test::kDeg, 2, 6);
  MotionOptions guided;
  guided.tcp = true;
  test::Made made{machine, setup, path, plan_motion(machine, setup, path, guided), test::with_decimals(6), {}};
  made.options.tcp = true;
  made.program = write_program(machine, setup, made.motion, made.options);

  // A pause after every block under tool-centre-point control, so that a sample finds it at its end.
  std::string text;
  bool on = false;
  for (const std::string& line : test::lines_of(made.program.text)) {
    text += line + "\n";
    if (line == "M428" || line == "M429") on = line == "M428";
    if (on && line != "M428") text += "G4 P0.1\n";
  }
  const test::ScratchFolder folder;
  write_whole(folder / "in.ngc", text);
  const Cutter& cutter = path.cutter;
  write_whole(folder / "in.tbl", "T" + std::to_string(cutter.number) + " P1 Z" + fixed(cutter.length_mm, 6) + " D" +
                                     fixed(cutter.diameter_mm, 4) + "\n");
  const Vec3& zero = setup.origin_mm;
  const std::string command = "'" LIGHTMILL_SOURCE_DIR "/tests/linuxcnc/headless.sh' '" + (folder / "in.ngc").string() +
                              "' 'G10 L2 P1 X" + fixed(zero.x(), 6) + " Y" + fixed(zero.y(), 6) + " Z" +
                              fixed(zero.z(), 6) + "' '" + (folder / "in.tbl").string() + "' '" +
                              (folder / "run").string() + "'";
  const int status = std::system(command.c_str());
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  if (code == 77) GTEST_SKIP() << "LinuxCNC is not installed";
  ASSERT_EQ(code, 0) << read_whole(folder / "run/linuxcnc.log");

  std::vector<std::array<double, 5>> heard;
  for (const std::string& line : test::lines_of(read_whole(folder / "run/joints.txt"))) {
    std::istringstream in(line);
    long number = 0;
    std::array<double, 5> q{};
    in >> number >> q[0] >> q[1] >> q[2] >> q[3] >> q[4];
    heard.push_back(q);
  }
  std::size_t from = 0, cuts = 0;
  double worst = 0;
  for (const AxisMove& move : made.motion.moves) {
    if (move.kind == MoveKind::kRapid) continue;
    const JointPosition& j = move.joints;
    const std::array<double, 5> want{j.x_mm, j.y_mm, j.z_mm, j.outer_rad / test::kDeg, j.inner_rad / test::kDeg};
    double best = 1e9;
    std::size_t at = from;
    for (std::size_t i = from; i < heard.size(); ++i) {
      double off = 0;
      for (std::size_t k = 0; k < 5; ++k) off = std::max(off, std::abs(heard[i][k] - want[k]));
      if (off < best) best = off, at = i;
    }
    EXPECT_LT(best, 2e-5) << "mm or degrees, at cut " << cuts;
    worst = std::max(worst, best);
    from = at;
    ++cuts;
  }
  EXPECT_GT(cuts, 100u);
  std::printf("%zu block ends, joints within %.1e mm or degrees\n", cuts, worst);
}

}  // namespace
}  // namespace lightmill

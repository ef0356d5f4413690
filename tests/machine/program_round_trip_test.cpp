// What postproc writes for a control, the machine's own reader understands as planned; the two share no code.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "machine/program_reader.h"
#include "postproc/program.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

struct Case {
  std::string controller;
  bool turning;
};

class ProgramRoundTrip : public testing::TestWithParam<Case> {};

TEST_P(ProgramRoundTrip, EveryPlannedMoveArrivesInItsTime) {
  MachineModel machine = test::hostile_machine();
  machine.controller = GetParam().controller;
  const WorkSetup work = work_on_table(machine, {23, -17, 30}, 55);
  const double degree = test::kDeg;
  const ToolPath path = GetParam().turning ? test::lead_rows(20 * degree, 2, 12)
                                           : test::fixed_rows(30 * degree, 70 * degree, 3, 20);
  const AxisMotion motion = plan_motion(machine, work, path);
  ProgramOptions options;
  options.decimals = 4;
  const Program program = write_program(machine, work, motion, options);

  ReaderSetup setup;
  setup.offsets[1] = {work.origin_mm.x(), work.origin_mm.y(), work.origin_mm.z(), 0, 0};
  setup.tool_length_mm = {{path.cutter.number, path.cutter.length_mm}};
  std::vector<ProgramStep> moves;
  bool turns = false;  // the spindle
  const ReadResult result =
      read_program(program.text, reader_dialect(machine.controller), machine, setup, [&](const ProgramStep& step) {
        if (step.kind == ProgramStep::kSpindle) turns = step.number == 3 && step.rpm == motion.spindle_rpm;
        if (step.kind != ProgramStep::kMove) return;
        if (!step.rapid) {
          EXPECT_TRUE(turns) << "line " << step.line;
        }
        moves.push_back(step);
      });
  ASSERT_FALSE(result.error) << "line " << result.error->line << ": " << result.error->rule;
  EXPECT_TRUE(result.ended);

  std::size_t next = 0;
  double seconds = 0;
  double planned = 0;
  for (const ProgramStep& step : moves) {
    if (!step.rapid) seconds += step.seconds;
    if (next == motion.moves.size()) continue;
    const AxisMove& move = motion.moves[next];
    const AxisValues want{move.joints.x_mm, move.joints.y_mm, move.joints.z_mm, move.joints.outer_rad,
                          move.joints.inner_rad};
    double worst = 0;
    for (std::size_t axis = 0; axis < want.size(); ++axis) worst = std::max(worst, std::abs(step.target[axis] - want[axis]));
    if (worst > 6e-5) continue;  // on the way: over the top, or a block that turns before it moves
    EXPECT_EQ(step.rapid, move.kind == MoveKind::kRapid) << "line " << step.line;
    planned += move.seconds;
    ++next;
  }
  EXPECT_EQ(next, motion.moves.size()) << "the plan does not arrive whole";
  EXPECT_GE(seconds, planned * (1 - 1e-5)) << "feeds are rounded down; only the ends' four decimals may shorten a way";
  EXPECT_LE(seconds, planned * 1.01);
}

INSTANTIATE_TEST_SUITE_P(Controls, ProgramRoundTrip,
                         testing::Values(Case{"linuxcnc", false}, Case{"linuxcnc", true}, Case{"fanuc", false},
                                         Case{"fanuc", true}),
                         [](const auto& it) { return it.param.controller + (it.param.turning ? "_turning" : "_fixed"); });

}  // namespace
}  // namespace lightmill

#include "postproc/program_parts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "design/core/errors.h"
#include "postproc/program_check.h"
#include "tests/postproc/programs.h"

namespace lightmill {
namespace {

using test::kDeg;
using testing::HasSubstr;
using testing::IsEmpty;

struct Job {
  MachineModel machine;
  WorkSetup setup;
  std::vector<AxisMotion> passes;
  ProgramOptions options;
};

Job job_for(const std::string& controller, bool tcp) {
  Job job;
  job.machine = test::hostile_machine();
  job.machine.controller = controller;
  job.machine.has_tcp = tcp;
  job.setup = work_on_table(job.machine, {23, -17, 30}, 54);
  job.options = test::with_decimals(4);
  job.options.tcp = tcp;
  ToolPath rough = test::fixed_rows(0.1, 1, 3, 40);
  rough.pass = "rough";
  rough.cutter.number = 1;
  job.passes.push_back(plan_motion(job.machine, job.setup, rough));
  job.passes.push_back(plan_motion(job.machine, job.setup, test::fixed_rows(30 * kDeg, 70 * kDeg, 12, 60)));
  return job;
}

TEST(WriteParts, TheMovesAreTheWholesAndEachPartStandsAlone) {
  for (const char* controller : {"grblhal", "linuxcnc", "fanuc", "siemens", "heidenhain"}) {
    Job job = job_for(controller, std::string(controller) != "grblhal");
    const AxisMotion& finish = job.passes[1];
    const Program whole = write_program(job.machine, job.setup, finish, job.options);
    job.machine.max_program_bytes = whole.text.size() / 4;
    const auto programs = write_programs(job.machine, job.setup, job.passes, false, job.options);
    ASSERT_GT(programs.size(), 4u) << controller;
    const auto is_finish = [](const Program& program) { return program.passes.front() == "finish"; };
    const auto parts = std::count_if(programs.begin(), programs.end(), is_finish);
    std::size_t part = 0;
    for (const Program& program : programs) {
      EXPECT_LE(program.text.size(), job.machine.max_program_bytes) << program.file_name;
      if (!is_finish(program)) continue;
      ++part;
      EXPECT_THAT(program.file_name,
                  testing::ContainsRegex("_" + std::to_string(part) + "[oO][fF]" + std::to_string(parts)));
    }
    EXPECT_EQ(static_cast<long>(part), parts);
  }
}

// The parts' motions end to end are the whole's, but for the approaches.
TEST(WriteParts, NothingIsLostBetweenParts) {
  const Job job = job_for("grblhal", false);
  const AxisMotion& whole = job.passes[1];
  std::vector<AxisMove> joined;
  for (std::size_t begin = 0; begin < whole.moves.size(); begin += 100) {
    const AxisMotion part = part_of(job.machine, whole, begin, std::min(begin + 100, whole.moves.size()));
    joined.insert(joined.end(), part.moves.begin() + (begin > 0 ? 1 : 0), part.moves.end());
    EXPECT_EQ(part.moves.front().joints.z_mm, job.machine.retract_z_mm);
  }
  ASSERT_EQ(joined.size(), whole.moves.size());
  for (std::size_t i = 0; i < joined.size(); ++i) {
    EXPECT_EQ(joined[i].joints.x_mm, whole.moves[i].joints.x_mm);
    EXPECT_EQ(joined[i].seconds, whole.moves[i].seconds);
  }
}

TEST(WriteParts, NoRetractInTimeIsRefusedWithThePlace) {
  Job job = job_for("grblhal", false);
  job.machine.max_program_bytes = 2500;
  try {
    write_programs(job.machine, job.setup, std::span(&job.passes[1], 1), false, job.options);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("finish: the control takes programs of 2 kB"));
    EXPECT_THAT(e.what(), HasSubstr("from move 1 of"));
  }
}

// One program for both has the same feed moves in either pass as a program each; head and end are shared.
TEST(WriteParts, FiguresAreOfEachPass) {
  for (const char* controller : {"fanuc", "siemens", "heidenhain", "heidenhain_iso"}) {
    const Job job = job_for(controller, true);
    const Program one = write_programs(job.machine, job.setup, job.passes, true, job.options).at(0);
    const auto each = write_programs(job.machine, job.setup, job.passes, false, job.options);
    ASSERT_EQ(one.by_pass.size(), 2u);
    for (std::size_t k = 0; k < 2; ++k) {
      EXPECT_EQ(one.by_pass[k].feed_seconds, each[k].feed_seconds) << controller;
      EXPECT_LT(one.by_pass[k].blocks, each[k].blocks) << controller;
      EXPECT_NEAR(static_cast<double>(one.by_pass[k].bytes), static_cast<double>(each[k].bytes), 0.3 * static_cast<double>(each[k].bytes)) << controller;
    }
    EXPECT_EQ(one.by_pass[0].blocks + one.by_pass[1].blocks, one.blocks);
    EXPECT_EQ(one.by_pass[0].bytes + one.by_pass[1].bytes, one.text.size());
  }
}

TEST(WriteParts, OneProgramForAllWhileItFits) {
  Job job = job_for("fanuc", true);
  const auto one = write_programs(job.machine, job.setup, job.passes, true, job.options);
  ASSERT_EQ(one.size(), 1u);
  EXPECT_THAT(one[0].passes, testing::ElementsAre("rough", "finish"));
  EXPECT_EQ(one[0].file_name, "00_whole.nc");
  EXPECT_THAT(check_program_text(job.machine, job.setup, job.passes, one[0].text, job.options), IsEmpty());
  job.machine.max_program_bytes = one[0].text.size() - 1;
  EXPECT_EQ(write_programs(job.machine, job.setup, job.passes, true, job.options).size(), 2u);
}

}  // namespace
}  // namespace lightmill

#include "machine/program_schedule.h"

#include <gtest/gtest.h>

#include "machine/motion_timing.h"
#include "machine/program_lines.h"
#include "machine/program_run.h"
#include "tests/machine/resume_matrix.h"
#include "tests/postproc/programs.h"

namespace lightmill {
namespace {

/// What the dry run's timer makes of the program that the simulated machine hears.
double dry_run_seconds(const test::Shop& shop, const std::string& text) {
  SimulatedMachine machine(shop.machine, shop.setup, test::no_stock());
  MotionTimer timer(shop.machine);
  machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
    timer.move(motion, pieces.front(), pieces.back());
  };
  for (const ProgramLine& line : program_lines(text)) {
    machine.receive(std::string(line.text) + "\n");
    machine.work(1);
    machine.receive("~");
  }
  timer.finish();
  double seconds = 0;
  for (const SectionTiming& section : timer.sections()) seconds += section.timing.seconds;
  return seconds;
}

TEST(ProgramSchedule, IsTheDryRunsTime) {
  const test::Written w = test::written(test::lead_rows(20 * test::kDeg, 2, 6));
  const ProgramSchedule schedule = schedule_program(w.shop.machine, w.shop.setup, "grblhal", w.text);
  EXPECT_EQ(schedule.until_s.size(), program_lines(w.text).size());
  EXPECT_NEAR(schedule.total_s(), dry_run_seconds(w.shop, w.text), 1e-9);
  double before = 0;
  for (std::size_t i = 0; i < schedule.until_s.size(); ++i) {
    EXPECT_GE(schedule.until_s[i], before);
    before = schedule.until_s[i];
    EXPECT_EQ(schedule.at(static_cast<long>(i) + 1), before);
  }
  EXPECT_EQ(schedule.at(0), 0);
  EXPECT_EQ(schedule.at(1'000'000), schedule.total_s());
}

TEST(ProgramSchedule, OfAFileIsThatOfItsRun) {
  for (const bool tcp : {false, true}) {
    const test::Made made = test::make_for("siemens", true, tcp);
    test::Shop shop = test::shop_on(made.machine, made.setup);
    const ProgramSchedule schedule = schedule_program(shop.machine, shop.setup, "siemens", made.program.text);
    StockOptions coarse;
    coarse.pitch_mm = 2;
    double seconds = 0;
    for (const SectionTiming& section :
         run_programs(shop.machine, ReaderDialect::kSiemens, shop.setup, {{"p", made.program.text}}, coarse).timing) {
      seconds += section.timing.seconds;
    }
    EXPECT_NEAR(schedule.total_s(), seconds, 1e-6 * seconds);
  }
}

// A dwell belongs to the line behind it, not to the whole program.
TEST(ProgramSchedule, LinesTakeTheirOwnTime) {
  const std::string text = "G21 G90 G94\nG1 X10 F600\nG4 P7\nG1 X20\nM2\n";
  const ProgramSchedule schedule = schedule_program(test::skew_machine(), test::skew_setup(), "grblhal", text);
  ASSERT_EQ(schedule.until_s.size(), 5U);
  EXPECT_EQ(schedule.until_s[0], 0);
  EXPECT_NEAR(schedule.until_s[1], 2, 0.1) << "the workpiece's X10 is 20 mm from where the axis stands";
  EXPECT_NEAR(schedule.until_s[3] - schedule.until_s[1], 7 + 1, 0.1);
  EXPECT_EQ(schedule.until_s[4], schedule.until_s[3]);
}

TEST(PaceEstimate, LearnsTheActualPace) {
  PaceEstimate pace;
  pace.observe(0, 0, true);
  EXPECT_EQ(pace.factor(), 1) << "the schedule is believed first";
  double scheduled = 0, now = 0;
  for (int i = 0; i < 2400; ++i) pace.observe(scheduled += 0.25, now += 0.5, true);
  EXPECT_NEAR(pace.factor(), 2, 0.05) << "half as quick";
  // Time in which somebody held the machine says nothing.
  for (int i = 0; i < 1000; ++i) pace.observe(scheduled, now += 1, false);
  EXPECT_NEAR(pace.factor(), 2, 0.05);
  // An override to twice the feed is learned within some minutes.
  for (int i = 0; i < 2400; ++i) pace.observe(scheduled += 0.5, now += 0.5, true);
  EXPECT_NEAR(pace.factor(), 1, 0.05);
}

}  // namespace
}  // namespace lightmill

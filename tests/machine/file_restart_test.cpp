// Restarts of programs that controls run as files, in every dialect, with and without tool-centre-point control.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "machine/kinematics.h"
#include "machine/program_lines.h"
#include "machine/program_run.h"
#include "machine/restart.h"
#include "tests/machine/resume_matrix.h"
#include "tests/postproc/programs.h"

namespace lightmill {
namespace {

using testing::HasSubstr;

struct Case {
  std::string dialect;
  bool turning, tcp;
};

void PrintTo(const Case& c, std::ostream* out) {
  *out << c.dialect << (c.turning ? ", five axes" : ", 3+2") << (c.tcp ? ", tcp" : "");
}

struct Set {
  test::Shop shop;
  std::string text;
  RestartOptions options;
  [[nodiscard]] std::vector<ProgramLine> lines() const { return program_lines(text); }
  [[nodiscard]] Restart restart(long line) const { return write_restart(shop.machine, shop.setup, text, line, options); }
};

Set set_for(const Case& c, const MachineModel& base = test::hostile_machine()) {
  MachineModel machine = base;
  machine.controller = c.dialect;
  machine.has_tcp = c.tcp;
  const WorkSetup work = work_on_table(machine, {23, -17, 30}, 54);
  ProgramOptions options = test::with_decimals(4);
  options.tcp = c.tcp;
  ToolPath path = test::with_long_flutes(c.turning ? test::lead_rows(20 * test::kDeg, 2, 5)
                                                   : test::fixed_rows(30 * test::kDeg, 70 * test::kDeg, 2, 12));
  path.spindle_rpm = std::min(path.spindle_rpm, machine.max_spindle_rpm);
  Set set{test::shop_on(machine, work), write_program(machine, work, plan_motion(machine, work, path), options).text, {}};
  set.options.dialect = c.dialect;
  set.options.program_name = "30_finish.nc";
  return set;
}

/// Lines all over the program, every one of its head.
std::vector<long> lines_to_try(const Set& set, std::size_t step) {
  std::vector<long> numbers;
  const auto lines = set.lines();
  for (std::size_t i = 0; i < lines.size(); i += i < 45 || i + 10 > lines.size() ? 3 : step) numbers.push_back(lines[i].number);
  return numbers;
}

class FileRestart : public testing::TestWithParam<Case> {};

TEST_P(FileRestart, IsSafeAndGoesOnAsTheProgram) {
  const Set set = set_for(GetParam());
  const ReaderSetup reader = reader_setup(set.shop.machine, set.shop.setup);
  WorkpieceView view(set.shop.machine, set.shop.setup.workpiece_origin_mm);
  const double top = set.shop.machine.retract_z_mm;
  int written = 0;
  for (const long line : lines_to_try(set, 60)) {
    SCOPED_TRACE("restart at line " + std::to_string(line));
    // Places, modes, feeds and the whole tail are compared before it is returned.
    const Restart restart = set.restart(line);
    EXPECT_LE(restart.first_line, line);
    if (restart.entry_lines == 0) {
      EXPECT_EQ(restart.text, set.text);
      continue;
    }
    ++written;
    AxisValues from = reader.start;
    bool spindle = false, ready = false;
    int feeds = 0;
    read_program(restart.text, reader_dialect(set.options.dialect), set.shop.machine, reader, [&](const ProgramStep& step) {
      if (step.line > restart.entry_lines) return;
      if (step.kind == ProgramStep::kSpindle) spindle = step.number == 3;
      if (step.kind == ProgramStep::kDwell) ready = spindle && step.seconds >= set.shop.machine.spindle_start_s;
      if (step.kind != ProgramStep::kMove) return;
      const auto differ = [&](int a, int b) { return std::abs(step.target[a] - from[a]) > 1e-3 || std::abs(step.target[b] - from[b]) > 1e-3; };
      if (differ(3, 4) || (step.rapid && differ(0, 1))) {
        EXPECT_NEAR(from[2], top, 1e-9) << "turns and crosses at the machine's top only";
        EXPECT_NEAR(step.target[2], top, 1e-9);
      }
      const auto tip = [&](const AxisValues& q) { return view.cutter({q[0], q[1], q[2], q[3], q[4]}, restart.tool_length_mm); };
      const Vec3 way = tip(step.target).tip_mm - tip(from).tip_mm;
      if (!step.rapid && way.norm() > 1e-6) {
        ++feeds;
        EXPECT_TRUE(ready) << "the spindle has had its time";
        EXPECT_LT(way.cross(tip(from).axis).norm(), 1e-3) << "down the tool's axis, to a decimal of the text";
        EXPECT_LE(way.dot(tip(from).axis), 0);
        EXPECT_NEAR(step.seconds, way.norm() / set.options.entry_feed_mm_per_s, 0.01);
      }
      from = step.target;
    });
    EXPECT_LE(feeds, 1);
  }
  EXPECT_GT(written, 3);
}

TEST_P(FileRestart, LeavesNoMark) {
  const Set set = set_for(GetParam());
  StockOptions stock;
  stock.pitch_mm = 0.4;
  const ReaderDialect dialect = reader_dialect(set.options.dialect);
  const ProgramRun whole = run_programs(set.shop.machine, dialect, set.shop.setup, {{"whole", set.text}}, stock);
  ASSERT_TRUE(whole.faults.empty()) << whole.faults.front().message;
  const auto lines = set.lines();
  for (const double share : {0.3, 0.8}) {
    const long line = lines[44 + static_cast<std::size_t>(share * static_cast<double>(lines.size() - 50))].number;
    const Restart restart = set.restart(line);
    ASSERT_GT(restart.entry_lines, 0);
    const RestartTrial trial = try_restart(set.shop.machine, set.shop.setup, stock, {}, set.text, restart, set.options.dialect);
    EXPECT_TRUE(trial.faults.empty()) << trial.faults.front().message;
    EXPECT_GT(trial.seconds, 8) << "the spindle's start alone";
    EXPECT_LT(test::worst_um(whole.surface, trial.surface), 0.05) << "line " << line;
  }
}

INSTANTIATE_TEST_SUITE_P(Dialects, FileRestart,
                         testing::Values(Case{"linuxcnc", true, false}, Case{"linuxcnc", true, true},
                                         Case{"fanuc", true, false}, Case{"fanuc", false, true},
                                         Case{"fanuc", true, true}, Case{"siemens", true, false},
                                         Case{"siemens", true, true}, Case{"heidenhain", true, false},
                                         Case{"heidenhain", true, true}, Case{"heidenhain_iso", false, false},
                                         Case{"heidenhain_iso", true, true}));

// The way up of a head that leans would cut: the restart backs out along the tool's axis before anything else.
TEST(FileRestartOnAHead, BacksOutAlongTheToolsAxis) {
  MachineModel head = read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/head_table_siemens840d.toml");
  head.max_spindle_rpm = 36000;
  const Set set = set_for({"siemens", true, true}, head);
  const auto lines = set.lines();
  const long line = lines[lines.size() / 2].number;
  const Restart restart = set.restart(line);
  EXPECT_NEAR(restart.backs_out_mm, set.options.back_out_mm, 1e-9);
  EXPECT_THAT(restart.text, HasSubstr("G91\nG1 X"));
  StockOptions stock;
  stock.pitch_mm = 0.4;
  const ProgramRun whole = run_programs(head, ReaderDialect::kSiemens, set.shop.setup, {{"whole", set.text}}, stock);
  const RestartTrial trial = try_restart(set.shop.machine, set.shop.setup, stock, {}, set.text, restart, "siemens");
  EXPECT_TRUE(trial.faults.empty()) << trial.faults.front().message;
  EXPECT_LT(test::worst_um(whole.surface, trial.surface), 0.05);
}

TEST(FileRestartText, HeidenhainBlocksCountAndNamesAreTheFiles) {
  const Set set = set_for({"heidenhain", true, true});
  const auto lines = set.lines();
  const Restart restart = set.restart(lines[lines.size() / 2].number);
  EXPECT_THAT(restart.text, HasSubstr("BEGIN PGM 30_FINISH_R MM"));
  EXPECT_THAT(restart.text, HasSubstr("END PGM 30_FINISH_R MM"));
  EXPECT_THAT(restart.text, HasSubstr("DL-2"));
}

TEST(FileRestartText, WhatCannotBeWrittenIsSaid) {
  Set set = set_for({"linuxcnc", false, false});
  const auto refused = [&](const std::string& text, long line, const std::string& why) {
    try {
      write_restart(set.shop.machine, set.shop.setup, text, line, set.options);
      FAIL() << why;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr(why));
    }
  };
  const std::string head = "G21 G90 G54\nG53 G0 Z0\nT3 M6\nG43 H3\nS9000 M3\nG4 P9\nG0 X0 Y0\nG0 Z20\nG1 Z12 F300\nX5\nX6\n";
  refused(set.text, 0, "not in the program");
  refused(set.text, 100000, "not in the program");
  refused(head + "O1 repeat [3]\nG91 G1 X1\nG90\nO1 endrepeat\nG1 X9\nX10\nM2\n", 16, "variables");
  refused("G20" + head.substr(3) + "M2\n", 11, "inches");
  refused(head + "G9.9\nX0.3\nM2\n", 13, "a control would stop there");
}

}  // namespace
}  // namespace lightmill

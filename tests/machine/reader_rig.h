// Programs read on a machine that is hostile to mix-ups.
#pragma once

#include <gtest/gtest.h>

#include "machine/kinematics.h"
#include "machine/program_reader.h"
#include "machine_rig.h"

namespace lightmill::test {

inline constexpr double kRad = kPi / 180;

struct Reading {
  ReadResult result;
  std::vector<ProgramStep> steps, moves;  ///< moves: the programmed points
};

inline Reading read(const std::string& text, ReaderDialect dialect = ReaderDialect::kLinuxCnc,
                    long most_blocks = 100000, const MachineModel& machine = skew_machine()) {
  ReaderSetup setup;
  setup.offsets[0] = {10, -5, -400, 0, 0};
  setup.tool_length_mm = {{1, 80}, {3, 85}};
  setup.tool_diameter_mm = {{1, 4}};
  setup.most_blocks = most_blocks;
  Reading reading;
  reading.result = read_program(text, dialect, machine, setup, [&](const ProgramStep& step) {
    reading.steps.push_back(step);
    if (step.kind == ProgramStep::kMove && step.whole) reading.moves.push_back(step);
  });
  return reading;
}

inline void expect_refused(const std::string& text, const std::string& rule, long line,
                           ReaderDialect dialect = ReaderDialect::kLinuxCnc) {
  const Reading r = read(text, dialect);
  ASSERT_TRUE(r.result.error) << text;
  EXPECT_NE(r.result.error->rule.find(rule), std::string::npos) << text << ": " << r.result.error->rule;
  EXPECT_EQ(r.result.error->line, line) << text;
  EXPECT_GE(r.result.error->column, 1);
}

/// What a step's axes mean to the work: tip and axis of the cutter.
inline ToolPose pose_of(const ProgramStep& step, double length_mm, const MachineModel& machine = skew_machine()) {
  WorkpieceView view(machine, {10, -5, -400});
  const AxisValues& q = step.target;
  return view.cutter({q[0], q[1], q[2], q[3], q[4]}, length_mm);
}

/// The same steps, however they were written: places, times, kinds.
inline void expect_same_steps(const Reading& a, const Reading& b) {
  ASSERT_FALSE(a.result.error) << a.result.error->line << ": " << a.result.error->rule;
  ASSERT_FALSE(b.result.error) << b.result.error->line << ": " << b.result.error->rule;
  ASSERT_EQ(a.steps.size(), b.steps.size());
  for (std::size_t i = 0; i < a.steps.size(); ++i) {
    EXPECT_EQ(a.steps[i].kind, b.steps[i].kind) << i;
    EXPECT_EQ(a.steps[i].rapid, b.steps[i].rapid) << i;
    EXPECT_NEAR(a.steps[i].seconds, b.steps[i].seconds, 1e-9) << i;
    for (std::size_t k = 0; k < 5; ++k) EXPECT_NEAR(a.steps[i].target[k], b.steps[i].target[k], 1e-9) << i;
  }
}

}  // namespace lightmill::test

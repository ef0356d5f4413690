#include "machine/program_trace.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "design/core/text.h"
#include "postproc/program.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

struct Job {
  MachineModel machine;
  OperatorSetup setup;
  std::vector<std::string> lines;
};

Job rows_for(const std::string& controller) {
  Job job;
  job.machine = test::hostile_machine();
  job.machine.controller = controller;
  const WorkSetup work = work_on_table(job.machine, {23, -17, 30}, 54);
  job.setup.cutters = {test::ball()};
  job.setup.blank.size_mm = {30, 26};
  job.setup.blank.height_mm = 15;
  job.setup.workpiece_origin_mm = work.origin_mm;
  ProgramOptions options;
  options.decimals = 4;
  const std::string text = write_program(job.machine, work, plan_motion(job.machine, work, test::fixed_rows(15 * test::kDeg, 70 * test::kDeg, 2, 6, 16)), options).text;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = text.find('\n', at);
    job.lines.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return job;
}

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

constexpr double kPitch_mm = 0.2;

MachinedSurface milled(const Job& job) {
  StockOptions stock;
  stock.pitch_mm = kPitch_mm;
  return run_programs(job.machine, ReaderDialect::kLinuxCnc, job.setup, {{"30_finish.ngc", joined(job.lines)}}, stock).surface;
}

// The line that was made to cut too deep is named as the maker of the deepest gouge, and the tip stands over it at that line.
TEST(MakerOf, TheDeepestGougeNamesTheLineThatCutIt) {
  const Job clean = rows_for("linuxcnc");
  const MachinedSurface as_it_should_be = milled(clean);
  std::size_t first = 0;
  while (clean.lines[first].find("F1080") == std::string::npos) ++first;
  for (const std::size_t k : {2U, 4U}) {
    Job job = clean;
    std::string& line = job.lines[first + k];
    const std::size_t z = line.find('Z');
    ASSERT_NE(z, std::string::npos) << line;
    const std::size_t end = std::min(line.find(' ', z), line.size());
    line.replace(z, end - z, "Z" + compact(std::strtod(line.c_str() + z + 1, nullptr) - 0.3, 4));
    const MachinedSurface surface = milled(job);
    std::size_t deepest = 0;
    double gouge = 0;
    for (std::size_t i = 0; i < surface.heights_mm.values.size(); ++i) {
      const double depth = as_it_should_be.heights_mm.values[i] - surface.heights_mm.values[i];
      if (depth > gouge) {
        gouge = depth;
        deepest = i;
      }
    }
    ASSERT_GT(gouge, 0.1);
    const auto width = static_cast<std::size_t>(surface.heights_mm.width);
    const Vec2 place = surface.extent.min + kPitch_mm * Vec2(static_cast<double>(deepest % width), static_cast<double>(deepest / width));
    const std::string text = joined(job.lines);
    const auto maker = maker_of(job.machine, job.setup, "linuxcnc", {{"30_finish.ngc", text}}, surface, place);
    ASSERT_TRUE(maker.has_value());
    EXPECT_EQ(maker->program, "30_finish.ngc");
    const auto planted = static_cast<long>(first + k + 1);
    EXPECT_TRUE(maker->line == planted || maker->line == planted + 1) << maker->line << ", planted in " << planted << ", and the way back";
    EXPECT_NEAR(maker->place_mm.z(), surface.heights_mm.values[deepest], 1e-9);
    EXPECT_TRUE(maker->picture.starts_with("<svg"));
    const auto tip = place_of_line(job.machine, job.setup, "linuxcnc", text, planted);
    ASSERT_TRUE(tip.has_value());
    EXPECT_LT((tip->head<2>() - place).norm(), 4);
  }
}

TEST(MakerOf, NobodyMadeWhatNoCutterReaches) {
  const Job job = rows_for("linuxcnc");
  EXPECT_FALSE(maker_of(job.machine, job.setup, "linuxcnc", {{"30_finish.ngc", joined(job.lines)}}, milled(job), {14.5, 12.5}).has_value());
  EXPECT_FALSE(place_of_line(job.machine, job.setup, "linuxcnc", joined(job.lines), 100000).has_value());
}

// Over the wire or as a file, a machine makes the same motions of the same rows.
TEST(TraceProgram, AWireAndAFileTellTheSameWay) {
  std::vector<Vec3> ways[2];
  int at = 0;
  for (const char* controller : {"grblhal", "linuxcnc"}) {
    const Job job = rows_for(controller);
    long last_line = 0;
    trace_program(job.machine, job.setup, controller, joined(job.lines), [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
      EXPECT_GE(motion.line, last_line);
      last_line = motion.line;
      if (!motion.rapid) ways[at].push_back(pieces.back().to.tip_mm);
    });
    EXPECT_LE(last_line, static_cast<long>(job.lines.size()));
    ++at;
  }
  ASSERT_EQ(ways[0].size(), ways[1].size());
  ASSERT_GT(ways[0].size(), 10U);
  for (std::size_t k = 0; k < ways[0].size(); ++k) EXPECT_LT((ways[0][k] - ways[1][k]).norm(), 1e-3) << k;
}

}  // namespace
}  // namespace lightmill

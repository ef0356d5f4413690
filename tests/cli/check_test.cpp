// `lightmill check`: what it tells from the design alone and after planning, and its exit code where a lens cannot be milled.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "command_rig.h"

namespace lightmill::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

CommandResult checked(const fs::path& folder) { return lightmill_command({"check", folder.string()}); }

void edit(const fs::path& file, const std::string& from, const std::string& to) { spill(file, replaced(slurp(file), from, to)); }

std::size_t count_of(const std::string& text, const std::string& what) {
  std::size_t count = 0;
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++count;
  return count;
}

TEST(Check, TellsWhetherALensCanBeMilledFromTheDesignAloneAndAfterwards) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run", job = run / "job.toml";
  ASSERT_EQ(lightmill_command({"make", tiny_job(scratch).string(), "-o", run.string(), "--until", "design", "-q"}).code, 0);

  const CommandResult designed = checked(run);
  EXPECT_EQ(designed.code, 0) << designed.err;
  for (const char* what : {"height", "blank", "enough", "steepest slope", "axis, semi_finish", "axis, finish", "all within 10 to 55 deg", "tightest hollow",
                           "out of reach", "in creases", "elsewhere"}) {
    EXPECT_THAT(designed.out, HasSubstr(what));
  }
  EXPECT_THAT(designed.out, Not(HasSubstr("what wears the edge")));

  // Planned: the same, and the passes; the page tells it, too.
  ASSERT_EQ(lightmill_command({"cam", run.string(), "-q"}).code, 0);
  const CommandResult planned = checked(run);
  EXPECT_EQ(planned.code, 0) << planned.err;
  const std::size_t limits = designed.out.find("axis limits       not looked at");
  ASSERT_NE(limits, std::string::npos) << designed.out;
  EXPECT_TRUE(planned.out.starts_with(designed.out.substr(0, limits))) << planned.out;
  EXPECT_THAT(planned.out, Not(HasSubstr("axis limits")));

  // Paths that this place of the blank cannot reach.
  const std::string reached = slurp(job);
  edit(job, "workpiece_origin_mm = [7.0, -4.0, 0.0]", "workpiece_origin_mm = [150.0, -4.0, 0.0]");
  const CommandResult far = checked(run);
  EXPECT_EQ(far.code, 2);
  EXPECT_THAT(far.out, AllOf(HasSubstr("cannot be milled"), HasSubstr("its limit is")));
  spill(job, reached);
  EXPECT_EQ(count_of(planned.out, "what wears the edge"), 3U);
  const std::string page = slurp(run / "report.html");
  EXPECT_THAT(page, AllOf(HasSubstr("Machinability"), HasSubstr("axis, semi_finish")));
  const auto found = nlohmann::json::parse(slurp(run / "report.json")).at("cam").at("machinability");
  EXPECT_TRUE(found.at("refusals").empty());
  EXPECT_GT(found.at("stock").at("height_mm"), found.at("stock").at("least_mm"));

  // Too low a blank and a tilt that nothing can be cut with, both told.
  const std::string good = slurp(job);
  edit(job, "height_mm = \"auto\"", "height_mm = 4.05");
  edit(job, "tilt_deg = 30.0", "tilt_deg = 80.0");
  const CommandResult refused = checked(run);
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.out, AllOf(HasSubstr("too low"), HasSubstr("no axis of this kind will do"), HasSubstr("less tilt"),
                                 HasSubstr("cannot be milled  the relief is too tall for the blank")));
  EXPECT_EQ(count_of(refused.out, "cannot be milled"), 2U);
  EXPECT_THAT(refused.err, HasSubstr("cannot be milled as the job asks: the relief is too tall"));
  const CommandResult cam = lightmill_command({"cam", run.string(), "-q"});
  EXPECT_EQ(cam.code, 2);
  EXPECT_EQ(count_of(checked(run).out, "cannot be milled"), 2U) << "the reason of `cam` is told twice";

  // What only planning sees: a shank as thick as a wrist, from the last time; forgotten when the job is mended.
  spill(job, good);
  const std::string ball = slurp(fixture("cutters/finish_4mm_ball.toml"));
  spill(run / "fat.toml", replaced(replaced(ball, "shank_diameter_mm = 4.0", "shank_diameter_mm = 60.0"), "flute_length_mm = 6.0", "flute_length_mm = 2.1"));
  edit(job, fixture("cutters/finish_4mm_ball.toml").string(), (run / "fat.toml").string());
  EXPECT_EQ(checked(run).code, 0);
  EXPECT_EQ(lightmill_command({"cam", run.string(), "-q"}).code, 2);
  const CommandResult touching = checked(run);
  EXPECT_EQ(touching.code, 2);
  EXPECT_THAT(touching.out, HasSubstr("would touch"));
  spill(job, good);
  EXPECT_EQ(checked(run).code, 0);
}

}  // namespace
}  // namespace lightmill::test

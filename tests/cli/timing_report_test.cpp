#include "cli/timing_report.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace lightmill {
namespace {

using nlohmann::json;

std::vector<Fault> faults(double commanded_minutes, double planned_minutes, double worst_slowing = 1) {
  const json passes = {{"finish", {{"commanded_minutes", commanded_minutes}, {"program", "30_finish.nc"}, {"line", 28}}}};
  return feed_faults(passes, {{"finish", {{"minutes", planned_minutes}}}}, {{"finish", {{"worst_slowing", worst_slowing}}}});
}

TEST(FeedFaults, AProgramTakesThePlannedTimeAtItsFeeds) {
  EXPECT_TRUE(faults(111.4, 111.2).empty());
  EXPECT_TRUE(faults(1.3, 1.1).empty()) << "the spindle's start and the way to the tool come on top";
  EXPECT_TRUE(faults(150, 100, 1.5).empty()) << "the post had to slow moves";
  EXPECT_TRUE(faults(5, 0).empty()) << "nothing is planned";
}

TEST(FeedFaults, TenTimesAndATenthAreSaidWithProgramAndLine) {
  for (const double factor : {0.1, 0.5, 2.0, 10.0}) {
    const std::vector<Fault> found = faults(factor * 10, 10);
    ASSERT_EQ(found.size(), 1U) << factor;
    EXPECT_EQ(found.front().kind, "feed");
    EXPECT_EQ(found.front().program, "30_finish.nc");
    EXPECT_EQ(found.front().line, 28);
  }
}

TEST(ToolFaults, AProgramCutsWithTheToolsOfItsPassesInTheirOrder) {
  std::map<std::string, Cutter> cutters;
  for (const auto& [pass, number] : {std::pair{"rough", 1}, {"semi_finish", 2}, {"finish", 3}, {"profile", 1}}) cutters[pass].number = number;
  const auto files = [](const char* name) { return json{{"files", {{{"file", std::string("program/") + name}}}}}; };
  const auto cut_with = [](const char* program, std::vector<int> tools) {
    std::vector<ProgramSection> sections;
    long line = 0;
    for (const int tool : tools) {
      ProgramSection section{program, {}};
      section.section.tool = tool;
      section.section.line = line += 100;
      section.section.timing.feed_mm = 1;
      sections.push_back(section);
    }
    return sections;
  };
  const json each = {{"rough", files("10_rough.nc")}, {"finish", files("30_finish.nc")}};
  EXPECT_TRUE(tool_faults(cut_with("10_rough.nc", {1}), cutters, each).empty());
  EXPECT_TRUE(tool_faults(cut_with("other.nc", {7}), cutters, each).empty()) << "nothing is planned for it";
  const std::vector<Fault> swapped = tool_faults(cut_with("30_finish.nc", {2}), cutters, each);
  ASSERT_EQ(swapped.size(), 1U);
  EXPECT_EQ(swapped[0].kind, "wrong_tool");
  EXPECT_EQ(swapped[0].program, "30_finish.nc");
  EXPECT_EQ(swapped[0].line, 100);

  const json all = {{"rough", files("all.nc")}, {"semi_finish", files("all.nc")}, {"finish", files("all.nc")}, {"profile", files("all.nc")}};
  EXPECT_TRUE(tool_faults(cut_with("all.nc", {1, 2, 3, 1}), cutters, all).empty());
  EXPECT_EQ(tool_faults(cut_with("all.nc", {1, 3, 2, 1}), cutters, all).size(), 2U) << "each where the other belongs";
}

}  // namespace
}  // namespace lightmill

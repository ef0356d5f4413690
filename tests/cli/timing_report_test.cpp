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

}  // namespace
}  // namespace lightmill

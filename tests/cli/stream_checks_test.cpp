#include "cli/stream_checks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace lightmill {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

// 500 blocks of 42 bytes a second want 233,334 baud, as in the table of data rates.
TEST(StreamChecks, ASlowLinkIsSaidBeforeTheStart) {
  const json report = {{"postproc",
                        {{"rough", {{"data_rate", {{"bytes_per_block", 30}, {"peak_blocks_per_s", 100}}}}},
                         {"finish", {{"data_rate", {{"bytes_per_block", 42}, {"peak_blocks_per_s", 500}}}}},
                         {"setup", {{"work_offset", 54}}}}}};
  EXPECT_THAT(slow_link(report, 115200), AllOf(HasSubstr("finish wants up to 500 blocks of 42 bytes a second, 233334 baud"),
                                               HasSubstr("this line has 115200"), Not(HasSubstr("rough"))));
  EXPECT_EQ(slow_link(report, 250000), "");
  EXPECT_THAT(slow_link(report, 9600), AllOf(HasSubstr("finish"), HasSubstr("\nrough"))) << "each on a line";
  EXPECT_EQ(slow_link(json::object(), 9600), "");
}

TEST(StreamChecks, TheChecklistNamesToolsAndZero) {
  Job job;
  job.machine.work_offset = 56;
  job.finish.cutter.number = 3;
  job.finish.cutter.name = "ball 4";
  job.finish.cutter.length_mm = 84.25;
  EXPECT_THAT(checklist(job), AllOf(HasSubstr("G56 on the centre"), HasSubstr("T3 ball 4, 84.25 mm"), HasSubstr("guard")));
}

}  // namespace
}  // namespace lightmill

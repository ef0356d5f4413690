#include "cli/program_excerpt.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace lightmill {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr const char* kProgram = "G21\nG90\nT1 M6\nG1 X1 <&\nX2\nX3\nX4\nX5\nM30";

TEST(ProgramExcerpt, ShowsThreeLinesAroundTheOneThatMatters) {
  const std::string picture = program_excerpt(kProgram, 4, "a & b");
  EXPECT_THAT(picture, HasSubstr("<svg"));
  EXPECT_THAT(picture, HasSubstr("a &amp; b"));
  EXPECT_THAT(picture, HasSubstr("G1 X1 &lt;&amp;"));
  EXPECT_THAT(picture, HasSubstr(">G21<"));
  EXPECT_THAT(picture, HasSubstr(">X4<"));
  EXPECT_THAT(picture, Not(HasSubstr(">X5<")));
  EXPECT_THAT(program_excerpt(kProgram, 9, ""), HasSubstr(">M30<")) << "the last line ends without a feed";
}

TEST(ProgramExcerpt, HasNothingToShowBesideTheProgram) {
  EXPECT_EQ(program_excerpt(kProgram, 10, ""), "");
  EXPECT_EQ(program_excerpt("", 1, ""), "");
  EXPECT_THAT(program_excerpt("G1 \x01\xff", 1, ""), HasSubstr("G1 ??"));
}

}  // namespace
}  // namespace lightmill

#include "machine/fault_words.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace lightmill {
namespace {

using ::testing::HasSubstr;

Fault fault_on(long line, long last_line = 0, long worst_line = 0) {
  Fault fault;
  fault.kind = "collision";
  fault.line = line;
  fault.last_line = last_line;
  fault.worst_line = worst_line;
  fault.message = "the holder is 1 mm < 2 mm";
  return fault;
}

TEST(FaultWords, NameTheLinesAndTheWorstOfThem) {
  EXPECT_EQ(lines_in_words(fault_on(0)), "");
  EXPECT_EQ(lines_in_words(fault_on(8)), "line 8");
  EXPECT_EQ(lines_in_words(fault_on(8, 8, 8)), "line 8");
  EXPECT_EQ(lines_in_words(fault_on(8, 12)), "lines 8 to 12");
  EXPECT_EQ(lines_in_words(fault_on(8, 12, 9)), "lines 8 to 12, worst in 9");
  Fault fault = fault_on(8, 12, 9);
  EXPECT_EQ(described(fault), "collision lines 8 to 12, worst in 9: the holder is 1 mm < 2 mm");
  fault.program = "a.nc";
  EXPECT_EQ(heading(fault), "collision in a.nc, lines 8 to 12, worst in 9");
}

TEST(FaultWords, StandOverThePicture) {
  Fault fault = fault_on(8);
  EXPECT_EQ(headed_picture(fault), "");
  fault.picture = "<svg><g/></svg>\n";
  EXPECT_THAT(headed_picture(fault), HasSubstr(">collision line 8</text>"));
  EXPECT_THAT(headed_picture(fault), HasSubstr("1 mm &lt; 2 mm</text>\n</svg>"));
}

// A machine counts what it is sent: no blank lines, no commands, through all programs.
TEST(FaultWords, ASentLinesFaultIsFoundInItsProgram) {
  SentLines sent;
  sent.add("a.nc", "G21\n\n$X\n  \nG90\r\n");
  sent.add("b.nc", "\n(two)\n\nM30");
  Fault fault = fault_on(2);
  locate(fault, sent);
  EXPECT_EQ(heading(fault), "collision in a.nc, line 5");
  fault = fault_on(3, 4, 4);
  locate(fault, sent);
  EXPECT_EQ(heading(fault), "collision in b.nc, lines 2 to 4, worst in 4");
  fault = fault_on(5);
  locate(fault, sent);
  EXPECT_EQ(heading(fault), "collision line 5") << "beyond the programs' end";
}

}  // namespace
}  // namespace lightmill

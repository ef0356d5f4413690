#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <Eigen/Geometry>
#include <cmath>

#include "reader_rig.h"

namespace lightmill {
namespace {

using test::expect_refused;
using test::expect_same_steps;
using test::kRad;
using test::pose_of;
using test::read;
using test::Reading;

TEST(HeidenhainReader, SpeaksInMovesAndCycles) {
  const Reading r = read(
      "0 BEGIN PGM LENS MM\n1 BLK FORM 0.1 Z X-30 Y-30 Z-10\n2 CYCL DEF 247 DATUM SETTING ~\n  Q339=+1\n3 TOOL CALL 3 "
      "Z S20000\n"
      "4 CYCL DEF 32.0 TOLERANCE\n5 CYCL DEF 32.1 T0.003\n6 L Z-1 R0 FMAX M91\n7 L X+0 Y+0 R0 FMAX M3\n8 L Z+30 FMAX\n"
      "9 L X+30 F1000\n10 CC X+0 Y+0\n11 C X+0 Y+30 DR+\n12 CR X+30 Y+0 R+30 DR-\n13 LBL 1\n14 L IX+1\n15 CALL LBL 1 "
      "REP2\n"
      "16 M128\n17 L X+1 Y+2 Z+30 B+10 C-170\n18 L C+170 M126\n19 M129\n20 L Z-1 R0 FMAX M91 M5\n21 END PGM LENS MM\n",
      ReaderDialect::kHeidenhain);
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  EXPECT_TRUE(r.result.ended);
  ASSERT_EQ(r.moves.size(), 12U);
  EXPECT_EQ(r.moves[0].target[2], -1);
  EXPECT_EQ(r.moves[2].target, (AxisValues{10, -5, -400 + 85 + 30, 0, 0}));
  EXPECT_DOUBLE_EQ(r.moves[3].seconds, 1.8);
  EXPECT_EQ(r.moves[8].programmed[0], 33);
  EXPECT_NEAR(r.moves[10].programmed[4], -190 * kRad, 1e-12) << "the short way with M126";
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  const AxisValues& q = r.moves[9].target;
  EXPECT_LT((view.cutter({q[0], q[1], q[2], q[3], q[4]}, 85).tip_mm - Vec3(1, 2, 30)).norm(), 1e-10);

  const auto refused = [](const std::string& middle, const std::string& rule) {
    expect_refused("0 BEGIN PGM A MM\n1 " + middle + "\n2 END PGM A MM\n", rule, 2, ReaderDialect::kHeidenhain);
  };
  refused("L X+1 RL F100", "no diameter");
  refused("L X+1", "feed not given");
  refused("L X1e5 FMAX", "bad number");
  refused("M116", "not understood");
  refused("C X+0 Y+1 DR+ F100", "CC");
  refused("CYCL DEF 200 DRILLING", "needs Q200");
  refused("CYCL DEF 205 PECKING", "cycle 205");
  refused("CALL LBL 7", "not set");
  refused("CALL PGM OTHER", "another file");
  refused("APPR LT X+1 Y+2 LEN5", "APPR needs RL or RR");
  refused("DEP LT LEN5 F100", "DEP needs a path");
  refused("RND R2", "RND");
  refused("L X+Q5 FMAX", "never set");
  refused("QL1 = 5", "not understood");
  refused("L X+1 FMAX M91 M128", "machine coordinates");
  expect_refused("0 BEGIN PGM A MM\n2 END PGM A MM\n", "block number 1", 2, ReaderDialect::kHeidenhain);
  expect_refused("0 BEGIN PGM A MM\n1 END PGM B MM\n", "must name", 2, ReaderDialect::kHeidenhain);
  expect_refused("0 BEGIN PGM A MM\n1 M128\n2 TOOL CALL 1 Z S5000\n3 END PGM A MM\n", "M129", 3,
                 ReaderDialect::kHeidenhain);
}

TEST(HeidenhainReader, TimesBlocks) {
  const Reading r =
      read("0 BEGIN PGM A MM\n1 L X+1 F600\n2 L X+2 B+5 FT0.25\n3 L X+3\n4 END PGM A MM\n", ReaderDialect::kHeidenhain);
  ASSERT_FALSE(r.result.error) << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 3U);
  EXPECT_DOUBLE_EQ(r.moves[1].seconds, 0.25);
  EXPECT_DOUBLE_EQ(r.moves[2].seconds, 0.1) << "the feed per minute is in force again";
  expect_refused("0 BEGIN PGM A MM\n1 L X+1 FT0\n2 END PGM A MM\n", "FT takes", 2, ReaderDialect::kHeidenhain);
}

TEST(HeidenhainReader, SpeaksDinIsoToo) {
  const Reading r = read(
      "%LENS G71 *\nN10 G30 G17 X-30 Y-30 Z-10 *\nN20 G31 G90 X+30 Y+30 Z+0 *\nN30 G247 Q339=+1 *\nN40 T3 G17 S20000 "
      "DL-2 *\n"
      "N50 G00 G40 Z-1 M91 *\nN60 X+0 Y+0 M3 *\nN70 G04 F8 *\nN80 Z+30 *\nN90 G01 X+30 F1000 *\nN100 G03 X+0 Y+30 I+0 "
      "J+0 *\n"
      "N110 G01 G91 X+1 *\nN120 G90 M126 *\nN130 G00 C-170 *\nN140 C+170 *\nN150 M128 *\nN160 G01 X+1 Y+2 Z+30 B+10 *\n"
      "N170 M129 *\nN180 G00 Z-1 M91 M5 *\nN190 ; the end\nN200 M30 *\nN99999999 %LENS G71 *\n",
      ReaderDialect::kHeidenhainIso);
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  EXPECT_TRUE(r.result.ended);
  ASSERT_EQ(r.moves.size(), 10U);
  EXPECT_EQ(r.moves[0].target[2], -1);
  EXPECT_EQ(r.moves[2].target, (AxisValues{10, -5, -400 + 83 + 30, 0, 0})) << "DL shortens the tool";
  EXPECT_DOUBLE_EQ(r.moves[3].seconds, 1.8);
  EXPECT_NEAR(r.moves[4].programmed[1], 30, 1e-12);
  EXPECT_NEAR(r.moves[5].programmed[0], 1, 1e-12);
  EXPECT_NEAR(r.moves[7].programmed[4], -190 * kRad, 1e-12);
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  const AxisValues& q = r.moves[8].target;
  EXPECT_LT((view.cutter({q[0], q[1], q[2], q[3], q[4]}, 83).tip_mm - Vec3(1, 2, 30)).norm(), 1e-10);

  const auto refused = [](const std::string& block, const std::string& rule) {
    expect_refused("%A G71 *\nN10 " + block + "\nN99999999 %A G71 *\n", rule, 2, ReaderDialect::kHeidenhainIso);
  };
  refused("G01 X+1", "ends with *");
  refused("G01 X+1 *", "feed not given");
  refused("G41 X+1 F100 *", "no diameter");
  refused("G43 X+1 *", "G43 is not understood");
  refused("M116 *", "M116 is not understood");
  refused("G00 X+1 X+2 *", "named twice");
  refused("G00 X1e5 *", "bad number");
  refused("G62 T0.1 P01 *", "value is missing");
  refused("G247 Q339=+12 *", "datums");
  refused("T9 G17 S100 *", "tool table");
  expect_refused("%A G71 *\nN20 M128 *\nN30 T1 G17 S100 *\n", "M129", 3, ReaderDialect::kHeidenhainIso);
  expect_refused("%A G71 *\nN20 M8 *\nN20 M9 *\n", "grow", 3, ReaderDialect::kHeidenhainIso);
  expect_refused("%A G71 *\nN20 M8 *\nN30 %B G71 *\n", "must name", 3, ReaderDialect::kHeidenhainIso);
}

std::string iso_numbered(const std::vector<std::string>& blocks) {
  std::string text = "%A G71 *\n";
  for (std::size_t i = 0; i < blocks.size(); ++i) text += "N" + std::to_string(10 * (i + 1)) + " " + blocks[i] + " *\n";
  return text + "N99999999 %A G71 *\n";
}
Reading iso(const std::vector<std::string>& blocks) {
  return read(iso_numbered(blocks), ReaderDialect::kHeidenhainIso);
}

std::string numbered(const std::vector<std::string>& blocks) {
  std::string text = "0 BEGIN PGM A MM\n";
  for (std::size_t i = 0; i < blocks.size(); ++i) text += std::to_string(i + 1) + " " + blocks[i] + "\n";
  return text + std::to_string(blocks.size() + 1) + " END PGM A MM\n";
}
Reading conversation(const std::vector<std::string>& blocks) {
  return read(numbered(blocks), ReaderDialect::kHeidenhain);
}
/// At the last block, or some blocks before it.
void expect_conversation_refused(const std::vector<std::string>& blocks, const std::string& rule, long before = 0) {
  expect_refused(numbered(blocks), rule, static_cast<long>(blocks.size()) + 1 - before, ReaderDialect::kHeidenhain);
}

TEST(HeidenhainReader, ReckonsWithQParameters) {
  const Reading r =
      conversation({"FN 0: Q1 = +3", "FN 1: Q2 = +Q1 + -5", "FN 2: Q3 = +Q1 - +Q2", "FN 3: Q4 = +Q3 * +Q1",
                    "FN 4: Q5 = +Q4 DIV +2", "FN 5: Q6 = SQRT +16", "FN 6: Q7 = SIN +30", "FN 7: Q8 = COS +60",
                    "FN 8: Q9 = +3 LEN +4", "FN 13: Q10 = -1 ANG +1", "L X+Q1 Y+Q2 Z+Q3 FMAX", "L X+Q4 Y-Q5 Z+Q6 FMAX",
                    "L X+Q7 Y+Q8 Z+Q9 FMAX", "L X+Q10 FMAX", "Q11 = Q1 + 2 * SQ( Q6 - 1 ) ^ 1", "L IX+Q11 F+Q11",
                    "Q12 = NEG INT 2.7 + SIN( 90 )", "L X+Q12"});
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  const double ends[][3] = {{3, -2, 5}, {15, -7.5, 4}, {0.5, 0.5, 5}, {315, 0.5, 5}, {336, 0.5, 5}, {-1, 0.5, 5}};
  ASSERT_EQ(r.moves.size(), std::size(ends));
  for (std::size_t i = 0; i < std::size(ends); ++i) {
    for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(r.moves[i].programmed[k], ends[i][k], 1e-12) << i;
  }
  EXPECT_NEAR(r.moves[4].seconds, 60, 1e-9) << "21 mm at 21 mm a minute";
  expect_conversation_refused({"FN 4: Q1 = +1 DIV +0"}, "no number");
  expect_conversation_refused({"FN 14: ERROR = 1000"}, "error of its own");
  expect_conversation_refused({"FN 18: SYSREAD Q1 = ID1"}, "FN 18 is not understood");
  expect_conversation_refused({"FN 0: QS1 = +1"}, "QL, QR and QS");
  expect_conversation_refused({"Q1 = ( 2"}, "')' is missing");
  expect_conversation_refused({"Q1 = 2 3"}, "nothing may follow");
}

// A program that jumps is what it does, written out.
TEST(HeidenhainReader, JumpsAreTheirUnrolledPrograms) {
  const Reading jumps = conversation({"FN 0: Q1 = +0",
                                      "LBL 1",
                                      "FN 1: Q1 = +Q1 + +1",
                                      "FN 10: IF +Q1 NE +2 GOTO LBL 2",
                                      "CALL LBL 5",
                                      "LBL 2",
                                      "L X+Q1 F600",
                                      "FN 12: IF +Q1 LT +3 GOTO LBL 1",
                                      "FN 9: IF +Q1 EQU +3 GOTO LBL \"END\"",
                                      "L X+99",
                                      "LBL 5",
                                      "L Y+Q1 FMAX",
                                      "LBL 0",
                                      "LBL \"END\"",
                                      "FN 11: IF +Q1 GT +5 GOTO LBL 1",
                                      "L IZ+Q1",
                                      "CALL LBL 7",
                                      "M30",
                                      "LBL 7",
                                      "L IZ+1",
                                      "LBL 0"});
  const Reading unrolled = conversation({"L X+1 F600", "L Y+2 FMAX", "L X+2", "L X+3", "L IZ+3", "L IZ+1", "M30"});
  expect_same_steps(jumps, unrolled);
  expect_conversation_refused({"FN 9: IF +1 EQU +1 GOTO LBL 9"}, "label 9 is not set");
  expect_refused(numbered({"LBL 1", "FN 9: IF +1 EQU +1 GOTO LBL 1"}), "does not end", 3, ReaderDialect::kHeidenhain);
}

TEST(HeidenhainReader, PolarAndTangentPaths) {
  const Reading r = conversation({"L X+20 Y+0 Z+0 F600", "CC X+10 Y+0", "LP PR+5 PA+90", "LP IPA+90", "CP PA+270 DR+",
                                  "CP IPA+720 IZ-4 DR+", "L X+10 Y-10", "CT X+20 Y-20", "CTP PR+10 PA+0"});
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  const double ends[][3] = {{20, 0, 0},   {10, 5, 0},    {5, 0, 0},     {10, -5, 0},
                            {10, -5, -4}, {10, -10, -4}, {20, -20, -4}, {20, 0, -4}};
  ASSERT_EQ(r.moves.size(), std::size(ends));
  for (std::size_t i = 0; i < std::size(ends); ++i) {
    for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(r.moves[i].programmed[k], ends[i][k], 1e-9) << i;
  }
  double helix_s = 0;
  for (const ProgramStep& step : r.steps) {
    if (step.kind != ProgramStep::kMove) continue;
    if (step.line == 7) {
      helix_s += step.seconds;
      EXPECT_NEAR(std::hypot(step.programmed[0] - 10, step.programmed[1]), 5, 1e-9);
    }
    // Straight down, then a quarter of a circle to the left, then on to the right end of the pole's circle.
    if (step.line == 9 || step.line == 10) {
      EXPECT_NEAR(std::hypot(step.programmed[0] - 20, step.programmed[1] + 10), 10, 1e-9);
    }
  }
  EXPECT_NEAR(helix_s, std::hypot(20 * kPi, 4) / 10, 1e-9);
  expect_conversation_refused({"LP PR+5 PA+90 FMAX"}, "need a CC");
  expect_conversation_refused({"CT X+5 Y+5 F100"}, "needs a path");
  expect_conversation_refused({"L X+5 F100", "CT X+9"}, "straight ahead");
  expect_conversation_refused({"CC X+0 Y+0", "L X+5 F100", "CP IPA-90 DR+"}, "same sign");
  expect_conversation_refused({"CC X+0 Y+0", "LP PR+5 X+1 PA+3 FMAX"}, "beside polar");
}

// The compensated contour is LinuxCNC's.
TEST(HeidenhainReader, CompensatesAsLinuxCnc) {
  const Reading r = conversation({"TOOL CALL 1 Z S5000", "L X-10 Y+0 FMAX", "L X+0 RL F600", "L X+10", "L Y+10",
                                  "CC X+20 Y+10", "C X+20 Y+20 DR-", "L X+40", "L Y+30 R0 FMAX"});
  Reading linuxcnc =
      read("T1 M6\nG43 H1\nG0 X-10 Y0\nG41 D1 G1 X0 F600\nX10\nY10\nG2 X20 Y20 I10 J0\nG1 X40\nG40 G0 Y30\nM2\n");
  expect_same_steps(r, linuxcnc);
  // Down and up beside the contour: compensation begins and ends with a move in the plane.
  const Reading deep = conversation({"TOOL CALL 1 Z S5000", "L X-10 Y+0 FMAX", "L Z-5 RL F600", "L X+0", "L X+10",
                                     "L Z+20 R0 FMAX", "L Z+30", "L X+0 Y+9"});
  ASSERT_FALSE(deep.result.error) << deep.result.error->rule;
  const double ends[][3] = {{-10, 0, 0}, {-10, 0, -5}, {0, 2, -5}, {10, 2, -5}, {10, 2, 20}, {10, 2, 30}, {0, 9, 30}};
  ASSERT_EQ(deep.moves.size(), std::size(ends));
  for (std::size_t i = 1; i < std::size(ends); ++i) {
    for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(deep.moves[i].programmed[k], ends[i][k], 1e-12) << i;
  }
  expect_conversation_refused({"TOOL CALL 1 Z S5000", "L X+10 RL F100", "L X+20 RR"}, "R0 must stand between");
  expect_conversation_refused({"TOOL CALL 1 Z S5000", "L X+10 RL F100", "M128"}, "while cutter compensation");
  expect_conversation_refused({"TOOL CALL 1 Z S5000", "L X+10 F100", "CR X+20 R+9 DR- RL"}, "straight lines");
  expect_conversation_refused({"TOOL CALL 1 Z S5000", "L X+10 RL F100", "TOOL CALL 1 Z S5000"}, "while cutter");
}

// Space angles turn about X, then Y, then Z as they stand; the tool stands square, the tip where the coordinates say.
TEST(HeidenhainReader, TiltedPlanesAreTurnedCoordinates) {
  EXPECT_TRUE(rc::check("tip and axis by space angles", [] {
    const auto angle = [](int least, int most) { return *rc::gen::inRange(least, most); };
    const int a = angle(-60, 60), b = angle(-60, 60), c = angle(-180, 180);
    const auto word = [](const char* letters, int v) {
      return std::string(" ") + letters + (v < 0 ? "" : "+") + std::to_string(v);
    };
    const std::string spatial = "PLANE SPATIAL" + word("SPA", a) + word("SPB", b) + word("SPC", c);
    const char* ways[] = {" TURN FMAX", " MOVE DIST20 F2000", " STAY"};
    const int way = angle(0, 3);
    std::vector<std::string> blocks = {"TOOL CALL 1 Z S5000", "L X+3 Y+4 Z+50 FMAX", "CYCL DEF 7.0", "CYCL DEF 7.1 X+5",
                                       spatial + ways[way]};
    if (way == 2) blocks.emplace_back("L B+Q121 C+Q122 FMAX");
    blocks.insert(blocks.end(), {"L X+1 Y+2 Z+3 FMAX", "CYCL DEF 7.0", "CYCL DEF 7.1 Z-2", "L X+1 Y+2 Z+3 FMAX"});
    const Reading r = conversation(blocks);
    RC_ASSERT(!r.result.error);
    const Eigen::Matrix3d R = (Eigen::AngleAxisd(c * kRad, Vec3::UnitZ()) * Eigen::AngleAxisd(b * kRad, Vec3::UnitY()) *
                               Eigen::AngleAxisd(a * kRad, Vec3::UnitX()))
                                  .toRotationMatrix();
    RC_ASSERT(r.moves.size() == 4U);
    const ToolPose first = pose_of(r.moves[2], 80), second = pose_of(r.moves[3], 80);
    RC_ASSERT((first.axis - R.col(2)).norm() < 1e-9);
    RC_ASSERT((first.tip_mm - (Vec3(5, 0, 0) + R * Vec3(1, 2, 3))).norm() < 1e-9);
    RC_ASSERT((second.tip_mm - (Vec3(5, 0, 0) + R * Vec3(1, 2, 1))).norm() < 1e-9);
    const ToolPose before = pose_of(r.moves[0], 80), turned = pose_of(r.moves[1], 80);
    if (way == 1) {  // 20 mm beyond the tip nothing moves
      RC_ASSERT((before.tip_mm - 20 * before.axis - turned.tip_mm + 20 * turned.axis).norm() < 1e-9);
    } else {
      for (std::size_t n = 0; n < 3; ++n) RC_ASSERT(std::abs(r.moves[1].target[n] - r.moves[0].target[n]) < 1e-9);
    }
  }));
  const Reading back =
      conversation({"PLANE SPATIAL SPA+0 SPB+30 SPC+0 TURN FMAX SEQ-", "PLANE RESET TURN FMAX", "L X+1 FMAX"});
  ASSERT_FALSE(back.result.error) << back.result.error->rule;
  EXPECT_NEAR(back.moves[0].target[3], -30 * kRad, 1e-12) << "SEQ- takes the other solution";
  EXPECT_EQ(back.moves[1].target[3], 0);
  EXPECT_EQ(back.moves[2].target[0], 11);
  expect_conversation_refused({"PLANE SPATIAL SPA+0 SPB+30 SPC+0"}, "MOVE, TURN or STAY");
  expect_conversation_refused({"PLANE SPATIAL SPA+0 SPB+30 TURN FMAX"}, "SPA, SPB and SPC");
  expect_conversation_refused({"PLANE SPATIAL SPA+0 SPB+130 SPC+0 TURN FMAX"}, "cannot turn the tool");
  expect_conversation_refused({"PLANE VECTOR BX1 BY0 BZ0"}, "SPATIAL and RESET");
  expect_conversation_refused({"M128", "PLANE RESET STAY"}, "M129");
}

TEST(HeidenhainReader, VectorsTurnTheTool) {
  const Reading r =
      conversation({"TOOL CALL 1 Z S5000", "M128", "LN X+1 Y+2 Z+3 NX+0 NY+0 NZ+1 TX+0.3 TY-0.4 TZ+0.8 F600"});
  ASSERT_FALSE(r.result.error) << r.result.error->rule;
  EXPECT_LT((pose_of(r.moves[0], 80).axis - Vec3(0.3, -0.4, 0.8).normalized()).norm(), 1e-12);
  EXPECT_LT((pose_of(r.moves[0], 80).tip_mm - Vec3(1, 2, 3)).norm(), 1e-10);
  expect_conversation_refused({"LN X+1 TX+1 F100"}, "M128");
}

void expect_ends(const Reading& r, const std::vector<Vec3>& ends) {
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), ends.size());
  for (std::size_t i = 0; i < ends.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(r.moves[i].programmed[k], ends[i][static_cast<int>(k)], 1e-9) << i;
  }
}
/// All that line `line` moves lies on a circle.
void expect_on_circle(const Reading& r, long line, double u, double v, double radius_mm) {
  int steps = 0;
  for (const ProgramStep& step : r.steps) {
    if (step.kind != ProgramStep::kMove || step.line != line) continue;
    ++steps;
    EXPECT_NEAR(std::hypot(step.programmed[0] - u, step.programmed[1] - v), radius_mm, 1e-9);
  }
  EXPECT_GT(steps, 3);
}

TEST(HeidenhainReader, RoundsAndChamfersCorners) {
  const Reading lines = conversation({"L X+0 Y+0 Z+0 F600", "L X+10", "RND R2 F300", "L Y+10", "CHF 3", "L X+20"});
  expect_ends(lines, {{0, 0, 0}, {8, 0, 0}, {10, 2, 0}, {10, 7, 0}, {13, 10, 0}, {20, 10, 0}});
  expect_on_circle(lines, 4, 8, 2, 2);
  double arc_s = 0;
  for (const ProgramStep& step : lines.steps) arc_s += step.line == 4 ? step.seconds : 0;
  EXPECT_NEAR(arc_s, kPi / 5, 1e-5) << "the corner's feed";
  EXPECT_NEAR(lines.moves[3].seconds, 0.5, 1e-12) << "the feed before is in force again";
  // Up from a line into a clockwise circle about (15, 0), and the crease of two circles about (5, 0) and (11, 0).
  const double root = std::sqrt(35);
  const Reading circle =
      conversation({"L X+0 Y+0 Z+0 F600", "L X+10", "RND R1", "CC X+15 Y+0", "C X+15 Y+5 DR-", "L X+30"});
  expect_ends(circle, {{0, 0, 0}, {15 - root, 0, 0}, {15 - 5 * root / 6, 5. / 6, 0}, {15, 5, 0}, {30, 5, 0}});
  expect_on_circle(circle, 6, 15, 0, 5);
  const double high = 5 * std::sqrt(27) / 6;
  const Reading crease =
      conversation({"L X+0 Y+0 Z+0 F600", "CC X+5 Y+0", "C X+8 Y+4 DR-", "RND R1", "CC X+11 Y+0", "C X+16 Y+0 DR-"});
  expect_ends(crease, {{0, 0, 0}, {7.5, high, 0}, {8.5, high, 0}, {16, 0, 0}});
  expect_on_circle(crease, 5, 8, std::sqrt(27), 1);
  // Two turns and a half, then straight out: what is cut off is their end.
  const Reading turns = conversation({"L X+5 Y+0 Z+0 F600", "CC X+0 Y+0", "CP IPA+900 DR+", "RND R1", "L X-9"});
  double sweep_s = 0;
  for (const ProgramStep& step : turns.steps) sweep_s += step.line == 4 ? step.seconds : 0;
  const double rest_rad = std::asin(1. / 6);  // the rounding's centre is 6 from (0, 0) and 1 above the line
  EXPECT_NEAR(sweep_s, (5 * kPi - rest_rad) * 5 / 10, 1e-6);
  // A slot's end: the roundings leave nothing of the line between them.
  expect_ends(conversation({"L X+0 Y+0 Z+0 F600", "L X+10", "RND R5", "L Y+10", "RND R5", "L X+0 M8"}),
              {{0, 0, 0}, {5, 0, 0}, {10, 5, 0}, {5, 10, 0}, {0, 10, 0}});
  // A cutter of radius 2 to the right of a corner that turns left.
  const Reading beside = conversation(
      {"TOOL CALL 1 Z S5000", "L X-10 Y+0 Z+0 FMAX", "L X+0 RR F600", "L X+10", "RND R2", "L Y+10", "L X+20 R0"});
  expect_ends(beside, {{-10, 0, 0}, {0, -2, 0}, {8, -2, 0}, {12, 2, 0}, {12, 10, 0}, {20, 10, 0}});
  expect_conversation_refused({"L X+5 F600", "L X+10", "RND R6", "L Y+10"}, "larger than the paths", 1);
  expect_conversation_refused({"L X+0 Y+0 Z+0 F600", "L X+10", "CHF 6", "L Y+5"}, "the chamfer is larger", 1);
  expect_conversation_refused({"L X+0 F600", "L X+10", "RND R1", "L X+5"}, "turns back", 1);
  expect_conversation_refused({"L X+0 F600", "L X+10", "RND R1", "L Y+5 Z-1"}, "of the plane", 1);
  expect_conversation_refused({"L X+0 F600", "L X+10", "RND R1", "L Y+5 FMAX"}, "without FMAX");
  expect_conversation_refused({"L X+0 F600", "L X+10", "RND R1", "M30"}, "another path");
  expect_conversation_refused({"L X+0 F600", "L X+10", "RND R0", "L Y+5"}, "above 0", 1);
  expect_conversation_refused({"L X+0 F600", "L X+10", "CHF 1", "CR X+20 R+9 DR-"}, "straight lines", 1);
}

// A cutter of radius 2, a first path to the right; the centre runs inside the arcs of APPR and DEP.
TEST(HeidenhainReader, ApproachesAndDeparts) {
  const auto contour = [](const std::string& approach, const std::string& departure) {
    return conversation({"TOOL CALL 1 Z S5000", "L X-10 Y+8 Z+5 R0 F900", approach, "L X+20", departure});
  };
  const Reading straight = contour("APPR LT X+0 Y+0 Z-5 LEN15 RL F600", "DEP LT LEN12.5 F300");
  expect_ends(straight, {{-10, 8, 5}, {-15, 2, 5}, {-15, 2, -5}, {0, 2, -5}, {20, 2, -5}, {32.5, 2, -5}});
  EXPECT_NEAR(straight.moves[2].seconds, 10 / 15., 1e-12) << "with the feed before";
  EXPECT_NEAR(straight.moves[3].seconds, 1.5, 1e-12);
  EXPECT_NEAR(straight.moves[5].seconds, 2.5, 1e-12);
  expect_ends(contour("APPR LN X+0 Y+0 LEN15 RR F600", "DEP LN Z+9 LEN5"),
              {{-10, 8, 5}, {0, -17, 5}, {0, -2, 5}, {20, -2, 5}, {20, -7, 5}, {20, -7, 9}});
  const Reading circles = contour("APPR CT X+0 Y+0 CCA180 R+10 RR F600", "DEP CT CCA 90 R+8 F100");
  expect_ends(circles, {{-10, 8, 5}, {0, -18, 5}, {0, -2, 5}, {20, -2, 5}, {26, -8, 5}});
  expect_on_circle(circles, 6, 20, -8, 6);
  for (const ProgramStep& step : circles.steps) {
    if (step.line == 4 && step.kind == ProgramStep::kMove) {
      EXPECT_LT(step.programmed[0], 1e-9) << "clockwise";
    }
  }
  expect_ends(contour("APPR CT X+0 Y+0 CCA90 R-6 RL F600", "DEP CT CCA90 R-6"),
              {{-10, 8, 5}, {-8, -6, 5}, {0, 2, 5}, {20, 2, 5}, {28, -6, 5}});
  expect_ends(contour("APPR LCT X+0 Y+0 R8 RL F600", "DEP LCT X+30 Y+8 Z+7 R+8"),
              {{-10, 8, 5}, {-3.6, 3.2, 5}, {0, 2, 5}, {20, 2, 5}, {23.6, 3.2, 5}, {30, 8, 5}, {30, 8, 7}});
  // Polar, into an arc, behind it a corner.
  expect_ends(
      conversation({"TOOL CALL 1 Z S5000", "L X+0 Y+30 Z+0 FMAX", "CC X+0 Y+0", "APPR PLT PR+10 PA+180 LEN5 RL F600",
                    "CC X+0 Y+0", "C X+0 Y+10 DR-", "L Y+20", "RND R3", "L X-10", "DEP LT LEN1", "L X+0 Y+0"}),
      {{0, 30, 0},
       {-12, -5, 0},
       {-12, 0, 0},
       {-2, std::sqrt(140), 0},
       {-2, 17, 0},
       {-3, 18, 0},
       {-10, 18, 0},
       {-11, 18, 0},
       {0, 0, 0}});
  const auto refused = [](const std::vector<std::string>& blocks, const std::string& rule, long before = 0) {
    std::vector<std::string> all{"TOOL CALL 1 Z S5000", "L X-10 Y+8 Z+5 R0 F900"};
    all.insert(all.end(), blocks.begin(), blocks.end());
    expect_conversation_refused(all, rule, before);
  };
  refused({"APPR LT X+0 Y+0 LEN5 RL", "L Z-5"}, "in X and Y");
  refused({"APPR LT X+0 Y+0 LEN5 RL", "M8"}, "a path must follow");
  refused({"APPR LT X+0 Y+0 LEN5 RL", "L X+5 R0"}, "do not change");
  refused({"APPR LT X+0 Y+0 LEN5"}, "needs RL or RR");
  refused({"APPR CT X+0 Y+0 R5 RL"}, "CCA");
  refused({"APPR XT X+0 Y+0 R5 RL"}, "LT, LN, CT or LCT");
  refused({"APPR LT X+0 Y+0 RL"}, "LEN is missing");
  refused({"APPR LT X+0 Y+0 LEN5 RL FMAX"}, "neither FMAX");
  refused({"APPR CT X+0 Y+0 CCA90 R2 RL", "L X+20"}, "does not fit", 1);
  refused({"APPR LCT X+0 Y+0 R30 RL", "L X+20"}, "too large", 1);
  refused({"DEP LT LEN5"}, "DEP needs a path");
}

// The same blocks in both languages of the control.
TEST(HeidenhainReader, DinIsoIsTheConversation) {
  const std::pair<std::vector<std::string>, std::vector<std::string>> cases[] = {
      {{"D00 Q1 P01 +3", "D01 Q2 P01 +Q1 P02 -5", "D03 Q3 P01 +Q2 P02 +Q1", "D04 Q4 P01 +Q3 P02 +2", "D05 Q5 P01 +16",
        "D06 Q6 P01 +30", "D08 Q7 P01 +3 P02 +4", "D13 Q8 P01 -1 P02 +1", "Q9 = Q5 * ( 2 + Q6 )", "G01 X+Q2 Y-Q4 F+Q9",
        "G00 X+Q7 Y+Q8"},
       {"FN 0: Q1 = +3", "FN 1: Q2 = +Q1 + -5", "FN 3: Q3 = +Q2 * +Q1", "FN 4: Q4 = +Q3 DIV +2", "FN 5: Q5 = SQRT +16",
        "FN 6: Q6 = SIN +30", "FN 8: Q7 = +3 LEN +4", "FN 13: Q8 = -1 ANG +1", "Q9 = Q5 * ( 2 + Q6 )",
        "L X+Q2 Y-Q4 F+Q9", "L X+Q7 Y+Q8 FMAX"}},
      {{"G98 L1", "G91 G01 X+1 F600", "G90", "L1,2", "L5,0", "D11 P01 +1 P02 +2 P03 9", "D09 P01 +0 P02 +0 P03 9",
        "M30", "G98 L5", "G00 Y+7", "G98 L0", "G98 L9", "G01 Z+1", "M30"},
       {"LBL 1", "L IX+1 F600", "Q1 = 0", "CALL LBL 1 REP2", "CALL LBL 5", "FN 11: IF +1 GT +2 GOTO LBL 9",
        "FN 9: IF +0 EQU +0 GOTO LBL 9", "M30", "LBL 5", "L Y+7 FMAX", "LBL 0", "LBL 9", "L Z+1 F600", "M30"}},
      {{"T1 G17 S5000 DL+1 DR+0.5", "G00 G40 X-10 Y+0 M3", "G01 G41 X+0 F600", "X+10", "G25 R3", "Y+10", "G24 R1",
        "I+20 J+20", "X+20", "G03 X+30 Y+20", "G02 X+40 Y+30 R+10", "G00 G40 Z+50 M9", "I+0 J+0", "G11 R+50 H+90 F500",
        "G91 G13 H+360 Z-5", "G90 G00 Z+50 M5"},
       {"TOOL CALL 1 Z S5000 DL+1 DR+0.5", "L X-10 Y+0 R0 FMAX M3", "L X+0 RL F600", "L X+10", "RND R3", "L Y+10",
        "CHF 1", "CC X+20 Y+20", "L X+20", "C X+30 Y+20 DR+", "CR X+40 Y+30 R+10 DR-", "L Z+50 R0 FMAX M9",
        "CC X+0 Y+0", "LP PR+50 PA+90 F500", "CP IPA+360 IZ-5 DR+", "L Z+50 FMAX M5"}},
      {{"G99 T5 L+20 R+3", "T5 G17 S900", "G54 X+5 G90", "G00 X+0 Y+0 M3",
        "G200 Q200=+2 Q201=-8 Q206=+300 Q202=+3 Q210=+0 Q203=+0 Q204=+20 Q211=+0.1", "G79", "X+10 M99", "G04 F0.5",
        "G38"},
       {"TOOL DEF 5 L+20 R+3", "TOOL CALL 5 Z S900", "CYCL DEF 7.1 X+5", "L X+0 Y+0 FMAX M3",
        "CYCL DEF 200 DRILLING Q200=+2 Q201=-8 Q206=+300 Q202=+3 Q210=+0 Q203=+0 Q204=+20 Q211=+0.1", "CYCL CALL",
        "L X+10 FMAX M99", "CYCL DEF 9.1 DWELL0.5", "STOP"}},
  };
  for (const auto& [blocks, words] : cases) expect_same_steps(iso(blocks), conversation(words));
  const auto refused = [](const std::string& block, const std::string& rule) {
    expect_refused(iso_numbered({block}), rule, 2, ReaderDialect::kHeidenhainIso);
  };
  refused("D14 Q1 P01 +3", "D14 is not understood");
  refused("D01 Q1 P01 +3", "not complete");
  refused("D01 Q1 P02 +3 P01 +2", "P01 expected");
  refused("D09 P01 +0 P02 +0 P03 7", "label 7 is not set");
  refused("L3,0", "label 3 is not set");
  refused("G98", "needs its label");
  refused("G01 X+Q5 F9", "never set");
  refused("G79", "no cycle");
  refused("G25 R1", "behind a path");
  EXPECT_EQ(iso({"D00 Q1 P01 +3", "G01 X+Q1 Y+Q2 F100"}).result.error->column, 16) << "of Q2 in the text";
}

// Down to 3, 6 and 8 mm, each time out to 2 mm above the work and back to 2 mm above the ground; up to 20 mm.
TEST(HeidenhainReader, DrillsWithPecks) {
  const std::string cycle =
      "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S5000\n2 L X+5 Y+5 Z+50 R0 FMAX M3\n3 CYCL DEF 200 DRILLING ~\n"
      "    Q200=+2    ;SET-UP CLEARANCE ~\n    Q201=-8    ;DEPTH ~\n    Q206=+300  ;FEED RATE FOR PLNGNG ~\n"
      "    Q202=+3    ;PLUNGING DEPTH ~\n    Q210=+0.5  ;DWELL TIME AT TOP ~\n    Q203=+1    ;SURFACE COORDINATE ~\n"
      "    Q204=+20   ;2ND SET-UP CLEARANCE ~\n    Q211=+0.1  ;DWELL TIME AT DEPTH\n";
  const Reading holes = read(cycle + "4 CYCL CALL\n5 L X+9 FMAX M99\n6 END PGM A MM\n", ReaderDialect::kHeidenhain);
  std::vector<Vec3> ends{{5, 5, 50}};
  for (const double x : {5, 9}) {
    if (x == 9) ends.emplace_back(9, 5, 21);
    for (const double z : {3, -2, 3, 0, -5, 3, -3, -7, 3, 21}) ends.emplace_back(x, 5, z);
  }
  expect_ends(holes, ends);
  double dwells_s = 0;
  for (const ProgramStep& step : holes.steps) dwells_s += step.kind == ProgramStep::kDwell ? step.seconds : 0;
  EXPECT_NEAR(dwells_s, 2 * (2 * 0.5 + 0.1), 1e-12);
  EXPECT_NEAR(holes.moves[2].seconds, 1, 1e-12) << "5 mm at 300 mm a minute";
  EXPECT_TRUE(holes.moves[3].rapid);
  const Reading reamed = conversation({"L X+0 Y+0 Z+50 FMAX",
                                       "CYCL DEF 201 REAMING Q200=+2 Q201=-8 Q206=+300 Q211=+0 "
                                       "Q208=+600 Q203=+0 Q204=+20",
                                       "CYCL CALL M8"});
  expect_ends(reamed, {{0, 0, 50}, {0, 0, 2}, {0, 0, -8}, {0, 0, 2}, {0, 0, 20}});
  EXPECT_NEAR(reamed.moves[3].seconds, 1, 1e-12);
  expect_conversation_refused({"CYCL CALL"}, "no cycle");
  expect_conversation_refused({"CYCL DEF 200 Q200=+2 Q201=-8 Q206=+300 Q202=+3 Q203=+0 Q999=+1"}, "does not know Q999");
  expect_conversation_refused({"CYCL DEF 200 Q200=+2 Q201=+8 Q206=+300 Q202=+3 Q203=+0", "CYCL CALL"}, "below 0");
  expect_conversation_refused({"CYCL DEF 200 Q200=+2 Q201=-8 Q206=+300 Q202=+0.0001 Q203=+0", "CYCL CALL"},
                              "too small");
}

TEST(HeidenhainReader, RetractsAlongTheTool) {
  const Reading r =
      conversation({"TOOL CALL 1 Z S5000 F600", "L X+0 Y+0 Z+0 F MAX", "M140 MB50 F1200", "L X+5", "M140 MB MAX"});
  ASSERT_FALSE(r.result.error) << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 4U);
  EXPECT_NEAR(r.moves[1].programmed[2], 50, 1e-12);
  EXPECT_NEAR(r.moves[1].seconds, 2.5, 1e-12);
  EXPECT_NEAR(r.moves[2].seconds, 0.5, 1e-12) << "the feed of the tool call";
  EXPECT_EQ(r.moves[3].target[2], test::skew_machine().z.max_mm);
  EXPECT_TRUE(r.moves[3].rapid);
  expect_conversation_refused({"M140"}, "not complete");
  expect_conversation_refused({"M128", "M140 MB50"}, "under M128");
}

}  // namespace
}  // namespace lightmill

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

Reading fanuc(const std::string& text, long most_blocks = 100000) {
  return read("%\nO1000\n" + text, ReaderDialect::kFanuc, most_blocks);
}
void expect_fanuc_refused(const std::string& text, const std::string& rule, long line) {
  expect_refused("O1000\n" + text, rule, line + 1, ReaderDialect::kFanuc);
}

TEST(FanucReader, CallsSubprograms) {
  const Reading r = read("%\nO1\nG91\nM98 P200 L3\nM30\nO200\nG0 X2.\nM99\n%\n", ReaderDialect::kFanuc);
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 3U);
  EXPECT_EQ(r.moves.back().target[0], 6);
}

// A macro is what it does, written out.
TEST(FanucReader, MacrosAreTheirUnrolledPrograms) {
  const Reading macro = fanuc(
      "G90 G54 F600.\n#100=0\nWHILE[#100LT3]DO1\n#101=#100*10\nG0 X#101 Y-#101\nIF[#100EQ1]GOTO50\n"
      "G1 Z-1. X[#101+SIN[30]]\nN50 #100=#100+1\nEND1\n"
      "IF[#100NE3]THEN#100=99\nG0 X[#100] Z[ATAN[1]/[1]/45*FIX[-2.5]]\nM30\n%\n");
  const Reading unrolled =
      fanuc("G90 G54 F600.\nG0 X0 Y0\nG1 Z-1. X.5\nG0 X10. Y-10.\nG0 X20. Y-20.\nG1 Z-1. X20.5\nG0 X3. Z-2.\nM30\n%\n");
  expect_same_steps(macro, unrolled);
}

TEST(FanucReader, ArgumentsHaveTheirVariables) {
  // A to Z, and I, J, K once more: #1 #2 #3, #4 #5 #6 and #7 #8 #9.
  const Reading r = fanuc(
      "G90 F100.\n#1=77\nG65 P9000 L2 A1. B2. C3. I4. J5. K6. I7. J8. K9. H11 M13 Q17. R18. X24. Z26.\nG0 X#1\n"
      "G65 P9001 A5.\nG0 X#500\nM30\n"
      "O9000\nG0 X[#1+#2+#3] Y[#4*100+#5*10+#6] Z[-#7-#8-#9]\nG0 X#11 Y#13 Z-#17\nG0 X#18 Y#24 Z-#26\n"
      "G0 X1. Y#20\n#1=0\nM99\n"
      "O9001\n#500=#1\nG65 P9002 A[#1+1]\nM99\nO9002\n#500=#500*100+#1\nM98 P9003\nM99\nO9003\n#500=#500+#1\nM99\n%\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 10U);
  for (const std::size_t first : {0U, 4U}) {
    const double ends[][3] = {{6, 456, -24}, {11, 13, -17}, {18, 24, -26}};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(r.moves[first + i].programmed[k], ends[i][k]) << i;
    }
    EXPECT_EQ(r.moves[first + 3].programmed[1], 24) << "a word with an empty variable counts for nothing";
  }
  EXPECT_EQ(r.moves[8].programmed[0], 77) << "the caller's variables come back";
  EXPECT_EQ(r.moves[9].programmed[0], 512) << "M98 sees its caller's variables, G65 has its own";
}

TEST(FanucReader, ModalCallsFollowEachMove) {
  const std::string drill = "O9000\nG91 G1 Z-#26 F#9\nG0 Z#26\nG90\nM99\n%\n";
  const Reading modal = fanuc("G90 G0 X0 Y0 Z5.\nG66 P9000 Z3. F200\nX10.\nM8\nX20. Y5.\nG67\nX30.\nM30\n" + drill);
  const Reading called =
      fanuc("G90 G0 X0 Y0 Z5.\nX10.\nG65 P9000 Z3. F200\nG0\nM8\nX20. Y5.\nG65 P9000 Z3. F200\nG0 X30.\nM30\n" + drill);
  expect_same_steps(modal, called);
}

TEST(FanucReader, JumpsWithinTheProgramAndOutOfSubprograms) {
  const Reading r = fanuc(
      "#100=0\nN10 #100=#100+1\nG0 X#100\nIF[[#100GE2]AND[#1EQ#0]]GOTO30\nGOTO10\nN30 M98 P2000\nG0 X99.\nN40 G0 Y1.\n"
      "M98 P40003\nM30\n"
      "O2000\nN10 G0 X50.\nM99 P40\nO3\nG91 G0 X1.\nG90\nM99\n%\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 8U);
  const double x[] = {1, 2, 50, 50, 51, 52, 53, 54};
  for (std::size_t i = 0; i < 8; ++i) EXPECT_EQ(r.moves[i].programmed[0], x[i]) << i;
  expect_fanuc_refused("GOTO99\nM30\nO2\nN99 M99\n", "no block N99", 1);
  expect_fanuc_refused("WHILE[1EQ1]DO1\nEND1\nM30\n", "does not end", 2);
  expect_fanuc_refused("END1\nWHILE[1EQ1]DO1\nM30\n", "END without DO", 1);
  expect_fanuc_refused("DO1\nGOTO5\nEND1\nN5\nEND1\nM30\n", "END without DO", 5);
  expect_fanuc_refused("WHILE[#1EQ#0]DO2\nM30\n", "no END", 1);
  expect_fanuc_refused("IF[#1EQ#0]X1.\nM30\n", "GOTO or THEN", 1);
  expect_fanuc_refused("#3000=12(STOP)\nM30\n", "alarm 12", 1);
  expect_fanuc_refused("#4001=1\nM30\n", "cannot be set", 1);
  expect_fanuc_refused("G0 X#4001\nM30\n", "system variable #4001", 1);
  expect_fanuc_refused("#100=1/0\nM30\n", "no number", 1);
  expect_fanuc_refused("#100=SQRT[-1]\nM30\n", "out of its range", 1);
  expect_fanuc_refused("G65 P9 A1.\nM30\n", "O9 is not in this file", 1);
  expect_fanuc_refused("G65 P2 A1\nM30\nO2\nM99\n", "decimal point", 1);
  expect_fanuc_refused("G65 P2 N1.\nM30\nO2\nM99\n", "no argument", 1);
  expect_fanuc_refused("G65 P2\nM30\nO2\nG65 P2\nM99\n", "too deeply", 4);
  expect_fanuc_refused("G66 P2\nG66 P2\nM30\nO2\nM99\n", "modal call is on", 2);
  expect_fanuc_refused("M99\nM30\n", "without end", 1);
  expect_fanuc_refused("M98 P2 L0\nM30\nO2\nM99\n", "L counts", 1);
}

TEST(FanucReader, KnowsWhereItStands) {
  const Reading r = fanuc("G90 G54 T1 M6 G43 H1\nG0 X1. Y2. Z3.\nG0 X[#5041+#5021] Y#5222 Z[#5003*2]\nM30\n%\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  EXPECT_EQ(r.moves[1].programmed[0], 1 + 11);
  EXPECT_EQ(r.moves[1].programmed[1], -5);
  EXPECT_EQ(r.moves[1].programmed[2], 6);
}

TEST(FanucReader, MoreOffsetsAndShifts) {
  const Reading r = fanuc(
      "G90 G10 L20 P3 X100. Y0 Z0\nG54.1 P3 G0 X1.\nG91 G10 L2 P1 X5.\nG90 G54 G0 X1.\nG52 X2.\nG0 X1.\nG52 X0\n"
      "G92 X7.\nG0 X8.\nG92.1 X0\nG0 X1.\nM30\n%\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  const double x[] = {101, 16, 18, 19, 16};
  ASSERT_EQ(r.moves.size(), 5U);
  for (std::size_t i = 0; i < 5; ++i) EXPECT_EQ(r.moves[i].target[0], x[i]) << i;
  expect_fanuc_refused("G54.1 P49\nM30\n", "P1 to P48", 1);
  expect_fanuc_refused("G10 L10 P1 R2.\nM30\n", "L2 P1 to P6", 1);
}

// The compensated contour is LinuxCNC's.
TEST(FanucReader, CompensatesAsLinuxCnc) {
  const std::string contour =
      "T1 M6\nG0 X-10. Y0\nG41 D1 G1 X0 F600.\nX10.\nG4 X1.\nY10.\nG2 X20. Y20. R10.\nG1 X40.\nG40 G0 Y30.\nM30\n";
  std::string same = contour;
  same.replace(same.find("G4 X1."), 6, "G4 P1.");
  expect_same_steps(fanuc(contour), read(same));
  expect_fanuc_refused("T1 M6\nG41 D1 G1 X5. F100.\nG68.2 I0 J90. K0\nM30\n", "while cutter compensation", 3);
}

// In a tilted plane the tool stands square on it and the tip is where the turned coordinates say.
TEST(FanucReader, TiltedPlanesAreTurnedCoordinates) {
  EXPECT_TRUE(rc::check("tip and axis by Euler angles", [] {
    const auto angle = [](int least, int most) { return *rc::gen::inRange(least, most); };
    const int i = angle(-180, 180), j = angle(-80, 80), k = angle(-180, 180);
    const Vec3 origin(angle(-20, 20), angle(-20, 20), angle(-5, 20)), p(angle(-9, 9), angle(-9, 9), angle(1, 9));
    const auto word = [](char letter, double v) { return std::string(" ") + letter + std::to_string(v); };
    const Reading r = fanuc("T1 M6\nG90 G54 G0 X0 Y0 Z200.\nG68.2" + word('X', origin.x()) + word('Y', origin.y()) +
                            word('Z', origin.z()) + word('I', i) + word('J', j) + word('K', k) + "\nG53.1\nG43 H1\nG0" +
                            word('X', p.x()) + word('Y', p.y()) + word('Z', p.z()) + "\nG69\nG49\nM30\n%\n");
    RC_ASSERT(!r.result.error);
    const Eigen::Matrix3d R = (Eigen::AngleAxisd(i * kRad, Vec3::UnitZ()) * Eigen::AngleAxisd(j * kRad, Vec3::UnitX()) *
                               Eigen::AngleAxisd(k * kRad, Vec3::UnitZ()))
                                  .toRotationMatrix();
    const ToolPose pose = pose_of(r.moves.back(), 80);
    RC_ASSERT((pose.axis - R.col(2)).norm() < 1e-9);
    RC_ASSERT((pose.tip_mm - (origin + R * p)).norm() < 1e-9);
    // G53.1 turned the rotary axes alone.
    for (std::size_t n = 0; n < 3; ++n) RC_ASSERT(std::abs(r.moves[1].target[n] - r.moves[0].target[n]) < 1e-9);
  }));
  // P1 and P2 choose between both ways to turn.
  const auto outer = [](const char* p) {
    const Reading r = fanuc(std::string("T1 M6\nG68.2 I0 J30. K0\nG53.1 ") + p + "\nM30\n%\n");
    EXPECT_FALSE(r.result.error);
    return r.moves.back().target[3] / kRad;
  };
  EXPECT_NEAR(outer("P1"), 30, 1e-9);
  EXPECT_NEAR(outer("P2"), -30, 1e-9);
  expect_fanuc_refused("G53.1\nM30\n", "needs a plane", 1);
  expect_fanuc_refused("G68.2 P1 I0 J1. K0\nM30\n", "Euler", 1);
  expect_fanuc_refused("G68.2 I0 J150. K0\nG53.1\nM30\n", "cannot turn the tool", 2);
  expect_fanuc_refused("G68.2 I0 J10. K0\nG0 X1. C5.\nM30\n", "turn by themselves", 2);
  expect_fanuc_refused("G68.2 I0 J10. K0\nG55\nM30\n", "tilted plane is on", 2);
}

TEST(FanucReader, DirectionsTurnTheTool) {
  const Reading r = fanuc(
      "T1 M6\nG90 G54 G0 X0 Y0 Z100.\nG43.5 H1 I0 J0 K1.\nG1 X1. Y2. Z3. I1. J-2. K4. F600.\nX5.\nI0 J0 "
      "K1.\nG49\nM30\n%\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 5U);
  const Vec3 direction = Vec3(1, -2, 4).normalized();
  for (const std::size_t i : {2U, 3U}) EXPECT_LT((pose_of(r.moves[i], 80).axis - direction).norm(), 1e-12) << i;
  EXPECT_LT((pose_of(r.moves[2], 80).tip_mm - Vec3(1, 2, 3)).norm(), 1e-10);
  EXPECT_LT((pose_of(r.moves[4], 80).axis - Vec3::UnitZ()).norm(), 1e-12);
  EXPECT_LT((pose_of(r.moves[4], 80).tip_mm - Vec3(5, 2, 3)).norm(), 1e-10);
  expect_fanuc_refused("T1 M6\nG43.5 H1\nG1 X1. I1. B5. F100.\nM30\n", "beside a rotary axis", 3);
  expect_fanuc_refused("T1 M6\nG43.5 H1\nG2 X1. I1. F100.\nM30\n", "an arc", 3);
  expect_fanuc_refused("T1 M6\nG43.4 H1\nG1 X1. I1. F100.\nM30\n", "no use", 3);
}

TEST(FanucReader, CyclesRepeatAndTap) {
  const auto ends = [](const std::string& text) {
    const Reading r = read("O1\nT1 M6\nM3 S900\nG43 H1\nG0 X0. Y0. Z9.\n" + text + "M30\n", ReaderDialect::kFanuc);
    EXPECT_FALSE(r.result.error) << (r.result.error ? r.result.error->rule : "");
    std::string all;
    for (std::size_t i = 1; i < r.moves.size(); ++i) {
      all += r.moves[i].rapid ? " r" : " f";
      for (std::size_t k = 0; k < 3; ++k) {
        if (r.moves[i].programmed[k] != r.moves[i - 1].programmed[k])
          all += "XYZ"[k] + std::to_string(static_cast<int>(std::lround(r.moves[i].programmed[k])));
      }
    }
    return all;
  };
  EXPECT_EQ(ends("G91 G81 X5. Z-6. R-7. F100. K2\nG80\n"), " rX5 rZ2 fZ-4 rZ9 rX10 rZ2 fZ-4 rZ9");
  EXPECT_EQ(ends("G84 X5. Z-6. R2. F100.\nG80\n"), " rX5 rZ2 fZ-6 fZ2 rZ9");
  EXPECT_EQ(ends("G99 G86 X5. Z-6. R2. F100.\nG80\n"), " rX5 rZ2 fZ-6 rZ2");
  EXPECT_EQ(ends("G99 G73 X5. Z-6. R2. Q8. F100.\nG80\n"), " rX5 rZ2 fZ-6 rZ2");
  EXPECT_EQ(ends("G1 X5. F100. /Y5.\n"), " fX5") << "from the stroke on the operator's switch";
  expect_refused("O1\nF100.\nG0 Z9.\nG81 X5. Z-6. R2. K1.5\n", "K counts", 4, ReaderDialect::kFanuc);
}

}  // namespace
}  // namespace lightmill

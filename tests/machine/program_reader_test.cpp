#include "machine/program_reader.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "design/core/text.h"
#include "machine/kinematics.h"
#include "reader_rig.h"

namespace lightmill {
namespace {

using test::expect_refused;
using test::kRad;
using test::read;
using test::Reading;

TEST(ProgramReader, ArcsInEveryPlaneKeepTheirRadius) {
  const struct {
    const char* text;
    int u, v;
  } cases[] = {{"G17 G0 X30 Y0 Z0\nG3 X0 Y30 Z2 I-30 J0 F1000\nM2\n", 0, 1},
               {"G18 G0 Z30 X0 Y0\nG3 Z0 X30 Y2 K-30 I0 F1000\nM2\n", 2, 0},
               {"G19 G0 Y30 Z0 X0\nG3 Y0 Z30 X2 R30 F1000\nM2\n", 1, 2}};
  for (const auto& c : cases) {
    const Reading r = read(c.text);
    ASSERT_FALSE(r.result.error) << r.result.error->rule;
    double seconds = 0;
    for (const ProgramStep& step : r.steps) {
      if (step.kind != ProgramStep::kMove || step.rapid) continue;
      EXPECT_NEAR(std::hypot(step.programmed[c.u], step.programmed[c.v]), 30, 1e-9);
      EXPECT_GE(step.programmed[c.u], -1e-9);
      EXPECT_GE(step.programmed[c.v], -1e-9);
      seconds += step.seconds;
    }
    EXPECT_NEAR(seconds, 0.06 * std::hypot(15 * kPi, 2), 1e-9);
  }
}

TEST(ProgramReader, ExpressionsLoopsAndSubprograms) {
  const Reading r = read(
      "o100 sub\n#<r> = [#1 * 2]\nG1 X#<r> Y[#2 ** 2 + 1] F100\no100 endsub\n#5=1\no1 while [#5 le 3]\no100 call [#5] "
      "[#5+1]\n#5=[#5+1]\n"
      "o1 endwhile\no2 if [1 eq 2]\nX99\no2 elseif [#5 eq 4]\nX-1\no2 else\nX98\no2 endif\no3 repeat [2]\nG91 X5\no3 "
      "endrepeat\n"
      "G90 X[atan[1]/[1]] Y[-sin[30]] Z[2 - 3 - 4]\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 7U);
  for (int i = 1; i <= 3; ++i) {
    EXPECT_DOUBLE_EQ(r.moves[static_cast<std::size_t>(i) - 1].programmed[0], 2 * i);
    EXPECT_DOUBLE_EQ(r.moves[static_cast<std::size_t>(i) - 1].programmed[1], (i + 1) * (i + 1) + 1);
  }
  EXPECT_DOUBLE_EQ(r.moves[3].programmed[0], -1);
  EXPECT_DOUBLE_EQ(r.moves[5].programmed[0], 9);
  EXPECT_NEAR(r.moves[6].programmed[0], 45, 1e-12);
  EXPECT_NEAR(r.moves[6].programmed[1], -0.5, 1e-12);
  EXPECT_NEAR(r.moves[6].programmed[2], -5, 1e-12);
}

// The centre keeps the radius to the side: round outside corners, cut short in inside ones.
TEST(ProgramReader, CutterCompensationKeepsTheRadius) {
  const std::string start = "T1 M6 F600\nG0 X-10 Y0\n";
  const Reading r = read(start + "G41 G1 X0\nX10\nG4 P1\nY10\nX20\nY0\nG40 G0 Y20\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  const Vec3 ends[] = {{-10, 0, 0}, {0, 2, 0},   {8, 2, 0},  {8, 12 - 2, 0}, {10, 12, 0},
                       {20, 12, 0}, {22, 10, 0}, {22, 0, 0}, {20, 20, 0}};
  ASSERT_EQ(r.moves.size(), std::size(ends));
  for (std::size_t i = 0; i < std::size(ends); ++i)
    EXPECT_LT((Vec3(r.moves[i].programmed[0], r.moves[i].programmed[1], 0) - ends[i]).norm(), 1e-12) << i;
  EXPECT_NEAR(r.moves[2].seconds, 0.8, 1e-12) << "the feed holds along the centre's path";
  std::size_t dwell = 0;
  for (std::size_t i = 0; i < r.steps.size(); ++i) {
    if (r.steps[i].kind == ProgramStep::kDwell) dwell = i;
  }
  EXPECT_EQ(r.steps[dwell - 1].line, 4) << "what is said behind a move stays behind it";
  // Every chord of the arcs at outside corners keeps the radius.
  for (const ProgramStep& step : r.steps) {
    if (step.kind != ProgramStep::kMove || step.whole) continue;
    const double x = step.programmed[0], y = step.programmed[1];
    EXPECT_NEAR(x < 15 ? std::hypot(x - 10, y - 10) : std::hypot(x - 20, y - 10), 2, 1e-9);
  }
  const auto refused = [&](const std::string& text, const std::string& rule) {
    const auto lines = static_cast<long>(std::count(text.begin(), text.end(), '\n'));
    expect_refused(start + text + "\nM2\n", rule, lines + 3);
  };
  refused("G41 G1 X-8", "not longer than the cutter's radius");
  refused("G41 G1 X0\nX5\nX5 Y1\nX0", "does not reach the concave corner");
  refused("G41 G1 X0\nG3 X2 Y2 R1.2", "too small to reach");
  refused("G41 G1 X0\nG3 X3 Y3 J3\nG42", "on already");
  refused("G41 G1 X0\nG3 X1 Y1 J1", "does not fit into the arc");
  refused("G41 G1 X0\nX10\nG40 G2 X20 Y0 R10", "must be straight");
  refused("G41 G1 X0\nG55", "while cutter compensation is on");
  refused("G41 G1 X0\nG81 X1 Z1 R2", "while cutter compensation is on");
  refused("G41 G1 X0\n#1=#5420", "not known while cutter compensation");
  refused("G41 D3", "no diameter");
  refused("G41 D1.5", "names a tool");
  refused("G19 G41 D1", "G17 or G18");
  refused("G42.1", "needs D");
}

// Radius and angle about the program's zero, absolute and added.
TEST(ProgramReader, PolarWords) {
  const Reading r = read("G0 X3 Y4 Z0\nG1 @10 F100\n^90\nG91 @-4 ^-90 Z1\nG90 @[2+3] ^180\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 5U);
  const double x[] = {3, 6, 0, 6, -5}, y[] = {4, 8, 10, 0, 0};
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_NEAR(r.moves[i].programmed[0], x[i], 1e-12) << i;
    EXPECT_NEAR(r.moves[i].programmed[1], y[i], 1e-12) << i;
  }
  EXPECT_EQ(r.moves[4].programmed[2], 1);
  expect_refused("G0 X0 Y0\nG1 F100 @5\nM2\n", "no radius or angle", 2, ReaderDialect::kLinuxCnc);
  expect_refused("G1 F100 @5 ^3 X1\nM2\n", "beside X or Y", 1, ReaderDialect::kLinuxCnc);
  expect_refused("G18 G1 F100 @5 ^3\nM2\n", "G17", 1, ReaderDialect::kLinuxCnc);
  expect_refused("G92 @5 ^3\nM2\n", "two codes want", 1, ReaderDialect::kLinuxCnc);
}

// M70 keeps modes, M72 brings them back, M73 does when the subprogram returns; each call has its own.
TEST(ProgramReader, ModesAreKeptAndBroughtBack) {
  const Reading r = read(
      "o1 sub\nM73\nG91 G20 F5 G1 X1\no1 endsub\nG90 G21 F200 G1 X1\nM70\nG91 F50 X1\nM72\nX5\no1 call\nX7\n"
      "G92 X0\nX1\nG92.2\nX8\nG92.3\nX2\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  const double x[] = {1, 2, 5, 30.4, 7, 8, 8, 9};  // from the machine's zero
  // F is taken before G20 of its block.
  const double minutes[] = {11.0 / 200, 1.0 / 50, 3.0 / 200, 25.4 / 5, 23.4 / 200, 1.0 / 200, 0, 1.0 / 200};
  ASSERT_EQ(r.moves.size(), 8U);
  for (std::size_t i = 0; i < 8; ++i) {
    EXPECT_NEAR(r.moves[i].target[0] - r.moves[0].target[0] + 1, x[i], 1e-9) << i;
    EXPECT_NEAR(r.moves[i].seconds, 60 * minutes[i], 1e-9) << i;
  }
  expect_refused("M72\nM2\n", "without modes", 1, ReaderDialect::kLinuxCnc);
  expect_refused("M70\nM71\nM72\nM2\n", "without modes", 3, ReaderDialect::kLinuxCnc);
  expect_refused("M73\nM2\n", "outside of a subprogram", 1, ReaderDialect::kLinuxCnc);
}

TEST(ProgramReader, LoopsAreLeftAndContinued) {
  const Reading r = read(
      "#1=0\no1 while [#1 lt 9]\n#1=[#1+1]\no2 if [#1 eq 2]\no1 continue\no2 endif\no3 if [#1 eq 4]\no1 break\no3 "
      "endif\n"
      "G0 X#1\no1 endwhile\no4 repeat [3]\nG0 Y#1\no4 break\no4 endrepeat\n#2=0\no5 do\n#2=[#2+1]\no6 repeat [2]\n"
      "o7 if [#2 lt 3]\no5 continue\no7 endif\nG0 Z#2\no6 endrepeat\no5 while [#2 lt 3]\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_GE(r.moves.size(), 4U);
  EXPECT_EQ(r.moves[0].programmed[0], 1);
  EXPECT_EQ(r.moves[1].programmed[0], 3) << "2 is passed over, 4 ends it";
  EXPECT_EQ(r.moves[2].programmed[1], 4);
  EXPECT_EQ(r.moves[3].programmed[2], 3);
  expect_refused("o1 break\nM2\n", "outside of its loop", 1, ReaderDialect::kLinuxCnc);
}

TEST(ProgramReader, OffsetsLengthsAndMachineCoordinates) {
  const Reading r =
      read("T3 M6 G43 H3\nG0 X1 Z2\nG10 L2 P2 X100 Y0 Z0\nG55 X1\nG53 G0 Z0\nG54 G92 X7\nG0 X8\nG92.1\nG0 X8\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 5U);
  EXPECT_EQ(r.moves[0].target, (AxisValues{11, 0, -313, 0, 0}));
  EXPECT_EQ(r.moves[1].target[0], 101);
  EXPECT_EQ(r.moves[2].target[2], 0);
  EXPECT_EQ(r.moves[3].target[0], 102) << "one beyond where G92 called it 7";
  EXPECT_EQ(r.moves[4].target[0], 18);
}

// With tool-centre-point control the tip keeps its line while the table turns; the joints come from the machine file
// alone.
TEST(ProgramReader, TheTipKeepsItsLineUnderTcp) {
  const std::string moves = "G1 X1. Y2. Z30. B10. C20. F1000.\nX5. Y-3. Z31. B-20. C75.\n";
  const std::string fanuc = "%\nO1000\nT3 M6\nG90 G54 G0 X0. Y0. Z100.\nG43.4 H3\n" + moves + "G49\nM30\n%\n";
  const std::string linuxcnc = "T3 M6\nG90 G54 G43 H3\nG0 X0 Y0 Z15\nM428\n" + moves + "M429\nM2\n";
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  for (const bool is_fanuc : {true, false}) {
    const Reading r = read(is_fanuc ? fanuc : linuxcnc, is_fanuc ? ReaderDialect::kFanuc : ReaderDialect::kLinuxCnc);
    ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
    const ProgramStep* before = nullptr;
    int turning = 0;
    for (const ProgramStep& step : r.steps) {
      if (step.kind == ProgramStep::kMove && step.tcp) {
        const auto pose = [&](const AxisValues& q) { return view.cutter({q[0], q[1], q[2], q[3], q[4]}, 85).tip_mm; };
        const Vec3 planned(step.programmed[0], step.programmed[1], step.programmed[2]);
        EXPECT_LT((pose(step.target) - planned).norm(), 1e-10);
        if (before != nullptr && before->tcp) {
          ++turning;
          AxisValues middle{};
          for (std::size_t i = 0; i < 5; ++i) middle[i] = (step.target[i] + before->target[i]) / 2;
          const Vec3 from(before->programmed[0], before->programmed[1], before->programmed[2]);
          EXPECT_LT((pose(middle) - (from + planned) / 2).norm(), 6e-5) << "between two chords' ends";
        }
      }
      if (step.kind == ProgramStep::kMove) before = &step;
    }
    EXPECT_GT(turning, 10);
    EXPECT_EQ(r.moves.back().programmed[4], 75 * kRad);
  }
}

// One pocket on a slope, looped and compensated, in the words of three controls: the same motion.
TEST(ProgramReader, ThreeControlsMillTheSameTiltedPocket) {
  const Reading fanuc = read(
      "%\nO1\nT1 M6\nG90 G54 G0 X0. Y0. Z90.\nG68.2 X2. Y3. Z4. I0 J30. K0\nG53.1 P1\nG43 H1\nG0 X0 Y0 Z20.\n#100=1\n"
      "WHILE[#100LE3]DO1\nG1 Z-#100 F300.\nG41 D1 X5. F600.\nY[#100*4]\nG3 X-5. Y[#100*4] R5.\nG1 Y0\nG40 G0 X0\n"
      "#100=#100+1\nEND1\nG0 Z20.\nM30\n%\n",
      ReaderDialect::kFanuc);
  const Reading heidenhain = read(
      "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S5000\n2 L X+0 Y+0 Z+10 FMAX\n3 CYCL DEF 7.0\n4 CYCL DEF 7.1 X+2 Y+3 Z+4\n"
      "5 PLANE SPATIAL SPA+30 SPB+0 SPC+0 TURN FMAX SEQ+\n6 L X+0 Y+0 Z+20 FMAX\n7 Q1 = 1\n8 LBL 1\n9 L Z-Q1 F300\n"
      "10 L X+5 RL F600\n11 Q2 = Q1 * 4\n12 L Y+Q2\n13 CR X-5 Y+Q2 R+5 DR+\n14 L Y+0\n15 L X+0 R0 FMAX\n16 Q1 = Q1 + "
      "1\n"
      "17 CALL LBL 1 REP 2/2\n18 L Z+20 FMAX\n19 M30\n20 END PGM A MM\n",
      ReaderDialect::kHeidenhain);
  const Reading siemens = read(
      "G17 G90 G94 G54\nT1 M6\nG0 X0 Y0 Z10\nCYCLE800(0,\"TC\",0,57,2,3,4,30,0,0,0,0,0,1)\nG0 X0 Y0 Z20\nFOR R1=1 TO "
      "3\n"
      "G1 Z=-R1 F300\nG41 X5 F600\nY=R1*4\nG3 X-5 Y=R1*4 CR=5\nG1 Y0\nG40 G0 X0\nENDFOR\nG0 Z20\nM30\n",
      ReaderDialect::kSiemens);
  ASSERT_FALSE(fanuc.result.error) << fanuc.result.error->line << ": " << fanuc.result.error->rule;
  for (const Reading* other : {&heidenhain, &siemens}) {
    ASSERT_FALSE(other->result.error) << other->result.error->line << ": " << other->result.error->rule;
    ASSERT_EQ(other->steps.size(), fanuc.steps.size());
    for (std::size_t i = 0; i < fanuc.steps.size(); ++i) {
      EXPECT_EQ(other->steps[i].kind, fanuc.steps[i].kind) << i;
      EXPECT_NEAR(other->steps[i].seconds, fanuc.steps[i].seconds, 1e-9) << i;
      for (std::size_t k = 0; k < 5; ++k) EXPECT_NEAR(other->steps[i].target[k], fanuc.steps[i].target[k], 1e-9) << i;
    }
  }
  EXPECT_GT(fanuc.moves.size(), 20U);
}

TEST(ProgramReader, DrillsAsTheCycleSays) {
  const Reading r = read("G0 Z20\nG99 G81 X10 Y5 Z-3 R2 F100\nX20\nG98 X30\nG80\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->rule;
  int bottoms = 0;
  for (const ProgramStep& step : r.moves) bottoms += !step.rapid && step.programmed[2] == -3;
  EXPECT_EQ(bottoms, 3);
  EXPECT_EQ(r.moves.back().programmed[2], 20) << "where the cycles began";
}

// A cubic and a quadratic by their Bezier polynomials, a circle as a rational spline, and one of more points.
TEST(ProgramReader, SplinesFollowTheirClosedForms) {
  const auto worst = [](const Reading& r, auto off) {
    double most = 0;
    for (const ProgramStep& step : r.steps) {
      if (step.kind == ProgramStep::kMove && !step.rapid)
        most = std::max(most, off(step.programmed[0], step.programmed[1]));
    }
    return most;
  };
  // Against the nearest of many points of the polynomial.
  const auto bezier = [](const std::vector<Vec3>& p) {
    std::vector<Vec3> curve;
    for (int i = 0; i <= 8000; ++i) {
      std::vector<Vec3> q = p;
      for (std::size_t n = q.size() - 1; n > 0; --n) {
        for (std::size_t k = 0; k < n; ++k) q[k] += i / 8000.0 * (q[k + 1] - q[k]);
      }
      curve.push_back(q[0]);
    }
    return [curve](double x, double y) {
      double least = 1e9;
      for (const Vec3& q : curve) least = std::min(least, (q - Vec3(x, y, 0)).norm());
      return least;
    };
  };
  const Reading cubic = read("F600 G0 X1 Y2\nG5 X11 Y4 I3 J6 P-4 Q5\nM2\n");
  ASSERT_FALSE(cubic.result.error) << cubic.result.error->rule;
  ASSERT_GT(cubic.steps.size(), 20U);
  EXPECT_LT(worst(cubic, bezier({{1, 2, 0}, {4, 8, 0}, {7, 9, 0}, {11, 4, 0}})), 2e-3);
  const Reading quadratic = read("F600 G0 X1 Y2\nG91 G5.1 X4 Y-3 I2 J6\nM2\n");
  ASSERT_FALSE(quadratic.result.error) << quadratic.result.error->rule;
  EXPECT_LT(worst(quadratic, bezier({{1, 2, 0}, {3, 8, 0}, {5, -1, 0}})), 2e-3);
  // A quarter of a circle has the middle weight cos 45 degrees.
  const Reading circle =
      read("F600 G0 X5 Y0\nG5.2 P1\nX5 Y5 P" + std::to_string(std::sqrt(0.5)) + "\nX0 Y5 P1\nG5.3\nG1 X0 Y0\nM2\n");
  ASSERT_FALSE(circle.result.error) << circle.result.error->rule;
  double seconds = 0, most = 0;
  for (const ProgramStep& step : circle.steps) {
    if (step.kind != ProgramStep::kMove || step.rapid || step.line > 5) continue;
    most = std::max(most, std::abs(std::hypot(step.programmed[0], step.programmed[1]) - 5));
    seconds += step.seconds;
  }
  EXPECT_LT(most, 1e-6);
  EXPECT_NEAR(seconds, 2.5 * kPi / 10, 1e-4);
  EXPECT_EQ(circle.moves.back().programmed[0], 0);
  // Uniform clamped knots: with all weights one and points on a line, the spline stays on it and ends at its last
  // point.
  const Reading line = read("F600 G0 X0 Y0\nG5.2 X1 Y2 P1 L4\nX2 Y4 P3\nX5 Y10 P1\nX6 Y12 P2\nG5.3\nM2\n");
  ASSERT_FALSE(line.result.error) << line.result.error->rule;
  EXPECT_LT(worst(line, [](double x, double y) { return std::abs(y - 2 * x); }), 1e-9);
  EXPECT_EQ(line.moves.back().programmed[0], 6);
  // The second cubic goes on in the first one's direction.
  const Reading two = read("F600 G0 X0 Y0\nG5 X10 Y0 I3 J4 P-3 Q-4\nG5 X20 P-3 Q4\nM2\n");
  ASSERT_FALSE(two.result.error) << two.result.error->rule;
  const auto second = bezier({{10, 0, 0}, {13, 4, 0}, {17, 4, 0}, {20, 0, 0}});
  EXPECT_LT(worst(two, [&](double x, double y) { return x <= 10 ? 0 : second(x, y); }), 2e-3);

  const auto refused = [](const std::string& text, const std::string& rule) {
    expect_refused("F600\n" + text + "\nM2\n", rule,
                   1 + static_cast<long>(std::count(text.begin(), text.end(), '\n')) + 1);
  };
  refused("G5 X1 Y1 I1 P1 Q1", "I and J belong together");
  refused("G5 X1 Y1 I1 J1 P1", "needs P and Q");
  refused("G5 X1 Z1 I1 J1 P1 Q1", "X and Y only");
  refused("G18 G5.1 X1 Y1 I1 J1", "need G17");
  refused("G5.3", "without G5.2");
  refused("G5.2 X1 Y1 P1\nG5.3", "as many control points");
  refused("G5.2 X1 Y1 P1\nG1 X3", "only G5.2");
  refused("G5.2 X1 P1", "X and Y");
  refused("G5.2 X1 Y1 P-1", "positive weight");
}

// No probe, no inputs, no outputs, no encoder: what the control would answer without them.
TEST(ProgramReader, AnswersAsAControlWithoutSignals) {
  const Reading r = read(
      "F600 G38.3 Z-10\nG1 X#5063 Y[#5070+1]\nM62 P1\nM64 P0\nM68 E0 Q1\nM66 P0 L3 Q2\nG1 X#5399\nM66 E1 L0\nG1 "
      "X#5399\nM50 P0\nG97 S100 M3\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 4U);
  EXPECT_EQ(r.moves[1].programmed[0], -10);
  EXPECT_EQ(r.moves[1].programmed[1], 1);
  EXPECT_EQ(r.moves[2].programmed[0], -1) << "waited in vain";
  EXPECT_EQ(r.moves[3].programmed[0], 0);
  EXPECT_EQ(std::count_if(r.steps.begin(), r.steps.end(),
                          [](const ProgramStep& s) { return s.kind == ProgramStep::kDwell && s.seconds == 2; }),
            1);
  const Reading probed = read("F600\nG38.2 Z-10\nM2\n");
  ASSERT_EQ(probed.moves.size(), 1U) << "the move is made";
  ASSERT_TRUE(probed.result.error);
  EXPECT_NE(probed.result.error->rule.find("no contact"), std::string::npos);
  expect_refused("F600\nG38.4 Z-10\nM2\n", "no contact that could open", 2);
  expect_refused("F600 G91\nG38.3 Z0.1\nM2\n", "too short", 2);
  expect_refused("M66 P0 L3\nM2\n", "needs a time", 1);
  expect_refused("M62\nM2\n", "needs P", 1);
  for (const char* code : {"G7", "G71", "G96"}) expect_refused(std::string(code) + " S100\nM2\n", "lathes", 1);
  for (const char* code : {"G33", "G33.1", "G76"})
    expect_refused(std::string("S100 M3\n") + code + " Z1 K1\nM2\n", "encoder", 2);
}

// F times the spindle's speed; LinuxCNC's rs274 refuses S0 in the same words' place, and takes F of another mode for
// none.
TEST(ProgramReader, FeedPerRevolutionGoesWithTheSpindle) {
  const struct {
    ReaderDialect dialect;
    const char *head, *point, *end;
  } controls[] = {{ReaderDialect::kLinuxCnc, "G21 G90\n", "", "M2\n"},
                  {ReaderDialect::kFanuc, "%\nO1\nG21 G90\n", ".", "M30\n%\n"},
                  {ReaderDialect::kSiemens, "G54 G90\n", "", "M30\n"}};
  for (const auto& c : controls) {
    const std::string head = c.head, dot = c.point, turning = head + "G0 X0 Y0\nS1000 M3\nG95 F0.1\n";
    const auto run = [&](const std::string& text) { return read(text + c.end, c.dialect); };
    // 10 mm at 0.1 mm a revolution: 100 revolutions, at 1000, 2000 a minute; then an arc of the same length; per minute
    // again.
    const Reading r = run(turning + "G1 X10" + dot + "\nS2000\nX20" + dot + "\nG2 X20" + dot + " Y0 I0 J" +
                          fixed(5 / kPi, 9) + "\nG94 F300\nG1 X30" + dot + "\n");
    ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
    std::vector<double> seconds(5);  // the rapid first
    std::size_t move = 0;
    for (const ProgramStep& step : r.steps) {
      if (step.kind != ProgramStep::kMove) continue;
      ASSERT_LT(move, 5U);
      seconds[move] += step.seconds;
      move += step.whole ? 1 : 0;
    }
    EXPECT_NEAR(seconds[1], 6, 1e-9);
    EXPECT_NEAR(seconds[2], 3, 1e-9);
    EXPECT_NEAR(seconds[3], 3, 1e-3);
    EXPECT_NEAR(seconds[4], 2, 1e-9);
    const auto refused = [&](const std::string& text, const std::string& rule) {
      const Reading bad = run(text);
      ASSERT_TRUE(bad.result.error) << text;
      EXPECT_NE(bad.result.error->rule.find(rule), std::string::npos) << bad.result.error->rule;
    };
    refused(head + "G95 F0.1\nG1 X10" + dot + "\n", "spindle stands");
    refused(turning + "G1 X10" + dot + "\nM5\nX20" + dot + "\n", "spindle stands");
    refused(turning + "G94\nG1 X10" + dot + "\n", "feed not given");
    refused(head + "S1000 M3\nF100" + dot + "\nG95\nG1 X10" + dot + "\n", "feed not given");
  }
}

TEST(ProgramReader, ReferencePointsAndLocalShifts) {
  const Reading r = read("G0 X5 Y6 Z7\nG28.1\nG0 X1 Y1 Z1\nG28 Z9\nG30\nG52 X10\nG0 X0 Y0\nM2\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 6U);
  EXPECT_EQ(r.moves[2].programmed[2], 9);
  EXPECT_EQ(r.moves[3].programmed, (AxisValues{1, 1, 7, 0, 0}));
  EXPECT_EQ(r.moves[4].target, (AxisValues{}));
  EXPECT_EQ(r.moves[5].target[0], 20) << "G54 at 10, G52 by 10 more";
}

TEST(ProgramReader, RefusesWhatItCannotObeyWithLineAndRule) {
  expect_refused("G21\nG1 X1\nM2\n", "feed", 2);
  expect_refused("G93 G1 X1 F1\nX2\nM2\n", "F is missing", 2);
  EXPECT_FALSE(read("G21 G40 G90 G43 H1 S5000 T1 M6 M3 M8\nM2\n").result.error)
      << "M codes have modal groups of their own";
  expect_refused("M3 M4\nM2\n", "modal group", 1);
  expect_refused("O1\nG4 X-1.\nM30\n", "negative", 2, ReaderDialect::kFanuc);
  expect_refused("G90 G91\nM2\n", "modal group", 1);
  expect_refused("G41.2 D1\nM2\n", "not known", 1);
  expect_refused("G43.4 H1\nM2\n", "not known", 1);
  expect_refused("M128\nM2\n", "not known", 1);
  expect_refused("G0 A1\nM2\n", "not known to this machine", 1);
  expect_refused("G0 X1 X2\nM2\n", "repeated", 1);
  expect_refused("G0 X1e5\nM2\n", "word E", 1);
  expect_refused("G0 X[1/0]\nM2\n", "no number", 1);
  expect_refused("G0 X#<nothing>\nM2\n", "never set", 1);
  expect_refused("G0 X1 P2\nM2\n", "no use", 1);
  expect_refused("T7 M6\nM2\n", "tool table", 1);
  expect_refused("G2 X10 Y0 I1 J0 F100\nM2\n", "do not fit", 1);
  expect_refused("G0 X1\n", "ends without", 1);
  expect_refused("o1 while [1]\no1 endwhile\nM2\n", "does not end", 1);
  expect_refused("G0 C400000\nM2\n", "turn too far", 1);
  expect_refused("o1 sub\no1 call\no1 endsub\no1 call\nM2\n", "too deeply", 2);
  expect_refused("O1\nG0 X10\nM30\n", "decimal point", 2, ReaderDialect::kFanuc);
  expect_refused("O1\nM98 P9\nM30\n", "not in this file", 2, ReaderDialect::kFanuc);
  expect_refused("O1\nG0 X\nM30\n", "value is missing", 2, ReaderDialect::kFanuc);
}

// Seeded mutations of a program: an error or motion, never a crash, a hang or a place that is no number.
TEST(ProgramReader, SurvivesMutatedPrograms) {
  const std::string seed =
      "%\no1 sub\nG1 X#1 Y[#2*2] F100\no1 endsub\nN10 T1 M6 G43 H1\no1 call [1] [2]\nG2 X3 I1 J0\nM428\nG93 G1 X1 B10 "
      "C20 "
      "F10\nM429\n"
      "G94 G81 X1 Z-1 R2 F5\no2 while [#5 lt 3]\n#5=[#5+1]\no2 endwhile\no3 if [#5 gt 1]\nX1\no3 else\nX2\no3 "
      "endif\nM2\n%\n";
  const std::string conversational =
      "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S5000\n2 L X+1 Y-2 R0 F500 M3\n3 CC X+0 Y-2\n4 C X-1 Y-2 DR+\n5 LBL 1\n6 L "
      "IX+1 B+5\n"
      "7 CALL LBL 1 REP3\n8 M128\n9 L C+90 B-10\n10 M129\n11 CYCL DEF 7.0\n12 CYCL DEF 7.1 X+5\n13 CYCL DEF 247 "
      "~\nQ339=1\n14 END PGM A MM\n";
  const std::string iso =
      "%A G71 *\nN1 G30 G17 X-1 Y-1 Z+0 *\nN2 T1 G17 S5000 DL-2 *\nN3 G247 Q339=+1 *\nN4 G62 T0.002 P01 0 P02 0.02 "
      "*\nN5 G01 X+1 "
      "Y-2 F500 M3 *\nN6 G02 X-1 Y-2 I+0 J-2 *\nN7 M128 *\nN8 G01 C+90 B-10 *\nN9 M129 *\nN10 M30 *\nN99999999 %A G71 "
      "*\n";
  const std::string siemens =
      "; %_N_A_MPF\nTRAFOOF\nG17 G40 G71 G90 G94 G54\nSUPA G0 Z0 D0\nT1 M6\nS5000 "
      "M3\nCYCLE832(0.002,_ORI_FINISH,0.02)\nD1\nG1 X=1 "
      "Y2 F500\nG2 X3 I1 J0\nTRAORI\nORIWKS ORIAXES\nG1 B10 C=DC(20)\nTRAFOOF\nG93 X1 F10\nM30\n";
  const std::string contour =
      "T1 M6 F100\nG0 X-10 Y0\nG41 D1 G1 X0\nX10\nY10\nG3 X0 Y20 R10\nG4 P1\nG2 X-5 Y15 I0 J-5\nG1 Z3\nG40 G0 X20\nG5 "
      "X10 "
      "Y5 I3 J4 P-2 "
      "Q1\nG5.2 P2\nX40 Y0 P1 L4\nX45 Y5 P1\nX50 Y6 P2\nG5.3\nG98 G73 X1 Z-1 R1 Q0.7 L2\nG38.3 Z-3\nM66 P0 L3 Q1\nM2\n";
  const std::string macro =
      "%\nO1\nT1 M6 G43 H1 F100.\n#100=0\nWHILE[#100LT3]DO1\n#100=#100+1\nIF[#100EQ2]GOTO9\nG65 P2 A#100 B2.\nN9 "
      "G1 X[SIN[30]*#100]\nEND1\nG66 P2 A1.\nX5.\nG67\nIF[#1EQ#0]THEN#2=1\nM98 P3 L2\nG68.2 X1. I30. J20. K5.\nG53.1 "
      "P1\nX1. Y2.\nG69\nG43.5 H1\nX2. I1. K2.\nG49\nG54.1 P2\nM30\nO2\nG91 Z-#1\nG90\nM99\nO3\nG41 D1 X9.\nG40 "
      "X5.\nM99\n%\n";
  const std::string reckoning =
      "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S5000\n2 FN 0: Q1 = +0\n3 LBL 1\n4 Q1 = Q1 + 2 * SIN( 30 )\n5 CC X+Q1 "
      "Y+0\n6 LP PR+5 PA+30 F100\n7 CP IPA+400 IZ-1 DR+\n8 CT X+9 Y+9\n9 FN 12: IF +Q1 LT +3 GOTO LBL 1\n10 L X-9 "
      "RL\n11 "
      "L Y+20\n12 L X+0 R0\n13 PLANE SPATIAL SPA+10 SPB+20 SPC+30 MOVE DIST5 F500\n14 L X+1\n15 PLANE RESET TURN "
      "FMAX\n16 M128\n17 LN X+1 NX+0 NZ+1 TX+1 TZ+2\n18 END PGM A MM\n";
  const std::string frames =
      "G17 G54 F100\nDEF REAL AA=2\nT1 M6\nFOR R1=1 TO 3\nIF R1==2 GOTOF NEXT\nTRANS X=R1\nAROT Z30\nG1 "
      "X=IC(AA*R1)\nNEXT:\nENDFOR\nWHILE R2<2\nR2=R2+1\nL5 "
      "P2\nENDWHILE\nCYCLE800(0,\"T\",0,57,0,0,0,10,20,30,0,0,0,1)\nX1"
      "\nCYCLE800()\nG41 X9\nG40 Y9\nTRAORI\nORIWKS ORIVECT\nA3=1 C3=2\nTRAFOOF\nG18 G2 X=IC(3) CR=5 "
      "TURN=1\nM30\n%_N_L5_SPF\nY"
      "=MINVAL(R2,1)\nRET\n";
  std::mt19937 random(7);
  const std::string letters = "GMXYZBCFIJKLOPQRSTD#[]<>()%/*+-.=:,0123456789 \n\t";
  const struct {
    const std::string& text;
    ReaderDialect dialect;
  } seeds[] = {{conversational, ReaderDialect::kHeidenhain},
               {iso, ReaderDialect::kHeidenhainIso},
               {siemens, ReaderDialect::kSiemens},
               {contour, ReaderDialect::kLinuxCnc},
               {seed, ReaderDialect::kLinuxCnc},
               {macro, ReaderDialect::kFanuc},
               {reckoning, ReaderDialect::kHeidenhain},
               {frames, ReaderDialect::kSiemens}};
  for (const auto& [text, dialect] : seeds) {
    const Reading whole = read(text, dialect);
    EXPECT_FALSE(whole.result.error) << text << whole.result.error->line << ": " << whole.result.error->rule;
  }
  for (int run = 0; run < 3000; ++run) {
    std::string text = seeds[static_cast<std::size_t>(run) % std::size(seeds)].text;
    for (unsigned n = random() % 6 + 1; n > 0; --n) {
      const std::size_t at = random() % text.size();
      switch (random() % 3) {
        case 0:
          text[at] = random() % 8 ? letters[random() % letters.size()] : static_cast<char>(random());
          break;
        case 1:
          text.erase(at, random() % 9 + 1);
          break;
        default:
          text.insert(at, text.substr(random() % text.size(), random() % 20));
          break;
      }
      if (text.empty()) text = "X";
    }
    for (const ReaderDialect dialect : {ReaderDialect::kLinuxCnc, ReaderDialect::kFanuc, ReaderDialect::kHeidenhain,
                                        ReaderDialect::kHeidenhainIso, ReaderDialect::kSiemens}) {
      const Reading r = read(text, dialect, 500);
      for (const ProgramStep& step : r.moves) {
        for (const double q : step.target) ASSERT_TRUE(std::isfinite(q)) << run;
        ASSERT_TRUE(std::isfinite(step.seconds) && step.seconds >= 0) << run;
      }
    }
  }
}

// As rs274 does it: a subprogram without arguments sees and sets its caller's parameters.
TEST(ProgramReader, CallsFanucSubprogramsInLinuxCnc) {
  const Reading r = read(
      "O1 (main)\n#1=5\nG0 X1\nM98 P100 L2\nX#1\nX#5221 Y[#5222*2] Z[#5220+#5223]\nM30\nO100\nG0 "
      "Y#1\n#1=[#1+1]\nM99\n");
  ASSERT_FALSE(r.result.error) << r.result.error->rule;
  const double ends[][2] = {{1, 0}, {1, 5}, {1, 6}, {7, 6}, {10, -10}};
  ASSERT_EQ(r.moves.size(), std::size(ends));
  for (std::size_t i = 1; i < std::size(ends); ++i) {
    for (std::size_t k = 0; k < 2; ++k) EXPECT_NEAR(r.moves[i].programmed[k], ends[i][k], 1e-12) << i;
  }
  EXPECT_NEAR(r.moves.back().programmed[2], -399, 1e-12) << "G54 and its Z";
  expect_refused("M98 P100\nM30\nO100 sub\nO100 endsub\n", "not in this file", 1);
  expect_refused("#5221=3\nM2\n", "set these", 1);
  expect_refused("G0 X#5211\nM2\n", "not known here", 1);
}

}  // namespace
}  // namespace lightmill

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

TEST(SiemensReader, SuppressesFramesAndTurnsTheShortWay) {
  const Reading r = read(
      "; %_N_LENS_MPF\nG17 G40 G71 G90 G94\nG54\nSUPA G0 Z0 D0\nT3 M6\nS20000 M3\nG4 F8\nD1\nG0 X=10 Y2 Z30\nSUPA G0 "
      "Z-50\n"
      "SUPA G0 Z-50 D0\nG0 C=DC(190)\nC=DC(10)\nC=AC(-20)\nC=IC(5)\nD1\nTRAORI\nG54\nORIWKS ORIAXES\nG1 X1 Y2 Z30 B10 "
      "F1200\n"
      "TRAFOOF\nG93 G1 X2 F60\nM5\nM30\n",
      ReaderDialect::kSiemens);
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 10U);
  EXPECT_EQ(r.moves[1].target, (AxisValues{20, -3, -400 + 85 + 30, 0, 0}));
  EXPECT_EQ(r.moves[2].target[2], 35) << "SUPA alone keeps the tool's length";
  EXPECT_EQ(r.moves[3].target[2], -50);
  EXPECT_NEAR(r.moves[4].programmed[4], -170 * kRad, 1e-12);
  EXPECT_NEAR(r.moves[5].programmed[4], 10 * kRad, 1e-12) << "180 degrees on, either way";
  EXPECT_NEAR(r.moves[7].programmed[4], -15 * kRad, 1e-12);
  WorkpieceView view(test::skew_machine(), {10, -5, -400});
  const AxisValues& q = r.moves[8].target;
  EXPECT_LT((view.cutter({q[0], q[1], q[2], q[3], q[4]}, 85).tip_mm - Vec3(1, 2, 30)).norm(), 1e-10);
  EXPECT_DOUBLE_EQ(r.moves[9].seconds, 1);

  const auto refused = [](const std::string& block, const std::string& rule) {
    expect_refused("G54\n" + block + "\nM30\n", rule, 2, ReaderDialect::kSiemens);
  };
  refused("G1 X1", "feed not given");
  refused("G0 X1 X2", "named twice");
  refused("G0 C=DC(400)", "take an angle");
  refused("G0 X1Y2", "blanks");
  refused("G0 X1e5", "blanks");
  refused("G55 G54", "one group");
  refused("G41", "no diameter");
  refused("G43", "G43 is not known");
  refused("M128", "M code");
  refused("R1=5 G0 X1", "block of their own");
  refused("X=R1/0", "no number");
  refused("COMPCAD", "COMPCAD is not known");
  refused("L7", "L7 is not in this file");
  refused("MIRROR X0", "shift and turn only");
  refused("G1 A3=1 F100", "need TRAORI");
  refused("CYCLE832(0.1", "')'");
  refused("T9", "tool table");
  refused("G4", "seconds");
  refused("D2", "cutting edges");
  expect_refused("T1 M6\nTRAORI\nSUPA G0 Z0 D0\nM30\n", "TRAFOOF", 3, ReaderDialect::kSiemens);
  expect_refused("T1 M6\nTRAORI\nG0 B10\nM30\n", "ORIAXES", 3, ReaderDialect::kSiemens);
  expect_refused("G93 G1 X1 F60\nX2\nM30\n", "F is missing", 2, ReaderDialect::kSiemens);
  expect_refused("G0 X1\n", "ends without", 1, ReaderDialect::kSiemens);
}

Reading siemens(const std::string& text) {
  return read("G17 G90 G71 G94 G54\n" + text, ReaderDialect::kSiemens);
}
void expect_siemens_refused(const std::string& text, const std::string& rule, long line) {
  expect_refused("G54\n" + text, rule, line + 1, ReaderDialect::kSiemens);
}

// A program that reckons and loops is what it does, written out.
TEST(SiemensReader, LoopsAreTheirUnrolledPrograms) {
  const Reading loops = siemens(
      "DEF REAL STEP=10, WIDTH\nWIDTH=STEP/2 + 1\nF600\nR1=0\nWHILE R1 < 2\nR1=R1+1\nG1 X=R1*STEP Y=-WIDTH\nENDWHILE\n"
      "FOR R2=1 TO 3\nIF (R2==2) AND NOT (R1<>2)\nG0 Z=R2\nELSE\nIF R2>2\nG0 Z=10*R2\nENDIF\nENDIF\nENDFOR\n"
      "REPEAT\nR1=R1-1\nX=IC(SIN(30)*R1)\nUNTIL R1<=0\n"
      "LOOP\nR3=R3+1\nIF R3>=2 GOTOF DONE\nY=R3\nENDLOOP\nDONE: Y=TRUNC(7.9) DIV 2\n"
      "AGAIN:\nR4=R4+1\nG1 X=R4\nIF R4<2 GOTOB AGAIN\nGOTO N99\nX77\nN99 X=R[1+1] Y=MAXVAL(3,ATAN2(1,1))\nM30\n");
  const Reading unrolled =
      siemens("F600\nG1 X10 Y-6\nG1 X20 Y-6\nG0 Z2\nG0 Z30\nX=IC(0.5)\nX=IC(0)\nY1\nY3\nG1 X1\nG1 X2\nX4 Y45\nM30\n");
  expect_same_steps(loops, unrolled);
  expect_siemens_refused("IF 0\nM30\n", "no other end", 1);
  expect_siemens_refused("ENDWHILE\nM30\n", "no other end", 1);
}

TEST(SiemensReader, CallsItsSubprograms) {
  const Reading r = siemens(
      "R1=1\nL10 P3\nSIDE\nG0 X=R1\nM30\n%_N_L10_SPF\n;$PATH=/_N_SPF_DIR\nG0 Y=R1\nR1=R1+1\nM17\n"
      "PROC SIDE\nG0 Z-1\nL10\nRET\n");
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), 6U);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(r.moves[i].programmed[1], 1.0 + static_cast<double>(i));
  EXPECT_EQ(r.moves[3].programmed[2], -1);
  EXPECT_EQ(r.moves[4].programmed[1], 4);
  EXPECT_EQ(r.moves[5].programmed[0], 5);
  expect_siemens_refused("L10\nM30\n%_N_L10_SPF\nL10\nM17\n", "too deeply", 4);
  expect_siemens_refused("G0 X1\n%_N_L10_SPF\nM17\n", "does not end", 2);
  expect_siemens_refused("GOTOF LAB\nM30\n%_N_L10_SPF\nLAB: M17\n", "label LAB is not found", 1);
  expect_siemens_refused("LAB:\nGOTOF LAB\nM30\n", "label LAB is not found", 2);
  expect_siemens_refused("LAB:\nGOTOB LAB\nM30\n", "does not end", 2);
  expect_siemens_refused("ENDIF\nX=NOTHING\nM30\n", "bad number", 2);
  expect_siemens_refused("G0 X=$P_TOOL\nM30\n", "system variable", 1);
  expect_siemens_refused("DEF STRING[8] AA\nM30\n", "REAL, INT and BOOL", 1);
}

void expect_points(const Reading& r, const std::vector<Vec3>& points) {
  ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
  ASSERT_EQ(r.moves.size(), points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k)
      EXPECT_NEAR(r.moves[i].programmed[k], points[i][static_cast<int>(k)], 1e-9) << i;
  }
}
TEST(SiemensReader, SubprogramsTakeValues) {
  expect_points(
      siemens(
          "DEF INT NN=2.6\nDEF REAL RAD=7\nG0 X0 Y0 Z0\nSTEP(4)\nSTEP(,9) P2\nX=NN Y=RAD\nM30\nPROC STEP(REAL RAD, INT "
          "COUNT=1.4)\nX=RAD Y=COUNT\nRAD=99\nRET\n"),
      {{0, 0, 0}, {4, 1, 0}, {0, 9, 0}, {99, 9, 0}, {3, 7, 0}});
  expect_siemens_refused("STEP(1,2)\nM30\nPROC STEP(REAL AA)\nRET\n", "more values", 1);
  expect_siemens_refused("STEP(1\nM30\nPROC STEP(REAL AA)\nRET\n", "')' is missing", 1);
  expect_siemens_refused("STEP(1)\nM30\nPROC STEP(REAL AA\nRET\n", "does not end", 1);
}

TEST(SiemensReader, DrillsOnceAndBehindEveryMove) {
  const Reading holes = siemens(
      "T1 D1 M6\nS900 M3\nG0 X0 Y0 Z50\nF300\nCYCLE82(10,1,2,-5,,0.5)\nMCALL "
      "CYCLE81(20,0,2,,6)\nX9\nY9\nZ30\nMCALL\nX0\nM30\n");
  expect_points(holes, {{0, 0, 50},
                        {0, 0, 3},
                        {0, 0, -5},
                        {0, 0, 10},
                        {9, 0, 10},
                        {9, 0, 2},
                        {9, 0, -6},
                        {9, 0, 20},
                        {9, 9, 20},
                        {9, 9, 2},
                        {9, 9, -6},
                        {9, 9, 20},
                        {9, 9, 30},
                        {0, 9, 30}});
  EXPECT_NEAR(holes.moves[2].seconds, 1.6, 1e-12);
  // Out of the hole after 5, 9, 12, 14, 15, then 0.75 twice; 0.6 mm before the ground the feed begins.
  expect_points(siemens("G0 X0 Y0 Z10\nF300\nCYCLE83(10,0,1,-16.5,,-5,,1,0,0,0.5,1)\nM30\n"),
                {{0, 0, 10}, {0, 0, 1},     {0, 0, -5},    {0, 0, 1}, {0, 0, -4.4},  {0, 0, -9},
                 {0, 0, 1},  {0, 0, -8.4},  {0, 0, -12},   {0, 0, 1}, {0, 0, -11.4}, {0, 0, -14},
                 {0, 0, 1},  {0, 0, -13.4}, {0, 0, -15},   {0, 0, 1}, {0, 0, -14.4}, {0, 0, -15.75},
                 {0, 0, 1},  {0, 0, -15.15}, {0, 0, -16.5}, {0, 0, 10}});
  // Chips are broken by 1 mm.
  const Reading chips = siemens("G0 X0 Y0 Z10\nF300\nCYCLE83(10,0,1,-8,,,4,0,0.25,0,0.5,0)\nM30\n");
  expect_points(chips, {{0, 0, 10}, {0, 0, 1}, {0, 0, -4}, {0, 0, -3}, {0, 0, -8}, {0, 0, 10}});
  EXPECT_NEAR(chips.moves[2].seconds, 2, 1e-12) << "half the feed";
  expect_siemens_refused("F9\nCYCLE81(10,0)\nM30\n", "needs RTP", 2);
  expect_siemens_refused("F9\nCYCLE81(10,0,2,5)\nM30\n", "above the depth", 2);
  expect_siemens_refused("CYCLE81(10,0,2,-5)\nM30\n", "feed not given", 1);
  expect_siemens_refused("F9\nCYCLE81(10,0,2,-5,,0,0,12)\nM30\n", "too many", 2);
  expect_siemens_refused("MCALL POCKET4(1)\nM30\n", "MCALL", 1);
}

TEST(SiemensReader, RoundsAndChamfersCorners) {
  const double half = std::sqrt(2.);
  expect_points(
      siemens("G1 X0 Y0 Z0 F600\nX10 RND=2\nY10 CHR=3\nX0 CHF=2\nY0\nM30\n"),
      {{0, 0, 0}, {8, 0, 0}, {10, 2, 0}, {10, 7, 0}, {7, 10, 0}, {half, 10, 0}, {0, 10 - half, 0}, {0, 0, 0}});
  // In the plane Z X, where an arc comes in.
  const double root = std::sqrt(35.);
  expect_points(siemens("G18 G1 X0 Y0 Z0 F600\nZ10 RND=1\nG2 Z15 X5 CR=5\nG1 Z30\nM30\n"),
                {{0, 0, 0}, {0, 0, 15 - root}, {5. / 6, 0, 15 - 5 * root / 6}, {5, 0, 15}, {5, 0, 30}});
  expect_siemens_refused("G1 X0 Y0 F600\nX10 RND=11\nY10\nM30\n", "larger than the paths", 3);
  // Nothing is left of the path for a second corner.
  expect_siemens_refused("G1 X0 Y0 F600\nX10 CHR=5\nY5 RND=1\nX0\nM30\n", "between paths", 4);
  expect_siemens_refused("G1 X0 Y0 F600\nX10 RND=1\nM30\n", "another path", 3);
  expect_siemens_refused("G1 X0 Y0 F600\nX10 RND=1\nG0 Y5\nM30\n", "feed per minute", 3);
  expect_siemens_refused("G1 X0 Y0 F600\nX10 RND=1 CHR=1\nM30\n", "one of RND", 2);
  expect_siemens_refused("G1 X0 Y0 F600\nX10 RND=1\nTRANS X3\nM30\n", "another path", 3);
}

TEST(SiemensReader, ArcsInEveryPlane) {
  // The same quarter turn from (30, 0) about the origin, by relative and absolute centres and by radius, in three
  // planes.
  const struct {
    const char* text;
    int u, v, w;
  } cases[] = {{"G17 G0 X30 Y0 Z0\nG3 X0 Y30 Z2 I-30 J0 F1000", 0, 1, 2},
               {"G17 G0 X30 Y0 Z0\nG3 X0 Y30 Z2 I=AC(0) J=AC(0) F1000", 0, 1, 2},
               {"G18 G0 Z30 X0 Y0\nG3 Z0 X30 Y2 K-30 I0 F1000", 2, 0, 1},
               {"G18 G0 Z30 X0 Y0\nG3 Z=IC(-30) X=AC(30) Y2 CR=30 F1000", 2, 0, 1},
               {"G19 G0 Y30 Z0 X0\nG3 Y0 Z30 X2 CR=30 F1000", 1, 2, 0},
               {"G19 G0 Y30 Z0 X0\nG3 Y0 Z30 X2 J=AC(0) K=AC(0) TURN=0 F1000", 1, 2, 0}};
  for (const auto& c : cases) {
    const Reading r = siemens(std::string(c.text) + "\nM30\n");
    ASSERT_FALSE(r.result.error) << c.text << r.result.error->rule;
    double seconds = 0;
    for (const ProgramStep& step : r.steps) {
      if (step.kind != ProgramStep::kMove || step.rapid) continue;
      EXPECT_NEAR(std::hypot(step.programmed[c.u], step.programmed[c.v]), 30, 1e-9);
      seconds += step.seconds;
    }
    EXPECT_NEAR(seconds, 0.06 * std::hypot(15 * kPi, 2), 1e-9) << c.text;
    EXPECT_EQ(r.moves.back().programmed[c.w], 2);
  }
  const Reading turns = siemens("G0 X30 Y0\nG3 X30 Y0 I-30 TURN=2 F1000\nM30\n");
  double seconds = 0;
  for (const ProgramStep& step : turns.steps) seconds += step.seconds;
  EXPECT_NEAR(seconds, 0.06 * 180 * kPi, 1e-9);
  expect_siemens_refused("G18 G2 X1 Z1 J1 F100\nM30\n", "across", 1);
  expect_siemens_refused("G2 X1 Y1 I1 CR=2 F100\nM30\n", "centre or CR", 1);
  expect_siemens_refused("G2 X1 Y1 F100\nM30\n", "needs its centre", 1);
}

TEST(SiemensReader, CompensatesAsLinuxCnc) {
  const std::string contour = "G0 X-10 Y0\nG41 G1 X0 F600\nX10\nY10\nG2 X20 Y20 I10 J0\nG1 X40\nG40 G0 Y30\n";
  expect_same_steps(siemens("T1 M6\n" + contour + "M30\n"), read("T1 M6 G43 H1\n" + contour + "M2\n"));
  expect_siemens_refused("T1 M6\nG41 G1 X9 F600\nROT Z3\nM30\n", "while cutter compensation", 3);
  expect_siemens_refused("T1 M6\nG41 G1 X9 F600\nG55\nM30\n", "while cutter compensation", 3);
}

// Frames chain: each one is seen from inside those before it; roll, pitch and yaw about X, Y and Z as they stand.
TEST(SiemensReader, FramesChain) {
  EXPECT_TRUE(rc::check("a point through a chain of frames", [] {
    Eigen::Affine3d chain = Eigen::Affine3d::Identity();
    std::string text = "T1 M6\n";
    const auto number = [](int most) { return *rc::gen::inRange(-most, most); };
    for (int n = *rc::gen::inRange(1, 5); n > 0; --n) {
      const bool turns = *rc::gen::inRange(0, 2) == 1, adds = *rc::gen::inRange(0, 4) > 0;
      const int x = number(turns ? 80 : 9), y = number(turns ? 80 : 9), z = number(turns ? 80 : 9);
      if (!adds) chain.setIdentity();
      if (turns)
        chain = chain * Eigen::AngleAxisd(z * kRad, Vec3::UnitZ()) * Eigen::AngleAxisd(y * kRad, Vec3::UnitY()) *
                Eigen::AngleAxisd(x * kRad, Vec3::UnitX());
      else
        chain = chain * Eigen::Translation3d(x, y, z);
      text += std::string(adds ? "A" : "") + (turns ? "ROT" : "TRANS") + " X=" + std::to_string(x) + " Y" +
              std::to_string(y) + " Z" + std::to_string(z) + "\n";
    }
    const Reading r = siemens(text + "G0 X1 Y2 Z3\nTRANS\nG0 X1 Y2 Z3\nM30\n");
    RC_ASSERT(!r.result.error);
    const Vec3 p = chain * Vec3(1, 2, 3);
    const AxisValues& q = r.moves[0].target;
    RC_ASSERT((Vec3(q[0] - 10, q[1] + 5, q[2] + 400 - 80) - p).norm() < 1e-9);
    RC_ASSERT(std::abs(r.moves[1].target[0] - 11) < 1e-12);
  }));
  const Reading plane = siemens("G18 ROT RPL=90\nG0 X1 Y2 Z3\nM30\n");
  ASSERT_TRUE(plane.result.error) << "a frame stands in a block of its own";
  const Reading rpl = siemens("G18\nROT RPL=90\nG0 Z1 X0 Y0\nM30\n");
  ASSERT_FALSE(rpl.result.error) << rpl.result.error->rule;
  EXPECT_NEAR(rpl.moves[0].target[0], 11, 1e-12) << "in G18 Z turns towards X";
  expect_siemens_refused("ROT A5\nM30\n", "takes X, Y and Z", 1);
}

// A swivelled plane: the tool stands square on it and the tip is where the turned coordinates say.
TEST(SiemensReader, SwivelledPlanesAreTurnedCoordinates) {
  EXPECT_TRUE(rc::check("tip and axis axis by axis", [] {
    const auto angle = [](int least, int most) { return *rc::gen::inRange(least, most); };
    const int a = angle(-50, 50), b = angle(-50, 50), c = angle(-180, 180);
    const bool zyx = angle(0, 2) == 1;
    const std::string angles = zyx ? std::to_string(c) + "," + std::to_string(b) + "," + std::to_string(a)
                                   : std::to_string(a) + "," + std::to_string(b) + "," + std::to_string(c);
    const Reading r =
        siemens("T1 M6\nG0 X0 Y0 Z60\nCYCLE800(1,\"TC1\",200000," + std::string(zyx ? "27" : "57") + ",4,5,6," +
                angles + ",0.5,0,-1,-1,100,1)\nG0 X1 Y2 Z3\nATRANS X3\nX1\nCYCLE800()\nTRANS\nM30\n");
    RC_ASSERT(!r.result.error);
    const Eigen::AngleAxisd X(a * kRad, Vec3::UnitX()), Y(b * kRad, Vec3::UnitY()), Z(c * kRad, Vec3::UnitZ());
    const Eigen::Matrix3d R = zyx ? (Z * Y * X).toRotationMatrix() : (X * Y * Z).toRotationMatrix();
    const ToolPose pose = pose_of(r.moves[3], 80), shifted = pose_of(r.moves[4], 80);
    RC_ASSERT(r.moves[1].target[2] == test::skew_machine().retract_z_mm);
    RC_ASSERT((pose.axis - R.col(2)).norm() < 1e-9);
    RC_ASSERT((pose.tip_mm - (Vec3(4, 5, 6) + R * Vec3(1.5, 2, 2))).norm() < 1e-9);
    RC_ASSERT((shifted.tip_mm - pose.tip_mm - R * Vec3(3, 0, 0)).norm() < 1e-9);
  }));
  const auto outer = [](const char* direction) {
    const Reading r = siemens(std::string("CYCLE800(0,\"\",0,57,0,0,0,0,30,0,0,0,0,") + direction + ")\nM30\n");
    EXPECT_FALSE(r.result.error);
    return r.moves.empty() ? 0 : r.moves.back().target[3] / kRad;
  };
  EXPECT_NEAR(outer("-1"), -30, 1e-9);
  EXPECT_NEAR(outer("1"), 30, 1e-9);
  EXPECT_EQ(outer("0"), 0) << "only reckoned";
  expect_siemens_refused("CYCLE800(0,\"\",0,192,0,0,0,1,2)\nM30\n", "axis by axis", 1);
  expect_siemens_refused("CYCLE800(0,\"\",10,57)\nM30\n", "ST 0 (new)", 1);
  expect_siemens_refused("CYCLE800(0,\"\",0,57,0,0,0,0,150,0,0,0,0,-1)\nM30\n", "cannot turn the tool", 1);
  expect_siemens_refused("CYCLE800(0,TC\nM30\n", "bad number", 1);
}

// A direction by its vector; with ORIVECT the axis stays in the plane of both and turns evenly, the tip on its line.
TEST(SiemensReader, DirectionsTurnTheTool) {
  const std::string start = "T1 M6\nG0 X0 Y0 Z50\nTRAORI\nG54\nORIWKS ";
  const std::string turn = "G1 X1 Y2 Z40 A3=0.3 B3=-0.4 C3=1 F600\nX6 Y4 A3=-0.2 B3=-0.5 C3=0.8\nTRAFOOF\nM30\n";
  const Vec3 from = Vec3(0.3, -0.4, 1).normalized(), to = Vec3(-0.2, -0.5, 0.8).normalized();
  for (const bool great_circle : {false, true}) {
    const Reading r = siemens(start + (great_circle ? "ORIVECT\n" : "ORIAXES\n") + turn);
    ASSERT_FALSE(r.result.error) << r.result.error->line << ": " << r.result.error->rule;
    EXPECT_LT((pose_of(r.moves[1], 80).axis - from).norm(), 1e-12);
    EXPECT_LT((pose_of(r.moves[2], 80).axis - to).norm(), 1e-12);
    EXPECT_LT((pose_of(r.moves[2], 80).tip_mm - Vec3(6, 4, 40)).norm(), 1e-10);
    double out_of_plane = 0, off_line = 0, seconds = 0;
    for (const ProgramStep& step : r.steps) {
      if (step.kind != ProgramStep::kMove || step.line != 8) continue;
      const ToolPose pose = pose_of(step, 80);
      out_of_plane = std::max(out_of_plane, std::abs(pose.axis.dot(from.cross(to).normalized())));
      const Vec3 along = Vec3(5, 2, 0).normalized(), p = pose.tip_mm - Vec3(1, 2, 40);
      off_line = std::max(off_line, (p - along * along.dot(p)).norm());
      seconds += step.seconds;
    }
    EXPECT_NEAR(seconds, std::hypot(5, 2) / 10, 1e-9);
    EXPECT_LT(off_line, 1e-9);
    if (great_circle) {
      EXPECT_LT(out_of_plane, 1e-4) << "between places half a degree apart";
    } else {
      EXPECT_GT(out_of_plane, 1e-3) << "the rotary axes turn evenly";
    }
  }
  expect_siemens_refused("TRAORI\nORIMKS ORIVECT\nG1 X1 C3=1 F100\nM30\n", "ORIWKS", 3);
  expect_siemens_refused("TRAORI\nG1 X1 C3=1 F100\nM30\n", "ORIAXES or ORIVECT", 2);
  expect_siemens_refused("TRAORI\nORIVECT\nG1 X1 A3=1 C3=-1 F100\nM30\n", "cannot turn the tool", 3);
  expect_siemens_refused("TRAORI\nORIVECT\nG1 X1 B10 F100\nM30\n", "need ORIAXES", 3);
}

}  // namespace
}  // namespace lightmill

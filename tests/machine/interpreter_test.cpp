#include "machine/detail/interpreter.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>

#include "machine_rig.h"

namespace lightmill::detail {
namespace {

constexpr double kRad = kPi / 180;

class InterpreterTest : public testing::Test {
 protected:
  Interpreter interpreter{test::skew_machine()};

  void SetUp() override { interpreter.set_offset(54, {10, -5, -400}); }
  /// The only step of a line that must be good.
  GcodeStep one(const char* line) {
    EXPECT_EQ(interpreter.execute(line), 0) << line;
    EXPECT_EQ(interpreter.steps().size(), 1U) << line;
    return interpreter.steps().empty() ? GcodeStep{} : interpreter.steps().front();
  }
};

TEST_F(InterpreterTest, MovesInTheWorkOffset) {
  EXPECT_EQ(interpreter.execute("G21 G90 G94 G17"), 0);
  const GcodeStep rapid = one("G0 X1.5 Y-2.25");
  EXPECT_TRUE(rapid.rapid);
  EXPECT_EQ(rapid.target, (Joints{11.5, -7.25, 0, 0, 0}));
  const GcodeStep feed = one("g1 z3 f600");
  EXPECT_FALSE(feed.rapid);
  EXPECT_EQ(feed.target, (Joints{11.5, -7.25, -397, 0, 0}));
  EXPECT_DOUBLE_EQ(feed.seconds, 39.7);
  // Modal: neither G1 nor F again.
  EXPECT_DOUBLE_EQ(one("X2.5").seconds, 0.1);
  EXPECT_EQ(one("B30C-45.5").target, (Joints{12.5, -7.25, -397, 30 * kRad, -45.5 * kRad}));
}

TEST_F(InterpreterTest, ToolLengthOffsetsAndMachineCoordinates) {
  EXPECT_EQ(interpreter.execute("G43.1 Z85"), 0);
  EXPECT_TRUE(interpreter.steps().empty());
  EXPECT_EQ(one("G0 Z20").target[2], -400 + 85 + 20);
  EXPECT_EQ(one("G53 G0 Z0").target[2], 0);
  EXPECT_EQ(interpreter.execute("G49"), 0);
  EXPECT_EQ(one("G0 Z20").target[2], -380);
  // The offsets that the operator has not set are zero.
  EXPECT_EQ(one("G55 G0 X1 Y1").target, (Joints{1, 1, -380, 0, 0}));
  EXPECT_EQ(one("G53 G0 X7").target[0], 7);
  EXPECT_EQ(one("X7").target[0], 7) << "G53 is for one block; G55 stays";
}

TEST_F(InterpreterTest, OffsetsAreSetByNumberAndByPlace) {
  EXPECT_EQ(interpreter.execute("G10 L2 P2 X1 Z-7 B90"), 0);
  EXPECT_TRUE(interpreter.sets_places());
  EXPECT_EQ(interpreter.offset(55), (Joints{1, 0, -7, 90 * kRad, 0}));
  EXPECT_EQ(one("G55 G0 X2 Z2 B10").target, (Joints{3, 0, -5, 100 * kRad, 0}));
  EXPECT_FALSE(interpreter.sets_places());
  // L20: where the machine stands is X5, tool length and all; P0 is the offset that is active.
  EXPECT_EQ(interpreter.execute("G43.1 Z85"), 0);
  EXPECT_EQ(interpreter.execute("G20 G10 L20 P0 X1 Z2"), 0);
  EXPECT_EQ(interpreter.offset(55), (Joints{3 - 25.4, 0, -5 - 85 - 50.8, 90 * kRad, 0}));
  const Joints there = one("G0 X1 Z2").target;
  EXPECT_NEAR(there[0], 3, 1e-12) << "it stands there already";
  EXPECT_NEAR(there[2], -5, 1e-12);
  EXPECT_EQ(one("G21 G54 X0").target[0], 10) << "the other offsets are as they were";
}

TEST_F(InterpreterTest, ShiftsLieOverAllOffsetsUntilTheyAreTakenAway) {
  EXPECT_EQ(one("G0 X1 Y2 Z3").target, (Joints{11, -3, -397, 0, 0}));
  EXPECT_EQ(interpreter.execute("G92 X0 Z10"), 0);
  EXPECT_EQ(interpreter.shift(), (Joints{1, 0, -7, 0, 0}));
  EXPECT_EQ(interpreter.zero(), (Joints{11, -5, -407, 0, 0}));
  EXPECT_EQ(one("X5 Y0 Z0").target, (Joints{16, -5, -407, 0, 0}));
  EXPECT_EQ(one("G59 X5").target[0], 6);
  // L20 keeps the shift: the program's zero is where it says.
  EXPECT_EQ(interpreter.execute("G10 L20 P6 X5"), 0);
  EXPECT_EQ(one("X6").target[0], 7);
  EXPECT_EQ(interpreter.execute("G92.1"), 0);
  EXPECT_EQ(one("G54 X5").target[0], 15);
  EXPECT_EQ(interpreter.execute("G92 X1"), 0);
  interpreter.reset();
  EXPECT_EQ(interpreter.shift(), Joints{}) << "a reset forgets it, and keeps the offsets";
  EXPECT_EQ(interpreter.offset(59)[0], 0);
}

TEST_F(InterpreterTest, ReferencePlacesAreReachedThroughAPointOnTheWay) {
  EXPECT_EQ(one("G0 X1 Y2 Z3 B20").target, (Joints{11, -3, -397, 20 * kRad, 0}));
  EXPECT_EQ(interpreter.execute("G28.1"), 0);
  EXPECT_EQ(interpreter.execute("G0 X20 Y20 Z20"), 0);
  // With axis words, these axes only: first to the point in work coordinates, then home.
  EXPECT_EQ(interpreter.execute("G91 G28 Z5"), 0);
  ASSERT_EQ(interpreter.steps().size(), 2U);
  EXPECT_TRUE(interpreter.steps()[0].rapid && interpreter.steps()[1].rapid);
  EXPECT_EQ(interpreter.steps()[0].target, (Joints{30, 15, -375, 20 * kRad, 0}));
  EXPECT_EQ(interpreter.steps()[1].target, (Joints{30, 15, -397, 20 * kRad, 0}));
  EXPECT_EQ(one("G90 G28").target, (Joints{11, -3, -397, 20 * kRad, 0})) << "without, all at once";
  EXPECT_EQ(one("G30").target, Joints{}) << "the machine's zero until G30.1 sets it";
  EXPECT_EQ(interpreter.execute("G30.1 G0 X7"), 0) << "takes no axis words for itself";
  EXPECT_EQ(interpreter.reference(1), Joints{});
  EXPECT_EQ(interpreter.position()[0], 17);
}

TEST_F(InterpreterTest, GrblHalHasNineOffsetsAndGrblSix) {
  EXPECT_EQ(interpreter.execute("G10 L2 P9 X3"), 0);
  EXPECT_EQ(one("G59.3 G0 X1").target[0], 4);
  EXPECT_EQ(code_name(interpreter.modes().offset), "G59.3");
  Interpreter grbl(test::skew_machine(), 6);
  EXPECT_EQ(grbl.execute("G59.1"), kUnsupported);
  EXPECT_EQ(grbl.execute("G10 L2 P7 X1"), kUnknownOffset);
  EXPECT_EQ(grbl.execute("G10 L2 P6 X1"), 0);
}

TEST_F(InterpreterTest, AProbeIsAFeedMoveOfItsOwn) {
  const GcodeStep probe = one("G38.3 Z-6 F60");
  EXPECT_EQ(probe.kind, GcodeStep::kProbe);
  EXPECT_EQ(probe.number, 383);
  EXPECT_FALSE(probe.rapid);
  EXPECT_EQ(probe.target[2], -406);
  EXPECT_DOUBLE_EQ(probe.seconds, 406);
  EXPECT_EQ(one("Z-7").kind, GcodeStep::kProbe) << "modal, as in grbl";
}

// A block with an error changes nothing of what G10, G92 and their likes set.
TEST_F(InterpreterTest, ARefusedLineSetsNoOffset) {
  EXPECT_EQ(interpreter.execute("G10 L2 P1 X99 K1"), kUnusedWords);
  EXPECT_EQ(interpreter.execute("G92 X99 K1"), kUnusedWords);
  EXPECT_EQ(interpreter.execute("G28.1 K1"), kUnusedWords);
  EXPECT_FALSE(interpreter.sets_places());
  EXPECT_EQ(one("G0 X1").target[0], 11);
  EXPECT_EQ(interpreter.reference(0), Joints{});
}

TEST_F(InterpreterTest, IncrementalAndInches) {
  EXPECT_EQ(one("G0 X1").target[0], 11);
  EXPECT_EQ(one("G91 X2 B10").target, (Joints{13, 0, 0, 10 * kRad, 0}));
  EXPECT_EQ(one("X2 B10").target[3], 20 * kRad);
  EXPECT_DOUBLE_EQ(one("G90 G20 X1").target[0], 35.4);
  EXPECT_EQ(one("B90").target[3], 90 * kRad) << "degrees are not inches";
  EXPECT_DOUBLE_EQ(one("G1 X2 F10").seconds, 6);
}

TEST_F(InterpreterTest, InverseTime) {
  EXPECT_EQ(interpreter.execute("G93"), 0);
  EXPECT_DOUBLE_EQ(one("G1 X1 B20 F8").seconds, 7.5);
  EXPECT_EQ(interpreter.execute("X2"), kNoFeed) << "F in every block";
  EXPECT_EQ(interpreter.execute("X2 F0"), kNoFeed);
  EXPECT_DOUBLE_EQ(one("X2 F60").seconds, 1);
  EXPECT_EQ(one("G0 X3").target[0], 13) << "a rapid needs no F";
  EXPECT_EQ(interpreter.execute("G94"), 0);
  EXPECT_EQ(interpreter.execute("G1 X4"), kNoFeed) << "an inverse time is no feed";
}

TEST_F(InterpreterTest, TurnAndTravelTogetherUnderG94TakeTheEuclideanLength) {
  // 3 mm and 4 degrees: grbl's rule.
  EXPECT_EQ(interpreter.execute("G0 X0"), 0);
  EXPECT_DOUBLE_EQ(one("G1 X3 C4 F300").seconds, 1);
}

TEST_F(InterpreterTest, ArcsStayWithinATenthOfAMicrometre) {
  interpreter.set_offset(54, {0, 0, 0});
  EXPECT_EQ(interpreter.execute("G0 X30 Y0 Z0"), 0);
  // A quarter turn counter-clockwise about the origin that climbs 2 mm.
  ASSERT_EQ(interpreter.execute("G3 X0 Y30 Z2 I-30 J0 F1000"), 0);
  Joints last{30, 0, 0, 0, 0};
  double seconds = 0;
  for (const GcodeStep& step : interpreter.steps()) {
    EXPECT_NEAR(std::hypot(step.target[0], step.target[1]), 30, 1e-9);
    EXPECT_GT(std::hypot((step.target[0] + last[0]) / 2, (step.target[1] + last[1]) / 2), 30 - 1.0001e-4);
    const double angle = std::atan2(step.target[1], step.target[0]);
    EXPECT_NEAR(step.target[2], 2 * angle / (kPi / 2), 1e-9);
    seconds += step.seconds;
    last = step.target;
  }
  EXPECT_EQ(last, (Joints{0, 30, 2, 0, 0}));
  EXPECT_NEAR(seconds, 60.0 / 1000 * std::hypot(30 * kPi / 2, 2), 1e-9);

  // In the other planes G3 turns from Z to X and from Y to Z.
  ASSERT_EQ(interpreter.execute("G0 X0 Y0 Z-10"), 0);
  ASSERT_EQ(interpreter.execute("G18 G3 X-10 Z0 I0 K10"), 0);
  for (const GcodeStep& step : interpreter.steps()) {
    EXPECT_NEAR(std::hypot(step.target[0], step.target[2]), 10, 1e-9);
    EXPECT_LE(step.target[0], 0);
  }
  ASSERT_EQ(interpreter.execute("G0 X0 Y10 Z0"), 0);
  ASSERT_EQ(interpreter.execute("G19 G2 Y0 Z-10 J-10"), 0);
  for (const GcodeStep& step : interpreter.steps()) {
    EXPECT_NEAR(std::hypot(step.target[1], step.target[2]), 10, 1e-9);
    EXPECT_LE(step.target[2], 0);
  }
  EXPECT_EQ(interpreter.execute("G3 X5 J1"), kNoArcPlane);
  ASSERT_EQ(interpreter.execute("G17 G0 X0 Y30 Z2"), 0);

  // The same by radius, clockwise and back; a negative radius takes the long way.
  ASSERT_EQ(interpreter.execute("G2 X30 Y0 Z2 R30"), 0);
  for (const GcodeStep& step : interpreter.steps()) EXPECT_NEAR(std::hypot(step.target[0], step.target[1]), 30, 1e-9);
  ASSERT_EQ(interpreter.execute("G2 X0 Y30 R-30"), 0);
  double least = 0;
  for (const GcodeStep& step : interpreter.steps()) least = std::min(least, std::min(step.target[0], step.target[1]));
  EXPECT_NEAR(least, -30, 1e-3) << "three quarters of the circle about the origin";

  // A full turn when the ends coincide.
  ASSERT_EQ(interpreter.execute("G2 X0 Y30 I0 J-30"), 0);
  EXPECT_GT(interpreter.steps().size(), 1000U);
}

TEST_F(InterpreterTest, MachineWords) {
  EXPECT_EQ(interpreter.execute("T3 M6"), 0);
  ASSERT_EQ(interpreter.steps().size(), 2U);
  EXPECT_EQ(interpreter.steps()[1].kind, GcodeStep::kChangeTool);
  EXPECT_EQ(interpreter.steps()[1].number, 3);
  const GcodeStep spindle = one("S36000 M3");
  EXPECT_EQ(spindle.kind, GcodeStep::kSpindle);
  EXPECT_EQ(spindle.rpm, 36000);
  EXPECT_EQ(spindle.number, 3);
  EXPECT_EQ(one("G4 P8").seconds, 8);
  EXPECT_EQ(one("M7").number, 7);
  EXPECT_EQ(one("S20000").rpm, 20000) << "a running spindle follows S";
  EXPECT_EQ(one("M5").number, 0);
  EXPECT_EQ(interpreter.execute("S100"), 0) << "no spindle turns";
  EXPECT_EQ(interpreter.execute("M3"), kOutOfRange);
  EXPECT_EQ(interpreter.execute("S40000 M3"), kOutOfRange);
  EXPECT_EQ(one("M0").kind, GcodeStep::kPause);
  EXPECT_EQ(one("M30").kind, GcodeStep::kEnd);
  // A line's steps run in RS274's order, not in the order of its words.
  EXPECT_EQ(interpreter.execute("G0 X5 M3 S2000 M0"), 0);
  ASSERT_EQ(interpreter.steps().size(), 3U);
  EXPECT_EQ(interpreter.steps()[0].kind, GcodeStep::kSpindle);
  EXPECT_EQ(interpreter.steps()[1].kind, GcodeStep::kMove);
  EXPECT_EQ(interpreter.steps()[2].kind, GcodeStep::kPause);
}

TEST_F(InterpreterTest, TheEndOfAProgramResetsTheModesThatHurt) {
  EXPECT_EQ(interpreter.execute("G93 G91 G55 S2000 M3"), 0);
  EXPECT_EQ(interpreter.execute("M2"), 0);
  EXPECT_FALSE(interpreter.modes().incremental);
  EXPECT_FALSE(interpreter.modes().inverse_time);
  EXPECT_EQ(interpreter.modes().offset, 54);
  EXPECT_EQ(interpreter.modes().spindle, 5);
}

TEST_F(InterpreterTest, NothingIsToBeDone) {
  for (const char* line :
       {"%", "(a comment)", "; G1 X5", "  ", "N100", "G21 (mm) G90 ; and so on", "G80", "G40 G49 G54 G61"}) {
    EXPECT_EQ(interpreter.execute(line), 0) << line;
    EXPECT_TRUE(interpreter.steps().empty()) << line;
  }
}

struct Refused {
  const char* line;
  int error;
};

// Codes of grblHAL: as the firmware answered where it was tried, its list of codes for the rest.
TEST_F(InterpreterTest, RefusesWhatItCannotObey) {
  const Refused cases[] = {
      {"G1 X1", kNoFeed},      // no feed yet [measured]
      {"G93 G1 X1", kNoFeed},  // [measured]
      {"G1 X1 F0", kNoFeed},
      {"G1 X1 F-5", kNegativeValue},
      {"bad", kBadNumber},  // [measured]
      {"G0 X", kBadNumber},
      {"G0 X1.2.3", kExpectedLetter},
      {"G0 X--1", kBadNumber},
      {"G0 X1e5", kUnsupported},  // no exponents: E5 is a word of its own
      {"G0 X#1", kBadNumber},
      {"G0 X1 (never closed", kBadNumber},
      {"G43 H1", kUnsupported},  // [measured]
      {"G41", kUnsupported},     // [measured]
      {"G64", kUnsupported},     // [measured]
      {"G43.4", kUnsupported},
      {"M128", kUnsupported},
      {"M3.5", kNotInteger},
      {"G0 A1", kUnsupported},  // this machine has no A axis
      {"G0 U1", kUnsupported},
      {"G1 X1 F100 G1 X2", kAxisConflict},  // a lost line feed [measured]
      {"G0 G43.1 Z85", kAxisConflict},
      {"G90 G91", kModalGroup},
      {"G54 G55 X1", kModalGroup},
      {"M3 M5", kModalGroup},
      {"M8 M9", kModalGroup},
      {"G0 X1 X2", kWordRepeated},
      {"N1.5 G0 X1", kBadLineNumber},
      {"T1.5", kNotInteger},
      {"T-1", kNegativeValue},
      {"S-1", kNegativeValue},
      {"G4", kValueMissing},
      {"G4 P-1", kNegativeValue},
      {"G53 G2 X1 I1 F1", kG53Mode},
      {"G53 G43.1 Z1", kG53Mode},
      {"G80 X1", kAxisWordsExist},
      {"G43.1 X1", kToolOffsetAxis},
      {"G43.1", kNoAxisWords},
      {"G0 X1 I2", kUnusedWords},
      {"G0 X1 P2", kUnusedWords},
      {"G2 X1 Y1 F100", kNoArcOffsets},
      {"G2 I1 F100", kNoAxisWords},
      {"G2 Z1 I1 F100", kNoArcPlane},
      {"G2 X10 Y0 R1 F100", kArcRadius},
      {"G2 X10 Y0 I1 J0 F100", kInvalidTarget},
      {"S500 M3", kOutOfRange},
      {"G10 L2 P1", kNoAxisWords},
      {"G10 P1 X1", kValueMissing},
      {"G10 L2 X1", kValueMissing},
      {"G10 L2 P10 X1", kUnknownOffset},
      {"G10 L2 P-1 X1", kNegativeValue},
      {"G10 L2 P1 R30 X1", kUnsupported},
      {"G10 L10 P1 X1", kUnsupported},
      {"G92", kNoAxisWords},
      {"G28 G0 X1", kAxisConflict},
      {"G28 G53 X1", kModalGroup},
      {"G92.2", kUnsupported},
      {"G28.2", kUnsupported},
      {"G59.4", kUnsupported},
      {"G38.2 F100", kNoAxisWords},
      {"G38.2 Z-1", kNoFeed},
      {"G38.2 X0 F100 G91", kInvalidTarget},
      {"G0 X1 L2", kUnusedWords},
  };
  for (const Refused& c : cases) {
    const Joints before = interpreter.position();
    EXPECT_EQ(interpreter.execute(c.line), c.error) << c.line;
    EXPECT_TRUE(interpreter.steps().empty()) << c.line;
    EXPECT_EQ(interpreter.position(), before) << c.line;
    EXPECT_EQ(interpreter.modes().motion, 0) << c.line << " changed the modes";
    EXPECT_FALSE(interpreter.modes().inverse_time) << c.line;
  }
  EXPECT_EQ(interpreter.execute(std::string(257, ' ')), kOverflow);
  EXPECT_EQ(interpreter.execute("G0 X1" + std::string(251, ' ')), 0);
}

// Numbers mean what strtod says they mean.
RC_GTEST_PROP(InterpreterNumbers, AreReadExactly, (bool negative, unsigned whole, unsigned fraction)) {
  whole %= 100000;
  fraction %= 100000;
  char text[64];
  std::snprintf(text, sizeof text, "%s%u.%05u", negative ? "-" : "", whole, fraction);
  Interpreter interpreter(test::skew_machine());
  RC_ASSERT(interpreter.execute("G0 X" + std::string(text)) == 0);
  RC_ASSERT(interpreter.position()[0] == std::strtod(text, nullptr));
}

// Any bytes: an error or a step, never a crash, and never a position that is no number.
RC_GTEST_PROP(InterpreterFuzz, AnyBytes, (const std::vector<std::string>& lines)) {
  Interpreter interpreter(test::skew_machine());
  for (const std::string& line : lines) interpreter.execute(line);
  for (const double q : interpreter.position()) RC_ASSERT(std::isfinite(q));
}

RC_GTEST_PROP(InterpreterFuzz, WordSalad, ()) {
  Interpreter interpreter(test::skew_machine());
  for (int i = 0; i < 20; ++i) {
    std::string line;
    const int words = *rc::gen::inRange(0, 8);
    for (int w = 0; w < words; ++w) {
      line += *rc::gen::elementOf(std::string("GGGGMXYZBCFIJKNPRST(%;"));
      line += std::to_string(*rc::gen::elementOf(
          std::vector<int>{0, 1, 2, 3, 4, 5, 6, 17, 20, 21, 40, 43, 49, 53, 54, 80, 90, 91, 93, 94, -7, 1000}));
      if (*rc::gen::inRange(0, 4) == 0)
        line += *rc::gen::elementOf(std::vector<std::string>{".1", ".", " ", "e3", "-"});
    }
    const Joints before = interpreter.position();
    const int error = interpreter.execute(line);
    if (error != 0) RC_ASSERT(interpreter.position() == before);
    for (const GcodeStep& step : interpreter.steps()) {
      RC_ASSERT(std::isfinite(step.seconds) && step.seconds >= 0);
      for (const double q : step.target) RC_ASSERT(std::isfinite(q));
    }
  }
}

}  // namespace
}  // namespace lightmill::detail

#include "machine/simulated_machine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <random>

#include "design/core/errors.h"
#include "machine/program_lines.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

/// A machine that answers a text at once, as a person at a terminal sees it (carriage returns left out).
class Talk {
 public:
  explicit Talk(const SimulationOptions& options = test::no_stock(), const MachineModel& model = test::skew_machine())
      : machine(model, test::skew_setup(), options) {
    machine.start();
    replies();
  }
  std::string replies() {
    std::string text = machine.take_replies();
    std::erase(text, '\r');
    return text;
  }
  std::string say(std::string_view text) {
    machine.receive(text);
    while (machine.work(1000) > 0) {
    }
    return replies();
  }
  /// All characters of a burst arrive before the first line is worked on.
  std::string burst(const std::vector<std::string>& lines) {
    std::string text;
    for (const std::string& line : lines) text += line + "\n";
    return say(text);
  }
  SimulatedMachine machine;
};

// --- Conversations recorded from grblHAL ---

TEST(Conversation, BannerAndIdentity) {
  SimulatedMachine machine(test::skew_machine(), test::skew_setup(), test::no_stock());
  machine.start();
  EXPECT_EQ(machine.take_replies(), "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n");
  Talk talk;
  EXPECT_THAT(talk.say("$I\n"), AllOf(HasSubstr("[OPT:VNML+,100,1024,6,0]\n"), HasSubstr("[AXS:6:XYZABC]\n"),
                                      HasSubstr("[FIRMWARE:grblHAL]\nok\n")));
  EXPECT_THAT(talk.say("?"), StartsWith("<Idle|MPos:0.000,0.000,0.000,0.000,0.000,0.000|Bf:100,1023|FS:0,0|WCO:10.000,-"
                                        "5.000,-400.000,0.000,0.000,0.000"));
  EXPECT_EQ(talk.say("$G\n"), "[GC:G0 G54 G17 G21 G90 G94 G49 M5 M9 T0 F0 S0]\nok\n");
  EXPECT_THAT(talk.say("$#\n"), HasSubstr("[G54:10.000,-5.000,-400.000,0.000,0.000,0.000]\n[G55:0.000,0.000,0.000"));
  EXPECT_EQ(talk.say("$Q\n"), "error:3\n");
}

TEST(Conversation, ABadLineLatches) {
  Talk talk;
  EXPECT_EQ(talk.burst({"G21", "G90", "bad", "G0 X1", "G0 X2", "G0 X3"}),
            "ok\nok\nerror:2\nerror:2\nerror:2\nerror:2\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 0) << "nothing after it was executed";
  EXPECT_EQ(talk.say("\r\n"), "ok\n") << "an empty line clears the latch";
  EXPECT_EQ(talk.say("G0 X1\n"), "ok\n");
  EXPECT_EQ(talk.burst({"G1 X1", "G0 X2"}), "error:22\nerror:22\n");
  EXPECT_THAT(talk.say("$G\n"), HasSubstr("ok\n")) << "so does a $ command";
  EXPECT_EQ(talk.say("G0 X2\n"), "ok\n");
  EXPECT_EQ(talk.say("G43 H1\n"), "error:20\n");
  EXPECT_THAT(talk.say("\x18"), HasSubstr("GrblHAL")) << "and a reset";
  EXPECT_EQ(talk.say("G1 X1 F100 G1 X2\n"), "error:24\n");
}

TEST(Conversation, LinesTooLong) {
  Talk talk;
  EXPECT_EQ(talk.say("G0 X1 (" + std::string(300, 'x') + ")\n"), "error:11\n");
  EXPECT_EQ(talk.say("\n"), "ok\n");
  // In pieces, with the beginning taken out of the buffer before the end comes.
  for (int i = 0; i < 30; ++i) EXPECT_EQ(talk.say("(" + std::string(98, 'x') + ")"), "");
  EXPECT_EQ(talk.say("\n"), "error:11\n");
  EXPECT_EQ(talk.say("\nG0 X1\n"), "ok\nok\n");
}

TEST(Conversation, ToolChangeIsAcknowledgedAtOnceAndWaits) {
  Talk talk;
  EXPECT_EQ(talk.burst({"T3 M6", "G0 X1"}), "ok\n");
  EXPECT_THAT(talk.say("?"), StartsWith("<Tool|"));
  EXPECT_EQ(talk.machine.result().tool, 0);
  EXPECT_EQ(talk.say("~"), "ok\n");
  EXPECT_EQ(talk.machine.result().tool, 3);
  EXPECT_THAT(talk.say("?"), StartsWith("<Idle|MPos:11.000"));
}

TEST(Conversation, PauseIsAcknowledgedWhenItEnds) {
  Talk talk;
  EXPECT_EQ(talk.burst({"G0 X1", "M0", "G0 X2"}), "ok\n");
  EXPECT_THAT(talk.say("?"), StartsWith("<Hold:0|MPos:11.000"));
  EXPECT_EQ(talk.say("~"), "ok\nok\n");
  EXPECT_EQ(talk.say("M1\n"), "ok\n") << "the switch for optional stops is off";
  EXPECT_EQ(talk.say("M30\n"), "[MSG:Pgm End]\nok\n");
}

TEST(Conversation, AnUnknownToolIsAnAlarm) {
  Talk talk;
  EXPECT_THAT(talk.say("T7 M6\n"), StartsWith("ALARM:3\n"));
  EXPECT_EQ(talk.say("G0 X1\n"), "");
  EXPECT_EQ(talk.machine.result().faults.at(0).kind, "alarm");
  EXPECT_THAT(talk.machine.result().faults.at(0).message, HasSubstr("tool 7 is not in the magazine"));
}

TEST(Conversation, HoldKeepsLinesAndPosition) {
  Talk talk;
  EXPECT_EQ(talk.say("!G0 X1\n"), "");
  EXPECT_THAT(talk.say("?"), AllOf(StartsWith("<Hold:0|"), HasSubstr("Bf:100,1017")));
  EXPECT_EQ(talk.say("~"), "ok\n");
  EXPECT_EQ(talk.say("!"), "");
  const std::string restart = talk.say("\x18");
  EXPECT_THAT(restart, HasSubstr("GrblHAL"));
  EXPECT_THAT(restart, testing::Not(HasSubstr("ALARM")));
  EXPECT_THAT(talk.say("?"), StartsWith("<Idle|MPos:11.000"));
}

TEST(Conversation, Door) {
  Talk talk;
  EXPECT_EQ(talk.say("\x84"), "[MSG:Check Door]\n");
  EXPECT_THAT(talk.say("?"), StartsWith("<Door:0|"));
  EXPECT_EQ(talk.say("G0 X1\n"), "");
  EXPECT_EQ(talk.say("~"), "ok\n");
}

TEST(Conversation, ResetWhileMovingLosesThePosition) {
  SimulationOptions options = test::no_stock();
  options.time_factor = 1;
  Talk talk(options);
  EXPECT_EQ(talk.say("G1 X100 F60\n"), "ok\n");
  EXPECT_THAT(talk.say("?"), AllOf(StartsWith("<Run|"), HasSubstr("Bf:99,1023")));
  EXPECT_THAT(talk.say("\x18"),
              AllOf(StartsWith("ALARM:3\n"), HasSubstr("GrblHAL"), HasSubstr("[MSG:'$H'|'$X' to unlock]")));
  EXPECT_EQ(talk.say("G0 X1\n"), "error:9\n");
  EXPECT_EQ(talk.say("$X\n"), "[MSG:Caution: Unlocked]\nok\n");
  EXPECT_EQ(talk.say("G0 X1\n"), "ok\n");
}

TEST(Conversation, SoftLimitIsDeafUntilReset) {
  Talk talk;
  EXPECT_EQ(talk.burst({"G0 X100", "G0 X251", "G0 X0"}), "ok\nALARM:2\n[MSG:Reset to continue]\n");
  const Fault fault = talk.machine.result().faults.at(0);
  EXPECT_EQ(fault.kind, "limit");
  EXPECT_THAT(fault.picture, HasSubstr("#b3261e")) << "the axis that would pass is red";
  EXPECT_EQ(fault.line, 2);
  EXPECT_NEAR(fault.amount_mm, 1, 1e-9);
  EXPECT_THAT(fault.message, HasSubstr("X would pass its limit 260 mm by 1 mm"));
  EXPECT_EQ(talk.machine.result().joints.x_mm, 110) << "it has not moved";
  EXPECT_EQ(talk.say("$X\nG0 X0\n"), "");
  EXPECT_THAT(talk.say("?"), StartsWith("<Alarm|"));
  EXPECT_THAT(talk.say("\x18"), HasSubstr("to unlock"));
  EXPECT_EQ(talk.burst({"G0 X1", "$X", "G0 X1"}), "error:9\n[MSG:Caution: Unlocked]\nok\nok\n");
}

// There is no probe: the input never changes, as on a control whose input is open.
TEST(Conversation, AProbeThatMeetsNothingIsAnAlarmThatXUnlocks) {
  Talk talk;
  EXPECT_EQ(talk.burst({"G38.3 X-4 F600", "G1 X-3"}), "[PRB:6.000,0.000,0.000,0.000,0.000,0.000:0]\nok\nok\n");
  EXPECT_EQ(talk.burst({"G38.2 X-5", "G1 X0"}), "[PRB:5.000,0.000,0.000,0.000,0.000,0.000:0]\nALARM:5\nok\nerror:9\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 5) << "it has gone all the way";
  ASSERT_EQ(talk.machine.result().faults.size(), 2U);
  EXPECT_EQ(talk.machine.result().faults[1].kind, "probe") << "and no tool in the spindle";
  EXPECT_EQ(talk.burst({"$X", "G38.4 X-6"}), "[MSG:Caution: Unlocked]\nok\nALARM:4\nok\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 5) << "it has not moved";
  EXPECT_EQ(talk.burst({"$X", "G91 G0 X1"}), "[MSG:Caution: Unlocked]\nok\nok\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 6);
}

TEST(Conversation, OffsetsAreReported) {
  Talk talk;
  EXPECT_EQ(talk.burst({"G10 L2 P9 X1 Y2", "G59.3 G0 X0 Y0 Z-5", "G28.1", "G92 X-7"}), "ok\nok\nok\nok\n");
  EXPECT_THAT(talk.say("$G\n"), HasSubstr("[GC:G0 G59.3 "));
  const std::string places = talk.say("$#\n");
  EXPECT_THAT(places, HasSubstr("[G59.3:1.000,2.000,0.000,0.000,0.000,0.000]"));
  EXPECT_THAT(places, HasSubstr("[G28:1.000,2.000,-5.000,0.000,0.000,0.000]"));
  EXPECT_THAT(places, HasSubstr("[G92:7.000,0.000,0.000,0.000,0.000,0.000]"));
  EXPECT_THAT(talk.say("?"), HasSubstr("WCO:8.000,2.000,0.000"));
}

TEST(Conversation, CheckModeMovesNothing) {
  Talk talk;
  EXPECT_EQ(talk.say("$C\n"), "[MSG:Enabled]\nok\n");
  EXPECT_THAT(talk.say("?"), StartsWith("<Check|"));
  EXPECT_EQ(talk.burst({"G0 X100", "G1 X2 F100", "T3 M6", "bad"}), "ok\nok\nok\nerror:2\n");
  EXPECT_THAT(talk.say("$C\n"), AllOf(HasSubstr("[MSG:Disabled]"), HasSubstr("GrblHAL")));
  EXPECT_EQ(talk.machine.result().joints.x_mm, 0);
  EXPECT_EQ(talk.machine.result().lines, 0);
}

// --- Conversations recorded from grbl 1.1h ---

Talk grbl_talk() {
  SimulationOptions options = test::no_stock();
  options.personality = Personality::kGrbl;
  return Talk(options);
}

TEST(GrblConversation, BannerIdentityAndReports) {
  SimulationOptions options = test::no_stock();
  options.personality = Personality::kGrbl;
  SimulatedMachine machine(test::skew_machine(), test::skew_setup(), options);
  machine.start();
  EXPECT_EQ(machine.take_replies(), "\r\nGrbl 1.1h ['$' for help]\r\n");
  Talk talk = grbl_talk();
  EXPECT_THAT(talk.say("$I\n"), AllOf(HasSubstr("[VER:1.1h.20190830:"), HasSubstr("[OPT:V,15,128]\nok\n")));
  EXPECT_EQ(talk.say("?"), "<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:10.000,-5.000,-400.000>\n") << "no Bf";
  EXPECT_EQ(talk.say("?"), "<Idle|MPos:0.000,0.000,0.000|FS:0,0|Ov:100,100,100>\n");
  EXPECT_EQ(talk.say("?"), "<Idle|MPos:0.000,0.000,0.000|FS:0,0>\n");
  EXPECT_EQ(talk.say("$10=3\n"), "ok\n");
  EXPECT_EQ(talk.say("?"), "<Idle|MPos:0.000,0.000,0.000|Bf:15,127|FS:0,0>\n");
}

TEST(GrblConversation, GoesOnAfterAnError) {
  Talk talk = grbl_talk();
  EXPECT_EQ(talk.burst({"G21", "G90", "bad", "G0 X1", "G0 X2", "G0 X3"}), "ok\nok\nerror:2\nok\nok\nok\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 13) << "the rest is executed";
}

TEST(GrblConversation, KnowsNoToolsAndNoRotaryAxes) {
  Talk talk = grbl_talk();
  for (const char* line : {"T3 M6", "G0 B10", "G0 X1 C5", "G43 H1", "G41", "G64"}) {
    EXPECT_EQ(talk.say(std::string(line) + "\n"), "error:20\n") << line;
  }
  EXPECT_EQ(talk.say("T3\nG43.1 Z80\nG1 X1\n"), "ok\nok\nerror:22\n");
  EXPECT_EQ(talk.say("G1 X1 F100 G1 X2\n"), "error:24\n") << "a lost line feed";
}

TEST(GrblConversation, EightyCharactersThatCount) {
  Talk talk = grbl_talk();
  EXPECT_EQ(talk.say("G0 X1 (" + std::string(100, 'x') + ")\n"), "ok\n") << "comments and blanks are thrown away";
  EXPECT_EQ(talk.say("G0X" + std::string(76, '0') + "\n"), "ok\n");
  EXPECT_EQ(talk.say("G0X" + std::string(77, '0') + "\n"), "error:11\n");
}

// The receive buffer empties into the line buffer while a line comes, so that a line may be longer than the receive buffer.
TEST(GrblConversation, LinesLongerThanTheReceiveBuffer) {
  Talk talk = grbl_talk();
  EXPECT_EQ(talk.say("(" + std::string(140, 'x') + ")\n"), "ok\n");
  EXPECT_EQ(talk.say(";" + std::string(140, 'x') + "\n"), "ok\n");
  EXPECT_EQ(talk.say("G0 " + std::string(140, ' ') + "x1 (" + std::string(140, 'x') + ") /y2\n"), "ok\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 11);
  EXPECT_EQ(talk.machine.result().joints.y_mm, -3);
  EXPECT_EQ(talk.say("G0 X" + std::string(140, '0') + "\n"), "error:11\n");
  EXPECT_EQ(talk.say("G0 X2\n"), "ok\n") << "the error is that line's alone";
  EXPECT_EQ(talk.machine.result().overflowed_bytes, 0);
  EXPECT_EQ(talk.machine.result().received_digest,
            program_digest("(" + std::string(140, 'x') + ")\n;" + std::string(140, 'x') + "\nG0 " + std::string(140, ' ') +
                           "x1 (" + std::string(140, 'x') + ") /y2\nG0 X2\n"));
  // A line without end: taken out as it comes, in bounded memory, and refused when it ends.
  for (int i = 0; i < 1000; ++i) EXPECT_EQ(talk.say("(" + std::string(98, 'x') + ")"), "");
  talk.say("$10=3 ");
  EXPECT_EQ(talk.say("\n"), "error:11\n");
  EXPECT_EQ(talk.say("(alarms do not refuse comments\n"), "ok\n");
}

TEST(GrblConversation, TheReceiveBufferEmptiesWhileALineComes) {
  Talk talk = grbl_talk();
  talk.say("$10=3\n??");
  talk.say("G0 X1");
  EXPECT_THAT(talk.say("?"), AllOf(StartsWith("<Idle|"), HasSubstr("|Bf:15,127|"))) << "in the line buffer";
  talk.say("!5 Y2");
  EXPECT_THAT(talk.say("?"), HasSubstr("|Bf:15,123|")) << "a held machine takes nothing out";
  EXPECT_EQ(talk.say("~\n"), "ok\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 25);
  talk.say("G0 X9");
  talk.say("\x18");
  EXPECT_EQ(talk.say("G0 X1\n"), "ok\n") << "a reset forgets the beginning of a line";
}

TEST(GrblConversation, ASmallBuffer) {
  Talk talk = grbl_talk();
  talk.machine.receive("!" + std::string(200, '\n'));
  EXPECT_EQ(talk.machine.result().highest_buffer_fill, 127);
  EXPECT_EQ(talk.machine.result().overflowed_bytes, 73);
}

// Heard on real firmware: X11 whose second 1 became 0x91 is X1, and the feed runs at 110 %.
TEST(Conversation, AGarbledDigitTurnsAnOverride) {
  SimulationOptions options = test::no_stock();
  VirtualClock clock;
  options.clock = &clock;
  options.time_factor = 1;
  Talk talk(options);
  EXPECT_EQ(talk.say("G1 X1\x91 F60\n"), "ok\n");
  EXPECT_EQ(talk.machine.next_event(), ClockTime(static_cast<long>(std::ceil(11e9 / 1.1))));
  talk.say("?");
  EXPECT_THAT(talk.say("?"), HasSubstr("|Ov:110,100,100"));
}

TEST(Conversation, OverridesActOnWhatRuns) {
  SimulationOptions options = test::no_stock();
  VirtualClock clock;
  options.clock = &clock;
  options.time_factor = 1;
  Talk talk(options);
  using std::chrono::seconds;
  EXPECT_EQ(talk.say("G1 X10 F60\n"), "ok\n");  // 20 mm from X -10: 20 s
  clock.advance_to(seconds(10));
  talk.say(std::string(10, '\x92'));  // ten times 10 % less, but never below 10 %
  EXPECT_EQ(talk.machine.next_event(), ClockTime(seconds(110))) << "half the way is done";
  clock.advance_to(seconds(60));
  talk.say("\x90");
  EXPECT_EQ(talk.machine.next_event(), ClockTime(seconds(65)));
  EXPECT_EQ(talk.say("!"), "");
  clock.advance_to(seconds(100));
  EXPECT_EQ(talk.machine.next_event(), kNever);
  EXPECT_EQ(talk.say("~"), "");
  EXPECT_EQ(talk.machine.next_event(), ClockTime(seconds(105)));
}

// --- Within a motion ---

struct PacedTalk {
  VirtualClock clock;
  Talk talk;
  explicit PacedTalk(SimulationOptions options = test::no_stock())
      : talk((options.clock = &clock, options.time_factor = 1, options)) {}
  std::string at(double seconds, std::string_view text) {
    clock.advance_to(ClockTime(std::llround(seconds * 1e9)));
    return talk.say(text);
  }
};

TEST(RunningMotion, PlaceAndFeedAreThoseOfTheMoment) {
  PacedTalk m;
  EXPECT_EQ(m.at(0, "G1 X10 F60\nG4 P5\nG1 X10 C60 F240\n"), "ok\n");  // 20 mm from X 0; 60 degrees
  EXPECT_THAT(m.at(5, "?"), AllOf(StartsWith("<Run|MPos:5.000,0.000,"), HasSubstr("|FS:60,0|")));
  EXPECT_THAT(m.at(10, "\x91?"), AllOf(StartsWith("<Run|MPos:10.000,"), HasSubstr("|FS:66,0|")));
  EXPECT_THAT(m.at(10, "\x90?"), HasSubstr("|FS:60,0>"));
  EXPECT_THAT(m.at(12.5, "!?"), AllOf(StartsWith("<Hold:0|MPos:12.500,"), HasSubstr("|FS:0,0>")));
  EXPECT_THAT(m.at(100, "?"), AllOf(StartsWith("<Hold:0|MPos:12.500,"), HasSubstr("|FS:0,0>")));
  EXPECT_THAT(m.at(100, "~?"), AllOf(StartsWith("<Run|MPos:12.500,"), HasSubstr("|FS:60,0>")));
  EXPECT_EQ(m.at(107.5, ""), "ok\nok\n");
  EXPECT_THAT(m.at(109, "?"), AllOf(StartsWith("<Run|MPos:20.000,"), HasSubstr("|FS:0,0>"))) << "the dwell";
  EXPECT_THAT(m.at(117.5, "?"), AllOf(StartsWith("<Run|MPos:20.000,0.000,0.000,0.000,0.000,20.000|"), HasSubstr("|FS:240,0>")));
  EXPECT_THAT(m.at(200, "?"), AllOf(StartsWith("<Idle|MPos:20.000,0.000,0.000,0.000,0.000,60.000|"), HasSubstr("|FS:0,0>")));
}

TEST(RunningMotion, AResetLeavesTheMachineWhereItIs) {
  PacedTalk m;
  m.at(0, "G1 X10 F60\nX-10\n");
  EXPECT_THAT(m.at(5, "\x18"), HasSubstr("ALARM:3"));
  EXPECT_THAT(m.at(50, "?"), StartsWith("<Alarm|MPos:5.000,0.000,0.000,"));
  EXPECT_EQ(m.talk.machine.result().joints.x_mm, 5);
  EXPECT_EQ(m.talk.machine.result().machine_seconds, 5);
  EXPECT_THAT(m.at(50, "$X\nG91 G1 X1 F60\n"), HasSubstr("ok\nok\n"));
  EXPECT_THAT(m.at(60, "?"), StartsWith("<Idle|MPos:6.000,")) << "and it goes on from there";
}

TEST(RunningMotion, SpindleOverride) {
  PacedTalk m;
  std::vector<double> rpm;
  m.talk.machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
    rpm.push_back(motion.spindle_rpm);
    EXPECT_EQ(pieces.at(0).spindle_rpm, motion.spindle_rpm);
  };
  m.at(0, "S10000 M3\nG1 X10 F60\n");
  EXPECT_THAT(m.at(5, "\x9a?"), HasSubstr("|FS:60,11000|"));
  EXPECT_THAT(m.at(10, std::string(20, '\x9a') + "?"), HasSubstr("|FS:60,20000|")) << "at most 200 %";
  EXPECT_THAT(m.at(15, "\x99" + std::string(20, '\x9b') + "?"), HasSubstr("|FS:60,1000>")) << "at least 10 %";
  m.at(30, "");
  EXPECT_EQ(rpm, (std::vector<double>{10000, 11000, 20000, 1000}));
  m.at(30, "S30000\n\x99" + std::string(5, '\x9a'));
  EXPECT_THAT(m.at(30, "?"), HasSubstr("|FS:0,36000>")) << "what it can";
  m.at(30, "M5\n");
  EXPECT_THAT(m.at(30, "?"), HasSubstr("|FS:0,0>"));
}

// Holds and overrides at any moment cut one motion into pieces that join, last as long as the machine was not held, and
// end where the motion ends.
RC_GTEST_PROP(RunningMotion, PiecesJoin, (unsigned seed)) {
  std::mt19937 random(seed);
  PacedTalk m;
  std::vector<Motion> made;
  m.talk.machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>&) { made.push_back(motion); };
  m.at(0, "G1 X7 Y-3 B20 C-50 F100\nX8 Y4 C10\nG0 X0\n");
  double now = 0, held_s = 0;
  bool held = false;
  while (m.talk.machine.busy()) {
    const double step = static_cast<double>(random() % 10000) * 1e-3;
    now += step;
    held_s += held ? step : 0;
    held = now < 300 && random() % 3 == 0;
    m.at(now, std::string(held ? "!" : "~") + "\x90\x91\x92\x93\x94"[random() % 5] + "\x95\x96\x97"[random() % 3]);
  }
  const auto same = [](const JointPosition& a, const JointPosition& b) {
    return a.x_mm == b.x_mm && a.y_mm == b.y_mm && a.z_mm == b.z_mm && a.outer_rad == b.outer_rad && a.inner_rad == b.inner_rad;
  };
  JointPosition place;
  double seconds = 0;
  for (const Motion& motion : made) {
    RC_ASSERT(same(motion.from, place));
    RC_ASSERT(motion.seconds > 0);
    place = motion.to;
    seconds += motion.seconds;
  }
  RC_ASSERT(same(place, m.talk.machine.result().joints));
  RC_ASSERT(place.x_mm == 10);
  RC_ASSERT(seconds <= now - held_s + 1e-6);
  RC_ASSERT(std::abs(seconds - m.talk.machine.result().machine_seconds) < 1e-9);
}

TEST(RunningMotion, AHoldCutsAsFarAsItGot) {
  SimulationOptions options;
  options.stock.pitch_mm = 0.1;
  options.remove_stock = true;
  PacedTalk m(options);
  // A groove 1 mm deep from X -10 on, stopped after half of its 20 s.
  m.at(0, "T1 M6\n");
  m.at(0, "~G43.1 Z80\nS20000 M3\nG4 P9\nG0 X-10 Y0 Z20\nG1 Z11 F600\n");
  m.at(100, "G1 X10 F60\n");
  m.at(110, "!");
  m.at(150, "\x18");
  const MachinedSurface surface = m.talk.machine.machined();
  const auto height = [&](double x) {
    const Vec2 node = (Vec2(x, 0) - surface.extent.min) / surface.pitch_mm;
    return surface.heights_mm.at(static_cast<int>(std::lround(node.x())), static_cast<int>(std::lround(node.y())));
  };
  EXPECT_NEAR(height(-5), 11, 1e-3);
  EXPECT_NEAR(height(-0.1), 11, 0.01);
  EXPECT_NEAR(height(1), 12 - 1 + 2 - std::sqrt(3), 0.01) << "the ball's end, 1 mm beside its middle";
  EXPECT_EQ(height(3), 12);
}

// --- The receive buffer ---

TEST(ReceiveBuffer, HoldsOneByteLessThanItsSizeAndLosesTheRest) {
  MachineModel model = test::skew_machine();
  model.receive_buffer_bytes = 64;
  Talk talk(test::no_stock(), model);
  // One line is taken out, seven of nine bytes fit into 63 bytes; a blind sender's ninth does not.
  std::string burst;
  for (int i = 0; i < 9; ++i) burst += "G0 X1" + std::to_string(i) + ".5\n";
  talk.machine.receive(burst);
  EXPECT_EQ(talk.machine.result().highest_buffer_fill, 63);
  EXPECT_EQ(talk.machine.result().overflowed_bytes, 9);
  EXPECT_EQ(talk.say(""), "ok\nok\nok\nok\nok\nok\nok\nok\n");
  EXPECT_EQ(talk.machine.result().joints.x_mm, 27.5);
  EXPECT_EQ(talk.machine.result().faults.at(0).kind, "overflow");
}

TEST(ReceiveBuffer, RealTimeBytesPassAFullBuffer) {
  Talk talk;
  talk.machine.receive("!" + std::string(5000, '\n'));
  EXPECT_THAT(talk.say("?"), HasSubstr("Bf:100,0|"));
}

// Whatever the pieces in which the bytes come, the lines are the same.
RC_GTEST_PROP(ReceiveBuffer, LinesComeWholeAndInOrder, ()) {
  std::string text;
  const int count = *rc::gen::inRange(1, 200);
  for (int i = 0; i < count; ++i)
    text += "G0 X" + std::to_string(*rc::gen::inRange(-200, 200)) + (i % 3 ? "\n" : "\r\n");
  SimulatedMachine machine(test::skew_machine(), test::skew_setup(), test::no_stock());
  long expected_line = 1;
  machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>&) {
    RC_ASSERT(motion.line == expected_line++);
  };
  std::string_view rest = text;
  while (!rest.empty()) {
    const auto size = std::min<std::size_t>(static_cast<std::size_t>(*rc::gen::inRange(1, 300)), rest.size());
    machine.receive(rest.substr(0, size));
    rest.remove_prefix(size);
    while (machine.work(3) > 0) {
    }
  }
  RC_ASSERT(machine.result().received_digest == program_digest(text));
  RC_ASSERT(machine.result().lines == count);
  RC_ASSERT(machine.result().overflowed_bytes == 0);
}

RC_GTEST_PROP(SimulatedMachineFuzz, AnyBytes, (const std::string& bytes)) {
  SimulatedMachine machine(test::skew_machine(), test::skew_setup(), test::no_stock());
  machine.start();
  for (int i = 0; i < 5; ++i) {
    machine.receive(bytes);
    machine.receive("\n~\n");
    machine.work(100);
  }
  machine.take_replies();
}

// --- The digest ---

TEST(LineDigest, KnowsLostDoubledAndSwappedLines) {
  const std::string good = program_digest("G0 X1\nG0 X2\nG0 X3\n");
  EXPECT_EQ(program_digest("G0 X1\r\n\n  G0 X2\nG0 X3"), good) << "blank lines and line ends do not count";
  for (const char* bad : {"G0 X1\nG0 X3\n", "G0 X1\nG0 X2\nG0 X2\nG0 X3\n", "G0 X2\nG0 X1\nG0 X3\n",
                          "G0 X1\nG0 X2G0 X3\n", "G0 X1\nG0 X2\nG0 X4\n"}) {
    EXPECT_NE(program_digest(bad), good) << bad;
  }
  // FNV-1a of "a", 64 bits, from its authors' list of test vectors is af63dc4c8601ec8c; ours goes on with the line
  // feed.
  std::uint64_t state = (0xaf63dc4c8601ec8cULL ^ '\n') * 1099511628211ULL;
  char text[17];
  std::snprintf(text, sizeof text, "%016lx", static_cast<unsigned long>(state));
  EXPECT_EQ(program_digest("a"), text);
}

TEST(LineDigest, RefusedLinesDoNotCount) {
  Talk talk;
  talk.burst({"G0 X1", "bad", "G0 X2", "", "G0 X3"});
  EXPECT_EQ(talk.machine.result().received_digest, program_digest("G0 X1\nG0 X3\n"));
}

// --- The machine ---

TEST(Machine, CutterFollowsTheProgramInTheWorkpieceFrame) {
  Talk talk;
  std::vector<SweptMove> moves;
  std::vector<Motion> motions;
  talk.machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
    motions.push_back(motion);
    moves.insert(moves.end(), pieces.begin(), pieces.end());
  };
  talk.burst({"T3 M6"});
  talk.say("~");
  EXPECT_EQ(talk.burst({"G43.1 Z85", "S36000 M3", "G4 P8", "G53 G0 Z0", "G0 X3 Y4", "G0 Z20", "G1 Z12 F480"}),
            "ok\nok\nok\nok\nok\nok\nok\n");
  ASSERT_EQ(moves.size(), 4U);
  EXPECT_LT((moves.back().to.tip_mm - Vec3(3, 4, 12)).norm(), 1e-12);
  EXPECT_TRUE(moves.back().spindle_on);
  EXPECT_FALSE(moves.back().rapid);
  EXPECT_EQ(moves.back().line, 8);
  EXPECT_EQ(motions.back().tool, 3);
  EXPECT_EQ(motions.back().spindle_rpm, 36000);
  EXPECT_DOUBLE_EQ(motions.back().seconds, 1);
}

// The text believes 85 mm, the spindle holds another length: the tip is off by the difference.
TEST(Machine, TheToolInTheSpindleIsTheTruth) {
  OperatorSetup setup = test::skew_setup();
  setup.cutters[1].length_mm = 84.9;
  SimulatedMachine machine(test::skew_machine(), setup, test::no_stock());
  Vec3 tip = Vec3::Zero();
  machine.on_motion = [&](const Motion&, const std::vector<SweptMove>& pieces) { tip = pieces.back().to.tip_mm; };
  machine.receive("T3 M6\n");
  machine.work(1);
  machine.receive("~G43.1 Z85\nG0 X0 Y0 Z20\n");
  machine.work(10);
  EXPECT_NEAR(tip.z(), 20.1, 1e-12);
}

// Only the operator's offset is set; the program's mistake moves the cut by the whole offset.
TEST(Machine, ASwappedOffsetIsNoSmallMatter) {
  Talk talk;
  Vec3 tip = Vec3::Zero();
  talk.machine.on_motion = [&](const Motion&, const std::vector<SweptMove>& pieces) { tip = pieces.back().to.tip_mm; };
  talk.burst({"T3 M6"});
  talk.say("~");
  talk.burst({"G43.1 Z85", "G54 G0 X0 Y0"});
  EXPECT_NEAR(tip.x(), 0, 1e-12);
  talk.burst({"G55 G0 X0 Y0"});
  EXPECT_NEAR(tip.x(), -10, 1e-12);
}

TEST(Machine, SpindleCutsOnlyAtSpeedAndClockwise) {
  Talk talk;
  bool on = false;
  talk.machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>&) { on = motion.spindle_on; };
  talk.burst({"F1000", "S20000 M3", "G1 X1"});
  EXPECT_FALSE(on) << "it takes 8 s to its speed";
  talk.burst({"G4 P8", "G1 X2"});
  EXPECT_TRUE(on);
  talk.burst({"M5", "G1 X3"});
  EXPECT_FALSE(on);
  talk.burst({"M4", "G4 P9", "G1 X4"});
  EXPECT_FALSE(on) << "cutters are right-handed";
}

TEST(Machine, TimeIsFeedsLimitsAndDwells) {
  Talk talk;
  // Position to begin with is X 0, Y 0, Z 0 in the machine.
  talk.say("G53 G0 X60 Y10\n");  // X: 60 mm at 600 mm/s
  EXPECT_NEAR(talk.machine.result().machine_seconds, 0.1, 1e-12);
  talk.say("G4 P2.5\n");
  EXPECT_NEAR(talk.machine.result().machine_seconds, 2.6, 1e-12);
  talk.say("G53 G1 X120 F1200\n");  // 60 mm at 20 mm/s
  EXPECT_NEAR(talk.machine.result().machine_seconds, 5.6, 1e-12);
  talk.say("G53 G1 X0 F99999\n");  // 120 mm, limited to 600 mm/s
  EXPECT_NEAR(talk.machine.result().machine_seconds, 5.8, 1e-12);
  talk.say("G93 G1 C90 F6000\n");  // 10 ms wanted, the table needs pi/2 / 25
  EXPECT_NEAR(talk.machine.result().machine_seconds, 5.8 + kPi / 2 / 25, 1e-12);
}

TEST(Machine, LimitsHoldInsideArcsToo) {
  Talk talk;
  // Ends are inside Y's 130 mm, the arc between them is not.
  EXPECT_EQ(talk.burst({"G55 G0 X-50 Y100"}), "ok\n");
  EXPECT_THAT(talk.burst({"G2 X50 Y100 I50 J0 F1000"}), StartsWith("ALARM:2"));
  EXPECT_THAT(talk.machine.result().faults.at(0).message, HasSubstr("Y would pass its limit 130 mm"));
  EXPECT_NEAR(talk.machine.result().joints.y_mm, 100, 1e-12);
}

TEST(Machine, RotaryLimits) {
  Talk talk;
  EXPECT_EQ(talk.say("G0 B110 C99999\n"), "ok\n") << "C is endless";
  EXPECT_THAT(talk.say("G0 B-110.01\n"), StartsWith("ALARM:2"));
  EXPECT_THAT(talk.machine.result().faults.at(0).message, HasSubstr("B would pass its limit -110 deg by 0.01 deg"));
}

TEST(Machine, FaultsNameTheProgram) {
  Talk talk;
  talk.machine.begin_program("10_rough.nc");
  talk.burst({"G0 X1", "G0 X2"});
  talk.machine.begin_program("20_finish.nc");
  talk.burst({"G0 X3", "G0 X9999"});
  const Fault fault = talk.machine.result().faults.at(0);
  EXPECT_EQ(fault.program, "20_finish.nc");
  EXPECT_EQ(fault.line, 2);
}

TEST(Machine, RealTimePace) {
  SimulationOptions options = test::no_stock();
  options.time_factor = 20;
  Talk talk(options);
  // One second of motion in 50 ms; the planner takes all lines at once, M5 waits for their end.
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(talk.burst({"G1 X5 F600", "X10", "M5"}), "ok\nok\n");
  std::string late;
  while (late.empty()) late = talk.say("");
  EXPECT_EQ(late, "ok\n");
  EXPECT_GE(std::chrono::steady_clock::now() - start, std::chrono::milliseconds(49));
}

TEST(Machine, PlannerIsBounded) {
  SimulationOptions options = test::no_stock();
  options.time_factor = 1;
  MachineModel model = test::skew_machine();
  model.planner_blocks = 5;
  Talk talk(options, model);
  std::vector<std::string> lines;
  for (int i = 0; i < 9; ++i) lines.push_back("G1 X" + std::to_string(i + 1) + " F60");
  EXPECT_EQ(talk.burst(lines), "ok\nok\nok\nok\nok\n");
  EXPECT_THAT(talk.say("?"), AllOf(StartsWith("<Run|"), HasSubstr("Bf:0,")));
}

// --- Planted faults ---

TEST(PlantedFaults, AreReadFromText) {
  LineOptions line;
  PlantedFaults control;
  plant_fault("reset@400", 1, line, control);
  plant_fault("lose-line@3", 1, line, control);
  plant_fault("flip@120", 1, line, control);
  EXPECT_EQ(control, (PlantedFaults{.reset_at_line = 400, .drop_line_at = 3}));
  ASSERT_EQ(line.faults.size(), 1U);
  EXPECT_EQ(line.faults[0].kind, LineFault::Kind::kFlipByte);
  // Without a place the seed chooses one, and again the same.
  const auto seeded = [&](unsigned seed) {
    plant_fault("reset", seed, line, control);
    return control.reset_at_line;
  };
  EXPECT_EQ(seeded(7), seeded(7));
  EXPECT_NE(seeded(7), seeded(8));
  for (const char* bad : {"reset@", "reset@0", "reset@3 ", "melt"}) EXPECT_THROW(plant_fault(bad, 1, line, control), InputError) << bad;
  SimulationOptions options = test::no_stock();
  options.planted = control;
  options.personality = Personality::kDripFeed;
  EXPECT_THROW(SimulatedMachine(test::skew_machine(), test::skew_setup(), options), InputError);
}

TEST(PlantedFaults, EachDoesWhatItSays) {
  const auto options = [](auto&& plant) {
    SimulationOptions o = test::no_stock();
    plant(o.planted);
    return o;
  };
  const std::vector<std::string> lines = {"G0 X1", "G0 X2", "G0 X3"};
  {
    Talk talk(options([](PlantedFaults& p) { p.error_at_line = 2; }));
    EXPECT_EQ(talk.burst(lines), "ok\nerror:2\nerror:2\n");
    EXPECT_EQ(talk.machine.result().joints.x_mm, 11);
  }
  {
    Talk talk(options([](PlantedFaults& p) { p.drop_line_at = 2; }));
    EXPECT_EQ(talk.burst(lines), "ok\nok\n");
    EXPECT_EQ(talk.machine.result().lines, 2);
  }
  {
    Talk talk(options([](PlantedFaults& p) { p.alarm_at_line = 2; }));
    EXPECT_THAT(talk.burst(lines), StartsWith("ok\nALARM:1\n"));
  }
  {
    Talk talk(options([](PlantedFaults& p) { p.door_at_line = 2; }));
    EXPECT_EQ(talk.burst(lines), "ok\n[MSG:Check Door]\nok\n");
    EXPECT_EQ(talk.say("~"), "ok\n");
  }
  {
    Talk talk(options([](PlantedFaults& p) { p.reset_at_line = 2; }));
    EXPECT_THAT(talk.burst(lines), AllOf(StartsWith("ok\n\nGrblHAL")));
  }
  {
    Talk talk(options([](PlantedFaults& p) { p.power_loss_at_line = 2; }));
    EXPECT_EQ(talk.burst(lines), "ok\n");
    EXPECT_TRUE(talk.machine.dead());
    talk.machine.start();
    EXPECT_FALSE(talk.machine.dead());
    EXPECT_THAT(talk.burst({"G0 X3"}), AllOf(HasSubstr("to unlock"), HasSubstr("error:9")));
    EXPECT_THAT(talk.burst({"$X", "G0 X3"}), HasSubstr("ok\nok\n"));
  }
}

}  // namespace
}  // namespace lightmill

#include "machine/streamer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <random>

#include "design/core/text.h"
#include "machine/detail/interpreter.h"
#include "machine/detail/sent_text.h"
#include "machine/program_lines.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using testing::AllOf;
using testing::HasSubstr;

StreamOptions quick() {
  StreamOptions options;
  options.reply_timeout = milliseconds(150);
  options.settle_time = milliseconds(20);
  options.on_operator = [](const std::string&) { return true; };
  return options;
}

/// A zigzag of `count` feed lines between a header and a footer, lines of all lengths.
std::string zigzag(long count, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::string text =
      "%\nG21 G90 G94 G17 G40 G49 G54\nT3 M6\nG43.1 Z85\nS36000 M3\nG4 P8\nG53 G0 Z0\nG0 X0 Y0\nG0 Z30\n";
  for (long i = 0; i < count; ++i) {
    const int decimals = static_cast<int>(random() % 6);
    text += "G1 X" + fixed(static_cast<double>(random() % 10000) * 0.002 - 10, decimals) + " Y" +
            fixed(static_cast<double>(i % 1000) * 0.01 - 5, decimals) + " F3000";
    if (random() % 8 == 0) text += " (" + std::string(random() % 60, 'c') + ")";
    text += "\n";
  }
  return text + "G53 G0 Z0\nM5\nM2\n%\n";
}

struct Outcome {
  StreamResult stream;
  SimulationResult machine;
};

/// In lockstep: time-outs cost nothing, and every run is the same.
Outcome stream(const std::string& program, const SimulationOptions& simulation = test::no_stock(),
               const StreamOptions& options = quick(), const LineOptions& line = {},
               const MachineModel& model = test::skew_machine()) {
  test::Lockstep rig(simulation, line, model);
  Outcome outcome;
  outcome.stream = stream_program(rig.link, program, options);
  outcome.machine = rig.machine.result();
  return outcome;
}

/// Through a pseudo-terminal and libserial, as to a real machine.
Outcome stream_through_terminal(const std::string& program, const LineOptions& line = {}) {
  test::MachineRig rig(test::no_stock(), line);
  rig.serve_in_thread();
  Outcome outcome;
  {
    const auto connection = rig.connect();
    outcome.stream = stream_program(*connection, program, quick());
  }
  rig.stop();
  outcome.machine = rig.machine.result();
  return outcome;
}

LineOptions faulty(LineFault::Kind kind, bool to_machine, long at) {
  LineOptions line;
  line.faults.push_back({.kind = kind, .to_machine = to_machine, .at = at});
  return line;
}

TEST(Streamer, EveryLineOnceAndInOrder) {
  const std::string program = zigzag(20000);
  const Outcome outcome = stream_through_terminal(program);
  EXPECT_EQ(outcome.stream.end, StreamEnd::kDone) << outcome.stream.message;
  EXPECT_EQ(outcome.stream.lines_acknowledged, outcome.stream.lines_total);
  EXPECT_EQ(outcome.stream.receive_buffer_bytes, 1024);
  EXPECT_LE(outcome.stream.highest_buffer_fill, 1023);
  EXPECT_GT(outcome.stream.highest_buffer_fill, 900) << "the buffer is to be kept full";
  EXPECT_EQ(outcome.machine.received_digest, program_digest(program));
  EXPECT_EQ(outcome.machine.overflowed_bytes, 0);
  EXPECT_TRUE(outcome.machine.faults.empty());
}

// Any buffer, any lines: the buffer is never over, the text arrives once.
RC_GTEST_PROP(StreamerProperty, NeverOverflowsAnyBuffer, ()) {
  MachineModel model = test::skew_machine();
  model.receive_buffer_bytes = *rc::gen::inRange(100, 2000);
  const std::string program = zigzag(*rc::gen::inRange(0, 400), *rc::gen::arbitrary<unsigned>());
  StreamOptions options = quick();
  options.settle_time = milliseconds(2);
  options.audit_every_lines = *rc::gen::inRange(1, 200);
  const Outcome outcome = stream(program, test::no_stock(), options, {}, model);
  RC_ASSERT(outcome.stream.done());
  RC_ASSERT(outcome.machine.overflowed_bytes == 0);
  RC_ASSERT(outcome.machine.highest_buffer_fill < model.receive_buffer_bytes);
  RC_ASSERT(outcome.stream.highest_buffer_fill < model.receive_buffer_bytes);
  RC_ASSERT(outcome.machine.received_digest == program_digest(program));
}

TEST(Streamer, OneLineAtATimeWaitsForEachOk) {
  StreamOptions options = quick();
  options.one_at_a_time = true;
  bool waits = false;
  long sent = 0;
  options.on_traffic = [&](const std::string& text) {
    if (text == "< ok") waits = false;
    if (text.size() < 4 || !text.starts_with("> ") || text[2] == '$' || text[2] == '<') return;
    EXPECT_FALSE(waits) << text;
    waits = true;
    ++sent;
  };
  const std::string program = zigzag(300);
  std::size_t longest = 0;
  for (const ProgramLine& line : program_lines(program)) longest = std::max(longest, line.text.size() + 1);
  const Outcome outcome = stream(program, test::no_stock(), options, {.baud = 115200, .faults = {}});
  EXPECT_TRUE(outcome.stream.done()) << outcome.stream.message;
  EXPECT_EQ(outcome.machine.received_digest, program_digest(program));
  EXPECT_EQ(outcome.stream.highest_buffer_fill, static_cast<int>(longest)) << "never two lines under way";
  EXPECT_EQ(outcome.stream.recovered_acknowledgements, 0);
  EXPECT_GE(sent, 300);
}

TEST(Streamer, ABlindSenderDoesOverflow) {
  test::MachineRig rig;
  const auto connection = rig.connect();
  const std::string text = zigzag(200);
  const std::size_t sent = connection->write_some(text, milliseconds(100));
  rig.serve_in_thread();
  std::this_thread::sleep_for(milliseconds(100));
  rig.stop();
  EXPECT_GT(sent, 1024U);
  EXPECT_GT(rig.machine.result().overflowed_bytes, 0);
}

TEST(Streamer, SurvivesADroppedAcknowledgement) {
  const std::string program = zigzag(3000);
  for (const long at : {4L, 15L, 1500L, 3013L}) {
    const Outcome outcome =
        stream(program, test::no_stock(), quick(), faulty(LineFault::Kind::kDropOk, false, at));
    EXPECT_EQ(outcome.stream.end, StreamEnd::kDone) << at << ": " << outcome.stream.message;
    EXPECT_EQ(outcome.stream.recovered_acknowledgements, 1) << at;
    EXPECT_THAT(outcome.stream.message, AllOf(HasSubstr("1 acknowledgement got lost"), HasSubstr("between lines")));
    EXPECT_EQ(outcome.machine.received_digest, program_digest(program)) << "no line lost, none doubled";
  }
}

TEST(Streamer, ALostLineIsNotTakenForALostAcknowledgement) {
  // The last motion before an audit is lost on the wire: the machine stands elsewhere.
  std::string program = "G21 G90\nG1 F3000 X0 Y0\n";
  for (int i = 1; i <= 50; ++i) program += "G1 X" + std::to_string(i) + " Y" + std::to_string(i % 7) + "\n";
  SimulationOptions simulation = test::no_stock();
  simulation.planted.drop_line_at = 52;
  const Outcome outcome = stream(program, simulation);
  EXPECT_EQ(outcome.stream.end, StreamEnd::kLostAcknowledgement);
  EXPECT_THAT(outcome.stream.message, HasSubstr("it does not stand where line 52 ends"));
}

TEST(Streamer, ALostHeaderLineShowsInTheModes) {
  SimulationOptions simulation = test::no_stock();
  simulation.planted.drop_line_at = 3;  // G55: the machine would cut elsewhere
  const Outcome outcome = stream("G21 G90\nG0 X1 Y1\nG55\nG0 X2 Y2\n", simulation);
  EXPECT_EQ(outcome.stream.end, StreamEnd::kLostAcknowledgement);
  EXPECT_THAT(outcome.stream.message, HasSubstr("are not those of the program"));
  EXPECT_EQ(outcome.machine.lines, 2);
}

TEST(Streamer, TwoMissingAcknowledgementsAreTooMany) {
  SimulationOptions simulation = test::no_stock();
  simulation.planted.drop_line_at = 200;
  const Outcome outcome = stream(zigzag(300), simulation, quick(), faulty(LineFault::Kind::kDropOk, false, 100));
  EXPECT_EQ(outcome.stream.end, StreamEnd::kLostAcknowledgement);
  EXPECT_THAT(outcome.stream.message, HasSubstr("more than one is missing"));
}

TEST(Streamer, StopsAtAControllerError) {
  const std::string program = "\n\n" + zigzag(3000);
  SimulationOptions simulation = test::no_stock();
  simulation.planted.error_at_line = 1500;
  const Outcome outcome = stream(program, simulation);
  EXPECT_EQ(outcome.stream.end, StreamEnd::kControllerError);
  EXPECT_EQ(outcome.stream.error_line, 1502) << "of the text, with its blank lines";
  EXPECT_EQ(outcome.stream.lines_acknowledged, 1499);
  EXPECT_EQ(outcome.machine.lines, 1499) << "the controller executed what it acknowledged and nothing else";
  EXPECT_THAT(outcome.stream.message,
              AllOf(HasSubstr("refused line 1502 with error:2"), HasSubstr("none of the lines after it"),
                    HasSubstr("1499 of 3013 lines acknowledged")));
  EXPECT_EQ(outcome.machine.overflowed_bytes, 0);
}

TEST(Streamer, ARealMistakeInTheTextIsNamed) {
  const Outcome outcome = stream("G21 G90\nG1 X1\nG0 X5\n");
  EXPECT_EQ(outcome.stream.end, StreamEnd::kControllerError);
  EXPECT_EQ(outcome.stream.error_line, 2);
  EXPECT_THAT(outcome.stream.message, HasSubstr("error:22: 'G1 X1'"));
}

TEST(Streamer, StopsAtAnAlarm) {
  std::string program = "G21 G90\n";
  for (int i = 0; i < 100; ++i) program += "G0 X" + std::to_string(i * 5) + "\n";
  const Outcome outcome = stream(program);
  EXPECT_EQ(outcome.stream.end, StreamEnd::kAlarm);
  EXPECT_THAT(outcome.stream.message, HasSubstr("ALARM:2 at or before line 53"));
  EXPECT_EQ(outcome.stream.error_line, 53) << "X 10 + 5 * 51 passes 260";
  ASSERT_EQ(outcome.machine.faults.size(), 1U);
  EXPECT_EQ(outcome.machine.faults[0].line, 53);
}

TEST(Streamer, NoticesARestart) {
  SimulationOptions simulation = test::no_stock();
  simulation.planted.reset_at_line = 700;
  const Outcome outcome = stream(zigzag(3000), simulation);
  EXPECT_EQ(outcome.stream.end, StreamEnd::kReset);
  EXPECT_EQ(outcome.stream.lines_acknowledged, 699);
  EXPECT_THAT(outcome.stream.message, HasSubstr("restarted"));
}

TEST(Streamer, SurvivesAHangUp) {
  const Outcome outcome = stream_through_terminal(zigzag(3000), faulty(LineFault::Kind::kHangUp, false, 4000));
  EXPECT_EQ(outcome.stream.end, StreamEnd::kHungUp);
  EXPECT_LE(outcome.stream.lines_acknowledged, 1000);
  EXPECT_THAT(outcome.stream.message, AllOf(HasSubstr("hung up"), HasSubstr("goes on with what it has buffered"),
                                            HasSubstr("may or may not be executed")));
}

// Every single garbled byte is either refused by the controller, noticed by the streamer, or shows in the digest.
TEST(Streamer, NoGarbledByteGoesUnnoticed) {
  const std::string program = zigzag(30);
  const long greeting = 1 + 1 + 1 + 3;  // "?", reset, empty line... and then some
  long silent = 0, refused = 0, other = 0;
  for (long at = greeting + 5; at < static_cast<long>(program.size()); at += 61) {
    const Outcome outcome =
        stream(program, test::no_stock(), quick(), faulty(LineFault::Kind::kFlipByte, true, at));
    if (outcome.stream.end == StreamEnd::kControllerError) {
      ++refused;
    } else if (!outcome.stream.done()) {
      ++other;
    } else {
      ++silent;
      EXPECT_NE(outcome.machine.received_digest, program_digest(program)) << "byte " << at;
    }
  }
  EXPECT_GT(silent, 0) << "digits turn into digits: the digest is there for them";
  EXPECT_GT(refused, 0);
}

TEST(Streamer, AsksTheOperator) {
  std::vector<std::string> asked;
  StreamOptions options = quick();
  options.on_operator = [&](const std::string& what) {
    asked.push_back(what);
    return true;
  };
  const std::string program = "G21 G90\nT1 M6\nG0 X1\nM0 (turn the part)\nG0 X2\nM1\nT3 M6\nG0 X3\nM0\n";
  const Outcome outcome = stream(program, test::no_stock(), options);
  EXPECT_TRUE(outcome.stream.done()) << outcome.stream.message;
  EXPECT_THAT(asked, testing::ElementsAre("tool change: T1 M6", "program pause: M0 (turn the part)",
                                          "tool change: T3 M6", "program pause: M0"));
  EXPECT_EQ(outcome.machine.tool, 3);
  EXPECT_EQ(outcome.machine.received_digest, program_digest(program));

  options.on_operator = nullptr;
  const Outcome alone = stream(program, test::no_stock(), options);
  EXPECT_EQ(alone.stream.end, StreamEnd::kStopped);
  EXPECT_EQ(alone.machine.tool, 0);
  EXPECT_EQ(alone.machine.lines, 2) << "nothing is sent past a tool change that nobody confirms";
}

TEST(Streamer, WaitsForASlowMachine) {
  // Seven seconds of motion, replies far apart: no acknowledgement is missed, the end is waited for.
  SimulationOptions simulation = test::no_stock();
  simulation.time_factor = 1;
  MachineModel model = test::skew_machine();
  model.planner_blocks = 3;
  const std::string program = "G21 G90\nG1 X10 F600\nX20\nX30\nX40\nX50\nX60\nM5\n";
  const Outcome outcome = stream(program, simulation, quick(), {}, model);
  EXPECT_TRUE(outcome.stream.done()) << outcome.stream.message;
  EXPECT_EQ(outcome.stream.recovered_acknowledgements, 0);
  EXPECT_GE(outcome.stream.seconds, 7);
  EXPECT_LE(outcome.stream.seconds, 7.3);
  EXPECT_EQ(outcome.machine.joints.x_mm, 70);
}

TEST(Streamer, APacedWireIsNoTrouble) {
  const std::string program = zigzag(200);
  const Outcome outcome = stream_through_terminal(program, {.baud = 115200, .faults = {}});
  EXPECT_TRUE(outcome.stream.done()) << outcome.stream.message;
  EXPECT_EQ(outcome.machine.received_digest, program_digest(program));
  EXPECT_GT(outcome.stream.seconds, static_cast<double>(program.size()) / 11520);
}

TEST(Streamer, StopsWhenTheUserWants) {
  Monitor monitor;
  double fraction = 0;
  monitor.on_progress = [&](std::string_view, double f) { fraction = f; };
  monitor.should_stop = [&] { return fraction > 0; };
  test::MachineRig rig(test::no_stock(), {.baud = 115200, .faults = {}});
  rig.serve_in_thread();
  const auto connection = rig.connect();
  const StreamResult result = stream_program(*connection, zigzag(20000), quick(), monitor);
  EXPECT_EQ(result.end, StreamEnd::kStopped);
  EXPECT_LT(result.lines_sent, 20000);
  char bytes[64];
  connection->write_some(std::string("?"), milliseconds(100));
  std::string answer;
  while (answer.find('>') == std::string::npos) {
    const std::size_t count = connection->read_some(bytes, milliseconds(500));
    if (count == 0) break;
    answer.append(bytes, count);
  }
  EXPECT_THAT(answer, HasSubstr("<Hold"));
}

TEST(Streamer, RefusesBeforehandWhatNoControllerTakes) {
  test::MachineRig rig;
  rig.serve_in_thread();
  const auto connection = rig.connect();
  const auto complaint = [&](const std::string& program) -> std::string {
    try {
      stream_program(*connection, program, quick());
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(complaint("G21\n\n" + std::string(257, 'x')), AllOf(HasSubstr("line 3"), HasSubstr("257 characters")));
  EXPECT_THAT(complaint("G21\n(really?)\n"), AllOf(HasSubstr("line 2"), HasSubstr("'?'")));
  EXPECT_THAT(complaint("(fl\xc3\xa4"
                        "che)\n"),
              HasSubstr("byte above 127"));
  EXPECT_THAT(complaint("G21\n$H\n"), HasSubstr("controller command"));
  rig.stop();
  EXPECT_EQ(rig.machine.result().received_bytes, 0) << "nothing was sent";
}

TEST(Streamer, NobodyThereIsAnIoError) {
  const PseudoTerminal silent{std::filesystem::path()};
  const auto connection = open_serial(silent.far_end(), 115200);
  EXPECT_THROW(stream_program(*connection, "G21\n", quick()), IoError);
}

TEST(Streamer, ALockedControllerIsAnIoError) {
  test::MachineRig rig;
  rig.serve_in_thread();
  const auto connection = rig.connect();
  EXPECT_EQ(stream_program(*connection, "G0 X9999\n", quick()).end, StreamEnd::kAlarm);
  try {
    stream_program(*connection, "G0 X1\n", quick());
    FAIL();
  } catch (const IoError& error) {
    EXPECT_THAT(error.what(), HasSubstr("$X"));
  }
}

TEST(Streamer, OneProgramAfterAnother) {
  test::MachineRig rig;
  rig.serve_in_thread();
  const std::string first = zigzag(100), second = zigzag(200, 7);
  for (const std::string& program : {first, second}) {
    const auto connection = rig.connect();
    EXPECT_TRUE(stream_program(*connection, program, quick()).done());
  }
  rig.stop();
  EXPECT_EQ(rig.machine.result().received_digest, program_digest(first + second));
}

// --- Before the start ---

TEST(Streamer, CheckModeFindsWhatWouldBeRefusedAndMovesNothing) {
  for (const Personality personality : {Personality::kGrblHal, Personality::kGrbl}) {
    SimulationOptions simulation = test::no_stock();
    simulation.personality = personality;
    test::Lockstep rig(simulation);
    std::string program = "G21 G90\nS20000 M3\nG0 X1\n";
    for (int i = 0; i < 200; ++i) program += "G1 X" + std::to_string(i % 9) + " F600\n";
    const StreamResult good = check_program(rig.link, program + "M0\nM5\nM2\n", quick());
    EXPECT_TRUE(good.done()) << good.message;
    EXPECT_EQ(good.message, "the controller takes all 206 lines");
    const StreamResult bad = check_program(rig.link, program + "G1 Q7\nM2\n", quick());
    EXPECT_EQ(bad.end, StreamEnd::kControllerError);
    EXPECT_EQ(bad.error_line, 204);
    EXPECT_THAT(bad.message, HasSubstr("in check mode, nothing has moved: the controller refused line 204"));
    EXPECT_EQ(rig.machine.result().lines, 0);
    EXPECT_EQ(rig.machine.result().machine_seconds, 0);
    // It is ready for the real thing.
    EXPECT_TRUE(stream_program(rig.link, program + "M2\n", quick()).done());
  }
}

TEST(Streamer, SettingsMustFitTheMachineFile) {
  const MachineModel machine = test::skew_machine();
  StreamOptions options = quick();
  options.machine = &machine;
  EXPECT_TRUE(stream("G21\nG0 X1\nM2\n", test::no_stock(), options).stream.done());
  MachineModel other = machine;
  other.y.max_speed_mm_per_s /= 2;
  other.max_spindle_rpm = 24000;
  other.z.min_mm -= 5;
  test::Lockstep rig(test::no_stock(), {}, other);
  try {
    stream_program(rig.link, "G21\nG0 X1\nM2\n", options);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("$30 (highest spindle speed) is 24000, the file says 36000 rpm"),
                                    HasSubstr("$111 (Y speed) is 15000, the file says 30000 mm/min"),
                                    HasSubstr("$132 (Z travel) is 370, the file says 365 mm")));
  }
  EXPECT_EQ(rig.machine.result().lines, 0);
  EXPECT_THAT(setting_differences({{13, 1}, {32, 1}}, machine), testing::SizeIs(2)) << "inches and laser mode are never right";
}

// --- The operator ---

TEST(Streamer, PausesWhereTheOperatorWants) {
  StreamOptions options = quick();
  std::vector<std::string> asked;
  options.on_operator = [&](const std::string& what) {
    asked.push_back(what);
    return true;
  };
  options.pause_before = [](const ProgramLine& line, std::string_view before) {
    return line.number == 3 || is_optional_stop(before);
  };
  const std::string program = "G21 G90\nG0 X1\nG0 X2\nG0 X3 M01\nG0 X9\nM2\n";
  const Outcome outcome = stream(program, test::no_stock(), options);
  EXPECT_TRUE(outcome.stream.done()) << outcome.stream.message;
  EXPECT_THAT(asked, testing::ElementsAre("before line 3: G0 X2", "before line 5: G0 X9"));
  EXPECT_EQ(outcome.machine.received_digest, program_digest(program));

  options.on_operator = [&](const std::string&) { return false; };
  const Outcome stopped = stream(program, test::no_stock(), options);
  EXPECT_EQ(stopped.stream.end, StreamEnd::kStopped);
  EXPECT_EQ(stopped.machine.lines, 2) << "nothing behind the pause was sent";
  // Single block.
  asked.clear();
  options.on_operator = [&](const std::string& what) {
    asked.push_back(what);
    return true;
  };
  options.pause_before = [](const ProgramLine&, std::string_view) { return true; };
  EXPECT_TRUE(stream(program, test::no_stock(), options).stream.done());
  EXPECT_EQ(asked.size(), 6U);
}

// A digit that became another is executed without a word; where the machine rests, its place tells.
TEST(Streamer, AGarbledNumberShowsWhereTheMachineRests) {
  const std::string program = "G21 G90\nG0 X1 Y2\nG0 X2 Y3\nG0 X3\nG0 Z90\nM2\n";
  const std::size_t digit = program.find("Y3") + 1;
  StreamOptions options = quick();
  int asked = 0;
  options.on_operator = [&](const std::string&) { return ++asked > 0; };
  for (const bool pause : {false, true}) {
    if (pause) options.pause_before = [](const ProgramLine& line, std::string_view) { return line.number == 5; };
    // Behind the greeting: "?", reset, "?", line feed, "$I" and its line feed, "?".
    const Outcome outcome = stream(program, test::no_stock(), options,
                                   faulty(LineFault::Kind::kFlipByte, true, static_cast<long>(digit) + 1 + 8));
    EXPECT_EQ(outcome.stream.end, StreamEnd::kWrongPlace) << outcome.stream.message;
    EXPECT_THAT(outcome.stream.message, HasSubstr(pause ? "where line 4 ends" : "where line 5 ends"));
    EXPECT_EQ(outcome.machine.joints.y_mm, -3) << "Y2 where the program says Y3";
    EXPECT_EQ(outcome.machine.lines, pause ? 4 : 5);
  }
  EXPECT_EQ(asked, 0);
}

TEST(Streamer, TheOperatorsKeysActAtOnce) {
  SimulationOptions simulation = test::no_stock();
  simulation.time_factor = 1;
  test::Lockstep rig(simulation, {.baud = 115200, .faults = {}});
  StreamOptions options = quick();
  int asked = 0;
  options.on_operator = [&](const std::string&) { return ++asked > 0; };
  // Held from second 3 to 63, then twice as quick.
  int pressed = 0;
  options.commands = [&]() -> std::string {
    if (pressed == 0 && rig.clock.now() > std::chrono::seconds(3)) return ++pressed, "!";
    if (pressed == 1 && rig.clock.now() > std::chrono::seconds(63)) return ++pressed, "~" + std::string(10, '\x91');
    return "";
  };
  const StreamResult result = stream_program(rig.link, "G21 G90\nG1 X20 F60\nG1 X30\nG1 X40\nM2\n", options);
  EXPECT_TRUE(result.done()) << result.message;
  EXPECT_EQ(asked, 0) << "who held it knows why it stands";
  // 50 s at F60 in all: 3 - 0.5 or so of them before the hold, the rest at half the time.
  EXPECT_NEAR(result.seconds, 3 + 60 + 47.5 / 2, 1);
}

// Held, at rest, reset: the controller does not raise its alarm for a position lost in motion.
TEST(Streamer, GivingUpKeepsThePlace) {
  SimulationOptions simulation = test::no_stock();
  simulation.time_factor = 1;
  test::Lockstep rig(simulation, {.baud = 115200, .faults = {}});
  StreamOptions options = quick();
  options.commands = [&]() -> std::string { return rig.clock.now() > std::chrono::seconds(3) ? "\x18" : ""; };
  std::string program = "G21 G91\nG1 F60\n";
  for (int i = 0; i < 100; ++i) program += "X0.1\n";
  const StreamResult result = stream_program(rig.link, program + "M2\n", options);
  EXPECT_EQ(result.end, StreamEnd::kAborted) << result.message;
  EXPECT_THAT(result.message, AllOf(HasSubstr("its place is kept"), HasSubstr("acknowledged")));
  EXPECT_FALSE(rig.machine.result().alarm);
  const double x_mm = rig.machine.result().joints.x_mm;
  EXPECT_NEAR(x_mm, 2.7, 0.5) << "1 mm/s from second 0.4 or so on";
  rig.link.run_for(std::chrono::minutes(1));
  EXPECT_EQ(rig.machine.result().joints.x_mm, x_mm) << "nothing of the buffer is left";
  // The same controller takes the next program at once.
  EXPECT_TRUE(stream_program(rig.link, "G21 G90\nG0 X1\nM2\n", quick()).done());
}

TEST(Streamer, ItsStatusTellsLinePlaceAndFill) {
  SimulationOptions simulation = test::no_stock();
  simulation.time_factor = 1;
  test::Lockstep rig(simulation, {.baud = 115200, .faults = {}});
  StreamOptions options = quick();
  const std::string program = zigzag(2000);
  std::vector<StreamStatus> seen;
  options.on_status = [&](const StreamStatus& status) { seen.push_back(status); };
  const StreamResult result = stream_program(rig.link, program, options);
  ASSERT_TRUE(result.done()) << result.message;
  ASSERT_GT(seen.size(), 20U);
  bool moved = false, full = false;
  for (std::size_t i = 1; i < seen.size(); ++i) {
    EXPECT_GE(seen[i].lines_executed, seen[i - 1].lines_executed);
    EXPECT_GE(seen[i].line, seen[i - 1].line);
    EXPECT_LE(seen[i].lines_executed, seen[i].lines_acknowledged);
    EXPECT_LT(seen[i].under_way_bytes, seen[i].receive_buffer_bytes);
    EXPECT_EQ(seen[i].report.machine_position.size(), 6U);
    moved = moved || seen[i].report.feed_mm_per_min == 3000;
    full = full || seen[i].under_way_bytes > 900;
  }
  EXPECT_TRUE(moved);
  EXPECT_TRUE(full);
  EXPECT_EQ(seen.back().report.overrides, (std::vector<double>{100, 100, 100})) << "the last that came";
}

TEST(Streamer, JournalHasEveryLine) {
  std::vector<std::string> journal;
  StreamOptions options = quick();
  options.on_traffic = [&](const std::string& line) { journal.push_back(line); };
  const std::string program = zigzag(50);
  stream(program, test::no_stock(), options);
  std::string sent;
  for (const std::string& line : journal) {
    if (line.starts_with("> ") && line.size() > 3 && line != "> <reset>" && line != "> $I")
      sent += line.substr(2) + "\n";
    if (line == "> %") sent += "%\n";
  }
  EXPECT_EQ(program_digest(sent), program_digest(program));
}

TEST(StatusReport, IsRead) {
  StatusReport report;
  ASSERT_TRUE(parse_status(
      "<Hold:0|MPos:13.476,0.000,-1.500,0.000,2.000,0.000|Bf:99,1023|FS:1000,0|Ov:100,100,100|WCO:1,2,3,0,0,0>",
      report));
  EXPECT_EQ(report.state, "Hold");
  EXPECT_EQ(report.machine_position[2], -1.5);
  EXPECT_EQ(report.free_blocks, 99);
  EXPECT_EQ(report.free_bytes, 1023);
  EXPECT_EQ(report.work_offset[1], 2);
  for (const char* bad : {"", "<>", "ok", "<Idle|MPos:1,x>", "<Idle|Bf:1>", "<Idle"})
    EXPECT_FALSE(parse_status(bad, report)) << bad;
}

RC_GTEST_PROP(StatusReportFuzz, AnyBytes, (const std::string& text)) {
  StatusReport report;
  parse_status(text, report);
  parse_status("<" + text + ">", report);
  detail::words_of(text);
  detail::ProgrammedState state;
  state.read(text);
  int compared = 0;
  state.agrees_modes("[GC:" + text, compared);
}

// Two lines whose line feed gets lost must be an error to the controller, or not be under way together.
RC_GTEST_PROP(MergedLines, AreErrorsUnlessSaidToBePossible, ()) {
  const auto line = [] {
    std::string text;
    if (*rc::gen::inRange(0, 3) == 0) text += "G" + std::to_string(*rc::gen::inRange(0, 2));
    for (const char letter : {'X', 'Y', 'Z', 'F'}) {
      if (*rc::gen::inRange(0, 2))
        text += letter + std::to_string(*rc::gen::inRange(1, 90)) + (*rc::gen::inRange(0, 2) ? ".5" : "");
    }
    return text.empty() ? std::string("M5") : text;
  };
  const std::string first = line(), second = line();
  if (detail::may_merge(detail::words_of(first), detail::words_of(second))) return;
  detail::Interpreter interpreter(test::skew_machine());
  RC_ASSERT(interpreter.execute("G1 F100") == 0);
  RC_ASSERT(interpreter.execute(first + second) != 0);
}

}  // namespace
}  // namespace lightmill

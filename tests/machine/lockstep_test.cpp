#include "machine/lockstep.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "machine/program_lines.h"
#include "machine/streamer.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using testing::HasSubstr;

/// Three axes, no tool change, so that grbl takes it too; `feed_mm_per_min` and `chord_mm` say how fast lines are eaten.
std::string slope(long lines, double feed_mm_per_min, double chord_mm) {
  std::string text = "G21 G90 G94\nS20000 M3\nG4 P1\nG0 Z50\nG0 X0 Y0\nG1 F" + compact(feed_mm_per_min, 0) + "\n";
  for (long i = 1; i <= lines; ++i) {
    text += "X" + fixed(static_cast<double>(i % 400) * chord_mm, 4) + "Y" + fixed(static_cast<double>(i) * 1e-4, 4) +
            "Z" + fixed(50 - 0.001 * static_cast<double>(i % 7), 4) + "\n";
  }
  return text + "M5\nM2\n";
}

SimulationOptions in_time(Personality personality = Personality::kGrblHal) {
  SimulationOptions options = test::no_stock();
  options.personality = personality;
  options.time_factor = 1;
  return options;
}

/// Everything that two runs could differ in.
std::string trace(const LineOptions& line) {
  std::string record;
  test::Lockstep rig(in_time(), line);
  StreamOptions options;
  options.on_traffic = [&](const std::string& text) { record += std::to_string(rig.clock.now().count()) + " " + text + "\n"; };
  const StreamResult result = stream_program(rig.link, slope(500, 3000, 0.1), options);
  const SimulationResult machine = rig.machine.result();
  return record + result.message + compact(result.seconds, 9) + machine.received_digest +
         compact(machine.machine_seconds, 9) + std::to_string(rig.clock.now().count());
}

TEST(Lockstep, IsTheSameToTheByteRunAfterRun) {
  const LineOptions sound{.baud = 115200, .faults = {}};
  LineOptions disturbed = sound;
  disturbed.faults.push_back({.kind = LineFault::Kind::kLateOk, .to_machine = false, .at = 100, .seconds = 0.7});
  disturbed.faults.push_back({.kind = LineFault::Kind::kDropOk, .to_machine = false, .at = 300});
  const std::string first = trace(sound), worse = trace(disturbed);
  EXPECT_EQ(first, trace(sound));
  EXPECT_EQ(worse, trace(disturbed));
  EXPECT_NE(first, worse);
}

TEST(Lockstep, TimeOutsRunOnTheVirtualClock) {
  test::Lockstep rig(in_time());
  char byte = 0;
  const ClockTime before = rig.clock.now();
  rig.link.read_some({&byte, 1}, milliseconds(0));  // the banner is there
  std::array<char, 256> rest;
  rig.link.read_some(rest, milliseconds(0));
  EXPECT_EQ(rig.link.read_some(rest, milliseconds(3'600'000)), 0U) << "an hour of silence";
  EXPECT_EQ(rig.clock.now() - before, std::chrono::hours(1));
}

TEST(Lockstep, APulledPlugIsAnIoErrorAndTheMachineWorksOn) {
  test::Lockstep rig(in_time(), {.baud = 0, .faults = {{.kind = LineFault::Kind::kHangUp, .to_machine = true, .at = 30}}});
  EXPECT_EQ(rig.link.write_some(std::string("G21\nG1 X1 F60\nG1 X2\nG1 X3\n"), milliseconds(0)), 26U);
  EXPECT_EQ(rig.link.write_some(std::string("G1 X4\nG1 X5\n"), milliseconds(0)), 12U);
  std::array<char, 256> replies;
  EXPECT_GT(rig.link.read_some(replies, milliseconds(0)), 0U) << "what has arrived is still read";
  EXPECT_THROW(rig.link.read_some(replies, milliseconds(100)), IoError);
  rig.link.run_for(std::chrono::minutes(1));
  EXPECT_NEAR(rig.machine.result().joints.x_mm, 13, 1e-9) << "what it had buffered";
  // The cable put in again.
  LockstepLink again(rig.machine, rig.clock);
  again.write_some(std::string("?"), milliseconds(0));
  EXPECT_GT(again.read_some(replies, milliseconds(100)), 0U);
}

// The machine keeps up, so the wire is what limits: it is to be full.
TEST(Lockstep, TheWireIsUsedFully) {
  struct Case {
    Personality personality;
    int baud, buffer;
  };
  for (const Case& c : {Case{Personality::kGrbl, 115200, 128}, Case{Personality::kGrblHal, 115200, 1024},
                        Case{Personality::kGrblHal, 1000000, 1024}}) {
    SimulationOptions simulation = test::no_stock();
    simulation.personality = c.personality;
    test::Lockstep rig(simulation, {.baud = c.baud, .faults = {}});
    const std::string program = slope(4000, 3000, 0.1);
    const StreamResult result = stream_program(rig.link, program);
    ASSERT_TRUE(result.done()) << result.message;
    EXPECT_EQ(result.receive_buffer_bytes, c.buffer);
    EXPECT_EQ(rig.machine.result().received_digest, program_digest(program));
    EXPECT_EQ(rig.machine.result().overflowed_bytes, 0);
    const double use = static_cast<double>(result.bytes_sent) * 10 / c.baud / result.streaming_seconds;
    EXPECT_GT(use, 0.95) << c.baud << " baud, buffer " << c.buffer;
    EXPECT_LE(use, 1);
    RecordProperty("link_use_percent_" + std::to_string(c.baud) + "_" + std::to_string(c.buffer),
                   fixed(100 * use, 2));
  }
}

// A feed hold never waits behind more than 128 bytes of lines.
TEST(Lockstep, AHoldIsOnTheWireWithin20Milliseconds) {
  std::mt19937 random(3);
  for (int i = 0; i < 100; ++i) {
    test::Lockstep rig(in_time(), {.baud = 115200, .faults = {}});
    const ClockTime press = std::chrono::microseconds(700'000 + static_cast<long>(random() % 1'000'000));
    Monitor monitor;
    ClockTime pressed{0};
    monitor.should_stop = [&] {
      if (rig.clock.now() < press || pressed.count() > 0) return pressed.count() > 0;
      pressed = rig.clock.now();
      return true;
    };
    const StreamResult result = stream_program(rig.link, slope(3000, 3000, 0.1), {}, monitor);
    ASSERT_EQ(result.end, StreamEnd::kStopped) << result.message;
    ASSERT_GT(pressed.count(), 0);
    // The hold is the last byte put on the line.
    while (rig.link.queued() > 0) rig.link.run_for(milliseconds(1));
    EXPECT_LE(rig.clock.now() - pressed, milliseconds(20));
  }
}

// --- Starvation ---

TEST(Starvation, AFastWireStarvesNothing) {
  test::Lockstep rig(in_time(), {.baud = 115200, .faults = {}});
  const StreamResult result = stream_program(rig.link, slope(1500, 1200, 0.1));  // 200 lines a second of 25 bytes
  EXPECT_TRUE(result.done()) << result.message;
  EXPECT_EQ(rig.machine.result().starvations, 0);
  EXPECT_EQ(result.starved_reports, 0);
  EXPECT_TRUE(rig.machine.result().faults.size() == 1) << "no tool in the spindle, and nothing else";
}

TEST(Starvation, ASlowWireIsCountedAndPlaced) {
  test::Lockstep rig(in_time(), {.baud = 9600, .faults = {}});
  const long lines = 400;
  const StreamResult result = stream_program(rig.link, slope(lines, 3000, 0.1));  // 500 lines a second; 38 arrive
  EXPECT_TRUE(result.done()) << result.message;
  const SimulationResult machine = rig.machine.result();
  EXPECT_GT(machine.starvations, lines * 3 / 4);
  // Conservation: the time in all is that of the motions and that of the standstills.
  EXPECT_NEAR(machine.starved_seconds + machine.machine_seconds - 1, result.streaming_seconds - 1, 1.5);
  ASSERT_FALSE(machine.worst_starvations.empty());
  const Starvation& worst = machine.worst_starvations.front();
  EXPECT_GT(worst.line, 5);
  EXPECT_LT(worst.line, 6 + lines);
  EXPECT_NEAR(worst.seconds, 0.025, 0.02) << "a line of 25 bytes takes 26 ms";
  EXPECT_EQ(machine.faults.back().kind, "starved");
  EXPECT_THAT(machine.faults.back().message, HasSubstr(std::to_string(machine.starvations) + " times"));
  EXPECT_GT(result.starved_reports, 3);
  EXPECT_GT(result.first_starved_line, 5);
  EXPECT_THAT(result.message, HasSubstr("too slow for the program"));
}

TEST(Starvation, OnePauseOfTheWireIsOneMark) {
  test::Lockstep rig(in_time(), {.baud = 115200, .faults = {{.kind = LineFault::Kind::kLateOk, .to_machine = false, .at = 300, .seconds = 2}}});
  const std::string program = slope(1500, 1200, 0.1);
  const StreamResult result = stream_program(rig.link, program);
  EXPECT_TRUE(result.done()) << result.message;
  const SimulationResult machine = rig.machine.result();
  ASSERT_EQ(machine.starvations, 1);
  const Starvation& mark = machine.worst_starvations.front();
  // The lines under way and those in the planner were still milled; the tip is where that line ends.
  EXPECT_GT(mark.line, 300);
  const auto lines = program_lines(program);  // views of it
  EXPECT_THAT(std::string(lines[static_cast<std::size_t>(mark.line - 1)].text),
              HasSubstr("X" + fixed(mark.place_mm.x() + 0.0, 4) + "Y"));
  EXPECT_GT(mark.seconds, 0.5);
  EXPECT_LT(mark.seconds, 2);
}

TEST(Starvation, TheMarkIsAsDeepAsSaidWhereTheCutterStood) {
  // A level groove; once with a pause of the wire, once without.
  const auto milled = [](double mark_mm, bool late, SimulationResult& result) {
    SimulationOptions options = in_time();
    options.remove_stock = true;
    options.stock.pitch_mm = 0.1;
    options.starvation_mark_mm = mark_mm;
    std::vector<LineFault> faults;
    if (late) faults.push_back({.kind = LineFault::Kind::kLateOk, .to_machine = false, .at = 150, .seconds = 2});
    test::Lockstep rig(options, {.baud = 115200, .faults = faults});
    std::string program = "G21 G90 G54\nT1 M6\nG43.1 Z80\nS20000 M3\nG4 P9\nG0 X-18 Y0\nG0 Z20\nG1 Z11 F3000\n";
    for (int k = 1; k <= 360; ++k) program += "G1 X" + fixed(-18 + 0.1 * k, 2) + " F1200\n";
    StreamOptions stream;
    stream.on_operator = [](const std::string&) { return true; };
    const StreamResult streamed = stream_program(rig.link, program + "G0 Z20\nM5\nM2\n", stream);
    EXPECT_TRUE(streamed.done()) << streamed.message;
    result = rig.machine.result();
    return rig.machine.machined();
  };
  SimulationResult ended;
  const MachinedSurface smooth = milled(0.005, false, ended);
  EXPECT_EQ(ended.starvations, 0);
  const MachinedSurface marked = milled(0.005, true, ended);
  ASSERT_EQ(ended.starvations, 1);
  EXPECT_EQ(ended.faults.back().amount_mm, 0.005);
  double deepest = 0;
  Vec2 place = Vec2::Zero();
  for (int j = 0; j < smooth.heights_mm.height; ++j) {
    for (int i = 0; i < smooth.heights_mm.width; ++i) {
      const double depth = smooth.heights_mm.at(i, j) - marked.heights_mm.at(i, j);
      EXPECT_GE(depth, 0);
      if (depth <= deepest) continue;
      deepest = depth;
      place = marked.extent.min + marked.pitch_mm * Vec2(i, j);
    }
  }
  EXPECT_NEAR(deepest, 0.005, 1e-6);
  EXPECT_NEAR(place.x(), ended.worst_starvations.front().place_mm.x(), 0.1) << "as deep all across the groove";
  EXPECT_EQ(milled(0, true, ended).heights_mm.values, smooth.heights_mm.values);
}

TEST(Starvation, StopsThatTheProgramWantsAreNone) {
  test::Lockstep rig(in_time(), {.baud = 1200, .faults = {}});
  const StreamResult result =
      stream_program(rig.link, "G21 G90\nS20000 M3\nG4 P2\nG1 X5 F6000\nM5\nG0 X0\nM3\nG4 P1\nG1 X5\nG4 P1\nG0 X0\nM2\n");
  EXPECT_TRUE(result.done()) << result.message;
  EXPECT_EQ(rig.machine.result().starvations, 0);
}

}  // namespace
}  // namespace lightmill

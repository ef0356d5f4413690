#include "machine/drip_feed.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <random>

#include "design/core/errors.h"
#include "machine/program_lines.h"
#include "machine/restart.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

using std::chrono::milliseconds;
using testing::HasSubstr;

SimulationOptions drip(double block_s) {
  SimulationOptions options = test::no_stock();
  options.personality = Personality::kDripFeed;
  options.drip_block_s = block_s;
  return options;
}

std::string tape(long blocks, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::string text = "%\nO1000 (LENS)\nG21 G90\n";
  for (long i = 0; i < blocks; ++i) {
    text += "X" + std::to_string(random() % 100) + ".25Y-" + std::string(1 + random() % 5, '3') + ".5\n";
  }
  return text + "M30\n%\n";
}

// Any buffer, any speed of line and control: the tape arrives once, the buffer is never over.
RC_GTEST_PROP(DripFeed, NeverOverflowsAndLosesNothing, (unsigned seed)) {
  std::mt19937 random(seed);
  MachineModel model = test::skew_machine();
  model.receive_buffer_bytes = 200 + static_cast<int>(random() % 2000);
  LineOptions line;
  line.baud = std::array{1200, 9600, 38400, 115200}[random() % 4];
  test::Lockstep rig(drip(1e-4 * static_cast<double>(random() % 100)), line, model);
  const std::string program = tape(static_cast<long>(random() % 200), seed);
  DripOptions options;
  options.leader_nulls = static_cast<int>(random() % 60);
  const StreamResult result = drip_feed(rig.link, program, options);
  rig.link.run_for(std::chrono::minutes(1));
  const SimulationResult machine = rig.machine.result();
  RC_ASSERT(result.done());
  RC_ASSERT(machine.overflowed_bytes == 0);
  RC_ASSERT(machine.received_program == program);
  RC_ASSERT(machine.received_digest == program_digest(program));
  RC_ASSERT(!machine.alarm);
}

// A block may be longer than the buffer, which empties while it comes; one without end stops the control.
TEST(DripFeed, BlocksLongerThanTheBuffer) {
  MachineModel model = test::skew_machine();
  model.receive_buffer_bytes = 100;
  test::Lockstep rig(drip(0.01), {.baud = 9600, .faults = {}}, model);
  const std::string program = "%\n(" + std::string(500, 'x') + ")\nG21\nM30\n%\n";
  EXPECT_TRUE(drip_feed(rig.link, program).done());
  rig.link.run_for(milliseconds(1000));
  EXPECT_EQ(rig.machine.result().received_program, program);
  EXPECT_EQ(rig.machine.result().overflowed_bytes, 0);

  test::Lockstep other(drip(0.01), {}, model);
  DripOptions options;
  options.stuck_after = milliseconds(1000);
  EXPECT_FALSE(drip_feed(other.link, "%\n" + std::string(10000, 'X') + "\nM30\n%\n", options).done());
  EXPECT_EQ(other.machine.result().faults.at(0).kind, "alarm");
}

TEST(DripFeed, IsHeldByASlowControl) {
  test::Lockstep rig(drip(0.05), {.baud = 9600, .faults = {}});
  const StreamResult result = drip_feed(rig.link, tape(400));
  EXPECT_TRUE(result.done()) << result.message;
  EXPECT_THAT(result.message, HasSubstr("acknowledges nothing; the control held the sender"));
  EXPECT_GT(result.seconds, 15) << "the control's pace, 20 blocks a second, less what its buffer holds";
}

TEST(DripFeed, ASenderThatDoesNotListenOverflowsTheBuffer) {
  test::Lockstep rig(drip(0.05), {.baud = 9600, .faults = {}});
  rig.link.write_some(tape(400), milliseconds(0));
  rig.link.run_for(std::chrono::minutes(1));
  EXPECT_GT(rig.machine.result().overflowed_bytes, 0);
}

// Whatever the control has got is in the journal, which is ahead by no more than it announces.
TEST(DripFeed, TheJournalKnowsWhatMayHaveBeenSent) {
  const std::filesystem::path path = std::filesystem::path(::testing::TempDir()) / ("drip_journal_" + std::to_string(::getpid()));
  const std::string program = tape(400);
  const auto lines = static_cast<long>(program_lines(program).size());
  for (const double seconds : {0.0, 0.3, 1.7, 4.1}) {
    std::filesystem::remove(path);
    test::Lockstep rig(drip(0.02), {.baud = 9600, .faults = {}});
    Monitor monitor;
    const ClockTime start = rig.link.clock().now();
    monitor.should_stop = [&] { return rig.link.clock().now() - start > std::chrono::duration<double>(seconds); };
    long sent = 0;
    {
      JournalHeader header;
      header.program = "part.nc";
      header.program_digest = program_digest(program);
      header.lines = lines;
      Journal journal(path, header);
      DripOptions options;
      options.journal = &journal;
      sent = drip_feed(rig.link, program, options, monitor).lines_sent;
    }
    const JournalSummary summary = read_journal(path);
    EXPECT_LT(sent, lines);
    EXPECT_GE(summary.sent, sent);
    EXPECT_LE(summary.sent, sent + JournalOptions{}.announce_lines);
    EXPECT_EQ(last_line_of(program, summary.header, summary.sent), std::min(summary.sent, lines));
  }
  std::filesystem::remove(path);
}

TEST(DripFeed, AStuckXoffIsSaid) {
  LineOptions line{.baud = 9600, .faults = {{.kind = LineFault::Kind::kDropXon, .to_machine = false, .at = 2}}};
  {
    test::Lockstep rig(drip(0.02), line);
    const StreamResult result = drip_feed(rig.link, tape(400));
    EXPECT_EQ(result.end, StreamEnd::kStopped);
    EXPECT_THAT(result.message, HasSubstr("taken nothing for 60 s since its XOFF"));
    EXPECT_THAT(result.message, HasSubstr("hold it there"));
    EXPECT_LT(result.lines_sent, 400);
  }
  {
    // The operator knows better for a while.
    test::Lockstep rig(drip(0.02), line);
    DripOptions options;
    int asked = 0;
    options.on_operator = [&](const std::string&) { return ++asked < 4; };
    EXPECT_EQ(drip_feed(rig.link, tape(400), options).end, StreamEnd::kStopped);
    EXPECT_EQ(asked, 4);
    EXPECT_GT(rig.clock.now(), std::chrono::seconds(240));
  }
}

// Seven bits and even parity: a turned bit is seen, and the control stops.
TEST(DripFeed, ParitySeesATurnedBit) {
  LineOptions line{.baud = 9600, .faults = {{.kind = LineFault::Kind::kFlipByte, .at = 1500, .bit = 2}}};
  for (const bool parity : {true, false}) {
    line.even_parity = parity;
    test::Lockstep rig(drip(0.001), line);
    const std::string program = tape(400);
    const StreamResult result = drip_feed(rig.link, program);
    const SimulationResult machine = rig.machine.result();
    EXPECT_EQ(machine.alarm, parity);
    EXPECT_EQ(result.done(), !parity) << "the alarmed control holds the sender";
    EXPECT_NE(machine.received_program, program);
  }
}

TEST(DripFeed, TapeMarksAndTrailerAreAdded) {
  test::Lockstep rig(drip(0), {.baud = 9600, .faults = {}});
  DripOptions options;
  options.trailer = "\x03\x04";
  std::vector<std::string> heard;
  options.on_traffic = [&](const std::string& text) { heard.push_back(text); };
  const StreamResult result = drip_feed(rig.link, "G21\nG0 X1\nM30\n", options);
  EXPECT_TRUE(result.done());
  EXPECT_EQ(rig.machine.result().received_program, "%\nG21\nG0 X1\nM30\n%\n");
  EXPECT_EQ(rig.machine.result().received_bytes, 3 + 5 + 7 + 5 + 3 + 2);
  EXPECT_EQ(heard.front(), "< XON");
  EXPECT_THROW(drip_feed(rig.link, "(\xb5m)\n"), InputError);
}

}  // namespace
}  // namespace lightmill

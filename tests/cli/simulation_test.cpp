#include "cli/simulation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "command_rig.h"

namespace lightmill {
namespace {

using namespace test;
using nlohmann::json;
using testing::HasSubstr;

constexpr int kMoves = 60;

/// Feed moves of 1 mm in 10 ms each, in the air and next to each other: 8 bytes a line.
std::string short_moves() {
  std::string text = "T3 M6\nG91 G94\nS20000 M3\nG1F6000X1.0000\n";
  for (int i = 1; i < kMoves; ++i) text += "X1.0000\n";
  return text + "M5\nM2\n";
}

struct Milled {
  int code = 0;
  std::string result;  ///< its bytes
  json faults;
};

Milled dry_run(const ScratchFolder& scratch, const std::string& program, const std::vector<std::string>& options) {
  spill(scratch / "part.nc", program);
  std::vector<std::string> arguments = {"dry-run", (scratch / "part.nc").string(), "--blank", "12x10x5", "--pitch-um", "200", "-o", (scratch / "out").string()};
  arguments.insert(arguments.end(), options.begin(), options.end());
  const CommandResult run = lightmill_command(arguments);
  return {run.code, slurp(scratch / "out/result.json"), json::parse(slurp(scratch / "out/faults.json"))["faults"]};
}

// A line of 8 bytes takes 8 * 10 / 4800 s = 16.67 ms, its move 10 ms: the cutter stands after every move but the last, 6.67 ms
// each. Status reports are asked for at most four times a second, a byte of 2.1 ms each.
TEST(Simulation, ALineTooSlowStarvesAsReckonedByHand) {
  const ScratchFolder scratch;
  const Milled milled = dry_run(scratch, short_moves(), {"--pace-baud", "4800"});
  EXPECT_EQ(milled.code, 5);
  ASSERT_EQ(milled.faults.size(), 1U) << milled.faults;
  EXPECT_EQ(milled.faults[0]["kind"], "starved");
  const json result = json::parse(milled.result);
  EXPECT_EQ(result["starvations"], kMoves - 1);
  const double line_s = 8 * 10 / 4800.0, byte_s = 10 / 4800.0;
  EXPECT_GE(result["starved_seconds"], (kMoves - 1) * (line_s - 0.010) - 1e-6);
  EXPECT_LE(result["starved_seconds"], (kMoves - 1) * (line_s - 0.010) + 5 * byte_s);
}

TEST(Simulation, ALineFastEnoughStarvesNothing) {
  const ScratchFolder scratch;
  // 8.3 ms a line, and at the machine's own speed.
  for (const char* baud : {"9600", "115200"}) {
    const Milled milled = dry_run(scratch, short_moves(), {"--pace-baud", baud});
    EXPECT_EQ(milled.code, 0) << baud << ": " << milled.faults;
    EXPECT_EQ(json::parse(milled.result)["starvations"], 0) << baud;
  }
}

TEST(Simulation, APacedRunIsTheSameToTheByteHoweverFastTheClockRuns) {
  const ScratchFolder scratch;
  const Milled first = dry_run(scratch, short_moves(), {"--pace-baud", "4800"});
  EXPECT_EQ(dry_run(scratch, short_moves(), {"--pace-baud", "4800"}).result, first.result);
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(dry_run(scratch, short_moves(), {"--pace-baud", "4800", "--time-factor", "20"}).result, first.result);
  // A second of moves and the greeting, twenty times faster than the wall's clock.
  EXPECT_GE(std::chrono::steady_clock::now() - start, std::chrono::milliseconds(50));
}

}  // namespace
}  // namespace lightmill

#include "cli/simulation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <numeric>

#include "cli/job.h"
#include "cli/run_folder.h"
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
  std::string said;
  std::string result;  ///< its bytes
  json faults;
};

Milled dry_run(const ScratchFolder& scratch, const std::string& program, const std::vector<std::string>& options) {
  spill(scratch / "part.nc", program);
  std::vector<std::string> arguments = {"dry-run", (scratch / "part.nc").string(), "--blank", "12x10x5", "--pitch-um", "500", "-o", (scratch / "out").string()};
  arguments.insert(arguments.end(), options.begin(), options.end());
  const CommandResult run = lightmill_command(arguments);
  return {run.code, run.out + run.err, slurp(scratch / "out/result.json"), json::parse(slurp(scratch / "out/faults.json"))["faults"]};
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

// The cutters of a shop floor cut at the data of the job's material, also behind the pseudo-terminal.
TEST(Simulation, ReadsTheCuttersDataForTheJobsMaterial) {
  const ScratchFolder scratch;
  std::string text = "[target]\nimage = \"/a/portrait.png\"\n[stock]\nmaterial = \"PVC, clear\"\n";
  for (const char* pass : {"rough", "semi_finish", "finish"}) {
    spill(scratch / (std::string(pass) + ".toml"), slurp(fixture("cutters/finish_4mm_ball.toml")) +
                                                       "[material.PVC]\nspindle_rpm = 20000\nfeed_per_tooth_mm = 0.017\nplunge_feed_mm_per_min = 100\n");
    text += "[" + std::string(pass) + "]\ncutter = \"" + (scratch / (std::string(pass) + ".toml")).string() + "\"\n";
  }
  const Job job = read_job_text(text, "x.toml", "/a");
  const MachineModel machine = read_machine(job.machine.file);
  RunFolder folder(scratch / "run", true);
  folder.finish(Stage::kCam, "", {}, {{"cam", {{"blank", {{"size_mm", {100, 100}}, {"height_mm", 14}}}}}});
  SimulatedShop shop = shop_of(job, folder);
  for (const Cutter& cutter : setup_of(shop, machine).cutters) {
    EXPECT_EQ(cutter.feed_per_tooth_mm, 0.017);
    EXPECT_EQ(cutter.spindle_rpm, 20000);
  }
  EXPECT_THAT(machine_arguments(shop, "link", "out"), testing::Contains("--material=PVC"));
  shop.material = "";
  EXPECT_NE(setup_of(shop, machine).cutters[0].feed_per_tooth_mm, 0.017) << "the first by name";

  spill(scratch / "part.nc", short_moves());
  const CommandResult refused = lightmill_command({"dry-run", (scratch / "part.nc").string(), "--blank", "12x10x5", "--material", "glass", "-o", (scratch / "out").string()});
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.err, testing::AllOf(HasSubstr("'glass'"), HasSubstr("only for PMMA")));
}

/// Rows of numbers by their heads; the programs' names apart.
struct Table {
  std::vector<std::string> programs;
  std::map<std::string, std::vector<double>> columns;
};

Table line_times(const ScratchFolder& scratch) {
  std::istringstream in(slurp(scratch / "out/line_times.csv"));
  std::string row, cell;
  std::vector<std::string> heads;
  Table table;
  for (bool head = true; std::getline(in, row); head = false) {
    std::istringstream cells(row);
    for (std::size_t i = 0; std::getline(cells, cell, ','); ++i) {
      if (head) heads.push_back(cell);
      else if (i == 0) table.programs.push_back(cell);
      else table.columns[heads.at(i)].push_back(std::stod(cell));
    }
  }
  return table;
}

double sum(const std::vector<double>& values) { return std::accumulate(values.begin(), values.end(), 0.0); }

// The table is the summary, line by line: over the wire and from a file.
TEST(Simulation, LineTimesAddUpToTheTimeInAll) {
  const ScratchFolder scratch;
  const std::string program = "G21 G90 G94\nT3 M6\nS20000 M3\nG4 P9\nG0 X20\nG1 F6000 X40\n(nothing)\nY1\nG1 X41 F60\nM5\nM2\n";
  for (const char* control : {"hsm400u_grblhal", "trunnion_linuxcnc"}) {
    const Milled milled = dry_run(scratch, program, {"--line-times", "--machine", std::string(LIGHTMILL_FIXTURES) + "/machines/" + control + ".toml"});
    EXPECT_EQ(milled.code, 0) << milled.said;
    const Table table = line_times(scratch);
    EXPECT_EQ(table.programs, std::vector<std::string>(4, "part.nc"));
    const auto& at = table.columns;
    EXPECT_EQ(at.at("line"), (std::vector<double>{5, 6, 8, 9}));
    EXPECT_EQ(at.at("rapid"), (std::vector<double>{1, 0, 0, 0}));
    EXPECT_EQ(at.at("stood_s"), (std::vector<double>{9, 0, 0, 0}));
    EXPECT_NEAR(at.at("asked_mm_per_min")[1], 6000, 1e-3);
    EXPECT_LT(at.at("reached_mm_per_min")[1], 6000) << "it starts from rest";
    EXPECT_NEAR(at.at("top_speed_per_s")[1], 100, 1e-3) << "and gets there";
    EXPECT_NEAR(at.at("top_speed_per_s")[3], 1, 0.5);
    const json result = json::parse(milled.result);
    double seconds = 0;
    for (const json& section : result["timing"]) seconds += section["seconds"].get<double>();
    EXPECT_GT(seconds, 9);
    EXPECT_NEAR(sum(at.at("stood_s")) + sum(at.at("seconds")), seconds, 1e-5);
  }
}

TEST(Simulation, AFileThatALimitStopsHasRunTheLinesBefore) {
  const ScratchFolder scratch;
  const Milled milled = dry_run(scratch, "G21 G90 G94\nT3 M6\nS20000 M3\nG4 P9\nG0 X1\nX2\nX3\nX4\nX5\nX9999\nX6\nM2\n",
                                {"--machine", std::string(LIGHTMILL_FIXTURES) + "/machines/trunnion_linuxcnc.toml"});
  EXPECT_EQ(milled.code, 5);
  ASSERT_EQ(milled.faults.size(), 1U) << milled.faults;
  EXPECT_EQ(milled.faults[0]["kind"], "limit");
  EXPECT_EQ(milled.faults[0]["line"], 10);
  EXPECT_THAT(milled.said, HasSubstr("lines: 9,"));
  EXPECT_EQ(json::parse(milled.result)["lines"], 9);
}

}  // namespace
}  // namespace lightmill

#include "machine/restart.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <random>

#include "design/core/text.h"
#include "machine/kinematics.h"
#include "machine/program_lines.h"
#include "machine/streamer.h"
#include "postproc/program.h"
#include "tests/machine/machine_rig.h"
#include "tests/machine/resume_matrix.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

constexpr double kCoarse_mm = 0.25;  // pitch of the stock

using test::Shop;
using test::with_long_flutes;
using test::worst_um;
using test::Written;
using test::written;

Written fixed_axis() {
  return written(test::fixed_rows(25 * test::kDeg, 70 * test::kDeg, 3, 20));
}
Written five_axis() {
  return written(test::lead_rows(20 * test::kDeg, 3, 14));
}

/// What a machine without stock does with a text.
std::vector<Motion> motions(const Shop& shop, const std::string& text, SimulationResult* result = nullptr) {
  SimulatedMachine machine(shop.machine, shop.setup, test::no_stock());
  std::vector<Motion> all;
  machine.on_motion = [&](const Motion& motion, const std::vector<SweptMove>&) { all.push_back(motion); };
  for (const ProgramLine& line : program_lines(text)) {
    machine.receive(std::string(line.text) + "\n");
    machine.work(1);
    machine.receive("~");
  }
  EXPECT_THAT(machine.take_replies(), testing::Not(testing::HasSubstr("error")));
  if (result != nullptr) *result = machine.result();
  return all;
}

StockOptions coarse() {
  StockOptions options;
  options.pitch_mm = kCoarse_mm;
  return options;
}

MachinedSurface milled(const Shop& shop, const std::string& text) {
  SimulationOptions options;
  options.stock = coarse();
  SimulatedMachine machine(shop.machine, shop.setup, options);
  for (const ProgramLine& line : program_lines(text)) {
    machine.receive(std::string(line.text) + "\n");
    machine.work(1);
    machine.receive("~");
  }
  EXPECT_TRUE(machine.result().faults.empty());
  return machine.machined();
}

// Lines that were cut, a reset, the restart: the surface is that of the undisturbed program.
double apart(const JointPosition& a, const JointPosition& b) {
  return std::max({std::abs(a.x_mm - b.x_mm), std::abs(a.y_mm - b.y_mm), std::abs(a.z_mm - b.z_mm),
                   std::abs(a.outer_rad - b.outer_rad), std::abs(a.inner_rad - b.inner_rad)});
}

/// The laws of every restart: what comes before the tail is safe, and the tail is the original's.
void expect_lawful(const Written& w, long line, const RestartOptions& options = {}) {
  SCOPED_TRACE("restart at line " + std::to_string(line));
  const Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, line, options);
  EXPECT_LE(restart.first_line, line);
  if (restart.entry_lines == 0) {
    EXPECT_EQ(restart.text, w.text);
    return;
  }
  const std::vector<Motion> original = motions(w.shop, w.text);
  SimulationResult result;
  const std::vector<Motion> heard = motions(w.shop, restart.text, &result);
  EXPECT_TRUE(result.faults.empty()) << result.faults.front().message;

  // Line numbers of the machine count lines that are not blank.
  const auto lines = program_lines(w.text);
  const long first = 1 + std::count_if(lines.begin(), lines.end(),
                                       [&](const ProgramLine& l) { return l.number < restart.first_line; });
  std::vector<Motion> tail, rest;
  for (const Motion& m : original) {
    if (m.line >= first) tail.push_back(m);
  }
  for (const Motion& m : heard) {
    if (m.line > restart.entry_lines) rest.push_back(m);
  }
  ASSERT_EQ(rest.size(), tail.size());
  for (std::size_t i = 0; i < tail.size(); ++i) {
    ASSERT_LT(apart(rest[i].to, tail[i].to), 1e-6) << i;
    ASSERT_LT(apart(rest[i].from, tail[i].from), 1e-6) << i;
    ASSERT_EQ(rest[i].rapid, tail[i].rapid) << i;
    ASSERT_NEAR(rest[i].seconds, tail[i].seconds, 1e-5 * std::max(1.0, tail[i].seconds)) << i;
    ASSERT_EQ(rest[i].spindle_on, tail[i].spindle_on) << i;
    ASSERT_EQ(rest[i].spindle_rpm, tail[i].spindle_rpm) << i;
    ASSERT_EQ(rest[i].tool, tail[i].tool) << i;
  }

  WorkpieceView view(w.shop.machine, w.shop.setup.workpiece_origin_mm);
  const double top = w.shop.machine.retract_z_mm;
  int feeds = 0;
  for (const Motion& m : heard) {
    if (m.line > restart.entry_lines) break;
    const bool turns = m.from.outer_rad != m.to.outer_rad || m.from.inner_rad != m.to.inner_rad;
    const bool crosses = m.from.x_mm != m.to.x_mm || m.from.y_mm != m.to.y_mm;
    if (turns || (crosses && m.rapid)) {
      EXPECT_EQ(m.from.z_mm, top);
      EXPECT_EQ(m.to.z_mm, top);
    }
    if (m.rapid) continue;
    ++feeds;
    EXPECT_TRUE(m.spindle_on);
    EXPECT_FALSE(turns);
    const ToolPose from = view.cutter(m.from, restart.tool_length_mm), to = view.cutter(m.to, restart.tool_length_mm);
    const Vec3 way = to.tip_mm - from.tip_mm;
    EXPECT_LT(way.cross(to.axis).norm(), 1e-5) << "along the tool's axis";
    EXPECT_LE(way.dot(to.axis), 0) << "down";
    EXPECT_NEAR(m.seconds, way.norm() / options.entry_feed_mm_per_s, 1e-3);
  }
  EXPECT_LE(feeds, 1);
}

TEST(Restart, TailOfA3Plus2ProgramFromEveryLine) {
  const Written w = fixed_axis();
  const long last = program_lines(w.text).back().number;
  for (long line = 1; line <= last; ++line) expect_lawful(w, line);
}

TEST(Restart, TailOfAFiveAxisProgramFromEveryLine) {
  const Written w = five_axis();
  EXPECT_NE(w.text.find("G93"), std::string::npos);
  const long last = program_lines(w.text).back().number;
  for (long line = 1; line <= last; line += line < 40 || line > last - 10 ? 1 : 17) expect_lawful(w, line);
}

TEST(Restart, RandomProgramsFromRandomLines) {
  const unsigned seed = 20240611;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random(seed);
  const auto real = [&](double least, double most) { return std::uniform_real_distribution(least, most)(random); };
  for (int i = 0; i < 12; ++i) {
    const bool turning = i % 2 == 0;
    const Written w = written(turning ? test::lead_rows(real(5, 30) * test::kDeg, 2, 5 + i)
                                      : test::fixed_rows(real(0, 40) * test::kDeg, real(-3, 3), 2, 5 + i, real(5, 34)),
                              test::hostile_machine());
    RestartOptions options;
    options.overlap_mm = real(0, 20);
    const long last = program_lines(w.text).back().number;
    for (int j = 0; j < 4; ++j) expect_lawful(w, std::uniform_int_distribution<long>(1, last)(random), options);
  }
}

// The head carries an axis: its X and Y are not the tip's.
TEST(Restart, OnAMachineWhoseHeadTilts) {
  MachineModel machine =
      read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/head_table_siemens840d.toml");
  machine.max_spindle_rpm = 36000;
  const Written w = written(test::lead_rows(20 * test::kDeg, 2, 6), machine);
  const long last = program_lines(w.text).back().number;
  RestartOptions from_the_top;
  from_the_top.back_out_mm = 0;
  for (long line = 1; line <= last; line += 17) expect_lawful(w, line, from_the_top);
}

// Its way up would cut: it backs out along the tool's axis first.
TEST(Restart, OnATiltingHeadItBacksOutFirst) {
  MachineModel machine =
      read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/head_table_siemens840d.toml");
  machine.max_spindle_rpm = 36000;
  const Written w = written(test::lead_rows(20 * test::kDeg, 2, 6), machine);
  const long line = program_lines(w.text)[program_lines(w.text).size() / 2].number;
  const Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, line);
  EXPECT_EQ(restart.backs_out_mm, 20);
  EXPECT_NE(restart.text.find("G91 G1 X"), std::string::npos);
  const RestartTrial trial = try_restart(w.shop.machine, w.shop.setup, coarse(), {}, w.text, restart);
  EXPECT_TRUE(trial.faults.empty()) << trial.faults.front().message;
  EXPECT_LT(worst_um(milled(w.shop, w.text), trial.surface), 0.05);
}

// Modes that our own post never mixes.
TEST(Restart, EveryModalStateIsRestored) {
  Written w = fixed_axis();
  w.text =
      "%\n(all sorts)\nG21 G90 G94 G17 G55\nG53 G0 Z0\n\nT3 M6\nG43.1 Z85\nS20000 M3\nG4 P9\nM7\nG53 G0 Z0\n"
      "G0 B10 C20\nG0 X1 Y2\nG0 Z30\nG1 Z20 F500\nX2\nG91\nX0.5 Y0.25\nG18 G2 X2 Z0 I1 K0\nX2 I1\nX1 Z-1 I1 K0\n"
      "M8\nX1 I0.5\nG90 G17\nG93 G1 X3 F20\nX4 B11 F30\nG94 F600\nG20\nX0.2 F30\nY0.3\nG21 S21000\nX5 F700\n"
      "G91 G20\nG93 Y0.01 F50\nC1 F20\nG94 G90 G21 G1 F100 Y8\nG0 Z25\nM9\nG1 Z20\nX3\nM5\nG53 G0 Z0\nM30\n%\n";
  const long last = program_lines(w.text).back().number;
  for (const double overlap : {0.0, 2.0, 100.0}) {
    RestartOptions options;
    options.overlap_mm = overlap;
    for (long line = 1; line <= last - 2; ++line) expect_lawful(w, line, options);
  }
}

TEST(Restart, GoesBackByTheOverlapAndNoFartherThanTheCut) {
  const Written w = fixed_axis();
  const auto lines = program_lines(w.text);
  RestartOptions options;
  options.overlap_mm = 4;
  int whole = 0;
  for (const ProgramLine& line : lines) {
    const Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, line.number, options);
    if (restart.entry_lines == 0) continue;
    // Points are 1.5 mm apart on a wavy way.
    EXPECT_LT(restart.overlap_mm, 4 + 1.7 + 20);
    if (restart.overlap_mm >= 4) ++whole;
    for (const ProgramLine& over : lines) {
      if (over.number >= restart.first_line && over.number < line.number) {
        EXPECT_EQ(over.text.find("G0"), std::string::npos) << "a rapid is never gone over again";
      }
    }
  }
  EXPECT_GT(whole, 30);
}

TEST(Restart, RefusesWhatItCannotDo) {
  const Written w = fixed_axis();
  const auto restart = [&](const std::string& text, long line) {
    return write_restart(w.shop.machine, w.shop.setup, text, line);
  };
  EXPECT_THROW(restart(w.text, 0), InputError);
  EXPECT_THROW(restart(w.text, 100000), InputError);
  EXPECT_THROW(restart("", 1), InputError);
  std::string broken = w.text;
  broken.replace(broken.rfind("G1"), 2, "Q7");
  try {
    restart(broken, program_lines(broken).back().number);
    ADD_FAILURE() << "a line that no control takes";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("Q7"));
  }
  MachineModel low = w.shop.machine;
  low.x.max_mm = -100;
  EXPECT_THROW(write_restart(low, w.shop.setup, w.text, 40), InputError) << "outside the travels";
}

TEST(Restart, LeavesNoMark) {
  for (const Written& w : {fixed_axis(), five_axis()}) {
    const MachinedSurface undisturbed = milled(w.shop, w.text);
    const long last = program_lines(w.text).back().number;
    for (int i = 1; i <= 4; ++i) {
      const long line = 30 + i * (last - 40) / 4;
      RestartOptions options;
      options.overlap_mm = 2.0 * i - 2;
      const Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, line, options);
      const RestartTrial trial = try_restart(w.shop.machine, w.shop.setup, coarse(), {}, w.text, restart);
      EXPECT_TRUE(trial.faults.empty()) << trial.faults.front().message;
      EXPECT_GT(trial.seconds, 8) << "the spindle's start alone";
      EXPECT_LT(worst_um(undisturbed, trial.surface), 0.05) << "line " << line;
    }
  }
}

// The trial sees what is wrong with a restart that nothing was cut for.
TEST(Restart, TheTrialSeesFaults) {
  const Written w = fixed_axis();
  Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, 60);
  const std::size_t feed_in = restart.text.find("\nG1 ");
  ASSERT_NE(feed_in, std::string::npos);
  restart.text[feed_in + 2] = '0';  // in a rapid to the place
  restart.uncut_line = 1;
  const RestartTrial trial = try_restart(w.shop.machine, w.shop.setup, coarse(), {}, w.text, restart);
  ASSERT_FALSE(trial.faults.empty());
  EXPECT_EQ(trial.faults.front().kind, "rapid_in_stock");
}

TEST(Restart, PathNearShowsTheWayThere) {
  const Written w = fixed_axis();
  const Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, 60);
  const auto pieces = path_near(w.shop.machine, w.shop.setup, w.text, restart.place.tip_mm, 3);
  ASSERT_FALSE(pieces.empty());
  EXPECT_TRUE(std::any_of(pieces.begin(), pieces.end(), [&](const PathPiece& p) {
    return p.line == restart.first_line && (p.from - restart.place.tip_mm).norm() < 1e-6;
  }));
  for (const PathPiece& p : pieces) EXPECT_LT((p.from - restart.place.tip_mm).norm(), 40);
}

// ---------------------------------------------------------------------------------------------------------------------

// A planner played by hand: lines go in one by one, those that move take a block (very short ones may not), blocks are
// carried out in order, spindle and dwell wait until all are. The place found is never behind the truth, and not far
// before it.
TEST(FindPlace, IsNeverTooLate) {
  const Written base = fixed_axis();
  const unsigned seed = 77;
  std::mt19937 random(seed);
  const auto chance = [&](double p) { return std::bernoulli_distribution(p)(random); };
  for (int trial = 0; trial < 60; ++trial) {
    SCOPED_TRACE("seed " + std::to_string(seed) + " trial " + std::to_string(trial));
    MachineModel machine = base.shop.machine;
    machine.planner_blocks = 15;
    std::string text = "G21 G90 G94 G55\nT3 M6\nS20000 M3\nG1 X0 Y0 Z10 F500\n";
    std::vector<int> kind{3, 3, 3, 1};  // 0: no move, 1: a block, 2: perhaps a block, 3: waits
    double x = 0;
    for (int i = 0; i < 120; ++i) {
      if (chance(0.02)) {
        text += "G4 P0.1\n";
        kind.push_back(3);
      } else if (chance(0.1)) {
        text += "(nothing)\n";
        kind.push_back(0);
      } else if (chance(0.1)) {
        x += 0.001;
        text += "X" + std::to_string(x) + "\n";
        kind.push_back(2);
      } else {
        x += 0.5;
        text += "X" + std::to_string(x) + "\n";
        kind.push_back(1);
      }
    }
    text += "M2\n";
    kind.push_back(3);
    JournalSummary journal;
    journal.header.program_digest = program_digest(text);
    journal.header.lines = static_cast<long>(kind.size());
    journal.header.planner_blocks = machine.planner_blocks;
    std::deque<long> blocks;
    const long stop = std::uniform_int_distribution<long>(1, static_cast<long>(kind.size()) - 1)(random);
    long acknowledged = 0;
    while (acknowledged < stop) {
      const int next = kind[static_cast<std::size_t>(acknowledged)];
      if (next == 3) blocks.clear();
      if (next == 1 || (next == 2 && chance(0.5))) {
        if (static_cast<int>(blocks.size()) == machine.planner_blocks) blocks.pop_front();
        blocks.push_back(acknowledged);
      }
      ++acknowledged;
      while (!blocks.empty() && chance(0.45)) blocks.pop_front();
      if (chance(0.1)) {
        journal.acknowledged_at_report = acknowledged;
        journal.report = "<Run|MPos:" + std::to_string(x) + ",0.000,0.000,0.000,0.000,0.000|Bf:" +
                         std::to_string(machine.planner_blocks - static_cast<int>(blocks.size())) + ",100|FS:0,0>";
      }
    }
    // What the sender has heard of it may be less.
    journal.acknowledged =
        std::max(journal.acknowledged_at_report, acknowledged - std::uniform_int_distribution<long>(0, 3)(random));
    journal.sent = std::min(acknowledged + 5, journal.header.lines);
    const StreamPlace place = find_place(machine, base.shop.setup, text, journal);
    const long truth = blocks.empty() ? acknowledged : blocks.front();  // lines before are carried out
    EXPECT_LE(place.executed_line, truth);
    EXPECT_EQ(place.uncut_line, place.executed_line + 1);
    EXPECT_EQ(place.acknowledged_line, journal.acknowledged);
    EXPECT_GE(place.sent_line, acknowledged);
    long moving = 0;
    for (long i = place.executed_line; i < journal.acknowledged; ++i)
      moving += kind[static_cast<std::size_t>(i)] == 1 ? 1 : 0;
    EXPECT_LE(moving, machine.planner_blocks + 11) << "not needlessly early";
  }
}

JournalSummary journal_of(const Written& w, long acknowledged) {
  JournalSummary journal;
  journal.header.program = "part.nc";
  journal.header.program_digest = program_digest(w.text);
  journal.header.lines = static_cast<long>(program_lines(w.text).size());
  journal.header.planner_blocks = 100;
  journal.acknowledged = acknowledged;
  journal.sent = std::min(acknowledged + 64, journal.header.lines);
  return journal;
}

TEST(FindPlace, ReadsReportsAndEnds) {
  const Written w = five_axis();
  const auto find = [&](const JournalSummary& j) { return find_place(w.shop.machine, w.shop.setup, w.text, j); };
  const auto lines = program_lines(w.text);
  const auto last = static_cast<long>(lines.size());

  JournalSummary journal = journal_of(w, 60);
  StreamPlace place = find(journal);
  EXPECT_EQ(place.acknowledged_line, lines[59].number);
  EXPECT_LT(place.executed_line, lines[59].number) << "acknowledged is not milled";
  EXPECT_FALSE(place.reported);

  // Standing on the way of a line that is acknowledged.
  const std::vector<Motion> all = motions(w.shop, w.text);
  const auto at = std::find_if(all.begin(), all.end(), [](const Motion& m) { return m.line == 55; });
  ASSERT_NE(at, all.end());
  const auto middle = [](double a, double b) { return compact((a + b) / 2, 3); };
  const std::string deg = middle(at->from.outer_rad / test::kDeg, at->to.outer_rad / test::kDeg) + "," +
                          middle(at->from.inner_rad / test::kDeg, at->to.inner_rad / test::kDeg);
  journal.report = "<Run|MPos:" + middle(at->from.x_mm, at->to.x_mm) + "," + middle(at->from.y_mm, at->to.y_mm) + "," +
                   middle(at->from.z_mm, at->to.z_mm) + ",0.000," + deg + "|Bf:94,900|FS:0,0>";
  journal.acknowledged_at_report = 60;
  place = find(journal);
  EXPECT_EQ(place.reported_line, lines[54].number);
  EXPECT_EQ(place.executed_line, lines[59 - 16].number) << "six blocks and what is prepared";

  journal.report = "<Idle|MPos:0.000,0.000,0.000,0.000,0.000,0.000|Bf:100,1023|FS:0,0>";
  EXPECT_EQ(find(journal).executed_line, lines[59].number);

  // An acknowledgement too few: only what was audited counts.
  journal.end = "lost acknowledgement";
  journal.audited = 20;
  EXPECT_EQ(find(journal).executed_line, lines[19].number);

  journal = journal_of(w, last);
  journal.end = "done";
  EXPECT_EQ(find(journal).uncut_line, 0) << "nothing is left";

  journal.header.program_digest = "of another text";
  EXPECT_THROW(find(journal), InputError);
}

// The journal of a restart speaks of lines of the restart; the place is one of the program.
TEST(FindPlace, OfARestartOfARestart) {
  const Written w = five_axis();
  const auto lines = program_lines(w.text);
  const Restart restart = write_restart(w.shop.machine, w.shop.setup, w.text, lines[60].number);
  ASSERT_GT(restart.entry_lines, 0);
  JournalSummary journal = journal_of(w, 0);
  journal.header.lines = static_cast<long>(program_lines(restart.text).size());
  journal.header.entry_lines = restart.entry_lines;
  journal.header.first_line = restart.first_line;
  journal.header.uncut_line = restart.uncut_line;
  const std::string idle = "<Idle|MPos:0.000,0.000,0.000,0.000,0.000,0.000|Bf:100,1023|FS:0,0>";
  for (long acknowledged = 0; acknowledged <= journal.header.lines; acknowledged += acknowledged < 40 ? 1 : 29) {
    journal.acknowledged = journal.acknowledged_at_report = acknowledged;
    journal.report = idle;
    const StreamPlace place = find_place(w.shop.machine, w.shop.setup, w.text, journal);
    const long into = restart.first_line + acknowledged - restart.entry_lines;  // no blank lines in there
    const long expected = std::max(restart.uncut_line, into);
    EXPECT_EQ(place.uncut_line, expected > lines.back().number ? 0 : expected) << acknowledged;
  }
}

// At every kind of end: the place from the journal is true, and the surface that of the undisturbed program.
TEST(ResumeMatrix, EveryFaultAtAFewPlaces) {
  const test::ResumeCase program = test::resume_case();
  for (const test::ResumeFault& fault : test::resume_faults()) {
    const test::ResumeRow row = test::resume_row(program, fault, 2, 4711);
    for (const std::string& broken : row.broken) ADD_FAILURE() << broken;
    EXPECT_GE(row.resumed + row.went_on, row.places) << fault.name;
  }
}

}  // namespace
}  // namespace lightmill

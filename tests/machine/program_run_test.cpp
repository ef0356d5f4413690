#include "machine/program_run.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "postproc/program_check.h"
#include "tests/postproc/programs.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

struct Shop {
  MachineModel machine;
  OperatorSetup setup;
  StockOptions stock;
  WorkSetup work;
};

Shop shop_for(const std::string& controller) {
  Shop shop;
  shop.machine = test::hostile_machine();
  shop.machine.controller = controller;
  shop.machine.has_tcp = controller != "grblhal";
  shop.work = work_on_table(shop.machine, {23, -17, 30}, 54);
  shop.setup.cutters = {test::ball()};
  shop.setup.blank.size_mm = {36, 36};
  shop.setup.blank.height_mm = 15;
  shop.setup.workpiece_origin_mm = shop.work.origin_mm;
  shop.stock.pitch_mm = 0.25;
  return shop;
}

// Rows over a wavy surface, entered from above; fixed or leaning along the pass.
ToolPath rows(bool turning) {
  return turning ? test::lead_rows(20 * test::kDeg, 3, 6) : test::fixed_rows(15 * test::kDeg, 70 * test::kDeg, 3, 12);
}

ProgramRun run(const Shop& shop, const ToolPath& path, bool tcp, const std::string& find = "",
               const std::string& replace = "") {
  MotionOptions motion;
  motion.tcp = tcp;
  ProgramOptions options;
  options.decimals = 4;
  options.tcp = tcp;
  Program program = write_program(shop.machine, shop.work, plan_motion(shop.machine, shop.work, path, motion), options);
  if (!find.empty()) {
    const std::size_t at = program.text.find(find);
    EXPECT_NE(at, std::string::npos) << find;
    program.text.replace(at, find.size(), replace);
  }
  return run_programs(shop.machine, reader_dialect(shop.machine.controller), shop.setup,
                      {{program.file_name, program.text}}, shop.stock);
}

// Every control that runs files mills the same part, by its own kinematics or by the post's.
TEST(RunPrograms, EveryDialectLeavesTheSameSurface) {
  for (const bool turning : {false, true}) {
    MachinedSurface first;
    for (const char* controller : {"linuxcnc", "fanuc", "siemens", "heidenhain", "heidenhain_iso"}) {
      for (const bool tcp : {false, true}) {
        if (std::string(controller) == "heidenhain_iso" && turning && !tcp) continue;
        const Shop shop = shop_for(controller);
        const ProgramRun result = run(shop, rows(turning), tcp);
        for (const Fault& fault : result.faults) {
          ADD_FAILURE() << controller << " line " << fault.line << ": " << fault.kind << ", " << fault.message;
        }
        EXPECT_GT(result.surface.removed_mm3, 50);
        MotionTiming total;
        for (const SectionTiming& section : result.timing) total.add(section.timing);
        EXPECT_GT(total.seconds, 8) << "the spindle's start alone";
        if (first.heights_mm.empty()) {
          first = result.surface;
          continue;
        }
        ASSERT_EQ(result.surface.heights_mm.values.size(), first.heights_mm.values.size());
        // A tip tolerance of 0.2 um either way and last decimals, seen on slopes.
        const Grid<float>&before = first.heights_mm, &after = result.surface.heights_mm;
        double worst = 0;
        for (int j = 0; j + 1 < before.height; ++j) {
          for (int i = 0; i + 1 < before.width; ++i) {
            const double rise = std::hypot(before.at(i + 1, j) - before.at(i, j), before.at(i, j + 1) - before.at(i, j));
            const double off = std::abs(after.at(i, j) - before.at(i, j));
            worst = std::max(worst, off / (1 + rise / shop.stock.pitch_mm));
          }
        }
        EXPECT_LT(worst, 6e-4) << controller << (tcp ? " tcp" : "") << (turning ? " turning" : " fixed");
      }
    }
  }
}

// Rapids of a control whose axes do not wait for each other: planned as straight ones they would hit the work.
TEST(RunPrograms, DogLegsAreSeenAndPlannedFor) {
  Shop shop = shop_for("fanuc");
  ToolPath path = test::fixed_rows(25 * test::kDeg, 0, 2, 12);
  path.clearance_z_mm = 18;
  for (Move& move : path.moves) {  // low over the part
    if (move.kind == MoveKind::kRapid || (move.kind == MoveKind::kLink && move.pose.tip_mm.z() > 20))
      move.pose.tip_mm.z() = 18;
  }
  const auto kinds = [](const ProgramRun& result) {
    std::string all;
    for (const Fault& fault : result.faults) all += fault.kind + " ";
    return all;
  };
  for (const bool tcp : {false, true}) {
    EXPECT_FALSE(shop.machine.has_straight_rapids());
    EXPECT_EQ(kinds(run(shop, path, tcp)), "");

    MachineModel straight = shop.machine;
    straight.straight_rapids = true;
    ProgramOptions options;
    options.decimals = 4;
    options.tcp = tcp;
    const AxisMotion motion = plan_motion(straight, shop.work, path);
    const Program program = write_program(straight, shop.work, motion, options);
    const auto faults = check_program_text(shop.machine, shop.work, motion, program.text, options);
    ASSERT_FALSE(faults.empty());
    EXPECT_NE(faults.front().find("rapids are not straight"), std::string::npos) << faults.front();
    EXPECT_THROW(write_program(shop.machine, shop.work, motion, options), NumericalError);
    const auto run_on = [&](const MachineModel& machine) {
      return kinds(
          run_programs(machine, ReaderDialect::kFanuc, shop.setup, {{program.file_name, program.text}}, shop.stock));
    };
    EXPECT_EQ(run_on(straight), "");
    EXPECT_NE(run_on(shop.machine).find("rapid_in_stock"), std::string::npos) << run_on(shop.machine);
  }
}

// Where H is a number of its own it can be another tool's than the spindle's: said at the first feed, once, with what is off.
TEST(RunPrograms, TheLengthOfAnotherToolIsAFault) {
  for (const char* controller : {"linuxcnc", "fanuc"}) {
    Shop shop = shop_for(controller);
    const int number = shop.setup.cutters.front().number;
    Cutter other = test::ball();
    other.number = number + 4;
    other.name = "a longer ball";
    other.length_mm += 0.5;
    shop.setup.cutters.push_back(other);
    const std::string right = " H" + std::to_string(number), wrong = " H" + std::to_string(other.number);
    for (const bool length : {true, false}) {
      const std::string tool = "T" + std::to_string(number) + " M6", another = "T" + std::to_string(other.number) + " M6";
      const ProgramRun found = length ? run(shop, rows(false), false, right, wrong) : run(shop, rows(false), false, tool, another);
      std::vector<Fault> faults;
      for (const Fault& fault : found.faults) {
        if (fault.kind == "wrong_tool") faults.push_back(fault);
      }
      ASSERT_EQ(faults.size(), 1U) << controller;
      EXPECT_EQ(faults[0].program.substr(0, 2), "30") << faults[0].program;
      EXPECT_GT(faults[0].line, 5);
      EXPECT_NEAR(faults[0].amount_mm, 0.5, 1e-9);
      EXPECT_NE(faults[0].message.find(length ? "0.5 mm too high; write H" : "0.5 mm too low; write H"), std::string::npos) << faults[0].message;
      EXPECT_LT(faults[0].place_mm.norm(), 60) << "over the work";
    }
    EXPECT_TRUE(run(shop, rows(false), false).faults.empty());
  }
}

TEST(RunPrograms, FaultsAreFoundInTheText) {
  const Shop shop = shop_for("heidenhain");
  const auto kind = [](const ProgramRun& result) {
    return result.faults.empty() ? std::string() : result.faults.front().kind;
  };
  EXPECT_EQ(kind(run(shop, rows(true), true)), "");
  EXPECT_EQ(kind(run(shop, rows(true), true, " DL-2", "")), "") << "two millimetres up: less is cut, nothing is hit";
  EXPECT_EQ(kind(run(shop, rows(true), true, "DWELL 8", "DWELL 1")), "spindle_off_in_cut");
  const ProgramRun lost = run(shop, rows(true), true, "M129", "M127 X");
  EXPECT_EQ(kind(lost), "error");
  EXPECT_GT(lost.faults.front().line, 0);
  EXPECT_EQ(lost.faults.front().program, "30_FINISH.H");
  EXPECT_EQ(kind(run(shop, rows(false), false, "TOOL CALL 3", "TOOL CALL 4")), "error") << "not in the table";
  EXPECT_EQ(kind(run(shop, rows(false), false, "L X-240", "L X-340")), "limit");
}

// A rapid down into the work, within a subprogram: the line is that of the text as an editor counts, blank lines and all.
TEST(RunPrograms, AFaultInASubprogramNamesItsLineInEveryDialect) {
  struct Dive {
    std::string controller;
    std::vector<std::string> call, before, after;  ///< the subprogram stands at the text's beginning or behind its end
    std::string rapid;
  };
  const std::vector<Dive> dives = {
      {"linuxcnc", {"o100 call"}, {"", "o100 sub", "G91", "G0 Z-27", "G90", "o100 endsub"}, {}, "G0 Z-27"},
      {"fanuc", {"M98 P100"}, {}, {"O100", "G91", "G0 Z-27.", "G90", "M99"}, "G0 Z-27."},
      {"siemens", {"DIVE"}, {}, {"", "PROC DIVE", "G91", "G0 Z-27", "G90", "RET"}, "G0 Z-27"},
      {"heidenhain", {"0 CALL LBL 7"}, {}, {"0 LBL 7", "0 L IZ-27 FMAX", "0 LBL 0"}, "L IZ-27"},
      {"heidenhain_iso", {"N0 L7,0 *"}, {}, {"N0 G98 L7 *", "N0 G91 *", "N0 G00 Z-27 *", "N0 G90 *", "N0 G98 L0 *"}, "G00 Z-27"}};
  for (const Dive& dive : dives) {
    const Shop shop = shop_for(dive.controller);
    ProgramOptions options;
    options.decimals = 4;
    const Program program = write_program(shop.machine, shop.work, plan_motion(shop.machine, shop.work, rows(false)), options);
    std::vector<std::string> lines = test::lines_of(program.text);
    const auto line_with = [&](const std::string& what) {
      return std::find_if(lines.begin(), lines.end(), [&](const std::string& line) { return line.find(what) != std::string::npos; });
    };
    lines.insert(line_with("M5"), dive.call.begin(), dive.call.end());
    lines.insert(line_with("M30") + 1, dive.after.begin(), dive.after.end());
    lines.insert(lines.begin() + 1, dive.before.begin(), dive.before.end());
    const ProgramRun result = run_programs(shop.machine, reader_dialect(dive.controller), shop.setup,
                                           {{"dive", test::renumbered(lines, dive.controller)}}, shop.stock);
    ASSERT_FALSE(result.faults.empty()) << dive.controller;
    const Fault& fault = result.faults.front();
    EXPECT_EQ(fault.kind, "rapid_in_stock") << dive.controller << ": " << fault.message;
    EXPECT_EQ(fault.program, "dive");
    EXPECT_EQ(fault.line, line_with(dive.rapid) - lines.begin() + 1) << dive.controller;
  }
}

}  // namespace
}  // namespace lightmill

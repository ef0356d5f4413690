// Every dialect: golden headers and footers, the controls' traps, and mutations of the finished text.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <filesystem>
#include <regex>
#include <sstream>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "tests/postproc/programs.h"

namespace lightmill {
namespace {

using test::faults_of;
using test::joined;
using test::kDeg;
using test::lines_of;
using test::Made;
using test::make;
using test::make_for;
using test::with_decimals;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

struct Case {
  std::string controller;
  bool tcp;
  bool turning;
  [[nodiscard]] std::string name() const {
    return controller + (tcp ? "_tcp" : "") + (turning ? "_turning" : "_fixed");
  }
};

std::vector<Case> all_cases() {
  std::vector<Case> cases;
  for (const DialectFacts& dialect : dialects()) {
    for (const bool tcp : {false, true}) {
      for (const bool turning : {false, true}) {
        const bool no_time_word = dialect.name == "heidenhain_iso" && turning && !tcp;
        if ((!tcp || dialect.tcp) && !no_time_word) cases.push_back({dialect.name, tcp, turning});
      }
    }
  }
  return cases;
}

class EveryDialect : public testing::TestWithParam<Case> {
 protected:
  [[nodiscard]] static Made made() { return make_for(GetParam().controller, GetParam().turning, GetParam().tcp); }
};

INSTANTIATE_TEST_SUITE_P(Controls, EveryDialect, testing::ValuesIn(all_cases()),
                         [](const auto& it) { return it.param.name(); });

bool feeds(const std::string& line) {
  if (test::is_comment(line) || line.find("G4 ") != std::string::npos || line.find("G04") != std::string::npos)
    return false;
  const std::size_t f = line.find(" F");
  return f != std::string::npos && (std::isdigit(static_cast<unsigned char>(line[f + 2])) != 0 || line[f + 2] == 'T');
}

// Header, the first block that feeds, and footer, as in the golden file (LIGHTMILL_WRITE_GOLDEN=1 writes it anew: look
// at the difference before you keep it).
TEST_P(EveryDialect, HeaderAndFooterAreGolden) {
  const std::vector<std::string> lines = lines_of(made().program.text);
  const auto first = std::find_if(lines.begin(), lines.end(), feeds);
  const auto last = std::find_if(lines.rbegin(), lines.rend(), feeds).base();
  std::vector<std::string> around(lines.begin(), first + 1);
  around.emplace_back("...");
  around.insert(around.end(), last, lines.end());
  std::string text = joined(around);
  const std::string version = LIGHTMILL_VERSION;
  text.replace(text.find(version), version.size(), "VERSION");
  const std::filesystem::path golden =
      std::filesystem::path(LIGHTMILL_SOURCE_DIR) / "tests/postproc/golden" / (GetParam().name() + ".txt");
  if (std::getenv("LIGHTMILL_WRITE_GOLDEN") != nullptr) write_whole(golden, text);
  EXPECT_EQ(text, read_whole(golden));
}

// Where the numbers of a line begin, and their signs if they have one; not the block's own number, and not zero.
std::vector<std::size_t> numbers_in(const std::string& line, const std::string& controller) {
  std::vector<std::size_t> starts;
  const auto digit = [&](std::size_t i) {
    return i < line.size() && std::isdigit(static_cast<unsigned char>(line[i])) != 0;
  };
  std::size_t i = controller.starts_with("heidenhain") ? line.find(' ') : 0;
  while (i < line.size()) {
    const bool sign = (line[i] == '+' || line[i] == '-') && digit(i + 1);
    if (!sign && !digit(i)) {
      ++i;
      continue;
    }
    const std::size_t begin = i;
    i += sign;
    while (digit(i) || (i < line.size() && line[i] == '.')) ++i;
    // The names of programs hold numbers too.
    const bool name = begin > 0 && (line[begin - 1] == '_' || line[begin - 1] == '%') && controller != "siemens";
    if (!name && line.substr(begin, i - begin).find_first_of("123456789") != std::string::npos) starts.push_back(begin);
  }
  return starts;
}

bool harmless(const std::string& line) {
  for (const char* const what : {"G4 ", "G04 ", "DWELL ", "BLK FORM", "G30 ", "G31 ", "O00", "; %_N_"}) {
    if (line.find(what) != std::string::npos) return true;
  }
  return false;
}

// The finished text is what is judged: every line left out, every sign turned and every number changed, of a fixed
// program whole, of a turning one in header and footer and in samples of the cut. Block numbers are set right again.
TEST_P(EveryDialect, NoticesMutations) {
  const Made good = made();
  EXPECT_THAT(faults_of(good, good.program.text), IsEmpty());
  const std::vector<std::string> lines = lines_of(good.program.text);
  ASSERT_EQ(test::renumbered(lines, GetParam().controller), good.program.text);
  const auto noticed = [&](const std::vector<std::string>& changed, const std::string& what) {
    EXPECT_THAT(faults_of(good, test::renumbered(changed, GetParam().controller)), Not(IsEmpty())) << what;
  };
  int mutations = 0;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const bool inside = i > 45 && i + 20 < lines.size();
    if (test::is_comment(lines[i]) || (GetParam().turning && inside && i % 23 != 0)) continue;
    std::vector<std::string> changed = lines;
    changed.erase(changed.begin() + static_cast<long>(i));
    noticed(changed, "without " + lines[i]);
    ++mutations;
    for (const std::size_t at : numbers_in(lines[i], GetParam().controller)) {
      changed = lines;
      if (lines[i][at] == '-') {
        changed[i].replace(at, 1, good.program.text.find('+') != std::string::npos ? "+" : "");
      } else if (lines[i][at] == '+') {
        changed[i][at] = '-';
      } else {
        changed[i].insert(at, "-");
      }
      noticed(changed, lines[i] + " -> " + changed[i]);
      // A longer dwell, a larger box for the graphics and another program number harm nothing.
      if (harmless(lines[i])) continue;
      const std::size_t digit = lines[i].find_first_of("123456789", at);
      changed[i] = lines[i];
      changed[i][digit] = lines[i][digit] == '9' ? '1' : static_cast<char>(lines[i][digit] + 1);
      noticed(changed, lines[i] + " -> " + changed[i]);
      ++mutations;
    }
  }
  EXPECT_GT(mutations, 50);
}

// Numbers as the control takes them: no exponent, no minus before zero, its decimals, its point, its sign, its length;
// printable ASCII, its line ends, its longest line.
TEST_P(EveryDialect, NumbersAndLinesAreTheControls) {
  const Made good = made();
  const bool tnc = GetParam().controller.starts_with("heidenhain"), fanuc = GetParam().controller == "fanuc";
  const std::string sign = tnc ? "[+-]" : "-?";
  const std::string value = sign + (fanuc ? "[0-9]{1,5}\\.([0-9]{0,3}[1-9])?" : "[0-9]{1,5}(\\.[0-9]{0,3}[1-9])?");
  const std::regex coordinate("([XYZBC]" + value + "|C=DC\\([0-9.]+\\))"), minus_zero(".*-0(\\.0*)?");
  int words = 0;
  for (std::string line : lines_of(good.program.text)) {
    if (tnc) {
      ASSERT_TRUE(line.ends_with('\r')) << line;
      line.pop_back();
    }
    EXPECT_LE(line.size(), 80u);
    for (const char c : line) ASSERT_TRUE(c >= ' ' && c <= '~') << line;
    if (test::is_comment(line) || line.find("BEGIN") != std::string::npos) continue;
    std::istringstream in(line);
    for (std::string word; in >> word;) {
      if (word.size() < 2 || std::string_view("XYZBC").find(word[0]) == std::string_view::npos) continue;
      if (std::isalpha(static_cast<unsigned char>(word[1])) != 0) continue;  // BLK, CYCL
      EXPECT_TRUE(std::regex_match(word, coordinate)) << line;
      EXPECT_FALSE(std::regex_match(word, minus_zero)) << line;
      ++words;
    }
  }
  EXPECT_GT(words, 50);
}

TEST(Dialects, RefuseAnAngleLongerThanTheControlTakes) {
  for (const char* controller : {"fanuc", "heidenhain"}) {
    Made made = make_for(controller, true);
    for (AxisMove& move : made.motion.moves) move.joints.inner_rad += 2 * kPi * 300;
    try {
      write_program(made.machine, made.setup, made.motion, made.options);
      FAIL();
    } catch (const InputError& e) {
      EXPECT_THAT(e.what(), testing::AllOf(HasSubstr("finish: C would be written as 10"), HasSubstr("5 digits"),
                                           HasSubstr("unwinds")));
    }
  }
}

TEST(Dialects, RefuseAnUnknownTool) {
  MachineModel machine = test::hostile_machine();
  ToolPath path = test::fixed_rows(0.3, 1, 1, 3);
  path.cutter.number = 0;
  try {
    make(machine, work_on_table(machine, {12, -17, 30}, 55), path);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), testing::AllOf(HasSubstr("finish: cutter '4 mm ball'"), HasSubstr("T word")));
  }
}

// Equal but for a last decimal, where a number lay between two.
bool alike(const std::string& a, const std::string& b) {
  if (a == b) return true;
  std::istringstream in_a(a), in_b(b);
  std::string word_a, word_b;
  while (in_a >> word_a) {
    if (!(in_b >> word_b)) return false;
    const std::size_t digits = word_a.find_first_of("+-.0123456789");
    if (digits == std::string::npos || word_a.substr(0, digits) != word_b.substr(0, digits)) return false;
    const double x = std::atof(word_a.c_str() + digits), y = std::atof(word_b.c_str() + digits);
    if (std::abs(x - y) > 1.01e-4 * (word_a[0] == 'F' ? std::max(1.0, x) : 1)) return false;
  }
  return !(in_b >> word_b);
}

// Machine and work shifted together: the program is the same but for machine coordinates.
RC_GTEST_PROP(Dialects, ShiftsOfMachineAndWorkDoNotMatter, ()) {
  static const std::vector<Case> cases = all_cases();
  const Case c = cases[static_cast<std::size_t>(*rc::gen::inRange(0, static_cast<int>(cases.size())))];
  const Made made = make_for(c.controller, c.turning, c.tcp);
  const Vec3 shift(test::real(-80, 80), test::real(-80, 80), test::real(-80, 80));
  Made moved = made;
  MachineModel& m = moved.machine;
  for (RotaryAxis* axis : {&m.outer, &m.inner}) axis->point_mm += shift;
  m.table_centre_mm += shift;
  m.tool_change_mm += shift;
  m.retract_z_mm += shift.z();
  LinearAxis* const axes[3] = {&m.x, &m.y, &m.z};
  for (int i = 0; i < 3; ++i) {
    axes[i]->min_mm += shift[i];
    axes[i]->max_mm += shift[i];
  }
  moved.setup.origin_mm += shift;
  moved = make(m, moved.setup, made.path, made.options);
  const auto work = [](const Made& which) {
    std::vector<std::string> lines;
    for (const std::string& line : lines_of(which.program.text)) {
      const bool machine = line.find("G53") != std::string::npos || line.find("SUPA") != std::string::npos ||
                           line.find("M91") != std::string::npos || line.find("ZERO IN MACHINE") != std::string::npos;
      if (!machine) lines.push_back(line);
    }
    return lines;
  };
  const auto lines = work(moved), expected = work(made);
  RC_ASSERT(lines.size() == expected.size());
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (!alike(lines[i], expected[i])) RC_FAIL(c.name() + ": " + expected[i] + " -> " + lines[i]);
  }
}

std::string refusal(const Made& made, const std::string& find, const std::string& replace) {
  std::string text = made.program.text;
  const std::size_t at = text.find(find);
  if (at == std::string::npos) return "'" + find + "' is not there";
  text.replace(at, find.size(), replace);
  const auto faults = faults_of(made, test::renumbered(lines_of(text), made.machine.controller));
  return faults.empty() ? "accepted" : joined(faults);
}

// M128: the length reaches to the ball's centre; off before the tool call and before machine coordinates.
TEST(HeidenhainTraps, M128) {
  const Made made = make_for("heidenhain", true, true);
  EXPECT_THAT(refusal(made, " DL-2", ""), HasSubstr("DL does not take"));
  EXPECT_THAT(refusal(made, " DL-2", " DL+2"), HasSubstr("DL does not take"));
  EXPECT_THAT(refusal(made, "M129\r\n", "M3\r\n"), HasSubstr("before tool-centre-point control is off"));
  const std::size_t off = made.program.text.rfind("M129");
  std::string on = made.program.text;
  on.replace(off, 4, "M128");
  EXPECT_THAT(joined(faults_of(made, on)), HasSubstr("machine coordinates before tool-centre-point control is off"));
  EXPECT_THAT(refusal(made, "S36000 DL-2", "S36000 DL-2 M128"), HasSubstr("no place"));

  // Under M128 the words are the ball's centre: one radius up the tool from the tip.
  const auto& cut = *std::find_if(made.path.moves.begin(), made.path.moves.end(),
                                  [](const Move& m) { return m.kind == MoveKind::kPlunge; });
  const Vec3 centre = cut.pose.tip_mm + 2 * cut.pose.axis;
  EXPECT_THAT(made.program.text, HasSubstr(" L Z+" + compact(centre.z(), 4) + " F300"));

  MachineModel machine = made.machine;
  ToolPath path = made.path;
  path.cutter.corner_radius_mm = 0.5;
  ProgramOptions options = made.options;
  EXPECT_THROW(make(machine, made.setup, path, options), InputError) << "ball cutters only";
  ToolPath fixed = test::fixed_rows(30 * kDeg, 70 * kDeg, 2, 8);
  fixed.cutter.corner_radius_mm = 0.5;
  EXPECT_THAT(make(machine, made.setup, fixed, options).program.text, Not(HasSubstr("M128")));
}

TEST(HeidenhainTraps, TimesAreWholeMillisecondsAndNotShorter) {
  const Made made = make_for("heidenhain", true);
  EXPECT_THAT(made.program.text, HasSubstr(" FT0.0"));
  // What that costs is said: in the program for its reader, and by block for the report.
  EXPECT_THAT(made.program.text, HasSubstr(" S IN FINISH: TIMES OF BLOCKS ARE WHOLE"));
  double lost = 0, worst = 1;
  for (const AxisMove& move : made.motion.moves) {
    if (move.kind == MoveKind::kRapid) continue;
    const double ms = move.seconds * 1e3, up = std::ceil(ms - 1e-6);
    lost += (up - ms) / 1e3;
    worst = std::max(worst, up / ms);
  }
  EXPECT_NEAR(made.program.rounding_s, lost, 1e-9);
  EXPECT_NEAR(made.program.worst_rounding, worst, 1e-9);
  EXPECT_GT(worst, 1.01);
  EXPECT_EQ(make_for("heidenhain", true, true).program.rounding_s, 0) << "M128 takes feeds";
  const std::size_t at = made.program.text.find(" FT");
  const std::string word = made.program.text.substr(at, made.program.text.find('\r', at) - at);
  EXPECT_THAT(refusal(made, word, " FT0.001"), HasSubstr("faster than planned"));
  EXPECT_THAT(refusal(made, word, ""), HasSubstr("without F"));
  try {
    make_for("heidenhain_iso", true);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("tcp"));
  }
}

TEST(HeidenhainTraps, FrameAndNumbers) {
  const Made made = make_for("heidenhain", false);
  EXPECT_EQ(made.program.file_name, "30_FINISH.H");
  EXPECT_THAT(refusal(made, "END PGM 30_FINISH", "END PGM 20_FINISH"), HasSubstr("names another program"));
  std::string text = made.program.text;
  text.erase(text.find("25 M3\r\n"), 7);
  EXPECT_THAT(joined(faults_of(made, text)), HasSubstr("block number 25 expected"));
  text = made.program.text;
  text.erase(text.find('\r'), 1);
  EXPECT_THAT(joined(faults_of(made, text)), HasSubstr("carriage return"));
  EXPECT_THAT(refusal(made, "T0.002", "T0.02"), HasSubstr("tolerance"));
}

TEST(SiemensTraps, TraoriAndLength) {
  const Made made = make_for("siemens", true, true);
  EXPECT_THAT(refusal(made, "D1\n", ""), HasSubstr("tool length"));
  EXPECT_THAT(refusal(made, "SUPA G0 Z0 D0", "SUPA G0 Z0"), HasSubstr("without D0")) << "SUPA keeps the tool's length";
  EXPECT_THAT(refusal(made, "TRAORI\nG54\n", "TRAORI\n"), HasSubstr("safe modes"));
  EXPECT_THAT(refusal(made, "ORIWKS ORIAXES\n", ""), HasSubstr("ORIWKS"));
  EXPECT_THAT(refusal(made, "=DC(", "=AC("), HasSubstr("not words"));
}

TEST(Tcp, OnlyWhereTheMachineHasIt) {
  MachineModel machine = test::hostile_machine();
  machine.controller = "fanuc";
  ProgramOptions options = with_decimals(4);
  options.tcp = true;
  const WorkSetup setup = work_on_table(machine, {23, -17, 30}, 54);
  try {
    make(machine, setup, test::fixed_rows(0.3, 1, 2, 9), options);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("[controller] tcp = true"));
  }
}

// Rotary positions do not depend on where the part stands; under TCP nothing does.
TEST(Tcp, TheProgramDoesNotKnowWhereTheWorkStands) {
  for (const char* controller : {"linuxcnc", "fanuc", "siemens", "heidenhain", "heidenhain_iso"}) {
    Made made = make_for(controller, true, true);
    const auto cut = [](const Made& m) {
      std::string text;
      for (const std::string& line : lines_of(m.program.text)) {
        if (feeds(line)) text += line.substr(line.find(' ')) + "\n";
      }
      return text;
    };
    const std::string before = cut(made);
    EXPECT_GT(before.size(), 100u);
    made.setup.origin_mm += Vec3(-31, 22, 7);
    made.machine.outer.point_mm += Vec3(1, 2, 3);
    const Made moved = make(made.machine, made.setup, made.path, made.options);
    // Subdivision follows the pivots; the programmed ends of the path's moves are in both.
    const auto last = [](const std::string& text) { return text.substr(text.rfind('\n', text.size() - 2) + 1); };
    EXPECT_EQ(last(before), last(cut(moved))) << controller;
  }
}

// A limited axis rewinds above the part, in every dialect, and the checker follows.
TEST(Rewinds, AreWrittenAndChecked) {
  for (const Case& c : all_cases()) {
    if (!c.turning) continue;
    MachineModel machine = test::hostile_machine();
    machine.controller = c.controller;
    machine.has_tcp = c.tcp;
    machine.inner.min_rad = -400 * kDeg;
    machine.inner.max_rad = 400 * kDeg;
    ProgramOptions options = with_decimals(4);
    options.tcp = c.tcp;
    const Made made = make(machine, work_on_table(machine, {11, 7, 30}, 54), test::circling(3, 40, false), options);
    EXPECT_EQ(made.motion.rewinds, 1u);
    EXPECT_TRUE(made.program.text.find("REWINDS 1 ") != std::string::npos) << c.name();
  }
}

// One program for two tools: the second tool's length, speed and zero of the plan are its own.
TEST(WholeProgram, ChangesToolsBetweenPasses) {
  for (const Case& c : all_cases()) {
    MachineModel machine = test::hostile_machine();
    machine.controller = c.controller;
    machine.has_tcp = c.tcp;
    machine.tool_change_mm.z() = -20;
    const WorkSetup setup = work_on_table(machine, {23, -17, 30}, 54);
    ToolPath second = c.turning ? test::lead_rows(20 * kDeg, 1, 4) : test::fixed_rows(30 * kDeg, 70 * kDeg, 1, 5);
    second.pass = "semi_finish";
    second.cutter.number = 7;
    second.cutter.length_mm = 92;
    second.spindle_rpm = 20000;
    const std::vector<AxisMotion> passes{plan_motion(machine, setup, test::fixed_rows(0.2, 1, 1, 5)),
                                         plan_motion(machine, setup, second)};
    ProgramOptions options = with_decimals(4);
    options.tcp = c.tcp;
    const Program program = write_program(machine, setup, passes, options);
    EXPECT_THAT(program.text, HasSubstr(c.controller.starts_with("heidenhain") ? "20000" : "S20000 M3"));
    EXPECT_THAT(check_program_text(machine, setup, passes, program.text, options), IsEmpty()) << c.name();
    // Lines of the change left out.
    const std::vector<std::string> lines = lines_of(program.text);
    const auto change = std::find_if(lines.begin() + 40, lines.end(),
                                     [](const std::string& l) { return l.find("M5") != std::string::npos; });
    for (auto at = change; at < change + 12 && at < lines.end(); ++at) {
      std::vector<std::string> changed = lines;
      changed.erase(changed.begin() + (at - lines.begin()));
      EXPECT_THAT(check_program_text(machine, setup, passes, test::renumbered(changed, c.controller), options),
                  Not(IsEmpty()))
          << c.name() << " without " << *at;
    }
  }
}

// Fixed and, where the machine can, turning in the cut; with the control's own kinematics where it has them.
TEST(Dialects, EveryMachineFileGetsAProgram) {
  for (const auto& entry :
       std::filesystem::directory_iterator(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines")) {
    const MachineModel machine = read_machine(entry.path());
    for (const bool turning : {false, true}) {
      if (turning && !machine.has_rotary()) continue;
      ToolPath path = turning ? test::lead_rows(15 * kDeg, 1, 5) : test::fixed_rows(0, 0, 2, 9);
      path.spindle_rpm = std::min(path.spindle_rpm, machine.max_spindle_rpm);
      ProgramOptions options = with_decimals(4);
      const Made made = make(machine, work_on_table(machine, {12, -17, 30}, 54), path, options);
      EXPECT_GT(made.program.blocks, 30u) << entry.path();
      options.tcp = machine.has_tcp;
      EXPECT_NO_THROW(make(machine, made.setup, path, options)) << entry.path();
    }
  }
}

TEST(Dialects, ThreeAxesHaveNoRotaryWordAndPark) {
  const MachineModel machine = read_machine(std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/router_grblhal.toml");
  const WorkSetup setup = work_on_table(machine, {0, 0, 30}, 54);
  ToolPath path = test::fixed_rows(0, 0, 2, 9);
  path.spindle_rpm = 20000;
  const Made made = make(machine, setup, path);
  for (const std::string& line : lines_of(made.program.text)) {
    if (line.front() == '(') continue;
    EXPECT_EQ(line.find_first_of("ABC"), std::string::npos) << line;
  }
  EXPECT_THAT(made.program.text, HasSubstr("G53 G0 X-190 Y190\nG49\nM30"));
  EXPECT_THROW(plan_motion(machine, setup, test::fixed_rows(0.2, 0, 2, 9)), InputError);
  EXPECT_THROW(plan_motion(machine, setup, test::lead_rows(0.2, 2, 9)), InputError);
}

// A fork head on a table machine's travels: the plan keeps the tip on its line also where the head carries the tool.
TEST(Dialects, HeadsTurnInTheCut) {
  for (const Chain chain : {Chain::kHeadTable, Chain::kHeadHead}) {
    MachineModel machine = test::hostile_machine();
    machine.chain = chain;
    machine.outer.on_head = true;
    machine.inner.on_head = chain == Chain::kHeadHead;
    machine.outer.direction = 1;
    machine.outer.point_mm = {3, -2, 40};
    if (machine.inner.on_head) machine.inner.point_mm = {-5, 4, 0};
    if (machine.inner.on_head) machine.inner.direction = 1;
    const WorkSetup setup = work_on_table(machine, {23, -17, 100}, 54);
    const Made made = make(machine, setup, test::lead_rows(20 * kDeg, 2, 12));
    EXPECT_GT(made.motion.max_tip_error_um, 0);
    EXPECT_LE(made.motion.max_tip_error_um, 0.2);
    const ToolPose end = forward(machine, setup, 85, made.motion.moves.back().joints);
    EXPECT_LT((end.tip_mm - made.path.moves.back().pose.tip_mm).norm(), 1e-9);
    EXPECT_LT((end.axis - made.path.moves.back().pose.axis).norm(), 1e-9);
  }
}

TEST(Dialects, PositioningMachinesDoNotTurnInTheCut) {
  MachineModel machine = test::hostile_machine();
  machine.simultaneous = false;
  const WorkSetup setup = work_on_table(machine, {12, -17, 30}, 54);
  EXPECT_NO_THROW(plan_motion(machine, setup, test::fixed_rows(0.3, 1, 2, 9)));
  EXPECT_THROW(plan_motion(machine, setup, test::lead_rows(0.3, 2, 9)), InputError);
}

TEST(Dialects, RefuseWhatTheyCannotWrite) {
  MachineModel machine = test::hostile_machine();
  const WorkSetup setup = work_on_table(machine, {12, -17, 30}, 55);
  machine.controller = "sinumerik";
  EXPECT_THROW(make(machine, setup, test::fixed_rows(0.3, 1, 1, 3)), InputError);
  machine.controller = "fanuc";
  EXPECT_THROW(make(machine, setup, test::fixed_rows(0.3, 1, 1, 3), with_decimals(5)), InputError);
}

// Below 1 um of X, Y, Z LinuxCNC 2.9 takes the wrong time for a G93 block that turns.
TEST(Dialects, LinuxCncTurnsAndMovesApartWhereTheWayIsTiny) {
  Made made = make_for("linuxcnc", true);
  auto& moves = made.motion.moves;
  const auto cut = std::find_if(moves.begin(), moves.end(), [](const AxisMove& m) { return m.kind == MoveKind::kCut; });
  AxisMove tiny = *cut;
  tiny.joints.inner_rad += 1 * kDeg;
  tiny.joints.z_mm += 4e-4;
  tiny.seconds = 0.5;
  moves.insert(cut + 1, tiny);
  made.program = write_program(made.machine, made.setup, made.motion, made.options);
  const auto lines = lines_of(made.program.text);
  const auto turn = std::find_if(lines.begin(), lines.end(), [](const std::string& line) {
    return line.front() == 'C' && line.ends_with(" F120");
  });
  ASSERT_NE(turn, lines.end());
  EXPECT_EQ((turn + 1)->front(), 'Z');
  EXPECT_THAT(*(turn + 1), testing::EndsWith(" F120"));
}

}  // namespace
}  // namespace lightmill

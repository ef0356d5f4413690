#include "postproc/program.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <clocale>
#include <cstdlib>
#include <fstream>
#include <locale>
#include <regex>
#include <sstream>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "tests/postproc/programs.h"
#include "tests/postproc/rs274.h"

namespace lightmill {
namespace {

using test::Canonical;
using test::faults_of;
using test::has_rs274;
using test::joined;
using test::kDeg;
using test::lines_of;
using test::Made;
using test::make;
using test::make_for;
using test::Rs274Run;
using test::run_rs274;
using test::with_block_numbers;
using test::with_decimals;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

Made make_fixed(const ProgramOptions& options = {}) {
  const MachineModel machine = test::hostile_machine();
  return make(machine, work_on_table(machine, {12, -17, 30}, 55), test::fixed_rows(30 * kDeg, 70 * kDeg, 3, 20),
              options);
}

// A table that must be unwound in the middle of the program.
Made make_unwinding() {
  MachineModel machine = test::hostile_machine();
  machine.inner.min_rad = -400 * kDeg;
  machine.inner.max_rad = 400 * kDeg;
  return make(machine, work_on_table(machine, {11, 7, 30}, 54), test::circling(5, 60, true));
}

Made make_turning(const ProgramOptions& options = {}) {
  const MachineModel machine = test::hostile_machine();
  return make(machine, work_on_table(machine, {23, -17, 30}, 54), test::lead_rows(20 * kDeg, 2, 12), options);
}

TEST(WriteGrblHal, FileNamesSayTheOrder) {
  EXPECT_EQ(program_file_name("rough", "grblhal"), "10_rough.nc");
  EXPECT_EQ(program_file_name("semi_finish", "linuxcnc"), "20_semi_finish.ngc");
  EXPECT_EQ(program_file_name("finish", "fanuc"), "30_finish.nc");
  EXPECT_EQ(program_file_name("finish", "heidenhain"), "30_FINISH.H");
  EXPECT_EQ(program_file_name("finish", "siemens"), "LM_30_FINISH.MPF") << "two letters first";
  EXPECT_EQ(program_file_name("../x y", "grblhal"), "40____x_y.nc");
}

TEST(WriteGrblHal, GoldenHeaderAndFooter) {
  MachineModel machine = test::fixture_machine();
  const WorkSetup setup = work_on_table(machine, {0, 0, 30}, 54);
  ToolPath path = test::empty_path(25);
  const Vec3 axis = test::direction(30 * kDeg, 0);
  path.moves = {{{{1, 2, 40}, axis}, MoveKind::kRapid, 0}, {{{1, 2, 10}, axis}, MoveKind::kPlunge, 5},
                {{{2, 2, 10}, axis}, MoveKind::kCut, 18},  {{{3, 2, 10}, axis}, MoveKind::kCut, 18},
                {{{3, 2, 40}, axis}, MoveKind::kLink, 80}, {{{3, 2, 50}, axis}, MoveKind::kRapid, 0}};
  ProgramOptions options;
  options.job_name = "Test (50%) \xC3\xA9t\xC3\xA9!";
  options.job_hash = "0123abcd";
  const Made made = make(machine, setup, path, options);
  EXPECT_EQ(made.program.file_name, "30_finish.nc");
  // B30 C0: p = P + Ry(-30)(o + w - P), P = (0, 0, -380), o = (0, 0, -390); program = p - o. For w = (1, 2, 40):
  // x = cos 30 - 30 sin 30, z = 10 + 30 cos 30 + sin 30.
  EXPECT_EQ(made.program.text, R"((LIGHTMILL )" LIGHTMILL_VERSION R"( 30_finish.nc)
(JOB Test [50_] _t__)
(HASH OF THE JOB 0123abcd)
(MAKES the finish pass of a lens, 7 moves, rotary axes fixed)
(TIME ABOUT 0.2 MIN, accelerations not counted)
(TOOL T3 4 mm ball)
(TOOL DIAMETER 4 CORNER RADIUS 2 STICK-OUT 32 MM)
(TOOL LENGTH 85.000 MM FROM SPINDLE NOSE TO TIP)
(TOOL finish AT 36000 RPM, cutting data: test)
(ZERO G54 = WORKPIECE ORIGIN WITH B0 C0: the centre of the blank's back)
(ZERO IN MACHINE COORDINATES X0.000 Y0.000 Z-390.000)
(MACHINE B/C trunnion, travels of a Mikron HSM 400U [unverified], grblHAL)
([stand-in])
(MACHINE Unverified: travels, speeds, pivots. The real machine has a Heidenhain)
(iTNC 530.)
(NO TOOL CENTRE CONTROL: the program holds axis positions and fits this)
(machine, this zero and this tool length only)
(M7 = AIR ON THE MIST OUTPUT)
G21 G90 G94 G17 G40 G49 G80 G54
G53 G0 Z0
G53 G0 X-240 Y115
T3 M6
G43.1 Z85
S36000 M3
G4 P8
M7
G53 G0 Z0
B30 C0
X-14.13397 Y2
Z36.48076
G1 X0.86603 Z10.5 F300
X1.73205 Z11 F1080
X2.59808 Z11.5
X-12.40192 Z37.48076 F4800
G0 X-17.40192 Z46.14102
M5 M9
G53 G0 Z0
G0 B0
G49
M30
)");
  EXPECT_EQ(made.program.blocks, 22u);
}

TEST(WriteGrblHal, FixedProgramsHaveNoRotaryWordInTheCut) {
  const Made made = make_fixed();
  EXPECT_THAT(made.program.text, Not(HasSubstr("G93")));
  const auto lines = lines_of(made.program.text);
  EXPECT_EQ(std::count_if(lines.begin(), lines.end(),
                          [](const std::string& line) {
                            return line.front() != '(' && line.find_first_of("BC") != std::string::npos;
                          }),
            2) << "into place, and home";
}

TEST(WriteGrblHal, TurningProgramsHaveAFeedOnEveryLine) {
  const Made made = make_turning();
  const auto lines = lines_of(made.program.text);
  const auto g93 = std::find(lines.begin(), lines.end(), "G93");
  const auto g94 = std::find(lines.begin(), lines.end(), "G94");
  ASSERT_LT(g93, g94);
  std::size_t feeds = 0;
  bool rapid = false;
  for (auto line = g93 + 1; line != g94; ++line) {
    if (line->starts_with("G0") || line->starts_with("G53")) rapid = true;
    if (line->starts_with("G1")) rapid = false;
    if (rapid || line->find_first_of("XYZ") == std::string::npos || line->starts_with("B")) continue;
    feeds += line->find(" F") != std::string::npos;
  }
  EXPECT_EQ(feeds, std::count_if(made.motion.moves.begin(), made.motion.moves.end(),
                                 [](const AxisMove& move) { return move.kind != MoveKind::kRapid; }));
}

// Up, turn, across, down, in blocks of their own.
TEST(WriteGrblHal, UnwindsAtTheMachinesTop) {
  const auto lines = lines_of(make_unwinding().program.text);
  const auto g93 = std::find(lines.begin(), lines.end(), "G93");
  const auto g94 = std::find(g93, lines.end(), "G94");
  int unwound = 0;
  for (auto up = std::find(g93, g94, "G53 G0 Z0"); up != g94; up = std::find(up + 1, g94, "G53 G0 Z0")) {
    EXPECT_EQ((up + 1)->find_first_of("XYZF"), std::string::npos) << *(up + 1);
    EXPECT_NE((up + 1)->find('C'), std::string::npos) << *(up + 1);
    EXPECT_EQ((up + 2)->find_first_of("BCZF"), std::string::npos) << *(up + 2);
    EXPECT_EQ((up + 3)->front(), 'Z') << *(up + 3);
    ++unwound;
  }
  EXPECT_GE(unwound, 2);
}

TEST(WriteGrblHal, NumbersAreWhatEveryControllerReads) {
  for (const Made& made :
       {make_fixed(), make_turning(), make_fixed(with_decimals(3)), make_turning(with_decimals(7))}) {
    const std::regex word("[A-Z]-?[0-9]+(\\.[0-9]*[1-9])?|G43\\.1");
    for (const std::string& line : lines_of(made.program.text)) {
      EXPECT_LE(line.size(), 80u);
      if (line.front() == '(') continue;
      std::istringstream words(line);
      // Words stand apart by spaces, have no exponent, no trailing zero; minus zero is none.
      for (std::string w; words >> w;) {
        EXPECT_TRUE(std::regex_match(w, word)) << line;
        EXPECT_FALSE(std::regex_match(w, std::regex("[A-Z]-0(\\.0*)?"))) << line;
      }
    }
  }
}

TEST(WriteGrblHal, DoesNotFollowTheLocale) {
  const std::string here = make_turning().program.text;
  struct Comma : std::numpunct<char> {
    char do_decimal_point() const override { return ','; }
    char do_thousands_sep() const override { return '.'; }
    std::string do_grouping() const override { return "\3"; }
  };
  const std::string before = std::setlocale(LC_ALL, nullptr);
  const std::locale global = std::locale::global(std::locale(std::locale::classic(), new Comma));
  std::setlocale(LC_ALL, "de_DE.UTF-8");  // where the system has it; the C++ locale above needs nothing
  const std::string german = make_turning().program.text;
  std::locale::global(global);
  std::setlocale(LC_ALL, before.c_str());
  EXPECT_EQ(here, german);
}

TEST(WriteGrblHal, SpeedOutsideTheSpindlesRangeIsTheUsersToChange) {
  Made made = make_fixed();
  made.motion.spindle_rpm = 60000;
  try {
    write_program(made.machine, made.setup, made.motion);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("60000 rpm"));
    EXPECT_THAT(e.what(), HasSubstr("spindle_rpm"));
  }
}

TEST(WriteGrblHal, RapidBelowTheSafePlaneIsRefused) {
  Made made = make_fixed();
  ToolPath path = made.path;
  path.moves[1].kind = MoveKind::kRapid;  // down to 3 mm above the surface
  const AxisMotion motion = plan_motion(made.machine, made.setup, path);
  EXPECT_THROW(write_program(made.machine, made.setup, motion), NumericalError);
}

TEST(CheckProgramText, AcceptsWhatIsWritten) {
  EXPECT_THAT(faults_of(make_fixed(), make_fixed().program.text), IsEmpty());
  EXPECT_THAT(faults_of(make_turning(), make_turning().program.text), IsEmpty());
  const Made numbered = make_turning(with_block_numbers(true));
  EXPECT_THAT(numbered.program.text, HasSubstr("\nN1 G21"));
  EXPECT_THAT(faults_of(numbered, numbered.program.text), IsEmpty());
}

// A lost line, a line twice, a swapped pair, a flipped sign, a lost digit: anywhere, and noticed.
TEST(CheckProgramText, NoticesEveryMutation) {
  const Made turning = make(test::hostile_machine(), work_on_table(test::hostile_machine(), {23, -17, 30}, 54),
                            test::lead_rows(20 * kDeg, 1, 3, 4));
  for (const Made& made : {make_fixed(), turning}) {
    const std::vector<std::string> lines = lines_of(made.program.text);
    const auto cut = static_cast<std::size_t>(
        std::find_if(lines.begin(), lines.end(), [](const std::string& line) { return line.starts_with("G1 "); }) -
        lines.begin());
    int mutations = 0;
    for (std::size_t i = 0; i < lines.size(); ++i) {
      if (lines[i].front() == '(') continue;
      std::vector<std::string> dropped = lines;
      dropped.erase(dropped.begin() + static_cast<long>(i));
      EXPECT_THAT(faults_of(made, joined(dropped)), Not(IsEmpty())) << "dropped: " << lines[i];
      ++mutations;

      for (std::size_t at = 0; at < lines[i].size(); ++at) {
        if (std::isupper(lines[i][at]) == 0) continue;
        const std::size_t digits = at + 1;
        const std::size_t end = std::min(lines[i].find(' ', at), lines[i].size());
        std::string number = lines[i].substr(digits, end - digits);
        if (number == "0" && !std::strchr("GM", lines[i][at])) continue;
        const std::string flipped = number.front() == '-' ? number.substr(1) : "-" + number;
        std::vector<std::string> changed = lines;
        if (number != "0") {
          changed[i] = lines[i].substr(0, digits) + flipped + lines[i].substr(end);
          EXPECT_THAT(faults_of(made, joined(changed)), Not(IsEmpty())) << "sign: " << lines[i] << " -> " << changed[i];
          ++mutations;
        }
        // The other digit is wrong by two at least: 0.0001 of feed rounding is not a fault.
        for (std::size_t d = digits; d < end; ++d) {
          if (std::isdigit(static_cast<unsigned char>(lines[i][d])) == 0) continue;
          if (lines[i][at] == 'F' && d > digits + 2) continue;
          if (lines[i][at] == 'P') continue;
          changed = lines;
          changed[i][d] = static_cast<char>('0' + (lines[i][d] - '0' + 5) % 10);
          EXPECT_THAT(faults_of(made, joined(changed)), Not(IsEmpty()))
              << "digit: " << lines[i] << " -> " << changed[i];
          ++mutations;
        }
      }
      // In the header some neighbours may stand either way round, in the cut none.
      if (i > cut && i + 1 < lines.size() && lines[i + 1].find('F') != std::string::npos && lines[i] != lines[i + 1]) {
        std::vector<std::string> swapped = lines;
        std::swap(swapped[i], swapped[i + 1]);
        EXPECT_THAT(faults_of(made, joined(swapped)), Not(IsEmpty()))
            << "swapped: " << lines[i] << " | " << lines[i + 1];
        ++mutations;
      }
    }
    EXPECT_GT(mutations, 300);
  }
}

TEST(CheckProgramText, KnowsTheRules) {
  const Made made = make_turning();
  const std::string& good = made.program.text;
  const auto with = [&](const std::string& find, const std::string& replace) {
    std::string text = good;
    text.replace(text.find(find), find.size(), replace);
    const auto faults = faults_of(made, text);
    return faults.empty() ? std::string("accepted") : joined(faults);
  };
  EXPECT_THAT(with("G4 P8", "G4 P1"), HasSubstr("before the spindle has had time"));
  EXPECT_THAT(with("S36000 M3\n", "S36000 M5\n"), HasSubstr("spindle off"));
  EXPECT_THAT(with("G93\n", ""), HasSubstr("outside G93"));
  EXPECT_THAT(with("G43.1 Z85\n", ""), HasSubstr("tool length"));
  EXPECT_THAT(with("M30\n", "M30"), HasSubstr("line feed"));
  EXPECT_EQ(with("(MACHINE", "(machine"), "accepted");
  EXPECT_THAT(with("(MACHINE", "(MACHINE\xC3\xA9"), HasSubstr("ASCII"));
  EXPECT_THAT(with("(MACHINE", "(MACHINE!"), HasSubstr("real-time"));
  EXPECT_THAT(with("(MACHINE", "(" + std::string(80, 'x')), HasSubstr("80 characters"));
  EXPECT_THAT(with("M5 M9", "M9"), HasSubstr("spindle or air on"));
  EXPECT_THAT(with("M7\nG53 G0 Z0\n", "M7\n"), HasSubstr("top"));
  const std::size_t f = good.find(" F", good.find("G93\n"));
  EXPECT_THAT(with(good.substr(f, good.find('\n', f) - f), ""), HasSubstr("G93 block without F"));
  EXPECT_THAT(with(good.substr(f, good.find('\n', f) - f), " F999999"), HasSubstr("faster than planned"));
  EXPECT_THAT(with("M5 M9\nG53 G0 Z0\n", "M5 M9\nG53 G0 Z-5\n"), HasSubstr("after the last"));
  EXPECT_THAT(with("G53 G0 X-240", "G53 G0 X-251"), HasSubstr("leaves the machine's travel"));
}

// A second interpreter, not ours: LinuxCNC's --------------------------------------------------------------------------

// Every move of the plan arrives in the canonical calls, in order, to 1e-4.
void expect_plan_arrives(const Made& made, const Rs274Run& run) {
  EXPECT_EQ(run.exit_code, 0) << run.errors;
  const bool turning = made.program.text.find("G93\n") != std::string::npos;
  std::size_t next = 0;
  double feed = 0;
  Vec3 last = Vec3::Zero();
  const Vec3& zero = made.setup.origin_mm;
  const double length = made.path.cutter.length_mm;
  for (const Canonical& c : run.calls) {
    if (c.call == "SET_FEED_RATE") feed = c.numbers.at(0);
    if (c.call != "STRAIGHT_FEED" && c.call != "STRAIGHT_TRAVERSE") continue;
    ASSERT_EQ(c.numbers.size(), 9u - 3u) << "X Y Z A B C";
    const Vec3 here(c.numbers[0], c.numbers[1], c.numbers[2]);
    if (next < made.motion.moves.size()) {
      const AxisMove& move = made.motion.moves[next];
      const JointPosition& j = move.joints;
      // The interpreter knows no workpiece zero (its offsets are 0); the tool length is in force.
      const Vec3 want = j.z_mm == made.machine.retract_z_mm
                            ? Vec3(j.x_mm - zero.x(), j.y_mm - zero.y(), here.z())
                            : Vec3(j.x_mm - zero.x(), j.y_mm - zero.y(), j.z_mm - length - zero.z());
      const bool there = (here - want).cwiseAbs().maxCoeff() < 1e-4 &&
                         std::abs(c.numbers[4] - j.outer_rad / kDeg) < 1e-4 &&
                         std::abs(c.numbers[5] - j.inner_rad / kDeg) < 1e-4;
      if (c.call == "STRAIGHT_FEED") {
        EXPECT_TRUE(there) << "move " << next << ": " << here.transpose() << " instead of " << want.transpose();
        EXPECT_NE(move.kind, MoveKind::kRapid);
        if (turning) {
          // Canonical feed = F word x length, so F = feed / length must say the planned time. Four decimals limit it.
          const double distance = (here - last).norm();
          if (distance > 0.05) {
            EXPECT_NEAR(distance / feed * 60, move.seconds, move.seconds * 5e-3);
          }
        } else {
          EXPECT_LE(feed, made.path.moves[next - 1].feed_mm_per_s * 60 * (1 + 1e-6));
          EXPECT_GE(feed, made.path.moves[next - 1].feed_mm_per_s * 60 * (1 - 2e-4));
        }
      }
      if (there) ++next;
    }
    last = here;
  }
  EXPECT_EQ(next, made.motion.moves.size()) << "the plan does not arrive whole";
}

TEST(Rs274, ReadsAFixedProgram) {
  if (!has_rs274()) GTEST_SKIP() << "rs274 is not installed: apt-get install --no-install-recommends linuxcnc-uspace";
  const Made made = make_fixed();
  const Rs274Run run = run_rs274(made);
  expect_plan_arrives(made, run);
}

TEST(Rs274, ReadsATurningProgram) {
  if (!has_rs274()) GTEST_SKIP() << "rs274 is not installed: apt-get install --no-install-recommends linuxcnc-uspace";
  expect_plan_arrives(make_unwinding(), run_rs274(make_unwinding()));
  for (const bool numbers : {false, true}) {
    const Made made = make_turning(with_block_numbers(numbers));
    expect_plan_arrives(made, run_rs274(made));
  }
}

TEST(Rs274, ReadsTheLinuxCncDialect) {
  if (!has_rs274()) GTEST_SKIP() << "rs274 is not installed: apt-get install --no-install-recommends linuxcnc-uspace";
  for (const bool turning : {false, true}) {
    const Made made = make_for("linuxcnc", turning);
    expect_plan_arrives(made, run_rs274(made));
  }
}

// Under TCP the words are the tip, and the feed is the tip's.
TEST(Rs274, ReadsTheLinuxCncDialectUnderTcp) {
  if (!has_rs274()) GTEST_SKIP() << "rs274 is not installed: apt-get install --no-install-recommends linuxcnc-uspace";
  for (const bool turning : {false, true}) {
    const Made made = make_for("linuxcnc", turning, true);
    const Rs274Run run = run_rs274(made);
    EXPECT_EQ(run.exit_code, 0) << run.errors;
    std::size_t next = 0;
    for (const Canonical& c : run.calls) {
      if (next == made.motion.moves.size()) break;
      const AxisMove& move = made.motion.moves[next];
      if (move.joints.z_mm == made.machine.retract_z_mm) {
        ++next;
        continue;
      }
      if (c.call != "STRAIGHT_FEED" && c.call != "STRAIGHT_TRAVERSE") continue;
      const ToolPose pose = forward(made.machine, made.setup, made.path.cutter.length_mm, move.joints);
      const bool there = (Vec3(c.numbers[0], c.numbers[1], c.numbers[2]) - pose.tip_mm).cwiseAbs().maxCoeff() < 1e-4 &&
                         std::abs(c.numbers[4] - move.joints.outer_rad / kDeg) < 1e-4 &&
                         std::abs(c.numbers[5] - move.joints.inner_rad / kDeg) < 1e-4;
      if (c.call == "STRAIGHT_FEED") {
        EXPECT_TRUE(there) << next;
      }
      if (there) ++next;
    }
    EXPECT_EQ(next, made.motion.moves.size()) << "the plan does not arrive whole";
  }
}

// That this witness can say no.
TEST(Rs274, RefusesABrokenProgram) {
  if (!has_rs274()) GTEST_SKIP() << "rs274 is not installed: apt-get install --no-install-recommends linuxcnc-uspace";
  Made made = make_turning();
  std::string& text = made.program.text;
  const std::size_t f = text.find(" F", text.find("G93\n"));
  text.erase(f, text.find('\n', f) - f);
  const Rs274Run run = run_rs274(made);
  EXPECT_NE(run.exit_code, 0);
  EXPECT_THAT(run.errors, HasSubstr("F word missing"));
}

}  // namespace
}  // namespace lightmill

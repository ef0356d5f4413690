#include "postproc/detail/arc_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "design/core/errors.h"
#include "tests/postproc/programs.h"
#include "tests/postproc/rs274.h"

namespace lightmill {
namespace {

using detail::ArcRun;
using detail::first_axis;
using detail::longest_arc;
using detail::second_axis;
using test::kDeg;
using test::Made;
using test::real;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr double kTolerance_mm = 2e-4;

// Points of a helix about `centre`: `normal` is the axis across.
std::vector<Vec3> helix(int normal, const Vec3& centre, double radius, double from, double turn, double rise, int moves) {
  std::vector<Vec3> points;
  for (int i = 0; i <= moves; ++i) {
    const double t = double(i) / moves, angle = from + t * turn;
    Vec3 p = centre;
    p[first_axis(normal)] += radius * std::cos(angle);
    p[second_axis(normal)] += radius * std::sin(angle);
    p[normal] += t * rise;
    points.push_back(p);
  }
  return points;
}

// A circle's own points come back as one arc with its centre, whatever the plane, the sense and the way along its axis.
RC_GTEST_PROP(LongestArc, FindsACirclesCentre, ()) {
  const int normal = *rc::gen::inRange(0, 3);
  const Vec3 centre(real(-50, 50), real(-50, 50), real(-50, 50));
  const double radius = real(1, 200);
  const double sense = *rc::gen::element(-1.0, 1.0);
  const double turn = sense * real(0.1, 1.5);
  // Chords nearer than the tolerance.
  const int moves = 4 + static_cast<int>(std::abs(turn) / std::sqrt(4 * kTolerance_mm / radius));
  const auto points = helix(normal, centre, radius, real(-3, 3), turn, real(-0.2, 0.2) * radius * std::abs(turn), moves);
  const auto run = longest_arc(points, kTolerance_mm, 1e-5);
  RC_ASSERT(run.has_value());
  RC_ASSERT(run->moves == static_cast<std::size_t>(moves));
  RC_ASSERT(run->arc.normal == normal);
  RC_ASSERT(run->arc.clockwise == (sense < 0));
  RC_ASSERT(run->error_mm <= kTolerance_mm);
  Vec3 off = run->arc.centre_mm - centre;
  off[normal] = 0;
  RC_ASSERT(off.norm() < 8 * kTolerance_mm / (turn * turn) + 1e-4);  // sagitta and radius by one tolerance
}

// Whatever a path does, an arc stays by it: sampled densely, both ways.
RC_GTEST_PROP(LongestArc, StaysByAnyPath, ()) {
  std::vector<Vec3> points;
  const double a = real(0, 3), b = real(0, 3), c = real(0.05, 0.5), step = real(0.02, 0.4);
  for (int i = 0; i < 60; ++i) {
    const double x = step * i;
    points.emplace_back(x, real(0, 0.1) * b * std::sin(c * x), a * std::cos(c * x) + real(0, 1e-4));
  }
  const auto run = longest_arc(points, kTolerance_mm, 1e-4);
  if (!run) return;
  const int u = first_axis(run->arc.normal), v = second_axis(run->arc.normal);
  for (std::size_t i = 1; i <= run->moves; ++i) {
    for (int k = 0; k <= 20; ++k) {
      const Vec3 p = points[i - 1] + k / 20.0 * (points[i] - points[i - 1]);
      const auto radius = [&](const Vec3& q) {
        return std::hypot(q[u] - run->arc.centre_mm[u], q[v] - run->arc.centre_mm[v]);
      };
      RC_ASSERT(std::abs(radius(p) - radius(points[0])) < kTolerance_mm + 3e-4);  // and last decimals of both ends
    }
  }
}

TEST(LongestArc, LeavesStraightLinesAndCornersAlone) {
  std::vector<Vec3> line, corner;
  for (int i = 0; i <= 20; ++i) line.emplace_back(i, 0.5 * i, -0.25 * i);
  for (int i = 0; i <= 20; ++i) corner.emplace_back(std::min(i, 10), std::max(i - 10, 0), 0);
  EXPECT_FALSE(longest_arc(line, kTolerance_mm, 1e-5));
  EXPECT_FALSE(longest_arc(corner, kTolerance_mm, 1e-5));
}

struct Case {
  std::string controller;
  bool tcp;
};

class Arcs : public testing::TestWithParam<Case> {
 protected:
  [[nodiscard]] static Made made(bool arcs, double tilt_rad, int decimals = 4) {
    MachineModel machine = test::hostile_machine();
    machine.controller = GetParam().controller;
    machine.has_tcp = GetParam().tcp;
    ProgramOptions options = test::with_decimals(decimals);
    options.tcp = GetParam().tcp;
    options.arc_tolerance_mm = arcs ? kTolerance_mm : 0;
    return test::make(machine, work_on_table(machine, {23, -17, 30}, 54), test::fixed_rows(tilt_rad, 0, 2, 150), options);
  }
};

INSTANTIATE_TEST_SUITE_P(Controls, Arcs,
                         testing::Values(Case{"grblhal", false}, Case{"linuxcnc", false}, Case{"linuxcnc", true},
                                         Case{"fanuc", false}, Case{"fanuc", true}),
                         [](const auto& it) { return it.param.controller + (it.param.tcp ? "_tcp" : ""); });

TEST_P(Arcs, SaveBytesAndStandInTheText) {
  for (const double tilt : {0.0, 25 * kDeg}) {
    const Made with = made(true, tilt), without = made(false, tilt);
    EXPECT_GT(with.program.arcs, 10u);
    EXPECT_LT(with.program.text.size() * 2, without.program.text.size());
    EXPECT_LE(with.program.max_arc_error_mm, kTolerance_mm);
    EXPECT_THAT(with.program.text, HasSubstr("G18 G"));
    EXPECT_EQ(without.program.arcs, 0u);
    double with_s = 0, without_s = 0;
    for (const double s : with.program.feed_seconds) with_s += s;
    for (const double s : without.program.feed_seconds) without_s += s;
    EXPECT_NEAR(with_s, without_s, 1e-9 * without_s);
    EXPECT_LT(with.program.feed_seconds.size(), without.program.feed_seconds.size() / 3);
  }
}

// The check holds every arc against the straight moves of the plan, from the text alone.
TEST_P(Arcs, MutationsAreNoticed) {
  const Made good = made(true, 0);
  EXPECT_THAT(faults_of(good, good.program.text), IsEmpty());
  const std::vector<std::string> lines = test::lines_of(good.program.text);
  int mutations = 0;
  const auto noticed = [&](std::size_t i, const std::string& line) {
    std::vector<std::string> changed = lines;
    if (line.empty()) {
      changed.erase(changed.begin() + static_cast<long>(i));
    } else {
      changed[i] = line;
    }
    EXPECT_THAT(faults_of(good, test::joined(changed)), Not(IsEmpty())) << lines[i] << " -> " << line;
    ++mutations;
  };
  const auto closing = std::find(lines.begin(), lines.end(), "G17");
  ASSERT_NE(closing, lines.end());
  noticed(static_cast<std::size_t>(closing - lines.begin()), "");
  for (std::size_t i = 0; i < lines.size() && mutations < 300; ++i) {
    const std::string& line = lines[i];
    if (line.find(" K") == std::string::npos || line.front() == '(') continue;
    noticed(i, "");
    for (const char letter : {'X', 'Z', 'I', 'K'}) {
      const std::size_t at = line.find(letter);
      std::string turned = line;
      if (line[at + 1] == '-') {
        turned.erase(at + 1, 1);
      } else {
        turned.insert(at + 1, "-");
      }
      noticed(i, turned);
      noticed(i, line.substr(0, at) + line.substr(std::min(line.find(' ', at), line.size())));
    }
    for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
             {"G18", "G17"}, {"G18", "G19"}, {"G2", "G3"}, {"G3", "G2"}, {"G2", "G1"}, {"G3", "G1"}}) {
      const std::size_t at = line.find(from);
      if (at != std::string::npos) noticed(i, std::string(line).replace(at, from.size(), to));
    }
  }
  EXPECT_GT(mutations, 100);
}

// A wide tolerance lets arcs be shorter or longer than the moves they stand for: their time is still the plan's, as the check
// says that write_program asks.
RC_GTEST_PROP(ArcsOfRandomRows, TakeThePlansTimeAtAnyTolerance, ()) {
  ToolPath path = test::fixed_rows(real(0, 40) * kDeg, real(-3, 3), 2, *rc::gen::inRange(5, 40), real(1, 34));
  const double wave_mm = *rc::gen::element(0.0, 1.0) * real(0, 0.02);
  for (Move& move : path.moves) {
    if (move.kind == MoveKind::kCut) move.pose.tip_mm.z() += real(-1, 1) * wave_mm;
  }
  const MachineModel machine = test::hostile_machine();
  ProgramOptions options = test::with_decimals(4);
  options.arc_tolerance_mm = real(2e-4, 0.02);
  const Made made = test::make(machine, work_on_table(machine, {23, -17, 30}, 54), path, options);
  RC_CLASSIFY(made.program.arcs > 0);
  RC_ASSERT(faults_of(made, made.program.text).empty());
}

TEST(ArcsAreRefused, WhereAnotherPlaneTurnsTheToolLength) {
  for (const char* controller : {"siemens", "heidenhain", "heidenhain_iso"}) {
    MachineModel machine = test::hostile_machine();
    machine.controller = controller;
    ProgramOptions options = test::with_decimals(4);
    options.arc_tolerance_mm = kTolerance_mm;
    try {
      test::make(machine, work_on_table(machine, {23, -17, 30}, 54), test::fixed_rows(0.3, 1, 1, 9), options);
      FAIL();
    } catch (const InputError& e) {
      EXPECT_THAT(e.what(), HasSubstr("[controller] arcs"));
    }
  }
}

// LinuxCNC's own interpreter takes every arc as planned: its canonical ends, planes, centres and senses.
TEST(ArcsInRs274, AreWhatWasWritten) {
  if (!test::has_rs274()) GTEST_SKIP() << "rs274 is not installed";
  MachineModel machine = test::hostile_machine();
  machine.controller = "linuxcnc";
  ProgramOptions options;
  options.arc_tolerance_mm = kTolerance_mm;
  const Made made =
      test::make(machine, work_on_table(machine, {23, -17, 30}, 54), test::fixed_rows(0, 0, 3, 150), options);
  const test::Rs274Run run = test::run_rs274(made);
  ASSERT_EQ(run.exit_code, 0) << run.errors;
  const auto arcs = [](const test::Canonical& c) { return c.call == "ARC_FEED"; };
  EXPECT_EQ(static_cast<std::size_t>(std::count_if(run.calls.begin(), run.calls.end(), arcs)), made.program.arcs);
  EXPECT_TRUE(std::any_of(run.calls.begin(), run.calls.end(), [](const auto& c) { return c.call == "SELECT_PLANE"; }));
  // ARC_FEED(first end, second end, first centre, second centre, rotation, axis end, A, B, C), in the plane's own order.
  Vec3 at = Vec3::Zero();
  std::size_t next = 0;
  double feed = 0;
  for (const test::Canonical& c : run.calls) {
    if (c.call == "SET_FEED_RATE") feed = c.numbers[0];
    if (c.call == "STRAIGHT_FEED" || c.call == "STRAIGHT_TRAVERSE") at = {c.numbers[0], c.numbers[1], c.numbers[2]};
    if (c.call != "ARC_FEED") continue;
    ASSERT_GE(c.numbers.size(), 6u);
    EXPECT_NEAR(feed, 60 * 18, 60 * 18 * 1e-4) << "the path's";
    const Vec3 end(c.numbers[1], c.numbers[5], c.numbers[0]);  // G18: Z and X
    const double r0 = std::hypot(at.z() - c.numbers[2], at.x() - c.numbers[3]);
    const double r1 = std::hypot(end.z() - c.numbers[2], end.x() - c.numbers[3]);
    EXPECT_NEAR(r0, r1, 3e-4);
    EXPECT_EQ(std::abs(c.numbers[4]), 1);
    at = end;
    const auto planned = [&](const AxisMove& m) {
      return (Vec3(m.joints.x_mm, m.joints.y_mm, m.joints.z_mm - 85) - made.setup.origin_mm - end).cwiseAbs().maxCoeff() < 1e-4;
    };
    const auto found = std::find_if(made.motion.moves.begin() + static_cast<long>(next), made.motion.moves.end(), planned);
    ASSERT_NE(found, made.motion.moves.end());
    next = static_cast<std::size_t>(found - made.motion.moves.begin()) + 1;
  }
}

}  // namespace
}  // namespace lightmill

// What postproc writes for a control, the machine's own reader understands as planned; the two share no code.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "design/core/errors.h"
#include "machine/kinematics.h"
#include "machine/program_reader.h"
#include "postproc/program.h"
#include "tests/postproc/support.h"

namespace lightmill {
namespace {

constexpr double kTip_mm = 2e-4;    // four decimals of three axes, and of two angles about pivots 60 mm away
constexpr double kAxis_rad = 2e-6;  // four decimals of two angles

struct Case {
  std::string controller;
  bool tcp;
  bool turning;
};

struct Planned {
  MachineModel machine;
  WorkSetup work;
  AxisMotion motion;
};

Planned plan(const std::string& controller, bool turning) {
  Planned planned;
  planned.machine = test::hostile_machine();
  planned.machine.controller = controller;
  planned.machine.has_tcp = controller != "grblhal";
  planned.work = work_on_table(planned.machine, {23, -17, 30}, 55);
  const ToolPath path =
      turning ? test::lead_rows(20 * test::kDeg, 2, 12) : test::fixed_rows(30 * test::kDeg, 70 * test::kDeg, 3, 20);
  planned.motion = plan_motion(planned.machine, planned.work, path);
  return planned;
}

// A step at whose end the control stands at a programmed point, and the cutter there.
struct Heard {
  ProgramStep step;
  ToolPose pose;
};

std::string write_text(const Planned& p, bool tcp) {
  ProgramOptions options;
  options.decimals = 4;
  options.tcp = tcp;
  return write_program(p.machine, p.work, p.motion, options).text;
}

std::vector<Heard> hear(const Planned& p, bool tcp) {
  const std::string text = write_text(p, tcp);
  ReaderSetup setup;
  setup.offsets[1] = {p.work.origin_mm.x(), p.work.origin_mm.y(), p.work.origin_mm.z(), 0, 0};
  setup.tool_length_mm = {{p.motion.cutter.number, p.motion.cutter.length_mm}};
  WorkpieceView view(p.machine, p.work.origin_mm);
  std::vector<Heard> heard;
  bool spindle = false, dwelled = false, guided = false;
  double seconds = 0;  // of the chords before
  const ReadResult result =
      read_program(text, reader_dialect(p.machine.controller), p.machine, setup, [&](const ProgramStep& step) {
        if (step.kind == ProgramStep::kSpindle) spindle = step.number == 3 && step.rpm == p.motion.spindle_rpm;
        if (step.kind == ProgramStep::kDwell) dwelled = spindle && step.seconds >= 8;
        if (step.kind != ProgramStep::kMove) return;
        if (!step.rapid) {
          EXPECT_TRUE(spindle && dwelled) << "line " << step.line;
        }
        guided = guided || step.tcp;
        seconds += step.seconds;
        if (!step.whole) return;
        const AxisValues& q = step.target;
        heard.push_back({step, view.cutter({q[0], q[1], q[2], q[3], q[4]}, p.motion.cutter.length_mm)});
        heard.back().step.seconds = seconds;
        seconds = 0;
      });
  EXPECT_FALSE(result.error) << "line " << result.error->line << ": " << result.error->rule << "\n" << text;
  EXPECT_TRUE(result.ended);
  EXPECT_EQ(guided, tcp);
  return heard;
}

class ProgramRoundTrip : public testing::TestWithParam<Case> {};

TEST_P(ProgramRoundTrip, EveryPlannedMoveArrivesInItsTime) {
  const Planned p = plan(GetParam().controller, GetParam().turning);
  std::size_t next = 0;
  double seconds = 0, planned = 0;
  for (const auto& [step, pose] : hear(p, GetParam().tcp)) {
    if (!step.rapid) seconds += step.seconds;
    if (next == p.motion.moves.size()) continue;
    const AxisMove& move = p.motion.moves[next];
    const ToolPose want = forward(p.machine, p.work, p.motion.cutter.length_mm, move.joints);
    // Elsewhere it is on the way: over the top, or in a block that turns before it moves.
    if ((pose.tip_mm - want.tip_mm).norm() > kTip_mm || (pose.axis - want.axis).norm() > kAxis_rad) continue;
    EXPECT_EQ(step.rapid, move.kind == MoveKind::kRapid) << "line " << step.line;
    if (!step.tcp) {
      EXPECT_NEAR(step.target[0], move.joints.x_mm, 6e-5);
      EXPECT_NEAR(step.target[1], move.joints.y_mm, 6e-5);
      EXPECT_NEAR(step.target[2], move.joints.z_mm, 6e-5);
    }
    planned += move.seconds;
    ++next;
  }
  EXPECT_EQ(next, p.motion.moves.size()) << "the plan does not arrive whole";
  EXPECT_GE(seconds, planned * (1 - 1e-5)) << "feeds are rounded down; only the ends' four decimals may shorten a way";
  const bool whole_ms = GetParam().controller == "heidenhain" && GetParam().turning && !GetParam().tcp;
  EXPECT_LE(seconds, planned * 1.01 + (whole_ms ? 1e-3 * static_cast<double>(p.motion.moves.size()) : 0));
}

std::vector<Case> all_cases() {
  std::vector<Case> cases;
  for (const char* controller : {"linuxcnc", "fanuc", "siemens", "heidenhain", "heidenhain_iso"}) {
    for (const bool tcp : {false, true}) {
      for (const bool turning : {false, true}) {
        if (std::string(controller) == "heidenhain_iso" && turning && !tcp) continue;  // has no word for a time
        cases.push_back({controller, tcp, turning});
      }
    }
  }
  return cases;
}

INSTANTIATE_TEST_SUITE_P(Controls, ProgramRoundTrip, testing::ValuesIn(all_cases()), [](const auto& it) {
  return it.param.controller + (it.param.tcp ? "_tcp" : "") + (it.param.turning ? "_turning" : "_fixed");
});

// One plan, through the post's kinematics and through the control's: the same tip at every programmed point, and the
// same time to it.
TEST(ProgramRoundTripBothWays, TheTipPathIsTheSame) {
  for (const char* controller : {"linuxcnc", "fanuc", "siemens", "heidenhain"}) {
    for (const bool turning : {false, true}) {
      const Planned p = plan(controller, turning);
      std::vector<Heard> cuts[2];
      for (const bool tcp : {false, true}) {
        for (const Heard& h : hear(p, tcp)) {
          if (!h.step.rapid) cuts[tcp ? 1 : 0].push_back(h);
        }
      }
      ASSERT_EQ(cuts[0].size(), cuts[1].size()) << controller;
      for (std::size_t i = 0; i < cuts[0].size(); ++i) {
        EXPECT_LT((cuts[0][i].pose.tip_mm - cuts[1][i].pose.tip_mm).norm(), kTip_mm) << controller << " " << i;
        EXPECT_LT((cuts[0][i].pose.axis - cuts[1][i].pose.axis).norm(), 1e-9) << controller << " " << i;
        // Short ways feel the last decimal, and FT its millisecond.
        const double s0 = cuts[0][i].step.seconds, s1 = cuts[1][i].step.seconds;
        EXPECT_NEAR(s0, s1, 0.01 * s0 + 1e-3) << controller << " " << i;
      }
    }
  }
}

// Cut for the control's tool-centre-point control, moves are longer; between their ends, where the control is on its
// own, tip and ball's centre keep their lines and no axis is too fast.
TEST(ProgramRoundTripGuided, TheControlKeepsTipAndCentreOnTheirLines) {
  for (const char* controller : {"linuxcnc", "fanuc", "siemens", "heidenhain", "heidenhain_iso"}) {
    Planned p = plan(controller, true);
    p.machine.inner.max_speed_rad_per_s = 0.5;  // so that it matters
    const ToolPath path = test::lead_rows(20 * test::kDeg, 2, 12);
    MotionOptions options;
    options.tcp = true;
    const std::size_t free = p.motion.moves.size();
    p.motion = plan_motion(p.machine, p.work, path, options);
    EXPECT_LT(p.motion.moves.size(), free * 2 / 3) << controller;
    EXPECT_GT(p.motion.slowed_moves, 0U);
    const std::string text = write_text(p, true);
    WorkpieceView view(p.machine, p.work.origin_mm);
    AxisValues before{};
    bool known = false;
    std::size_t cut = 0;
    double tip = 0, centre = 0, ratio = 0;
    ReaderSetup setup;
    setup.offsets[1] = {p.work.origin_mm.x(), p.work.origin_mm.y(), p.work.origin_mm.z(), 0, 0};
    setup.tool_length_mm = {{path.cutter.number, path.cutter.length_mm}};
    const ReadResult result =
        read_program(text, reader_dialect(controller), p.machine, setup, [&](const ProgramStep& step) {
          if (step.kind != ProgramStep::kMove) return;
          const AxisValues& q = step.target;
          if (step.tcp && !step.rapid) {
            ++cut;
            const ToolPose at = view.cutter({q[0], q[1], q[2], q[3], q[4]}, path.cutter.length_mm);
            const Vec3 ball = at.tip_mm + 2 * at.axis;
            double tip_off = 1e9, centre_off = 1e9;
            for (std::size_t i = 1; i < path.moves.size(); ++i) {
              const auto off = [](const Vec3& x, const Vec3& a, const Vec3& b) {
                const double t = std::clamp((x - a).dot(b - a) / std::max((b - a).squaredNorm(), 1e-12), 0.0, 1.0);
                return (x - a - t * (b - a)).norm();
              };
              const ToolPose &a = path.moves[i - 1].pose, &b = path.moves[i].pose;
              tip_off = std::min(tip_off, off(at.tip_mm, a.tip_mm, b.tip_mm));
              // The centre's course is an arc of the great circle over the tip's line: sampled.
              for (int k = 0; k < 64; ++k) {
                const double turn = std::acos(std::min(1.0, a.axis.dot(b.axis)));
                const auto over = [&](double s) {
                  const Vec3 axis =
                      turn < 1e-6
                          ? b.axis
                          : Vec3((std::sin((1 - s) * turn) * a.axis + std::sin(s * turn) * b.axis) / std::sin(turn));
                  return Vec3(a.tip_mm + s * (b.tip_mm - a.tip_mm) + 2 * axis);
                };
                centre_off = std::min(centre_off, off(ball, over(k / 64.0), over((k + 1) / 64.0)));
              }
            }
            tip = std::max(tip, tip_off);
            centre = std::max(centre, centre_off);
            if (known && step.seconds > 2e-3) ratio = std::max(ratio, std::abs(q[4] - before[4]) / step.seconds / 0.5);
          }
          before = q;
          known = step.tcp;
        });
    EXPECT_FALSE(result.error) << result.error->rule;
    EXPECT_GT(cut, 500U);
    EXPECT_LT(tip, 2e-4 + 1e-4) << controller << ": tolerance and last decimal";
    EXPECT_LT(centre, 2e-4 + 1e-4) << controller;
    EXPECT_LT(ratio, 1.02) << controller;
    EXPECT_GT(ratio, 0.9) << controller;
    EXPECT_THROW(write_text(p, false), InputError) << "such a motion needs the control";
  }
}

// Arcs are chords here; every one of them lies by the planned straight moves, on every control that takes arcs.
TEST(ProgramRoundTripArcs, TheTipStaysByThePlannedLines) {
  constexpr double kArc_mm = 2e-4;
  for (const Case& c : {Case{"linuxcnc", false, false}, {"linuxcnc", true, false}, {"fanuc", false, false}, {"fanuc", true, false}}) {
    Planned p = plan(c.controller, false);
    const ToolPath path = test::fixed_rows(25 * test::kDeg, 0, 2, 150);
    p.motion = plan_motion(p.machine, p.work, path);
    ProgramOptions options;
    options.decimals = 4;
    options.tcp = c.tcp;
    options.arc_tolerance_mm = kArc_mm;
    const Program program = write_program(p.machine, p.work, p.motion, options);
    ASSERT_GT(program.arcs, 10U);
    ReaderSetup setup;
    setup.offsets[1] = {p.work.origin_mm.x(), p.work.origin_mm.y(), p.work.origin_mm.z(), 0, 0};
    setup.tool_length_mm = {{path.cutter.number, path.cutter.length_mm}};
    WorkpieceView view(p.machine, p.work.origin_mm);
    double worst = 0, seconds = 0, planned = 0;
    std::size_t chords = 0, arrived = 0;
    const ReadResult result =
        read_program(program.text, reader_dialect(c.controller), p.machine, setup, [&](const ProgramStep& step) {
          if (step.kind != ProgramStep::kMove || step.rapid) return;
          const AxisValues& q = step.target;
          const Vec3 tip = view.cutter({q[0], q[1], q[2], q[3], q[4]}, path.cutter.length_mm).tip_mm;
          double nearest = 1e9;
          for (std::size_t i = 1; i < path.moves.size(); ++i) {
            const Vec3 a = path.moves[i - 1].pose.tip_mm, b = path.moves[i].pose.tip_mm;
            const double t = std::clamp((tip - a).dot(b - a) / std::max((b - a).squaredNorm(), 1e-12), 0.0, 1.0);
            nearest = std::min(nearest, (tip - a - t * (b - a)).norm());
          }
          worst = std::max(worst, nearest);
          seconds += step.seconds;
          ++chords;
          arrived += step.whole;
        });
    EXPECT_FALSE(result.error) << "line " << result.error->line << ": " << result.error->rule;
    EXPECT_LT(worst, kArc_mm + kTip_mm) << c.controller << ": tolerance and last decimals";
    EXPECT_GT(chords, arrived);
    for (const AxisMove& move : p.motion.moves) planned += move.seconds;
    EXPECT_GE(seconds, planned * (1 - 1e-5));
    EXPECT_LE(seconds, planned * 1.01);
  }
}

// Any chain, rotary axes as measured (not square), pivots that meet nowhere, either sign: what is written is read back.
RC_GTEST_PROP(ProgramRoundTripAnyMachine, EveryPlannedPoseArrives, ()) {
  static const std::vector<Case> cases = all_cases();
  const Case c = cases[static_cast<std::size_t>(*rc::gen::inRange(0, static_cast<int>(cases.size())))];
  const auto off = [](double most) { return test::real(-most, most); };
  Planned p;
  MachineModel& m = p.machine;
  m = test::hostile_machine();
  m.controller = c.controller;
  m.has_tcp = true;
  m.chain = *rc::gen::element(Chain::kTableTable, Chain::kHeadTable, Chain::kHeadHead);
  m.x.min_mm = m.y.min_mm = m.z.min_mm = -1000;
  m.x.max_mm = m.y.max_mm = 1000;
  m.outer.letter = *rc::gen::element('A', 'B');
  m.outer.axis = (m.outer.letter == 'A' ? Vec3::UnitX() : Vec3::UnitY()) + Vec3(off(0.02), off(0.02), off(0.02));
  m.outer.axis.normalize();
  m.inner.axis = (Vec3::UnitZ() + Vec3(off(0.02), off(0.02), 0)).normalized();
  m.outer.on_head = m.chain != Chain::kTableTable;
  m.inner.on_head = m.chain == Chain::kHeadHead;
  for (RotaryAxis* axis : {&m.outer, &m.inner}) {
    axis->direction = *rc::gen::element(-1.0, 1.0);
    axis->point_mm = axis->on_head ? Vec3(off(20), off(20), off(60)) : Vec3(off(20), off(20), -380 + off(30));
  }
  p.work = work_on_table(m, {off(40), off(40), 30}, 55);
  ToolPath path =
      c.turning ? test::lead_rows(test::real(0.1, 0.4), 1, 3) : test::fixed_rows(test::real(0.1, 0.6), off(3), 1, 4);
  path.cutter.length_mm = test::real(60, 110);
  p.motion = plan_motion(m, p.work, path);

  std::size_t next = 0;
  double worst = 0;
  for (const auto& [step, pose] : hear(p, c.tcp)) {
    if (next == p.motion.moves.size()) break;
    const ToolPose want = forward(m, p.work, path.cutter.length_mm, p.motion.moves[next].joints);
    const double tip = (pose.tip_mm - want.tip_mm).norm();
    // Angles of four decimals at the end of an arm of half a metre.
    if (tip > 6e-4 || (pose.axis - want.axis).norm() > kAxis_rad) continue;
    if (step.tcp) worst = std::max(worst, tip);
    ++next;
  }
  RC_ASSERT(next == p.motion.moves.size());
  RC_ASSERT(worst < 1e-4);  // under TCP the tip itself is written, to half a last decimal in each direction
}

}  // namespace
}  // namespace lightmill

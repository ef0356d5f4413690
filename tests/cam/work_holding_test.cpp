#include "cam/work_holding.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <tuple>

#include "cam/finishing.h"
#include "cam/roughing.h"
#include "design/core/errors.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::spline_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

template <class Plan>
std::string refusal(const Plan& plan) {
  try {
    plan();
  } catch (const InputError& e) {
    return e.what();
  }
  return "planned";
}

SplineSurface lens() {
  return spline_of(Box2::centred({20, 16}), 40, 32, [](double x, double y) { return 12 + 0.03 * x + 0.1 * std::sin(0.4 * y); });
}

TEST(WorkHolding, JawsBelowThePathsAreMilledOverAndHigherOnesRefusedWithThePlace) {
  const SplineSurface s = lens();
  Blank blank{{20, 16}, 13.2};
  const Cutter mill = test::cutter("rough_10mm"), ball = test::cutter("finish_4mm_ball");
  blank.keep_outs = vise_jaws(blank.size_mm, {30, 15, 4});
  EXPECT_EQ(refusal([&] { plan_roughing(s, blank, mill, {}); }), "planned");
  EXPECT_EQ(refusal([&] { plan_finishing(s, blank, ball, {}); }), "planned");
  blank.keep_outs = vise_jaws(blank.size_mm, {30, 15, 12.5});
  EXPECT_THAT(refusal([&] { plan_roughing(s, blank, mill, {}); }), AllOf(HasSubstr("rough: the cutter or shank"), HasSubstr("holds the work near x"), HasSubstr("z 13.0")));
  EXPECT_THAT(refusal([&] { plan_finishing(s, blank, ball, {}); }), AllOf(HasSubstr("finish"), HasSubstr("near x")));
}

TEST(WorkHolding, NoCutterGoesBelowTheBackOfTheBlank) {
  // The lowest place of a leaning ball lies below its tip, that of a flat mill on its rim.
  const double lean = 0.5;
  const Vec3 axis(std::sin(lean), 0, std::cos(lean));
  for (const auto& [name, corner, below_tip] :
       {std::tuple("finish_4mm_ball", 2.0, 2 * (1 - std::cos(lean))), {"rough_10mm", 0.5, 0.5 * (1 - std::cos(lean)) + 4.5 * std::sin(lean)}}) {
    ToolPath path;
    path.pass = "finish";
    path.cutter = test::cutter(name);
    ASSERT_EQ(path.cutter.corner_radius_mm, corner);
    path.moves.push_back({{Vec3(3, 2, below_tip + 1e-4), axis}, MoveKind::kCut, 10});
    EXPECT_EQ(refusal([&] { refuse_contact(path, {}); }), "planned");
    path.moves.back().pose.tip_mm.z() -= 0.05;
    EXPECT_THAT(refusal([&] { refuse_contact(path, {}); }), HasSubstr("0.05 mm below the back of the blank near x 3.0, y 2.0"));
  }
}

TEST(WorkHolding, RapidsStayAboveTheHighestClamp) {
  const SplineSurface s = lens();
  Blank blank{{20, 16}, 13.2};
  blank.keep_outs = {{{60, -5, 0}, {70, 5, 40}}};  // far beside, but high
  const ToolPath path = plan_roughing(s, blank, test::cutter("rough_10mm"), {});
  EXPECT_GE(path.clearance_z_mm, 45);
  EXPECT_EQ(highest_obstacle_mm(blank), 40);
}

TEST(WorkHolding, AClampBesideTheBlankTurnsTheFixedTiltAway) {
  const SplineSurface s = lens();
  Blank blank{{20, 16}, 13.2};
  const Cutter ball = test::cutter("finish_4mm_ball");
  const ToolPath free = plan_finishing(s, blank, ball, {});
  EXPECT_LT(free.moves.back().pose.axis.y(), -0.4) << "the usual tilt leans to -Y";
  // A post at -Y that the leaning holder would meet, out of the ball's own way.
  blank.keep_outs = {{{-12, -40, 0}, {12, -26, 35.6}}};
  const ToolPath path = plan_finishing(s, blank, ball, {});
  EXPECT_GT((path.moves.back().pose.axis - free.moves.back().pose.axis).norm(), 0.02);
  EXPECT_EQ(refusal([&] { refuse_contact(path, blank.keep_outs); }), "planned");
  EXPECT_NE(refusal([&] { refuse_contact(free, blank.keep_outs); }), "planned");
}

TEST(WorkHolding, AnyPartOfTheToolCountsOnAnyMove) {
  ToolPath path;
  path.pass = "finish";
  path.cutter = test::cutter("finish_4mm_ball");
  const auto at = [](double x, double z) { return ToolPose{{x, 0, z}, Vec3::UnitZ()}; };
  path.moves = {{at(-50, 30), MoveKind::kRapid, 0}, {at(50, 30), MoveKind::kLink, 80}};
  const auto box = [](double z0, double z1, double y) { return std::vector<KeepOut>{{{-1, y, z0}, {1, y + 1, z1}}}; };
  EXPECT_EQ(refusal([&] { refuse_contact(path, box(0, 29, 0)); }), "planned");
  EXPECT_THAT(refusal([&] { refuse_contact(path, box(0, 29.8, 0)); }), HasSubstr("on the way")) << "nearer than half a millimetre";
  EXPECT_EQ(refusal([&] { refuse_contact(path, box(0, 60, 4)); }), "planned") << "beside the shank, below the holder";
  EXPECT_THAT(refusal([&] { refuse_contact(path, box(0, 63, 4)); }), HasSubstr("the holder"));
}

TEST(WorkHolding, RoughingGoesAroundClampsOnTheBlank) {
  // The blank is 14 mm larger all around than the lens: room for the mill between lens and clamps.
  const auto s = spline_of(Box2::centred({12, 10}), 20, 20, [](double x, double y) { return 14 + 0.4 * std::sin(x / 4) * std::cos(y / 5); });
  const Cutter mill = test::cutter("rough_10mm");
  Blank blank{{40, 38}, s.highest() + 0.6};
  const ToolPath free = plan_roughing(s, blank, mill, {});
  for (const double y : {-10.0, 6.0}) {
    blank.keep_outs.push_back({{-60, y, 0}, {-17.5, y + 4, 27}});
    blank.keep_outs.push_back({{17.5, y, 0}, {60, y + 4, 27}});
  }
  EXPECT_NE(refusal([&] { refuse_contact(free, blank.keep_outs); }), "planned") << "a plan that does not know of them runs into them";
  const ToolPath around = plan_roughing(s, blank, mill, {});  // which looks at its own path
  // By brute force: no place of the mill, at any pose, is within a box.
  double lowest = 1e9;
  for (std::size_t k = 1; k < around.moves.size(); ++k) {
    for (int t = 0; t <= 10; ++t) {
      const Vec3 p = around.moves[k - 1].pose.tip_mm + t / 10.0 * (around.moves[k].pose.tip_mm - around.moves[k - 1].pose.tip_mm);
      for (const KeepOut& box : blank.keep_outs) {
        const double x = std::max({box.min_mm.x() - p.x(), p.x() - box.max_mm.x(), 0.0});
        const double y = std::max({box.min_mm.y() - p.y(), p.y() - box.max_mm.y(), 0.0});
        if (std::hypot(x, y) < 5) lowest = std::min(lowest, p.z() - box.max_mm.z());
      }
    }
  }
  EXPECT_GT(lowest, 0) << "the mill within a clamp";
  EXPECT_LT(lowest, 10) << "nothing near a clamp: the test sees nothing";
  // Still all of the lens is roughed.
  EXPECT_LT(around.predicted_cusp_um, free.predicted_cusp_um + 50);
}

}  // namespace
}  // namespace lightmill

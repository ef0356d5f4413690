// Parts cut out by cam's own tool paths, and with faults planted in them.
#include "machine/cut_out.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>

#include "cam/profile.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

constexpr double kPitch_mm = 0.2;
/// The way around stands off by at most 6 um.
constexpr double kStandOff_um = 6.5;

const Blank kBlank{{44, 40}, 5};
const Outline kRectangle{Outline::Shape::kRectangle, {30, 24}, {}};
const Outline kDisk{Outline::Shape::kDisk, {26, 26}, {}};

Outline bean() {
  Outline outline;
  outline.shape = Outline::Shape::kLoop;
  for (int k = 0; k < 180; ++k) {
    const double t = 2 * kPi * k / 180;
    const double r = 12 + 1.5 * std::cos(2 * t);
    outline.loop_mm.emplace_back(r * std::cos(t), 0.9 * r * std::sin(t));
  }
  return outline;
}

Cutter mill() {
  Cutter cutter = read_cutter(std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters" / "rough_10mm.toml");
  cutter.diameter_mm = 4;
  cutter.corner_radius_mm = 0.2;
  return cutter;
}

ProfileOptions profile() {
  ProfileOptions options;
  options.tabs = 3;
  options.tab_width_mm = 2;
  options.tab_height_mm = 0.6;
  return options;
}

SplineSurface flat() {
  return test::spline_of(Box2::centred({44, 40}), 20, 20, [](double, double) { return 4; });
}

/// What the planned path leaves, changed by `plant`.
SolidStock cut_out(const Outline& outline, const std::function<void(std::vector<Move>&)>& plant = {}) {
  ToolPath path = plan_profile(flat(), kBlank, outline, mill(), profile());
  if (plant) plant(path.moves);
  SolidStock solid(kBlank, kPitch_mm);
  solid.set_cutter(mill());
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (path.moves[k].kind != MoveKind::kRapid) solid.cut(path.moves[k - 1].pose, path.moves[k].pose);
  }
  solid.flush();
  return solid;
}

WallDeviation walls_of(const SolidStock& solid, const Outline& outline) { return measure_walls(solid, outline, 1, 3.9); }
std::vector<Tab> tabs_of(const SolidStock& solid, const Outline& outline) {
  return find_tabs(solid, outline, 4, (profile().skin_mm + profile().tab_height_mm) / 2);
}

TEST(CutOut, WallsStandOnTheOutlineAndTabsHoldThePart) {
  for (const Outline& outline : {kRectangle, kDisk, bean()}) {
    const SolidStock solid = cut_out(outline);
    const WallDeviation walls = walls_of(solid, outline);
    EXPECT_GT(walls.places, 3000);
    EXPECT_LT(walls.max_left_um, kStandOff_um);
    EXPECT_LT(walls.max_gouge_um, 0.5);
    const std::vector<Tab> tabs = tabs_of(solid, outline);
    ASSERT_EQ(tabs.size(), 3U);
    for (const Tab& tab : tabs) {
      EXPECT_NEAR(tab.height_mm, 0.6, 0.003);
      // 2 % below its top the ramps add 0.23 and the mill's corner 0.2 on either side.
      EXPECT_NEAR(tab.width_mm, 2.9, 0.25);
    }
    // The skin is one bridge all around.
    EXPECT_EQ(find_tabs(solid, outline, 4, 0.05).size(), 1U);
    EXPECT_EQ(solid.pieces().size(), 1U);
  }
}

TEST(CutOut, ATabThatIsCutThroughIsMissed) {
  const Outline& outline = kRectangle;
  const Tab first = tabs_of(cut_out(outline), outline).front();
  const auto through_a_tab = [&](std::vector<Move>& moves) {
    for (Move& move : moves) {
      Vec3& tip = move.pose.tip_mm;
      if ((tip.head<2>() - first.place_mm).norm() < 9 && tip.z() < 0.7) tip.z() = 0.1;
    }
  };
  const SolidStock solid = cut_out(outline, through_a_tab);
  EXPECT_EQ(tabs_of(solid, outline).size(), 2U);
  EXPECT_EQ(find_tabs(solid, outline, 4, 0.05).size(), 1U);
}

TEST(CutOut, APartThatIsCutFreeIsSaid) {
  const Outline& outline = kDisk;
  const SolidStock solid = cut_out(outline, [](std::vector<Move>& moves) {
    for (Move& move : moves) move.pose.tip_mm.z() -= 0.7;
  });
  EXPECT_TRUE(find_tabs(solid, outline, 4, 0.001).empty());
  const auto pieces = solid.pieces();
  ASSERT_GE(pieces.size(), 2U);
  EXPECT_NEAR(pieces[1].volume_mm3 / (kPi * 13 * 13 * 5), 1, 2e-3);
}

TEST(CutOut, AWallThatIsOffIsMeasured) {
  // The whole way 50 um to +x: a gouge on one side, material left on the other.
  const SolidStock solid = cut_out(kDisk, [](std::vector<Move>& moves) {
    for (Move& move : moves) move.pose.tip_mm.x() += 0.05;
  });
  const WallDeviation walls = walls_of(solid, kDisk);
  EXPECT_NEAR(walls.max_gouge_um, 50, kStandOff_um);
  EXPECT_NEAR(walls.max_left_um, 50, kStandOff_um);
  EXPECT_LT(walls.gouge_place_mm.x(), -12);
  EXPECT_GT(walls.left_place_mm.x(), 12);
  // Nothing was cut at all: no wall is found.
  const WallDeviation none = walls_of(SolidStock(kBlank, kPitch_mm), kDisk);
  EXPECT_EQ(none.max_left_um, 1000);
}

}  // namespace
}  // namespace lightmill

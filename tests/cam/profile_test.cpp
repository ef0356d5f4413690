#include "cam/profile.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>

#include "cam/outline_region.h"
#include "design/core/errors.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;

Cutter mill() { return read_cutter(std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters" / "rough_10mm.toml"); }

const Outline kDisk{Outline::Shape::kDisk, {60, 60}, {}};
const Outline kRectangle{Outline::Shape::kRectangle, {50, 40}, {}};

SplineSurface dome() {
  return test::spline_of(Box2::centred({60, 60}), 60, 60, [](double x, double y) { return 11 - 0.001 * (x * x + y * y) + 0.005 * x; });
}

ProfileOptions with_land() {
  ProfileOptions options;
  options.land_mm = 4;
  options.land_z_mm = 8;
  return options;
}

class CutOut : public ::testing::TestWithParam<bool> {};

TEST_P(CutOut, StaysOutsideThePartGoesDownGentlyAndLeavesTabsAndSkin) {
  const bool land = GetParam();
  const SplineSurface s = dome();
  const Blank blank{{100, 100}, 12};
  const ProfileOptions options = land ? with_land() : ProfileOptions();
  const Cutter cutter = mill();
  const Outline& optical = land ? kRectangle : kDisk;
  const ToolPath path = plan_profile(s, blank, optical, cutter, options);
  const std::vector<Vec2> optical_loop = outline_places(optical, 0.05);
  const std::vector<Vec2> part_loop = outline_places(lightmill::with_land(optical, options.land_mm), 0.05);
  EXPECT_EQ(path.moves.front().kind, MoveKind::kRapid);
  EXPECT_EQ(path.moves.back().kind, MoveKind::kRapid);
  double lowest = 100, turned = 0, on_bottom = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const Vec3& a = path.moves[k - 1].pose.tip_mm;
    const Vec3& b = path.moves[k].pose.tip_mm;
    const double level = (b - a).head<2>().norm();
    const bool cut = path.moves[k].kind == MoveKind::kCut || path.moves[k].kind == MoveKind::kPlunge;
    if (!cut) {
      EXPECT_TRUE(path.moves[k].kind == MoveKind::kLink || std::min(a.z(), b.z()) >= path.clearance_z_mm - 1e-9);
      continue;
    }
    // Down at 3 degrees at most, plus the helix over a tab's ramp.
    EXPECT_LE(a.z() - b.z(), 0.0525 * level + 1e-9);
    EXPECT_EQ(path.moves[k].kind == MoveKind::kPlunge, b.z() < a.z() - 1e-9);
    lowest = std::min(lowest, b.z());
    turned += a.x() * b.y() - a.y() * b.x();
    if (std::max(a.z(), b.z()) <= options.skin_mm + 1e-9) on_bottom += level;
    // Below its top the part stays whole: the optical body above the land, the part below it.
    const Vec2 middle = (a + b).head<2>() / 2;
    EXPECT_GE(distance_to_loop(optical_loop, middle), 5 - 1e-4);
    if (land && b.z() < options.land_z_mm - 1e-9) {
      EXPECT_GE(distance_to_loop(part_loop, middle), 5 - 1e-4);
    }
  }
  EXPECT_DOUBLE_EQ(lowest, options.skin_mm);
  EXPECT_LT(turned, 0) << "clockwise: climb milling at the part";
  // Once around on the bottom but for the tabs and their ramps.
  const double around = land ? 2 * (58 + 48) + 10 * kPi : 70 * kPi;
  const double at_tabs = options.tabs * (options.tab_width_mm + 10 + 2 * (options.tab_height_mm - options.skin_mm) / 0.0524);
  EXPECT_NEAR(on_bottom, around - at_tabs, 0.02 * around);
}

INSTANTIATE_TEST_SUITE_P(WithAndWithoutLand, CutOut, ::testing::Bool());

TEST(Tabs, BecomeFewerThenSmallerWhereThePartIsSmall) {
  const auto fitted = [](double diameter) { return with_fitting_tabs({}, {Outline::Shape::kDisk, {diameter, diameter}, {}}, mill()); };
  const ProfileOptions whole;
  const auto way = [](const ProfileOptions& o) { return o.tabs * (o.tab_width_mm + 10 + 2 * (o.tab_height_mm - o.skin_mm) / 0.0524); };
  const auto around = [](double diameter) { return kPi * (diameter + 10); };
  EXPECT_EQ(fitted(60).tabs, 4);
  const ProfileOptions three = fitted(40);
  EXPECT_EQ(three.tabs, 3);
  EXPECT_EQ(three.tab_width_mm, whole.tab_width_mm);
  EXPECT_EQ(three.tab_height_mm, whole.tab_height_mm);
  const ProfileOptions smaller = fitted(28);
  EXPECT_EQ(smaller.tabs, 3);
  EXPECT_NEAR(way(smaller), around(28), 0.05);  // the way is up to 6 um outside the offset
  EXPECT_GT(smaller.tab_width_mm, 2);
  EXPECT_GT(smaller.tab_height_mm, 0.5);
  EXPECT_LT(smaller.tab_height_mm, 1);
  EXPECT_EQ(fitted(15).tabs, 4) << "not even three of the least: refused as asked for";
  ProfileOptions none;
  none.tabs = 0;
  EXPECT_EQ(with_fitting_tabs(none, {Outline::Shape::kDisk, {5, 5}, {}}, mill()).tabs, 0);
  // What fits is planned.
  for (const double diameter : {40.0, 28.0}) {
    const SplineSurface s = test::spline_of(Box2::centred({diameter, diameter}), 20, 20, [](double, double) { return 4.0; });
    EXPECT_NO_THROW(plan_profile(s, {Vec2::Constant(diameter + 24), 4.5}, {Outline::Shape::kDisk, {diameter, diameter}, {}}, mill(), fitted(diameter)));
  }
}

// What the refusal names is planned, and one tab more is not.
TEST(Tabs, ARefusalNamesWhatFits) {
  for (const double diameter : {2.0, 4.0, 8.0, 15.0}) {
    const SplineSurface s = test::spline_of(Box2::centred({diameter, diameter}), 20, 20, [](double, double) { return 3.0; });
    const Blank blank{Vec2::Constant(diameter + 24), 3.5};
    const Outline disk{Outline::Shape::kDisk, {diameter, diameter}, {}};
    std::string message = "no error";
    try {
      plan_profile(s, blank, disk, mill(), {});
    } catch (const InputError& e) {
      message = e.what();
    }
    std::smatch whole, least;
    const bool named = std::regex_search(message, whole, std::regex("profile.tabs = (\\d+) fits"));
    const bool named_least = std::regex_search(message, least, std::regex("(\\d+) with profile.tab_width_mm = 2 and profile.tab_height_mm = 0.5"));
    ASSERT_TRUE(named || named_least) << message;
    for (const bool small : {false, true}) {
      if (small ? !named_least : !named) continue;
      ProfileOptions options;
      options.tabs = std::stoi((small ? least : whole)[1]);
      if (small) options.tab_width_mm = 2, options.tab_height_mm = 0.5;
      EXPECT_NO_THROW(plan_profile(s, blank, disk, mill(), options)) << diameter << ": " << message;
      ++options.tabs;
      EXPECT_THROW(plan_profile(s, blank, disk, mill(), options), InputError) << diameter << ": " << message;
    }
  }
}

TEST(CutOutDepth, ATurnTakesNoMoreThanTheStepdown) {
  // Highest cut at any angle against the one a turn earlier.
  const ToolPath path = plan_profile(dome(), {{100, 100}, 12}, kDisk, mill(), {});
  std::vector<double> last(360, 1e9);
  for (const Move& m : path.moves) {
    if (m.kind != MoveKind::kCut && m.kind != MoveKind::kPlunge) continue;
    double& before = last[static_cast<int>(std::floor((std::atan2(m.pose.tip_mm.y(), m.pose.tip_mm.x()) + kPi) / (2 * kPi) * 359.99))];
    EXPECT_TRUE(before > 1e8 || before - m.pose.tip_mm.z() <= 1.02) << m.pose.tip_mm.transpose();
    before = std::min(before, m.pose.tip_mm.z());
  }
}

TEST(CutOutErrors, NameWhatIsWrong) {
  const SplineSurface s = dome();
  const auto message = [&](const Outline& outline, const Blank& blank, const Cutter& cutter, const ProfileOptions& options) {
    try {
      plan_profile(s, blank, outline, cutter, options);
    } catch (const InputError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  const Blank blank{{100, 100}, 12};
  Cutter stubby = mill();
  stubby.flute_length_mm = 8;
  EXPECT_THAT(message(kDisk, blank, stubby, {}), HasSubstr("longer flutes"));
  ProfileOptions many;
  many.tabs = 20;
  EXPECT_THAT(message(kDisk, blank, mill(), many), HasSubstr("20 tabs"));
  ProfileOptions low = with_land();
  low.land_z_mm = 0.5;
  EXPECT_THAT(message(kRectangle, blank, mill(), low), HasSubstr("land_drop_mm"));
  ProfileOptions steep;
  steep.stepdown_mm = 5;
  EXPECT_THAT(message({Outline::Shape::kDisk, {4, 4}, {}}, blank, mill(), steep), HasSubstr("too short to go down"));
}

}  // namespace
}  // namespace lightmill

#include "cam/roughing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <random>
#include <set>

#include "cam/outline.h"
#include "design/core/errors.h"
#include "tests/cam/path_check.h"

namespace lightmill {
namespace {

using test::spline_of;

Cutter mill() {
  return read_cutter(std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters" / "rough_10mm.toml");
}

/// Height of the bull-nose's surface above its tip.
double above_tip(const Cutter& c, double r) {
  const double e = r - (c.radius_mm() - c.corner_radius_mm);
  return e <= 0 ? 0 : c.corner_radius_mm - std::sqrt(std::max(0.0, c.corner_radius_mm * c.corner_radius_mm - e * e));
}

/// The test's own stock: a height field from which moves take what the cutter sweeps, sampled densely in time order.
struct OwnStock {
  static constexpr double kPitch = 0.37;
  OwnStock(const Blank& blank, const Cutter& cutter) : size(blank.size_mm), tool(cutter) {
    nx = static_cast<int>(size.x() / kPitch);
    ny = static_cast<int>(size.y() / kPitch);
    heights = Grid<double>(nx + 1, ny + 1, blank.height_mm);
  }
  [[nodiscard]] double x(int i) const { return -size.x() / 2 + i * kPitch; }
  [[nodiscard]] double y(int j) const { return -size.y() / 2 + j * kPitch; }
  /// What a move meets: the deepest cut, that under the inner half of the cutter, and how wide, counted in strips along the
  /// move within a millimetre of it, it engages deeper than it may over its full width.
  struct Engagement {
    double deepest = 0;
    double core = 0;
    double width = 0;
    double against_mm = 0;  ///< way on which it lies to the left alone: not climb milling
    double cut_mm = 0;      ///< way in material
  };
  /// Removes along a move.
  Engagement sweep(const Vec3& a, const Vec3& b, bool cut) {
    Engagement e;
    const Vec2 along = (b - a).head<2>().norm() > 1e-9 ? Vec2((b - a).head<2>().normalized()) : Vec2(Vec2::Zero());
    const int strip_count = 2 * static_cast<int>(tool.radius_mm() / kPitch) + 3;
    std::vector<double> met_at(strip_count, -1e9), touched_at(strip_count, -1e9);
    const int steps = 1 + static_cast<int>((b - a).norm() / 0.1);
    for (int k = 0; k <= steps; ++k) {
      const Vec3 p = a + (b - a) * k / steps;
      const double r = tool.radius_mm();
      const double travelled = (b - a).norm() * k / steps;
      const int i0 = std::max(0, static_cast<int>(std::ceil((p.x() - r + size.x() / 2) / kPitch)));
      const int i1 = std::min(nx, static_cast<int>(std::floor((p.x() + r + size.x() / 2) / kPitch)));
      const int j0 = std::max(0, static_cast<int>(std::ceil((p.y() - r + size.y() / 2) / kPitch)));
      const int j1 = std::min(ny, static_cast<int>(std::floor((p.y() + r + size.y() / 2) / kPitch)));
      for (int j = j0; j <= j1; ++j) {
        for (int i = i0; i <= i1; ++i) {
          const double d = std::hypot(x(i) - p.x(), y(j) - p.y());
          if (d > r) continue;
          const double z = p.z() + above_tip(tool, d);
          double& h = heights.at(i, j);
          e.deepest = std::max(e.deepest, h - z);
          if (d < r / 2) e.core = std::max(e.core, h - z);
          const double aside = (x(i) - p.x()) * along.y() - (y(j) - p.y()) * along.x();
          const int strip = static_cast<int>(std::floor(aside / kPitch + strip_count / 2.0));
          if (h - z > tool.slot_depth_mm + 0.05) met_at[strip] = travelled;
          if (h - z > 0.05) touched_at[strip] = travelled;
          if (cut && z < h) h = z;
        }
      }
      const auto touched = [&](auto first, auto last) { return std::count_if(first, last, [&](double s) { return s > travelled - 1; }); };
      const auto middle = touched_at.begin() + strip_count / 2;
      const auto left = touched(touched_at.begin(), middle), right = touched(middle + 1, touched_at.end());
      const double way = k > 0 ? (b - a).norm() / steps : 0;
      if (left + right > 0) e.cut_mm += way;
      if (left > 2 && right <= 2) e.against_mm += way;
      e.width = std::max(e.width, kPitch * static_cast<double>(std::count_if(met_at.begin(), met_at.end(), [&](double s) { return s > travelled - 1; })));
    }
    return e;
  }
  Vec2 size;
  Cutter tool;
  int nx, ny;
  Grid<double> heights;
};

/// One of the planner's rows, two of the judge's strips, and what the border of the material gains within the millimetre looked at.
constexpr double kEngagementToleranceMm = 1.2;
/// A pixel of the judge between the planner's nodes, on slopes to 1 and at walls that lines leave.
constexpr double kDepthToleranceMm = 0.45;
/// A ramp's depth on one of the planner's cells, twice: what the middle may touch where it comes down through air.
constexpr double kRampToleranceMm = 0.07;
/// The judge's share of way against the feed, where the planner counts less than half of it.
constexpr double kAgainstShare = 0.01;

struct Case {
  const char* name;
  double (*height)(double, double);
  double over;  ///< blank above the surface
  RoughWay way;
};

double hills(double x, double y) {
  return 12 + 0.6 * std::sin(x / 5) * std::cos(y / 6 + 0.4) + 0.02 * x;
}
double bowl(double x, double y) {
  return 14 - 1.2 * std::exp(-((x - 2) * (x - 2) + (y + 3) * (y + 3)) / 60);
}
double dome(double x, double y) {
  return 16 - 0.008 * (x * x + y * y);
}
double slope(double x, double y) {
  return 13 + 0.2 * x + 0.1 * y;
}

/// A hill that stands in the way of the lines: behind it, material is left that no neighbouring line has opened.
double island(double x, double y) {
  return 10 + 3.5 * std::exp(-std::pow((x * x + 1.5 * y * y) / 50, 2));
}

class Roughing : public ::testing::TestWithParam<Case> {};

TEST_P(Roughing, NeverCutsBelowTheAllowanceAndLeavesLittle) {
  const Case& c = GetParam();
  const Vec2 size(36, 30);
  const auto s = spline_of(Box2::centred(size), 90, 75, c.height);
  const Blank blank{{38, 31}, s.highest() + c.over};
  const Cutter tool = mill();
  RoughOptions options;
  options.way = c.way;
  const ToolPath path = plan_roughing(s, blank, tool, options);
  ASSERT_FALSE(path.moves.empty());

  // Brute force: places under the cutter, anywhere on any move, against surface + allowance.
  std::mt19937 random(6);
  std::uniform_real_distribution<double> u(0, 1);
  double nearest = 1e9;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const Vec3& a = path.moves[k - 1].pose.tip_mm;
    const Vec3& b = path.moves[k].pose.tip_mm;
    EXPECT_EQ(path.moves[k].pose.axis, Vec3(0, 0, 1));
    for (int m = 0; m < 60; ++m) {
      const Vec3 p = a + u(random) * (b - a);
      const double r = tool.radius_mm() * std::sqrt(u(random)), angle = 2 * kPi * u(random);
      const Vec2 q(p.x() + r * std::cos(angle), p.y() + r * std::sin(angle));
      if (std::abs(q.x()) > 19 || std::abs(q.y()) > 15.5) continue;
      nearest = std::min(nearest, p.z() + above_tip(tool, r) - s.height(q.x(), q.y()) - options.allowance_mm);
    }
  }
  EXPECT_GE(nearest, 0) << "below surface + allowance";
  EXPECT_LE(nearest, 0.3) << "needlessly far above it";

  // In time order: links and rapids meet nothing, rapids stay above clearance, a cut is never deeper than allowed.
  OwnStock stock(blank, tool);
  EXPECT_EQ(path.moves.front().kind, MoveKind::kRapid);
  EXPECT_EQ(path.moves.back().kind, MoveKind::kRapid);
  double deepest = 0, in_air = 0, steepest = 0, widest = 0, against = 0, in_material = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const Move& m = path.moves[k];
    const Vec3& a = path.moves[k - 1].pose.tip_mm;
    const Vec3& b = m.pose.tip_mm;
    const bool cut = m.kind == MoveKind::kCut || m.kind == MoveKind::kPlunge;
    if (m.kind == MoveKind::kRapid) {
      EXPECT_GE(std::min(a.z(), b.z()), path.clearance_z_mm - 1e-9);
    } else {
      EXPECT_GT(m.feed_mm_per_s, 0);
    }
    const OwnStock::Engagement met = stock.sweep(a, b, cut);
    if (!cut)
      in_air = std::max(in_air, met.deepest);
    else
      deepest = std::max(deepest, met.deepest);
    if (cut) {
      widest = std::max(widest, met.width);
      against += met.against_mm;
      in_material += met.cut_mm;
    }
    // Going down beside the block misses one that stands 0.3 mm over on each side, too.
    const auto beside = [&](double over) {
      return std::hypot(std::max(0.0, std::abs(b.x()) - 19 - over), std::max(0.0, std::abs(b.y()) - 15.5 - over));
    };
    if (!cut && b.z() < a.z() && b.z() < blank.height_mm && beside(0) > tool.radius_mm() - 0.2) {
      EXPECT_GT(beside(0.3), tool.radius_mm()) << "move " << k;
    }
    // Down at more than 3 degrees only where the cutter's middle, which does not cut, meets air.
    const double level = (b - a).head<2>().norm();
    if (cut && a.z() - b.z() > std::tan(3.1 * kPi / 180) * level + 1e-9) steepest = std::max(steepest, met.core);
  }
  EXPECT_LE(in_air, 0.03);
  EXPECT_LE(steepest, kRampToleranceMm) << "plunge into material";
  EXPECT_LE(deepest, 1.3 * options.stepdown_mm + kDepthToleranceMm) << "cut deeper than a level and what the one above left";
  EXPECT_LE(widest, options.stepover_mm + kEngagementToleranceMm) << "engaged wider than the stepover";

  EXPECT_LE(against, std::max(0.5, kAgainstShare * in_material)) << "not climb milling: " << against << " of " << in_material << " mm";

  // What stays, against the stated bound.
  double most = 0;
  for (int j = 0; j <= stock.ny; ++j) {
    for (int i = 0; i <= stock.nx; ++i) {
      if (std::abs(stock.x(i)) > 18 || std::abs(stock.y(j)) > 15) continue;
      most = std::max(most, stock.heights.at(i, j) - s.height(stock.x(i), stock.y(j)));
    }
  }
  EXPECT_LE(most * 1e3, path.predicted_cusp_um + 50);
  EXPECT_LE(most, 1.0) << "more than the ball should meet";
  EXPECT_GE(most, options.allowance_mm);
}

INSTANTIATE_TEST_SUITE_P(Surfaces, Roughing,
                         ::testing::Values(Case{"hills", hills, 0.3, RoughWay::kLevels},
                                           Case{"bowl", bowl, 0.0, RoughWay::kLayers},
                                           Case{"dome", dome, 2.5, RoughWay::kLevels},
                                           Case{"slope", slope, 0.3, RoughWay::kLayers},
                                           Case{"island", island, 0.4, RoughWay::kLevels},
                                           Case{"island_in_layers", island, 0.4, RoughWay::kLayers}),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(RoughingEntry, TheFirstCutOfALevelTakesNoMoreThanTheStepover) {
  const auto s = spline_of(Box2::centred({40, 30}), 20, 20, [](double, double) { return 10; });
  const Blank blank{{40, 30}, 12.3};
  const ToolPath path = plan_roughing(s, blank, mill(), {});
  // A flat lens: two levels; each starts outside at +y with the axis 1 mm outside the block (radius 5, stepover 4) and
  // off -x.
  double first_y = 0, first_x = 0;
  for (const Move& m : path.moves) {
    if (m.kind != MoveKind::kCut) continue;
    if (first_y == 0) first_y = m.pose.tip_mm.y();
  }
  for (const Move& m : path.moves) {
    if (m.kind == MoveKind::kRapid) {
      first_x = m.pose.tip_mm.x();
      break;
    }
  }
  EXPECT_NEAR(first_y, 15 + 5 - 4, 0.26);
  EXPECT_LT(first_x, -20 - 5 + 0.3);
  EXPECT_NEAR(path.predicted_cusp_um, 300, 60);
  OwnStock stock(blank, mill());
  double widest = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const bool cut = path.moves[k].kind == MoveKind::kCut;
    widest = std::max(widest, stock.sweep(path.moves[k - 1].pose.tip_mm, path.moves[k].pose.tip_mm, cut).width);
  }
  EXPECT_NEAR(widest, 4, kEngagementToleranceMm) << "the judge of engagement sees the stepover";
}

TEST(RoughingSlots, WhatIsWiderThanTheStepoverIsNoDeeperThanTheMillsData) {
  // A pit in a flat lens: its first lines have material to both sides.
  const auto s = spline_of(Box2::centred({44, 40}), 88, 80, [](double x, double y) {
    return 14 - 2.5 / (1 + std::exp(3 * (std::hypot(x - 2, y + 1) - 9)));
  });
  const Blank blank{{44, 40}, 14.5};
  for (const double slot : {0.0, 0.3}) {
    Cutter tool = mill();
    tool.slot_depth_mm = slot;
    const ToolPath path = plan_roughing(s, blank, tool, {});
    tool.slot_depth_mm = 0.3;
    OwnStock stock(blank, tool);
    double widest = 0;
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      const bool cut = path.moves[k].kind == MoveKind::kCut || path.moves[k].kind == MoveKind::kPlunge;
      widest = std::max(widest, stock.sweep(path.moves[k - 1].pose.tip_mm, path.moves[k].pose.tip_mm, cut).width);
    }
    if (slot == 0) {
      EXPECT_GT(widest, 6) << "no slot here: the case tests nothing";
    } else {
      EXPECT_LE(widest, RoughOptions{}.stepover_mm + kEngagementToleranceMm);
    }
  }
}

/// The time of a path by its moves alone.
double minutes_of(const ToolPath& path, double rapid_mm_per_s) {
  double s = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    const double way = (path.moves[k].pose.tip_mm - path.moves[k - 1].pose.tip_mm).norm();
    s += way / (path.moves[k].kind == MoveKind::kRapid ? rapid_mm_per_s : path.moves[k].feed_mm_per_s);
  }
  return s / 60;
}

TEST(RoughingChoice, TakesTheFasterWayAndSaysBothTimes) {
  struct Known {
    const char* why;
    double (*height)(double, double);
    double stepdown_mm;
    RoughWay faster;
  };
  const Known cases[] = {
      {"a wedge within one level that asks for lines 3 mm apart: they alone, or every 4 mm and then every 3 mm again",
       [](double, double y) { return 14 + 0.083 * y; }, 3.5, RoughWay::kLayers},
      {"a steep wedge of many levels: lines 4 mm apart in each, or eight times as close in every layer",
       [](double, double y) { return 14 + 0.7 * y; }, 1.5, RoughWay::kLevels}};
  for (const Known& known : cases) {
    const auto s = spline_of(Box2::centred({20, 16}), 40, 32, known.height);
    const Blank blank{{20, 16}, s.highest() + 0.6};
    RoughOptions options;
    options.stepdown_mm = known.stepdown_mm;
    const RoughChoice choice = plan_faster_roughing(s, blank, mill(), options);
    EXPECT_EQ(choice.way, known.faster) << known.why;
    const double levels = minutes_of(plan_roughing(s, blank, mill(), options), 200);
    options.way = RoughWay::kLayers;
    const double layers = minutes_of(plan_roughing(s, blank, mill(), options), 200);
    EXPECT_GT(std::max(levels, layers), 1.05 * std::min(levels, layers)) << known.why;
    EXPECT_NEAR(choice.levels_minutes, levels, 1e-9);
    EXPECT_NEAR(choice.layers_minutes, layers, 1e-9);
    EXPECT_NEAR(minutes_of(choice.path, 200), std::min(levels, layers), 1e-9);
  }
}

TEST(RoughingMargin, LinesComeNearerOnlyWhereTheLensAsksForIt) {
  // A wedge in a blank that is three times as wide and high.
  const auto s = spline_of(Box2::centred({20, 16}), 40, 32, [](double, double y) { return 14 + 0.25 * std::clamp(y, -8.0, 8.0); });
  Outline outline;
  outline.size_mm = {20, 16};
  const Blank blank{{60, 48}, s.highest() + 0.4};
  const ToolPath path = plan_roughing(faded_outside(s, outline, 1), blank, mill(), {});
  std::set<long> on_lens, beside;  // lines, by y
  for (const Move& m : path.moves) {
    if (m.kind != MoveKind::kCut) continue;
    const Vec3& tip = m.pose.tip_mm;
    // Beyond the mill's radius, and stretches that are milled as one.
    (std::abs(tip.x()) < 10 ? on_lens : std::abs(tip.x()) > 10 + 5 + 10 ? beside : on_lens).insert(std::lround(tip.y() * 1000));
  }
  // Every level has the same lines, the last raster its own.
  EXPECT_LE(beside.size(), 2 * (48 + 10) / RoughOptions{}.stepover_mm + 4);
  EXPECT_GE(on_lens.size(), beside.size() + 10);
  EXPECT_LT(path.predicted_cusp_um, 300 + 500);
}

TEST(RoughingShank, KeepsAwayFromWhatStandsWhereItIsWiderThanTheMill) {
  const auto flat = spline_of(Box2::centred({18, 12}), 36, 24, hills);
  const auto steep = spline_of(Box2::centred({18, 12}), 36, 24, [](double x, double y) { return 12 + 0.65 * x + 0.1 * std::sin(y); });
  const Vec2 size(20, 13);
  Cutter stout = mill();
  stout.flute_length_mm = 1.6;
  stout.shank = {{1.6, 3, 4.5, 4.5}};
  stout.shank_diameter_mm = 19;
  RoughOptions options;
  options.stepdown_mm = 0.9;
  // The deepest that the shank, from 3 mm above the tip, is below what stands: in time order, by the test's own stock.
  const auto deepest = [&](const ToolPath& path, const Blank& blank) {
    OwnStock stock(blank, stout);
    double most = -1e9;
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      const Vec3& a = path.moves[k - 1].pose.tip_mm;
      const Vec3& b = path.moves[k].pose.tip_mm;
      stock.sweep(a, b, path.moves[k].kind == MoveKind::kCut || path.moves[k].kind == MoveKind::kPlunge);
      for (int j = 0; j <= stock.ny; ++j) {
        for (int i = 0; i <= stock.nx; ++i) {
          const double r = std::hypot(stock.x(i) - b.x(), stock.y(j) - b.y());
          if (r > 5 && r < 9.5) most = std::max(most, stock.heights.at(i, j) - (b.z() + 3));
        }
      }
    }
    return most;
  };
  for (const SplineSurface* surface : {&flat, &steep}) {
    const Blank blank{size, surface->highest() + 1.2};
    const ToolPath path = plan_roughing(*surface, blank, stout, options);
    EXPECT_LE(deepest(path, blank), 0);
    EXPECT_LE(path.predicted_cusp_um, 2600);
  }
  Cutter slim = stout;
  slim.shank_diameter_mm = 10;
  const Blank blank{size, steep.highest() + 1.2};
  EXPECT_GT(deepest(plan_roughing(steep, blank, slim, options), blank), 0.1) << "a plan that does not know of it runs into it: the judge sees that";
}

TEST(RoughingNothing, PlansNoMoveWhereTheBlankIsNoHigherThanRoughingWouldLeaveIt) {
  const auto s = spline_of(Box2::centred({24, 20}), 24, 20, [](double x, double y) { return 14 + 0.05 * std::sin(x / 3 + y / 4); });
  const Blank blank{{24, 20}, s.highest() + 0.1};
  const RoughChoice plan = plan_faster_roughing(s, blank, mill(), {});
  EXPECT_TRUE(plan.path.moves.empty());
  EXPECT_EQ(plan.levels_minutes, 0);
  for (const float h : plan.rest.heights_mm.values) EXPECT_FLOAT_EQ(h, static_cast<float>(blank.height_mm));
}

TEST(AfterPass, LeavesTheBallsUndersideAlongItsWay) {
  RestMaterial rest{Box2::centred({20, 16}), Grid<float>(81, 65, 5.0F)};
  ToolPath path;
  path.cutter = test::cutter("semi_finish_4mm_ball");
  const Vec3 axis = Vec3(0.3, 0.2, 1).normalized();
  const auto at = [&](double x, double z, MoveKind kind) { path.moves.push_back({{Vec3(x, 1, z) - 2 * axis, axis}, kind, 10}); };
  at(-8, 9, MoveKind::kRapid);
  at(-4, 6, MoveKind::kLink);
  at(6, 6, MoveKind::kCut);
  at(0, 5, MoveKind::kLink);
  const RestMaterial after = after_pass(rest, path);
  for (int j = 0; j < 65; ++j) {
    for (int i = 0; i < 81; ++i) {
      const double x = -10 + 0.25 * i, y = -8 + 0.25 * j;
      const double away2 = std::pow(y - 1, 2) + std::pow(std::max({0.0, -4 - x, x - 6}), 2);
      const double expected = away2 < 4 ? std::min(5.0, 6 - std::sqrt(4 - away2)) : 5;
      EXPECT_NEAR(after.heights_mm.at(i, j), expected, 0.02) << x << " " << y;
      EXPECT_GE(after.heights_mm.at(i, j), expected - 1e-5);
    }
  }
}

TEST(RoughingRest, IsWhatTheCutterLeavesAndTellsHowDeepTheNextOneCuts) {
  // Steps of a dome: the rest against a stock that is swept by the test, and the ball's deepest cut against both.
  const auto s = spline_of(Box2::centred({20, 16}), 50, 40, dome);
  const Blank blank{{22, 17}, s.highest() + 1};
  const RoughChoice plan = plan_faster_roughing(s, blank, mill(), {});
  OwnStock stock(blank, mill());
  double against = 0, in_material = 0;
  for (std::size_t k = 1; k < plan.path.moves.size(); ++k) {
    const MoveKind kind = plan.path.moves[k].kind;
    const auto met = stock.sweep(plan.path.moves[k - 1].pose.tip_mm, plan.path.moves[k].pose.tip_mm, kind == MoveKind::kCut || kind == MoveKind::kPlunge);
    against += met.against_mm;
    in_material += met.cut_mm;
  }
  EXPECT_NEAR(plan.cutting.conventional_share(), against / in_material, 0.1);
  const Grid<float>& rest = plan.rest.heights_mm;
  const Vec2 pitch = plan.rest.extent.size().cwiseQuotient(Vec2(rest.width - 1, rest.height - 1));
  for (int j = 1; j < stock.ny; j += 3) {
    for (int i = 1; i < stock.nx; i += 3) {
      const Vec2 at = (Vec2(stock.x(i), stock.y(j)) - plan.rest.extent.min).cwiseQuotient(pitch);
      const int a = static_cast<int>(at.x());
      const int b = static_cast<int>(at.y());
      const auto [low, high] = std::minmax({rest.at(a, b), rest.at(a + 1, b), rest.at(a, b + 1), rest.at(a + 1, b + 1)});
      EXPECT_GE(stock.heights.at(i, j), low - 0.15) << at.transpose();
      EXPECT_LE(stock.heights.at(i, j), high + 0.15) << at.transpose();
    }
  }
  ToolPath ball;
  ball.cutter = test::cutter("semi_finish_4mm_ball");
  ball.moves.push_back({{Vec3(3, 2, dome(3, 2)), Vec3::UnitZ()}, MoveKind::kCut, 10});
  double deepest = 0;
  for (int j = 0; j < rest.height; ++j) {
    for (int i = 0; i < rest.width; ++i) {
      const double d = (plan.rest.extent.min + Vec2(i, j).cwiseProduct(pitch) - Vec2(3, 2)).norm();
      if (d < 2) deepest = std::max(deepest, rest.at(i, j) - (dome(3, 2) + 2 - std::sqrt(4 - d * d)));
    }
  }
  EXPECT_NEAR(deepest_cut_mm(plan.rest, ball), deepest, 1e-5);
  EXPECT_GT(deepest, 0.3);
}

TEST(RoughingBesideTheLens, GoesNeitherBelowTheBackNorTheLand) {
  // A wedge in a blank that is much larger: straight on, its low side would be 10 mm below the back.
  const auto s = spline_of(Box2::centred({12, 10}), 24, 20, [](double x, double y) { return 7 + 0.5 * x + 0.1 * y; });
  const Blank blank{{40, 38}, 11};
  Outline outline;
  outline.size_mm = {12, 10};
  const double ground = 7 - 3 - 0.5, drop = 0.8;
  const SplineSurface part = faded_outside(s, outline, drop);
  const ToolPath path = plan_roughing(part, blank, mill(), {});
  double lowest = 1e9;
  for (const Move& m : path.moves) lowest = std::min(lowest, m.pose.tip_mm.z());
  EXPECT_GT(lowest, ground - drop + 0.3);
  try {
    plan_roughing(s, blank, mill(), {});
    ADD_FAILURE() << "planned below the back";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), ::testing::HasSubstr("below the back of the blank near x -"));
  }
}

TEST(RoughingErrors, NameWhatIsWrongAndByHowMuch) {
  const auto s = spline_of(Box2::centred({40, 30}), 20, 20, [](double x, double) { return 10 + 0.1 * x; });
  const auto message = [&](const Blank& blank, const Cutter& tool, const RoughOptions& options) {
    try {
      plan_roughing(s, blank, tool, options);
    } catch (const InputError& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  EXPECT_THAT(message({{40, 30}, 11.5}, mill(), {}), ::testing::HasSubstr("0.5 mm taller than the blank"));
  EXPECT_THAT(message({{39, 30}, 20}, mill(), {}), ::testing::HasSubstr("smaller than the lens"));
  RoughOptions wide;
  wide.stepover_mm = 11;
  EXPECT_THAT(message({{40, 30}, 20}, mill(), wide), ::testing::HasSubstr("stepover"));
  RoughOptions deep;
  deep.stepdown_mm = 20;
  EXPECT_THAT(message({{40, 30}, 60}, mill(), deep), ::testing::AllOf(::testing::HasSubstr("stepdown_mm = 20"), ::testing::HasSubstr("at most 19.2")));
  Cutter stubby = mill();
  stubby.holder.front().from_mm = 3;
  EXPECT_THAT(message({{40, 30}, 20}, stubby, {}), ::testing::HasSubstr("longer cutter"));
}

}  // namespace
}  // namespace lightmill

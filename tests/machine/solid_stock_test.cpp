#include "machine/solid_stock.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <random>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "machine/detail/stock_tool.h"
#include "machine/detail/swept_body.h"
#include "machine/stock_model.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;
using Path = std::vector<ToolPose>;

const Blank kBlank{{12, 9}, 5};
constexpr double kPitch_mm = 0.1;
/// Places along a ray are floats of up to 6 mm.
constexpr double kFloat_mm = 1e-6;

Cutter mill(double diameter, double corner, double flutes = 20) {
  Cutter cutter;
  cutter.name = "mill";
  cutter.number = 1;
  cutter.diameter_mm = diameter;
  cutter.corner_radius_mm = corner;
  cutter.flute_length_mm = flutes;
  cutter.shank_diameter_mm = diameter;
  cutter.length_mm = 60;
  return cutter;
}
Cutter ball(double diameter) { return mill(diameter, diameter / 2, 2.5 * diameter); }

Vec3 leaning(double degrees, double direction_degrees) {
  const double t = degrees * kPi / 180, d = direction_degrees * kPi / 180;
  return {std::sin(t) * std::cos(d), std::sin(t) * std::sin(d), std::cos(t)};
}

void cut(SolidStock& solid, const Cutter& cutter, const Path& path) {
  solid.set_cutter(cutter);
  for (std::size_t k = 1; k < path.size(); ++k) solid.cut(path[k - 1], path[k]);
  solid.flush();
}

SolidStock milled(const Cutter& cutter, const Path& path, const Blank& blank = kBlank, double pitch_mm = kPitch_mm) {
  SolidStock solid(blank, pitch_mm);
  cut(solid, cutter, path);
  return solid;
}

double volume(const Blank& blank) { return blank.size_mm.x() * blank.size_mm.y() * blank.height_mm; }

/// The farthest that an end of a span is from that of the other solid; huge if rays have other numbers of spans.
double farthest(const SolidStock& a, const SolidStock& b) {
  double most = 0;
  for (int along = 0; along < 3; ++along) {
    for (int row = 0; row < a.rays(along).rows(); ++row) {
      for (int column = 0; column < a.rays(along).columns(); ++column) {
        const auto p = a.rays(along).at(column, row), q = b.rays(along).at(column, row);
        if (p.size() != q.size()) return 1e9;
        for (std::size_t k = 0; k < p.size(); ++k) {
          most = std::max<double>({most, std::abs(p[k].from - q[k].from), std::abs(p[k].to - q[k].to)});
        }
      }
    }
  }
  return most;
}

Path random_path(std::mt19937& random, int moves, bool leans) {
  const auto number = [&](double low, double high) { return std::uniform_real_distribution(low, high)(random); };
  const Vec3 axis = leans ? leaning(number(5, 60), number(0, 360)) : Vec3::UnitZ();
  Path path;
  for (int k = 0; k <= moves; ++k) path.push_back({{number(-7, 7), number(-5, 5), number(1, 6)}, axis});
  return path;
}

TEST(SolidStock, TakesSlotsPocketsAndCylindersFromTheBlock) {
  const Vec3 up = Vec3::UnitZ();
  // A 3 mm mill 2 deep along half the block, its round end included; walls exactly where they are.
  const SolidStock slot = milled(mill(3, 0), {{{-9, 0.5, 3}, up}, {{1, 0.5, 3}, up}});
  EXPECT_NEAR(volume(kBlank) - slot.volume_mm3(), 2 * (7 * 3 + kPi * 1.5 * 1.5 / 2), 0.05);
  const auto across = slot.rays(1).at(10, 45);  // along y at x = -4.95, z = 4.55
  ASSERT_EQ(across.size(), 2U);
  EXPECT_NEAR(across[0].to, 0.5 - 1.5, kFloat_mm);
  EXPECT_NEAR(across[1].from, 0.5 + 1.5, kFloat_mm);
  // A plunge: a cylinder.
  const SolidStock hole = milled(mill(4, 0), {{{0.3, -0.2, 9}, up}, {{0.3, -0.2, 1.3}, up}});
  EXPECT_NEAR(volume(kBlank) - hole.volume_mm3(), kPi * 4 * 3.7, 0.2);
  // A pocket with round corners.
  const SolidStock pocket =
      milled(mill(3, 0), {{{-2, -1, 2}, up}, {{2, -1, 2}, up}, {{2, 1, 2}, up}, {{-2, 1, 2}, up}, {{-2, -1, 2}, up}});
  EXPECT_NEAR(volume(kBlank) - pocket.volume_mm3(), 3 * (7 * 5 - (4 - kPi) * 1.5 * 1.5), 0.2);
  // A ball all along the block: a circular segment times its length.
  const double r = 2, depth = 1.2;
  const SolidStock groove = milled(ball(4), {{{-9, 0.2, 5 - depth}, up}, {{9, 0.2, 5 - depth}, up}});
  const double segment = r * r * std::acos((r - depth) / r) - (r - depth) * std::sqrt(2 * r * depth - depth * depth);
  EXPECT_NEAR(volume(kBlank) - groove.volume_mm3(), 12 * segment, 12 * segment * 5e-3);
}

TEST(SolidStock, OrderRepetitionAndSplittingOfCutsDoNotMatter) {
  std::mt19937 random(7);
  for (const bool leans : {false, true}) {
    const Cutter cutter = leans ? ball(3) : mill(3, 0.5);
    const Path path = random_path(random, 12, leans);
    const SolidStock once = milled(cutter, path);
    EXPECT_LT(once.volume_mm3(), volume(kBlank) - 5);

    SolidStock twice = milled(cutter, path);
    cut(twice, cutter, path);
    EXPECT_EQ(farthest(once, twice), 0);

    SolidStock backwards(kBlank, kPitch_mm);
    backwards.set_cutter(cutter);
    for (std::size_t k = path.size(); k-- > 1;) backwards.cut(path[k - 1], path[k]);
    backwards.flush();
    EXPECT_EQ(farthest(once, backwards), 0);

    Path split;
    for (std::size_t k = 1; k < path.size(); ++k) {
      for (int part = 0; part < 10; ++part) {
        split.push_back({path[k - 1].tip_mm + part / 10.0 * (path[k].tip_mm - path[k - 1].tip_mm), path[k].axis});
      }
    }
    split.push_back(path.back());
    // Thin rags of material may be on one side of a float or the other: their volume is nothing.
    EXPECT_NEAR(milled(cutter, split).volume_mm3(), once.volume_mm3(), 1e-4);
  }
}

RC_GTEST_PROP(SolidStock, NeverGrows, (unsigned seed)) {
  std::mt19937 random(seed);
  const Blank blank{{6, 5}, 4};
  SolidStock solid(blank, 0.5);
  for (int round = 0; round < 3; ++round) {
    std::array<std::vector<std::vector<Span>>, 3> before;
    const auto each_ray = [&](const auto& visit) {
      for (int along = 0; along < 3; ++along) {
        const RayBundle& rays = solid.rays(along);
        for (int k = 0; k < rays.rows() * rays.columns(); ++k) visit(along, k, rays.at(k % rays.columns(), k / rays.columns()));
      }
    };
    each_ray([&](int along, int, std::span<const Span> spans) { before[along].emplace_back(spans.begin(), spans.end()); });
    const bool leans = random() % 2 == 0;
    cut(solid, random() % 2 == 0 ? ball(2) : mill(2.5, leans ? 0.0 : 0.4, 6), random_path(random, 3, leans));
    each_ray([&](int along, int k, std::span<const Span> spans) {
      const std::vector<Span>& old = before[along][k];
      float last = -10;
      for (const Span& span : spans) {
        RC_ASSERT(!span.empty());
        RC_ASSERT(span.from > last);
        last = span.to;
        RC_ASSERT(std::any_of(old.begin(), old.end(), [&](const Span& o) { return o.from <= span.from && span.to <= o.to; }));
      }
    });
  }
}

TEST(SolidStock, AgreesWithTheHeightFieldOnWhatStandsOnTheBack) {
  std::mt19937 random(11);
  // Nodes of the field are the middles of the solid's cells.
  const Blank field_blank{kBlank.size_mm - Vec2::Constant(kPitch_mm), kBlank.height_mm};
  for (int round = 0; round < 6; ++round) {
    const bool leans = round % 2 == 1;
    const Cutter cutter = round < 2 ? mill(3, 0) : round < 4 ? ball(3) : mill(3, 0.6);
    Path path = random_path(random, 6, leans);
    for (ToolPose& pose : path) pose.tip_mm.z() += 1;
    StockModel model(field_blank, {kPitch_mm, 0});
    model.set_cutter(cutter);
    for (std::size_t k = 1; k < path.size(); ++k) model.move({1, path[k - 1], path[k], false, true, 1});
    model.flush();
    const MachinedSurface surface = model.surface();
    const SolidStock solid = milled(cutter, path);
    ASSERT_EQ(surface.heights_mm.width, solid.rays(2).columns());
    double most = 0;
    for (int j = 0; j < surface.heights_mm.height; ++j) {
      for (int i = 0; i < surface.heights_mm.width; ++i) {
        const auto spans = solid.rays(2).at(i, j);
        ASSERT_FALSE(spans.empty());
        most = std::max<double>(most, std::abs(spans.front().to - surface.heights_mm.at(i, j)));
      }
    }
    EXPECT_LT(most, 2e-5) << round;
  }
}

TEST(SolidStock, ATiltedFlatEndMillLeavesAnEllipticGroove) {
  // Leaning along its way by 30 degrees: the end's disk is seen as an ellipse.
  const double r = 2, lean = kPi / 6;
  const Vec3 axis = leaning(30, 0);
  const Vec3 tip(0, 0.3, 4.5);
  const SolidStock solid = milled(mill(2 * r, 0), {{tip - Vec3(12, 0, 0), axis}, {tip + Vec3(12, 0, 0), axis}});
  for (int j = 0; j < solid.rays(2).rows(); ++j) {
    const double y = solid.place_mm(1, j) - tip.y();
    const double floor = std::abs(y) < r ? tip.z() - r * std::sin(lean) * std::sqrt(1 - y * y / r / r) : 5;
    EXPECT_NEAR(solid.rays(2).at(60, j).front().to, std::min(floor, 5.0), 5e-6) << y;
  }
  const int level = 40;  // z = 4.05
  const double half = r * std::sqrt(1 - std::pow((tip.z() - solid.place_mm(2, level)) / (r * std::sin(lean)), 2));
  const auto across = solid.rays(1).at(60, level);
  ASSERT_EQ(across.size(), 2U);
  EXPECT_NEAR(across[1].from - across[0].to, 2 * half, 4e-6);
}

TEST(SolidStock, AnUndercutOfALeaningMillIsKept) {
  // Lying down by 60 degrees into the side of the block: a slanting slit, material over and under it.
  const double r = 0.5;
  const Vec3 axis = leaning(60, 0);
  const Vec3 tip(2, 0, 2);
  const SolidStock solid = milled(mill(2 * r, 0), {{tip - Vec3(0, 9, 0), axis}, {tip + Vec3(0, 9, 0), axis}});
  const int column = 100;  // x = 4.05
  const auto spans = solid.rays(2).at(column, 45);
  ASSERT_EQ(spans.size(), 2U);
  const double on_axis = tip.z() + (solid.place_mm(0, column) - tip.x()) / std::tan(kPi / 3);
  EXPECT_NEAR(spans[0].to, on_axis - r / std::sin(kPi / 3), 2e-6);
  EXPECT_NEAR(spans[1].from, on_axis + r / std::sin(kPi / 3), 2e-6);
  EXPECT_EQ(solid.pieces().size(), 1U);  // it hangs on the side that the mill came not through
}

RC_GTEST_PROP(SolidStock, ChordsInClosedFormAreThoseOfTheNearestDistance, (unsigned seed)) {
  std::mt19937 random(seed);
  const auto number = [&](double low, double high) { return std::uniform_real_distribution(low, high)(random); };
  const bool is_ball = random() % 2 == 0;
  const Tool tool(is_ball ? ball(4) : mill(4, random() % 2 == 0 ? 0.0 : 0.5, 9));
  const Vec3 axis = is_ball && random() % 3 > 0 ? leaning(number(0, 80), number(0, 360)) : Vec3::UnitZ();
  const ToolPose from{{number(-1, 1), number(-1, 1), number(-1, 1)}, axis};
  ToolPose to = from;
  if (const unsigned way = random() % 4; way == 0) {
    to.tip_mm += number(-2, 2) * axis;
  } else {
    to.tip_mm += Vec3(number(-2, 2), way == 1 ? 0 : number(-2, 2), way == 3 ? 0 : number(-1, 1));
  }
  const RoundedCylinder shape{tool.radius_mm - tool.corner_mm, tool.corner_mm, tool.flute_length_mm - tool.corner_mm};
  const SweptBody body(tool, from, to);
  for (int line = 0; line < 12; ++line) {
    const int along = static_cast<int>(random() % 3);
    Vec3 place(number(-4, 5), number(-4, 5), number(-3, 12));
    // An upright mill's flutes end flat, the nearest distance's body is round there.
    const bool at_the_end = !is_ball && place.z() > std::min(from.tip_mm.z(), to.tip_mm.z()) + 9 - tool.corner_mm;
    if (along != 2 && at_the_end) continue;
    const Chord chord = body.chord(along, place);
    const auto enter = [&](double side) {
      place[along] = -40 * side;
      const auto way = entry(shape, from.tip_mm, to.tip_mm - from.tip_mm, axis, place, side * Vec3::Unit(along));
      return way ? side * (*way - 40) : kNothing;
    };
    const double first = enter(1), last = enter(-1);
    constexpr double kGrazes_mm = 0.01;  // where a touch ends is ill-conditioned
    if (first == kNothing || last - first < kGrazes_mm) {
      RC_ASSERT(chord.empty() || chord.to - chord.from < 2 * kGrazes_mm);
      continue;
    }
    RC_ASSERT(!chord.empty());
    RC_ASSERT(std::abs(chord.from - first) < 1e-4);
    if (is_ball || along != 2) RC_ASSERT(std::abs(chord.to - last) < 1e-4);
  }
}

TEST(SolidStock, SaysWhichPiecesAreLoose) {
  const Vec3 up = Vec3::UnitZ();
  const auto ring = [&](double z) {
    return Path{{{-3, -2, z}, up}, {{3, -2, z}, up}, {{3, 2, z}, up}, {{-3, 2, z}, up}, {{-3, -2, z}, up}};
  };
  EXPECT_EQ(milled(mill(1, 0), ring(0.4)).pieces().size(), 1U);
  // A skin of 0.4 mm is no bridge for those who ask for half a millimetre.
  const auto by_skin = milled(mill(1, 0), ring(0.4)).pieces(0.5);
  EXPECT_GT(by_skin[1].volume_mm3, 100 * by_skin[2].volume_mm3);
  const auto pieces = milled(mill(1, 0), ring(-0.1)).pieces();
  ASSERT_EQ(pieces.size(), 2U);
  EXPECT_NEAR(pieces[1].volume_mm3, 5 * 3 * 5, 1e-6);
  EXPECT_NEAR(pieces[1].low_mm.x(), -2.5, 1e-6);
  EXPECT_NEAR(pieces[1].high_mm.y(), 1.5, 1e-6);
  EXPECT_NEAR(pieces[0].volume_mm3 + pieces[1].volume_mm3, 12 * 9 * 5 - 5 * (7 * 5 - (4 - kPi) / 4 - 5 * 3), 1);
}

TEST(SolidStock, AShankMeetsTheOverhangThatAHeightFieldHasNot) {
  // Over the slit of a leaning mill material stands on; a shank that comes down on it is seen.
  const Vec3 axis = leaning(60, 0);
  SolidStock solid = milled(mill(1, 0), {{{2, -9, 2}, axis}, {{2, 9, 2}, axis}});
  const Frustum shank{0, 20, 1, 1};
  const ToolPose above{{4, 0, 5.5}, Vec3::UnitZ()}, in{{4, 0, 4.5}, Vec3::UnitZ()};
  EXPECT_EQ(touch(solid, shank, above, {{4, 0, 5.001}, Vec3::UnitZ()}, 0).depth_mm, 0);
  const auto probe = touch(solid, shank, above, in, 0);
  EXPECT_NEAR(probe.depth_mm, 0.5, 1e-6);
  EXPECT_TRUE(may_touch(solid, shank, above, in, 0));
  EXPECT_FALSE(may_touch(solid, shank, above, above, 0));
}

TEST(SolidStock, ItsMemoryIsCountedAndBounded) {
  const SolidStock solid({{100, 100}, 15}, 0.1);
  EXPECT_LT(solid.bytes(), 1.4e6 * 12);
  EXPECT_GT(solid.bytes(), 1.25e6 * 12);
  EXPECT_THROW(SolidStock({{100, 100}, 15}, 0.005), InputError);
  EXPECT_THROW(SolidStock({{100, 100}, 15}, 0), InputError);
  EXPECT_THROW(SolidStock(kBlank, 0.1).cut({}, {}), InputError);
}

TEST(SolidStock, FilesReadBackAsWritten) {
  const test::ScratchFolder folder;
  const Vec3 axis = leaning(60, 0);
  const Blank blank{{10.05, 7.33}, 4.01};
  const SolidStock solid = milled(mill(1, 0), {{{2, -9, 2}, axis}, {{2, 9, 2}, axis}}, blank);
  solid.write(folder / "solid.bin");
  const SolidStock back = SolidStock::read(folder / "solid.bin");
  EXPECT_EQ(farthest(solid, back), 0);
  EXPECT_EQ(back.highest(Box2::centred(blank.size_mm)), solid.highest(Box2::centred(blank.size_mm)));
  const std::string bytes = read_whole(folder / "solid.bin");
  for (const std::size_t size : {std::size_t{0}, std::size_t{30}, bytes.size() - 1}) {
    write_whole(folder / "cut.bin", bytes.substr(0, size));
    EXPECT_THROW(SolidStock::read(folder / "cut.bin"), InputError) << size;
  }
}

}  // namespace
}  // namespace lightmill

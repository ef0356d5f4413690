#include "design/color_mask.h"

#include <gtest/gtest.h>

#include <cmath>

#include "design/core/files.h"
#include "design/core/image.h"
#include "design/surface.h"

namespace lightmill {
namespace {

/// A colour that tells where it is: all three channels differ and vary along x and y.
Vec3 colour_of(const Vec2& p) {
  return {0.5 + p.x() / 90, 0.5 + p.y() / 60, 0.6 - (p.x() + p.y()) / 120};
}

ColourGrid telling_colours() {
  ColourGrid colours{{{-40, -25}, {35, 30}}, Grid<float>(150, 110), Grid<float>(150, 110), Grid<float>(150, 110)};
  for (int j = 0; j < 110; ++j) {
    for (int i = 0; i < 150; ++i) {
      const Vec3 c = colour_of({-40 + (i + 0.5) / 2, -25 + (j + 0.5) / 2});
      colours.red.at(i, j) = static_cast<float>(c[0]);
      colours.green.at(i, j) = static_cast<float>(c[1]);
      colours.blue.at(i, j) = static_cast<float>(c[2]);
    }
  }
  return colours;
}

TEST(ColourMask, EachPlaceHasTheTargetsColourWhereItsLightLands) {
  Lens lens;
  lens.size_mm = {30, 20};
  SurfaceMesh mesh = start_mesh(lens, 121);
  const auto normal = [](double x, double y) { return Vec3(x / 150 - 0.05, y / 250, 1).normalized(); };
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
    Vec3& p = mesh.vertices[v];
    p.z() = 12 - p.x() * p.x() / 300 - p.y() * p.y() / 500 + 0.05 * p.x();
    mesh.normals[v] = normal(p.x(), p.y());
  }
  const ColourGrid colours = telling_colours();
  Light slanted;
  slanted.direction = {0.05, 0.02, 1};
  const Receiver receiver{.distance_mm = 60, .tilt_rad = {0, 0.2}};
  for (const Light& light : {Light{}, slanted}) {
    const auto ends = ray_ends(mesh, lens, light, receiver);
    const ColourGrid mask = colour_mask(mesh, ends, colours, Box2::centred({34, 22}), 3);
    ASSERT_EQ(mask.red.width, 102);
    ASSERT_EQ(mask.red.height, 66);
    int compared = 0;
    for (int j = 0; j < 66; ++j) {
      for (int i = 0; i < 102; ++i) {
        const Vec2 entry(-17 + (i + 0.5) / 3, -11 + (j + 0.5) / 3);
        if (std::abs(entry.x()) > 13 || std::abs(entry.y()) > 8) continue;
        // The ray of this very place, by hand.
        Vec3 inside;
        refract(light.direction.normalized(), Vec3::UnitZ(), {1, 1.49}, inside);
        Vec3 p(entry.x(), entry.y(), 12);
        for (int turn = 0; turn < 20; ++turn) {
          p.z() = 12 - p.x() * p.x() / 300 - p.y() * p.y() / 500 + 0.05 * p.x();
          p.head<2>() = entry + p.z() / inside.z() * inside.head<2>();
        }
        Vec3 after;
        ASSERT_TRUE(refract(inside, normal(p.x(), p.y()), {1.49, 1}, after));
        Vec2 landed;
        ASSERT_TRUE(receiver_frame(lens, receiver).meet(p, after, landed));
        ASSERT_TRUE(colours.extent.contains(landed));
        const Vec3 expected = colour_of(landed) / colour_of(landed).maxCoeff();
        ASSERT_NEAR(mask.red.at(i, j), expected[0], 2e-3) << entry.transpose();
        ASSERT_NEAR(mask.green.at(i, j), expected[1], 2e-3) << entry.transpose();
        ASSERT_NEAR(mask.blue.at(i, j), expected[2], 2e-3) << entry.transpose();
        ++compared;
      }
    }
    EXPECT_GT(compared, 3000);
    EXPECT_EQ(mask.red.at(0, 0), 1);  // beside the lens: clear
  }
}

TEST(ColourMask, StopsLightThatLandsBesideThePictureOrInItsBlack) {
  Lens lens;
  lens.size_mm = {30, 20};
  const SurfaceMesh mesh = start_mesh(lens, 31);
  ColourGrid half{Box2::centred({20, 20}), Grid<float>(20, 20), Grid<float>(20, 20), Grid<float>(20, 20)};
  for (int j = 0; j < 20; ++j) {
    for (int i = 10; i < 20; ++i) half.red.at(i, j) = 0.25F;
  }
  const ColourGrid mask = colour_mask(mesh, ray_ends(mesh, lens, {}, {}), half, Box2::centred(lens.size_mm), 2);
  EXPECT_EQ(mask.red.at(45, 20), 1);  // red passes whole, however dark
  EXPECT_EQ(mask.blue.at(45, 20), 0);
  EXPECT_EQ(mask.red.at(25, 20), 0);
  EXPECT_EQ(mask.red.at(59, 20), 0);
}

TEST(ColourMask, IsClearWhereCurvesAndPointsShineOnTheDark) {
  // Left half black, right half red; a curve across both and a point in the black.
  constexpr int kPixels = 80;  // of half a millimetre
  ColourGrid colours{Box2::centred({40, 40}), Grid<float>(kPixels, kPixels), Grid<float>(kPixels, kPixels),
                     Grid<float>(kPixels, kPixels)};
  for (int j = 0; j < kPixels; ++j) {
    for (int i = kPixels / 2; i < kPixels; ++i) colours.red.at(i, j) = 0.8F;
  }
  TargetLight target;
  target.extent = colours.extent;
  target.area_flux = Grid<double>(1, 1, 0.5);
  target.curves.push_back({{{-15, 5.2}, {15, 5.2}}, {0.01, 0.01}});
  target.points.push_back({{-8.2, -9.7}, 0.2});
  clear_for_curves(colours, target);
  for (int j = 0; j < kPixels; ++j) {
    for (int i = 0; i < kPixels; ++i) {
      const Vec2 p(-20 + (i + 0.5) / 2, -20 + (j + 0.5) / 2);
      const double from_curve = std::hypot(std::max(0.0, std::abs(p.x()) - 15), p.y() - 5.2);
      const double nearest = std::min(from_curve, (p - Vec2(-8.2, -9.7)).norm());
      const Vec3 filter = filter_of({colours.red.at(i, j), colours.green.at(i, j), colours.blue.at(i, j)});
      if (p.x() > 0) {
        EXPECT_EQ(filter, Vec3(1, 0, 0)) << p.transpose();
      } else if (nearest < 0.7) {
        EXPECT_EQ(filter, Vec3::Ones()) << p.transpose();
      } else if (nearest > 2.2) {
        EXPECT_EQ(filter, Vec3::Zero()) << p.transpose();
      }
    }
  }
}

TEST(ColourMask, TakesColoursAsTheReaderSeesThem) {
  const auto file = std::filesystem::temp_directory_path() /
                    ("colours_" + std::to_string(::testing::UnitTest::GetInstance()->random_seed()) + "_mask.png");
  Grid<float> red(3, 2), green(3, 2), blue(3, 2);
  red.at(0, 0) = 1;   // top left
  blue.at(2, 1) = 1;  // bottom right
  write_png8(file, red, green, blue);
  TargetSpec spec;
  spec.colours = file;
  for (const ViewedFrom from : {ViewedFrom::kLens, ViewedFrom::kBehind}) {
    spec.viewed_from = from;
    const auto colours = target_colours(spec);
    ASSERT_TRUE(colours);
    const int left = from == ViewedFrom::kLens ? 2 : 0;  // from the lens, +X is on the left
    EXPECT_EQ(colours->red.at(left, 1), 1);
    EXPECT_EQ(colours->blue.at(2 - left, 0), 1);
  }
  write_png8(file, red, red, red);
  EXPECT_FALSE(target_colours(spec));
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace lightmill

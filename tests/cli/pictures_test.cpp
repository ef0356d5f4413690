#include "cli/pictures.h"

#include <gtest/gtest.h>

#include <limits>

#include "design/core/image.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

TEST(DeviationPicture, IsRedAboveBlueBelowTopRowFirstAndLeavesOutWhatIsBesideTheLens) {
  const test::ScratchFolder scratch;
  constexpr float kBeside = std::numeric_limits<float>::quiet_NaN();
  // A lens of 4 x 3 values, one of them beside it, in a wide blank; row 0 is the smallest y.
  Grid<float> deviation(40, 30, kBeside);
  for (int y = 10; y < 13; ++y) {
    for (int x = 20; x < 24; ++x) deviation.at(x, y) = 0;
  }
  deviation.at(20, 10) = -5;
  deviation.at(23, 12) = 40;
  deviation.at(23, 10) = kBeside;
  write_deviation_picture(scratch / "deviation.png", deviation, 5);
  const Picture picture = read_picture(scratch / "deviation.png", Transfer::kSrgb, true);
  constexpr int kZoom = 125;  // the longer side is drawn 500 pixels wide
  ASSERT_GT(picture.red.width, 4 * kZoom) << "values and a scale";
  ASSERT_EQ(picture.red.height, 3 * kZoom);
  const auto colour = [&](int x, int row) {
    const int u = x * kZoom + kZoom / 2, v = row * kZoom + kZoom / 2;
    return Vec3(picture.red.at(u, v), picture.green.at(u, v), picture.blue.at(u, v));
  };
  const Vec3 above = colour(3, 0), below = colour(0, 2), zero = colour(1, 1), beside = colour(3, 2);
  EXPECT_GT(above.x(), 5 * above.z());
  EXPECT_GT(below.z(), 5 * below.x());
  EXPECT_LT(std::abs(zero.x() - zero.z()), 0.05);
  EXPECT_NE(beside, zero) << "paper";
}

}  // namespace
}  // namespace lightmill

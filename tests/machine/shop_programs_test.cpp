// Programs as shops write them, in every dialect: the same plate and the same pocket, whatever the words.
#include <gtest/gtest.h>

#include "design/core/files.h"
#include "reader_rig.h"

namespace lightmill {
namespace {

struct Shop {
  std::string dialect, extension;
};
const std::vector<Shop> kShops = {
    {"fanuc", "nc"}, {"linuxcnc", "ngc"}, {"siemens", "mpf"}, {"heidenhain", "h"}, {"heidenhain_iso", "i"}};

/// Where feed moves end on the machine, in the first work offset and above the tip.
std::vector<Vec3> feed_ends(const std::string& name, const Shop& shop) {
  const std::string path = std::string(LIGHTMILL_SOURCE_DIR) + "/tests/machine/shop_programs/" + name + "_" +
                           shop.dialect + "." + shop.extension;
  const test::Reading r = test::read(read_whole(path), reader_dialect(shop.dialect));
  if (r.result.error) ADD_FAILURE() << path << ":" << r.result.error->line << ": " << r.result.error->rule;
  EXPECT_TRUE(r.result.ended) << path;
  std::vector<Vec3> ends;
  for (const ProgramStep& step : r.moves) {
    if (step.rapid) continue;
    ends.emplace_back(step.target[0] - 10, step.target[1] + 5, step.target[2] + 400 - 80);
    EXPECT_EQ(step.target[3], 0);
  }
  return ends;
}

void expect_ends(const std::string& name, const std::vector<Vec3>& expected) {
  for (const Shop& shop : kShops) {
    const std::vector<Vec3> ends = feed_ends(name, shop);
    ASSERT_EQ(ends.size(), expected.size()) << shop.dialect;
    for (std::size_t i = 0; i < ends.size(); ++i)
      EXPECT_LT((ends[i] - expected[i]).norm(), 1e-9) << shop.dialect << " " << i;
  }
}

// A 4 mm mill to the left of its contour goes around convex corners, then two holes.
TEST(ShopPrograms, ThePlateIsOne) {
  expect_ends("plate", {{-10, -10, -2},
                        {-2, -8, -2},
                        {-2, 40, -2},
                        {0, 42, -2},
                        {40, 42, -2},
                        {52, 30, -2},
                        {52, 0, -2},
                        {50, -2, -2},
                        {-10, -2, -2},
                        {-10, -10, -2},
                        {10, 10, -5},
                        {20, 10, -5}});
}

TEST(ShopPrograms, ThePocketIsOne) {
  std::vector<Vec3> ends;
  for (const double z : {-1, -2, -3}) ends.insert(ends.end(), {{0, 0, z}, {8, 0, z}, {8, 0, z}, {0, 0, z}});
  ends.emplace_back(20, 10, -6);
  expect_ends("pocket", ends);
}

}  // namespace
}  // namespace lightmill

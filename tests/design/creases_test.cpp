#include "design/detail/creases.h"

#include <gtest/gtest.h>

#include "design/surface.h"

namespace lightmill::detail {
namespace {

/// Light that parts to both sides of x = 0.3 by `way_mm`, over a strip of the lens of `width_mm`.
struct Parting {
  double way_mm, width_mm;
  [[nodiscard]] std::vector<Vec2> at(const std::vector<Vec2>& places) const {
    std::vector<Vec2> targets;
    for (const Vec2& p : places) targets.emplace_back(p.x() + way_mm * std::clamp((p.x() - 0.3) / width_mm, -0.5, 0.5), p.y());
    return targets;
  }
};

struct Found {
  Creases creases;
  int rows = 0, crossed_rows = 0;  // of vertices, from left to right
};

Found find(const Parting& parting) {
  Lens lens;
  lens.size_mm = {40, 20};
  const SurfaceMesh mesh = start_mesh(lens, 41);  // edges of 1 mm
  std::vector<Vec2> places;
  for (const Vec3& p : mesh.vertices) places.emplace_back(p.head<2>());
  Found found;
  found.creases = find_creases(one_rings(static_cast<int>(places.size()), mesh.triangles), places, parting.at(places),
                               [&](const std::vector<Vec2>& somewhere) { return parting.at(somewhere); });
  constexpr int kColumns = 41;
  for (int first = 0; first < static_cast<int>(places.size()); first += kColumns) {
    bool crossed = false;
    for (int v = first; v + 1 < first + kColumns; ++v) crossed |= found.creases.torn(v, v + 1);
    ++found.rows;
    found.crossed_rows += crossed;
  }
  return found;
}

TEST(Creases, AStripTooNarrowForTheMeshIsOne) {
  for (const double width_mm : {0.01, 0.9, 1.6, 2.4}) {
    const Found found = find({20, width_mm});
    EXPECT_EQ(found.crossed_rows, found.rows) << width_mm;
  }
}

TEST(Creases, AStretchOverManyEdgesIsNone) {
  for (const double width_mm : {8.0, 16.0}) EXPECT_TRUE(find({4 * width_mm, width_mm}).creases.shares.empty()) << width_mm;
  EXPECT_TRUE(find({0, 1}).creases.shares.empty());
}

TEST(Creases, LieWhereTheLightParts) {
  const Found found = find({20, 0.01});
  const double half_way = 0.3;  // from the vertex at 0 to that at 1
  int seen = 0;
  for (const auto& [edge, share] : found.creases.shares) {
    const int a = static_cast<int>(edge >> 32), b = static_cast<int>(edge & 0xffffffff);
    const bool rises = a % 41 < b % 41;
    EXPECT_NEAR(share, rises ? half_way : 1 - half_way, 0.02);
    ++seen;
  }
  EXPECT_EQ(seen, 21 + 20);  // an edge along each row, a diagonal in between
}

}  // namespace
}  // namespace lightmill::detail

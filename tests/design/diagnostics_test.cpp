#include "design/diagnostics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "design/surface.h"

namespace lightmill {
namespace {

TEST(Diagnostics, ASpheresMeanCurvatureIsOneOverItsRadius) {
  Lens lens;
  lens.size_mm = {30, 20};
  SurfaceMesh mesh = start_mesh(lens, 121);
  for (const double bulge : {1.0, -1.0}) {
    for (std::size_t v = 0; v < mesh.vertices.size(); ++v) {
      const Vec2 p = mesh.vertices[v].head<2>();
      const double up = std::sqrt(50 * 50 - p.squaredNorm());
      mesh.vertices[v].z() = bulge * up;
      mesh.normals[v] = Vec3(bulge * p.x(), bulge * p.y(), up) / 50;
    }
    for (const double h : mean_curvatures(mesh)) ASSERT_NEAR(h, bulge / 50, 1e-12);
  }
}

TransportMap random_map(unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> place(-1, 1);
  TransportMap map;
  for (int i = 0; i < 200; ++i) {
    map.sites_mm.emplace_back(30 * place(random), 20 * place(random));
    map.source_centroids_mm.push_back(map.sites_mm.back() + Vec2(0.1, -0.2));
    map.weights_mm2.push_back(3 * place(random));
  }
  return map;
}

TEST(Diagnostics, OnABorderTwoCellsPowersAreEqualAndTheLeast) {
  const TransportMap map = random_map(5);
  const Box2 box{{-25, -15}, {20, 18}};
  const auto borders = power_cell_borders(map.sites_mm, map.weights_mm2, box);
  EXPECT_GT(borders.size(), 100u);
  for (const auto& border : borders) {
    for (const Vec2& end : border) {
      ASSERT_TRUE(end.x() > box.min.x() - 1e-9 && end.y() > box.min.y() - 1e-9 && end.x() < box.max.x() + 1e-9 &&
                  end.y() < box.max.y() + 1e-9);
    }
    const Vec2 middle = (border[0] + border[1]) / 2;
    std::vector<double> powers;
    for (std::size_t i = 0; i < map.sites_mm.size(); ++i)
      powers.push_back((middle - map.sites_mm[i]).squaredNorm() - map.weights_mm2[i]);
    std::sort(powers.begin(), powers.end());
    ASSERT_NEAR(powers[0], powers[1], 1e-9);
  }
}

TEST(Diagnostics, NearestSamplesAreTheNearest) {
  const TransportMap map = random_map(8);
  std::vector<Vec2> places{{100, 3}, {-40, -40}};
  for (int i = 0; i < 50; ++i) places.emplace_back(std::sin(i) * 33, std::cos(2.3 * i) * 22);
  const std::vector<int> found = nearest_samples(map, places);
  for (std::size_t k = 0; k < places.size(); ++k) {
    double least = 1e9;
    for (const Vec2& s : map.source_centroids_mm) least = std::min(least, (s - places[k]).norm());
    EXPECT_EQ((map.source_centroids_mm[found[k]] - places[k]).norm(), least);
  }
}

}  // namespace
}  // namespace lightmill

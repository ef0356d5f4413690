// Triangles as pixels.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill {

/// Calls draw(column, row, triangle, weights of its corners) for each pixel of a grid over `extent` (row 0 at the smallest y)
/// whose centre lies in a triangle.
template <typename Draw>
void for_each_pixel(const std::vector<Vec2>& places, const std::vector<std::array<int, 3>>& triangles, const Box2& extent,
                    int width, int height, const Draw& draw) {
  const Vec2 pixel = extent.size().cwiseQuotient(Vec2(width, height));
  constexpr double kRounding = 1e-9;
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    std::array<Vec2, 3> p;
    for (int k = 0; k < 3; ++k) p[k] = (places[triangles[t][k]] - extent.min).cwiseQuotient(pixel) - Vec2(0.5, 0.5);
    const Vec2 u = p[1] - p[0];
    const Vec2 v = p[2] - p[0];
    const double area = u.x() * v.y() - u.y() * v.x();
    if (area == 0) continue;
    const Vec2 low = p[0].cwiseMin(p[1]).cwiseMin(p[2]).array() - 1e-6;
    const Vec2 high = p[0].cwiseMax(p[1]).cwiseMax(p[2]).array() + 1e-6;
    const auto clipped = [](double x, int count) { return static_cast<int>(std::clamp(x, -1.0, static_cast<double>(count))); };
    const int x0 = std::max(0, clipped(std::ceil(low.x()), width));
    const int x1 = std::min(width - 1, clipped(std::floor(high.x()), width));
    const int y0 = std::max(0, clipped(std::ceil(low.y()), height));
    const int y1 = std::min(height - 1, clipped(std::floor(high.y()), height));
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        const Vec2 q = Vec2(x, y) - p[0];
        const double b = (q.x() * v.y() - q.y() * v.x()) / area;
        const double c = (u.x() * q.y() - u.y() * q.x()) / area;
        if (b >= -kRounding && c >= -kRounding && b + c <= 1 + kRounding) draw(x, y, static_cast<int>(t), Vec3(1 - b - c, b, c));
      }
    }
  }
}

}  // namespace lightmill

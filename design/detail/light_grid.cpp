#include "design/detail/light_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace lightmill::detail {

namespace {

/// Below this ratio of height to length a triangle is a segment: its light moves by less than this part of its length,
/// and areas that cancel to 1e-16 of length squared stay known to 1e-8.
constexpr double kThin = 1e-8;
/// Triangles shorter than this (in pixels) are points.
constexpr double kTiny = 1e-9;

/// A convex polygon: a triangle cut by a pixel's four lines has 7 corners; rounding may add a few that coincide.
struct SmallPolygon {
  std::array<Vec2, 16> corners;
  int size = 0;
  void add(const Vec2& p) { corners[size++] = p; }

  /// Area with respect to the first corner: small polygons far from the origin stay exact.
  [[nodiscard]] double area() const {
    double twice = 0;
    for (int k = 1; k + 1 < size; ++k) {
      const Vec2 u = corners[k] - corners[0];
      const Vec2 v = corners[k + 1] - corners[0];
      twice += u.x() * v.y() - u.y() * v.x();
    }
    return std::abs(twice) / 2;
  }
};

/// Cuts by the line coordinate `axis` = `at` into what lies below and above. Both share the very same new corners.
void split(const SmallPolygon& polygon, int axis, double at, SmallPolygon& below, SmallPolygon& above) {
  below.size = above.size = 0;
  for (int k = 0; k < polygon.size; ++k) {
    const Vec2& p = polygon.corners[k];
    const Vec2& q = polygon.corners[k + 1 == polygon.size ? 0 : k + 1];
    const double dp = p[axis] - at;
    const double dq = q[axis] - at;
    if (dp <= 0) below.add(p);
    if (dp >= 0) above.add(p);
    if ((dp < 0 && dq > 0) || (dp > 0 && dq < 0)) {
      Vec2 cut = p + (q - p) * (dp / (dp - dq));
      cut[axis] = at;
      below.add(cut);
      above.add(cut);
    }
  }
}

/// The pixel line at or below `value`, kept within [least, most] before the conversion to int can overflow.
int pixel_of(double value, int least, int most) {
  return static_cast<int>(std::clamp(std::floor(value), static_cast<double>(least), static_cast<double>(most)));
}

}  // namespace

void LightGrid::add_point(const Vec2& p, double amount) {
  if (p.x() >= 0 && p.y() >= 0 && p.x() <= flux.width && p.y() <= flux.height) {
    flux.at(pixel_of(p.x(), 0, flux.width - 1), pixel_of(p.y(), 0, flux.height - 1)) += amount;
  } else {
    outside += amount;
  }
}

void LightGrid::add_small_box(const Vec2& centre, double half_width, double half_height, double amount) {
  const double x0 = centre.x() - half_width;
  const double y0 = centre.y() - half_height;
  if (!(x0 >= 0 && y0 >= 0 && centre.x() + half_width < flux.width && centre.y() + half_height < flux.height)) {
    // At the rim the share of each of the four pixels is added only if the pixel exists.
    if (!(x0 > -2 && y0 > -2 && x0 < flux.width + 1.0 && y0 < flux.height + 1.0)) {
      outside += amount;
      return;
    }
    const int i = static_cast<int>(std::floor(x0));
    const int j = static_cast<int>(std::floor(y0));
    const double right =
        half_width > 0 ? std::clamp((x0 + 2 * half_width - (i + 1)) / (2 * half_width), 0.0, 1.0) : 0.0;
    const double upper =
        half_height > 0 ? std::clamp((y0 + 2 * half_height - (j + 1)) / (2 * half_height), 0.0, 1.0) : 0.0;
    double left_over = amount;
    for (int dj = 0; dj < 2; ++dj) {
      for (int di = 0; di < 2; ++di) {
        if (i + di < 0 || j + dj < 0 || i + di >= flux.width || j + dj >= flux.height) continue;
        const double share = amount * (di ? right : 1 - right) * (dj ? upper : 1 - upper);
        flux.at(i + di, j + dj) += share;
        left_over -= share;
      }
    }
    outside += left_over;
    return;
  }
  const int i = static_cast<int>(x0);
  const int j = static_cast<int>(y0);
  const double beyond_x = x0 + 2 * half_width - (i + 1);
  const double beyond_y = y0 + 2 * half_height - (j + 1);
  double* row = &flux.values[static_cast<std::size_t>(j) * flux.width + i];
  if (beyond_x <= 0 && beyond_y <= 0) {
    row[0] += amount;
    return;
  }
  const double upper = beyond_y > 0 ? amount * (beyond_y / (2 * half_height)) : 0.0;
  const double lower = amount - upper;
  const double right = beyond_x > 0 ? beyond_x / (2 * half_width) : 0.0;
  const double lower_right = lower * right;
  row[0] += lower - lower_right;
  if (beyond_x > 0) row[1] += lower_right;
  if (beyond_y > 0) {
    const double upper_right = upper * right;
    row[flux.width] += upper - upper_right;
    if (beyond_x > 0) row[flux.width + 1] += upper_right;
  }
}

void LightGrid::add_segment(const Vec2& a, const Vec2& b, const Vec2& c, double amount) {
  // The longest edge carries the segment; the third corner is where the density peaks.
  std::array<Vec2, 3> p = {a, b, c};
  double longest = (b - a).squaredNorm();
  if (const double bc = (c - b).squaredNorm(); bc > longest) {
    longest = bc;
    p = {b, c, a};
  }
  if ((a - c).squaredNorm() > longest) {
    longest = (a - c).squaredNorm();
    p = {c, a, b};
  }
  const Vec2 along = p[1] - p[0];
  const double peak = std::clamp((p[2] - p[0]).dot(along) / longest, 0.0, 1.0);
  const auto share_up_to = [&](double t) {
    if (t <= peak) return peak > 0 ? t * t / peak : 0.0;
    return 1 - (1 - t) * (1 - t) / (1 - peak);
  };
  // Cut at every pixel line of the grid; lines beside it only bound what is outside.
  std::vector<double> cuts = {0.0, 1.0};
  const int last_line[2] = {flux.width, flux.height};
  for (int axis = 0; axis < 2; ++axis) {
    if (along[axis] == 0) continue;
    const double low = std::min(p[0][axis], p[1][axis]);
    const double high = std::max(p[0][axis], p[1][axis]);
    const int first = pixel_of(low, -1, last_line[axis]) + 1;
    for (int line = std::max(first, 0); line <= last_line[axis] && line < high; ++line) {
      const double t = (line - p[0][axis]) / along[axis];
      if (t > 0 && t < 1) cuts.push_back(t);
    }
  }
  std::sort(cuts.begin(), cuts.end());
  double left_over = amount;
  double before = 0;
  for (std::size_t k = 1; k < cuts.size(); ++k) {
    const double upto = k + 1 == cuts.size() ? 1.0 : share_up_to(cuts[k]);
    const double share = amount * (upto - before);
    before = upto;
    const Vec2 middle = p[0] + along * ((cuts[k - 1] + cuts[k]) / 2);
    if (middle.x() >= 0 && middle.y() >= 0 && middle.x() < flux.width && middle.y() < flux.height) {
      flux.at(static_cast<int>(middle.x()), static_cast<int>(middle.y())) += share;
      left_over -= share;
    }
  }
  outside += left_over;
}

void LightGrid::add_triangle(const Vec2& a, const Vec2& b, const Vec2& c, double amount) {
  const Vec2 low = a.cwiseMin(b).cwiseMin(c);
  const Vec2 high = a.cwiseMax(b).cwiseMax(c);
  if (!(high.x() > 0 && high.y() > 0 && low.x() < flux.width && low.y() < flux.height)) {
    if (high == low) {
      add_point(a, amount);
    } else {
      outside += amount;
    }
    return;
  }
  const int i0 = pixel_of(low.x(), 0, flux.width - 1);
  const int i1 = pixel_of(high.x(), 0, flux.width - 1);
  const int j0 = pixel_of(low.y(), 0, flux.height - 1);
  const int j1 = pixel_of(high.y(), 0, flux.height - 1);
  const bool inside = low.x() >= 0 && low.y() >= 0 && high.x() <= flux.width && high.y() <= flux.height;
  if (inside && i0 == i1 && j0 == j1) {
    flux.at(i0, j0) += amount;
    return;
  }
  const double longest = std::max({(b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm()});
  if (longest < kTiny * kTiny) {
    add_point((a + b + c) / 3, amount);
    return;
  }
  const Vec2 ab = b - a;
  const Vec2 ac = c - a;
  const double twice_area = std::abs(ab.x() * ac.y() - ab.y() * ac.x());
  if (twice_area < kThin * longest) {
    add_segment(a, b, c, amount);
    return;
  }

  // Cut off what lies left of and below the grid, then row by row and pixel by pixel; what remains lies above or right.
  const double density = 2 * amount / twice_area;
  double left_over = amount;
  SmallPolygon rest, row, pixel, next;
  rest.add(a);
  rest.add(b);
  rest.add(c);
  if (low.y() < 0) {
    split(rest, 1, 0.0, pixel, next);
    rest = next;
  }
  double* last = nullptr;
  for (int j = j0; j <= j1 && rest.size > 2; ++j) {
    if (high.y() > j + 1) {
      split(rest, 1, j + 1.0, row, next);
      rest = next;
    } else {
      row = rest;
      rest.size = 0;
    }
    if (low.x() < 0 && row.size > 2) {
      split(row, 0, 0.0, pixel, next);
      row = next;
    }
    for (int i = i0; i <= i1 && row.size > 2; ++i) {
      if (high.x() > i + 1) {
        split(row, 0, i + 1.0, pixel, next);
        row = next;
      } else {
        pixel = row;
        row.size = 0;
      }
      if (pixel.size < 3) continue;
      const double share = density * pixel.area();
      last = &flux.at(i, j);
      *last += share;
      left_over -= share;
    }
  }
  // Of a triangle inside the grid only rounding is left over: it stays with the triangle's light.
  if (inside && last) {
    *last += left_over;
  } else {
    outside += left_over;
  }
}

}  // namespace lightmill::detail

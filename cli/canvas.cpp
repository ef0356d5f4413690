#include "cli/canvas.h"

#include <algorithm>
#include <cmath>

#include "design/core/image.h"

namespace lightmill {

namespace {

template <std::size_t N>
Colour ramp(const std::array<Colour, N>& stops, double t) {
  t = std::clamp(t, 0.0, 1.0) * (N - 1);
  const std::size_t i = std::min<std::size_t>(static_cast<std::size_t>(t), N - 2);
  return mix(stops[i], stops[i + 1], t - static_cast<double>(i));
}

// 5 x 7 characters, one byte per row, bit 4 leftmost.
struct Glyph {
  char character;
  std::array<unsigned char, 7> rows;
};
constexpr std::array<Glyph, 22> kGlyphs = {{
    {'0', {14, 17, 19, 21, 25, 17, 14}},
    {'1', {4, 12, 4, 4, 4, 4, 14}},
    {'2', {14, 17, 1, 2, 4, 8, 31}},
    {'3', {31, 2, 4, 2, 1, 17, 14}},
    {'4', {2, 6, 10, 18, 31, 2, 2}},
    {'5', {31, 16, 30, 1, 1, 17, 14}},
    {'6', {6, 8, 16, 30, 17, 17, 14}},
    {'7', {31, 1, 2, 4, 8, 8, 8}},
    {'8', {14, 17, 17, 14, 17, 17, 14}},
    {'9', {14, 17, 17, 15, 1, 2, 12}},
    {'.', {0, 0, 0, 0, 0, 12, 12}},
    {'-', {0, 0, 0, 31, 0, 0, 0}},
    {'+', {0, 4, 4, 31, 4, 4, 0}},
    {'a', {0, 0, 14, 1, 15, 17, 15}},
    {'b', {16, 16, 22, 25, 17, 25, 22}},
    {'d', {1, 1, 13, 19, 17, 19, 13}},
    {'l', {12, 4, 4, 4, 4, 4, 14}},
    {'m', {0, 0, 26, 21, 21, 21, 21}},
    {'r', {0, 0, 22, 25, 16, 16, 16}},
    {'u', {0, 0, 18, 18, 18, 29, 16}},
    {' ', {0, 0, 0, 0, 0, 0, 0}},
    {'/', {1, 1, 2, 4, 8, 16, 16}},
}};

constexpr std::array<unsigned char, 7> kUnknown = {31, 17, 17, 17, 17, 17, 31};  // seen, not left out

float light(double code) {
  return static_cast<float>(code <= 0.04045 ? code / 12.92 : std::pow((code + 0.055) / 1.055, 2.4));
}

}  // namespace

Colour mix(const Colour& a, const Colour& b, double t) {
  return {a.r + (b.r - a.r) * t, a.g + (b.g - a.g) * t, a.b + (b.b - a.b) * t};
}

Colour height_colour(double t) {
  static constexpr std::array<Colour, 6> kStops = {{{0.18, 0.10, 0.34},
                                                    {0.20, 0.28, 0.55},
                                                    {0.13, 0.48, 0.56},
                                                    {0.20, 0.66, 0.47},
                                                    {0.60, 0.82, 0.28},
                                                    {0.99, 0.91, 0.35}}};
  return ramp(kStops, t);
}

Colour deviation_colour(double t) {
  static constexpr std::array<Colour, 5> kStops = {
      {{0.09, 0.24, 0.55}, {0.45, 0.65, 0.85}, {0.96, 0.96, 0.95}, {0.91, 0.56, 0.42}, {0.62, 0.09, 0.14}}};
  return ramp(kStops, 0.5 + 0.5 * t);
}

Canvas::Canvas(int width, int height, const Colour& ground) : r_(width, height), g_(width, height), b_(width, height) {
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) set(x, y, ground);
  }
}

void Canvas::set(int x, int y, const Colour& c) {
  if (x < 0 || y < 0 || x >= width() || y >= height()) return;
  r_.at(x, y) = light(c.r);
  g_.at(x, y) = light(c.g);
  b_.at(x, y) = light(c.b);
}

void Canvas::line(const Vec2& a, const Vec2& b, const Colour& c) {
  const int count = std::min(100000, 1 + static_cast<int>(std::ceil((b - a).cwiseAbs().maxCoeff())));
  for (int i = 0; i <= count; ++i) {
    const Vec2 p = a + (b - a) * (static_cast<double>(i) / count);
    set(static_cast<int>(std::floor(p.x())), static_cast<int>(std::floor(p.y())), c);
  }
}

void Canvas::dot(const Vec2& centre, double radius, const Colour& c) {
  const Vec2 low = (centre.array() - radius).floor();
  for (int y = static_cast<int>(low.y()); y <= centre.y() + radius; ++y) {
    for (int x = static_cast<int>(low.x()); x <= centre.x() + radius; ++x) {
      if ((Vec2(x + 0.5, y + 0.5) - centre).norm() <= radius) set(x, y, c);
    }
  }
}

void Canvas::text(int x, int y, std::string_view words, const Colour& c, int size) {
  for (const char ch : words) {
    const auto found = std::find_if(kGlyphs.begin(), kGlyphs.end(), [&](const Glyph& glyph) { return glyph.character == ch; });
    const auto& rows = found != kGlyphs.end() ? found->rows : kUnknown;
    for (int row = 0; row < 7 * size; ++row) {
      for (int column = 0; column < 5 * size; ++column) {
        if ((rows[row / size] >> (4 - column / size)) & 1) set(x + column, y + row, c);
      }
    }
    x += 6 * size;
  }
}

void Canvas::write(const std::filesystem::path& path) const {
  write_png8(path, r_, g_, b_);
}

}  // namespace lightmill

// Pixels to draw pictures for the eye on.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>

#include "design/core/geometry.h"
#include "design/core/grid.h"

namespace lightmill {

/// sRGB code values in [0, 1].
struct Colour {
  double r = 0, g = 0, b = 0;
};
Colour mix(const Colour& a, const Colour& b, double t);

/// Dark blue to yellow for 0 to 1, evenly growing in brightness.
Colour height_colour(double t);
/// -1: blue, 0: near white, 1: red.
Colour deviation_colour(double t);

inline constexpr Colour kPaper{1, 1, 1};
inline constexpr Colour kInk{0.15, 0.17, 0.20};
inline constexpr int kScaleWidth = 150;  ///< pixels beside a picture: the bar and its figures

/// Pixels with row 0 on top; what falls outside is not drawn.
class Canvas {
 public:
  Canvas(int width, int height, const Colour& ground);
  [[nodiscard]] int width() const { return r_.width; }
  [[nodiscard]] int height() const { return r_.height; }

  void set(int x, int y, const Colour& c);
  void line(const Vec2& a, const Vec2& b, const Colour& c);
  void dot(const Vec2& centre, double radius, const Colour& c);
  /// Figures and units only: a character without a glyph is a blank.
  void text(int x, int y, std::string_view words, const Colour& c, int size = 2);
  void write(const std::filesystem::path& path) const;

 private:
  Grid<float> r_, g_, b_;
};

/// A vertical bar with three figures, right of column `left`.
template <typename ColourOf>
void draw_scale(Canvas& canvas, int left, const ColourOf& colour_of, const std::array<std::string, 3>& top_middle_bottom) {
  const int top = 24;
  const int bottom = canvas.height() - 24;
  for (int y = top; y < bottom; ++y) {
    for (int x = left + 14; x < left + 34; ++x) canvas.set(x, y, colour_of(1 - static_cast<double>(y - top) / (bottom - 1 - top)));
  }
  canvas.text(left + 40, top - 7, top_middle_bottom[0], kInk);
  canvas.text(left + 40, (top + bottom) / 2 - 7, top_middle_bottom[1], kInk);
  canvas.text(left + 40, bottom - 7, top_middle_bottom[2], kInk);
}

}  // namespace lightmill

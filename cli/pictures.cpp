#include "cli/pictures.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <string_view>

#include "design/core/image.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

/// sRGB code values in [0, 1].
struct Colour {
  double r = 0, g = 0, b = 0;
};

Colour mix(const Colour& a, const Colour& b, double t) {
  return {a.r + (b.r - a.r) * t, a.g + (b.g - a.g) * t, a.b + (b.b - a.b) * t};
}

template <std::size_t N>
Colour ramp(const std::array<Colour, N>& stops, double t) {
  t = std::clamp(t, 0.0, 1.0) * (N - 1);
  const std::size_t i = std::min<std::size_t>(static_cast<std::size_t>(t), N - 2);
  return mix(stops[i], stops[i + 1], t - static_cast<double>(i));
}

/// Dark blue to yellow, evenly growing in brightness.
Colour height_colour(double t) {
  static constexpr std::array<Colour, 6> kStops = {
      {{0.18, 0.10, 0.34}, {0.20, 0.28, 0.55}, {0.13, 0.48, 0.56}, {0.20, 0.66, 0.47}, {0.60, 0.82, 0.28}, {0.99, 0.91, 0.35}}};
  return ramp(kStops, t);
}

/// -1: blue (missing), 0: near white, 1: red (left).
Colour deviation_colour(double t) {
  static constexpr std::array<Colour, 5> kStops = {
      {{0.09, 0.24, 0.55}, {0.45, 0.65, 0.85}, {0.96, 0.96, 0.95}, {0.91, 0.56, 0.42}, {0.62, 0.09, 0.14}}};
  return ramp(kStops, 0.5 + 0.5 * t);
}

// 5 x 7 characters, one byte per row, bit 4 leftmost.
struct Glyph {
  char character;
  std::array<unsigned char, 7> rows;
};
constexpr std::array<Glyph, 16> kGlyphs = {{
    {'0', {14, 17, 19, 21, 25, 17, 14}}, {'1', {4, 12, 4, 4, 4, 4, 14}},    {'2', {14, 17, 1, 2, 4, 8, 31}},
    {'3', {31, 2, 4, 2, 1, 17, 14}},     {'4', {2, 6, 10, 18, 31, 2, 2}},   {'5', {31, 16, 30, 1, 1, 17, 14}},
    {'6', {6, 8, 16, 30, 17, 17, 14}},   {'7', {31, 1, 2, 4, 8, 8, 8}},     {'8', {14, 17, 17, 14, 17, 17, 14}},
    {'9', {14, 17, 17, 15, 1, 2, 12}},   {'.', {0, 0, 0, 0, 0, 12, 12}},    {'-', {0, 0, 0, 31, 0, 0, 0}},
    {'+', {0, 4, 4, 31, 4, 4, 0}},       {'m', {0, 0, 26, 21, 21, 21, 21}}, {'u', {0, 0, 18, 18, 18, 29, 16}},
    {' ', {0, 0, 0, 0, 0, 0, 0}},
}};

/// Pixels with row 0 on top; what falls outside is not drawn.
class Canvas {
 public:
  Canvas(int width, int height, const Colour& ground) : r_(width, height), g_(width, height), b_(width, height) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) set(x, y, ground);
    }
  }
  [[nodiscard]] int width() const { return r_.width; }
  [[nodiscard]] int height() const { return r_.height; }

  void set(int x, int y, const Colour& c) {
    if (x < 0 || y < 0 || x >= width() || y >= height()) return;
    r_.at(x, y) = light(c.r);
    g_.at(x, y) = light(c.g);
    b_.at(x, y) = light(c.b);
  }
  void line(Vec2 a, Vec2 b, const Colour& c) {
    const int count = std::min(100000, 1 + static_cast<int>(std::ceil((b - a).cwiseAbs().maxCoeff())));
    for (int i = 0; i <= count; ++i) {
      const Vec2 p = a + (b - a) * (static_cast<double>(i) / count);
      set(static_cast<int>(std::floor(p.x())), static_cast<int>(std::floor(p.y())), c);
    }
  }
  void text(int x, int y, std::string_view words, const Colour& c, int size = 2) {
    for (const char ch : words) {
      for (const auto& glyph : kGlyphs) {
        if (glyph.character != ch) continue;
        for (int row = 0; row < 7 * size; ++row) {
          for (int column = 0; column < 5 * size; ++column) {
            if ((glyph.rows[row / size] >> (4 - column / size)) & 1) set(x + column, y + row, c);
          }
        }
      }
      x += 6 * size;
    }
  }
  void write(const std::filesystem::path& path) const { write_png8(path, r_, g_, b_); }

 private:
  static float light(double code) {
    return static_cast<float>(code <= 0.04045 ? code / 12.92 : std::pow((code + 0.055) / 1.055, 2.4));
  }
  Grid<float> r_, g_, b_;
};

constexpr Colour kPaper{1, 1, 1};
constexpr Colour kInk{0.15, 0.17, 0.20};
constexpr int kScaleWidth = 150;  // pixels beside the picture: the bar and its figures

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

}  // namespace

Grid<float> rasterise_heights(const SurfaceMesh& mesh, const Box2& extent, int pixels) {
  const double pixel_mm = extent.size().maxCoeff() / pixels;
  Grid<float> heights(std::max(1, static_cast<int>(std::lround(extent.size().x() / pixel_mm))),
                      std::max(1, static_cast<int>(std::lround(extent.size().y() / pixel_mm))),
                      std::numeric_limits<float>::quiet_NaN());
  for (const auto& triangle : mesh.triangles) {
    const Vec3& a = mesh.vertices[triangle[0]];
    const Vec3& b = mesh.vertices[triangle[1]];
    const Vec3& c = mesh.vertices[triangle[2]];
    const double area = (b.x() - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (b.y() - a.y());
    if (area == 0) continue;
    const auto column = [&](double x) { return (x - extent.min.x()) / pixel_mm - 0.5; };
    const auto row = [&](double y) { return (y - extent.min.y()) / pixel_mm - 0.5; };
    const int x0 = std::max(0, static_cast<int>(std::ceil(column(std::min({a.x(), b.x(), c.x()})) - 1e-6)));
    const int x1 = std::min(heights.width - 1, static_cast<int>(std::floor(column(std::max({a.x(), b.x(), c.x()})) + 1e-6)));
    const int y0 = std::max(0, static_cast<int>(std::ceil(row(std::min({a.y(), b.y(), c.y()})) - 1e-6)));
    const int y1 = std::min(heights.height - 1, static_cast<int>(std::floor(row(std::max({a.y(), b.y(), c.y()})) + 1e-6)));
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        const double px = extent.min.x() + (x + 0.5) * pixel_mm;
        const double py = extent.min.y() + (y + 0.5) * pixel_mm;
        const double v = ((px - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (py - a.y())) / area;
        const double w = ((b.x() - a.x()) * (py - a.y()) - (px - a.x()) * (b.y() - a.y())) / area;
        if (v < -1e-9 || w < -1e-9 || v + w > 1 + 1e-9) continue;
        heights.at(x, y) = static_cast<float>(a.z() + v * (b.z() - a.z()) + w * (c.z() - a.z()));
      }
    }
  }
  return heights;
}

Grid<float> sample_heights(const SplineSurface& surface, int pixels) {
  const Box2& extent = surface.extent();
  const double pixel_mm = extent.size().maxCoeff() / pixels;
  Grid<float> heights(std::max(1, static_cast<int>(std::lround(extent.size().x() / pixel_mm))),
                      std::max(1, static_cast<int>(std::lround(extent.size().y() / pixel_mm))));
  for (int y = 0; y < heights.height; ++y) {
    for (int x = 0; x < heights.width; ++x) {
      heights.at(x, y) = static_cast<float>(
          surface.height(extent.min.x() + (x + 0.5) * pixel_mm, extent.min.y() + (y + 0.5) * pixel_mm));
    }
  }
  return heights;
}

void write_height_picture(const std::filesystem::path& path, const Grid<float>& heights_mm, double pixel_mm) {
  float lowest = std::numeric_limits<float>::infinity();
  float highest = -lowest;
  for (const float h : heights_mm.values) {
    if (!std::isfinite(h)) continue;
    lowest = std::min(lowest, h);
    highest = std::max(highest, h);
  }
  if (!(lowest <= highest)) lowest = highest = 0;
  const double range = std::max<double>(highest - lowest, 1e-9);
  const int w = heights_mm.width;
  const int h = heights_mm.height;
  Canvas canvas(w + kScaleWidth, std::max(h, 120), kPaper);
  // Shade slopes strongly: a lens's relief is a few mm over 100.
  const double exaggeration = 0.35 * std::min(w, h) * pixel_mm / (10 * range) + 1;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const double z = heights_mm.at(x, y);
      if (!std::isfinite(z)) continue;
      const auto slope = [&](double before, double after, int cells) {
        const double s = cells > 0 ? (after - before) / (cells * pixel_mm) : 0;
        return std::isfinite(s) ? s * exaggeration : 0;
      };
      const double dx = slope(heights_mm.at(std::max(x - 1, 0), y), heights_mm.at(std::min(x + 1, w - 1), y), std::min(x + 1, w - 1) - std::max(x - 1, 0));
      const double dy = slope(heights_mm.at(x, std::max(y - 1, 0)), heights_mm.at(x, std::min(y + 1, h - 1)), std::min(y + 1, h - 1) - std::max(y - 1, 0));
      // Light from the upper left.
      const double shade = (0.5 * dx - 0.5 * dy + 0.8) / std::sqrt((dx * dx + dy * dy + 1) * 1.14);
      const Colour c = height_colour((z - lowest) / range);
      canvas.set(x, h - 1 - y, shade < 0.75 ? mix({0.05, 0.05, 0.1}, c, std::clamp(0.25 + shade, 0.0, 1.0)) : mix(c, {1, 1, 1}, std::clamp(1.6 * (shade - 0.75), 0.0, 0.6)));
    }
  }
  draw_scale(canvas, w, height_colour, {fixed(highest, 2) + " mm", fixed((lowest + highest) / 2, 2), fixed(lowest, 2)});
  canvas.write(path);
}

void write_toolpath_picture(const std::filesystem::path& path, const ToolPath& tool_path, const Blank& blank) {
  // The blank fills most of the picture; entries and exits beside it are visible.
  constexpr int kPixels = 900;
  Box2 view = Box2::centred(blank.size_mm);
  // A tilted ball's tip is beside what it cuts; its centre is above.
  const double up = tool_path.cutter.is_ball() ? tool_path.cutter.radius_mm() : 0;
  const auto place = [&](const Move& move) -> Vec3 { return move.pose.tip_mm + up * move.pose.axis; };
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -lowest;
  for (const Move& move : tool_path.moves) {
    if (move.kind != MoveKind::kCut) continue;
    lowest = std::min(lowest, place(move).z());
    highest = std::max(highest, place(move).z());
    view.include(place(move).head<2>());
  }
  const double range = std::max(highest - lowest, 1e-9);
  const double scale = (kPixels - 40) / view.size().maxCoeff();
  const int width = 40 + static_cast<int>(std::ceil(view.size().x() * scale));
  const int height = 40 + static_cast<int>(std::ceil(view.size().y() * scale));
  Canvas canvas(width + kScaleWidth, std::max(height, 120), kPaper);
  const auto pixel = [&](const Vec3& p) {
    return Vec2(20 + (p.x() - view.min.x()) * scale, height - 20 - (p.y() - view.min.y()) * scale);
  };
  const Vec2 half = blank.size_mm / 2;
  for (int y = static_cast<int>(pixel({0, half.y(), 0}).y()); y < pixel({0, -half.y(), 0}).y(); ++y) {
    for (int x = static_cast<int>(pixel({-half.x(), 0, 0}).x()); x < pixel({half.x(), 0, 0}).x(); ++x) canvas.set(x, y, {0.93, 0.94, 0.95});
  }
  // Passes start at a link or rapid; draw every k-th, so that lines stay 4 pixels apart.
  const double spacing = std::max(tool_path.stepover_mm * scale, 1e-3);
  const int every = std::max(1, static_cast<int>(std::ceil(4 / spacing)));
  int pass = 0;
  MoveKind before = MoveKind::kRapid;
  for (std::size_t i = 1; i < tool_path.moves.size(); ++i) {
    const Move& move = tool_path.moves[i];
    const bool cut = move.kind == MoveKind::kCut || move.kind == MoveKind::kPlunge;
    if (cut && before != MoveKind::kCut && before != MoveKind::kPlunge) ++pass;
    before = move.kind;
    if (pass % every != 0) continue;
    const Vec2 a = pixel(place(tool_path.moves[i - 1]));
    const Vec2 b = pixel(place(move));
    const Colour colour = cut ? height_colour((place(move).z() - lowest) / range)
                              : move.kind == MoveKind::kRapid ? Colour{0.85, 0.30, 0.25} : Colour{0.95, 0.65, 0.25};
    canvas.line(a, b, colour);
  }
  draw_scale(canvas, width, height_colour, {fixed(std::isfinite(highest) ? highest : 0, 2) + " mm", "", fixed(std::isfinite(lowest) ? lowest : 0, 2)});
  canvas.write(path);
}

void write_deviation_picture(const std::filesystem::path& path, const Grid<float>& deviation_um, double range_um) {
  constexpr int kPixels = 900;
  const int factor = std::max(1, (std::max(deviation_um.width, deviation_um.height) + kPixels - 1) / kPixels);
  const int width = (deviation_um.width + factor - 1) / factor;
  const int height = (deviation_um.height + factor - 1) / factor;
  // Small parts are drawn larger.
  const int zoom = std::max(1, 500 / std::max(width, height));
  Canvas canvas(width * zoom + kScaleWidth, std::max(height * zoom, 120), kPaper);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      float strongest = 0;
      for (int v = y * factor; v < std::min((y + 1) * factor, deviation_um.height); ++v) {
        for (int u = x * factor; u < std::min((x + 1) * factor, deviation_um.width); ++u) {
          const float d = deviation_um.at(u, v);
          if (std::isfinite(d) && std::abs(d) > std::abs(strongest)) strongest = d;
        }
      }
      const Colour colour = deviation_colour(std::clamp(strongest / range_um, -1.0, 1.0));
      for (int v = 0; v < zoom; ++v) {
        for (int u = 0; u < zoom; ++u) canvas.set(x * zoom + u, (height - 1 - y) * zoom + v, colour);
      }
    }
  }
  const std::string range = compact(range_um, 1);
  draw_scale(canvas, width * zoom, [](double t) { return deviation_colour(2 * t - 1); }, {"+" + range + " um", "0", "-" + range + " um"});
  canvas.write(path);
}

}  // namespace lightmill

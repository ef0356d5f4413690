#include "cli/pictures.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "cli/canvas.h"
#include "design/core/raster.h"
#include "design/core/text.h"

namespace lightmill {

Grid<float> rasterise_values(const SurfaceMesh& mesh, const std::vector<double>& values, const Box2& extent, int pixels) {
  const double pixel_mm = extent.size().maxCoeff() / pixels;
  Grid<float> grid(std::max(1, static_cast<int>(std::lround(extent.size().x() / pixel_mm))),
                   std::max(1, static_cast<int>(std::lround(extent.size().y() / pixel_mm))),
                   std::numeric_limits<float>::quiet_NaN());
  std::vector<Vec2> places;
  for (const Vec3& v : mesh.vertices) places.emplace_back(v.head<2>());
  for_each_pixel(places, mesh.triangles, extent, grid.width, grid.height, [&](int x, int y, int t, const Vec3& weights) {
    double value = 0;
    for (int k = 0; k < 3; ++k) value += weights[k] * values[mesh.triangles[t][k]];
    grid.at(x, y) = static_cast<float>(value);
  });
  return grid;
}

Grid<float> rasterise_heights(const SurfaceMesh& mesh, const Box2& extent, int pixels) {
  std::vector<double> heights;
  for (const Vec3& v : mesh.vertices) heights.push_back(v.z());
  return rasterise_values(mesh, heights, extent, pixels);
}

Grid<float> sample_heights(const SplineSurface& surface, int pixels) {
  return sample_surface(surface, pixels, [](const Vec2&, const SplineSurface::Sample& s) { return s.h; });
}

Grid<float> sample_surface(const SplineSurface& surface, int pixels, const std::function<double(const Vec2& place_mm, const SplineSurface::Sample&)>& value) {
  const Box2& extent = surface.extent();
  const double pixel_mm = extent.size().maxCoeff() / pixels;
  Grid<float> values(std::max(1, static_cast<int>(std::lround(extent.size().x() / pixel_mm))),
                     std::max(1, static_cast<int>(std::lround(extent.size().y() / pixel_mm))));
  for (int y = 0; y < values.height; ++y) {
    for (int x = 0; x < values.width; ++x) {
      const Vec2 place = extent.min + pixel_mm * Vec2(x + 0.5, y + 0.5);
      values.at(x, y) = static_cast<float>(value(place, surface.sample(place.x(), place.y())));
    }
  }
  return values;
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
  // Passes start at a link or rapid, a spiral's turns where the last one is full; draw every k-th, so that lines stay 4 pixels apart.
  const double spacing = std::max(tool_path.stepover_mm * scale, 1e-3);
  const int every = std::max(1, static_cast<int>(std::ceil(4 / spacing)));
  int pass = 0;
  MoveKind before = MoveKind::kRapid;
  Vec2 heading(1, 0);
  double turned = 0;
  for (std::size_t i = 1; i < tool_path.moves.size(); ++i) {
    const Move& move = tool_path.moves[i];
    const bool cut = move.kind == MoveKind::kCut || move.kind == MoveKind::kPlunge;
    const Vec2 way = (place(move) - place(tool_path.moves[i - 1])).head<2>();
    if (cut && way.norm() > 1e-9) {
      turned += std::atan2(heading.x() * way.y() - heading.y() * way.x(), heading.dot(way));
      heading = way;
    }
    if ((cut && before != MoveKind::kCut && before != MoveKind::kPlunge) || std::abs(turned) > 2 * kPi) {
      ++pass;
      turned = 0;
    }
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

namespace {

/// The box of the values that are finite, all of the grid where none is.
Grid<float> finite_part(const Grid<float>& values) {
  int left = values.width, right = -1, bottom = values.height, top = -1;
  for (int y = 0; y < values.height; ++y) {
    for (int x = 0; x < values.width; ++x) {
      if (!std::isfinite(values.at(x, y))) continue;
      left = std::min(left, x);
      right = std::max(right, x);
      bottom = std::min(bottom, y);
      top = y;
    }
  }
  if (right < 0 || (left == 0 && bottom == 0 && right == values.width - 1 && top == values.height - 1)) return values;
  Grid<float> part(right - left + 1, top - bottom + 1);
  for (int y = 0; y < part.height; ++y) {
    for (int x = 0; x < part.width; ++x) part.at(x, y) = values.at(left + x, bottom + y);
  }
  return part;
}

}  // namespace

void write_deviation_picture(const std::filesystem::path& path, const Grid<float>& values, double range_um, const std::string& unit) {
  const Grid<float> deviation_um = finite_part(values);
  constexpr int kPixels = 900;
  const int factor = std::max(1, (std::max(deviation_um.width, deviation_um.height) + kPixels - 1) / kPixels);
  const int width = (deviation_um.width + factor - 1) / factor;
  const int height = (deviation_um.height + factor - 1) / factor;
  // Small parts are drawn larger.
  const int zoom = std::max(1, 500 / std::max(width, height));
  Canvas canvas(width * zoom + kScaleWidth, std::max(height * zoom, 120), kPaper);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      float strongest = std::numeric_limits<float>::quiet_NaN();
      for (int v = y * factor; v < std::min((y + 1) * factor, deviation_um.height); ++v) {
        for (int u = x * factor; u < std::min((x + 1) * factor, deviation_um.width); ++u) {
          const float d = deviation_um.at(u, v);
          if (std::isfinite(d) && !(std::abs(d) <= std::abs(strongest))) strongest = d;
        }
      }
      if (!std::isfinite(strongest)) continue;  // beside the lens: paper
      const Colour colour = deviation_colour(std::clamp(strongest / range_um, -1.0, 1.0));
      for (int v = 0; v < zoom; ++v) {
        for (int u = 0; u < zoom; ++u) canvas.set(x * zoom + u, (height - 1 - y) * zoom + v, colour);
      }
    }
  }
  const std::string range = compact(range_um, 1);
  draw_scale(canvas, width * zoom, [](double t) { return deviation_colour(2 * t - 1); }, {"+" + range + " " + unit, "0", "-" + range + " " + unit});
  canvas.write(path);
}

}  // namespace lightmill

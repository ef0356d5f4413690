#include "design/color_mask.h"

#include <algorithm>
#include <cmath>

#include "design/core/raster.h"

namespace lightmill {

namespace {

/// Bilinear between pixels' centres; black beside the picture.
Vec3 colour_at(const ColourGrid& colours, const Vec2& place) {
  if (!colours.extent.contains(place)) return Vec3::Zero();
  const int width = colours.red.width;
  const int height = colours.red.height;
  const Vec2 at = (place - colours.extent.min).cwiseQuotient(colours.extent.size()).cwiseProduct(Vec2(width, height));
  const double x = std::clamp(at.x() - 0.5, 0.0, width - 1.0);
  const double y = std::clamp(at.y() - 0.5, 0.0, height - 1.0);
  const int i = static_cast<int>(x);
  const int j = static_cast<int>(y);
  Vec3 sum = Vec3::Zero();
  for (int v = 0; v < 2; ++v) {
    for (int u = 0; u < 2; ++u) {
      const double weight = (u ? x - i : 1 - x + i) * (v ? y - j : 1 - y + j);
      if (weight == 0) continue;
      const std::size_t k = colours.red.index(i + u, j + v);
      sum += weight * Vec3(colours.red.values[k], colours.green.values[k], colours.blue.values[k]);
    }
  }
  return sum;
}

void set(ColourGrid& grid, int x, int y, const Vec3& colour) {
  grid.red.at(x, y) = static_cast<float>(colour[0]);
  grid.green.at(x, y) = static_cast<float>(colour[1]);
  grid.blue.at(x, y) = static_cast<float>(colour[2]);
}

}  // namespace

std::optional<ColourGrid> target_colours(const TargetSpec& spec) {
  const std::filesystem::path& file = spec.colours.empty() ? spec.image : spec.colours;
  if (file.empty()) return {};
  const Picture picture = read_picture(file, spec.transfer, true);
  if (picture.red.empty() ||
      (picture.red.values == picture.green.values && picture.green.values == picture.blue.values))
    return {};
  // as_seen() is its own inverse: from the picture to the receiver.
  return ColourGrid{Box2::centred(spec.size_mm), as_seen(picture.red, spec.viewed_from),
                    as_seen(picture.green, spec.viewed_from), as_seen(picture.blue, spec.viewed_from)};
}

void clear_for_curves(ColourGrid& colours, const TargetLight& target) {
  if (target.curves.empty() && target.points.empty()) return;
  constexpr double kDark = 0.05;      // linear; darker colours of a photo are noise more than colour
  constexpr double kBeside_mm = 1.0;  // that the light of a curve spreads
  const int width = colours.red.width;
  const int height = colours.red.height;
  TargetLight singular = target;
  singular.extent = colours.extent;
  singular.area_flux = {};
  singular.area_borders.clear();
  const Grid<double> lit = rasterise(singular, width, height);
  const Vec2 pixel = colours.extent.size().cwiseQuotient(Vec2(width, height));
  const int reach_x = static_cast<int>(std::lround(kBeside_mm / pixel.x()));
  const int reach_y = static_cast<int>(std::lround(kBeside_mm / pixel.y()));
  std::vector<char> near(lit.values.size(), 0);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (!(lit.at(x, y) > 0)) continue;
      for (int j = std::max(0, y - reach_y); j <= std::min(height - 1, y + reach_y); ++j) {
        for (int i = std::max(0, x - reach_x); i <= std::min(width - 1, x + reach_x); ++i) near[lit.index(i, j)] = 1;
      }
    }
  }
  for (std::size_t k = 0; k < near.size(); ++k) {
    const float brightest = std::max({colours.red.values[k], colours.green.values[k], colours.blue.values[k]});
    const float lift = static_cast<float>(kDark) - brightest;
    if (!near[k] || lift <= 0) continue;
    for (Grid<float>* channel : {&colours.red, &colours.green, &colours.blue}) channel->values[k] += lift;
  }
}

Vec3 filter_of(const Vec3& colour) {
  const double brightest = colour.maxCoeff();
  return brightest > 0 ? Vec3(colour / brightest) : Vec3::Zero();
}

ColourGrid colour_mask(const SurfaceMesh& mesh, const std::vector<RayEnds>& ends, const ColourGrid& colours,
                       const Box2& extent, double pixels_per_mm) {
  const int width = std::max(1, static_cast<int>(std::lround(extent.size().x() * pixels_per_mm)));
  const int height = std::max(1, static_cast<int>(std::lround(extent.size().y() * pixels_per_mm)));
  ColourGrid mask{extent, Grid<float>(width, height, 1.0F), Grid<float>(width, height, 1.0F),
                  Grid<float>(width, height, 1.0F)};
  std::vector<Vec2> entries;
  for (const RayEnds& end : ends) entries.push_back(end.entry_mm);
  for_each_pixel(entries, mesh.triangles, extent, width, height, [&](int x, int y, int t, const Vec3& weights) {
    Vec2 landed = Vec2::Zero();
    for (int k = 0; k < 3; ++k) {
      const RayEnds& end = ends[mesh.triangles[t][k]];
      if (!end.lands) return;
      landed += weights[k] * end.landed_mm;
    }
    set(mask, x, y, filter_of(colour_at(colours, landed)));
  });
  return mask;
}

ColourGrid coloured(const Caustic& caustic, const ColourGrid& colours) {
  const int width = caustic.flux.width;
  const int height = caustic.flux.height;
  ColourGrid result{caustic.extent, Grid<float>(width, height), Grid<float>(width, height), Grid<float>(width, height)};
  const Vec2 pixel = caustic.extent.size().cwiseQuotient(Vec2(width, height));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Vec2 place = caustic.extent.min + pixel.cwiseProduct(Vec2(x + 0.5, y + 0.5));
      set(result, x, y, caustic.flux.at(x, y) * filter_of(colour_at(colours, place)));
    }
  }
  return result;
}

}  // namespace lightmill

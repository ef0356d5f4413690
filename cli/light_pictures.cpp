#include "cli/light_pictures.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "cli/canvas.h"
#include "design/core/image.h"
#include "design/core/raster.h"
#include "design/core/text.h"
#include "design/diagnostics.h"

namespace lightmill {

namespace {

/// Pixels of a picture of a box whose longer side has `pixels`.
std::array<int, 2> pixels_of(const Box2& box, int pixels) {
  const double pixel = box.size().maxCoeff() / pixels;
  return {std::max(1, static_cast<int>(std::lround(box.size().x() / pixel))),
          std::max(1, static_cast<int>(std::lround(box.size().y() / pixel)))};
}

std::vector<Vec2> in_plan(const SurfaceMesh& mesh) {
  std::vector<Vec2> places;
  for (const Vec3& v : mesh.vertices) places.emplace_back(v.head<2>());
  return places;
}

/// Where a place of the receiver is in a picture of `box` that is `width` pixels wide, as its reader sees it.
struct ReceiverView {
  Box2 box;
  int width, height;
  ViewedFrom viewed_from;
  [[nodiscard]] Vec2 operator()(const Vec2& p) const {
    const Vec2 share = (p - box.min).cwiseQuotient(box.size());
    return {width * (viewed_from == ViewedFrom::kLens ? 1 - share.x() : share.x()), height * (1 - share.y())};
  }
};

}  // namespace

void write_curvature_picture(const std::filesystem::path& path, const SurfaceMesh& mesh, const Box2& lens_box) {
  constexpr int kPixels = 800;
  constexpr double kUnclipped = 0.98;
  const auto [width, height] = pixels_of(lens_box, kPixels);
  const std::vector<double> curvatures = mean_curvatures(mesh);
  std::vector<double> strength;
  for (const double c : curvatures) strength.push_back(std::abs(c));
  const auto place =
      strength.begin() + static_cast<std::ptrdiff_t>(kUnclipped * static_cast<double>(strength.size() - 1));
  std::nth_element(strength.begin(), place, strength.end());
  const double range = std::max(*place, 1e-12);
  Canvas canvas(width + kScaleWidth, std::max(height, 120), kPaper);
  for_each_pixel(in_plan(mesh), mesh.triangles, lens_box, width, height, [&](int x, int y, int t, const Vec3&) {
    canvas.set(x, height - 1 - y, deviation_colour(std::clamp(curvatures[t] / range, -1.0, 1.0)));
  });
  const std::string per_m = compact(1000 * range, 1);
  draw_scale(canvas, width, [](double t) { return deviation_colour(2 * t - 1); },
             {"+" + per_m + " /m", "0", "-" + per_m + " /m"});
  canvas.write(path);
}

void write_checkerboard_picture(const std::filesystem::path& path, const SurfaceMesh& mesh,
                                const std::vector<RayEnds>& ends, const Box2& lens_box, const Box2& picture,
                                int squares) {
  constexpr int kPixels = 800;
  constexpr Colour kBlack{0.08, 0.08, 0.10};
  constexpr Colour kBeside{0.45, 0.55, 0.66};
  const auto [width, height] = pixels_of(lens_box, kPixels);
  const double square = picture.size().maxCoeff() / squares;
  Canvas canvas(width, height, {0.75, 0.75, 0.75});
  for_each_pixel(in_plan(mesh), mesh.triangles, lens_box, width, height, [&](int x, int y, int t, const Vec3& weights) {
    Vec2 landed = Vec2::Zero();
    for (int k = 0; k < 3; ++k) {
      const RayEnds& end = ends[mesh.triangles[t][k]];
      if (!end.lands) return;
      landed += weights[k] * end.landed_mm;
    }
    const Vec2 field = ((landed - picture.min) / square).array().floor();
    const bool dark = static_cast<long>(field.x() + field.y()) % 2 != 0;
    canvas.set(x, height - 1 - y, !picture.contains(landed) ? kBeside : dark ? kBlack : kPaper);
  });
  canvas.write(path);
}

void write_samples_picture(const std::filesystem::path& path, const TransportMap& map, const Box2& source_box,
                           const Box2& picture, ViewedFrom viewed_from) {
  constexpr int kPixels = 480;  // of each still
  constexpr int kAlong = 64;    // samples along the longer side
  constexpr int kStills = 4;
  constexpr int kGap = 12;
  Box2 view = source_box;
  view.include(picture.min);
  view.include(picture.max);
  const auto [width, height] = pixels_of(view, kPixels);
  const double pitch = source_box.size().maxCoeff() / kAlong;
  std::vector<Vec2> places;
  for (double y = source_box.min.y() + pitch / 2; y < source_box.max.y(); y += pitch) {
    for (double x = source_box.min.x() + pitch / 2; x < source_box.max.x(); x += pitch) places.emplace_back(x, y);
  }
  const std::vector<int> samples = nearest_samples(map, places);
  Canvas canvas(kStills * width + (kStills - 1) * kGap, height, kPaper);
  for (int still = 0; still < kStills; ++still) {
    const double time = static_cast<double>(still) / (kStills - 1);
    const ReceiverView view_of{view, width, height, viewed_from};
    const Vec2 corner(still * (width + kGap), 0);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) canvas.set(static_cast<int>(corner.x()) + x, y, {0.07, 0.08, 0.11});
    }
    for (std::size_t k = 0; k < places.size(); ++k) {
      const Vec2& from = map.source_centroids_mm[samples[k]];
      if ((from - places[k]).norm() > pitch) continue;  // no light starts here
      const Vec2& to = map.target_centroids_mm[samples[k]];
      const Vec2 share = (from - source_box.min).cwiseQuotient(source_box.size());
      const Colour colour =
          mix(mix({0.25, 0.55, 1.0}, {1.0, 0.45, 0.35}, share.x()), {0.95, 0.95, 0.55}, 0.75 * share.y());
      canvas.dot(corner + view_of(from + time * (to - from)), 1.6, colour);
    }
  }
  canvas.write(path);
}

void write_cells_picture(const std::filesystem::path& path, const TransportMap& map, const Box2& picture,
                         ViewedFrom viewed_from) {
  constexpr int kPixels = 1200;
  const auto [width, height] = pixels_of(picture, kPixels);
  const ReceiverView view_of{picture, width, height, viewed_from};
  Canvas canvas(width, height, kPaper);
  for (const auto& border : power_cell_borders(map.seen_sites_mm, map.seen_weights_mm2, picture)) canvas.line(view_of(border[0]), view_of(border[1]), kInk);
  canvas.write(path);
}

void write_exposures(const std::filesystem::path& path, const Grid<double>& flux, ViewedFrom viewed_from,
                     double white) {
  constexpr int kGap = 8;
  Grid<float> both(2 * flux.width + kGap, flux.height, 1.0F);
  const Grid<float> two_seconds = display_picture(flux, viewed_from, white);
  for (int y = 0; y < flux.height; ++y) {
    for (int x = 0; x < flux.width; ++x) {
      both.at(x, y) = two_seconds.at(x, y) / 4;
      both.at(flux.width + kGap + x, y) = two_seconds.at(x, y);
    }
  }
  write_png8(path, both);
}

}  // namespace lightmill

// Target light: the measure on the receiver that the lens has to cast, a sum of area, curve and point light.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/core/image.h"

namespace lightmill {

/// A piece of the border of evenly lit areas: going along +x across it, the irradiance changes by `jump`. All borders of
/// a target together enclose areas: the irradiance at a place is the sum of the jumps left of it.
struct AreaBorder {
  Vec2 low;         ///< the end with the smaller y
  Vec2 high;
  double jump = 0;  ///< flux per mm2
};

/// A curve of infinite irradiance: flux per mm along a polyline, piecewise linear between the vertices [paper sec. 3].
struct CurveLight {
  std::vector<Vec2> vertices_mm;          ///< at least two; a closed curve repeats its first vertex
  std::vector<double> density_per_mm;     ///< flux per mm of length at each vertex
  [[nodiscard]] double flux() const;
};

/// A point of infinite irradiance.
struct PointLight {
  Vec2 position_mm;
  double flux = 0;
};

/// What shall arrive on the receiver, in receiver coordinates (mm, x and y along the lens frame's, origin in its centre),
/// already turned as `receiver.viewed_from` asks. The total flux is 1 after normalise().
struct TargetLight {
  Box2 extent;                    ///< the picture's rectangle; area light lives in it, curves and points too
  Grid<double> area_flux;         ///< flux per pixel, row 0 at the smallest y, column 0 at the smallest x; may be empty
  std::vector<AreaBorder> area_borders;  ///< of filled shapes, whose light adds to that of the pixels
  std::vector<CurveLight> curves;
  std::vector<PointLight> points;
  std::vector<std::string> warnings;  ///< what a drawing contained that was not understood, with line numbers

  [[nodiscard]] double area_total() const;
  [[nodiscard]] double curve_total() const;
  [[nodiscard]] double point_total() const;
  [[nodiscard]] double total() const { return area_total() + curve_total() + point_total(); }
  /// Scales all light so that the total is 1. Throws InputError when there is no light at all.
  void normalise();
};

/// Which way a reader looks at the receiver (DESIGN.md, "Pictures must come out readable").
enum class ViewedFrom { kLens, kBehind };

/// The `[target]` section of a job.
struct TargetSpec {
  std::filesystem::path image;      ///< empty: none
  std::filesystem::path drawing;    ///< SVG; empty: none
  Vec2 size_mm{100, 100};           ///< of the picture on the receiver; an image is stretched onto it, a drawing fitted
  double curve_flux = -1;           ///< share of all light that goes into the drawing's curves; < 0: by the drawing's own
                                    ///< relative fluxes when there is no area light, else 0.5
  double background = 0;            ///< irradiance added everywhere, as a share of the area light's mean
  Transfer transfer = Transfer::kAuto;
  ViewedFrom viewed_from = ViewedFrom::kLens;
  std::filesystem::path colours{};  ///< picture of the colour mask's colours; empty: the image's own
  bool color_mask = false;          ///< the image's brightness is its brightest channel's, which the mask lets through whole
};

/// Reads picture and drawing and sums them. Result is normalised.
/// Throws InputError: unreadable file, an all-black picture, a drawing with nothing drawable.
TargetLight load_target(const TargetSpec& spec);

/// Multiplies the area light by a factor.
void scale_area(TargetLight& target, double factor);

/// The area light as flux per cell of `width` x `height` cells over its extent; row 0 at the smallest y.
Grid<double> rasterise_area(const TargetLight& target, int width, int height);

/// The target as irradiance averaged onto `width` x `height` cells over its extent (curves and points in the cells they
/// pass), as flux per cell; row 0 at the smallest y.
Grid<double> rasterise(const TargetLight& target, int width, int height);

/// Turns a receiver-plane grid (row 0 at smallest y) into the picture as its reader sees it (row 0 on top).
template <typename T>
Grid<T> as_seen(const Grid<T>& receiver_grid, ViewedFrom viewed_from) {
  Grid<T> picture = flipped_rows(receiver_grid);
  // Someone at the lens looking along +Z with +Y up has +X on the left.
  return viewed_from == ViewedFrom::kLens ? flipped_columns(picture) : picture;
}

}  // namespace lightmill

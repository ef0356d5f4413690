// Shapes and paths of an SVG drawing, and their outlines as straight pieces.
#pragma once

#include <2geom/pathvector.h>

#include <cstddef>
#include <optional>
#include <vector>

#include "design/core/geometry.h"
#include "design/detail/svg_document.h"

namespace lightmill::detail {

/// A basic shape or path in user units; `view` is what percentages are of. Nothing, with a warning where that is a
/// surprise, when there is nothing to draw.
Geom::PathVector shape_of(SvgDocument& document, const pugi::xml_node& node, double font_size, const Vec2& view);

/// A path as straight pieces in mm, no farther from it than kFlatteningTolerance_mm.
struct Flattened {
  std::vector<Vec2> vertices_mm;
  std::vector<double> along;         ///< arc length from the start to each vertex, in user units (of dashes)
  std::vector<std::size_t> corners;  ///< which vertices are the path's own, in order; a closing one repeats the first
  bool closed = false;
};

/// Nothing when it comes to more than `most` pieces.
std::optional<Flattened> flatten(const Geom::Path& path, const Geom::Affine& to_mm, std::size_t most);

/// What percentages of a length without a direction are of [SVG 1.1, sec. 7.10].
double diagonal(const Vec2& view);

}  // namespace lightmill::detail

// SVG drawings as light: fills, strokes and points in receiver coordinates.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "design/detail/fills.h"
#include "design/target.h"

namespace lightmill::detail {

/// Curves are flattened so that no chord is farther than this from them.
inline constexpr double kFlatteningTolerance_mm = 0.01;

/// What was drawn, in drawing order. Densities are luminance x opacity x stroke width [mm]; points have their
/// data-flux.
struct Drawing {
  FilledShapes shapes;
  std::vector<CurveLight> strokes;
  std::vector<PointLight> points;
  std::vector<std::string> warnings;
};

/// What a drawing is for: light, fitted into the picture as its preserveAspectRatio says, or outlines, whatever their
/// paint, stretched onto it.
enum class DrawingUse { kLight, kOutlines };

/// Reads a drawing onto a picture of `size_mm`, centred, seen as `viewed_from` asks.
/// Throws InputError with the line when the file is not XML, has no size or unfolds to too much.
Drawing read_drawing(const std::filesystem::path& path, const Vec2& size_mm, ViewedFrom viewed_from,
                     DrawingUse use = DrawingUse::kLight);

/// The same of a file's text; `name` is what messages call it.
Drawing parse_drawing(std::string text, const std::string& name, const Vec2& size_mm, ViewedFrom viewed_from,
                      DrawingUse use = DrawingUse::kLight);

}  // namespace lightmill::detail

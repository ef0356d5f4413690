// SVG drawings as light: fills, strokes and points in receiver coordinates.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "design/detail/fills.h"
#include "design/target.h"

namespace lightmill::detail {

/// Curves are flattened so that no chord is farther than this from them.
inline constexpr double kFlatteningTolerance_mm = 0.01;

/// What was drawn, in drawing order. Densities are luminance x opacity x stroke width [mm]; points have their
/// data-flux.
struct Drawing {
  std::vector<Fill> fills;
  std::vector<CurveLight> strokes;
  std::vector<PointLight> points;
  std::vector<std::string> warnings;
};

/// A CSS colour as linear luminance (sRGB, Rec. 709 weights) and opacity; false if it is none we know.
bool parse_colour(std::string_view text, double& light, double& opacity);

/// Reads a drawing; its view box is stretched onto `size_mm`, centred, seen as `viewed_from` asks.
/// Throws InputError with the line when the file is not XML or has no size.
Drawing read_drawing(const std::filesystem::path& path, const Vec2& size_mm, ViewedFrom viewed_from);

}  // namespace lightmill::detail

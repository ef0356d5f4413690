// SVG drawings as light: fills, strokes and points in receiver coordinates.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "design/detail/coverage.h"
#include "design/target.h"

namespace lightmill::detail {

/// Curves are flattened so that no chord is farther than this from them.
inline constexpr double kFlatteningTolerance_mm = 0.01;

/// A filled shape: a viewer shows linear gray `light` with the given opacity over what lies beneath.
struct DrawnFill {
  std::vector<std::vector<Vec2>> outlines_mm;
  FillRule rule = FillRule::kNonZero;
  double light = 0;
  double opacity = 1;
};

/// What was drawn, in drawing order. Densities are luminance x opacity x stroke width [mm]; points have their
/// data-flux.
struct Drawing {
  std::vector<DrawnFill> fills;
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

// What an SVG drawing's shapes are painted with.
#pragma once

#include <2geom/affine.h>
#include <2geom/rect.h>

#include <string>

#include "design/detail/svg_document.h"
#include "design/detail/svg_gradient.h"
#include "design/detail/svg_properties.h"

namespace lightmill::detail {

/// How many references deep <use> and gradients may go.
inline constexpr int kDeepestUse = 16;

struct SvgPaint {
  enum class Kind { kNone, kEven, kGradient };
  Kind kind = Kind::kNone;
  double light = 0;  ///< of an even paint, linear luminance
  double opacity = 1;
  pugi::xml_node gradient;
};

/// What a paint property says; none, with a warning, when it is not understood.
SvgPaint paint_of(SvgDocument& document, const pugi::xml_node& node, const std::string& text, const SvgStyle& style);

/// The gradient of a <linearGradient> or <radialGradient>, with what it takes after others, for an element whose user
/// units `to_mm` maps, whose percentages are of `view` and whose shape has `bounds` in user units.
Gradient gradient_of(SvgDocument& document, const pugi::xml_node& node, double font_size, const Geom::Affine& to_mm,
                     const Vec2& view, const Geom::Rect& bounds);

}  // namespace lightmill::detail

// Strokes of an SVG drawing as curves of light: densities along them, and dashes.
#pragma once

#include <vector>

#include "design/detail/svg_document.h"
#include "design/detail/svg_properties.h"
#include "design/detail/svg_shapes.h"
#include "design/target.h"

namespace lightmill::detail {

/// The strokes along an element's paths. `density` [per mm] is multiplied by data-flux, which is given at the paths'
/// own vertices and linear along arc length in mm between them. Percentages are of `view`.
std::vector<CurveLight> strokes_of(SvgDocument& document, const pugi::xml_node& node, const SvgStyle& style,
                                   const Vec2& view, const std::vector<Flattened>& flattened, double density);

}  // namespace lightmill::detail

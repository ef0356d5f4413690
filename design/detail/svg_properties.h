// How an element of an SVG drawing is to be drawn: its properties, from attributes, style sheets and style attribute.
#pragma once

#include <string>

#include "design/detail/fills.h"
#include "design/detail/svg_document.h"

namespace lightmill::detail {

/// Presentation properties, inherited from element to element but for the last ones.
struct SvgStyle {
  std::string fill = "black";
  std::string stroke = "none";
  std::string colour = "black";
  std::string stroke_width = "1";
  std::string dashes = "none";
  std::string dash_offset = "0";
  double fill_opacity = 1;
  double stroke_opacity = 1;
  double font_size = 16;  // of em
  FillRule fill_rule = FillRule::kNonZero;
  FillRule clip_rule = FillRule::kNonZero;
  bool visible = true;
  // Of the element alone.
  bool displayed = true;
  bool overflows = false;
  bool fixed_stroke_width = false;
  double opacity = 1;
  std::string clip = "none";
  std::string transform;
  std::string stop_colour = "black";
  double stop_opacity = 1;
};

/// The style of an element whose parent has the style `inherited`: presentation attributes, then style sheets, then the
/// style attribute; important declarations after all others. What is not understood is a warning.
SvgStyle style_of(SvgDocument& document, const pugi::xml_node& node, const SvgStyle& inherited = {});

}  // namespace lightmill::detail

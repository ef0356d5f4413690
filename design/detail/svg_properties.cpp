#include "design/detail/svg_properties.h"

#include <algorithm>
#include <map>

#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

double opacity_of(SvgDocument& document, const pugi::xml_node& node, std::string_view property, std::string_view text) {
  std::string_view rest = text;
  auto value = take_number(rest);
  rest = trimmed(rest);
  if (value && rest == "%") *value /= 100, rest = {};
  if (!value || !rest.empty()) {
    document.warn(node, std::string(property) + " \"" + std::string(text) + "\" is not understood, taken as 1");
    return 1;
  }
  return std::clamp(*value, 0.0, 1.0);
}

void apply_property(SvgDocument& document, const pugi::xml_node& node, std::string_view property, std::string value,
                    SvgStyle& style) {
  if (value.empty() || value == "inherit" || value == "unset") return;
  const auto not_understood = [&](const std::string& instead) {
    document.warn(node, std::string(property) + " \"" + value + "\" is not understood" + instead);
  };
  const auto set_rule = [&](FillRule& rule) {
    if (value == "evenodd") {
      rule = FillRule::kEvenOdd;
    } else if (value == "nonzero" || value == "initial") {
      rule = FillRule::kNonZero;
    } else {
      not_understood(" and ignored");
    }
  };
  const bool initial = value == "initial";
  const SvgStyle fresh;
  if (property == "fill") {
    style.fill = initial ? fresh.fill : value;
  } else if (property == "stroke") {
    style.stroke = initial ? fresh.stroke : value;
  } else if (property == "color") {
    if (lower_case(value) != "currentcolor") style.colour = initial ? fresh.colour : value;
  } else if (property == "stroke-width") {
    style.stroke_width = initial ? fresh.stroke_width : value;
  } else if (property == "stroke-dasharray") {
    style.dashes = initial ? fresh.dashes : value;
  } else if (property == "stroke-dashoffset") {
    style.dash_offset = initial ? fresh.dash_offset : value;
  } else if (property == "fill-opacity") {
    style.fill_opacity = initial ? 1 : opacity_of(document, node, property, value);
  } else if (property == "stroke-opacity") {
    style.stroke_opacity = initial ? 1 : opacity_of(document, node, property, value);
  } else if (property == "opacity") {
    style.opacity = initial ? 1 : opacity_of(document, node, property, value);
  } else if (property == "stop-opacity") {
    style.stop_opacity = initial ? 1 : opacity_of(document, node, property, value);
  } else if (property == "stop-color") {
    style.stop_colour = initial ? fresh.stop_colour : value;
  } else if (property == "fill-rule") {
    set_rule(style.fill_rule);
  } else if (property == "clip-rule") {
    set_rule(style.clip_rule);
  } else if (property == "font-size") {
    // Words for sizes leave it; they matter only where lengths are in em.
    if (const auto size = parse_length(value, style.font_size, style.font_size); size && *size >= 0)
      style.font_size = *size;
  } else if (property == "visibility") {
    if (value == "hidden" || value == "collapse") {
      style.visible = false;
    } else if (value == "visible" || initial) {
      style.visible = true;
    } else {
      not_understood(" and ignored");
    }
  } else if (property == "display") {
    style.displayed = value != "none";
  } else if (property == "overflow") {
    style.overflows = value == "visible" || value == "auto";
  } else if (property == "clip-path") {
    style.clip = value;
  } else if (property == "transform") {
    style.transform = value;
  } else if (property == "vector-effect" && value == "non-scaling-stroke") {
    style.fixed_stroke_width = true;
  } else if (property == "color-interpolation") {
    if (value == "linearRGB") not_understood("; gradients are mixed in sRGB");
  } else if ((property == "mask" || property == "filter" || property == "marker" || property == "marker-start" ||
              property == "marker-mid" || property == "marker-end" || property == "mix-blend-mode" ||
              property == "vector-effect") &&
             value != "none" && value != "normal" && !initial) {
    not_understood(" and ignored");
  }
}

}  // namespace

SvgStyle style_of(SvgDocument& document, const pugi::xml_node& node, const SvgStyle& inherited) {
  const SvgStyle fresh;
  SvgStyle style = inherited;
  style.displayed = true;
  style.overflows = style.fixed_stroke_width = false;
  style.opacity = style.stop_opacity = 1;
  style.clip = fresh.clip;
  style.transform = node.attribute("transform").value();
  style.stop_colour = fresh.stop_colour;
  std::map<std::string, std::string, std::less<>> given;
  for (const auto& attribute : node.attributes()) {
    const std::string_view name = attribute.name();
    if (name != "transform" && name.find(':') == std::string_view::npos && is_known_property(name))
      given.emplace(name, trimmed(attribute.value()));
  }
  std::vector<Declaration> declarations =
      document.sheet().matching(local_name(node), node.attribute("id").value(), node.attribute("class").value());
  const auto own = parse_declarations(node.attribute("style").value(),
                                      [&](std::size_t, const std::string& what) { document.warn(node, what); });
  declarations.insert(declarations.end(), own.begin(), own.end());
  for (const bool important : {false, true}) {
    for (const auto& declaration : declarations) {
      if (declaration.important == important) given[declaration.property] = declaration.value;
    }
  }
  if (const auto size = given.find("font-size"); size != given.end())
    apply_property(document, node, size->first, size->second, style);
  for (const auto& [property, value] : given) {
    if (property != "font-size") apply_property(document, node, property, value, style);
  }
  return style;
}

}  // namespace lightmill::detail

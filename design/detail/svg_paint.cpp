#include "design/detail/svg_paint.h"

#include <algorithm>
#include <vector>

#include "design/detail/svg_shapes.h"
#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

/// A gradient and those that it takes after, itself first.
std::vector<pugi::xml_node> ancestry(const SvgDocument& document, pugi::xml_node gradient) {
  std::vector<pugi::xml_node> chain;
  while (gradient && chain.size() < kDeepestUse) {
    chain.push_back(gradient);
    gradient = document.named(href_of(gradient));
  }
  return chain;
}

std::vector<Gradient::Stop> stops_of(SvgDocument& document, const pugi::xml_node& gradient) {
  std::vector<Gradient::Stop> stops;
  for (const auto& node : ancestry(document, gradient)) {
    for (const auto& child : node.children()) {
      if (child.type() != pugi::node_element || local_name(child) != "stop") continue;
      const SvgStyle style = style_of(document, child);
      auto colour = parse_colour(lower_case(style.stop_colour) == "currentcolor" ? style.colour : style.stop_colour);
      if (!colour) {
        document.warn(child, "stop-color \"" + style.stop_colour + "\" is not understood; taken as black");
        colour = Colour{};
      }
      colour->opacity *= style.stop_opacity;
      const double before = stops.empty() ? 0 : stops.back().offset;
      stops.push_back({std::clamp(document.length(child, "offset", style.font_size, 1), before, 1.0), *colour});
    }
    if (!stops.empty()) break;
  }
  return stops;
}

}  // namespace

SvgPaint paint_of(SvgDocument& document, const pugi::xml_node& node, const std::string& text, const SvgStyle& style) {
  if (text == "none") return {};
  if (text.starts_with("url(")) {
    const std::size_t close = std::min(text.find(')'), text.size() - 1);
    const std::string fallback(trimmed(std::string_view(text).substr(close + 1)));
    const pugi::xml_node server = document.named(text.substr(0, close + 1));
    const std::string name = server ? local_name(server) : "";
    if (name == "linearGradient" || name == "radialGradient") {
      if (!stops_of(document, server).empty()) return {SvgPaint::Kind::kGradient, 0, 1, server};
      if (fallback.empty()) document.warn(node, "paint \"" + text + "\" is a gradient without stops; taken as none");
    } else {
      document.warn(node,
                    "paint \"" + text + "\" is not understood; taken as " + (fallback.empty() ? "none" : fallback));
    }
    return fallback.empty() ? SvgPaint{} : paint_of(document, node, fallback, style);
  }
  if (const auto colour = parse_colour(lower_case(text) == "currentcolor" ? style.colour : text))
    return {SvgPaint::Kind::kEven, colour->light(), colour->opacity, {}};
  document.warn(node, "paint \"" + text + "\" is not understood; taken as none");
  return {};
}

Gradient gradient_of(SvgDocument& document, const pugi::xml_node& node, double font_size, const Geom::Affine& to_mm,
                     const Vec2& user_view, const Geom::Rect& bounds) {
  const std::vector<pugi::xml_node> chain = ancestry(document, node);
  const auto given = [&](const char* name) {
    for (const auto& from : chain) {
      if (const auto attribute = from.attribute(name)) return attribute;
    }
    return pugi::xml_attribute();
  };
  const bool in_box = std::string_view(given("gradientUnits").as_string("objectBoundingBox")) != "userSpaceOnUse";
  const Vec2 view = in_box ? Vec2(1, 1) : user_view;
  const auto coordinate = [&](const char* name, const char* fallback, double whole) {
    const char* text = given(name).as_string(fallback);
    const auto value = parse_length(text, whole, font_size);
    if (!value) document.warn(node, std::string(name) + " = \"" + text + "\" is not a length");
    return value.value_or(0);
  };
  Gradient gradient;
  gradient.stops = stops_of(document, node);
  gradient.radial = local_name(node) == "radialGradient";
  if (gradient.radial) {
    gradient.to = {coordinate("cx", "50%", view.x()), coordinate("cy", "50%", view.y())};
    gradient.from = gradient.to;
    if (given("fx")) gradient.from.x() = coordinate("fx", "", view.x());
    if (given("fy")) gradient.from.y() = coordinate("fy", "", view.y());
    gradient.radius = coordinate("r", "50%", diagonal(view));
    const double off = (gradient.from - gradient.to).norm();
    if (const double most = 0.99 * gradient.radius; off > most)
      gradient.from = gradient.to + most / off * (gradient.from - gradient.to);
    if (coordinate("fr", "0", diagonal(view)) > 0)
      document.warn(node, "the focal radius fr is not understood; taken as 0");
  } else {
    gradient.from = {coordinate("x1", "0%", view.x()), coordinate("y1", "0%", view.y())};
    gradient.to = {coordinate("x2", "100%", view.x()), coordinate("y2", "0%", view.y())};
  }
  const std::string spread = given("spreadMethod").as_string("pad");
  if (spread == "reflect") gradient.spread = Gradient::Spread::kReflect;
  if (spread == "repeat") gradient.spread = Gradient::Spread::kRepeat;
  if (gradient.radial && gradient.spread != Gradient::Spread::kPad && gradient.from != gradient.to) {
    document.warn(node, "spreadMethod \"" + spread + "\" with a focus off the centre is not understood; taken as pad");
    gradient.spread = Gradient::Spread::kPad;
  }
  const Geom::Affine user_to_mm = in_box ? box_to_user(bounds) * to_mm : to_mm;
  const std::string text = given("gradientTransform").value();
  const auto transform = parse_transform(text);
  if (!transform) document.warn(node, "gradientTransform \"" + text + "\" is not understood and ignored");
  const Geom::Affine own_to_mm = transform.value_or(Geom::Affine()) * user_to_mm;
  gradient.to_mm.linear() << own_to_mm[0], own_to_mm[2], own_to_mm[1], own_to_mm[3];
  gradient.to_mm.translation() << own_to_mm[4], own_to_mm[5];
  return gradient;
}

}  // namespace lightmill::detail

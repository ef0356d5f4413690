#include "design/detail/svg.h"

#include <2geom/affine.h>
#include <2geom/bezier-curve.h>
#include <2geom/elliptical-arc.h>
#include <2geom/path-sink.h>
#include <2geom/pathvector.h>
#include <2geom/svg-path-parser.h>
#include <2geom/transforms.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <pugixml.hpp>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill::detail {

namespace {

constexpr int kDeepestUse = 16;
constexpr int kDeepestNesting = 512;   // of elements, well within a thread's stack
constexpr int kMostDashes = 1000000;   // per stroke
constexpr int kMostElements = 300000;  // drawn, counting what <use> draws again

std::string_view trimmed(std::string_view text) {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; };
  while (!text.empty() && blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && blank(text.back())) text.remove_suffix(1);
  return text;
}

/// The leading number of `text`, which is shortened by it.
std::optional<double> take_number(std::string_view& text) {
  text = trimmed(text);
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || !std::isfinite(value)) return std::nullopt;
  text.remove_prefix(end - text.data());
  return value;
}

/// Numbers separated by blanks and commas; nothing if there is anything else.
std::optional<std::vector<double>> numbers_of(std::string_view text) {
  std::vector<double> values;
  for (;;) {
    text = trimmed(text);
    if (text.starts_with(',')) text = trimmed(text.substr(1));
    if (text.empty()) return values;
    const auto value = take_number(text);
    if (!value) return std::nullopt;
    values.push_back(*value);
  }
}

/// A length in user units; a percentage is of `whole`.
std::optional<double> parse_length(std::string_view text, double whole) {
  const auto value = take_number(text);
  if (!value) return std::nullopt;
  static const std::map<std::string_view, double> units{
      {"", 1},           {"px", 1},         {"pt", 96.0 / 72}, {"pc", 16}, {"in", 96}, {"mm", 96 / 25.4},
      {"cm", 96 / 2.54}, {"q", 96 / 101.6}, {"Q", 96 / 101.6}, {"em", 16}, {"ex", 8}};
  text = trimmed(text);
  if (text == "%") return *value * whole / 100;
  const auto unit = units.find(text);
  if (unit == units.end()) return std::nullopt;
  return *value * unit->second;
}

/// The transform attribute [SVG 1.1, sec. 7.6]; nothing when it is not well formed.
std::optional<Geom::Affine> parse_transform(std::string_view text) {
  Geom::Affine result;  // identity; lib2geom multiplies row vectors, so the innermost transform comes first
  for (;;) {
    text = trimmed(text);
    while (text.starts_with(',')) text = trimmed(text.substr(1));
    if (text.empty() || text == "none") return result;
    const std::size_t open = text.find('(');
    const std::size_t close = text.find(')');
    if (open == std::string_view::npos || close == std::string_view::npos || close < open) return std::nullopt;
    const std::string_view name = trimmed(text.substr(0, open));
    const auto v = numbers_of(text.substr(open + 1, close - open - 1));
    text.remove_prefix(close + 1);
    if (!v) return std::nullopt;
    const std::size_t n = v->size();
    const auto& a = *v;
    Geom::Affine step;
    if (name == "matrix" && n == 6) {
      step = Geom::Affine(a[0], a[1], a[2], a[3], a[4], a[5]);
    } else if (name == "translate" && (n == 1 || n == 2)) {
      step = Geom::Translate(a[0], n == 2 ? a[1] : 0);
    } else if (name == "scale" && (n == 1 || n == 2)) {
      step = Geom::Affine(a[0], 0, 0, n == 2 ? a[1] : a[0], 0, 0);
    } else if (name == "rotate" && (n == 1 || n == 3)) {
      const Geom::Point centre(n == 3 ? a[1] : 0, n == 3 ? a[2] : 0);
      step = Geom::Translate(-centre) * Geom::Rotate::from_degrees(a[0]) * Geom::Translate(centre);
    } else if (name == "skewX" && n == 1) {
      step = Geom::Affine(1, 0, std::tan(a[0] * kPi / 180), 1, 0, 0);
    } else if (name == "skewY" && n == 1) {
      step = Geom::Affine(1, std::tan(a[0] * kPi / 180), 0, 1, 0, 0);
    } else {
      return std::nullopt;
    }
    result = step * result;
  }
}

/// Presentation properties, inherited from element to element.
struct Style {
  std::string fill = "black";
  std::string stroke = "none";
  std::string colour = "black";
  std::string stroke_width = "1";
  std::string dashes = "none";
  std::string dash_offset = "0";
  double fill_opacity = 1;
  double stroke_opacity = 1;
  double opacity = 1;  // product of this and all enclosing elements'
  FillRule rule = FillRule::kNonZero;
  bool visible = true;
  bool displayed = true;
};

class Reader {
 public:
  Reader(std::string text, const std::filesystem::path& path, const Vec2& size_mm, ViewedFrom viewed_from)
      : text_(std::move(text)), name_(path.string()) {
    const auto parsed =
        document_.load_buffer(text_.data(), text_.size(), pugi::parse_default | pugi::parse_ws_pcdata_single);
    if (!parsed) {
      throw InputError(name_ + ":" + std::to_string(line_at(parsed.offset)) +
                       ": not valid XML: " + parsed.description() + "; save the drawing again as plain SVG");
    }
    const pugi::xml_node root = document_.document_element();
    if (local_name(root) != "svg") throw InputError(name_ + ": the root element is not <svg>; give an SVG drawing");
    place(root, size_mm, viewed_from);
    collect_ids(root);
    Style style;
    apply_style(root, style);
    if (style.displayed) children(root, style, to_mm_, 0);
  }

  Drawing take() { return std::move(drawing_); }

 private:
  [[nodiscard]] int line_at(std::ptrdiff_t offset) const {
    const auto end = text_.begin() + std::clamp<std::ptrdiff_t>(offset, 0, static_cast<std::ptrdiff_t>(text_.size()));
    return 1 + static_cast<int>(std::count(text_.begin(), end, '\n'));
  }
  void warn(const pugi::xml_node& node, const std::string& what) {
    drawing_.warnings.push_back(name_ + ":" + std::to_string(line_at(node.offset_debug())) + ": " + what);
  }
  static std::string local_name(const pugi::xml_node& node) {
    const std::string name = node.name();
    return name.starts_with("svg:") ? name.substr(4) : name;
  }

  /// The map from user units to receiver mm: the view box is stretched onto the picture, y turned upwards.
  void place(const pugi::xml_node& root, const Vec2& size_mm, ViewedFrom viewed_from) {
    const auto box = numbers_of(root.attribute("viewBox").value());
    const auto width = parse_length(root.attribute("width").value(), 0);
    const auto height = parse_length(root.attribute("height").value(), 0);
    Vec2 corner(0, 0);
    if (box && box->size() == 4 && (*box)[2] > 0 && (*box)[3] > 0) {
      corner = Vec2((*box)[0], (*box)[1]);
      view_ = Vec2((*box)[2], (*box)[3]);
    } else if (width && height && *width > 0 && *height > 0) {
      view_ = Vec2(*width, *height);
    } else {
      throw InputError(name_ + ":" + std::to_string(line_at(root.offset_debug())) +
                       ": the drawing has no size; give <svg> a viewBox or a width and a height");
    }
    // A reader at the lens has +X on the left.
    const double side = viewed_from == ViewedFrom::kLens ? -1 : 1;
    const double sx = side * size_mm.x() / view_.x();
    const double sy = -size_mm.y() / view_.y();
    to_mm_ = Geom::Affine(sx, 0, 0, sy, -side * size_mm.x() / 2 - sx * corner.x(), size_mm.y() / 2 - sy * corner.y());
  }

  void collect_ids(const pugi::xml_node& node, int depth = 0) {
    if (depth > kDeepestNesting) {
      throw InputError(name_ + ":" + std::to_string(line_at(node.offset_debug())) + ": elements are nested over " +
                       std::to_string(kDeepestNesting) + " deep; ungroup the drawing");
    }
    if (const char* id = node.attribute("id").value(); *id) ids_.emplace(id, node);
    for (const auto& child : node.children()) collect_ids(child, depth + 1);
  }

  double opacity_of(const pugi::xml_node& node, std::string_view property, std::string_view text) {
    std::string_view rest = text;
    auto value = take_number(rest);
    rest = trimmed(rest);
    if (value && rest == "%") *value /= 100, rest = {};
    if (!value || !rest.empty()) {
      warn(node, std::string(property) + " \"" + std::string(text) + "\" is not understood, taken as 1");
      return 1;
    }
    return std::clamp(*value, 0.0, 1.0);
  }

  void apply_property(const pugi::xml_node& node, std::string_view property, std::string_view value, Style& style) {
    value = trimmed(value);
    if (value.empty()) return;
    if (value == "inherit" && property != "opacity") return;
    if (property == "fill")
      style.fill = value;
    else if (property == "stroke")
      style.stroke = value;
    else if (property == "color")
      style.colour = value;
    else if (property == "stroke-width")
      style.stroke_width = value;
    else if (property == "stroke-dasharray")
      style.dashes = value;
    else if (property == "stroke-dashoffset")
      style.dash_offset = value;
    else if (property == "fill-opacity")
      style.fill_opacity = opacity_of(node, property, value);
    else if (property == "stroke-opacity")
      style.stroke_opacity = opacity_of(node, property, value);
    else if (property == "opacity")
      style.opacity *= opacity_of(node, property, value);
    else if (property == "fill-rule")
      style.rule = value == "evenodd" ? FillRule::kEvenOdd : FillRule::kNonZero;
    else if (property == "visibility")
      style.visible = value == "visible";
    else if (property == "display")
      style.displayed = style.displayed && value != "none";
    else if ((property == "clip-path" || property == "mask" || property == "filter" || property == "marker" ||
              property == "marker-start" || property == "marker-mid" || property == "marker-end" ||
              property == "mix-blend-mode") &&
             value != "none" && value != "normal") {
      warn(node, std::string(property) + " is not understood and ignored");
    }
  }

  /// Presentation attributes, then the style attribute, which wins.
  void apply_style(const pugi::xml_node& node, Style& style) {
    static constexpr std::string_view properties[] = {
        "fill",           "stroke",       "color",      "stroke-width",     "fill-opacity",
        "stroke-opacity", "opacity",      "fill-rule",  "visibility",       "display",
        "clip-path",      "mask",         "filter",     "stroke-dasharray", "stroke-dashoffset",
        "marker",         "marker-start", "marker-mid", "marker-end",       "mix-blend-mode"};
    std::map<std::string, std::string, std::less<>> given;
    for (const auto property : properties) {
      if (const auto attribute = node.attribute(std::string(property).c_str()))
        given[std::string(property)] = attribute.value();
    }
    std::string_view css = node.attribute("style").value();
    while (!css.empty()) {
      const std::size_t end = std::min(css.find(';'), css.size());
      std::string_view declaration = css.substr(0, end);
      css.remove_prefix(std::min(end + 1, css.size()));
      const std::size_t colon = declaration.find(':');
      if (colon == std::string_view::npos) {
        if (!trimmed(declaration).empty())
          warn(node, "style \"" + std::string(trimmed(declaration)) + "\" is not understood and ignored");
        continue;
      }
      std::string_view value = trimmed(declaration.substr(colon + 1));
      if (value.ends_with("!important")) value = trimmed(value.substr(0, value.size() - 10));
      given[std::string(trimmed(declaration.substr(0, colon)))] = value;
    }
    for (const auto& [property, value] : given) apply_property(node, property, value, style);
  }

  void children(const pugi::xml_node& node, const Style& style, const Geom::Affine& to_mm, int depth) {
    for (const auto& child : node.children()) {
      if (child.type() == pugi::node_element) element(child, style, to_mm, depth);
    }
  }

  void element(const pugi::xml_node& node, const Style& inherited, const Geom::Affine& outer, int depth) {
    const std::string name = local_name(node);
    if (name == "defs" || name == "symbol" || name == "title" || name == "desc" || name == "metadata" ||
        name == "linearGradient" || name == "radialGradient" || name == "pattern" || name == "marker" ||
        name == "clipPath" || name == "mask" || name == "filter") {
      return;
    }
    if (name.find(':') != std::string::npos) return;  // an editor's own notes
    if (++elements_ > kMostElements) {
      throw InputError(name_ + ":" + std::to_string(line_at(node.offset_debug())) + ": the drawing has over " +
                       std::to_string(kMostElements) + " elements, counting what <use> draws again; simplify it");
    }
    Style style = inherited;
    apply_style(node, style);
    if (!style.displayed) return;
    Geom::Affine to_mm = outer;
    if (const auto attribute = node.attribute("transform")) {
      const auto transform = parse_transform(attribute.value());
      if (!transform) {
        warn(node,
             std::string("transform \"") + attribute.value() + "\" is not understood; <" + name + "> is left out");
        return;
      }
      to_mm = *transform * outer;
    }
    if (name == "g" || name == "a") {
      children(node, style, to_mm, depth);
      return;
    }
    if (name == "use") {
      use(node, style, to_mm, depth);
      return;
    }
    if (name == "circle" && has_class(node, "point")) {
      point(node, style, to_mm);
      return;
    }
    Geom::PathVector paths;
    if (!shape(node, name, paths)) return;
    draw(node, style, to_mm, paths);
  }

  void use(const pugi::xml_node& node, const Style& style, const Geom::Affine& to_mm, int depth) {
    std::string href = node.attribute("href").value();
    if (href.empty()) href = node.attribute("xlink:href").value();
    const auto target = href.starts_with('#') ? ids_.find(href.substr(1)) : ids_.end();
    if (target == ids_.end()) {
      warn(node, "<use> of \"" + href + "\", which is not in this file, is left out");
      return;
    }
    if (depth >= kDeepestUse) {
      warn(node, "<use> is nested too deeply and left out");
      return;
    }
    const Geom::Affine moved = Geom::Translate(length(node, "x", view_.x()), length(node, "y", view_.y())) * to_mm;
    if (local_name(target->second) == "symbol") {
      if (target->second.attribute("viewBox")) warn(node, "the viewBox of a <symbol> is not understood and ignored");
      Style inner = style;
      apply_style(target->second, inner);
      children(target->second, inner, moved, depth + 1);
    } else {
      element(target->second, style, moved, depth + 1);
    }
  }

  static bool has_class(const pugi::xml_node& node, std::string_view wanted) {
    std::string_view classes = node.attribute("class").value();
    while (!(classes = trimmed(classes)).empty()) {
      const std::size_t end = std::min(classes.find_first_of(" \t\n"), classes.size());
      if (classes.substr(0, end) == wanted) return true;
      classes.remove_prefix(end);
    }
    return false;
  }

  double length(const pugi::xml_node& node, const char* attribute, double whole, double fallback = 0) {
    const auto given = node.attribute(attribute);
    if (!given) return fallback;
    const auto value = parse_length(given.value(), whole);
    if (!value) warn(node, std::string(attribute) + " = \"" + given.value() + "\" is not a length");
    return value.value_or(fallback);
  }

  void point(const pugi::xml_node& node, const Style& style, const Geom::Affine& to_mm) {
    double flux = 1;
    if (const auto given = node.attribute("data-flux")) {
      std::string_view text = given.value();
      const auto value = take_number(text);
      if (!value || !trimmed(text).empty() || *value < 0) {
        warn(node,
             std::string("data-flux \"") + given.value() + "\" is not a number of at least 0; the point is left out");
        return;
      }
      flux = *value;
    }
    if (!style.visible || flux == 0) return;
    const Geom::Point at = Geom::Point(length(node, "cx", view_.x()), length(node, "cy", view_.y())) * to_mm;
    drawing_.points.push_back({{at.x(), at.y()}, flux});
  }

  /// The outline of a basic shape or path, in user units. False when there is nothing to draw.
  bool shape(const pugi::xml_node& node, const std::string& name, Geom::PathVector& paths) {
    Geom::PathBuilder builder(paths);
    const auto ellipse = [&](double cx, double cy, double rx, double ry) {
      builder.moveTo({cx + rx, cy});
      builder.arcTo(rx, ry, 0, false, true, {cx, cy + ry});
      builder.arcTo(rx, ry, 0, false, true, {cx - rx, cy});
      builder.arcTo(rx, ry, 0, false, true, {cx, cy - ry});
      builder.arcTo(rx, ry, 0, false, true, {cx + rx, cy});
      builder.closePath();
    };
    const double diagonal = view_.norm() / std::sqrt(2.0);
    if (name == "path") {
      try {
        Geom::SVGPathParser parser(builder);
        parser.parse(node.attribute("d").value());
      } catch (const std::exception& e) {
        warn(node, "path data is broken; what comes before the fault is drawn");
      }
    } else if (name == "rect") {
      const double x = length(node, "x", view_.x());
      const double y = length(node, "y", view_.y());
      const double w = length(node, "width", view_.x());
      const double h = length(node, "height", view_.y());
      if (!(w > 0 && h > 0)) return false;
      const bool has_rx = node.attribute("rx");
      const bool has_ry = node.attribute("ry");
      double rx = length(node, "rx", view_.x());
      double ry = length(node, "ry", view_.y());
      if (!has_rx) rx = ry;
      if (!has_ry) ry = rx;
      rx = std::clamp(rx, 0.0, w / 2);
      ry = std::clamp(ry, 0.0, h / 2);
      const bool round = rx > 0 && ry > 0;
      builder.moveTo({x + (round ? rx : 0), y});
      builder.lineTo({x + w - (round ? rx : 0), y});
      if (round) builder.arcTo(rx, ry, 0, false, true, {x + w, y + ry});
      builder.lineTo({x + w, y + h - (round ? ry : 0)});
      if (round) builder.arcTo(rx, ry, 0, false, true, {x + w - rx, y + h});
      builder.lineTo({x + (round ? rx : 0), y + h});
      if (round) builder.arcTo(rx, ry, 0, false, true, {x, y + h - ry});
      builder.lineTo({x, y + (round ? ry : 0)});
      if (round) builder.arcTo(rx, ry, 0, false, true, {x + rx, y});
      builder.closePath();
    } else if (name == "circle") {
      const double r = length(node, "r", diagonal);
      if (!(r > 0)) return false;
      ellipse(length(node, "cx", view_.x()), length(node, "cy", view_.y()), r, r);
    } else if (name == "ellipse") {
      const double rx = length(node, "rx", view_.x());
      const double ry = length(node, "ry", view_.y());
      if (!(rx > 0 && ry > 0)) return false;
      ellipse(length(node, "cx", view_.x()), length(node, "cy", view_.y()), rx, ry);
    } else if (name == "line") {
      builder.moveTo({length(node, "x1", view_.x()), length(node, "y1", view_.y())});
      builder.lineTo({length(node, "x2", view_.x()), length(node, "y2", view_.y())});
    } else if (name == "polyline" || name == "polygon") {
      const auto points = numbers_of(node.attribute("points").value());
      if (!points || points->size() < 4 || points->size() % 2 != 0) {
        warn(node, "the points of <" + name + "> are not pairs of numbers; it is left out");
        return false;
      }
      builder.moveTo({(*points)[0], (*points)[1]});
      for (std::size_t k = 2; k < points->size(); k += 2) builder.lineTo({(*points)[k], (*points)[k + 1]});
      if (name == "polygon") builder.closePath();
    } else {
      warn(node, "<" + name + "> is not understood and left out" +
                     (name == "text"    ? "; turn text into paths"
                      : name == "style" ? "; write styles at the elements"
                                        : ""));
      return false;
    }
    builder.flush();
    return !paths.empty();
  }

  /// A path as straight pieces in mm, no farther from it than the tolerance.
  struct Flattened {
    std::vector<Vec2> vertices_mm;
    std::vector<double> along;         ///< arc length from the start to each vertex, in user units (of dashes)
    std::vector<std::size_t> corners;  ///< which vertices are the path's own, in order; a closing one repeats the first
  };
  static Flattened flatten(const Geom::Path& path, const Geom::Affine& to_mm) {
    Flattened flat;
    std::vector<Vec2>& vertices = flat.vertices_mm;
    Geom::Point last = path.initialPoint();
    double along = 0;
    const auto add = [&](const Geom::Point& p) {
      const Geom::Point q = p * to_mm;
      const Vec2 v(q.x(), q.y());
      along += Geom::distance(p, last);
      last = p;
      if (!vertices.empty() && vertices.back() == v) return;
      vertices.push_back(v);
      flat.along.push_back(along);
    };
    add(path.initialPoint());
    flat.corners.push_back(0);
    const auto curves = path.closed() ? path.size_closed() : path.size_open();
    for (std::size_t k = 0; k < curves; ++k) {
      const Geom::Curve& curve = path[k];
      int pieces = 1;
      if (const auto* bezier = dynamic_cast<const Geom::BezierCurve*>(&curve)) {
        // Wang's bound: n^2 >= d (d - 1) / 8 max |second difference| / tolerance.
        double second = 0;
        const std::size_t degree = bezier->order();
        for (std::size_t i = 0; i + 2 <= degree; ++i) {
          const Geom::Point a = bezier->controlPoint(i) * to_mm;
          const Geom::Point b = bezier->controlPoint(i + 1) * to_mm;
          const Geom::Point c = bezier->controlPoint(i + 2) * to_mm;
          second = std::max(second, Geom::L2(a - 2 * b + c));
        }
        pieces = static_cast<int>(std::ceil(std::sqrt(degree * (degree - 1) / 8.0 * second / kFlatteningTolerance_mm)));
      } else if (const auto* arc = dynamic_cast<const Geom::EllipticalArc*>(&curve)) {
        // A chord over the angle a leaves a sagitta of r (1 - cos(a / 2)) on a circle, less on an ellipse of half axis
        // r.
        const double stretch = std::hypot(std::hypot(to_mm[0], to_mm[1]), std::hypot(to_mm[2], to_mm[3]));
        const double r = std::max(arc->ray(Geom::X), arc->ray(Geom::Y)) * stretch;
        if (r > kFlatteningTolerance_mm) {
          pieces = static_cast<int>(
              std::ceil(std::abs(arc->sweepAngle()) / (2 * std::acos(1 - kFlatteningTolerance_mm / r))));
        }
      }
      pieces = std::clamp(pieces, 1, 100000);
      for (int i = 1; i < pieces; ++i) add(curve.pointAt(static_cast<double>(i) / pieces));
      add(curve.finalPoint());
      flat.corners.push_back(vertices.size() - 1);
    }
    return flat;
  }

  /// A paint as light and opacity; false for none or when it is not understood.
  bool paint(const pugi::xml_node& node, const std::string& text, const Style& style, double& light, double& opacity) {
    if (text == "none") return false;
    if (parse_colour(text == "currentColor" || text == "currentcolor" ? style.colour : text, light, opacity))
      return opacity > 0;
    warn(node, "paint \"" + text + "\" is not understood; taken as none");
    return false;
  }

  /// The relative density at each flattened vertex: data-flux at the path's own vertices, linear along arc length in mm
  /// between them; 1 without. Nothing when data-flux is wrong, which is a warning.
  std::vector<std::vector<double>> flux_profiles(const pugi::xml_node& node, const std::vector<Flattened>& flattened,
                                                 const std::vector<bool>& closed) {
    std::vector<std::vector<double>> profiles;
    for (const auto& flat : flattened) profiles.emplace_back(flat.vertices_mm.size(), 1.0);
    const auto attribute = node.attribute("data-flux");
    if (!attribute) return profiles;
    const auto given = numbers_of(attribute.value());
    if (!given || std::any_of(given->begin(), given->end(), [](double value) { return value < 0; })) {
      warn(node, std::string("data-flux \"") + attribute.value() +
                     "\" is not a list of numbers of at least 0; the stroke is left out");
      return {};
    }
    // A closed subpath ends with the value that it starts with.
    std::size_t expected = 0;
    for (std::size_t k = 0; k < flattened.size(); ++k) expected += flattened[k].corners.size() - (closed[k] ? 1 : 0);
    if (given->size() != expected) {
      warn(node, "data-flux has " + std::to_string(given->size()) + " values, but the path has " +
                     std::to_string(expected) + " vertices; the stroke is left out. Give one value per vertex");
      return {};
    }
    std::size_t next = 0;
    for (std::size_t k = 0; k < flattened.size(); ++k) {
      const auto& flat = flattened[k];
      const std::size_t count = flat.corners.size() - (closed[k] ? 1 : 0);
      for (std::size_t c = 0; c + 1 < flat.corners.size(); ++c) {
        const double from = (*given)[next + c];
        const double to = (*given)[next + (c + 1) % count];
        const std::size_t first = flat.corners[c];
        const std::size_t last = flat.corners[c + 1];
        double length = 0;
        for (std::size_t i = first; i < last; ++i) length += (flat.vertices_mm[i + 1] - flat.vertices_mm[i]).norm();
        double at = 0;
        for (std::size_t i = first; i <= last; ++i) {
          if (i > first) at += (flat.vertices_mm[i] - flat.vertices_mm[i - 1]).norm();
          profiles[k][i] = length > 0 ? from + (to - from) * (at / length) : to;
        }
      }
      next += count;
    }
    return profiles;
  }

  /// Lengths of dashes and gaps in user units; empty for a solid stroke.
  std::vector<double> dash_pattern(const pugi::xml_node& node, const Style& style) {
    if (style.dashes == "none") return {};
    std::vector<double> pattern;
    double sum = 0;
    std::string_view rest = style.dashes;
    while (!(rest = trimmed(rest)).empty()) {
      const std::size_t end = std::min(rest.find_first_of(", \t\r\n"), rest.size());
      const auto value = parse_length(rest.substr(0, end), view_.norm() / std::sqrt(2.0));
      if (!value || *value < 0) {
        warn(node, "stroke-dasharray \"" + style.dashes + "\" is not a list of lengths of at least 0; drawn solid");
        return {};
      }
      pattern.push_back(*value);
      sum += *value;
      rest.remove_prefix(std::min(end, rest.size()));
      rest = trimmed(rest);
      if (rest.starts_with(',')) rest.remove_prefix(1);
    }
    if (!(sum > 0)) return {};  // all zero is solid [SVG 1.1, sec. 11.4]
    if (pattern.size() % 2 != 0) pattern.insert(pattern.end(), pattern.begin(), pattern.end());
    return pattern;
  }

  /// Adds the dashes of a curve; `along` is the arc length at its vertices, in the pattern's units.
  void cut_dashes(const pugi::xml_node& node, const CurveLight& curve, const std::vector<double>& along,
                  const std::vector<double>& pattern, double offset) {
    double period = 0;
    for (const double length : pattern) period += length;
    if (along.back() / period * static_cast<double>(pattern.size()) > kMostDashes) {
      warn(node, "stroke-dasharray cuts the stroke into over " + std::to_string(kMostDashes) + " dashes; drawn solid");
      drawing_.strokes.push_back(curve);
      return;
    }
    const auto at = [&](double s, std::size_t k) {
      const double t = std::clamp((s - along[k]) / (along[k + 1] - along[k]), 0.0, 1.0);
      return std::pair<Vec2, double>((1 - t) * curve.vertices_mm[k] + t * curve.vertices_mm[k + 1],
                                     (1 - t) * curve.density_per_mm[k] + t * curve.density_per_mm[k + 1]);
    };
    std::size_t entry = 0;
    double start = -(offset - std::floor(offset / period) * period);
    std::size_t k = 0;  // the piece that holds the start of the dash
    for (; start < along.back(); start += pattern[entry], entry = (entry + 1) % pattern.size()) {
      const double from = std::max(start, 0.0);
      const double to = std::min(start + pattern[entry], along.back());
      if (entry % 2 != 0 || !(to > from)) continue;
      while (k + 2 < along.size() && along[k + 1] <= from) ++k;
      CurveLight dash;
      const auto add = [&](const std::pair<Vec2, double>& vertex) {
        dash.vertices_mm.push_back(vertex.first);
        dash.density_per_mm.push_back(vertex.second);
      };
      add(at(from, k));
      while (k + 2 < along.size() && along[k + 1] < to) {
        ++k;
        add({curve.vertices_mm[k], curve.density_per_mm[k]});
      }
      add(at(to, k));
      if (dash.flux() > 0) drawing_.strokes.push_back(std::move(dash));
    }
  }

  void draw(const pugi::xml_node& node, const Style& style, const Geom::Affine& to_mm, const Geom::PathVector& paths) {
    if (!style.visible) return;
    std::vector<std::vector<Vec2>> outlines;
    std::vector<Flattened> flattened;
    std::vector<bool> closed;
    for (const auto& path : paths) {
      flattened.push_back(flatten(path, to_mm));
      closed.push_back(path.closed());
      outlines.push_back(flattened.back().vertices_mm);
    }

    double light = 0;
    double opacity = 1;
    if (paint(node, style.fill, style, light, opacity)) {
      drawing_.fills.push_back({outlines, style.rule, light, opacity * style.fill_opacity * style.opacity});
    }
    if (paint(node, style.stroke, style, light, opacity)) {
      const auto width = parse_length(style.stroke_width, view_.norm() / std::sqrt(2.0));
      if (!width || *width < 0)
        warn(node, "stroke-width \"" + style.stroke_width + "\" is not understood; the stroke is left out");
      // A stretched picture stretches strokes too: their width is the geometric mean over directions.
      const double density =
          light * opacity * style.stroke_opacity * style.opacity * width.value_or(0) * std::sqrt(std::abs(to_mm.det()));
      if (density > 0) {
        const auto profiles = flux_profiles(node, flattened, closed);
        const std::vector<double> pattern = dash_pattern(node, style);
        const auto offset = parse_length(style.dash_offset, view_.norm() / std::sqrt(2.0));
        if (!offset) warn(node, "stroke-dashoffset \"" + style.dash_offset + "\" is not a length; taken as 0");
        for (std::size_t k = 0; k < flattened.size() && k < profiles.size(); ++k) {
          if (flattened[k].vertices_mm.size() < 2) continue;
          CurveLight curve{flattened[k].vertices_mm, profiles[k]};
          for (double& value : curve.density_per_mm) value *= density;
          if (pattern.empty()) {
            if (curve.flux() > 0) drawing_.strokes.push_back(std::move(curve));
          } else {
            cut_dashes(node, curve, flattened[k].along, pattern, offset.value_or(0));
          }
        }
      }
    }
  }

  std::string text_;
  std::string name_;
  pugi::xml_document document_;
  std::map<std::string, pugi::xml_node, std::less<>> ids_;
  Vec2 view_{0, 0};  // width and height of the view box in user units
  Geom::Affine to_mm_;
  int elements_ = 0;
  Drawing drawing_;
};

}  // namespace

Drawing read_drawing(const std::filesystem::path& path, const Vec2& size_mm, ViewedFrom viewed_from) {
  return Reader(read_whole(path), path, size_mm, viewed_from).take();
}

}  // namespace lightmill::detail

#include "design/detail/svg.h"

#include <2geom/bezier-curve.h>
#include <2geom/elliptical-arc.h>
#include <2geom/path-sink.h>
#include <2geom/pathvector.h>
#include <2geom/svg-path-parser.h>
#include <2geom/transforms.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <pugixml.hpp>
#include <set>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/detail/svg_colour.h"
#include "design/detail/svg_gradient.h"
#include "design/detail/svg_style.h"
#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

constexpr int kDeepestUse = 16;                 // of <use> and of references between gradients
constexpr int kDeepestNesting = 512;            // of elements, well within a thread's stack
constexpr int kMostDashes = 1000000;            // per stroke
constexpr int kMostElements = 300000;           // drawn, counting what <use> draws again
constexpr std::size_t kMostVertices = 3000000;  // of all that is flattened
constexpr std::size_t kMostWarnings = 100;
constexpr double kFarthest = 1e6;  // picture sizes from its centre: beyond, flattening has no meaning

/// Presentation properties, inherited from element to element but for the last ones.
struct Style {
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

/// Where an element is drawn.
struct Place {
  Geom::Affine to_mm;      // from user units
  Vec2 view{0, 0};         // what percentages are of
  std::vector<int> clips;  // indices into the drawing's
  int group = -1;          // of fills
  double opacity = 1;      // of all enclosing elements, for strokes
  int uses = 0;            // <use> elements around it
};

struct Paint {
  enum class Kind { kNone, kEven, kGradient };
  Kind kind = Kind::kNone;
  double light = 0;
  double opacity = 1;
  pugi::xml_node gradient;
};

/// Something that may happen at many elements and is said once.
struct Tally {
  int count = 0;
  int first_line = 0;
  void note(int line) {
    if (count++ == 0) first_line = line;
  }
};

Vec2 vec(const Geom::Point& p) {
  return {p.x(), p.y()};
}

/// What editors note beside the drawing: by the address of its namespace, or by its prefix where that is an entity.
bool is_editors(std::string_view prefix, std::string_view address) {
  static constexpr std::array<std::string_view, 12> addresses{"inkscape.org",        "sodipodi",
                                                              "ns.adobe.com",        "w3.org/1999/02/22-rdf-syntax-ns",
                                                              "creativecommons.org", "web.resource.org/cc",
                                                              "purl.org/dc",         "bohemiancoding.com/sketch",
                                                              "serif.com",           "boxy-svg.com",
                                                              "vectornator.io",      "figma.com"};
  static constexpr std::array<std::string_view, 11> prefixes{"inkscape", "sodipodi", "rdf", "cc",    "dc", "sketch",
                                                             "serif",    "i",        "x",   "graph", "bx"};
  if (!address.empty() && !address.starts_with('&')) {
    return std::any_of(addresses.begin(), addresses.end(),
                       [&](std::string_view known) { return address.find(known) != std::string_view::npos; });
  }
  return std::find(prefixes.begin(), prefixes.end(), prefix) != prefixes.end();
}

class Reader {
 public:
  Reader(std::string text, const std::string& name, const Vec2& size_mm, ViewedFrom viewed_from, DrawingUse use)
      : text_(std::move(text)), name_(name), picture_(Box2::centred(size_mm)), use_(use) {
    if (text_.starts_with("\x1f\x8b"))
      throw InputError(name_ + ": this drawing is compressed; save it again as plain SVG");
    for (std::size_t at = 0; at < text_.size(); ++at) {
      if (text_[at] == '\n') line_ends_.push_back(at);
    }
    const auto parsed =
        document_.load_buffer(text_.data(), text_.size(), pugi::parse_default | pugi::parse_ws_pcdata_single);
    if (!parsed) {
      throw InputError(name_ + ":" + std::to_string(line_at(parsed.offset)) +
                       ": not valid XML: " + parsed.description() + "; save the drawing again as plain SVG");
    }
    const pugi::xml_node root = document_.document_element();
    if (local_name(root) != "svg") throw InputError(name_ + ": the root element is not <svg>; give an SVG drawing");
    collect(root);
    Place place;
    place.to_mm = page_to_mm(root, viewed_from, place.view);
    Style style;
    apply_style(root, style);
    if (!move_by_transform(root, style, place)) return;
    if (style.displayed) inside_group(root, style, place, [&] { children(root, style, place); });
  }

  Drawing take() {
    const auto sum_up = [&](const Tally& tally, const std::string& what) {
      if (tally.count == 0) return;
      drawing_.warnings.push_back(
          name_ + ":" + std::to_string(tally.first_line) + ": " + what +
          (tally.count > 1 ? " (and so at " + std::to_string(tally.count - 1) + " more elements)" : ""));
    };
    sum_up(cut_, "reaches out of the picture and is cut at its border");
    sum_up(dark_strokes_, "a black stroke is no light and takes none away; draw dark lines as filled shapes");
    if (warnings_ > kMostWarnings)
      drawing_.warnings.push_back(name_ + ": " + std::to_string(warnings_ - kMostWarnings) +
                                  " more warnings are not listed");
    return std::move(drawing_);
  }

 private:
  [[nodiscard]] int line_at(std::ptrdiff_t offset) const {
    const auto at = static_cast<std::size_t>(std::max<std::ptrdiff_t>(offset, 0));
    return 1 + static_cast<int>(std::lower_bound(line_ends_.begin(), line_ends_.end(), at) - line_ends_.begin());
  }
  void warn_at(int line, const std::string& what) {
    const std::string warning = name_ + ":" + std::to_string(line) + ": " + what;
    if (!warned_.insert(warning).second) return;
    if (++warnings_ <= kMostWarnings) drawing_.warnings.push_back(warning);
  }
  void warn(const pugi::xml_node& node, const std::string& what) { warn_at(line_at(node.offset_debug()), what); }
  [[noreturn]] void refuse(const pugi::xml_node& node, const std::string& what) const {
    throw InputError(name_ + ":" + std::to_string(line_at(node.offset_debug())) + ": " + what);
  }

  [[noreturn]] void refuse_size(const pugi::xml_node& node) const {
    refuse(node, "the drawing comes to over " + std::to_string(kMostVertices) + " straight pieces; simplify it");
  }
  void count_element(const pugi::xml_node& node) {
    if (++elements_ > kMostElements)
      refuse(node, "the drawing has over " + std::to_string(kMostElements) +
                       " elements, counting what <use> draws again; simplify it");
  }

  /// The address that a prefix stands for at a node.
  static std::string namespace_of(pugi::xml_node node, const std::string& prefix) {
    const std::string attribute = "xmlns:" + prefix;
    for (; node; node = node.parent()) {
      if (const auto given = node.attribute(attribute.c_str())) return given.value();
    }
    return "";
  }
  /// An element's name without the prefix of SVG's own namespace.
  static std::string local_name(const pugi::xml_node& node) {
    const std::string name = node.name();
    const std::size_t colon = name.find(':');
    if (colon == std::string::npos) return name;
    const std::string prefix = name.substr(0, colon);
    const std::string address = namespace_of(node, prefix);
    return address == "http://www.w3.org/2000/svg" || (prefix == "svg" && address.empty()) ? name.substr(colon + 1)
                                                                                           : name;
  }

  /// The map from the root's user units to receiver mm, y turned upwards. The page is what a viewer shows: the view box
  /// fitted into width and height, and that into the picture.
  Geom::Affine page_to_mm(const pugi::xml_node& root, ViewedFrom viewed_from, Vec2& view) {
    const auto box = view_box(root);
    const auto page_length = [&](const char* name) -> std::optional<double> {
      const std::string_view text = root.attribute(name).value();
      if (text.find('%') != std::string_view::npos) return std::nullopt;
      const auto value = parse_length(text, 0);
      return value && *value > 0 ? value : std::nullopt;
    };
    auto width = page_length("width");
    auto height = page_length("height");
    if (box) {
      if (!width) width = height ? *height * box->width() / box->height() : box->width();
      if (!height) height = *width * box->height() / box->width();
    }
    if (!width || !height) refuse(root, "the drawing has no size; give <svg> a viewBox or a width and a height");
    const Geom::Rect page = Geom::Rect::from_xywh(0, 0, *width, *height);
    const Vec2 size = picture_.size();
    AspectRatio ratio = aspect_ratio(root);
    if (use_ == DrawingUse::kOutlines) ratio.scale = AspectRatio::Scale::kStretch;
    const Geom::Affine onto_picture = fitted(page, Geom::Rect::from_xywh(0, 0, size.x(), size.y()), ratio);
    view = box ? Vec2(box->width(), box->height()) : Vec2(*width, *height);
    // A reader at the lens has +X on the left.
    const double side = viewed_from == ViewedFrom::kLens ? -1 : 1;
    const Geom::Affine onto_receiver(side, 0, 0, -1, -side * size.x() / 2, size.y() / 2);
    page_scale_ = std::sqrt(std::abs(onto_picture.det()));
    return (box ? fitted(*box, page, ratio) : Geom::Affine()) * onto_picture * onto_receiver;
  }

  std::optional<Geom::Rect> view_box(const pugi::xml_node& node) {
    const auto given = node.attribute("viewBox");
    if (!given) return std::nullopt;
    const auto box = numbers_of(given.value());
    if (box && box->size() == 4 && (*box)[2] > 0 && (*box)[3] > 0)
      return Geom::Rect::from_xywh((*box)[0], (*box)[1], (*box)[2], (*box)[3]);
    warn(node, std::string("viewBox \"") + given.value() + "\" is not four numbers with a size above 0, and ignored");
    return std::nullopt;
  }
  AspectRatio aspect_ratio(const pugi::xml_node& node) {
    const auto given = node.attribute("preserveAspectRatio");
    if (!given) return {};
    const auto ratio = parse_aspect_ratio(given.value());
    if (!ratio)
      warn(node,
           std::string("preserveAspectRatio \"") + given.value() + "\" is not understood; taken as xMidYMid meet");
    return ratio.value_or(AspectRatio{});
  }

  /// Ids and style sheets.
  void collect(const pugi::xml_node& node, int depth = 0) {
    if (depth > kDeepestNesting)
      refuse(node, "elements are nested over " + std::to_string(kDeepestNesting) + " deep; ungroup the drawing");
    if (const char* id = node.attribute("id").value(); *id) ids_.emplace(id, node);
    if (node.type() == pugi::node_element && local_name(node) == "style") add_sheet(node);
    for (const auto& child : node.children()) collect(child, depth + 1);
  }
  void add_sheet(const pugi::xml_node& node) {
    const std::string type = node.attribute("type").as_string("text/css");
    const std::string media = node.attribute("media").as_string("all");
    if (type != "text/css" || (media != "all" && media != "screen")) {
      warn(node, "<style> of type \"" + type + "\" for \"" + media + "\" is not understood and ignored");
      return;
    }
    for (const auto& part : node.children()) {
      if (part.type() != pugi::node_pcdata && part.type() != pugi::node_cdata) continue;
      const std::string_view css = part.value();
      const int line = line_at(part.offset_debug());
      sheet_.add(css, [&](std::size_t offset, const std::string& what) {
        const auto end = css.begin() + static_cast<std::ptrdiff_t>(std::min(offset, css.size()));
        warn_at(line + static_cast<int>(std::count(css.begin(), end, '\n')), what);
      });
    }
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

  void apply_property(const pugi::xml_node& node, std::string_view property, std::string value, Style& style) {
    if (value.empty() || value == "inherit" || value == "unset") return;
    const auto not_understood = [&](const std::string& instead) {
      warn(node, std::string(property) + " \"" + value + "\" is not understood" + instead);
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
    const Style fresh;
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
      style.fill_opacity = initial ? 1 : opacity_of(node, property, value);
    } else if (property == "stroke-opacity") {
      style.stroke_opacity = initial ? 1 : opacity_of(node, property, value);
    } else if (property == "opacity") {
      style.opacity = initial ? 1 : opacity_of(node, property, value);
    } else if (property == "stop-opacity") {
      style.stop_opacity = initial ? 1 : opacity_of(node, property, value);
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

  /// Presentation attributes, then style sheets, then the style attribute; important declarations after all others.
  void apply_style(const pugi::xml_node& node, Style& style) {
    const Style fresh;
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
        sheet_.matching(local_name(node), node.attribute("id").value(), node.attribute("class").value());
    const auto own = parse_declarations(node.attribute("style").value(),
                                        [&](std::size_t, const std::string& what) { warn(node, what); });
    declarations.insert(declarations.end(), own.begin(), own.end());
    for (const bool important : {false, true}) {
      for (const auto& declaration : declarations) {
        if (declaration.important == important) given[declaration.property] = declaration.value;
      }
    }
    if (const auto size = given.find("font-size"); size != given.end())
      apply_property(node, size->first, size->second, style);
    for (const auto& [property, value] : given) {
      if (property != "font-size") apply_property(node, property, value, style);
    }
  }

  /// Follows the element's transform; false, with a warning, when it is not understood.
  bool move_by_transform(const pugi::xml_node& node, const Style& style, Place& place) {
    const auto transform = parse_transform(style.transform);
    if (!transform) {
      warn(node, "transform \"" + style.transform + "\" is not understood; <" + local_name(node) + "> is left out");
      return false;
    }
    place.to_mm = *transform * place.to_mm;
    return true;
  }

  void children(const pugi::xml_node& node, const Style& style, const Place& place) {
    for (const auto& child : node.children()) {
      if (child.type() == pugi::node_element) element(child, style, place);
    }
  }

  /// Draws what is inside an element with an opacity or a clip of its own.
  template <typename Draw>
  void inside_group(const pugi::xml_node& node, const Style& style, Place& place, const Draw& draw) {
    if (!add_clip(node, style, place, std::nullopt)) return;
    if (style.opacity < 1) {
      drawing_.shapes.groups.push_back({style.opacity, place.group});
      place.group = static_cast<int>(drawing_.shapes.groups.size()) - 1;
      place.opacity *= style.opacity;
    }
    draw();
  }

  void element(const pugi::xml_node& node, const Style& inherited, const Place& outer) {
    const std::string name = local_name(node);
    static constexpr std::array<std::string_view, 18> not_drawn{
        "defs",           "symbol",     "title",  "desc",     "metadata",  "linearGradient",
        "radialGradient", "pattern",    "marker", "clipPath", "mask",      "filter",
        "style",          "solidColor", "view",   "font",     "font-face", "color-profile"};
    if (std::find(not_drawn.begin(), not_drawn.end(), name) != not_drawn.end()) return;
    if (const std::size_t colon = name.find(':'); colon != std::string::npos) {
      const std::string prefix = name.substr(0, colon);
      if (!is_editors(prefix, namespace_of(node, prefix))) warn(node, "<" + name + "> is not SVG and left out");
      return;
    }
    count_element(node);
    Style style = inherited;
    apply_style(node, style);
    if (!style.displayed) return;
    Place place = outer;
    if (name == "g" || name == "a" || name == "svg" || name == "switch" || name == "use") {
      if (!move_by_transform(node, style, place)) return;
      inside_group(node, style, place, [&] {
        if (name == "use") {
          use(node, style, place);
        } else if (name == "svg") {
          view(node, node, style, place);
        } else if (name == "switch") {
          warn(node, "the conditions of <switch> are not understood; its first element is drawn");
          const auto first =
              node.find_child([](const pugi::xml_node& child) { return child.type() == pugi::node_element; });
          if (first) element(first, style, place);
        } else {
          children(node, style, place);
        }
      });
      return;
    }
    if (!move_by_transform(node, style, place)) return;
    if (name == "circle" && has_class(node, "point")) {
      if (add_clip(node, style, place, std::nullopt)) point(node, style, place);
      return;
    }
    Geom::PathVector paths;
    if (!shape(node, name, style, place.view, paths)) return;
    for (const auto& child : node.children()) {
      if (child.type() != pugi::node_element) continue;
      const std::string inner = local_name(child);
      if (inner != "title" && inner != "desc" && inner != "metadata" && inner.find(':') == std::string::npos)
        warn(child, "<" + inner + "> in <" + name + "> is not understood and left out");
    }
    draw(node, style, place, paths);
  }

  /// The contents of a nested <svg> or a used <symbol>, placed as `by` (the <svg> or the <use>) says.
  void view(const pugi::xml_node& node, const pugi::xml_node& by, const Style& style, Place place) {
    const auto side = [&](const char* name, double whole) {
      const double fallback = by == node ? whole : length(node, name, style, whole, whole);
      return by.attribute(name) && std::string_view(by.attribute(name).value()) != "auto"
                 ? length(by, name, style, whole)
                 : fallback;
    };
    const Geom::Rect page = Geom::Rect::from_xywh(by == node ? length(node, "x", style, place.view.x()) : 0,
                                                  by == node ? length(node, "y", style, place.view.y()) : 0,
                                                  side("width", place.view.x()), side("height", place.view.y()));
    if (!(page.width() > 0 && page.height() > 0)) return;
    if (!style.overflows) {
      std::vector<Vec2> corners;
      for (int k = 0; k < 4; ++k) corners.push_back(vec(page.corner(k) * place.to_mm));
      drawing_.shapes.clips.push_back({{{corners}}});
      place.clips.push_back(static_cast<int>(drawing_.shapes.clips.size()) - 1);
    }
    if (const auto box = view_box(node)) {
      place.to_mm = fitted(*box, page, aspect_ratio(node)) * place.to_mm;
      place.view = {box->width(), box->height()};
    } else {
      place.to_mm = Geom::Translate(page.min()) * place.to_mm;
      place.view = {page.width(), page.height()};
    }
    children(node, style, place);
  }

  /// The element that an address such as "#leaf" or "url(#leaf)" names; none, with no word, when it is not in the file.
  [[nodiscard]] pugi::xml_node named(std::string_view address) const {
    address = trimmed(address);
    if (address.starts_with("url(") && address.ends_with(')')) address = trimmed(address.substr(4, address.size() - 5));
    if (address.size() >= 2 && (address.front() == '"' || address.front() == '\''))
      address = address.substr(1, address.size() - 2);
    if (!address.starts_with('#')) return {};
    const auto found = ids_.find(address.substr(1));
    return found == ids_.end() ? pugi::xml_node() : found->second;
  }
  static std::string href_of(const pugi::xml_node& node) {
    const auto plain = node.attribute("href");
    return plain ? plain.value() : node.attribute("xlink:href").value();
  }

  void use(const pugi::xml_node& node, const Style& style, Place place) {
    const pugi::xml_node target = named(href_of(node));
    if (!target) {
      warn(node, "<use> of \"" + href_of(node) + "\", which is not in this file, is left out");
      return;
    }
    if (place.uses >= kDeepestUse) {
      warn(node, "<use> is nested too deeply and left out");
      return;
    }
    ++place.uses;
    place.to_mm = Geom::Translate(length(node, "x", style, place.view.x()), length(node, "y", style, place.view.y())) *
                  place.to_mm;
    const std::string name = local_name(target);
    if (name != "symbol" && name != "svg") {
      element(target, style, place);
      return;
    }
    Style inner = style;
    apply_style(target, inner);
    if (!inner.displayed || !move_by_transform(target, inner, place)) return;
    inside_group(target, inner, place, [&] {
      if (name == "svg") {
        place.to_mm =
            Geom::Translate(length(target, "x", inner, place.view.x()), length(target, "y", inner, place.view.y())) *
            place.to_mm;
      }
      view(target, node, inner, place);
    });
  }

  static bool has_class(const pugi::xml_node& node, std::string_view wanted) {
    std::string_view classes = node.attribute("class").value();
    while (!(classes = trimmed(classes)).empty()) {
      if (take_word(classes) == wanted) return true;
    }
    return false;
  }

  double length(const pugi::xml_node& node, const char* attribute, const Style& style, double whole,
                double fallback = 0) {
    const auto given = node.attribute(attribute);
    if (!given) return fallback;
    const auto value = parse_length(given.value(), whole, style.font_size);
    if (!value) warn(node, std::string(attribute) + " = \"" + given.value() + "\" is not a length");
    return value.value_or(fallback);
  }
  static double diagonal(const Vec2& view) { return view.norm() / std::sqrt(2.0); }

  /// Adds the element's clip path, if it has one, to where it is drawn. False when nothing of it can show.
  /// `bounds` are the element's in user units, where they are known.
  bool add_clip(const pugi::xml_node& node, const Style& style, Place& place, const std::optional<Geom::Rect>& bounds) {
    if (style.clip == "none" || style.clip == "initial") return true;
    const pugi::xml_node path = named(style.clip);
    if (!path || local_name(path) != "clipPath") {
      warn(node, "clip-path \"" + style.clip + "\" is not understood and ignored");
      return true;
    }
    Style inner;
    apply_style(path, inner);
    Place within = place;
    if (std::string_view(path.attribute("clipPathUnits").value()) == "objectBoundingBox") {
      if (!bounds) {
        warn(node,
             "clip-path \"" + style.clip + "\" in units of the bounding box is only understood at shapes, and ignored");
        return true;
      }
      within.to_mm = box_to_user(*bounds) * within.to_mm;
      within.view = {1, 1};
    }
    if (inner.clip != "none") warn(path, "the clip-path of a <clipPath> is not understood and ignored");
    if (!move_by_transform(path, inner, within)) return true;
    Clip clip;
    for (const auto& child : path.children()) {
      if (child.type() == pugi::node_element) clip_part(child, inner, within, clip);
    }
    drawing_.shapes.clips.push_back(std::move(clip));
    place.clips.push_back(static_cast<int>(drawing_.shapes.clips.size()) - 1);
    return !drawing_.shapes.clips.back().empty();
  }
  void clip_part(const pugi::xml_node& node, const Style& inherited, const Place& outer, Clip& clip) {
    const std::string name = local_name(node);
    if (name == "title" || name == "desc" || name == "metadata") return;
    count_element(node);
    Style style = inherited;
    apply_style(node, style);
    if (!style.displayed) return;
    if (style.clip != "none") warn(node, "the clip-path of a part of a <clipPath> is not understood and ignored");
    Place place = outer;
    if (!move_by_transform(node, style, place)) return;
    if (name == "use") {
      const pugi::xml_node target = named(href_of(node));
      if (!target || place.uses >= kDeepestUse) {
        warn(node,
             "<use> of \"" + href_of(node) + "\", which is not in this file or goes round in circles, is left out");
        return;
      }
      ++place.uses;
      place.to_mm =
          Geom::Translate(length(node, "x", style, place.view.x()), length(node, "y", style, place.view.y())) *
          place.to_mm;
      clip_part(target, style, place, clip);
      return;
    }
    Geom::PathVector paths;
    if (!style.visible || !shape(node, name, style, place.view, paths)) return;
    if (const auto flattened = flatten_all(node, paths, place.to_mm))
      clip.push_back({outlines_of(*flattened), style.clip_rule});
  }
  static Geom::Affine box_to_user(const Geom::Rect& box) {
    return {box.width(), 0, 0, box.height(), box.left(), box.top()};
  }
  [[nodiscard]] bool shows(const Vec2& p, const Place& place) const {
    return std::all_of(place.clips.begin(), place.clips.end(), [&](int k) {
      const Clip& clip = drawing_.shapes.clips[k];
      return std::any_of(clip.begin(), clip.end(), [&](const Region& region) { return region.contains(p); });
    });
  }

  void point(const pugi::xml_node& node, const Style& style, const Place& place) {
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
    flux *= style.opacity * place.opacity;
    if (!style.visible || flux == 0) return;
    const Vec2 at =
        vec(Geom::Point(length(node, "cx", style, place.view.x()), length(node, "cy", style, place.view.y())) *
            place.to_mm);
    if (!shows(at, place)) return;
    if (!picture_.contains(at)) {
      warn(node, "a point lies outside the picture and is left out");
      return;
    }
    drawing_.points.push_back({at, flux});
  }

  /// The outline of a basic shape or path, in user units. False when there is nothing to draw.
  bool shape(const pugi::xml_node& node, const std::string& name, const Style& style, const Vec2& view,
             Geom::PathVector& paths) {
    Geom::PathBuilder builder(paths);
    const auto ellipse = [&](double cx, double cy, double rx, double ry) {
      builder.moveTo({cx + rx, cy});
      builder.arcTo(rx, ry, 0, false, true, {cx, cy + ry});
      builder.arcTo(rx, ry, 0, false, true, {cx - rx, cy});
      builder.arcTo(rx, ry, 0, false, true, {cx, cy - ry});
      builder.arcTo(rx, ry, 0, false, true, {cx + rx, cy});
      builder.closePath();
    };
    if (name == "path") {
      try {
        Geom::SVGPathParser parser(builder);
        parser.parse(node.attribute("d").value());
      } catch (const std::exception& e) {
        warn(node, "path data is broken; what comes before the fault is drawn");
      }
    } else if (name == "rect") {
      const double x = length(node, "x", style, view.x());
      const double y = length(node, "y", style, view.y());
      const double w = length(node, "width", style, view.x());
      const double h = length(node, "height", style, view.y());
      if (!(w > 0 && h > 0)) return false;
      const bool has_rx = node.attribute("rx");
      const bool has_ry = node.attribute("ry");
      double rx = length(node, "rx", style, view.x());
      double ry = length(node, "ry", style, view.y());
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
      const double r = length(node, "r", style, diagonal(view));
      if (!(r > 0)) return false;
      ellipse(length(node, "cx", style, view.x()), length(node, "cy", style, view.y()), r, r);
    } else if (name == "ellipse") {
      const double rx = length(node, "rx", style, view.x());
      const double ry = length(node, "ry", style, view.y());
      if (!(rx > 0 && ry > 0)) return false;
      ellipse(length(node, "cx", style, view.x()), length(node, "cy", style, view.y()), rx, ry);
    } else if (name == "line") {
      builder.moveTo({length(node, "x1", style, view.x()), length(node, "y1", style, view.y())});
      builder.lineTo({length(node, "x2", style, view.x()), length(node, "y2", style, view.y())});
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
                      : name == "image" ? "; give the image to the job (target.image)"
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
  Flattened flatten(const Geom::Path& path, const Geom::Affine& to_mm) {
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
      const auto pieces_of = [](double count) { return static_cast<int>(std::clamp(std::ceil(count), 1.0, 1e9)); };
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
        pieces = pieces_of(std::sqrt(degree * (degree - 1) / 8.0 * second / kFlatteningTolerance_mm));
      } else if (const auto* arc = dynamic_cast<const Geom::EllipticalArc*>(&curve)) {
        // A chord over the angle a leaves a sagitta of r (1 - cos(a / 2)) on a circle, less on an ellipse of half axis
        // r.
        const double stretch = std::hypot(std::hypot(to_mm[0], to_mm[1]), std::hypot(to_mm[2], to_mm[3]));
        const double r = std::max(arc->ray(Geom::X), arc->ray(Geom::Y)) * stretch;
        if (r > kFlatteningTolerance_mm) {
          pieces = pieces_of(std::abs(arc->sweepAngle()) / (2 * std::acos(1 - kFlatteningTolerance_mm / r)));
        }
      }
      vertices_ += pieces;
      if (vertices_ > kMostVertices) break;
      for (int i = 1; i < pieces; ++i) add(curve.pointAt(static_cast<double>(i) / pieces));
      add(curve.finalPoint());
      flat.corners.push_back(vertices.size() - 1);
    }
    return flat;
  }

  /// All of a shape; nothing, with a warning, when it leads nowhere near the picture.
  std::optional<std::vector<Flattened>> flatten_all(const pugi::xml_node& node, const Geom::PathVector& paths,
                                                    const Geom::Affine& to_mm) {
    const double farthest = kFarthest * picture_.size().maxCoeff();
    const auto bounds = paths.boundsFast();
    for (int k = 0; bounds && k < 4; ++k) {
      if (vec(bounds->corner(k) * to_mm).cwiseAbs().maxCoeff() < farthest) continue;
      warn(node, "<" + local_name(node) + "> reaches a million pictures far and is left out");
      return std::nullopt;
    }
    std::vector<Flattened> flattened;
    for (const auto& path : paths) flattened.push_back(flatten(path, to_mm));
    if (vertices_ > kMostVertices) refuse_size(node);
    return flattened;
  }
  static std::vector<std::vector<Vec2>> outlines_of(const std::vector<Flattened>& flattened) {
    std::vector<std::vector<Vec2>> outlines;
    for (const auto& flat : flattened) outlines.push_back(flat.vertices_mm);
    return outlines;
  }

  /// What a paint property says; none, with a warning, when it is not understood.
  Paint paint(const pugi::xml_node& node, const std::string& text, const Style& style) {
    if (text == "none") return {};
    if (text.starts_with("url(")) {
      const std::size_t close = std::min(text.find(')'), text.size() - 1);
      const std::string fallback(trimmed(std::string_view(text).substr(close + 1)));
      const pugi::xml_node server = named(text.substr(0, close + 1));
      const std::string name = server ? local_name(server) : "";
      if (name == "linearGradient" || name == "radialGradient") {
        if (!stops_of(server).empty()) return {Paint::Kind::kGradient, 0, 1, server};
        if (fallback.empty()) warn(node, "paint \"" + text + "\" is a gradient without stops; taken as none");
      } else {
        warn(node, "paint \"" + text + "\" is not understood; taken as " + (fallback.empty() ? "none" : fallback));
      }
      return fallback.empty() ? Paint{} : paint(node, fallback, style);
    }
    if (const auto colour = parse_colour(lower_case(text) == "currentcolor" ? style.colour : text))
      return {Paint::Kind::kEven, colour->light(), colour->opacity, {}};
    warn(node, "paint \"" + text + "\" is not understood; taken as none");
    return {};
  }

  /// A gradient and those that it takes after, itself first.
  [[nodiscard]] std::vector<pugi::xml_node> ancestry(pugi::xml_node gradient) const {
    std::vector<pugi::xml_node> chain;
    while (gradient && chain.size() < kDeepestUse) {
      chain.push_back(gradient);
      gradient = named(href_of(gradient));
    }
    return chain;
  }
  std::vector<Gradient::Stop> stops_of(const pugi::xml_node& gradient) {
    std::vector<Gradient::Stop> stops;
    for (const auto& node : ancestry(gradient)) {
      for (const auto& child : node.children()) {
        if (child.type() != pugi::node_element || local_name(child) != "stop") continue;
        Style style;
        apply_style(child, style);
        auto colour = parse_colour(lower_case(style.stop_colour) == "currentcolor" ? style.colour : style.stop_colour);
        if (!colour) {
          warn(child, "stop-color \"" + style.stop_colour + "\" is not understood; taken as black");
          colour = Colour{};
        }
        colour->opacity *= style.stop_opacity;
        const double before = stops.empty() ? 0 : stops.back().offset;
        stops.push_back({std::clamp(length(child, "offset", style, 1), before, 1.0), *colour});
      }
      if (!stops.empty()) break;
    }
    return stops;
  }
  Gradient gradient_of(const pugi::xml_node& node, const Style& style, const Place& place, const Geom::Rect& bounds) {
    const std::vector<pugi::xml_node> chain = ancestry(node);
    const auto given = [&](const char* name) {
      for (const auto& from : chain) {
        if (const auto attribute = from.attribute(name)) return attribute;
      }
      return pugi::xml_attribute();
    };
    const bool in_box = std::string_view(given("gradientUnits").as_string("objectBoundingBox")) != "userSpaceOnUse";
    const Vec2 view = in_box ? Vec2(1, 1) : place.view;
    const auto coordinate = [&](const char* name, const char* fallback, double whole) {
      const char* text = given(name).as_string(fallback);
      const auto value = parse_length(text, whole, style.font_size);
      if (!value) warn(node, std::string(name) + " = \"" + text + "\" is not a length");
      return value.value_or(0);
    };
    Gradient gradient;
    gradient.stops = stops_of(node);
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
      if (coordinate("fr", "0", diagonal(view)) > 0) warn(node, "the focal radius fr is not understood; taken as 0");
    } else {
      gradient.from = {coordinate("x1", "0%", view.x()), coordinate("y1", "0%", view.y())};
      gradient.to = {coordinate("x2", "100%", view.x()), coordinate("y2", "0%", view.y())};
    }
    const std::string spread = given("spreadMethod").as_string("pad");
    if (spread == "reflect") gradient.spread = Gradient::Spread::kReflect;
    if (spread == "repeat") gradient.spread = Gradient::Spread::kRepeat;
    if (gradient.radial && gradient.spread != Gradient::Spread::kPad && gradient.from != gradient.to) {
      warn(node, "spreadMethod \"" + spread + "\" with a focus off the centre is not understood; taken as pad");
      gradient.spread = Gradient::Spread::kPad;
    }
    Geom::Affine to_mm = in_box ? box_to_user(bounds) * place.to_mm : place.to_mm;
    const std::string text = given("gradientTransform").value();
    const auto transform = parse_transform(text);
    if (!transform) warn(node, "gradientTransform \"" + text + "\" is not understood and ignored");
    to_mm = transform.value_or(Geom::Affine()) * to_mm;
    gradient.to_mm.linear() << to_mm[0], to_mm[2], to_mm[1], to_mm[3];
    gradient.to_mm.translation() << to_mm[4], to_mm[5];
    return gradient;
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
  std::vector<double> dash_pattern(const pugi::xml_node& node, const Style& style, const Vec2& view) {
    if (style.dashes == "none") return {};
    std::vector<double> pattern;
    double sum = 0;
    std::string_view rest = style.dashes;
    while (!(rest = trimmed(rest)).empty()) {
      const std::size_t end = std::min(rest.find_first_of(", \t\r\n"), rest.size());
      const auto value = parse_length(rest.substr(0, end), diagonal(view), style.font_size);
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
                  const std::vector<double>& pattern, double offset, std::vector<CurveLight>& dashes) {
    double period = 0;
    for (const double length : pattern) period += length;
    if (along.back() / period * static_cast<double>(pattern.size()) > kMostDashes) {
      warn(node, "stroke-dasharray cuts the stroke into over " + std::to_string(kMostDashes) + " dashes; drawn solid");
      dashes.push_back(curve);
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
      vertices_ += dash.vertices_mm.size();
      if (vertices_ > kMostVertices) refuse_size(node);
      dashes.push_back(std::move(dash));
    }
  }

  void draw(const pugi::xml_node& node, const Style& style, Place place, const Geom::PathVector& paths) {
    if (!style.visible) return;
    const auto flattened = flatten_all(node, paths, place.to_mm);
    if (!flattened) return;
    const Geom::Rect bounds = paths.boundsExact().value_or(Geom::Rect());
    if (!add_clip(node, style, place, bounds)) return;
    std::vector<bool> closed;
    for (const auto& path : paths) closed.push_back(path.closed());
    Box2 box;
    for (const auto& flat : *flattened) {
      for (const Vec2& v : flat.vertices_mm) box.include(v);
    }
    if (box.empty()) return;

    bool lit = false;
    const Paint fill = paint(node, style.fill, style);
    if (fill.kind != Paint::Kind::kNone) {
      const double opacity = style.fill_opacity * style.opacity;
      const Region region{outlines_of(*flattened), style.fill_rule};
      auto& shapes = drawing_.shapes;
      if (fill.kind == Paint::Kind::kEven || use_ == DrawingUse::kOutlines) {
        shapes.fills.push_back({region, fill.light, fill.opacity * opacity, place.group, place.clips});
        lit = fill.light * fill.opacity * opacity > 0;
      } else {
        shapes.clips.push_back({region});
        std::vector<int> clips = place.clips;
        clips.push_back(static_cast<int>(shapes.clips.size()) - 1);
        for (auto& band : bands_of(gradient_of(fill.gradient, style, place, bounds), box)) {
          for (const auto& outline : band.shape.outlines_mm) vertices_ += outline.size();
          if (vertices_ > kMostVertices) refuse_size(node);
          shapes.fills.push_back({std::move(band.shape), band.light, band.opacity * opacity, place.group, clips});
          lit = lit || band.light * band.opacity * opacity > 0;
        }
      }
    }

    Paint stroke = paint(node, style.stroke, style);
    if (stroke.kind == Paint::Kind::kGradient) {
      const Band mean = mean_of(gradient_of(stroke.gradient, style, place, bounds));
      stroke = {Paint::Kind::kEven, mean.light, mean.opacity, {}};
      warn(node, "the gradient \"" + style.stroke + "\" of a stroke is drawn as its mean; vary it by data-flux");
    }
    if (stroke.kind == Paint::Kind::kEven && stroke.light == 0 && stroke.opacity > 0 && use_ == DrawingUse::kLight)
      dark_strokes_.note(line_at(node.offset_debug()));
    if (stroke.kind != Paint::Kind::kNone) {
      const auto width = parse_length(style.stroke_width, diagonal(place.view), style.font_size);
      if (!width || *width < 0)
        warn(node, "stroke-width \"" + style.stroke_width + "\" is not understood; the stroke is left out");
      // A stretched picture stretches strokes too: their width is the geometric mean over directions.
      const double scale = style.fixed_stroke_width ? page_scale_ : std::sqrt(std::abs(place.to_mm.det()));
      const double density = stroke.light * stroke.opacity * style.stroke_opacity * style.opacity * place.opacity *
                             std::max(0.0, width.value_or(0)) * scale;
      if (density > 0) {
        lit = true;
        add_strokes(node, style, place, *flattened, closed, density);
      }
    }
    const double slack = 1e-6 * picture_.size().maxCoeff();
    if (lit && place.clips.empty() &&
        ((box.min.array() < picture_.min.array() - slack).any() ||
         (box.max.array() > picture_.max.array() + slack).any())) {
      cut_.note(line_at(node.offset_debug()));
    }
  }

  void add_strokes(const pugi::xml_node& node, const Style& style, const Place& place,
                   const std::vector<Flattened>& flattened, const std::vector<bool>& closed, double density) {
    const auto profiles = flux_profiles(node, flattened, closed);
    std::vector<double> pattern = dash_pattern(node, style, place.view);
    auto offset = parse_length(style.dash_offset, diagonal(place.view), style.font_size);
    if (!offset) warn(node, "stroke-dashoffset \"" + style.dash_offset + "\" is not a length; taken as 0");
    if (const auto given = node.attribute("pathLength"); given && !pattern.empty()) {
      double whole = 0;
      for (const auto& flat : flattened) whole += flat.along.back();
      const auto stated = numbers_of(given.value());
      if (stated && stated->size() == 1 && stated->front() > 0) {
        for (double& dash : pattern) dash *= whole / stated->front();
        if (offset) *offset *= whole / stated->front();
      } else {
        warn(node, std::string("pathLength \"") + given.value() + "\" is not a number above 0, and ignored");
      }
    }
    std::vector<CurveLight> curves;
    const bool dots =
        std::any_of(flattened.begin(), flattened.end(), [](const Flattened& flat) { return flat.along.back() == 0; });
    const bool dark_dashes = !pattern.empty() && [&] {
      for (std::size_t k = 0; k < pattern.size(); k += 2) {
        if (pattern[k] > 0) return false;
      }
      return true;
    }();
    if (dots || dark_dashes) warn(node, "a stroke or dash without length has no light; mark points by class=\"point\"");
    for (std::size_t k = 0; k < flattened.size() && k < profiles.size(); ++k) {
      if (flattened[k].vertices_mm.size() < 2) continue;
      CurveLight curve{flattened[k].vertices_mm, profiles[k]};
      for (double& value : curve.density_per_mm) value *= density;
      if (pattern.empty()) {
        curves.push_back(std::move(curve));
      } else {
        cut_dashes(node, curve, flattened[k].along, pattern, offset.value_or(0), curves);
      }
    }
    for (const int clip : place.clips) {
      std::vector<CurveLight> inside;
      for (const auto& curve : curves) {
        for (auto& part : clipped(curve, drawing_.shapes.clips[clip])) inside.push_back(std::move(part));
      }
      curves = std::move(inside);
    }
    for (auto& curve : curves) {
      if (curve.flux() > 0) drawing_.strokes.push_back(std::move(curve));
    }
  }

  std::string text_;
  std::vector<std::size_t> line_ends_;
  std::string name_;
  Box2 picture_;
  DrawingUse use_;
  pugi::xml_document document_;
  std::map<std::string, pugi::xml_node, std::less<>> ids_;
  StyleSheet sheet_;
  double page_scale_ = 1;  // mm per unit of the page
  int elements_ = 0;
  std::size_t vertices_ = 0;
  Tally cut_;           // lit elements that reach out of the picture
  Tally dark_strokes_;  // elements whose stroke is black
  std::set<std::string> warned_;
  std::size_t warnings_ = 0;
  Drawing drawing_;
};

}  // namespace

Drawing parse_drawing(std::string text, const std::string& name, const Vec2& size_mm, ViewedFrom viewed_from,
                      DrawingUse use) {
  return Reader(std::move(text), name, size_mm, viewed_from, use).take();
}

Drawing read_drawing(const std::filesystem::path& path, const Vec2& size_mm, ViewedFrom viewed_from, DrawingUse use) {
  return parse_drawing(read_whole(path), path.string(), size_mm, viewed_from, use);
}

}  // namespace lightmill::detail

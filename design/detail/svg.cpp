#include "design/detail/svg.h"

#include <2geom/pathvector.h>
#include <2geom/transforms.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "design/core/files.h"
#include "design/detail/svg_document.h"
#include "design/detail/svg_paint.h"
#include "design/detail/svg_properties.h"
#include "design/detail/svg_shapes.h"
#include "design/detail/svg_strokes.h"
#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

constexpr int kMostElements = 300000;           // drawn, counting what <use> draws again
constexpr std::size_t kMostVertices = 3000000;  // of all that is flattened
constexpr double kOverPicture = 1e-6;           // picture sizes by which what fits may reach out of it
constexpr double kFarthest = 1e6;               // picture sizes from its centre: beyond, flattening has no meaning

/// Where an element is drawn.
struct Place {
  Geom::Affine to_mm;      // from user units
  Vec2 view{0, 0};         // what percentages are of
  std::vector<int> clips;  // indices into the drawing's
  int group = -1;          // of fills
  double opacity = 1;      // of all enclosing elements, for strokes
  int uses = 0;            // <use> elements around it
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

class Reader {
 public:
  Reader(std::string text, const std::string& name, const Vec2& size_mm, ViewedFrom viewed_from, DrawingUse use)
      : document_(std::move(text), name), picture_(Box2::centred(size_mm)), shown_(picture_), use_(use) {
    const pugi::xml_node root = document_.root();
    Place place;
    place.to_mm = page_to_mm(root, viewed_from, place.view);
    const SvgStyle style = style_of(document_, root);
    if (use_ == DrawingUse::kLight && !style.overflows) cut_at_page(place);
    if (!move_by_transform(root, style, place)) return;
    if (style.displayed) inside_group(root, style, place, [&] { children(root, style, place); });
  }

  Drawing take() {
    drawing_.warnings = document_.warnings();
    const auto sum_up = [&](const Tally& tally, const std::string& what) {
      if (tally.count == 0) return;
      const int more = tally.count - 1;
      drawing_.warnings.push_back(document_.message(
          tally.first_line, what + (more > 0 ? " (and so at " + std::to_string(more) + " more elements)" : "")));
    };
    sum_up(cut_, "reaches out of the picture and is cut at its border");
    sum_up(dark_strokes_, "a black stroke is no light and takes none away; draw dark lines as filled shapes");
    return std::move(drawing_);
  }

 private:
  [[noreturn]] void refuse_size(const pugi::xml_node& node) const {
    document_.refuse(node,
                     "the drawing comes to over " + std::to_string(kMostVertices) + " straight pieces; simplify it");
  }
  void count_vertices(const pugi::xml_node& node, std::size_t more) {
    vertices_ += more;
    if (vertices_ > kMostVertices) refuse_size(node);
  }
  void count_element(const pugi::xml_node& node) {
    if (++elements_ > kMostElements) {
      document_.refuse(node, "the drawing has over " + std::to_string(kMostElements) +
                                 " elements, counting what <use> draws again; simplify it");
    }
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
    if (!width || !height)
      document_.refuse(root, "the drawing has no size; give <svg> a viewBox or a width and a height");
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
    for (int k = 0; k < 4; ++k) page_.include(vec(page.corner(k) * onto_picture * onto_receiver));
    return (box ? fitted(*box, page, ratio) : Geom::Affine()) * onto_picture * onto_receiver;
  }

  /// A page that leaves room in the picture ends where a viewer ends it.
  void cut_at_page(Place& place) {
    const double slack = kOverPicture * picture_.size().maxCoeff();
    if ((page_.min.array() < picture_.min.array() + slack).all() &&
        (page_.max.array() > picture_.max.array() - slack).all())
      return;
    drawing_.shapes.clips.push_back(
        {{{{page_.min, {page_.max.x(), page_.min.y()}, page_.max, {page_.min.x(), page_.max.y()}}}}});
    place.clips.push_back(static_cast<int>(drawing_.shapes.clips.size()) - 1);
    clips_of_page_ = 1;
    shown_ = {page_.min.cwiseMax(picture_.min), page_.max.cwiseMin(picture_.max)};
  }

  std::optional<Geom::Rect> view_box(const pugi::xml_node& node) {
    const auto given = node.attribute("viewBox");
    if (!given) return std::nullopt;
    const auto box = numbers_of(given.value());
    if (box && box->size() == 4 && (*box)[2] > 0 && (*box)[3] > 0)
      return Geom::Rect::from_xywh((*box)[0], (*box)[1], (*box)[2], (*box)[3]);
    document_.warn(
        node, std::string("viewBox \"") + given.value() + "\" is not four numbers with a size above 0, and ignored");
    return std::nullopt;
  }
  AspectRatio aspect_ratio(const pugi::xml_node& node) {
    const auto given = node.attribute("preserveAspectRatio");
    if (!given) return {};
    const auto ratio = parse_aspect_ratio(given.value());
    if (!ratio)
      document_.warn(
          node, std::string("preserveAspectRatio \"") + given.value() + "\" is not understood; taken as xMidYMid meet");
    return ratio.value_or(AspectRatio{});
  }

  /// Follows the element's transform; false, with a warning, when it is not understood.
  bool move_by_transform(const pugi::xml_node& node, const SvgStyle& style, Place& place) {
    const auto transform = parse_transform(style.transform);
    if (!transform) {
      document_.warn(node,
                     "transform \"" + style.transform + "\" is not understood; <" + local_name(node) + "> is left out");
      return false;
    }
    place.to_mm = *transform * place.to_mm;
    return true;
  }

  void children(const pugi::xml_node& node, const SvgStyle& style, const Place& place) {
    for (const auto& child : node.children()) {
      if (child.type() == pugi::node_element) element(child, style, place);
    }
  }

  /// Draws what is inside an element with an opacity or a clip of its own.
  template <typename Draw>
  void inside_group(const pugi::xml_node& node, const SvgStyle& style, Place& place, const Draw& draw) {
    if (!add_clip(node, style, place, std::nullopt)) return;
    if (style.opacity < 1) {
      drawing_.shapes.groups.push_back({style.opacity, place.group});
      place.group = static_cast<int>(drawing_.shapes.groups.size()) - 1;
      place.opacity *= style.opacity;
    }
    draw();
  }

  void element(const pugi::xml_node& node, const SvgStyle& inherited, const Place& outer) {
    const std::string name = local_name(node);
    static constexpr std::array<std::string_view, 18> not_drawn{
        "defs",           "symbol",     "title",  "desc",     "metadata",  "linearGradient",
        "radialGradient", "pattern",    "marker", "clipPath", "mask",      "filter",
        "style",          "solidColor", "view",   "font",     "font-face", "color-profile"};
    if (std::find(not_drawn.begin(), not_drawn.end(), name) != not_drawn.end()) return;
    if (name.find(':') != std::string::npos) {
      if (!is_editors(node)) document_.warn(node, "<" + name + "> is not SVG and left out");
      return;
    }
    count_element(node);
    const SvgStyle style = style_of(document_, node, inherited);
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
          document_.warn(node, "the conditions of <switch> are not understood; its first element is drawn");
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
    const Geom::PathVector paths = shape_of(document_, node, style.font_size, place.view);
    if (paths.empty()) return;
    for (const auto& child : node.children()) {
      if (child.type() != pugi::node_element) continue;
      const std::string inner = local_name(child);
      if (inner != "title" && inner != "desc" && inner != "metadata" && inner.find(':') == std::string::npos)
        document_.warn(child, "<" + inner + "> in <" + name + "> is not understood and left out");
    }
    draw(node, style, place, paths);
  }

  /// The contents of a nested <svg> or a used <symbol>, placed as `by` (the <svg> or the <use>) says.
  void view(const pugi::xml_node& node, const pugi::xml_node& by, const SvgStyle& style, Place place) {
    const auto side = [&](const char* name, double whole) {
      const double fallback = by == node ? whole : document_.length(node, name, style.font_size, whole, whole);
      return by.attribute(name) && std::string_view(by.attribute(name).value()) != "auto"
                 ? document_.length(by, name, style.font_size, whole)
                 : fallback;
    };
    const Geom::Rect page =
        Geom::Rect::from_xywh(by == node ? document_.length(node, "x", style.font_size, place.view.x()) : 0,
                              by == node ? document_.length(node, "y", style.font_size, place.view.y()) : 0,
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

  void use(const pugi::xml_node& node, const SvgStyle& style, Place place) {
    const pugi::xml_node target = document_.named(href_of(node));
    if (!target) {
      document_.warn(node, "<use> of \"" + href_of(node) + "\", which is not in this file, is left out");
      return;
    }
    if (place.uses >= kDeepestUse) {
      document_.warn(node, "<use> is nested too deeply and left out");
      return;
    }
    ++place.uses;
    place.to_mm = Geom::Translate(document_.length(node, "x", style.font_size, place.view.x()),
                                  document_.length(node, "y", style.font_size, place.view.y())) *
                  place.to_mm;
    const std::string name = local_name(target);
    if (name != "symbol" && name != "svg") {
      element(target, style, place);
      return;
    }
    const SvgStyle inner = style_of(document_, target, style);
    if (!inner.displayed || !move_by_transform(target, inner, place)) return;
    inside_group(target, inner, place, [&] {
      if (name == "svg") {
        place.to_mm = Geom::Translate(document_.length(target, "x", inner.font_size, place.view.x()),
                                      document_.length(target, "y", inner.font_size, place.view.y())) *
                      place.to_mm;
      }
      view(target, node, inner, place);
    });
  }

  /// Adds the element's clip path, if it has one, to where it is drawn. False when nothing of it can show.
  /// `bounds` are the element's in user units, where they are known.
  bool add_clip(const pugi::xml_node& node, const SvgStyle& style, Place& place,
                const std::optional<Geom::Rect>& bounds) {
    if (style.clip == "none" || style.clip == "initial") return true;
    const pugi::xml_node path = document_.named(style.clip);
    if (!path || local_name(path) != "clipPath") {
      document_.warn(node, "clip-path \"" + style.clip + "\" is not understood and ignored");
      return true;
    }
    const SvgStyle inner = style_of(document_, path);
    Place within = place;
    if (std::string_view(path.attribute("clipPathUnits").value()) == "objectBoundingBox") {
      if (!bounds) {
        document_.warn(node, "clip-path \"" + style.clip +
                                 "\" in units of the bounding box is only understood at shapes, and ignored");
        return true;
      }
      within.to_mm = box_to_user(*bounds) * within.to_mm;
      within.view = {1, 1};
    }
    if (inner.clip != "none") document_.warn(path, "the clip-path of a <clipPath> is not understood and ignored");
    if (!move_by_transform(path, inner, within)) return true;
    Clip clip;
    for (const auto& child : path.children()) {
      if (child.type() == pugi::node_element) clip_part(child, inner, within, clip);
    }
    drawing_.shapes.clips.push_back(std::move(clip));
    place.clips.push_back(static_cast<int>(drawing_.shapes.clips.size()) - 1);
    return !drawing_.shapes.clips.back().empty();
  }
  void clip_part(const pugi::xml_node& node, const SvgStyle& inherited, const Place& outer, Clip& clip) {
    const std::string name = local_name(node);
    if (name == "title" || name == "desc" || name == "metadata") return;
    count_element(node);
    const SvgStyle style = style_of(document_, node, inherited);
    if (!style.displayed) return;
    if (style.clip != "none")
      document_.warn(node, "the clip-path of a part of a <clipPath> is not understood and ignored");
    Place place = outer;
    if (!move_by_transform(node, style, place)) return;
    if (name == "use") {
      const pugi::xml_node target = document_.named(href_of(node));
      if (!target || place.uses >= kDeepestUse) {
        document_.warn(node, "<use> of \"" + href_of(node) +
                                 "\", which is not in this file or goes round in circles, is left out");
        return;
      }
      ++place.uses;
      place.to_mm = Geom::Translate(document_.length(node, "x", style.font_size, place.view.x()),
                                    document_.length(node, "y", style.font_size, place.view.y())) *
                    place.to_mm;
      clip_part(target, style, place, clip);
      return;
    }
    if (!style.visible) return;
    const Geom::PathVector paths = shape_of(document_, node, style.font_size, place.view);
    if (paths.empty()) return;
    if (const auto flattened = flatten_all(node, paths, place.to_mm))
      clip.push_back({outlines_of(*flattened), style.clip_rule});
  }
  [[nodiscard]] bool shows(const Vec2& p, const Place& place) const {
    return std::all_of(place.clips.begin(), place.clips.end(), [&](int k) {
      const Clip& clip = drawing_.shapes.clips[k];
      return std::any_of(clip.begin(), clip.end(), [&](const Region& region) { return region.contains(p); });
    });
  }

  void point(const pugi::xml_node& node, const SvgStyle& style, const Place& place) {
    double flux = 1;
    if (const auto given = node.attribute("data-flux")) {
      std::string_view text = given.value();
      const auto value = take_number(text);
      if (!value || !trimmed(text).empty() || *value < 0) {
        document_.warn(node, std::string("data-flux \"") + given.value() +
                                 "\" is not a number of at least 0; the point is left out");
        return;
      }
      flux = *value;
    }
    flux *= style.opacity * place.opacity;
    if (!style.visible || flux == 0) return;
    const Vec2 at = vec(Geom::Point(document_.length(node, "cx", style.font_size, place.view.x()),
                                    document_.length(node, "cy", style.font_size, place.view.y())) *
                        place.to_mm);
    if (!shown_.contains(at)) {
      document_.warn(node, "a point lies outside the picture and is left out");
      return;
    }
    if (!shows(at, place)) return;
    drawing_.points.push_back({at, flux});
  }

  /// All of a shape; nothing, with a warning, when it leads nowhere near the picture.
  std::optional<std::vector<Flattened>> flatten_all(const pugi::xml_node& node, const Geom::PathVector& paths,
                                                    const Geom::Affine& to_mm) {
    const double farthest = kFarthest * picture_.size().maxCoeff();
    const auto bounds = paths.boundsFast();
    for (int k = 0; bounds && k < 4; ++k) {
      if (vec(bounds->corner(k) * to_mm).cwiseAbs().maxCoeff() < farthest) continue;
      document_.warn(node, "<" + local_name(node) + "> reaches a million pictures far and is left out");
      return std::nullopt;
    }
    std::vector<Flattened> flattened;
    for (const auto& path : paths) {
      auto flat = flatten(path, to_mm, kMostVertices - vertices_);
      if (!flat) refuse_size(node);
      count_vertices(node, flat->vertices_mm.size());
      flattened.push_back(std::move(*flat));
    }
    return flattened;
  }
  static std::vector<std::vector<Vec2>> outlines_of(const std::vector<Flattened>& flattened) {
    std::vector<std::vector<Vec2>> outlines;
    for (const auto& flat : flattened) outlines.push_back(flat.vertices_mm);
    return outlines;
  }

  void draw(const pugi::xml_node& node, const SvgStyle& style, Place place, const Geom::PathVector& paths) {
    if (!style.visible) return;
    const auto flattened = flatten_all(node, paths, place.to_mm);
    if (!flattened) return;
    const Geom::Rect bounds = paths.boundsExact().value_or(Geom::Rect());
    if (!add_clip(node, style, place, bounds)) return;
    Box2 box;
    for (const auto& flat : *flattened) {
      for (const Vec2& v : flat.vertices_mm) box.include(v);
    }
    if (box.empty()) return;

    bool lit = false;
    const SvgPaint fill = paint_of(document_, node, style.fill, style);
    if (fill.kind != SvgPaint::Kind::kNone) {
      const double opacity = style.fill_opacity * style.opacity;
      const Region region{outlines_of(*flattened), style.fill_rule};
      auto& shapes = drawing_.shapes;
      if (fill.kind == SvgPaint::Kind::kEven || use_ == DrawingUse::kOutlines) {
        shapes.fills.push_back({region, fill.light, fill.opacity * opacity, place.group, place.clips});
        lit = fill.light * fill.opacity * opacity > 0;
      } else {
        shapes.clips.push_back({region});
        std::vector<int> clips = place.clips;
        clips.push_back(static_cast<int>(shapes.clips.size()) - 1);
        for (auto& band :
             bands_of(gradient_of(document_, fill.gradient, style.font_size, place.to_mm, place.view, bounds), box)) {
          for (const auto& outline : band.shape.outlines_mm) count_vertices(node, outline.size());
          shapes.fills.push_back({std::move(band.shape), band.light, band.opacity * opacity, place.group, clips});
          lit = lit || band.light * band.opacity * opacity > 0;
        }
      }
    }

    SvgPaint stroke = paint_of(document_, node, style.stroke, style);
    if (stroke.kind == SvgPaint::Kind::kGradient) {
      const Band mean =
          mean_of(gradient_of(document_, stroke.gradient, style.font_size, place.to_mm, place.view, bounds));
      stroke = {SvgPaint::Kind::kEven, mean.light, mean.opacity, {}};
      document_.warn(node,
                     "the gradient \"" + style.stroke + "\" of a stroke is drawn as its mean; vary it by data-flux");
    }
    if (stroke.kind == SvgPaint::Kind::kEven && stroke.light == 0 && stroke.opacity > 0 && use_ == DrawingUse::kLight)
      dark_strokes_.note(document_.line_of(node));
    if (stroke.kind != SvgPaint::Kind::kNone) {
      const auto width = parse_length(style.stroke_width, diagonal(place.view), style.font_size);
      if (!width || *width < 0)
        document_.warn(node, "stroke-width \"" + style.stroke_width + "\" is not understood; the stroke is left out");
      // A stretched picture stretches strokes too: their width is the geometric mean over directions.
      const double scale = style.fixed_stroke_width ? page_scale_ : std::sqrt(std::abs(place.to_mm.det()));
      const double density = stroke.light * stroke.opacity * style.stroke_opacity * style.opacity * place.opacity *
                             std::max(0.0, width.value_or(0)) * scale;
      if (density > 0) {
        lit = true;
        add_strokes(node, style, place, *flattened, density);
      }
    }
    const double slack = kOverPicture * picture_.size().maxCoeff();
    if (lit && place.clips.size() == clips_of_page_ &&
        ((box.min.array() < shown_.min.array() - slack).any() ||
         (box.max.array() > shown_.max.array() + slack).any())) {
      cut_.note(document_.line_of(node));
    }
  }

  void add_strokes(const pugi::xml_node& node, const SvgStyle& style, const Place& place,
                   const std::vector<Flattened>& flattened, double density) {
    std::vector<CurveLight> curves = strokes_of(document_, node, style, place.view, flattened, density);
    for (std::size_t k = flattened.size(); k < curves.size(); ++k)  // what dashes add
      count_vertices(node, curves[k].vertices_mm.size());
    for (const int clip : place.clips) {
      std::vector<CurveLight> inside;
      for (const auto& curve : curves) {
        for (auto& part : clipped(curve, drawing_.shapes.clips[clip])) inside.push_back(std::move(part));
      }
      curves = std::move(inside);
    }
    for (auto& curve : curves) {
      count_vertices(node, curve.vertices_mm.size());
      if (curve.flux() > 0) drawing_.strokes.push_back(std::move(curve));
    }
  }

  SvgDocument document_;
  Box2 picture_;
  Box2 shown_;  // what of the picture the page covers
  Box2 page_;
  std::size_t clips_of_page_ = 0;
  DrawingUse use_;
  double page_scale_ = 1;  // mm per unit of the page
  int elements_ = 0;
  std::size_t vertices_ = 0;
  Tally cut_;           // lit elements that reach out of the picture
  Tally dark_strokes_;  // elements whose stroke is black
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

#include "design/detail/svg_shapes.h"

#include <2geom/bezier-curve.h>
#include <2geom/elliptical-arc.h>
#include <2geom/path-sink.h>
#include <2geom/svg-path-parser.h>

#include <algorithm>
#include <cmath>

#include "design/detail/svg.h"
#include "design/detail/svg_values.h"

namespace lightmill::detail {

Geom::PathVector shape_of(SvgDocument& document, const pugi::xml_node& node, double font_size, const Vec2& view) {
  const std::string name = local_name(node);
  Geom::PathVector paths;
  Geom::PathBuilder builder(paths);
  const auto length = [&](const char* attribute, double whole) {
    return document.length(node, attribute, font_size, whole);
  };
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
      document.warn(node, "path data is broken; what comes before the fault is drawn");
    }
  } else if (name == "rect") {
    const double x = length("x", view.x());
    const double y = length("y", view.y());
    const double w = length("width", view.x());
    const double h = length("height", view.y());
    if (!(w > 0 && h > 0)) return {};
    const bool has_rx = node.attribute("rx");
    const bool has_ry = node.attribute("ry");
    double rx = length("rx", view.x());
    double ry = length("ry", view.y());
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
    const double r = length("r", diagonal(view));
    if (!(r > 0)) return {};
    ellipse(length("cx", view.x()), length("cy", view.y()), r, r);
  } else if (name == "ellipse") {
    const double rx = length("rx", view.x());
    const double ry = length("ry", view.y());
    if (!(rx > 0 && ry > 0)) return {};
    ellipse(length("cx", view.x()), length("cy", view.y()), rx, ry);
  } else if (name == "line") {
    builder.moveTo({length("x1", view.x()), length("y1", view.y())});
    builder.lineTo({length("x2", view.x()), length("y2", view.y())});
  } else if (name == "polyline" || name == "polygon") {
    const auto points = numbers_of(node.attribute("points").value());
    if (!points || points->size() < 4 || points->size() % 2 != 0) {
      document.warn(node, "the points of <" + name + "> are not pairs of numbers; it is left out");
      return {};
    }
    builder.moveTo({(*points)[0], (*points)[1]});
    for (std::size_t k = 2; k < points->size(); k += 2) builder.lineTo({(*points)[k], (*points)[k + 1]});
    if (name == "polygon") builder.closePath();
  } else {
    document.warn(node, "<" + name + "> is not understood and left out" +
                            (name == "text"    ? "; turn text into paths"
                             : name == "image" ? "; give the image to the job (target.image)"
                                               : ""));
    return {};
  }
  builder.flush();
  return paths;
}

std::optional<Flattened> flatten(const Geom::Path& path, const Geom::Affine& to_mm, std::size_t most) {
  std::size_t room = most;
  Flattened flat;
  flat.closed = path.closed();
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
    if (static_cast<std::size_t>(pieces) > room) return std::nullopt;
    room -= pieces;
    for (int i = 1; i < pieces; ++i) add(curve.pointAt(static_cast<double>(i) / pieces));
    add(curve.finalPoint());
    flat.corners.push_back(vertices.size() - 1);
  }
  return flat;
}

double diagonal(const Vec2& view) {
  return view.norm() / std::sqrt(2.0);
}

}  // namespace lightmill::detail

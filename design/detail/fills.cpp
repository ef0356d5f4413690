#include "design/detail/fills.h"

#include <algorithm>
#include <cstdint>

#include "design/core/errors.h"

namespace lightmill::detail {

namespace {

// What a plane sweep may cost, some ten seconds in all.
constexpr std::size_t kMostCrossings = 5000000;
constexpr std::size_t kMostPairs = 1000000000;  // of edges tried for a crossing
constexpr std::size_t kMostSteps = 300000000;   // edges passed on all levels together

/// An edge, upwards.
struct Edge {
  Vec2 low;
  Vec2 high;
  int winding;
  int region;
  [[nodiscard]] double x_at(double y) const {
    if (y <= low.y()) return low.x();
    if (y >= high.y()) return high.x();
    return low.x() + (high.x() - low.x()) * (y - low.y()) / (high.y() - low.y());
  }
};

/// Adds the edge from p to q within the extent's heights; what lies left or right of it is moved onto its sides.
void add_edge(std::vector<Edge>& edges, const Vec2& p, const Vec2& q, int region, const Box2& extent) {
  if (p.y() == q.y()) return;
  const Edge whole = p.y() < q.y() ? Edge{p, q, 1, region} : Edge{q, p, -1, region};
  const double bottom = std::max(whole.low.y(), extent.min.y());
  const double top = std::min(whole.high.y(), extent.max.y());
  if (!(bottom < top)) return;
  const double left = extent.min.x();
  const double right = extent.max.x();
  std::vector<double> cuts{bottom, top};
  for (const double side : {left, right}) {
    if ((whole.low.x() < side) == (whole.high.x() < side)) continue;
    const double t = (side - whole.low.x()) / (whole.high.x() - whole.low.x());
    const double y = whole.low.y() + t * (whole.high.y() - whole.low.y());
    if (y > bottom && y < top) cuts.push_back(y);
  }
  std::sort(cuts.begin(), cuts.end());
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
    if (!(cuts[k] < cuts[k + 1])) continue;
    const double x = whole.x_at((cuts[k] + cuts[k + 1]) / 2);
    Vec2 low(whole.x_at(cuts[k]), cuts[k]);
    Vec2 high(whole.x_at(cuts[k + 1]), cuts[k + 1]);
    if (x <= left) low.x() = high.x() = left;
    if (x >= right) low.x() = high.x() = right;
    low.x() = std::clamp(low.x(), left, right);
    high.x() = std::clamp(high.x(), left, right);
    edges.push_back({low, high, whole.winding, region});
  }
}

/// Heights where edges cross; edges are in the order of their lower ends.
void add_crossings(const std::vector<Edge>& edges, std::vector<double>& levels) {
  const std::size_t ends = levels.size();
  std::size_t pairs = 0;
  std::vector<std::size_t> active;
  for (std::size_t e = 0; e < edges.size(); ++e) {
    const Edge& edge = edges[e];
    std::erase_if(active, [&](std::size_t k) { return edges[k].high.y() <= edge.low.y(); });
    pairs += active.size();
    for (const std::size_t k : active) {
      const Edge& other = edges[k];
      if (std::max(edge.low.x(), edge.high.x()) < std::min(other.low.x(), other.high.x()) ||
          std::max(other.low.x(), other.high.x()) < std::min(edge.low.x(), edge.high.x())) {
        continue;
      }
      const double y0 = edge.low.y();
      const double y1 = std::min(edge.high.y(), other.high.y());
      const double before = edge.x_at(y0) - other.x_at(y0);
      const double after = edge.x_at(y1) - other.x_at(y1);
      if ((before < 0 && after > 0) || (before > 0 && after < 0))
        levels.push_back(y0 + (y1 - y0) * before / (before - after));
    }
    if (pairs > kMostPairs || levels.size() > ends + kMostCrossings)
      throw InputError("its fills have too many edges that cross or overlap; simplify the paths");
    active.push_back(e);
  }
}

/// What covers the place that a sweep along x has reached. Regions are the fills' shapes, then the clips' parts.
class Covering {
 public:
  explicit Covering(const FilledShapes& shapes) : shapes_(shapes), parts_in_(shapes.clips.size(), 0) {
    for (std::size_t c = 0; c < shapes.clips.size(); ++c) clip_of_.resize(clip_of_.size() + shapes.clips[c].size(), c);
    windings_.assign(shapes.fills.size() + clip_of_.size(), 0);
    for (const auto& fill : shapes.fills) rules_.push_back(fill.shape.rule);
    for (const auto& clip : shapes.clips) {
      for (const auto& region : clip) rules_.push_back(region.rule);
    }
  }

  void pass(const Edge& edge) {
    int& winding = windings_[edge.region];
    const bool was = inside(edge.region, winding);
    winding += edge.winding;
    if (was == inside(edge.region, winding)) return;
    const std::size_t fills = shapes_.fills.size();
    if (static_cast<std::size_t>(edge.region) >= fills) {
      parts_in_[clip_of_[edge.region - fills]] += was ? -1 : 1;
      return;
    }
    const auto place = std::lower_bound(covering_.begin(), covering_.end(), edge.region);
    if (was) {
      covering_.erase(place);
    } else {
      covering_.insert(place, edge.region);
    }
  }

  /// As a viewer shows it: every fill over those before it, groups as one layer.
  [[nodiscard]] double irradiance() {
    layers_.assign(1, {});
    for (const int k : covering_) {
      const Fill& fill = shapes_.fills[k];
      if (std::any_of(fill.clips.begin(), fill.clips.end(), [&](int clip) { return parts_in_[clip] == 0; })) continue;
      while (!holds(layers_.back().group, fill.group)) leave();
      enter(fill.group);
      layers_.back().cover(fill.opacity * fill.light, fill.opacity);
    }
    while (layers_.size() > 1) leave();
    return layers_.front().light;
  }

 private:
  struct Layer {
    int group = -1;
    double light = 0;
    double opacity = 0;
    void cover(double more, double by) {
      light = more + (1 - by) * light;
      opacity = by + (1 - by) * opacity;
    }
  };

  [[nodiscard]] bool inside(int region, int winding) const {
    return rules_[region] == FillRule::kNonZero ? winding != 0 : winding % 2 != 0;
  }
  [[nodiscard]] bool holds(int outer, int group) const {
    while (group > outer) group = shapes_.groups[group].parent;
    return group == outer;
  }
  void enter(int group) {
    if (group == layers_.back().group) return;
    enter(shapes_.groups[group].parent);
    layers_.push_back({group});
  }
  void leave() {
    const Layer top = layers_.back();
    layers_.pop_back();
    const double opacity = shapes_.groups[top.group].opacity;
    layers_.back().cover(opacity * top.light, opacity * top.opacity);
  }

  const FilledShapes& shapes_;
  std::vector<std::size_t> clip_of_;  // of the regions after the fills
  std::vector<FillRule> rules_;       // of every region
  std::vector<int> windings_;
  std::vector<int> parts_in_;  // of every clip: how many of its parts are here
  std::vector<int> covering_;  // fills that are here, clipped or not
  std::vector<Layer> layers_;
};

/// Keeps the parts of a curve for which `cuts` gives pieces [t0, t1] of the segment from p to q.
template <typename Pieces>
std::vector<CurveLight> kept(const CurveLight& curve, const Pieces& pieces) {
  std::vector<CurveLight> parts;
  bool open = false;  // the last part continues
  for (std::size_t k = 0; k + 1 < curve.vertices_mm.size(); ++k) {
    const Vec2& p = curve.vertices_mm[k];
    const Vec2& q = curve.vertices_mm[k + 1];
    const auto density = [&](double t) { return (1 - t) * curve.density_per_mm[k] + t * curve.density_per_mm[k + 1]; };
    bool continues = false;
    for (const auto& [t0, t1] : pieces(p, q)) {
      if (!(t0 < t1)) continue;
      if (!open || t0 > 0) parts.push_back({{p + t0 * (q - p)}, {density(t0)}});
      parts.back().vertices_mm.push_back(t1 == 1 ? q : Vec2(p + t1 * (q - p)));
      parts.back().density_per_mm.push_back(density(t1));
      open = continues = t1 == 1;
    }
    open = continues;
  }
  return parts;
}

}  // namespace

std::vector<AreaBorder> borders_of(const FilledShapes& shapes, const Box2& extent) {
  std::vector<Edge> edges;
  int regions = 0;
  const auto add_region = [&](const Region& region) {
    for (const auto& outline : region.outlines_mm) {
      for (std::size_t k = 0; k < outline.size(); ++k)
        add_edge(edges, outline[k], outline[(k + 1) % outline.size()], regions, extent);
    }
    ++regions;
  };
  for (const auto& fill : shapes.fills) add_region(fill.shape);
  for (const auto& clip : shapes.clips) {
    for (const auto& region : clip) add_region(region);
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) { return a.low.y() < b.low.y(); });
  std::vector<double> levels;  // where the order of edges can change
  for (const Edge& edge : edges) {
    levels.push_back(edge.low.y());
    levels.push_back(edge.high.y());
  }
  add_crossings(edges, levels);
  std::sort(levels.begin(), levels.end());
  levels.erase(std::unique(levels.begin(), levels.end()), levels.end());

  // In each slab between levels edges do not cross: passing them from left to right, the irradiance is known between
  // them. An edge's jump mostly stays from slab to slab, and is written down when it changes.
  struct Running {
    double x0, x1, middle;  // in the slab
    std::size_t edge;
    double jump = 0;
    double since = 0;
  };
  std::vector<AreaBorder> borders;
  const auto write_down = [&](const Running& r, double until) {
    if (r.jump != 0 && until > r.since)
      borders.push_back({{edges[r.edge].x_at(r.since), r.since}, {edges[r.edge].x_at(until), until}, r.jump});
  };
  Covering covering(shapes);
  std::vector<Running> active;  // from left to right
  std::size_t next = 0;
  std::size_t steps = 0;
  for (std::size_t l = 0; l + 1 < levels.size(); ++l) {
    const double y0 = levels[l];
    const double y1 = levels[l + 1];
    std::erase_if(active, [&](const Running& r) {
      const bool over = edges[r.edge].high.y() <= y0;
      if (over) write_down(r, y0);
      return over;
    });
    for (; next < edges.size() && edges[next].low.y() <= y0; ++next) active.push_back({0, 0, 0, next, 0, y0});
    if ((steps += active.size()) > kMostSteps)
      throw InputError("its fills have too many edges that cross or overlap; simplify the paths");
    for (Running& r : active) {
      r.x0 = edges[r.edge].x_at(y0);
      r.x1 = edges[r.edge].x_at(y1);
      r.middle = edges[r.edge].x_at((y0 + y1) / 2);
    }
    // Nearly in order already.
    const auto before = [](const Running& a, const Running& b) {
      return a.middle < b.middle || (a.middle == b.middle && a.edge < b.edge);
    };
    for (std::size_t k = 1; k < active.size(); ++k) {
      if (!before(active[k], active[k - 1])) continue;
      const Running moved = active[k];
      const auto place =
          std::upper_bound(active.begin(), active.begin() + static_cast<std::ptrdiff_t>(k), moved, before);
      std::move_backward(place, active.begin() + static_cast<std::ptrdiff_t>(k),
                         active.begin() + static_cast<std::ptrdiff_t>(k) + 1);
      *place = moved;
    }
    double irradiance = 0;
    for (std::size_t k = 0; k < active.size();) {
      // Edges that coincide are one border.
      Running& first = active[k];
      const auto set_jump = [&](Running& r, double jump) {
        if (jump == r.jump) return;
        write_down(r, y0);
        r.jump = jump;
        r.since = y0;
      };
      const double x0 = first.x0;
      const double x1 = first.x1;
      covering.pass(edges[first.edge]);
      for (++k; k < active.size() && active[k].x0 == x0 && active[k].x1 == x1; ++k) {
        covering.pass(edges[active[k].edge]);
        set_jump(active[k], 0);
      }
      const double right = covering.irradiance();
      set_jump(first, right - irradiance);
      irradiance = right;
    }
  }
  for (const Running& r : active) write_down(r, levels.back());
  return borders;
}

bool Region::contains(const Vec2& p) const {
  int winding = 0;
  for (const auto& outline : outlines_mm) {
    for (std::size_t k = 0; k < outline.size(); ++k) {
      const Vec2& a = outline[k];
      const Vec2& b = outline[(k + 1) % outline.size()];
      if ((a.y() <= p.y()) == (b.y() <= p.y())) continue;
      if (a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x()) < p.x()) winding += a.y() < b.y() ? 1 : -1;
    }
  }
  return rule == FillRule::kNonZero ? winding != 0 : winding % 2 != 0;
}

std::vector<CurveLight> clipped(const CurveLight& curve, const Box2& box) {
  using Piece = std::pair<double, double>;
  return kept(curve, [&](const Vec2& p, const Vec2& q) {
    double t0 = 0;
    double t1 = 1;
    for (int axis = 0; axis < 2; ++axis) {
      const double d = q[axis] - p[axis];
      if (d == 0) {
        if (p[axis] < box.min[axis] || p[axis] > box.max[axis]) t1 = -1;
        continue;
      }
      const auto [enter, leave] = std::minmax({(box.min[axis] - p[axis]) / d, (box.max[axis] - p[axis]) / d});
      t0 = std::max(t0, enter);
      t1 = std::min(t1, leave);
    }
    return std::vector<Piece>{{t0, t1}};
  });
}

std::vector<CurveLight> clipped(const CurveLight& curve, const Clip& clip) {
  using Piece = std::pair<double, double>;
  return kept(curve, [&](const Vec2& p, const Vec2& q) {
    const Vec2 d = q - p;
    const auto cross = [](const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); };
    std::vector<double> cuts{0, 1};
    for (const Region& region : clip) {
      for (const auto& outline : region.outlines_mm) {
        for (std::size_t k = 0; k < outline.size(); ++k) {
          const Vec2& a = outline[k];
          const Vec2 e = outline[(k + 1) % outline.size()] - a;
          const double denominator = cross(d, e);
          if (denominator == 0) continue;
          const double t = cross(a - p, e) / denominator;
          const double s = cross(a - p, d) / denominator;
          if (t > 0 && t < 1 && s >= 0 && s <= 1) cuts.push_back(t);
        }
      }
    }
    std::sort(cuts.begin(), cuts.end());
    std::vector<Piece> pieces;
    for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
      const Vec2 middle = p + (cuts[k] + cuts[k + 1]) / 2 * d;
      if (std::none_of(clip.begin(), clip.end(), [&](const Region& region) { return region.contains(middle); }))
        continue;
      if (!pieces.empty() && pieces.back().second == cuts[k]) {
        pieces.back().second = cuts[k + 1];
      } else {
        pieces.emplace_back(cuts[k], cuts[k + 1]);
      }
    }
    return pieces;
  });
}

}  // namespace lightmill::detail

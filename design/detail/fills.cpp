#include "design/detail/fills.h"

#include <algorithm>
#include <cstdint>

#include "design/core/errors.h"

namespace lightmill::detail {

namespace {

// What a plane sweep may cost: steps are edges passed on a level, a few nanoseconds each.
constexpr std::size_t kMostCrossings = 10000000;
constexpr std::size_t kMostSteps = 4000000000;

/// An edge, upwards.
struct Edge {
  Vec2 low;
  Vec2 high;
  int winding;
  int fill;
  [[nodiscard]] double x_at(double y) const {
    if (y <= low.y()) return low.x();
    if (y >= high.y()) return high.x();
    return low.x() + (high.x() - low.x()) * (y - low.y()) / (high.y() - low.y());
  }
};

/// Adds the edge from p to q within the extent's heights; what lies left or right of it is moved onto its sides.
void add_edge(std::vector<Edge>& edges, const Vec2& p, const Vec2& q, int fill, const Box2& extent) {
  if (p.y() == q.y()) return;
  const Edge whole = p.y() < q.y() ? Edge{p, q, 1, fill} : Edge{q, p, -1, fill};
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
    edges.push_back({low, high, whole.winding, fill});
  }
}

/// Heights where edges cross; edges are in the order of their lower ends.
void add_crossings(const std::vector<Edge>& edges, std::vector<double>& levels) {
  const std::size_t ends = levels.size();
  std::size_t steps = 0;
  std::vector<std::size_t> active;
  for (std::size_t e = 0; e < edges.size(); ++e) {
    const Edge& edge = edges[e];
    std::erase_if(active, [&](std::size_t k) { return edges[k].high.y() <= edge.low.y(); });
    steps += active.size();
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
    if (steps > kMostSteps || levels.size() > ends + kMostCrossings)
      throw InputError("its fills have too many edges that cross or overlap; simplify the paths");
    active.push_back(e);
  }
}

/// What covers the place that a sweep along x has reached.
class Covering {
 public:
  explicit Covering(const std::vector<Fill>& fills) : fills_(fills), windings_(fills.size(), 0) {}

  void pass(const Edge& edge) {
    int& winding = windings_[edge.fill];
    const bool was = inside(edge.fill, winding);
    winding += edge.winding;
    if (was == inside(edge.fill, winding)) return;
    const auto place = std::lower_bound(covering_.begin(), covering_.end(), edge.fill);
    if (was) {
      covering_.erase(place);
    } else {
      covering_.insert(place, edge.fill);
    }
  }
  /// As a viewer shows it: every fill over those before it.
  [[nodiscard]] double irradiance() const {
    double sum = 0;
    for (const int k : covering_) sum += fills_[k].opacity * (fills_[k].light - sum);
    return sum;
  }

 private:
  [[nodiscard]] bool inside(int fill, int winding) const {
    return fills_[fill].rule == FillRule::kNonZero ? winding != 0 : winding % 2 != 0;
  }

  const std::vector<Fill>& fills_;
  std::vector<int> windings_;
  std::vector<int> covering_;
};

}  // namespace

std::vector<AreaBorder> borders_of(const std::vector<Fill>& fills, const Box2& extent) {
  std::vector<Edge> edges;
  for (std::size_t f = 0; f < fills.size(); ++f) {
    for (const auto& outline : fills[f].outlines_mm) {
      for (std::size_t k = 0; k < outline.size(); ++k)
        add_edge(edges, outline[k], outline[(k + 1) % outline.size()], static_cast<int>(f), extent);
    }
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
  Covering covering(fills);
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
      const auto place = std::upper_bound(active.begin(), active.begin() + static_cast<std::ptrdiff_t>(k), moved, before);
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

}  // namespace lightmill::detail

#include "design/detail/target_measure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "design/core/parallel.h"
#include "design/detail/clip.h"

namespace lightmill::detail {

namespace {

constexpr std::size_t kEdgeBlock = 4096;
constexpr std::size_t kRegionBlock = 16;

/// One directed edge's share in a cell's mass and moments, and the density along it.
struct Share {
  double mass = 0;
  Vec2 moment{0, 0};
  Vec2 collapsed{0, 0};
  double line = 0;
};

double cross(const Vec2& a, const Vec2& b) {
  return a.x() * b.y() - a.y() * b.x();
}

/// A strip as a region of the plane that cells are integrated over.
struct StripRegion {
  const Strip& strip;
  double radius;

  [[nodiscard]] Vec2 anchor() const { return strip.from + strip.direction * (strip.length / 2); }
  [[nodiscard]] Vec2 local(const Vec2& p) const {
    const Vec2 d = p - strip.from;
    return {d.dot(strip.direction), cross(strip.direction, d)};
  }
  [[nodiscard]] bool touches(const Vec2& p, const Vec2& q) const {
    const Vec2 a = local(p);
    const Vec2 d = local(q) - a;
    const double slack = 1e-9 * radius;
    double t0 = 0;
    double t1 = 1;
    return clip(a.x(), d.x(), -slack, strip.length + slack, t0, t1) &&
           clip(a.y(), d.y(), -radius - slack, radius + slack, t0, t1);
  }
  /// Green's theorem with F(u) = int_0^u density, clamped to the strip: exact for every closed cell, antisymmetric per
  /// edge.
  [[nodiscard]] Share along(const Vec2& p, const Vec2& q) const {
    Share share;
    const Vec2 a = local(p);
    const Vec2 b = local(q);
    // Most edges pass beside the strip, or before its start, where F is 0.
    if (std::max(a.y(), b.y()) <= -radius || std::min(a.y(), b.y()) >= radius || std::max(a.x(), b.x()) <= 0) return share;
    const Vec2 d = b - a;
    double t0 = 0;
    double t1 = 1;
    if (!clip(a.y(), d.y(), -radius, radius, t0, t1)) return share;
    const double scale = 1 / (2 * radius);
    const double d0 = strip.density_from * scale;
    const double slope = (strip.density_to - strip.density_from) * scale / strip.length;
    const auto F = [&](double u) { return u * (d0 + slope * u / 2); };
    const auto G = [&](double u) { return u * u * (d0 / 2 + slope * u / 3); };
    double mass = 0;
    double along_u = 0;
    double along_v = 0;
    const auto piece = [&](double from, double to) {
      if (to <= from) return;
      const double dv = d.y() * (to - from);
      const double um = std::clamp(a.x() + d.x() * (from + to) / 2, 0.0, strip.length);
      const double u0 = std::clamp(a.x() + d.x() * from, 0.0, strip.length);
      const double u1 = std::clamp(a.x() + d.x() * to, 0.0, strip.length);
      const double v0 = a.y() + d.y() * from;
      const double v1 = a.y() + d.y() * to;
      // Simpson's rule: exact for the cubics that occur.
      mass += dv / 6 * (F(u0) + 4 * F(um) + F(u1));
      along_u += dv / 6 * (G(u0) + 4 * G(um) + G(u1));
      along_v += dv / 6 * (v0 * F(u0) + 2 * (v0 + v1) * F(um) + v1 * F(u1));
    };
    // Before, within and beyond the strip's length.
    std::array<double, 4> cuts{t0, t0, t1, t1};
    if (d.x() != 0) {
      double first = (0 - a.x()) / d.x();
      double second = (strip.length - a.x()) / d.x();
      if (first > second) std::swap(first, second);
      cuts[1] = std::clamp(first, t0, t1);
      cuts[2] = std::clamp(second, t0, t1);
    } else {
      cuts[1] = t0;
      cuts[2] = t1;
    }
    for (int k = 0; k < 3; ++k) piece(cuts[k], cuts[k + 1]);
    const double mid = a.x() + d.x() * (cuts[1] + cuts[2]) / 2;
    if (mid >= 0 && mid <= strip.length) share.line = d.norm() * (cuts[2] - cuts[1]) * (d0 + slope * mid);
    const Vec2 across(-strip.direction.y(), strip.direction.x());
    share.mass = mass;
    share.collapsed = strip.from * mass + strip.direction * along_u;
    share.moment = share.collapsed + across * along_v;
    return share;
  }
};

/// A disk of uniform density.
struct DiskRegion {
  const Disk& disk;
  double radius;

  [[nodiscard]] Vec2 anchor() const { return disk.centre; }
  [[nodiscard]] bool touches(const Vec2& p, const Vec2& q) const {
    const Vec2 a = p - disk.centre;
    const Vec2 d = q - p;
    const double length2 = d.squaredNorm();
    const double t = length2 > 0 ? std::clamp(-a.dot(d) / length2, 0.0, 1.0) : 0.0;
    return (a + t * d).squaredNorm() <= radius * radius * (1 + 1e-9);
  }
  /// The disk's part of the triangle (centre, p, q), signed: a triangle where the edge is inside, sectors where it is
  /// not.
  [[nodiscard]] Share along(const Vec2& p, const Vec2& q) const {
    const Vec2 a = p - disk.centre;
    const Vec2 b = q - disk.centre;
    const Vec2 d = b - a;
    double area = 0;
    Vec2 moment(0, 0);
    const auto sector = [&](const Vec2& from, const Vec2& to) {
      const double angle = std::atan2(cross(from, to), from.dot(to));
      area += radius * radius * angle / 2;
      // Moment of a sector: R^3 / 3 (sin, -cos) between its two directions.
      const Vec2 e0 = from.normalized();
      const Vec2 e1 = to.normalized();
      moment += radius * radius * radius / 3 * Vec2(e1.y() - e0.y(), e0.x() - e1.x());
    };
    Share share;
    const double dd = d.squaredNorm();
    const double half = a.dot(d);
    const double discriminant = half * half - dd * (a.squaredNorm() - radius * radius);
    double t0 = 1;
    double t1 = 0;
    if (dd > 0 && discriminant > 0) {
      const double root = std::sqrt(discriminant);
      t0 = std::clamp((-half - root) / dd, 0.0, 1.0);
      t1 = std::clamp((-half + root) / dd, 0.0, 1.0);
    }
    const double density = disk.flux / (kPi * radius * radius);
    if (t0 >= t1) {
      if (a.squaredNorm() > 0 && b.squaredNorm() > 0) sector(a, b);
    } else {
      const Vec2 in = a + t0 * d;
      const Vec2 out = a + t1 * d;
      if (t0 > 0) sector(a, in);
      const double triangle = cross(in, out) / 2;
      area += triangle;
      moment += triangle / 3 * (in + out);
      if (t1 < 1) sector(out, b);
      share.line = density * std::sqrt(dd) * (t1 - t0);
    }
    share.mass = density * area;
    share.collapsed = share.mass * disk.centre;
    share.moment = share.collapsed + density * moment;
    return share;
  }
};

/// What a block of regions adds, in the order it was found.
struct Additions {
  struct Cell {
    int site;
    Share share;
  };
  struct Slope {
    int edge;
    double line;
  };
  std::vector<Cell> cells;
  std::vector<Slope> slopes;
};

/// Finds the cells that a convex region touches and integrates it over them.
class RegionWalker {
 public:
  RegionWalker(const PowerDiagram& diagram, const std::vector<Vec2>& sites, const std::vector<double>& psi)
      : diagram_(diagram), sites_(sites), psi_(psi), seen_(sites.size(), 0) {}

  template <typename Region>
  int walk(const Region& region, int hint, Additions& additions) {
    const int n = static_cast<int>(sites_.size());
    const int start = cell_at(diagram_, sites_, psi_, region.anchor(), hint);
    ++epoch_;
    queue_.assign(1, start);
    seen_[start] = epoch_;
    for (std::size_t k = 0; k < queue_.size(); ++k) {
      const int cell = queue_[k];
      Share sum;
      for_each_edge(cell, [&](int e) {
        const auto& edge = diagram_.edges[e];
        const Vec2& p = diagram_.vertices[edge.from];
        const Vec2& q = diagram_.vertices[edge.to];
        const Share share = region.along(p, q);
        const double sign = edge.a == cell ? 1 : -1;
        sum.mass += sign * share.mass;
        sum.moment += sign * share.moment;
        sum.collapsed += sign * share.collapsed;
        if (share.line > 0 && edge.a == cell && edge.b < n) additions.slopes.push_back({e, share.line});
        const int other = across(e, cell);
        if (other < n && seen_[other] != epoch_ && region.touches(p, q)) {
          seen_[other] = epoch_;
          queue_.push_back(other);
        }
      });
      additions.cells.push_back({cell, sum});
    }
    return start;
  }

 private:
  template <typename Action>
  void for_each_edge(int cell, const Action& action) const {
    for (std::size_t k = diagram_.first_edge[cell]; k < diagram_.first_edge[cell + 1]; ++k)
      action(diagram_.incident_edges[k]);
  }
  [[nodiscard]] int across(int e, int cell) const {
    const auto& edge = diagram_.edges[e];
    return edge.a == cell ? edge.b : edge.a;
  }

  const PowerDiagram& diagram_;
  const std::vector<Vec2>& sites_;
  const std::vector<double>& psi_;
  std::vector<int> seen_;
  std::vector<int> queue_;
  int epoch_ = 0;
};

/// Pixels for area light: the image's own, cut into equal parts where they are coarser than filled shapes need.
std::pair<int, int> shape_of(const TargetLight& target) {
  constexpr int kPixels = 1024;  // along the longer side, for the borders of filled shapes
  const auto& image = target.area_flux;
  if (target.area_borders.empty()) return {image.width, image.height};
  const Vec2 size = target.extent.size();
  const auto parts = [&](int given, int axis) {
    const double wanted = std::max(1.0, kPixels * size[axis] / size.maxCoeff());
    return given * std::max(1, static_cast<int>(std::lround(wanted / given)));
  };
  return image.empty() ? std::pair(parts(1, 0), parts(1, 1)) : std::pair(parts(image.width, 0), parts(image.height, 1));
}

/// Every pixel cut into equal parts.
Grid<double> refined(const Grid<double>& flux, int width, int height) {
  Grid<double> fine(width, height);
  if (flux.empty()) return fine;
  const int across = width / flux.width;
  const int up = height / flux.height;
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column)
      fine.at(column, row) = flux.at(column / across, row / up) / (across * up);
  }
  return fine;
}

}  // namespace

TargetMeasure measure_of(const TargetLight& target, const Vec2& centre, double radius, double most_pixels) {
  TargetMeasure measure;
  const Box2 extent{target.extent.min - centre, target.extent.max - centre};
  if (!target.area_flux.empty() || !target.area_borders.empty()) {
    const auto [width, height] = shape_of(target);
    const double shrink = std::sqrt(most_pixels / (static_cast<double>(width) * height));
    if (shrink < 1) {
      const auto shrunk = [&](int count) { return std::max(1, static_cast<int>(std::lround(count * shrink))); };
      measure.pixels = PixelDensity(rasterise_area(target, shrunk(width), shrunk(height)), extent);
    } else {
      std::vector<AreaBorder> borders = target.area_borders;
      for (auto& border : borders) {
        border.low -= centre;
        border.high -= centre;
      }
      const bool same = width == target.area_flux.width && height == target.area_flux.height;
      measure.pixels = same ? PixelDensity(target.area_flux, extent, borders)
                            : PixelDensity(refined(target.area_flux, width, height), extent, borders);
    }
  }
  for (const auto& curve : target.curves) {
    for (std::size_t k = 0; k + 1 < curve.vertices_mm.size(); ++k) {
      const Vec2 d = curve.vertices_mm[k + 1] - curve.vertices_mm[k];
      if (d.norm() == 0) continue;
      measure.strips.push_back({curve.vertices_mm[k] - centre, d.normalized(), d.norm(), curve.density_per_mm[k],
                                curve.density_per_mm[k + 1]});
    }
  }
  for (const auto& point : target.points) measure.points.push_back({point.position_mm - centre, point.flux});
  measure.radius = radius;
  return measure;
}

Spread spread_of(const TargetLight& target, double radius) {
  double mass = 0;
  Vec2 first(0, 0);
  Vec2 second(0, 0);
  const auto add = [&](double m, const Vec2& p, const Vec2& variance) {
    mass += m;
    first += m * p;
    second += m * (p.cwiseProduct(p) + variance);
  };
  const auto& area = target.area_flux;
  if (!area.empty()) {
    const Vec2 pitch = target.extent.size().cwiseQuotient(Vec2(area.width, area.height));
    for (int row = 0; row < area.height; ++row) {
      for (int column = 0; column < area.width; ++column) {
        add(area.at(column, row), target.extent.min + pitch.cwiseProduct(Vec2(column + 0.5, row + 0.5)),
            pitch.cwiseProduct(pitch) / 12);
      }
    }
  }
  // Green's theorem along the borders, with what lies right of the extent as zero; Simpson's rule is exact for cubics.
  const double right = target.extent.max.x();
  for (const auto& border : target.area_borders) {
    const double rise = border.jump * (border.high.y() - border.low.y());
    for (const auto& [t, weight] : {std::pair(0.0, 1.0 / 6), std::pair(0.5, 4.0 / 6), std::pair(1.0, 1.0 / 6)}) {
      const Vec2 p = border.low + t * (border.high - border.low);
      const double width = right - p.x();
      const double m = weight * rise * width;
      add(m, {(right + p.x()) / 2, p.y()}, {width * width / 12, 0});
    }
  }
  const Vec2 blur = Vec2::Constant(radius * radius / 4);
  for (const auto& curve : target.curves) {
    for (std::size_t k = 0; k + 1 < curve.vertices_mm.size(); ++k) {
      const Vec2 d = curve.vertices_mm[k + 1] - curve.vertices_mm[k];
      add(d.norm() * (curve.density_per_mm[k] + curve.density_per_mm[k + 1]) / 2,
          (curve.vertices_mm[k + 1] + curve.vertices_mm[k]) / 2, d.cwiseProduct(d) / 12 + blur);
    }
  }
  for (const auto& point : target.points) add(point.flux, point.position_mm, blur);
  Spread spread;
  spread.mean = first / mass;
  spread.deviation = (second / mass - spread.mean.cwiseProduct(spread.mean)).cwiseMax(0).cwiseSqrt();
  return spread;
}

PolygonMeasure::PolygonMeasure(const TargetMeasure& measure) : measure_(measure) {
  constexpr int kMostSide = 64;
  const std::size_t strips = measure.strips.size();
  const std::size_t regions = strips + measure.disks.size();
  if (regions == 0) return;
  for (const auto& strip : measure.strips) {
    box_.include(strip.from);
    box_.include(strip.from + strip.length * strip.direction);
  }
  for (const auto& disk : measure.disks) box_.include(disk.centre);
  const Vec2 wide = Vec2::Constant(measure.radius * (1 + 1e-9));
  box_ = {box_.min - wide, box_.max + wide};
  side_ = std::clamp(static_cast<int>(std::sqrt(static_cast<double>(regions))), 1, kMostSide);
  buckets_.resize(static_cast<std::size_t>(side_) * side_);
  const auto put = [&](int region, const Vec2& p, const Vec2& q) {
    for_each_bucket({p.cwiseMin(q) - wide, p.cwiseMax(q) + wide}, [&](std::size_t bucket) {
      auto& in = buckets_[bucket];
      if (in.empty() || in.back() != region) in.push_back(region);
    });
  };
  const double piece = (box_.size() / side_).minCoeff();
  for (std::size_t r = 0; r < strips; ++r) {
    const Strip& strip = measure.strips[r];
    const int pieces = std::clamp(static_cast<int>(std::ceil(strip.length / piece)), 1, 4 * kMostSide);
    for (int k = 0; k < pieces; ++k) {
      put(static_cast<int>(r), strip.from + strip.direction * (strip.length * k / pieces),
          strip.from + strip.direction * (strip.length * (k + 1) / pieces));
    }
  }
  for (std::size_t r = strips; r < regions; ++r) {
    const Vec2& centre = measure.disks[r - strips].centre;
    put(static_cast<int>(r), centre, centre);
  }
}

template <typename Visit>
void PolygonMeasure::for_each_bucket(const Box2& box, const Visit& visit) const {
  const Vec2 scale = Vec2::Constant(side_).cwiseQuotient(box_.size());
  const auto place = [&](const Vec2& p, int axis) {
    return static_cast<int>(std::clamp(std::floor((p[axis] - box_.min[axis]) * scale[axis]), -1.0, static_cast<double>(side_)));
  };
  for (int j = std::max(place(box.min, 1), 0); j <= std::min(place(box.max, 1), side_ - 1); ++j) {
    for (int i = std::max(place(box.min, 0), 0); i <= std::min(place(box.max, 0), side_ - 1); ++i)
      visit(static_cast<std::size_t>(j) * side_ + i);
  }
}

double PolygonMeasure::mass(const std::vector<Vec2>& corners) const {
  const std::size_t count = corners.size();
  if (count < 3) return 0;
  const auto around = [&](const auto& along) {
    double sum = 0;
    for (std::size_t k = 0; k < count; ++k) sum += along(corners[k], corners[(k + 1) % count]);
    return sum;
  };
  double mass = 0;
  if (!measure_.pixels.empty()) {
    mass += around([&](const Vec2& p, const Vec2& q) { return measure_.pixels.along(p, q).mass; });
  }
  if (side_ == 0) return mass;
  Box2 box;
  for (const Vec2& corner : corners) box.include(corner);
  std::vector<int> regions;
  for_each_bucket(box, [&](std::size_t bucket) {
    regions.insert(regions.end(), buckets_[bucket].begin(), buckets_[bucket].end());
  });
  std::sort(regions.begin(), regions.end());
  regions.erase(std::unique(regions.begin(), regions.end()), regions.end());
  const int strips = static_cast<int>(measure_.strips.size());
  for (const int r : regions) {
    if (r < strips) {
      const StripRegion strip{measure_.strips[r], measure_.radius};
      mass += around([&](const Vec2& p, const Vec2& q) { return strip.along(p, q).mass; });
    } else {
      const DiskRegion disk{measure_.disks[r - strips], measure_.radius};
      mass += around([&](const Vec2& p, const Vec2& q) { return disk.along(p, q).mass; });
    }
  }
  return mass;
}

CellIntegrals integrate_cells(const TargetMeasure& measure, const PowerDiagram& diagram, const std::vector<Vec2>& sites,
                              const std::vector<double>& psi, std::vector<int>& starts) {
  const int n = static_cast<int>(sites.size());
  CellIntegrals cells;
  cells.masses.assign(n, 0);
  cells.moments.assign(n, Vec2(0, 0));
  cells.edge_slopes.assign(diagram.edges.size(), 0);

  // Pixels: once along every edge, added on one side and subtracted on the other.
  if (!measure.pixels.empty()) {
    std::vector<PixelDensity::Integral> integrals(diagram.edges.size());
    parallel_blocks(diagram.edges.size(), kEdgeBlock, [&](std::size_t begin, std::size_t end) {
      for (std::size_t e = begin; e < end; ++e) {
        const auto& edge = diagram.edges[e];
        integrals[e] = measure.pixels.along(diagram.vertices[edge.from], diagram.vertices[edge.to]);
      }
    });
    parallel_blocks(n, kEdgeBlock, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        for (std::size_t k = diagram.first_edge[i]; k < diagram.first_edge[i + 1]; ++k) {
          const int e = diagram.incident_edges[k];
          const double sign = diagram.edges[e].a == static_cast<int>(i) ? 1 : -1;
          cells.masses[i] += sign * integrals[e].mass;
          cells.moments[i] += sign * integrals[e].moment;
        }
      }
    });
    for (std::size_t e = 0; e < diagram.edges.size(); ++e) {
      const auto& edge = diagram.edges[e];
      if (edge.a < n && edge.b < n) cells.edge_slopes[e] = integrals[e].line;
    }
  }
  cells.collapsed_moments = cells.moments;

  // Strips and disks: over the cells they touch, each block on its own, summed in order.
  const std::size_t regions = measure.strips.size() + measure.disks.size();
  if (regions > 0) {
    int visible = 0;
    while (visible + 1 < n && diagram.first_edge[visible] == diagram.first_edge[visible + 1]) ++visible;
    starts.resize(regions, visible);
    const std::size_t blocks = (regions + kRegionBlock - 1) / kRegionBlock;
    std::vector<Additions> additions(blocks);
    const std::size_t group = (blocks + 7) / 8;  // few walkers: each needs memory of the size of the diagram
    parallel_blocks(blocks, group, [&](std::size_t first_block, std::size_t last_block) {
      RegionWalker walker(diagram, sites, psi);
      for (std::size_t b = first_block; b < last_block; ++b) {
        for (std::size_t r = b * kRegionBlock; r < std::min(regions, (b + 1) * kRegionBlock); ++r) {
          int hint = starts[r];
          if (hint >= n || diagram.first_edge[hint] == diagram.first_edge[hint + 1]) hint = visible;
          starts[r] = r < measure.strips.size()
                          ? walker.walk(StripRegion{measure.strips[r], measure.radius}, hint, additions[b])
                          : walker.walk(DiskRegion{measure.disks[r - measure.strips.size()], measure.radius}, hint,
                                        additions[b]);
        }
      }
    });
    for (const auto& block : additions) {
      for (const auto& [site, share] : block.cells) {
        cells.masses[site] += share.mass;
        cells.moments[site] += share.moment;
        cells.collapsed_moments[site] += share.collapsed;
      }
      for (const auto& [edge, line] : block.slopes) cells.edge_slopes[edge] += line;
    }
  }
  for (std::size_t e = 0; e < diagram.edges.size(); ++e) cells.edge_slopes[e] /= diagram.site_distance[e];
  return cells;
}

void add_points(const TargetMeasure& measure, std::vector<PointShare> shares, CellIntegrals& cells) {
  for (const auto& [point, site, mass] : shares) {
    const Vec2 moment = mass * measure.points[point].place;
    cells.masses[site] += mass;
    cells.moments[site] += moment;
    cells.collapsed_moments[site] += moment;
  }
  cells.point_shares = std::move(shares);
}

}  // namespace lightmill::detail

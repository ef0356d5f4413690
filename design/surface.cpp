#include "design/surface.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <unordered_map>
#include <utility>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/compound_energy.h"
#include "design/detail/creases.h"
#include "design/detail/fresnel.h"
#include "design/detail/height_field.h"
#include "design/detail/height_settling.h"
#include "design/detail/hollow_limit.h"
#include "design/detail/map_interpolation.h"
#include "design/detail/near_border.h"
#include "design/detail/one_ring.h"
#include "design/detail/outline_mesh.h"
#include "design/detail/parabola_normal.h"
#include "design/detail/picture_loop.h"
#include "design/detail/vertex_light.h"

namespace lightmill {

namespace {

using detail::CompoundEnergy;
using detail::Creases;
using detail::Freedom;
using detail::HeightIntegrator;
using detail::HeightSettling;
using detail::OneRing;
using detail::VertexLight;

constexpr int kFirstGuessTurns = 60;           // of Fresnel mapping and integration; each gains about a digit
constexpr double kFirstGuessTolerance = 1e-9;  // mm
constexpr double kRoughTolerance = 1e-3;       // mm: enough to see which ray meets a vertex, and to go on from
constexpr double kNearlyAtRest = 1e-4;         // mm: enough to see which normals heights alone cannot mend

/// The target normals move on between turns, so that none needs to be driven to its end.
constexpr int kSlidingSteps = 5;
/// A vertex that slides into a crease changes its normals by much: undamped steps overshoot and are refused.
constexpr double kSlidingTrustRadius = 10;
/// Heights of the lens's own size are softer than those of single vertices by (mesh size)^2: any damping would hold
/// them.
constexpr double kEverywhereTrustRadius = 1e10;

SurfaceMesh grid_mesh(const Lens& lens, int longer) {
  const double pitch = lens.size_mm.maxCoeff() / (longer - 1);
  const int columns = std::max(1, static_cast<int>(std::lround(lens.size_mm.x() / pitch)));
  const int rows = std::max(1, static_cast<int>(std::lround(lens.size_mm.y() / pitch)));
  SurfaceMesh mesh;
  for (int j = 0; j <= rows; ++j) {
    for (int i = 0; i <= columns; ++i) {
      // Exactly symmetric, with the outline exactly on the lens's edge.
      mesh.vertices.emplace_back(lens.size_mm.x() * (2 * i - columns) / (2 * columns),
                                 lens.size_mm.y() * (2 * j - rows) / (2 * rows), lens.thickness_mm);
    }
  }
  const auto node = [&](int i, int j) { return j * (columns + 1) + i; };
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const int a = node(i, j), b = node(i + 1, j), c = node(i + 1, j + 1), d = node(i, j + 1);
      // Alternating diagonals: no direction is favoured, and rings are symmetric, so that their normals are second
      // order.
      if ((i + j) % 2 == 0) {
        mesh.triangles.push_back({a, b, c});
        mesh.triangles.push_back({a, c, d});
      } else {
        mesh.triangles.push_back({a, b, d});
        mesh.triangles.push_back({b, c, d});
      }
    }
  }
  return mesh;
}

SurfaceMesh disk_mesh(const Lens& lens, int longer) {
  const int rings = std::max(1, (longer - 1) / 2);
  SurfaceMesh mesh;
  mesh.vertices.emplace_back(0, 0, lens.thickness_mm);
  for (int ring = 1; ring <= rings; ++ring) {
    for (int i = 0; i < 6 * ring; ++i) {
      const double angle = 2 * kPi * i / (6 * ring);
      mesh.vertices.emplace_back(lens.size_mm.x() / 2 * ring / rings * std::cos(angle),
                                 lens.size_mm.y() / 2 * ring / rings * std::sin(angle), lens.thickness_mm);
    }
  }
  // Vertex `i` of `ring`, counted around without end.
  const auto node = [](int ring, int i) { return ring == 0 ? 0 : 1 + 3 * ring * (ring - 1) + i % (6 * ring); };
  for (int ring = 1; ring <= rings; ++ring) {
    for (int sextant = 0; sextant < 6; ++sextant) {
      for (int i = 0; i < ring; ++i) {
        const int outer = sextant * ring + i;
        const int inner = sextant * (ring - 1) + i;
        mesh.triangles.push_back({node(ring - 1, inner), node(ring, outer), node(ring, outer + 1)});
        if (i + 1 < ring)
          mesh.triangles.push_back({node(ring - 1, inner), node(ring, outer + 1), node(ring - 1, inner + 1)});
      }
    }
  }
  return mesh;
}

/// A square grid inside, a little off the outline; Delaunay triangles between the two.
SurfaceMesh outlined_mesh(const Lens& lens, int longer) {
  constexpr double kOff = 0.6;      // of the pitch, that the grid keeps off the outline: no slivers
  constexpr double kLongest = 1.5;  // of the pitch: the diagonals of the grid's squares pass
  const double pitch = lens.size_mm.maxCoeff() / (longer - 1);
  std::vector<std::vector<Vec2>> loops;
  std::vector<detail::Segment> border;
  Box2 box;
  for (const auto& loop : lens.outline_mm) {
    loops.push_back(detail::resampled(loop, pitch));
    for (std::size_t k = 0; k < loops.back().size(); ++k) {
      border.push_back({loops.back()[k], loops.back()[(k + 1) % loops.back().size()]});
      box.include(loops.back()[k]);
    }
  }
  SurfaceMesh mesh;
  if (border.empty()) return mesh;
  const detail::NearBorder near_border(border, kOff * pitch);
  const int columns = static_cast<int>(std::ceil(box.size().x() / pitch)) + 1;
  const int rows = static_cast<int>(std::ceil(box.size().y() / pitch)) + 1;
  const auto place = [&](int i, int j) { return Vec2(box.min.x() + i * pitch, box.min.y() + j * pitch); };
  std::vector<Vec2> inner;
  for (int j = 0; j < rows; ++j) {
    // Where the row crosses the outline, in order: inside is between odd and even.
    const double y = place(0, j).y();
    std::vector<double> crossings;
    for (const auto& [a, b] : border) {
      if ((a.y() > y) != (b.y() > y)) crossings.push_back(a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
    }
    std::sort(crossings.begin(), crossings.end());
    for (int i = 0; i < columns; ++i) {
      const Vec2 p = place(i, j);
      const auto before = std::lower_bound(crossings.begin(), crossings.end(), p.x()) - crossings.begin();
      if (before % 2 == 1 && !near_border.near(p)) inner.push_back(p);
    }
  }
  const detail::PlanarMesh plane = detail::outline_mesh(loops, kLongest * pitch, inner);
  mesh.triangles = plane.triangles;
  // The diagonals of whole squares alternate, as in a rectangle's grid; Delaunay's are anybody's guess.
  std::vector<int> square_of(plane.vertices.size(), -1);
  std::vector<int> column(plane.vertices.size()), row(plane.vertices.size());
  for (std::size_t v = 0; v < plane.vertices.size(); ++v) {
    const Vec2& p = plane.vertices[v];
    mesh.vertices.emplace_back(p.x(), p.y(), lens.thickness_mm);
    column[v] = static_cast<int>(std::lround((p.x() - box.min.x()) / pitch));
    row[v] = static_cast<int>(std::lround((p.y() - box.min.y()) / pitch));
    if (p == place(column[v], row[v])) square_of[v] = row[v] * columns + column[v];
  }
  std::unordered_map<int, std::array<int, 2>> squares;  // lower left node: its triangles
  for (std::size_t k = 0; k < mesh.triangles.size(); ++k) {
    const auto& t = mesh.triangles[k];
    if (square_of[t[0]] < 0 || square_of[t[1]] < 0 || square_of[t[2]] < 0) continue;
    const auto [left, right] = std::minmax({column[t[0]], column[t[1]], column[t[2]]});
    const auto [low, high] = std::minmax({row[t[0]], row[t[1]], row[t[2]]});
    if (right - left != 1 || high - low != 1) continue;
    auto& pair = squares.try_emplace(low * columns + left, std::array{-1, -1}).first->second;
    pair[pair[0] < 0 ? 0 : 1] = static_cast<int>(k);
  }
  std::unordered_map<int, int> node;
  for (std::size_t v = 0; v < square_of.size(); ++v) {
    if (square_of[v] >= 0) node[square_of[v]] = static_cast<int>(v);
  }
  for (const auto& [lower_left, pair] : squares) {
    if (pair[1] < 0) continue;
    const int a = node.at(lower_left), b = node.at(lower_left + 1);
    const int c = node.at(lower_left + columns + 1), d = node.at(lower_left + columns);
    const bool even = (lower_left % columns + lower_left / columns) % 2 == 0;
    mesh.triangles[pair[0]] = even ? std::array{a, b, c} : std::array{a, b, d};
    mesh.triangles[pair[1]] = even ? std::array{a, c, d} : std::array{b, c, d};
  }
  return mesh;
}

}  // namespace

SurfaceMesh start_mesh(const Lens& lens, int vertices_along_longer_side) {
  if (vertices_along_longer_side < 3) {
    throw InputError("surface.mesh is " + std::to_string(vertices_along_longer_side) + ", must be at least 3");
  }
  if (!(lens.size_mm.minCoeff() > 0)) throw InputError("lens.size_mm must be positive");
  SurfaceMesh mesh = lens.shape == Lens::Shape::kDisk      ? disk_mesh(lens, vertices_along_longer_side)
                     : lens.shape == Lens::Shape::kOutline ? outlined_mesh(lens, vertices_along_longer_side)
                                                           : grid_mesh(lens, vertices_along_longer_side);
  if (mesh.triangles.empty()) throw InputError("lens.outline encloses nothing; draw a closed, filled shape");
  mesh.normals.assign(mesh.vertices.size(), Vec3::UnitZ());
  return mesh;
}

std::vector<Vec2> interpolate_map(const TransportMap& map, const SourceLight& source,
                                  const std::vector<Vec2>& points_mm) {
  return detail::MapInterpolation(map, source).at(points_mm);
}

namespace {

/// Which way a vertex may go: inside everywhere, on a straight side along it, at corners and on a round outline only
/// up.
struct Outline {
  std::vector<Freedom> freedom;
  std::vector<Vec2> sides;
};

Outline outline_freedom(const std::vector<OneRing>& rings, const std::vector<Vec2>& entry) {
  constexpr double kStraight = 1e-9;  // sine of the turn between two edges that are one side
  Outline outline{std::vector<Freedom>(rings.size(), Freedom::kAll), std::vector<Vec2>(rings.size(), Vec2::Zero())};
  for (std::size_t v = 0; v < rings.size(); ++v) {
    if (rings[v].closed) continue;
    outline.freedom[v] = Freedom::kHeight;
    if (rings[v].neighbours.size() < 2) continue;
    const Vec2 before = (entry[v] - entry[rings[v].neighbours.front()]).normalized();
    const Vec2 after = (entry[rings[v].neighbours.back()] - entry[v]).normalized();
    if (std::abs(before.x() * after.y() - before.y() * after.x()) > kStraight || before.dot(after) < 0) continue;
    outline.freedom[v] = Freedom::kHeightAndSide;
    outline.sides[v] = (before + after).normalized();
  }
  return outline;
}

/// What the angle-weighted normal of a vertex shall be where its ring is one-sided, on the border and at creases: the
/// same mean of its triangles' wanted normals. Elsewhere rings surround their vertex, and its own normal is wanted.
std::vector<Vec3> ring_targets(const std::vector<Vec3>& wanted, const std::vector<Vec3>& positions,
                               const std::vector<OneRing>& rings, const Creases& creases) {
  std::vector<Vec3> result = wanted;
  for (std::size_t v = 0; v < rings.size(); ++v) {
    const OneRing& ring = rings[v];
    if (ring.closed && creases.crossed[v] == 0) continue;
    Vec3 sum = Vec3::Zero();
    bool torn = true;
    for (int k = 0; k < ring.triangle_count(); ++k) {
      if (!detail::has_say(creases.crossed[v], ring.triangle_count(), k)) continue;
      const int a = ring.neighbours[k];
      const int b = ring.neighbours[(k + 1) % ring.neighbours.size()];
      const Vec3 u = positions[a] - positions[v];
      const Vec3 w = positions[b] - positions[v];
      sum += std::atan2(u.cross(w).norm(), u.dot(w)) * (wanted[v] + wanted[a] + wanted[b]).normalized();
      torn &= (creases.crossed[v] >> (k % 32) & 1) != 0;
    }
    if (!torn && sum.norm() > 0) result[v] = sum.normalized();
  }
  return result;
}

std::vector<Vec3> ring_normals(const std::vector<Vec3>& positions, const std::vector<OneRing>& rings,
                               const Creases& creases) {
  std::vector<Vec3> normals(positions.size());
  parallel_blocks(positions.size(), 4096, [&](std::size_t begin, std::size_t end) {
    std::vector<Vec3> around;
    for (std::size_t v = begin; v < end; ++v) {
      around.clear();
      for (int n : rings[v].neighbours) around.push_back(positions[n]);
      normals[v] = detail::ring_normal(positions[v], around, rings[v].closed, creases.crossed[v], nullptr);
    }
  });
  return normals;
}

/// Lowers or lifts the surface so that its lowest vertex is at `floor_mm` (DESIGN.md, "Height gauge and d_TH").
void put_on_floor(std::vector<Vec3>& positions, double floor_mm) {
  double lowest = positions.front().z();
  for (const Vec3& p : positions) lowest = std::min(lowest, p.z());
  for (Vec3& p : positions) p.z() += floor_mm - lowest;
}

void grow(std::vector<char>& marked, const std::vector<OneRing>& rings, int by) {
  for (int ring = 0; ring < by; ++ring) {
    const std::vector<char> core = marked;
    for (std::size_t v = 0; v < marked.size(); ++v) {
      for (int n : rings[v].neighbours) marked[v] |= core[n];
    }
  }
}

/// Vertices slide where it pays: where the heights alone leave a normal so wrong that sliding by kWorthwhile of an edge
/// would cost less, and much more wrong than most (wanted normals are never quite those of a surface), and
/// kSlidingRings rings around. Around these heights give way; elsewhere the light would gain nothing.
std::vector<Freedom> near_creases(const CompoundEnergy& energy, const std::vector<Vec3>& positions,
                                  const std::vector<Freedom>& most_freedom) {
  constexpr double kWorthwhile = 0.1;
  constexpr double kMuchMore = 5;
  constexpr int kSlidingRings = 2;
  constexpr int kHeightRings = 4;
  const std::vector<Vec3> normals = ring_normals(positions, energy.rings, energy.creases);
  std::vector<double> errors;
  for (std::size_t v = 0; v < positions.size(); ++v) errors.push_back((normals[v] - energy.target_normals[v]).norm());
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  const double least =
      std::max(std::sqrt(energy.weights.direction / energy.weights.integration) * kWorthwhile * energy.slope_scale,
               kMuchMore * *middle);
  std::vector<char> near(positions.size(), 0);
  for (std::size_t v = 0; v < positions.size(); ++v) near[v] = (normals[v] - energy.target_normals[v]).norm() > least;
  grow(near, energy.rings, kSlidingRings);
  std::vector<char> around = near;
  grow(around, energy.rings, kHeightRings);
  std::vector<Freedom> result(positions.size(), Freedom::kNone);
  for (std::size_t v = 0; v < positions.size(); ++v) {
    if (near[v]) {
      result[v] = most_freedom[v];
    } else if (around[v]) {
      result[v] = Freedom::kHeight;
    }
  }
  return result;
}

double signed_area(const std::vector<Vec3>& p, const std::array<int, 3>& t) {
  const Vec3 ab = p[t[1]] - p[t[0]];
  const Vec3 ac = p[t[2]] - p[t[0]];
  return (ab.x() * ac.y() - ab.y() * ac.x()) / 2;
}

/// Takes vertices of triangles that a turn has turned over (or all but) half the way back to where they were, again and
/// again; `before` has none, so it ends. Returns how many vertices were held back.
int hold_back(const std::vector<std::array<int, 3>>& triangles, const std::vector<Vec3>& before, double least_area,
              std::vector<Vec3>& positions) {
  std::vector<char> held(positions.size(), 0);
  constexpr int kHalvings = 12;
  for (int halving = 0; halving <= kHalvings; ++halving) {
    std::vector<char> back(positions.size(), 0);
    bool any = false;
    for (const auto& t : triangles) {
      if (signed_area(positions, t) >= std::min(least_area, signed_area(before, t))) continue;
      for (int corner : t) back[corner] = held[corner] = 1;
      any = true;
    }
    if (!any) break;
    for (std::size_t v = 0; v < positions.size(); ++v) {
      if (!back[v]) continue;
      positions[v] = halving == kHalvings ? before[v] : Vec3((positions[v] + before[v]) / 2);
    }
  }
  return static_cast<int>(std::count(held.begin(), held.end(), 1));
}

/// Normals to trace and mill by: angle-weighted inside; on the border and at creases, where that is one-sided, the
/// normal of the parabola that fits the vertices around on the same side best, if they lie well around.
std::vector<Vec3> surface_normals(const SurfaceMesh& mesh, const std::vector<OneRing>& rings, const Creases& creases) {
  std::vector<Vec3> normals = ring_normals(mesh.vertices, rings, creases);
  parallel_blocks(rings.size(), 4096, [&](std::size_t begin, std::size_t end) {
    std::vector<int> around;
    std::vector<Vec3> places;
    for (std::size_t v = begin; v < end; ++v) {
      if (rings[v].closed && creases.crossed[v] == 0) continue;
      const auto add_ring = [&](int of) {
        for (int n : rings[of].neighbours) {
          if (!creases.torn(of, n)) around.push_back(n);
        }
      };
      around.clear();
      add_ring(static_cast<int>(v));
      for (std::size_t k = 0, first = around.size(); k < first; ++k) add_ring(around[k]);
      std::sort(around.begin(), around.end());
      around.erase(std::unique(around.begin(), around.end()), around.end());
      std::erase(around, static_cast<int>(v));
      places.clear();
      for (const int n : around) places.push_back(mesh.vertices[n]);
      if (const auto normal = detail::parabola_normal(mesh.vertices[v], places)) normals[v] = *normal;
    }
  });
  return normals;
}

/// Concave curvature along an edge, 1/mm.
double hollowness(const SurfaceMesh& mesh, int i, int j) {
  const Vec3 along = mesh.vertices[j] - mesh.vertices[i];
  return -(mesh.normals[j] - mesh.normals[i]).dot(along) / along.squaredNorm();
}

void report_hollows(const SurfaceMesh& mesh, const std::vector<std::array<int, 2>>& edges,
                    const std::vector<OneRing>& rings, const std::vector<VertexLight>& light,
                    double min_concave_radius_mm, SurfaceSummary& summary) {
  const auto judged = [&](int i, int j) { return rings[i].closed && rings[j].closed; };
  std::vector<double> curvatures;
  for (const auto& [i, j] : edges) {
    if (judged(i, j)) curvatures.push_back(hollowness(mesh, i, j));
  }
  summary.min_concave_radius_mm = std::numeric_limits<double>::infinity();
  if (!curvatures.empty()) {
    constexpr double kPercentile = 0.999;
    const auto place =
        curvatures.begin() + static_cast<std::ptrdiff_t>(kPercentile * static_cast<double>(curvatures.size() - 1));
    std::nth_element(curvatures.begin(), place, curvatures.end());
    if (*place > 0) summary.min_concave_radius_mm = 1 / *place;
  }
  double area_sum = 0, light_sum = 0;
  for (const auto& t : mesh.triangles) {
    const Vec3 area = (mesh.vertices[t[1]] - mesh.vertices[t[0]]).cross(mesh.vertices[t[2]] - mesh.vertices[t[0]]) / 2;
    const double flux = area.dot(light[t[0]].flux + light[t[1]].flux + light[t[2]].flux) / 3;
    area_sum += area.norm();
    light_sum += flux;
    bool sharper = false;
    for (int k = 0; k < 3; ++k) {
      const int i = t[k], j = t[(k + 1) % 3];
      sharper |= judged(i, j) && hollowness(mesh, i, j) * min_concave_radius_mm > 1;
    }
    if (!sharper) continue;
    summary.sharper_area_share += area.norm();
    summary.sharper_light_share += flux;
  }
  summary.sharper_area_share /= area_sum;
  summary.sharper_light_share = light_sum > 0 ? summary.sharper_light_share / light_sum : 0;
}

void check_options(const Lens& lens, const Receiver& receiver, const SurfaceOptions& options) {
  if (!(lens.refractive_index > 1)) throw InputError("lens.refractive_index must be above 1");
  if (!(receiver.distance_mm > 0)) throw InputError("receiver.distance_mm must be positive");
  if (!(options.min_concave_radius_mm > 0)) throw InputError("surface.min_concave_radius_mm must be above 0");
  if (options.outer_iterations < 0) throw InputError("surface.outer_iterations must not be negative");
  const SurfaceWeights& w = options.weights;
  for (const auto& [name, value] :
       {std::pair{"integration", w.integration}, std::pair{"barrier", w.barrier}, std::pair{"direction", w.direction},
        std::pair{"flux", w.flux}, std::pair{"smoothness", w.smoothness}}) {
    if (!(value >= 0)) throw InputError(std::string("surface.weights.") + name + " must not be negative");
  }
  if (!(w.integration > 0))
    throw InputError("surface.weights.integration must be positive: nothing else shapes the surface");
}

/// The rays through the vertices where they are, and where these shall go.
struct Aim {
  Creases creases;
  std::vector<VertexLight> light;
  std::vector<Vec3> directions;
  std::vector<Vec2> targets_mm;
  int unmapped = 0;
};

/// Vertices whose light the base loses aim where the nearest that keep theirs aim.
int fill_unmapped(std::vector<VertexLight>& light, const std::vector<OneRing>& rings) {
  std::vector<std::size_t> front;
  int unmapped = 0;
  for (std::size_t v = 0; v < light.size(); ++v) {
    if (light[v].mapped) {
      front.push_back(v);
    } else {
      ++unmapped;
    }
  }
  if (unmapped == 0) return 0;
  if (front.empty()) throw InputError("light: none of it arrives on the receiver");
  std::vector<char> known(light.size(), 0);
  for (std::size_t v : front) known[v] = 1;
  for (std::size_t k = 0; k < front.size(); ++k) {
    for (int n : rings[front[k]].neighbours) {
      if (known[n]) continue;
      known[n] = 1;
      light[n].source_mm = light[front[k]].source_mm;
      front.push_back(n);
    }
  }
  return unmapped;
}

/// Aims anew where rays have moved: heights change which slanted ray meets a vertex.
void take_aim(const detail::LitBase& base, const TargetFunction& target, const std::vector<OneRing>& rings,
              const std::vector<Vec3>& positions, bool may_crease, Aim& aim) {
  constexpr double kSamePlace = 1e-7;  // mm
  std::vector<VertexLight> light = base.at(positions);
  aim.unmapped = fill_unmapped(light, rings);
  bool moved = aim.light.size() != light.size();
  for (std::size_t v = 0; !moved && v < light.size(); ++v)
    moved = (light[v].source_mm - aim.light[v].source_mm).norm() > kSamePlace;
  if (moved) {
    std::vector<Vec2> places;
    for (const VertexLight& ray : light) places.push_back(ray.source_mm);
    aim.targets_mm = target(places);
    if (aim.targets_mm.size() != places.size()) {
      throw InputError("surface: " + std::to_string(aim.targets_mm.size()) + " target points for " +
                       std::to_string(places.size()) + " vertices");
    }
    if (may_crease) {
      aim.creases = detail::find_creases(rings, places, aim.targets_mm, target);
    } else {
      aim.creases.crossed.assign(rings.size(), 0);
    }
  }
  aim.directions.clear();
  for (const VertexLight& ray : light) aim.directions.push_back(ray.direction);
  if (moved) aim.light = std::move(light);
}

/// Normals of vertices at `positions` that aim at `targets`, without sharp hollows if the options say so.
std::vector<Vec3> wanted_normals(const std::vector<Vec3>& positions, const Aim& aim, const std::vector<Vec2>& targets,
                                 const HeightIntegrator& integrator, const Lens& lens, const Receiver& receiver,
                                 const SurfaceOptions& options) {
  std::vector<Vec3> normals = detail::fresnel_normals(positions, aim.directions, targets, lens, receiver);
  if (!options.limit_hollows) return normals;
  const std::vector<Vec2> slopes = detail::limited_hollows(detail::slopes_of(normals), positions, integrator.edges(), aim.creases,
                                                           options.min_concave_radius_mm);
  for (std::size_t v = 0; v < normals.size(); ++v) normals[v] = Vec3(-slopes[v].x(), -slopes[v].y(), 1).normalized();
  return normals;
}

/// What the normals of the energy's vertices shall be when they stand at `positions` and aim at `targets`.
void set_targets(CompoundEnergy& energy, const std::vector<Vec3>& positions, const Aim& aim, const std::vector<Vec2>& targets,
                 const HeightIntegrator& integrator, const Lens& lens, const Receiver& receiver, const SurfaceOptions& options) {
  const std::vector<Vec3> wanted = wanted_normals(positions, aim, targets, integrator, lens, receiver, options);
  energy.target_normals = ring_targets(wanted, positions, energy.rings, aim.creases);
  energy.target_slopes = detail::slopes_of(wanted);
}

/// Targets are corrected by what the surface paints, and heights follow, as long as that brings the picture closer.
void close_picture_loop(const TargetLight& picture, const SurfaceOptions& options, const Lens& lens, const Receiver& receiver,
                        const detail::LitBase& base, const Aim& aim, const HeightIntegrator& integrator, CompoundEnergy& energy,
                        HeightSettling& settling, OpticalSurface& surface, const Monitor& monitor) {
  constexpr int kLeastPixels = 256;         // as the measures
  constexpr double kVerticesPerPixel = 2.5;
  constexpr double kLeastGain = 0.01;       // of the error, for which a further turn is made
  constexpr double kLeastShare = 0.2;       // of the moves that the first order asks for
  std::vector<Vec3>& positions = surface.mesh.vertices;
  const std::size_t count = positions.size();
  const std::vector<VertexLight> light = base.at(positions);
  std::vector<double> flux;
  double all = 0;
  for (const auto& t : surface.mesh.triangles) {
    const Vec3 area = (positions[t[1]] - positions[t[0]]).cross(positions[t[2]] - positions[t[0]]) / 2;
    flux.push_back(area.dot(light[t[0]].flux + light[t[1]].flux + light[t[2]].flux) / 3);
    all += flux.back();
  }
  for (double& f : flux) f /= all;
  std::vector<Vec2> places;
  for (const VertexLight& ray : aim.light) places.push_back(ray.source_mm);
  const int along = static_cast<int>(std::sqrt(static_cast<double>(count)) / kVerticesPerPixel);
  // With seams joined most is gained; where the light of curves is what stretches across the dark, nothing is.
  const std::vector<Vec2> targets_at_start = surface.targets_mm;
  std::optional<detail::PictureLoop> loop;
  const auto build = [&](detail::Seams seams) {
    loop.emplace(picture, std::max(kLeastPixels, along), surface.mesh.triangles, flux, places, targets_at_start, aim.creases, seams);
  };
  build(detail::Seams::kJoined);
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  const auto landed = [&] {
    const std::vector<Vec3> normals = surface_normals(surface.mesh, energy.rings, aim.creases);
    std::vector<Vec2> result = surface.targets_mm;
    parallel_blocks(count, 4096, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v) {
        Vec3 after;
        Vec2 place;
        if (refract(light[v].direction, normals[v], {lens.refractive_index, 1}, after) && frame.meet(positions[v], after, place))
          result[v] = place;
      }
    });
    return result;
  };

  const int turns = options.picture_turns;
  std::vector<Vec2> ends = landed();
  detail::PictureLoop::Errors errors = loop->errors(ends);
  std::vector<double>& history = surface.summary.picture_errors;
  history.push_back(errors.sum);
  const std::vector<double>& missing = errors.missing.values;
  if (std::all_of(missing.begin(), missing.end(), [](double m) { return m == 0; })) return;  // all light is for curves
  double share = 1;
  bool joined = true;
  for (int turn = 0; turn < turns; ++turn) {
    monitor.report("correcting by the picture", static_cast<double>(turn) / turns);
    const std::vector<Vec3> positions_before = positions;
    const std::vector<Vec2> targets_before = surface.targets_mm;
    const std::vector<Vec2> moves = loop->moves(errors, ends);
    for (std::size_t v = 0; v < count; ++v) surface.targets_mm[v] += share * moves[v];
    set_targets(energy, positions, aim, surface.targets_mm, integrator, lens, receiver, options);
    settling.settle(kRoughTolerance, positions, monitor.part(static_cast<double>(turn) / turns, (turn + 1.0) / turns));
    put_on_floor(positions, lens.thickness_mm);
    std::vector<Vec2> ends_now = landed();
    detail::PictureLoop::Errors errors_now = loop->errors(ends_now);
    const double gain = 1 - errors_now.sum / errors.sum;
    if (gain > 0) {
      ends = std::move(ends_now);
      errors = std::move(errors_now);
      history.push_back(errors.sum);
    } else {
      positions = positions_before;
      surface.targets_mm = targets_before;
    }
    if (gain >= kLeastGain) continue;
    if (joined) {
      joined = false;
      build(detail::Seams::kParted);
      continue;
    }
    share /= 2;
    if (share < kLeastShare) return;
  }
}

/// Heights over the lens, lowest 0, of the base that the surface starts from.
std::vector<double> base_heights(const Lens& lens, const std::vector<Vec3>& vertices, double& floor) {
  std::vector<double> heights(vertices.size());
  const BaseSurface base(lens.base);
  parallel_blocks(vertices.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) heights[v] = base.at(vertices[v].head<2>()).height_mm;
  });
  floor = *std::min_element(heights.begin(), heights.end());
  for (double& h : heights) h -= floor;
  return heights;
}

/// `picture` may be null: then there is no loop.
OpticalSurface solve(const Lens& lens, const Light& light, const Receiver& receiver, const TargetFunction& target,
                     const TargetLight* picture, const SurfaceOptions& options, const Monitor& monitor) {
  const auto started = std::chrono::steady_clock::now();
  check_options(lens, receiver, options);
  OpticalSurface surface;
  surface.mesh = start_mesh(lens, options.mesh);
  std::vector<Vec3>& positions = surface.mesh.vertices;
  const std::size_t count = positions.size();
  for (const Vec3& p : positions) surface.entry_mm.emplace_back(p.head<2>());
  SurfaceSummary& summary = surface.summary;
  summary.vertices = static_cast<int>(count);
  const std::vector<OneRing> rings = detail::one_rings(static_cast<int>(count), surface.mesh.triangles);
  double base_floor = 0;
  const std::vector<double> heights_at_start = base_heights(lens, positions, base_floor);
  for (std::size_t v = 0; v < count; ++v) positions[v].z() += heights_at_start[v];
  const detail::LitBase base(lens, light, receiver, base_floor);

  // First guess: heights only, Fresnel mapping and integration in turn until nothing moves. Then vertices near creases
  // are drawn to them, and once more.
  std::optional<HeightIntegrator> integrator(std::in_place, surface.entry_mm, surface.mesh.triangles);
  const Outline outline = outline_freedom(rings, surface.entry_mm);
  const bool may_crease = options.solver != SurfaceSolver::kHeightField;
  Aim aim;
  for (const bool drawn : {false, true}) {
    monitor.report(drawn ? "heights between creases" : "first guess of the heights", drawn ? 0.05 : 0.0);
    std::vector<Vec2> slopes;
    for (int turn = 0; turn < kFirstGuessTurns; ++turn) {
      monitor.check();
      take_aim(base, target, rings, positions, may_crease, aim);
      slopes = detail::slopes_of(
          wanted_normals(positions, aim, aim.targets_mm, *integrator, lens, receiver, options));
      const std::vector<double> heights = integrator->integrate(slopes, aim.creases);
      double change = 0;
      for (std::size_t v = 0; v < count; ++v) {
        const double z = lens.thickness_mm + heights[v];
        change = std::max(change, std::abs(z - positions[v].z()));
        positions[v].z() = z;
      }
      if (change < (drawn || !may_crease ? kFirstGuessTolerance : kRoughTolerance)) break;
    }
    if (drawn || aim.creases.shares.empty()) break;
    surface.entry_mm =
        detail::drawn_to_creases(aim.creases, rings, surface.mesh.triangles, surface.entry_mm, slopes, outline.sides);
    for (std::size_t v = 0; v < count; ++v) positions[v].head<2>() = surface.entry_mm[v];
    integrator.emplace(surface.entry_mm, surface.mesh.triangles, aim.creases);
  }
  take_aim(base, target, rings, positions, may_crease, aim);
  surface.targets_mm = aim.targets_mm;
  summary.unmapped_vertices = aim.unmapped;

  // The paper's energy, and Fresnel mapping again, in turn. From here on each vertex belongs to the ray that meets it
  // now.
  const std::vector<Vec3> start = positions;
  std::vector<Freedom> freedom;
  double edge_sum = 0;
  for (const auto& [i, j] : integrator->edges()) edge_sum += (surface.entry_mm[j] - surface.entry_mm[i]).norm();
  CompoundEnergy energy{surface.mesh.triangles, rings, start, aim.light,      freedom, aim.creases,
                        outline.sides,          {},    {},    options.weights};
  energy.edge_mm = edge_sum / static_cast<double>(integrator->edges().size());
  energy.slope_scale = lens.size_mm.maxCoeff() / ((lens.refractive_index - 1) * receiver.distance_mm);
  energy.floor_mm = lens.thickness_mm;
  HeightSettling settling(energy);
  double lens_area = 0;
  for (const auto& t : surface.mesh.triangles) lens_area += signed_area(positions, t);
  constexpr double kThinnest = 1e-3;  // of the mean triangle's area: thinner ones have no normal worth its name
  const double least_area = kThinnest * lens_area / static_cast<double>(surface.mesh.triangles.size());
  const bool everywhere = options.solver == SurfaceSolver::kEverywhere;

  summary.reason = "outer iterations used up";
  for (int turn = 0; turn < options.outer_iterations; ++turn) {
    const Monitor part =
        monitor.part(0.1 + 0.9 * turn / options.outer_iterations, 0.1 + 0.9 * (turn + 1) / options.outer_iterations);
    const bool last = turn + 1 == options.outer_iterations;
    if (last && picture != nullptr && options.picture_turns > 0) {
      close_picture_loop(*picture, options, lens, receiver, base, aim, *integrator, energy, settling, surface,
                         part.part(0, 0.7));
    }
    set_targets(energy, positions, aim, surface.targets_mm, *integrator, lens, receiver, options);
    const std::vector<Vec3> before = positions;
    detail::MinimiserReport report;
    // The first turn brings the heights to rest. What is wrong then, only sliding can mend; it is damped, so that the
    // last turn brings the heights to rest again.
    const bool may_slide = may_crease && turn > 0 && !last;
    int sliding = 0;
    if (everywhere || may_slide) {
      freedom = everywhere ? outline.freedom : near_creases(energy, positions, outline.freedom);
      sliding = static_cast<int>(
          std::count_if(freedom.begin(), freedom.end(), [](Freedom f) { return f > Freedom::kHeight; }));
      if (sliding > 0) {
        summary.sliding_vertices = std::max(summary.sliding_vertices, sliding);
        report = detail::minimise(energy, kSlidingSteps, everywhere ? kEverywhereTrustRadius : kSlidingTrustRadius,
                                  positions, part.part(0, 0.7));
        summary.held_back_vertices += hold_back(surface.mesh.triangles, before, least_area, positions);
      }
    }
    // What comes after a slide starts anew: before it, heights need not be brought to rest.
    const double tolerance = last                     ? options.height_tolerance_mm / 2
                             : turn == 0 && may_crease ? kNearlyAtRest
                             : sliding > 0             ? kRoughTolerance
                                                       : options.height_tolerance_mm / 2;
    if (!everywhere) report = settling.settle(tolerance, positions, part.part(0.7, 1));
    put_on_floor(positions, lens.thickness_mm);
    summary.energy_history.push_back(report.final_energy);
    ++summary.outer_iterations;
    summary.final_height_change_mm = 0;
    for (std::size_t v = 0; v < count; ++v) {
      summary.final_height_change_mm =
          std::max(summary.final_height_change_mm, std::abs(positions[v].z() - before[v].z()));
    }
    const bool loop_to_come = picture != nullptr && options.picture_turns > 0 && !last;
    if (turn > 0 && sliding == 0 && !loop_to_come && summary.final_height_change_mm <= options.height_tolerance_mm) {
      summary.reason = "heights at rest";
      break;
    }
  }

  surface.mesh.normals = surface_normals(surface.mesh, rings, aim.creases);
  summary.inverted_triangles = count_inverted(surface.mesh);
  double highest = lens.thickness_mm;
  for (const Vec3& p : positions) highest = std::max(highest, p.z());
  summary.height_range_mm = highest - lens.thickness_mm;
  report_hollows(surface.mesh, integrator->edges(), rings, aim.light, options.min_concave_radius_mm, summary);
  summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  monitor.report("surface", 1.0);
  return surface;
}

}  // namespace

OpticalSurface solve_surface(const Lens& lens, const Light& light, const Receiver& receiver,
                             const TargetFunction& target, const SurfaceOptions& options, const Monitor& monitor) {
  return solve(lens, light, receiver, target, nullptr, options, monitor);
}

namespace {

OpticalSurface solve_by_map(const Lens& lens, const Light& light, const Receiver& receiver, const TransportMap& map,
                            const TargetLight* picture, const SurfaceOptions& options, const Monitor& monitor) {
  monitor.report("interpolating the transport map", 0.0);
  const TracedSource traced = trace_source(lens, light, receiver);
  const detail::MapInterpolation interpolation(map, traced.source);
  return solve(
      lens, light, receiver, [&](const std::vector<Vec2>& places) { return interpolation.at(places); }, picture, options,
      monitor.part(0.02, 1.0));
}

}  // namespace

OpticalSurface solve_surface(const Lens& lens, const Light& light, const Receiver& receiver, const TransportMap& map,
                             const SurfaceOptions& options, const Monitor& monitor) {
  return solve_by_map(lens, light, receiver, map, nullptr, options, monitor);
}

OpticalSurface solve_surface(const Lens& lens, const Light& light, const Receiver& receiver, const TransportMap& map,
                             const TargetLight& picture, const SurfaceOptions& options, const Monitor& monitor) {
  return solve_by_map(lens, light, receiver, map, &picture, options, monitor);
}

}  // namespace lightmill

#include "design/surface.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <utility>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/compound_energy.h"
#include "design/detail/fresnel.h"
#include "design/detail/height_field.h"
#include "design/detail/natural_neighbour.h"
#include "design/detail/one_ring.h"

namespace lightmill {

namespace {

using detail::CompoundEnergy;
using detail::Freedom;
using detail::HeightIntegrator;
using detail::OneRing;

constexpr int kFirstGuessTurns = 60;           // of Fresnel mapping and integration; each gains about a digit
constexpr double kFirstGuessTolerance = 1e-9;  // mm

/// How a turn minimises: the target normals move on between turns, so that none needs to be driven to its end.
struct Pace {
  int steps;
  double trust_radius;
};
/// Heights of the lens's own size are softer than those of single vertices by (mesh size)^2: any damping would hold
/// them.
constexpr Pace kHeightsOnly{3, 1e10};
/// A vertex that slides into a crease changes its normals by much: undamped steps overshoot and are refused.
constexpr Pace kSliding{5, 10};
/// The same with fewer steps when so many vertices slide that one costs what the whole stage should.
constexpr Pace kMuchSliding{3, 10};
constexpr double kMuch = 0.3;

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

double minmod(double a, double b) {
  if (a * b <= 0) return 0;
  return std::abs(a) < std::abs(b) ? a : b;
}

}  // namespace

SurfaceMesh start_mesh(const Lens& lens, int vertices_along_longer_side) {
  if (vertices_along_longer_side < 3) {
    throw InputError("surface.mesh is " + std::to_string(vertices_along_longer_side) + ", must be at least 3");
  }
  if (!(lens.size_mm.minCoeff() > 0)) throw InputError("lens.size_mm must be positive");
  SurfaceMesh mesh = lens.shape == Lens::Shape::kDisk ? disk_mesh(lens, vertices_along_longer_side)
                                                      : grid_mesh(lens, vertices_along_longer_side);
  mesh.normals.assign(mesh.vertices.size(), Vec3::UnitZ());
  return mesh;
}

std::vector<Vec2> interpolate_map(const TransportMap& map, const SourceLight& source,
                                  const std::vector<Vec2>& points_mm) {
  std::vector<Vec2> sites;
  std::vector<Vec2> targets;
  std::vector<double> cell_mm;  // side of a square with the cell's area
  const Vec2 half = source.size_mm / 2;
  const bool disk = source.shape == SourceLight::Shape::kDisk;
  const double area = disk ? kPi * half.x() * half.y() : 4 * half.x() * half.y();
  for (std::size_t i = 0; i < map.source_centroids_mm.size(); ++i) {
    if (!(map.source_masses[i] > 0)) continue;
    sites.push_back(map.source_centroids_mm[i]);
    targets.push_back(map.target_centroids_mm[i]);
    cell_mm.push_back(std::sqrt(area * map.source_masses[i]));
  }
  if (sites.size() < 3) throw InputError("surface: a transport map of fewer than three cells cannot be interpolated");

  // Centroids of border cells lie half a cell inside the border. Each is mirrored in the border, and its target is
  // carried on as it runs towards the border: by the smaller of two steps inside, so that a crease near the border is
  // not carried on.
  struct Mirror {
    int site;
    Vec2 outwards;  // from the centroid to its mirror image, along one side
  };
  std::vector<Mirror> mirrors;
  constexpr double kBorderCells = 0.9;  // the first row's centroids are half a cell from the border, the second's 1.5
  for (std::size_t s = 0; s < sites.size(); ++s) {
    const Vec2& p = sites[s];
    const double reach = kBorderCells * cell_mm[s];
    if (disk) {
      const Vec2 q = p.cwiseQuotient(half);  // on the unit disk
      const double r = q.norm();
      if (r > 0 && (1 - r) * half.minCoeff() < reach) {
        mirrors.push_back({static_cast<int>(s), (2 * (1 - r) / r * q).cwiseProduct(half)});
      }
    } else {
      for (int axis = 0; axis < 2; ++axis) {
        for (int side : {-1, 1}) {
          const double gap = half[axis] - side * p[axis];
          if (gap < reach) mirrors.push_back({static_cast<int>(s), Vec2::Unit(axis) * (2 * side * gap)});
        }
      }
    }
  }
  std::vector<Vec2> inner;
  for (const Mirror& m : mirrors) {
    inner.push_back(sites[m.site] - m.outwards);
    inner.push_back(sites[m.site] - 2 * m.outwards);
  }
  const std::vector<Vec2> inner_targets = detail::natural_neighbour_interpolation(sites, targets, inner);
  std::vector<Vec2> steps;
  for (std::size_t m = 0; m < mirrors.size(); ++m) {
    const Vec2 first = targets[mirrors[m].site] - inner_targets[2 * m];
    const Vec2 second = inner_targets[2 * m] - inner_targets[2 * m + 1];
    steps.emplace_back(minmod(first.x(), second.x()), minmod(first.y(), second.y()));
  }
  for (std::size_t m = 0; m < mirrors.size(); ++m) {
    sites.push_back(Vec2(sites[mirrors[m].site] + mirrors[m].outwards));
    targets.push_back(targets[mirrors[m].site] + steps[m]);
    // A cell in a corner is mirrored in both sides, and in the corner.
    if (m > 0 && mirrors[m - 1].site == mirrors[m].site && mirrors[m - 1].outwards.dot(mirrors[m].outwards) == 0) {
      sites.push_back(Vec2(sites[mirrors[m].site] + mirrors[m - 1].outwards + mirrors[m].outwards));
      targets.push_back(targets[mirrors[m].site] + steps[m - 1] + steps[m]);
    }
  }
  return detail::natural_neighbour_interpolation(sites, targets, points_mm);
}

namespace {

/// Which way a vertex may go: inside everywhere, on a straight side along it, at corners and on a round outline only
/// up.
std::vector<Freedom> freedoms(const Lens& lens, const std::vector<OneRing>& rings, const std::vector<Vec2>& entry) {
  std::vector<Freedom> result(rings.size(), Freedom::kAll);
  for (std::size_t v = 0; v < rings.size(); ++v) {
    if (rings[v].closed) continue;
    result[v] = Freedom::kHeight;
    if (lens.shape == Lens::Shape::kDisk) continue;
    const bool on_x_side = std::abs(entry[v].x()) == lens.size_mm.x() / 2;
    const bool on_y_side = std::abs(entry[v].y()) == lens.size_mm.y() / 2;
    if (on_x_side && !on_y_side) result[v] = Freedom::kHeightAndY;
    if (on_y_side && !on_x_side) result[v] = Freedom::kHeightAndX;
  }
  return result;
}

/// What the one-sided, angle-weighted normal of a border vertex shall be: the same mean of its triangles' wanted
/// normals. Inside, rings surround their vertex, and its own normal is wanted.
std::vector<Vec3> ring_targets(const std::vector<Vec3>& wanted, const std::vector<Vec3>& positions,
                               const std::vector<OneRing>& rings) {
  std::vector<Vec3> result = wanted;
  for (std::size_t v = 0; v < rings.size(); ++v) {
    const OneRing& ring = rings[v];
    if (ring.closed) continue;
    Vec3 sum = Vec3::Zero();
    for (int k = 0; k < ring.triangle_count(); ++k) {
      const int a = ring.neighbours[k];
      const int b = ring.neighbours[k + 1];
      const Vec3 u = positions[a] - positions[v];
      const Vec3 w = positions[b] - positions[v];
      sum += std::atan2(u.cross(w).norm(), u.dot(w)) * (wanted[v] + wanted[a] + wanted[b]).normalized();
    }
    if (sum.norm() > 0) result[v] = sum.normalized();
  }
  return result;
}

/// Lowers or lifts the surface so that its lowest vertex is at `floor_mm` (DESIGN.md, "Height gauge and d_TH").
void put_on_floor(std::vector<Vec3>& positions, double floor_mm) {
  double lowest = positions.front().z();
  for (const Vec3& p : positions) lowest = std::min(lowest, p.z());
  for (Vec3& p : positions) p.z() += floor_mm - lowest;
}

/// Vertices slide where it pays: where the heights alone leave a normal so wrong that sliding by kWorthwhile of an edge
/// would cost less, and kRings rings around. Elsewhere the light would gain nothing, and the equations are three times
/// larger.
std::vector<Freedom> near_creases(const CompoundEnergy& energy, const std::vector<Vec3>& positions,
                                  const std::vector<Freedom>& most_freedom) {
  constexpr double kWorthwhile = 0.1;
  constexpr int kRings = 2;
  const double least =
      std::sqrt(energy.weights.direction / energy.weights.integration) * kWorthwhile * energy.slope_scale;
  const std::vector<Vec3> normals = angle_weighted_normals(positions, energy.triangles);
  std::vector<char> near(positions.size(), 0);
  for (std::size_t v = 0; v < positions.size(); ++v) near[v] = (normals[v] - energy.target_normals[v]).norm() > least;
  for (int ring = 0; ring < kRings; ++ring) {
    const std::vector<char> core = near;
    for (std::size_t v = 0; v < positions.size(); ++v) {
      for (int n : energy.rings[v].neighbours) near[v] |= core[n];
    }
  }
  std::vector<Freedom> result(positions.size(), Freedom::kHeight);
  for (std::size_t v = 0; v < positions.size(); ++v) {
    if (near[v]) result[v] = most_freedom[v];
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

/// Normals to trace and mill by: angle-weighted inside; on the border, where that is one-sided, the normal of the
/// parabola that fits the vertices around best.
std::vector<Vec3> surface_normals(const SurfaceMesh& mesh, const std::vector<OneRing>& rings) {
  std::vector<Vec3> normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  for (std::size_t v = 0; v < rings.size(); ++v) {
    if (rings[v].closed) continue;
    std::vector<int> around = rings[v].neighbours;
    for (int n : rings[v].neighbours)
      around.insert(around.end(), rings[n].neighbours.begin(), rings[n].neighbours.end());
    std::sort(around.begin(), around.end());
    around.erase(std::unique(around.begin(), around.end()), around.end());
    std::erase(around, static_cast<int>(v));
    Eigen::MatrixXd terms(around.size(), 5);
    Eigen::VectorXd rises(around.size());
    for (std::size_t k = 0; k < around.size(); ++k) {
      const Vec3 d = mesh.vertices[around[k]] - mesh.vertices[v];
      const double weight = 1 / (d.head<2>().squaredNorm() + 1e-12);
      terms.row(k) << d.x(), d.y(), d.x() * d.x(), d.x() * d.y(), d.y() * d.y();
      terms.row(k) *= weight;
      rises[k] = weight * d.z();
    }
    if (around.size() < 5) continue;
    const Eigen::VectorXd fit = terms.colPivHouseholderQr().solve(rises);
    if (fit.allFinite()) normals[v] = Vec3(-fit[0], -fit[1], 1).normalized();
  }
  return normals;
}

/// 99.9th percentile of the concave curvature along the edges off the border, as a radius; infinite for a convex
/// surface.
double concave_radius(const SurfaceMesh& mesh, const std::vector<std::array<int, 2>>& edges,
                      const std::vector<OneRing>& rings) {
  std::vector<double> curvatures;
  for (const auto& [i, j] : edges) {
    if (!rings[i].closed || !rings[j].closed) continue;
    const Vec3 along = mesh.vertices[j] - mesh.vertices[i];
    curvatures.push_back(-(mesh.normals[j] - mesh.normals[i]).dot(along) / along.squaredNorm());
  }
  if (curvatures.empty()) return std::numeric_limits<double>::infinity();
  const std::size_t rank = std::min(curvatures.size() - 1, static_cast<std::size_t>(0.999 * curvatures.size()));
  std::nth_element(curvatures.begin(), curvatures.begin() + rank, curvatures.end());
  return curvatures[rank] > 0 ? 1 / curvatures[rank] : std::numeric_limits<double>::infinity();
}

}  // namespace

OpticalSurface solve_surface(const Lens& lens, const Receiver& receiver, const TransportMap& map,
                             const SurfaceOptions& options, const Monitor& monitor) {
  SourceLight source;
  source.shape = lens.shape == Lens::Shape::kDisk ? SourceLight::Shape::kDisk : SourceLight::Shape::kRectangle;
  source.size_mm = lens.size_mm;
  monitor.report("interpolating the transport map", 0.0);
  std::vector<Vec2> points;
  for (const Vec3& p : start_mesh(lens, options.mesh).vertices) points.emplace_back(p.head<2>());
  return solve_surface(lens, receiver, interpolate_map(map, source, points), options, monitor.part(0.02, 1.0));
}

OpticalSurface solve_surface(const Lens& lens, const Receiver& receiver, const std::vector<Vec2>& targets_mm,
                             const SurfaceOptions& options, const Monitor& monitor) {
  const auto started = std::chrono::steady_clock::now();
  if (!(lens.refractive_index > 1)) throw InputError("lens.refractive_index must be above 1");
  if (!(receiver.distance_mm > 0)) throw InputError("receiver.distance_mm must be positive");
  if (options.outer_iterations < 0) throw InputError("surface.outer_iterations must not be negative");
  const SurfaceWeights& w = options.weights;
  for (const auto& [name, value] :
       {std::pair{"integration", w.integration}, std::pair{"barrier", w.barrier}, std::pair{"direction", w.direction},
        std::pair{"flux", w.flux}, std::pair{"smoothness", w.smoothness}}) {
    if (!(value >= 0)) throw InputError(std::string("surface.weights.") + name + " must not be negative");
  }
  if (!(w.integration > 0))
    throw InputError("surface.weights.integration must be positive: nothing else shapes the surface");
  OpticalSurface surface;
  surface.mesh = start_mesh(lens, options.mesh);
  std::vector<Vec3>& positions = surface.mesh.vertices;
  const std::size_t count = positions.size();
  if (targets_mm.size() != count) {
    throw InputError("surface: " + std::to_string(targets_mm.size()) + " target points for " + std::to_string(count) +
                     " vertices");
  }
  surface.targets_mm = targets_mm;
  for (const Vec3& p : positions) surface.entry_mm.emplace_back(p.head<2>());
  SurfaceSummary& summary = surface.summary;
  summary.vertices = static_cast<int>(count);

  // First guess: heights only, Fresnel mapping and integration in turn until nothing moves.
  monitor.report("first guess of the heights", 0.0);
  const HeightIntegrator integrator(static_cast<int>(count), surface.mesh.triangles);
  for (int turn = 0; turn < kFirstGuessTurns; ++turn) {
    monitor.check();
    const auto slopes = detail::slopes_of(detail::fresnel_normals(positions, targets_mm, lens, receiver));
    const std::vector<double> heights = integrator.integrate(surface.entry_mm, slopes);
    double change = 0;
    for (std::size_t v = 0; v < count; ++v) {
      const double z = lens.thickness_mm + heights[v];
      change = std::max(change, std::abs(z - positions[v].z()));
      positions[v].z() = z;
    }
    if (change < kFirstGuessTolerance) break;
  }

  // The paper's energy in all three coordinates, and Fresnel mapping again, in turn.
  const std::vector<OneRing> rings = detail::one_rings(static_cast<int>(count), surface.mesh.triangles);
  const std::vector<Freedom> most_freedom = freedoms(lens, rings, surface.entry_mm);
  std::vector<Freedom> freedom(count, Freedom::kHeight);
  double edge_sum = 0;
  for (const auto& [i, j] : integrator.edges()) edge_sum += (surface.entry_mm[j] - surface.entry_mm[i]).norm();
  CompoundEnergy energy{surface.mesh.triangles, rings, surface.entry_mm, freedom, {}, {}, options.weights};
  energy.edge_mm = edge_sum / static_cast<double>(integrator.edges().size());
  energy.slope_scale = lens.size_mm.maxCoeff() / ((lens.refractive_index - 1) * receiver.distance_mm);
  energy.floor_mm = lens.thickness_mm;
  double lens_area = 0;
  for (const auto& t : surface.mesh.triangles) lens_area += signed_area(positions, t);
  constexpr double kThinnest = 1e-3;  // of the mean triangle's area: thinner ones have no normal worth its name
  const double least_area = kThinnest * lens_area / static_cast<double>(surface.mesh.triangles.size());

  summary.reason = "outer iterations used up";
  for (int turn = 0; turn < options.outer_iterations; ++turn) {
    const Monitor part =
        monitor.part(0.1 + 0.9 * turn / options.outer_iterations, 0.1 + 0.9 * (turn + 1) / options.outer_iterations);
    const std::vector<Vec3> wanted = detail::fresnel_normals(positions, targets_mm, lens, receiver);
    energy.target_normals = ring_targets(wanted, positions, rings);
    energy.target_slopes = detail::slopes_of(wanted);
    // The first turn brings the heights to rest. What is wrong then, only sliding can mend; it is damped, so that the
    // last turn brings the heights to rest again.
    const bool may_slide = turn > 0 && turn + 1 < options.outer_iterations;
    freedom.assign(count, Freedom::kHeight);
    if (may_slide) freedom = near_creases(energy, positions, most_freedom);
    const auto sliding = static_cast<double>(count - std::count(freedom.begin(), freedom.end(), Freedom::kHeight));
    const Pace pace = sliding == 0                                   ? kHeightsOnly
                      : sliding < kMuch * static_cast<double>(count) ? kSliding
                                                                     : kMuchSliding;
    const std::vector<Vec3> before = positions;
    const detail::MinimiserReport report = detail::minimise(energy, pace.steps, pace.trust_radius, positions, part);
    hold_back(surface.mesh.triangles, before, least_area, positions);
    put_on_floor(positions, lens.thickness_mm);
    summary.energy_history.push_back(report.final_energy);
    ++summary.outer_iterations;
    summary.final_height_change_mm = 0;
    for (std::size_t v = 0; v < count; ++v) {
      summary.final_height_change_mm =
          std::max(summary.final_height_change_mm, std::abs(positions[v].z() - before[v].z()));
    }
    if (turn > 0 && sliding == 0 && summary.final_height_change_mm <= options.height_tolerance_mm) {
      summary.reason = "heights at rest";
      break;
    }
  }

  surface.mesh.normals = surface_normals(surface.mesh, rings);
  summary.inverted_triangles = count_inverted(surface.mesh);
  double highest = lens.thickness_mm;
  for (const Vec3& p : positions) highest = std::max(highest, p.z());
  summary.height_range_mm = highest - lens.thickness_mm;
  summary.min_concave_radius_mm = concave_radius(surface.mesh, integrator.edges(), rings);
  summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  monitor.report("surface", 1.0);
  return surface;
}

}  // namespace lightmill

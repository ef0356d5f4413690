#include "design/detail/mesh_sampling.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/detail/equal_masses.h"
#include "design/detail/power_diagram.h"

namespace lightmill::detail {

namespace {

constexpr int kCoarsest = 512;           // sites of the coarsest sampling, at most
constexpr double kRest = 0.008;          // mean way from site to centroid, in cell sizes, at which the iteration rests
constexpr int kMostCoarse = 60;          // iterations on the coarsest level, and
constexpr int kMostFine = 16;            // on the others, which start near
constexpr double kOverRelaxation = 1.5;  // of Lloyd's step; below 2 the energy still falls
constexpr int kSharings = 3;             // turns of moving samples between parts of the source
constexpr double kEqual = 0.005;         // spread of the samples' flux that is equal enough

double cross(const Vec2& a, const Vec2& b) {
  return a.x() * b.y() - a.y() * b.x();
}

/// Integrals over one cell, or over its part in one triangle.
struct Integrals {
  double area = 0;
  double mass = 0;
  Vec2 moment{0, 0};
  double squared = 0;  // of the irradiance squared
  Vec2 squared_moment{0, 0};
  void operator+=(const Integrals& o) {
    area += o.area;
    mass += o.mass;
    moment += o.moment;
    squared += o.squared;
    squared_moment += o.squared_moment;
  }
};

/// A corner of a clipped triangle; `edge` is the border that leads on from it, or -1 for a side of the triangle.
struct Corner {
  Vec2 place;
  double rho;
  int edge;
};

/// Closed forms for products of linear functions on triangles.
Integrals integrate(const std::vector<Corner>& polygon) {
  Integrals sum;
  for (std::size_t k = 1; k + 1 < polygon.size(); ++k) {
    const Corner &a = polygon[0], &b = polygon[k], &c = polygon[k + 1];
    const double area = cross(b.place - a.place, c.place - a.place) / 2;
    const double r = a.rho, s = b.rho, t = c.rho;
    const double all = r + s + t;
    sum.area += area;
    sum.mass += area * all / 3;
    sum.moment += area / 12 * ((all + r) * a.place + (all + s) * b.place + (all + t) * c.place);
    sum.squared += area / 12 * (all * all + r * r + s * s + t * t);
    const auto weight = [](double x, double y, double z) {
      return 3 * x * x + 2 * x * (y + z) + y * y + z * z + y * z;
    };
    sum.squared_moment +=
        area / 30 * (weight(r, s, t) * a.place + weight(s, r, t) * b.place + weight(t, r, s) * c.place);
  }
  return sum;
}

struct Cells {
  std::vector<Integrals> of_site;
  std::vector<double> edge_flux;  // integral of the irradiance along each border
};

/// All integrals over the cells {x : x.s_i - psi_i is largest}. `at` remembers a site near each triangle.
Cells integrate_cells(const SourceMesh& mesh, const PowerDiagram& diagram, const std::vector<Vec2>& sites,
                      const std::vector<double>& psi, std::vector<int>& at) {
  const int n = static_cast<int>(sites.size());
  const auto incident = [&](int i) { return std::pair(diagram.first_edge[i], diagram.first_edge[i + 1]); };
  const auto other = [&](int e, int i) { return diagram.edges[e].a == i ? diagram.edges[e].b : diagram.edges[e].a; };
  struct Part {
    int site;
    Integrals integrals;
  };
  struct Along {
    int edge;
    double flux;
  };
  constexpr std::size_t kBlock = 512;
  const std::size_t blocks = (mesh.triangles.size() + kBlock - 1) / kBlock;
  std::vector<std::vector<Part>> parts(blocks);
  std::vector<std::vector<Along>> along(blocks);
  parallel_blocks(mesh.triangles.size(), kBlock, [&](std::size_t begin, std::size_t end) {
    auto& my_parts = parts[begin / kBlock];
    auto& my_along = along[begin / kBlock];
    std::vector<int> stamp(n, -1);
    std::vector<int> front;
    std::vector<Corner> polygon, clipped;
    std::vector<double> beyond;
    for (std::size_t k = begin; k < end; ++k) {
      const auto& t = mesh.triangles[k];
      const Vec2 middle = (mesh.vertices_mm[t[0]] + mesh.vertices_mm[t[1]] + mesh.vertices_mm[t[2]]) / 3;
      // Uphill over neighbours to the site whose cell holds the middle.
      int nearest = at[k];
      while (incident(nearest).first == incident(nearest).second) nearest = (nearest + 1) % n;
      for (double best = middle.dot(sites[nearest]) - psi[nearest];;) {
        const int from = nearest;
        const auto [first, last] = incident(from);
        for (std::size_t e = first; e < last; ++e) {
          const int b = other(diagram.incident_edges[e], from);
          if (b >= n) continue;
          const double value = middle.dot(sites[b]) - psi[b];
          if (value > best) {
            best = value;
            nearest = b;
          }
        }
        if (nearest == from) break;
      }
      at[k] = nearest;

      // From cell to cell across the borders that cut the triangle.
      front.assign(1, nearest);
      stamp[nearest] = static_cast<int>(k);
      while (!front.empty()) {
        const int i = front.back();
        front.pop_back();
        polygon.clear();
        for (const int v : t) polygon.push_back({mesh.vertices_mm[v], mesh.irradiance_per_mm2[v], -1});
        const auto [first, last] = incident(i);
        for (std::size_t e = first; e < last && !polygon.empty(); ++e) {
          const int edge = diagram.incident_edges[e];
          const int b = other(edge, i);
          if (b >= n) continue;
          const Vec2 toward = sites[b] - sites[i];
          const double border = psi[b] - psi[i];
          beyond.resize(polygon.size());
          bool cut = false;
          for (std::size_t c = 0; c < polygon.size(); ++c) {
            beyond[c] = toward.dot(polygon[c].place) - border;
            cut |= beyond[c] > 0;
          }
          if (!cut) continue;
          clipped.clear();
          for (std::size_t c = 0; c < polygon.size(); ++c) {
            const std::size_t d = c + 1 < polygon.size() ? c + 1 : 0;
            if (beyond[c] <= 0) clipped.push_back(polygon[c]);
            if ((beyond[c] <= 0) == (beyond[d] <= 0)) continue;
            const double share = beyond[c] / (beyond[c] - beyond[d]);
            const Corner crossing{polygon[c].place + share * (polygon[d].place - polygon[c].place),
                                  polygon[c].rho + share * (polygon[d].rho - polygon[c].rho),
                                  beyond[c] <= 0 ? edge : polygon[c].edge};
            clipped.push_back(crossing);
          }
          polygon.swap(clipped);
        }
        if (polygon.size() < 3) continue;
        my_parts.push_back({i, integrate(polygon)});
        for (std::size_t c = 0; c < polygon.size(); ++c) {
          const int edge = polygon[c].edge;
          if (edge < 0) continue;
          const Corner& next = polygon[c + 1 < polygon.size() ? c + 1 : 0];
          const int b = other(edge, i);
          // Each border is seen from both its cells.
          my_along.push_back({edge, (next.place - polygon[c].place).norm() * (polygon[c].rho + next.rho) / 4});
          if (stamp[b] == static_cast<int>(k)) continue;
          stamp[b] = static_cast<int>(k);
          front.push_back(b);
        }
      }
    }
  });
  Cells cells;
  cells.of_site.resize(n);
  cells.edge_flux.assign(diagram.edges.size(), 0.0);
  for (std::size_t block = 0; block < blocks; ++block) {
    for (const auto& part : parts[block]) cells.of_site[part.site] += part.integrals;
    for (const auto& a : along[block]) cells.edge_flux[a.edge] += a.flux;
  }
  return cells;
}

/// Random places with the irradiance as probability, one from each of `count` equal shares of the flux in the mesh's
/// order.
std::vector<Vec2> scattered(const SourceMesh& mesh, int count, std::mt19937_64& random) {
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  std::vector<Vec2> places;
  double done = 0;
  const double total = mesh.flux();
  double next = uniform() * total / count;
  for (const auto& t : mesh.triangles) {
    const Vec2 &a = mesh.vertices_mm[t[0]], &b = mesh.vertices_mm[t[1]], &c = mesh.vertices_mm[t[2]];
    const double r[3] = {mesh.irradiance_per_mm2[t[0]], mesh.irradiance_per_mm2[t[1]], mesh.irradiance_per_mm2[t[2]]};
    done += cross(b - a, c - a) / 6 * (r[0] + r[1] + r[2]);
    while (static_cast<int>(places.size()) < count && next < done) {
      for (;;) {
        double u = uniform(), v = uniform();
        if (u + v > 1) {
          u = 1 - u;
          v = 1 - v;
        }
        if (uniform() * std::max({r[0], r[1], r[2]}) > (1 - u - v) * r[0] + u * r[1] + v * r[2]) continue;
        places.emplace_back(a + u * (b - a) + v * (c - a));
        break;
      }
      next = (static_cast<double>(places.size()) + uniform()) * total / count;
    }
  }
  return places;
}

struct Relaxed {
  std::vector<Vec2> sites;
  PowerDiagram diagram;
  Cells cells;
  double way = 0;  // mean, in cell sizes
  int iterations = 0;

  /// Between sites: flux along their border / their distance.
  [[nodiscard]] std::vector<GraphEdge> edges() const {
    const int n = static_cast<int>(sites.size());
    std::vector<GraphEdge> result;
    for (std::size_t e = 0; e < diagram.edges.size(); ++e) {
      const auto& edge = diagram.edges[e];
      if (edge.a < n && edge.b < n) result.push_back({edge.a, edge.b, cells.edge_flux[e] / diagram.site_distance[e]});
    }
    return result;
  }
};

Relaxed relax(const SourceMesh& mesh, std::vector<Vec2> sites, double reach, int most, std::vector<int>& at,
              const Monitor& monitor) {
  Relaxed r;
  const std::size_t n = sites.size();
  for (;; ++r.iterations) {
    monitor.check();
    std::vector<double> psi(n);
    for (std::size_t i = 0; i < n; ++i) psi[i] = sites[i].squaredNorm() / 2;
    r.diagram = PowerDiagramBuilder(sites, reach).build(psi);
    r.cells = integrate_cells(mesh, r.diagram, sites, psi, at);
    r.way = 0;
    int dark = 0;
    std::vector<Vec2> moved = sites;
    for (std::size_t i = 0; i < n; ++i) {
      const Integrals& cell = r.cells.of_site[i];
      if (!(cell.squared > 0 && cell.mass > 0)) {
        ++dark;
        continue;
      }
      const Vec2 step = cell.squared_moment / cell.squared - sites[i];
      r.way += step.norm() / std::sqrt(cell.area) / static_cast<double>(n);
      moved[i] += kOverRelaxation * step;
    }
    if (dark > 0) {
      // Sites without light help out where most of it is.
      std::vector<int> rich(n);
      for (std::size_t i = 0; i < n; ++i) rich[i] = static_cast<int>(i);
      std::partial_sort(rich.begin(), rich.begin() + dark, rich.end(), [&](int a, int b) {
        const double p = r.cells.of_site[a].mass, q = r.cells.of_site[b].mass;
        return p > q || (p == q && a < b);
      });
      int k = 0;
      for (std::size_t i = 0; i < n; ++i) {
        if (r.cells.of_site[i].squared > 0 && r.cells.of_site[i].mass > 0) continue;
        const Integrals& giver = r.cells.of_site[rich[k]];
        if (giver.mass > 0)
          moved[i] = giver.squared_moment / giver.squared +
                     0.2 * std::sqrt(giver.area) * Vec2(std::cos(2.4 * k), std::sin(2.4 * k));
        ++k;
      }
    }
    if (dark == 0 && (r.way < kRest || r.iterations >= most)) break;
    if (r.iterations >= 4 * most)
      throw NumericalError("sampling the source: " + std::to_string(dark) +
                           " samples find no light; use fewer samples");
    sites = std::move(moved);
  }
  r.sites = std::move(sites);
  return r;
}

/// Lloyd's iteration keeps the samples of a part of the source that is far from the others; random starts give parts
/// more or less than their share. Moves whole samples from part to part; false when the shares are right to one.
bool share_out(Relaxed& relaxed) {
  const std::size_t n = relaxed.sites.size();
  std::vector<GraphEdge> lit;
  for (const auto& edge : relaxed.edges()) {
    if (edge.weight > 0) lit.push_back(edge);
  }
  const std::vector<int> part = connected_components(static_cast<int>(n), lit);
  double total = 0;
  std::vector<double> mass(n, 0.0);
  std::vector<int> lack(n, 0);  // of samples
  for (std::size_t i = 0; i < n; ++i) {
    total += relaxed.cells.of_site[i].mass;
    mass[part[i]] += relaxed.cells.of_site[i].mass;
    --lack[part[i]];
  }
  std::vector<int> rich, poor;
  for (std::size_t p = 0; p < n; ++p) {
    if (mass[p] > 0) lack[p] += std::max(1, static_cast<int>(std::lround(mass[p] / total * static_cast<double>(n))));
  }
  std::vector<int> order(n);
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return relaxed.cells.of_site[a].mass < relaxed.cells.of_site[b].mass; });
  for (std::size_t k = 0; k < n; ++k) {
    const int lightest = order[k];
    if (lack[part[lightest]] < 0) {
      rich.push_back(lightest);
      ++lack[part[lightest]];
    }
    const int heaviest = order[n - 1 - k];
    if (lack[part[heaviest]] > 0) {
      poor.push_back(heaviest);
      --lack[part[heaviest]];
    }
  }
  const std::size_t moves = std::min(rich.size(), poor.size());
  for (std::size_t k = 0; k < moves; ++k) {
    const Integrals& giver = relaxed.cells.of_site[poor[k]];
    relaxed.sites[rich[k]] = giver.squared_moment / giver.squared +
                             0.2 * std::sqrt(giver.area) *
                                 Vec2(std::cos(2.4 * static_cast<double>(k)), std::sin(2.4 * static_cast<double>(k)));
  }
  return moves > 0;
}

/// Moves the borders of the cells, not their sites, until each carries the same flux.
void equalise(const SourceMesh& mesh, Relaxed& relaxed, double reach, std::vector<int>& at, const Monitor& monitor) {
  const int n = static_cast<int>(relaxed.sites.size());
  PowerDiagramBuilder builder(relaxed.sites, reach);
  std::vector<double> last;
  const auto summary = [&] {
    SourceCells cells{last, {}, relaxed.edges()};
    for (const auto& cell : relaxed.cells.of_site) cells.masses.push_back(cell.mass);
    return cells;
  };
  const auto measure = [&](std::vector<double> psi) {
    monitor.check();
    relaxed.diagram = builder.build(psi);
    relaxed.cells = integrate_cells(mesh, relaxed.diagram, relaxed.sites, psi, at);
    last = std::move(psi);
    return summary();
  };
  for (int i = 0; i < n; ++i) last.push_back(relaxed.sites[i].squaredNorm() / 2);
  const SourceCells equal = with_equal_masses(relaxed.sites, summary(), kEqual, measure);
  if (equal.psi != last) (void)measure(equal.psi);
}

}  // namespace

std::vector<Sampling> sample_mesh(const SourceMesh& whole, int samples, std::uint64_t seed, const Monitor& monitor) {
  // About the centre of the light.
  SourceMesh mesh = whole;
  const double total = mesh.flux();
  if (!(total > 0)) throw InputError("transport: the source mesh carries no light");
  for (double& rho : mesh.irradiance_per_mm2) {
    if (!(rho >= 0)) throw InputError("transport: the source's irradiance must be 0 or above");
    rho /= total;
  }
  Vec2 mean(0, 0);
  Vec2 second(0, 0);
  for (int turn = 0; turn < 2; ++turn) {
    Vec2 sum(0, 0);
    for (const auto& t : mesh.triangles) {
      const Vec2 &a = mesh.vertices_mm[t[0]], &b = mesh.vertices_mm[t[1]], &c = mesh.vertices_mm[t[2]];
      const double area = cross(b - a, c - a) / 2;
      const double mass =
          area / 3 * (mesh.irradiance_per_mm2[t[0]] + mesh.irradiance_per_mm2[t[1]] + mesh.irradiance_per_mm2[t[2]]);
      if (turn == 0) {
        std::vector<Corner> corners;
        for (const int v : t) corners.push_back({mesh.vertices_mm[v], mesh.irradiance_per_mm2[v], -1});
        sum += integrate(corners).moment;
      } else {
        // Of the mean irradiance on each triangle: the spread only scales the start.
        sum += mass * (a.cwiseAbs2() + b.cwiseAbs2() + c.cwiseAbs2() + (a + b + c).cwiseAbs2()) / 12;
      }
    }
    if (turn == 0) {
      mean = sum;
      for (Vec2& p : mesh.vertices_mm) p -= mean;
    } else {
      second = sum;
    }
  }
  double reach = 0;
  for (const Vec2& p : mesh.vertices_mm) reach = std::max(reach, p.norm());

  int coarsest = samples;
  int levels = 1;
  for (; coarsest > kCoarsest; ++levels) coarsest = (coarsest + 3) / 4;
  std::mt19937_64 random(seed);
  std::vector<Vec2> sites = scattered(mesh, coarsest, random);
  if (static_cast<int>(sites.size()) < coarsest) throw NumericalError("sampling the source: its flux does not add up");
  std::vector<int> at(mesh.triangles.size(), 0);
  std::vector<Sampling> result;
  for (int level = levels - 1; level >= 0; --level) {
    const bool first = level == levels - 1;
    Relaxed relaxed = relax(mesh, std::move(sites), reach, first ? kMostCoarse : kMostFine, at, monitor);
    for (int turn = 0; first && turn < kSharings && share_out(relaxed); ++turn)
      relaxed = relax(mesh, std::move(relaxed.sites), reach, kMostCoarse, at, monitor);
    equalise(mesh, relaxed, reach, at, monitor);
    const std::size_t n = relaxed.sites.size();
    Sampling sampling;
    sampling.centre = mean;
    sampling.spread = second.cwiseSqrt();
    sampling.iterations = relaxed.iterations;
    sampling.way = relaxed.way;
    double mass = 0;
    for (const auto& cell : relaxed.cells.of_site) mass += cell.mass;
    for (const auto& cell : relaxed.cells.of_site) {
      sampling.masses.push_back(cell.mass / mass);
      sampling.centroids.emplace_back(cell.moment / cell.mass);
    }
    sampling.flux_spread = flux_spread_of(sampling.masses);
    sampling.edges = bridged(relaxed.edges());

    if (level > 0) {
      // Four for one, on a square turned at random.
      sites.clear();
      for (std::size_t i = 0; i < n; ++i) {
        const Integrals& cell = relaxed.cells.of_site[i];
        const double angle = 2 * kPi * static_cast<double>(random() >> 11) * 0x1p-53;
        const Vec2 arm = 0.35 * std::sqrt(cell.area) * Vec2(std::cos(angle), std::sin(angle));
        const Vec2 centre = cell.squared_moment / cell.squared;
        for (const Vec2& offset : {arm, Vec2(-arm.y(), arm.x()), Vec2(-arm), Vec2(arm.y(), -arm.x())})
          sites.emplace_back(centre + offset);
      }
      for (int& site : at) site *= 4;
    }
    sampling.sites = std::move(relaxed.sites);
    result.insert(result.begin(), std::move(sampling));
  }
  return result;
}

}  // namespace lightmill::detail

#include "design/transport.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <deque>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "design/detail/laplacian.h"
#include "design/detail/one_blas_thread.h"
#include "design/detail/power_diagram.h"
#include "design/detail/sampled_transport.h"
#include "design/detail/sampling.h"
#include "design/detail/target_measure.h"

namespace lightmill {

namespace {

using detail::CellIntegrals;
using detail::GraphEdge;
using detail::Laplacian;
using detail::PowerDiagram;
using detail::PowerDiagramBuilder;
using detail::Sampling;
using detail::TargetMeasure;
using Potential = std::vector<double>;

constexpr double kEmpty = 1e-9;  // a cell with less than this share of its mass is empty
constexpr double kArmijo = 1e-4;
constexpr int kMemory = 12;           // pairs that L-BFGS remembers
constexpr double kNewtonFrom = 0.03;  // l1 error below which Newton takes over, once no cell is empty
constexpr double kLeastStep = 0.03;   // of damped Newton; then the way of its step is searched
constexpr double kJoin = 1e-10;
constexpr int kSliding = 60;          // evaluations to find where cells change along a direction, and
constexpr double kSlid = 0.1;         // the share of a cell's mass that has to move there
constexpr double kNarrowing = 0.3;        // factor on the radius of strips and disks from stage to stage
constexpr double kNarrowingError = 0.15;  // l1 error after the prediction that the descent repairs quickly
constexpr double kLeastNarrowing = 0.95;  // smaller steps than this are left to the descent
// Half width of strips and disks at the start of every level, in distances between sites: beside area light they shall
// not blur it, alone they may be as wide as eases the start.
constexpr double kStartRadius = 0.3;
constexpr double kStartRadiusAlone = 3;
constexpr double kCoarseTolerance = 3e-2;  // of the worst cell on all levels but the finest

double dot(const Potential& a, const Potential& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

class Stopwatch {
 public:
  /// Seconds since the last call, or since the start.
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(last_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

Potential plus(const Potential& a, double t, const Potential& d) {
  Potential result(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) result[i] = a[i] + t * d[i];
  return result;
}

/// The dual at a potential. In psi = (|s|^2 - w) / 2 the convex function of [paper eq. 3] is, up to a constant and a
/// factor, sum_i nu_i psi_i + int max_i (x.s_i - psi_i) dmu(x), with the gradient nu_i - mu(C_i).
struct Evaluation {
  Potential psi;
  PowerDiagram diagram;
  CellIntegrals cells;
  Potential gradient;
  double value = 0;
  double l1_error = 0;
  double max_error = 0;
  double min_share = 0;  // smallest mu(C_i) / nu_i
  int empty = 0;

  [[nodiscard]] std::string words() const {
    return "mass error l1 " + fixed(l1_error, 6) + ", worst cell " + fixed(max_error, 4) + ", empty cells " +
           std::to_string(empty);
  }
};

/// One level of the multi-scale solver.
class Level {
 public:
  Level(const Sampling& sampling, TargetMeasure measure, double reach, const TransportOptions& options)
      : sampling_(sampling),
        measure_(std::move(measure)),
        options_(options),
        builder_(sampling.sites, reach) {}

  /// Improves psi until the errors are below `l1` and `most` and no cell is empty; returns the best it found otherwise.
  Evaluation solve(Potential psi, double l1, double most, const Monitor& monitor) {
    return solve_from(evaluate(std::move(psi)), l1, most, monitor);
  }
  Evaluation solve_from(Evaluation now, double l1, double most, const Monitor& monitor) {
    const bool reference = options_.solver == TransportSolver::kLbfgs;
    constexpr int kSlower = 20;  // evaluations of plain L-BFGS for one
    budget_ = evaluations_ + options_.max_iterations * (reference ? kSlower : 1);
    const auto done = [&] { return now.empty == 0 && now.l1_error <= l1 && now.max_error <= most; };
    double newton_from = reference ? 0 : kNewtonFrom;
    while (!done() && evaluations_ < budget_) {
      // The descent's first steps, without memory, only spoil what prediction or prolongation brought near.
      const bool near = now.empty == 0 && now.l1_error < newton_from;
      if (!near) descend(now, newton_from, done, monitor);
      if (done()) break;
      if (reference) return now;
      if (!newton(now, done, monitor)) newton_from = std::min(newton_from, now.l1_error) / 2;
    }
    return now;
  }

  /// Follows the solution `now` while strips and disks become narrower, down to `radius`. The potential is nearly
  /// linear in their radius: a Newton step that includes the tangent d psi / dr = H^-1 d mu / dr leads from one radius
  /// to the next.
  Evaluation narrow(Evaluation now, double radius, double l1, double most, const Monitor& monitor) {
    double factor = kNarrowing;
    const double widest = measure_.radius;
    const auto done = [&](double r) { return std::log(widest / r) / std::log(widest / radius); };
    while (measure_.radius > radius && now.empty == 0) {
      const double from = measure_.radius;
      const auto [corrected, tangent] = predict(now);
      Evaluation next;
      for (;; factor = std::sqrt(factor)) {
        measure_.radius = std::max(radius, from * factor);
        next = evaluate(plus(corrected, measure_.radius - from, tangent));
        if ((next.empty == 0 && next.l1_error < kNarrowingError) || factor > kLeastNarrowing) break;
      }
      if (!(next.l1_error < kNarrowingError)) next = better(std::move(next), now.psi);
      const bool last = measure_.radius == radius;
      now = solve_from(std::move(next), last ? l1 : kCoarseTolerance, last ? most : kCoarseTolerance,
                       monitor.part(done(from), done(measure_.radius)));
      factor = std::max(kNarrowing, factor * factor);
    }
    return now;
  }
  /// The potential that `now` leads to at another radius, to first order; strips and disks have that radius from then
  /// on.
  Potential extrapolated(const Evaluation& now, double radius) {
    if (now.empty > 0) return now.psi;
    const auto [corrected, tangent] = predict(now);
    const Potential predicted = plus(corrected, radius - measure_.radius, tangent);
    measure_.radius = radius;
    return better(evaluate(predicted), now.psi).psi;
  }
  [[nodiscard]] int evaluations() const { return evaluations_; }
  [[nodiscard]] const TransportPhases& phases() const { return phases_; }

 private:
  /// The prediction, or the potential that it came from if that is better: where no cell bridges two parts of the
  /// target, the second derivative is all but singular and a step along it may lead anywhere.
  Evaluation better(Evaluation predicted, const Potential& unmoved) {
    Evaluation still = evaluate(unmoved);
    return predicted.l1_error <= still.l1_error ? std::move(predicted) : std::move(still);
  }

  Evaluation evaluate(Potential psi) {
    ++evaluations_;
    Evaluation e;
    Stopwatch watch;
    e.diagram = builder_.build(psi);
    phases_.diagrams += watch.lap();
    e.cells = integrate_cells(measure_, e.diagram, sampling_.sites, psi, starts_);
    phases_.integrals += watch.lap();
    const std::size_t n = psi.size();
    e.gradient.resize(n);
    e.min_share = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < n; ++i) {
      const double mass = e.cells.masses[i];
      const double nu = sampling_.masses[i];
      e.gradient[i] = nu - mass;
      e.value += nu * psi[i] + sampling_.sites[i].dot(e.cells.moments[i]) - psi[i] * mass;
      e.l1_error += std::abs(nu - mass);
      e.max_error = std::max(e.max_error, std::abs(nu - mass) / nu);
      e.min_share = std::min(e.min_share, mass / nu);
      e.empty += mass < kEmpty * nu;
    }
    e.psi = std::move(psi);
    return e;
  }

  /// A gradient as a step: by the source's Laplacian, or as it is [paper sec. 4].
  Potential in_metric(Potential gradient) {
    if (options_.solver == TransportSolver::kLbfgs) return gradient;
    Stopwatch watch;
    if (!metric_) metric_.emplace(sampling_.sites, sampling_.edges);
    gradient = metric_->solve(gradient);
    phases_.equations += watch.lap();
    return gradient;
  }

  /// L-BFGS with the source's Laplacian as metric and Armijo's rule: works with empty cells, and fills them.
  template <typename Done>
  void descend(Evaluation& now, double newton_from, const Done& done, const Monitor& monitor) {
    struct Pair {
      Potential step, change;
      double curvature;
    };
    std::deque<Pair> memory;
    int filled = 0;  // iterations in a row without an empty cell
    double gamma = 1;
    while (evaluations_ < budget_) {
      monitor.report("transport, " + std::to_string(sampling_.sites.size()) + " samples: " + now.words(),
                     progress(now));
      // Two-loop recursion [Nocedal and Wright 2006, alg. 7.4].
      Potential d = now.gradient;
      std::vector<double> alpha(memory.size());
      for (std::size_t k = memory.size(); k-- > 0;) {
        alpha[k] = dot(memory[k].step, d) / memory[k].curvature;
        for (std::size_t i = 0; i < d.size(); ++i) d[i] -= alpha[k] * memory[k].change[i];
      }
      d = in_metric(std::move(d));
      for (double& x : d) x *= gamma;
      for (std::size_t k = 0; k < memory.size(); ++k) {
        const double beta = dot(memory[k].change, d) / memory[k].curvature;
        for (std::size_t i = 0; i < d.size(); ++i) d[i] += (alpha[k] - beta) * memory[k].step[i];
      }
      for (double& x : d) x = -x;
      const double slope = dot(now.gradient, d);
      if (!(slope < 0)) {
        if (memory.empty()) return;
        memory.clear();
        continue;
      }
      double t = 1;
      std::optional<Evaluation> next;
      const double noise = 1e-13 * std::abs(now.value);
      for (int attempt = 0;; ++attempt) {
        Evaluation trial = evaluate(plus(now.psi, t, d));
        if (trial.value <= now.value + kArmijo * t * slope + noise) {
          next = std::move(trial);
          break;
        }
        if (attempt == 30 || evaluations_ >= budget_) break;
        // The parabola through both values and the slope, within reason.
        const double parabola = -slope * t * t / (2 * (trial.value - now.value - slope * t));
        t = std::clamp(parabola, 0.1 * t, 0.5 * t);
      }
      if (!next) {
        if (memory.empty()) return;
        memory.clear();
        continue;
      }
      Pair pair;
      pair.step = plus(next->psi, -1, now.psi);
      pair.change = plus(next->gradient, -1, now.gradient);
      pair.curvature = dot(pair.step, pair.change);
      if (pair.curvature > 0) {
        const Potential weighted = in_metric(pair.change);
        gamma = pair.curvature / dot(pair.change, weighted);
        memory.push_back(std::move(pair));
        if (memory.size() > kMemory) memory.pop_front();
      }
      now = std::move(*next);
      filled = now.empty == 0 ? filled + 1 : 0;
      if (done() || (filled >= 2 && now.l1_error < newton_from)) return;
    }
  }

  /// Done fraction by the error that is left, on a logarithmic scale.
  [[nodiscard]] double progress(const Evaluation& e) const {
    const double goal = options_.l1_tolerance;
    return 1 - std::log(std::clamp(e.l1_error, goal, 2.0) / goal) / std::log(2 / goal);
  }

  /// The dual's second derivative, -d mu(C_i) / d psi_j. Where no cell bridges two parts of the target, the sites fall into
  /// parts too, which may rise and sink against each other without effect.
  struct Curvature {
    Laplacian laplacian;
    std::vector<int> part;  // of each site: its smallest site
    int parts;

    /// The gradient less its mean on each part: what light moved within the parts can change.
    [[nodiscard]] Potential within(const Potential& gradient) const { return plus(gradient, -1, means(gradient)); }
    /// The mean of the values on each site's part.
    [[nodiscard]] Potential means(const Potential& values) const {
      Potential sum(values.size(), 0.0);
      std::vector<int> count(values.size(), 0);
      for (std::size_t i = 0; i < values.size(); ++i) {
        sum[part[i]] += values[i];
        ++count[part[i]];
      }
      Potential result(values.size());
      for (std::size_t i = 0; i < values.size(); ++i) result[i] = sum[part[i]] / count[part[i]];
      return result;
    }
  };
  [[nodiscard]] Curvature curvature(const Evaluation& e) const {
    std::vector<GraphEdge> edges;
    double total = 0;
    for (std::size_t k = 0; k < e.diagram.edges.size(); ++k) {
      const double slope = e.cells.edge_slopes[k];
      if (!(slope > 0)) continue;
      edges.push_back({e.diagram.edges[k].a, e.diagram.edges[k].b, slope});
      total += slope;
    }
    // A trace of the metric joins parts of the target that no cell bridges.
    std::vector<int> part = detail::connected_components(static_cast<int>(e.psi.size()), edges);
    int parts = 0;
    for (std::size_t i = 0; i < part.size(); ++i) parts += part[i] == static_cast<int>(i);
    double metric_total = 0;
    for (const auto& edge : sampling_.edges) metric_total += edge.weight;
    for (const auto& edge : sampling_.edges) {
      if (part[edge.a] != part[edge.b]) edges.push_back({edge.a, edge.b, kJoin * total / metric_total * edge.weight});
    }
    return {Laplacian(sampling_.sites, edges), std::move(part), parts};
  }

  struct Prediction {
    Potential corrected;  // by a Newton step
    Potential tangent;    // d psi / d radius
  };
  Prediction predict(const Evaluation& e) {
    const Curvature second = curvature(e);
    return {plus(e.psi, -1, second.laplacian.solve(second.within(e.gradient))),
            second.laplacian.solve(second.within(radius_derivative(e)))};
  }

  /// d mu(C_i) / d radius at constant potential.
  Potential radius_derivative(const Evaluation& e) {
    constexpr double kShare = 1e-4;
    const double radius = measure_.radius;
    measure_.radius = radius * (1 - kShare);
    const CellIntegrals narrower = integrate_cells(measure_, e.diagram, sampling_.sites, e.psi, starts_);
    measure_.radius = radius;
    Potential derivative(e.psi.size());
    for (std::size_t i = 0; i < derivative.size(); ++i)
      derivative[i] = (e.cells.masses[i] - narrower.masses[i]) / (kShare * radius);
    return derivative;
  }

  /// Goes from `now` against `direction`, along which the dual falls at first, until half of the slope is gone or cells have
  /// changed, none by more than `least` allows. Starts at `t` and finds even a short stretch where that is so by bisection:
  /// where the target is thin, nothing changes for a long way and then everything does. False when there is none.
  bool slide(Evaluation& now, const Potential& direction, double t, double least) {
    const double first = dot(now.gradient, direction);
    double near = 0;
    double far = std::numeric_limits<double>::infinity();
    for (int attempt = 0; attempt < kSliding && evaluations_ < budget_; ++attempt) {
      Evaluation trial = evaluate(plus(now.psi, -t, direction));
      double change = 0;
      for (std::size_t i = 0; i < direction.size(); ++i)
        change = std::max(change, std::abs(trial.cells.masses[i] - now.cells.masses[i]) / sampling_.masses[i]);
      const double slope = dot(trial.gradient, direction);
      const bool sound = trial.min_share >= least;
      if (sound && (std::abs(slope) < first / 2 || (slope > 0 && change > kSlid))) {
        now = std::move(trial);
        return true;
      }
      (sound && slope > 0 ? near : far) = t;
      t = std::isfinite(far) ? (near + far) / 2 : 4 * t;
    }
    return false;
  }

  /// Moves parts of the sites against each other until cells bridge them.
  bool bridge(Evaluation& now, const Curvature& second, double least) {
    // The direction that the joints alone give is constant on each part.
    const Potential inner = second.within(now.gradient);
    const Potential direction = second.means(second.laplacian.solve(plus(now.gradient, -1, inner)));
    const auto [lowest, highest] = std::minmax_element(direction.begin(), direction.end());
    return slide(now, direction, measure_.radius * std::sqrt(sampling_.spread.prod()) / (*highest - *lowest), least);
  }

  /// Damped Newton [Kitagawa, Merigot, Thibert 2019, alg. 1]. False when the step becomes too small.
  template <typename Done>
  bool newton(Evaluation& now, const Done& done, const Monitor& monitor) {
    const double least = std::min(now.min_share, 1.0) / 2;
    while (!done() && evaluations_ < budget_) {
      monitor.report("transport, " + std::to_string(sampling_.sites.size()) + " samples: " + now.words(),
                     progress(now));
      Stopwatch watch;
      const Curvature second = curvature(now);
      const Potential inner = second.within(now.gradient);
      const Potential step = second.laplacian.solve(inner);
      phases_.equations += watch.lap();
      const double norm = std::sqrt(dot(inner, inner));
      // What the parts have too much or too little of outweighs the rest.
      if (second.parts > 1 && 2 * norm * norm < dot(now.gradient, now.gradient)) {
        if (!bridge(now, second, least)) return false;
        continue;
      }
      double alpha = 1;
      for (;;) {
        Evaluation trial = evaluate(plus(now.psi, -alpha, step));
        const Potential left = second.within(trial.gradient);
        if (trial.min_share >= least && std::sqrt(dot(left, left)) <= (1 - alpha / 2) * norm) {
          now = std::move(trial);
          break;
        }
        alpha /= 2;
        if (evaluations_ >= budget_) return false;
        if (alpha > kLeastStep) continue;
        if (!slide(now, step, alpha, least)) return false;
        break;
      }
    }
    return true;
  }

  const Sampling& sampling_;
  TargetMeasure measure_;
  const TransportOptions& options_;
  PowerDiagramBuilder builder_;
  std::optional<Laplacian> metric_;  // made when it is first needed
  std::vector<int> starts_;
  int evaluations_ = 0;
  TransportPhases phases_;
  int budget_ = 0;  // of evaluations, for the solve that is running
};

void check(const SourceLight& source, const TargetLight& target, const TransportOptions& options) {
  if (!(source.size_mm.x() > 0 && source.size_mm.y() > 0))
    throw InputError("transport: the source must have a size above 0");
  if (options.samples < 16)
    throw InputError("transport.samples = " + std::to_string(options.samples) + ": must be at least 16");
  if (!(options.point_radius_mm > 0)) throw InputError("transport: point_radius_mm must be above 0");
  if (!(std::abs(target.total() - 1) <= 1e-9)) throw InputError("transport: the target light must be normalised");
  const auto below_zero = [](double flux) { return flux < 0; };
  bool negative = std::ranges::any_of(target.area_flux.values, below_zero);
  for (const auto& curve : target.curves) negative |= std::ranges::any_of(curve.density_per_mm, below_zero);
  for (const auto& point : target.points) negative |= point.flux < 0;
  if (negative) throw InputError("transport: the target light must be 0 or above everywhere");
}

}  // namespace

TransportMap solve_transport(const SourceLight& source, const TargetLight& target, const TransportOptions& options,
                             const Monitor& monitor) {
  check(source, target, options);
  Stopwatch watch;
  const std::vector<Sampling> samplings = detail::sample_source(source, options.samples, options.seed, monitor);
  const double sampling_seconds = watch.lap();
  TransportMap map = detail::solve_sampled(samplings, target, options, monitor);
  map.summary.seconds += sampling_seconds;
  return map;
}

TransportMap detail::solve_sampled(const std::vector<Sampling>& samplings, const TargetLight& target,
                                   const TransportOptions& options, const Monitor& monitor) {
  const OneBlasThread one_blas_thread;
  Stopwatch watch;

  // The target about its own centre of mass: potentials of a concentrated target are then small, and accurate.
  const detail::Spread spread = detail::spread_of(target, options.point_radius_mm);
  const Box2 extent{target.extent.min - spread.mean, target.extent.max - spread.mean};
  const double reach = std::max({extent.min.norm(), extent.max.norm(), Vec2(extent.min.x(), extent.max.y()).norm(),
                                 Vec2(extent.max.x(), extent.min.y()).norm()}) +
                       options.point_radius_mm;

  const bool singular = !(target.curves.empty() && target.points.empty());
  const auto start_radius = [&](const Sampling& sampling) {
    // Of the cells on the target; on a lens or a target that is all but a line the other says more.
    const double area = 12 * std::max(sampling.spread.prod(), spread.deviation.prod());
    const double spacing = std::sqrt(area / static_cast<double>(sampling.sites.size()));
    // Alone, but never so wide that they merge.
    const double alone = std::min(kStartRadiusAlone * spacing, 0.1 * sampling.spread.maxCoeff());
    // A heavy point's disk has to be cut among many cells.
    double flux = 0;
    for (const auto& point : target.points) flux = std::max(flux, point.flux);
    const double heavy = 0.1 * std::min(std::sqrt(flux * area), sampling.spread.maxCoeff());
    return std::max(options.point_radius_mm, target.area_total() > 0 ? std::max(kStartRadius * spacing, heavy) : alone);
  };

  TransportMap map;
  Potential psi;
  std::optional<Evaluation> result;
  const int levels = static_cast<int>(samplings.size());
  double share_done = 0;
  Monitor steady = monitor;  // never runs backwards
  if (monitor.on_progress) {
    steady.on_progress = [&monitor, most = 0.0](std::string_view what, double fraction) mutable {
      most = std::clamp(fraction, most, 1.0);
      monitor.on_progress(what, most);
    };
  }
  for (int level = levels - 1; level >= 0; --level) {
    const Sampling& sampling = samplings[level];
    const int n = static_cast<int>(sampling.sites.size());

    const double measure_radius = singular ? start_radius(sampling) : options.point_radius_mm;
    TargetMeasure measure = detail::measure_of(target, spread.mean, measure_radius, level > 0 ? n : detail::kExact);

    if (psi.empty()) {
      // The affine map with the right centre and spreads.
      const Vec2 stretch = detail::spread_of(target, measure_radius).deviation.cwiseQuotient(sampling.spread);
      psi.resize(n);
      for (int i = 0; i < n; ++i) psi[i] = stretch.dot(sampling.sites[i].cwiseProduct(sampling.sites[i])) / 2;
    } else {
      psi = detail::prolong(samplings[level + 1], psi, sampling);
    }

    const double share = std::pow(0.25, level);
    Level solver(sampling, std::move(measure), reach, options);
    const bool finest = level == 0;
    const bool last = finest && measure_radius <= options.point_radius_mm;
    const double share_then = finest && !singular ? 1 : share_done + (singular ? 0.4 : 0.75) * share;
    result = solver.solve(std::move(psi), last ? options.l1_tolerance : kCoarseTolerance,
                          last ? options.max_tolerance : kCoarseTolerance, steady.part(share_done, share_then));
    if (finest && singular) {
      result = solver.narrow(std::move(*result), options.point_radius_mm, options.l1_tolerance, options.max_tolerance,
                             steady.part(share_then, 1));
    }
    share_done = share_then;
    psi = result->psi;
    if (!finest && singular) {
      psi = solver.extrapolated(*result, start_radius(samplings[level - 1]));
    }
    map.summary.iterations += solver.evaluations();
    map.summary.phases += solver.phases();
    ++map.summary.levels;
  }

  const Sampling& sampling = samplings.front();
  const std::size_t n = sampling.sites.size();
  map.sites_mm = sampling.sites;
  for (Vec2& site : map.sites_mm) site += sampling.centre;
  map.source_masses = sampling.masses;
  map.source_centroids_mm = sampling.centroids;
  for (Vec2& centroid : map.source_centroids_mm) centroid += sampling.centre;
  map.summary.flux_spread = sampling.flux_spread;
  map.target_masses = result->cells.masses;
  map.target_centroids_mm.resize(n);
  map.weights_mm2.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double mass = map.target_masses[i];
    map.target_centroids_mm[i] =
        spread.mean + (mass > 0 ? Vec2(result->cells.collapsed_moments[i] / mass) : Vec2(0, 0));
    map.weights_mm2[i] = map.sites_mm[i].squaredNorm() - 2 * (psi[i] + spread.mean.dot(sampling.sites[i]));
  }
  map.summary.samples = static_cast<int>(n);
  map.summary.l1_mass_error = result->l1_error;
  map.summary.max_mass_error = result->max_error;
  map.summary.empty_cells = result->empty;
  map.summary.converged =
      result->empty == 0 && result->l1_error <= options.l1_tolerance && result->max_error <= options.max_tolerance;
  map.summary.seconds = watch.lap();
  if (!map.summary.converged) {
    throw NumericalError("transport did not reach its tolerances in " + std::to_string(map.summary.iterations) +
                         " evaluations: " + result->words() +
                         "; try fewer samples, a larger point_radius_mm or a brighter background");
  }
  map.summary.reason = "tolerances reached";
  return map;
}

}  // namespace lightmill

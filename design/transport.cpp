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
#include "design/core/one_blas_thread.h"
#include "design/core/text.h"
#include "design/detail/cell_relaxation.h"
#include "design/detail/laplacian.h"
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
constexpr double kValueNoise = 1e-13;  // of the dual's value
constexpr int kMemory = 12;            // pairs that L-BFGS remembers

// Damping of Newton's steps, as a share of the second derivative.
constexpr double kDampingPerError = 5;  // at first, per l1 error
constexpr double kThin = 0.5;           // a cell with less than this share of its mass is damped the more the less it has
constexpr double kLeastDampingPerError = 0.1;
constexpr double kLeastDamping = 1e-8;
constexpr double kMostDamping = 1e6;
constexpr double kLessDamping = 0.2;
constexpr double kMoreDamping = 4;
constexpr double kGoodRatio = 0.7;  // of the dual's fall to the predicted one, above which damping becomes less, and
constexpr double kBadRatio = 0.3;   // below which it becomes more
constexpr double kTimidRatio = 1.5; // and above which thin cells are damped less
constexpr double kGoodError = 0.7;  // of a step's l1 error to the least so far, when it is good whatever the dual says
constexpr double kTimid = 0.7;       // of the slope that a step leaves, above which a longer one is searched
constexpr double kPart = 0.25;      // of a step that went too far, tried first
constexpr int kMostSearch = 60;     // evaluations along it

constexpr double kMostRelaxed = 0.2;      // share of all cells: with more without light a step has gone astray
constexpr int kRings = 8;               // of thin cells around each other, to a cell that tells the scale
constexpr double kFaint = 1e-12;  // of a sample's light, what a point gives it that is not worth a second derivative
constexpr double kHidden = 50;    // softnesses that a site without a cell is raised by, beside its neighbours' few
constexpr double kMostGap = 0.9 * kPi;  // between neighbours' directions around a site that they enclose
constexpr double kJoin = 1e-10;  // of the second derivative, between parts of the target that no cell bridges
constexpr double kNarrowing = 0.3;       // factor on the radius of strips and points from stage to stage
constexpr double kNarrowingError = 0.6;     // l1 error after the prediction that is repaired quickly
constexpr double kLeastNarrowing = 0.95;   // smaller steps than this are left to the repair
// Half width of strips, and of points, at the start of every level, in distances between sites: beside area light they shall
// not blur it, alone they may be as wide as eases the start.
constexpr double kStartRadius = 0.3;
constexpr double kStartRadiusAlone = 1;
constexpr double kCoarseError = 0.01;   // l1 error that is good enough for what only leads to the last solve
constexpr double kCoarseErrorAtPoints = 0.001;  // the same where points are to become sharper: shares fall off with exp(1 / r^2)

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

/// When a solve is done.
struct Goal {
  double l1_error;
  double max_error = std::numeric_limits<double>::infinity();
  bool every_cell = false;  // has light
  [[nodiscard]] bool reached(const Evaluation& e) const {
    return e.l1_error <= l1_error && e.max_error <= max_error && !(every_cell && e.empty > 0);
  }
};

/// One level of the multi-scale solver.
class Level {
 public:
  Level(const Sampling& sampling, TargetMeasure measure, double reach, const TransportOptions& options)
      : sampling_(sampling),
        measure_(std::move(measure)),
        options_(options),
        reach_(reach),
        builder_(sampling.sites, reach) {
    if (!measure_.points.empty()) inner_ = enclosed_sites();
  }

  /// Improves psi until the goal is reached; returns the best it found otherwise.
  Evaluation solve(Potential psi, const Goal& goal, const Monitor& monitor) {
    return solve_from(evaluate(std::move(psi)), goal, monitor);
  }
  Evaluation solve_from(Evaluation now, const Goal& goal, const Monitor& monitor) {
    const bool reference = options_.solver == TransportSolver::kLbfgs;
    constexpr int kSlower = 20;  // evaluations of plain L-BFGS for one
    budget_ = evaluations_ + options_.max_iterations * (reference ? kSlower : 1);
    return reference ? descend(std::move(now), goal, monitor) : minimise(std::move(now), goal, monitor);
  }

  /// Follows the solution `now` while strips and points become narrower, down to `radius`. The potential is nearly
  /// linear in their radius: a Newton step that includes the tangent d psi / dr = H^-1 d mu / dr leads from one radius
  /// to the next.
  Evaluation narrow(Evaluation now, double radius, const Goal& goal, const Monitor& monitor) {
    double factor = kNarrowing;
    const double widest = measure_.radius;
    const auto done = [&](double r) { return std::log(widest / r) / std::log(widest / radius); };
    while (measure_.radius > radius) {
      const double from = measure_.radius;
      const auto [corrected, tangent] = predict(now);
      Evaluation next;
      for (;; factor = std::sqrt(factor)) {
        measure_.radius = std::max(radius, from * factor);
        next = evaluate(plus(corrected, measure_.radius - from, tangent));
        if (next.l1_error < kNarrowingError || factor > kLeastNarrowing) break;
      }
      if (!(next.l1_error < kNarrowingError)) next = better(std::move(next), now.psi);
      const bool last = measure_.radius == radius;
      now = solve_from(std::move(next), last ? goal : Goal{coarse_error()},
                       monitor.part(done(from), done(measure_.radius)));
      factor = std::max(kNarrowing, factor * factor);
    }
    return now;
  }
  /// The potential that `now` leads to at another radius, to first order; strips and points have that radius from then
  /// on.
  Potential extrapolated(const Evaluation& now, double radius) {
    const auto [corrected, tangent] = predict(now);
    const Potential predicted = plus(corrected, radius - measure_.radius, tangent);
    measure_.radius = radius;
    return better(evaluate(predicted), now.psi).psi;
  }
  /// Good enough before a narrowing.
  [[nodiscard]] double coarse_error() const { return measure_.points.empty() ? kCoarseError : kCoarseErrorAtPoints; }
  [[nodiscard]] int evaluations() const { return evaluations_; }
  [[nodiscard]] const TransportPhases& phases() const { return phases_; }

 private:
  /// The prediction, or the potential that it came from if that is better: where no cell bridges two parts of the
  /// target, the second derivative is all but singular and a step along it may lead anywhere.
  Evaluation better(Evaluation predicted, const Potential& unmoved) {
    Evaluation still = evaluate(unmoved);
    return predicted.l1_error <= still.l1_error ? std::move(predicted) : std::move(still);
  }

  /// Sites that lie well inside the hull of their neighbours on the source.
  [[nodiscard]] std::vector<char> enclosed_sites() const {
    const std::size_t n = sampling_.sites.size();
    std::vector<std::vector<double>> directions(n);
    const auto look = [&](int from, int to) {
      const Vec2 way = sampling_.sites[to] - sampling_.sites[from];
      directions[from].push_back(std::atan2(way.y(), way.x()));
    };
    for (const auto& edge : sampling_.edges) {
      look(edge.a, edge.b);
      look(edge.b, edge.a);
    }
    std::vector<char> enclosed(n);
    for (std::size_t i = 0; i < n; ++i) {
      auto& around = directions[i];
      std::sort(around.begin(), around.end());
      double gap = around.empty() ? 2 * kPi : around.front() + 2 * kPi - around.back();
      for (std::size_t k = 1; k < around.size(); ++k) gap = std::max(gap, around[k] - around[k - 1]);
      enclosed[i] = gap < kMostGap;
    }
    return enclosed;
  }
  /// Potentials at which sites have no cell when a point x fills them and all that surround them. All their planes pass
  /// through one place, x.s_i - psi_i alike but for a few softnesses e, so that the inner ones' cells are within about e over
  /// the distance of sites from x; finding them costs thousands of all but degenerate triangles.
  [[nodiscard]] Potential without_inner_cells(const Potential& psi, const std::vector<detail::PointShare>& shares) const {
    if (shares.empty()) return psi;
    Potential result = psi;
    std::vector<int> fills(psi.size(), -1);
    for (const auto& [point, site, mass] : shares) {
      if (mass > sampling_.masses[site] / 2) fills[site] = point;
    }
    std::vector<char> hidden = inner_;
    for (const auto& edge : sampling_.edges) {
      if (fills[edge.a] != fills[edge.b]) hidden[edge.a] = hidden[edge.b] = 0;
    }
    for (std::size_t i = 0; i < hidden.size(); ++i) {
      if (hidden[i] && fills[i] >= 0) result[i] += kHidden * detail::softness(measure_);
    }
    return result;
  }

  Evaluation evaluate(Potential psi) {
    ++evaluations_;
    Evaluation e;
    Stopwatch watch;
    std::vector<detail::PointShare> shares = share_points(measure_, sampling_.sites, psi);
    phases_.integrals += watch.lap();
    e.diagram = builder_.build(without_inner_cells(psi, shares));
    phases_.diagrams += watch.lap();
    e.cells = integrate_cells(measure_, e.diagram, sampling_.sites, psi, starts_);
    add_points(measure_, std::move(shares), e.cells);
    phases_.integrals += watch.lap();
    const std::size_t n = psi.size();
    e.gradient.resize(n);
    e.value = points_entropy(measure_, e.cells.point_shares);
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

  /// Lets cells with too little light grow, where the dual falls by it.
  Evaluation relaxed(Evaluation now) {
    Potential level = now.psi;
    if (detail::level_points(measure_, sampling_.sites, sampling_.masses, now.cells.point_shares, level)) {
      Evaluation next = evaluate(std::move(level));
      if (next.value < now.value) now = std::move(next);
    }
    const bool hopeless = now.empty > kMostRelaxed * static_cast<double>(now.psi.size());
    if (hopeless || now.min_share >= detail::RelaxationOptions{}.below) return now;
    Stopwatch watch;
    Potential grown = detail::relax_cells(measure_, now.diagram, sampling_.sites, now.psi, now.cells.masses,
                                          sampling_.masses, {.reach = reach_});
    phases_.relaxation += watch.lap();
    Evaluation next = evaluate(std::move(grown));
    if (next.value < now.value) return next;
    return now;
  }

  /// The dual's second derivative, -d mu(C_i) / d psi_j, damped. Where no cell bridges two parts of the target, the sites
  /// fall into parts too, which may rise and sink against each other without effect.
  struct Curvature {
    Laplacian laplacian;
    std::vector<int> part;  // of each site: its smallest site
    int parts;

    /// The gradient less its mean on each part: what light moved within the parts can change.
    [[nodiscard]] Potential within(const Potential& gradient) const {
      return parts > 1 ? plus(gradient, -1, means(gradient)) : gradient;
    }
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
  struct Step {
    Potential direction;  // against which the dual falls
    bool between;         // it moves parts of the target against each other
  };
  static Step newton_step(const Evaluation& now, const Curvature& second) {
    const Potential inner = second.within(now.gradient);
    // What parts of the target have too much or too little of is moved between them first if it outweighs the rest.
    if (second.parts > 1 && 2 * dot(inner, inner) < dot(now.gradient, now.gradient))
      return {second.means(second.laplacian.solve(plus(now.gradient, -1, inner))), true};
    return {second.within(second.laplacian.solve(inner)), false};
  }

  /// Levenberg and Marquardt's damping of Newton's steps, in the metric of the source's Laplacian: a cell that light is
  /// about to leave has hardly a second derivative, and plain Newton throws it out. Cells that have lost their light
  /// grow again before a step is judged.
  Evaluation minimise(Evaluation now, const Goal& goal, const Monitor& monitor) {
    double damping = std::min(kDampingPerError * now.l1_error, 1.0);
    double thin_damping = 1;
    now = relaxed(std::move(now));
    double least_error = now.l1_error;  // so far: no error excuses a rise of the dual twice, or steps go in circles
    while (!goal.reached(now) && evaluations_ < budget_ && damping < kMostDamping) {
      least_error = std::min(least_error, now.l1_error);
      monitor.report("transport, " + std::to_string(sampling_.sites.size()) + " samples: " + now.words(),
                     progress(now));
      Stopwatch watch;
      const auto [step, between] = newton_step(now, curvature(now, damping, thin_damping));
      phases_.equations += watch.lap();
      const double slope = dot(now.gradient, step);
      const bool lost_in_rounding = slope < 20 * kValueNoise * std::abs(now.value);
      // The dual's fall over the predicted one. Where rounding hides it, or few cells outweigh all others in it, the
      // gradient decides.
      const auto ratio_of = [&](const Evaluation& trial) {
        double ratio = (now.value - trial.value) / (slope / 2);
        if (lost_in_rounding) ratio = nearer_to(goal, trial, now) ? 1 : -1;
        return trial.l1_error < kGoodError * least_error ? std::max(ratio, kGoodRatio) : ratio;
      };
      Evaluation trial = evaluate(plus(now.psi, -1, step));
      const bool timid = dot(trial.gradient, step) > kTimid * slope;
      if (timid) {
        // Parts of the target that few cells bridge are moved too little by a damped step, and need no new one.
        constexpr double kNoEnd = std::numeric_limits<double>::infinity();
        Evaluation longer = searched(now, step, slope, 1 / kPart, trial, 1, kNoEnd);
        const bool sound = longer.min_share >= std::min(trial.min_share, kThin);
        if (sound && (between || longer.l1_error < trial.l1_error)) trial = std::move(longer);
      }
      trial = relaxed(std::move(trial));
      double ratio = ratio_of(trial);
      const bool nearer = trial.l1_error < now.l1_error;
      if (ratio < kBadRatio || (ratio < kTimidRatio && !nearer)) {
        damping *= kMoreDamping;
        thin_damping = std::min(1.0, thin_damping * kMoreDamping);
      } else {
        if (ratio > kTimidRatio) thin_damping *= kLessDamping;
        // Damping that a timid step calls too much has no floor, unless thin cells are what holds it.
        const double floor = timid && now.min_share >= kThin ? kLeastDamping : kLeastDampingPerError * trial.l1_error;
        if (ratio >= kGoodRatio) damping = std::max(damping * kLessDamping, std::min(floor, damping));
      }
      if (ratio < kArmijo) {
        damping *= kMoreDamping;
        trial = relaxed(searched(now, step, slope, kPart, now, 0, 1));
        ratio = lost_in_rounding ? ratio_of(trial) : now.value - trial.value;
      }
      if (ratio > 0) now = std::move(trial);
    }
    return now;
  }

  static bool nearer_to(const Goal& goal, const Evaluation& trial, const Evaluation& now) {
    return now.l1_error > goal.l1_error ? trial.l1_error < now.l1_error : trial.max_error < now.max_error;
  }

  /// Goes against `direction`, along which the dual falls by `slope` at first, until half of that is gone: from `t` on, by
  /// bisection once it is too far. Where the target is thin nothing changes for a long way, and then everything does.
  /// `best` is at `near`, where there is too much left.
  Evaluation searched(const Evaluation& now, const Potential& direction, double slope, double t, Evaluation best,
                      double near, double far) {
    for (int attempt = 0; attempt < kMostSearch && evaluations_ < budget_; ++attempt) {
      Evaluation trial = evaluate(plus(now.psi, -t, direction));
      const double left = dot(trial.gradient, direction);
      if (std::abs(left) <= slope / 2) return trial;
      if (left > 0) {
        near = t;
        best = std::move(trial);
      } else {
        far = t;
      }
      t = near > 0 && std::isfinite(far) ? (near + far) / 2 : near > 0 ? t / kPart : t * kPart;
    }
    return best;
  }

  /// L-BFGS with Armijo's rule, as in the paper [paper sec. 4; Nocedal and Wright 2006, alg. 7.4].
  Evaluation descend(Evaluation now, const Goal& goal, const Monitor& monitor) {
    struct Pair {
      Potential step, change;
      double curvature;
    };
    std::deque<Pair> memory;
    double gamma = 1;
    while (!goal.reached(now) && evaluations_ < budget_) {
      monitor.report("transport, " + std::to_string(sampling_.sites.size()) + " samples: " + now.words(),
                     progress(now));
      Potential d = now.gradient;
      std::vector<double> alpha(memory.size());
      for (std::size_t k = memory.size(); k-- > 0;) {
        alpha[k] = dot(memory[k].step, d) / memory[k].curvature;
        for (std::size_t i = 0; i < d.size(); ++i) d[i] -= alpha[k] * memory[k].change[i];
      }
      for (double& x : d) x *= gamma;
      for (std::size_t k = 0; k < memory.size(); ++k) {
        const double beta = dot(memory[k].change, d) / memory[k].curvature;
        for (std::size_t i = 0; i < d.size(); ++i) d[i] += (alpha[k] - beta) * memory[k].step[i];
      }
      for (double& x : d) x = -x;
      const double slope = dot(now.gradient, d);
      std::optional<Evaluation> next;
      const double noise = kValueNoise * std::abs(now.value);
      double t = 1;
      for (int attempt = 0; slope < 0; ++attempt) {
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
        if (memory.empty()) break;
        memory.clear();
        continue;
      }
      Pair pair;
      pair.step = plus(next->psi, -1, now.psi);
      pair.change = plus(next->gradient, -1, now.gradient);
      pair.curvature = dot(pair.step, pair.change);
      if (pair.curvature > 0) {
        gamma = pair.curvature / dot(pair.change, pair.change);
        memory.push_back(std::move(pair));
        if (memory.size() > kMemory) memory.pop_front();
      }
      now = std::move(*next);
    }
    return now;
  }

  /// Done fraction by the error that is left, on a logarithmic scale.
  [[nodiscard]] double progress(const Evaluation& e) const {
    const double goal = options_.l1_tolerance;
    return 1 - std::log(std::clamp(e.l1_error, goal, 2.0) / goal) / std::log(2 / goal);
  }

  [[nodiscard]] Curvature curvature(const Evaluation& e, double damping, double thin_damping) const {
    std::vector<GraphEdge> edges;
    for (std::size_t k = 0; k < e.diagram.edges.size(); ++k) {
      const double slope = e.cells.edge_slopes[k];
      if (slope > 0) edges.push_back({e.diagram.edges[k].a, e.diagram.edges[k].b, slope});
    }
    // The second derivative of what a point gives, f/e (diag(p) - p p^T), is what is left of a star when its hub is
    // eliminated.
    const int n = static_cast<int>(e.psi.size());
    const int hubs = static_cast<int>(measure_.points.size());
    for (const auto& [point, site, mass] : e.cells.point_shares) {
      if (mass > kFaint * sampling_.masses[site]) edges.push_back({site, n + point, mass / detail::softness(measure_)});
    }
    const std::vector<double> scale = damping_scale(e, edges);
    const auto damped = [&](const GraphEdge& edge, double by) -> GraphEdge {
      return {edge.a, edge.b, by * std::sqrt(scale[edge.a] * scale[edge.b]) * edge.weight};
    };
    for (const auto& edge : sampling_.edges) {
      const double thin = thin_damping * std::max(thinness(e, edge.a), thinness(e, edge.b));
      if (thin > 0) edges.push_back(damped(edge, thin));
    }
    std::vector<int> part = detail::connected_components(n + hubs, edges);
    int parts = 0;
    for (std::size_t i = 0; i < part.size(); ++i) parts += part[i] == static_cast<int>(i);
    for (const auto& edge : sampling_.edges) {
      const double by = part[edge.a] == part[edge.b] ? damping : std::max(damping, kJoin);
      if (by > 0) edges.push_back(damped(edge, by));
    }
    return {Laplacian(sampling_.sites, edges, hubs), std::move(part), parts};
  }
  /// What a cell lacks to its share of light below which it is damped.
  [[nodiscard]] double thinness(const Evaluation& e, int site) const {
    return std::max(0.0, kThin - e.cells.masses[site] / sampling_.masses[site]);
  }
  /// The second derivative at each site in units of the source's: dense light is stiff, a dark field is soft. Thin cells,
  /// which have hardly any of their own, take their neighbours'.
  [[nodiscard]] std::vector<double> damping_scale(const Evaluation& e, const std::vector<GraphEdge>& second) const {
    const std::size_t n = e.psi.size();
    std::vector<double> own(n, 0), unit(n, 0);
    double own_total = 0;
    double unit_total = 0;
    for (const auto& edge : second) {
      own[edge.a] += edge.weight;
      if (static_cast<std::size_t>(edge.b) < n) own[edge.b] += edge.weight;
      own_total += edge.weight;
    }
    for (const auto& edge : sampling_.edges) {
      unit[edge.a] += edge.weight;
      unit[edge.b] += edge.weight;
      unit_total += edge.weight;
    }
    std::vector<double> scale(n, 0);  // 0: not known yet
    for (std::size_t i = 0; i < n; ++i) {
      if (thinness(e, static_cast<int>(i)) == 0) scale[i] = own[i] / unit[i];
    }
    const auto known = [](double x) { return x > 0; };
    for (int ring = 0; ring < kRings && !std::ranges::all_of(scale, known); ++ring) {
      std::vector<double> sum(n, 0), weight(n, 0);
      const auto lend = [&](int from, int to, double w) {
        if (scale[to] > 0 || !(scale[from] > 0)) return;
        sum[to] += w * scale[from];
        weight[to] += w;
      };
      for (const auto& edge : sampling_.edges) {
        lend(edge.a, edge.b, edge.weight);
        lend(edge.b, edge.a, edge.weight);
      }
      for (std::size_t i = 0; i < n; ++i) {
        if (weight[i] > 0) scale[i] = sum[i] / weight[i];
      }
    }
    for (double& s : scale) {
      if (!(s > 0)) s = own_total / unit_total;
    }
    return scale;
  }

  struct Prediction {
    Potential corrected;  // by a Newton step
    Potential tangent;    // d psi / d radius
  };
  Prediction predict(const Evaluation& e) {
    const Curvature second = curvature(e, kLeastDampingPerError * e.l1_error, 1);
    return {plus(e.psi, -1, second.laplacian.solve(second.within(e.gradient))),
            second.laplacian.solve(second.within(radius_derivative(e)))};
  }

  /// d mu(C_i) / d radius at constant potential.
  Potential radius_derivative(const Evaluation& e) {
    constexpr double kShare = 1e-4;
    const double radius = measure_.radius;
    measure_.radius = radius * (1 - kShare);
    CellIntegrals narrower = integrate_cells(measure_, e.diagram, sampling_.sites, e.psi, starts_);
    add_points(measure_, share_points(measure_, sampling_.sites, e.psi), narrower);
    measure_.radius = radius;
    Potential derivative(e.psi.size());
    for (std::size_t i = 0; i < derivative.size(); ++i)
      derivative[i] = (e.cells.masses[i] - narrower.masses[i]) / (kShare * radius);
    return derivative;
  }

  const Sampling& sampling_;
  TargetMeasure measure_;
  const TransportOptions& options_;
  double reach_;
  PowerDiagramBuilder builder_;
  std::vector<int> starts_;
  std::vector<char> inner_;  // per site: within its neighbours' hull; empty without points
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
    return std::max(options.point_radius_mm, target.area_total() > 0 ? kStartRadius * spacing : alone);
  };

  const Goal wanted{options.l1_tolerance, options.max_tolerance, true};
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
    result = solver.solve(std::move(psi), last ? wanted : Goal{finest ? solver.coarse_error() : kCoarseError},
                          steady.part(share_done, share_then));
    if (finest && singular) {
      result = solver.narrow(std::move(*result), options.point_radius_mm, wanted,
                             steady.part(share_then, 1));
    }
    share_done = share_then;
    psi = result->psi;
    if (n <= TransportMap::kMostSeen || map.seen_sites_mm.empty()) {
      map.seen_sites_mm.clear();
      map.seen_weights_mm2.clear();
      for (int i = 0; i < n; ++i) {
        map.seen_sites_mm.emplace_back(sampling.sites[i] + sampling.centre);
        map.seen_weights_mm2.push_back(map.seen_sites_mm[i].squaredNorm() - 2 * (psi[i] + spread.mean.dot(sampling.sites[i])));
      }
    }
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

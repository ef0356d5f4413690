// Semi-discrete optimal transport from the source irradiance to the target light by power diagrams [paper sec. 4].
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "design/core/geometry.h"
#include "design/core/monitor.h"
#include "design/source.h"
#include "design/target.h"

namespace lightmill {

/// kNewton: damped Newton steps, between which cells without light grow back.
/// kLbfgs: the paper's own, L-BFGS alone, for comparison; many times slower.
enum class TransportSolver { kNewton, kLbfgs };

struct TransportOptions {
  TransportSolver solver = TransportSolver::kNewton;
  int samples = 65536;          ///< sites of the power diagram (rounded to what the sampling needs)
  double l1_tolerance = 1e-4;   ///< stop when sum_i |mu_T(C_i) - mu_S(C_i)| is below, and
  double max_tolerance = 1e-2;  ///< max_i |mu_T(C_i) - mu_S(C_i)| / mu_S(C_i) is below
  int max_iterations = 500;     ///< evaluations of the dual per level
  double point_radius_mm = 0.01;///< half width of curves inside the solver; its square is the softness of points, README.md
  std::uint64_t seed = 1;
};

/// Where the time went, all levels together; what is missing is vectors and sampling.
struct TransportPhases {
  double diagrams = 0;   ///< seconds for power diagrams
  double integrals = 0;  ///< seconds for masses, moments and second derivatives
  double equations = 0;  ///< seconds for factorising and solving linear systems
  double relaxation = 0; ///< seconds for growing single cells
  TransportPhases& operator+=(const TransportPhases& other) {
    diagrams += other.diagrams;
    integrals += other.integrals;
    equations += other.equations;
    relaxation += other.relaxation;
    return *this;
  }
};

struct TransportSummary {
  int samples = 0;
  int iterations = 0;           ///< evaluations of the dual, all levels
  int levels = 0;
  double seconds = 0;
  TransportPhases phases;
  double l1_mass_error = 0;     ///< DESIGN.md, "Measures"
  double max_mass_error = 0;
  int empty_cells = 0;
  double flux_spread = 0;       ///< standard deviation of the samples' flux over its mean
  bool converged = false;
  std::string reason;           ///< why it stopped, in words
};

/// The map: light of source cell i (site, mass, centroid) goes to the power cell i of the target (weight, centroid).
struct TransportMap {
  std::vector<Vec2> sites_mm;
  std::vector<double> source_masses;        ///< mu_S(C_i^0), sum 1
  std::vector<Vec2> source_centroids_mm;
  std::vector<double> target_masses;        ///< mu_T(C_i^w), sum 1
  std::vector<double> weights_mm2;          ///< potentials of the power cells
  std::vector<Vec2> target_centroids_mm;
  /// The finest level of at most kMostSeen samples, or the coarsest: a power diagram whose cells the eye can tell apart.
  std::vector<Vec2> seen_sites_mm;
  std::vector<double> seen_weights_mm2;
  static constexpr int kMostSeen = 20000;
  TransportSummary summary;
};

/// Minimises the convex function of [paper eq. 3] from coarse to fine by damped Newton steps [Kitagawa, Merigot, Thibert 2019],
/// with coordinate descent for cells that have lost their light. The result does not depend on the thread count.
/// Throws NumericalError when it cannot reach the tolerances (with the figures it reached).
TransportMap solve_transport(const SourceLight& source, const TargetLight& target, const TransportOptions& options = {},
                             const Monitor& monitor = {});

}  // namespace lightmill

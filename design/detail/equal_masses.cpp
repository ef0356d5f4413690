#include "design/detail/equal_masses.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace lightmill::detail {

namespace {

constexpr double kBridge = 1e-3;       // of the mean weight, between neighbours with no light on their border
constexpr int kMostSteps = 6;          // two or three are the rule
constexpr double kLeastDamping = 0.1;  // smaller steps are not worth their integrals
constexpr double kLeastShare = 0.3;    // of the smaller of a cell's mass and its goal, that a step leaves

/// What each cell's mass shall be: the mean of its part of the source, for no border lets light through between parts.
std::vector<double> goals_of(const SourceCells& cells) {
  const std::size_t n = cells.masses.size();
  std::vector<GraphEdge> lit;
  std::copy_if(cells.edges.begin(), cells.edges.end(), std::back_inserter(lit),
               [](const GraphEdge& e) { return e.weight > 0; });
  const std::vector<int> part = connected_components(static_cast<int>(n), lit);
  std::vector<double> mass(n, 0.0);
  std::vector<int> count(n, 0);
  for (std::size_t i = 0; i < n; ++i) {
    mass[part[i]] += cells.masses[i];
    ++count[part[i]];
  }
  std::vector<double> goals(n);
  for (std::size_t i = 0; i < n; ++i) goals[i] = mass[part[i]] / count[part[i]];
  return goals;
}

double off_goal(const std::vector<double>& masses, const std::vector<double>& goals) {
  double squares = 0;
  for (std::size_t i = 0; i < masses.size(); ++i) squares += std::pow(masses[i] / goals[i] - 1, 2);
  return std::sqrt(squares / static_cast<double>(masses.size()));
}

}  // namespace

double flux_spread_of(const std::vector<double>& masses) {
  const double mean = std::accumulate(masses.begin(), masses.end(), 0.0) / static_cast<double>(masses.size());
  return off_goal(masses, std::vector<double>(masses.size(), mean));
}

std::vector<GraphEdge> bridged(std::vector<GraphEdge> edges) {
  double weights = 0;
  for (const auto& edge : edges) weights += edge.weight;
  const double least = kBridge * weights / static_cast<double>(std::max<std::size_t>(1, edges.size()));
  for (auto& edge : edges) edge.weight = std::max(edge.weight, least);
  return edges;
}

SourceCells with_equal_masses(const std::vector<Vec2>& sites, SourceCells cells, double enough,
                              const std::function<SourceCells(std::vector<double> psi)>& measure) {
  const std::vector<double> goals = goals_of(cells);
  double off = off_goal(cells.masses, goals);
  for (int step = 0; step < kMostSteps && off > enough; ++step) {
    // A cell shrinks by its borders' weights when its potential rises: d mass_i / d psi_j = weight_ij.
    std::vector<double> excess(goals.size());
    for (std::size_t i = 0; i < goals.size(); ++i) excess[i] = cells.masses[i] - goals[i];
    const std::vector<double> rise = Laplacian(sites, bridged(cells.edges)).solve(excess);
    const auto acceptable = [&](const SourceCells& trial) {
      for (std::size_t i = 0; i < goals.size(); ++i) {
        if (trial.masses[i] < kLeastShare * std::min(cells.masses[i], goals[i])) return false;
      }
      return off_goal(trial.masses, goals) < off;
    };
    double damping = 1;
    for (;; damping /= 2) {
      if (damping < kLeastDamping) return cells;
      std::vector<double> psi = cells.psi;
      for (std::size_t i = 0; i < psi.size(); ++i) psi[i] += damping * rise[i];
      SourceCells trial = measure(std::move(psi));
      if (!acceptable(trial)) continue;
      cells = std::move(trial);
      off = off_goal(cells.masses, goals);
      break;
    }
  }
  return cells;
}

}  // namespace lightmill::detail

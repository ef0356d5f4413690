// The compound energy over the heights of all vertices alone.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "design/core/monitor.h"
#include "design/detail/compound_energy.h"
#include "design/detail/laplacian.h"

namespace lightmill::detail {

/// Brings the heights of a mesh to rest. Kept through all turns of a surface: the equations of one turn precondition
/// those of the next.
class HeightSettling {
 public:
  /// `energy` lives longer; the normals and slopes that it wants may change between calls, its mesh, creases and
  /// weights not.
  explicit HeightSettling(const CompoundEnergy& energy);

  /// Gauss and Newton's steps until no height changes by more than `tolerance_mm`. The barrier is left to whoever puts
  /// the surface on its floor afterwards: nothing else changes with a shift. Throws NumericalError when there is no
  /// finite solution.
  MinimiserReport settle(double tolerance_mm, std::vector<Vec3>& positions, const Monitor& monitor);

 private:
  double evaluate(const std::vector<Vec3>& positions);
  void forward(const std::vector<double>& heights, std::vector<Eigen::Vector4d>& result) const;
  [[nodiscard]] std::vector<double> backward(const std::vector<Eigen::Vector4d>& values) const;
  [[nodiscard]] std::vector<double> step(const Monitor& monitor, MinimiserReport& report);
  void factorise(const std::vector<Vec3>& positions);

  const CompoundEnergy& energy_;
  EnergyScales scales_;
  // Four residuals per vertex, three of its normal and one of smoothness, and their derivatives by the heights of the
  // vertex and of its ring.
  std::vector<int> first_;  // of a vertex's slots in rows_: its own, then its ring's
  std::vector<Eigen::Vector4d> rows_;
  std::vector<Eigen::Vector4d> residuals_;
  std::vector<int> column_first_;             // of a vertex in columns_
  std::vector<std::pair<int, int>> columns_;  // vertex whose residuals, slot
  std::optional<Laplacian> factor_;           // of these derivatives, or of earlier ones
};

}  // namespace lightmill::detail

// Heights whose slopes come as close as they can to wanted slopes, by least squares over the edges of a mesh.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "design/detail/creases.h"
#include "design/detail/laplacian.h"

namespace lightmill::detail {

/// The height difference over every edge shall be the mean of its ends' slopes times the edge (trapezoidal rule: third
/// order in the edge's length, and no oscillation escapes it); edges weigh as their slopes do, by one over their length
/// squared, torn edges next to nothing: they only tell how high one side stands against the other. The matrix depends
/// on the mesh only and is factorised once.
class HeightIntegrator {
 public:
  HeightIntegrator(const std::vector<Vec2>& xy, const std::vector<std::array<int, 3>>& triangles,
                   const Creases& creases = {});

  /// Heights of the vertices for `slopes` (dz/dx, dz/dy); the lowest is 0. An edge that a crease crosses has either
  /// side's slope as far as that side reaches. Throws NumericalError when the solver fails.
  [[nodiscard]] std::vector<double> integrate(const std::vector<Vec2>& slopes, const Creases& creases) const;

  [[nodiscard]] const std::vector<std::array<int, 2>>& edges() const { return edges_; }

 private:
  std::vector<Vec2> xy_;
  std::vector<std::array<int, 2>> edges_;
  std::vector<double> weights_;
  std::optional<Laplacian> factor_;
};

}  // namespace lightmill::detail

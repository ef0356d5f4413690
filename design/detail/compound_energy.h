// The compound energy of the target optimisation [paper eq. 5 to 11] over all three coordinates of a mesh, by Ceres.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "design/core/monitor.h"
#include "design/detail/creases.h"
#include "design/detail/one_ring.h"
#include "design/detail/vertex_light.h"
#include "design/surface.h"

namespace lightmill::detail {

/// In which directions a vertex may move, from nowhere to everywhere. The outline of the lens stays where it is.
enum class Freedom : char { kNone, kHeight, kHeightAndSide, kAll };

/// What stays the same through one normal integration.
struct CompoundEnergy {
  const std::vector<std::array<int, 3>>& triangles;
  const std::vector<OneRing>& rings;
  const std::vector<Vec3>& start_mm;      ///< the mesh at rest: each vertex on the ray that belongs to it
  const std::vector<VertexLight>& light;  ///< that ray
  const std::vector<Freedom>& freedom;
  const Creases& creases;            ///< triangles that a crease crosses have no say in their corners' normals
  const std::vector<Vec2>& sides;    ///< unit, along the straight side that a border vertex may slide on
  std::vector<Vec3> target_normals;  ///< what the angle-weighted normal of each vertex shall be
  std::vector<Vec2> target_slopes;   ///< at the vertices themselves
  SurfaceWeights weights;
  double edge_mm = 1;      ///< mean edge of the start mesh: the unit of lengths
  double slope_scale = 1;  ///< the unit of normals: lens size over (n - 1) times distance
  double floor_mm = 0;     ///< z of the plane that the surface stays above

  /// The mean slope that is wanted over the edge from v to n.
  [[nodiscard]] Vec2 mean_slope(int v, int n) const {
    const double share = creases.crossed[v] == 0 ? 0.5 : creases.share(v, n);
    return share * target_slopes[v] + (1 - share) * target_slopes[n];
  }
};

/// Factors on the residuals that make every term dimensionless.
struct EnergyScales {
  double integration, direction, flux, smoothness, height_smoothness, barrier;
  explicit EnergyScales(const CompoundEnergy& energy);
};

struct MinimiserReport {
  double initial_energy = 0;
  double final_energy = 0;
  int iterations = 0;
  int inner_iterations = 0;  ///< of conjugate gradients
  std::string message;
};

/// All terms over all coordinates that are free, in Ceres: Levenberg-Marquardt from `positions`, at most `iterations`
/// steps, damped by the equations' diagonal over `trust_radius`. Throws NumericalError when Ceres finds no usable
/// solution.
MinimiserReport minimise(const CompoundEnergy& energy, int iterations, double trust_radius,
                         std::vector<Vec3>& positions, const Monitor& monitor);

/// The energy and its gradient by every coordinate, for tests. `positions` come back as they were.
double energy_at(const CompoundEnergy& energy, std::vector<Vec3>& positions, std::vector<Vec3>& gradient);

/// The angle-weighted normal of a vertex from its own and its ring's positions (in ring order), and its derivatives:
/// d normal / d ring vertex k is jacobians[k + 1], with respect to the vertex itself jacobians[0]. Triangle k has no
/// say when bit k of `crossed` is set, unless no other is left. For tests and the energy.
Vec3 ring_normal(const Vec3& centre, const std::vector<Vec3>& ring, bool closed, std::uint32_t crossed,
                 std::vector<Eigen::Matrix3d>* jacobians);

/// Whether triangle k of a ring has a say in the normal of its vertex.
bool has_say(std::uint32_t crossed, int triangle_count, int k);

}  // namespace lightmill::detail

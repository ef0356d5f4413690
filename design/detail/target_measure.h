// Exact integrals of a target measure (pixels and filled shapes, strips along curves, points) over the cells of a power
// diagram.
#pragma once

#include <limits>
#include <vector>

#include "design/core/geometry.h"
#include "design/detail/pixel_density.h"
#include "design/detail/point_light.h"
#include "design/detail/power_diagram.h"
#include "design/target.h"

namespace lightmill::detail {

/// A straight piece of a curve as a strip of half width `radius`, flux per mm linear from `density_from` to
/// `density_to`.
struct Strip {
  Vec2 from;
  Vec2 direction;  ///< unit
  double length;
  double density_from;
  double density_to;
};

/// An evenly lit disk of radius `radius`.
struct Disk {
  Vec2 centre;
  double flux;
};

/// A point of light, shared among sites as point_light.h says, with the softness radius^2.
struct Point {
  Vec2 place;
  double flux;
};

/// The target inside the solver. Curves are spread over strips of half width `radius`.
struct TargetMeasure {
  PixelDensity pixels;
  std::vector<Strip> strips;
  std::vector<Disk> disks;
  std::vector<Point> points;
  double radius = 0;
};

/// The target about `centre`. Area light is averaged onto a grid of about `most_pixels` pixels if that is coarser than
/// what the target has; kExact leaves it exactly as it is.
inline constexpr double kExact = std::numeric_limits<double>::infinity();
TargetMeasure measure_of(const TargetLight& target, const Vec2& centre, double radius, double most_pixels = kExact);

/// Mean and standard deviation of a target in x and y, its curves and points spread by `radius`.
struct Spread {
  Vec2 mean{0, 0};
  Vec2 deviation{0, 0};
};
Spread spread_of(const TargetLight& target, double radius);

/// Integrates a measure over single convex polygons; regions are found by buckets.
class PolygonMeasure {
 public:
  explicit PolygonMeasure(const TargetMeasure& measure);
  /// Flux in a polygon, counter-clockwise; that of points is no polygon's.
  [[nodiscard]] double mass(const std::vector<Vec2>& corners) const;

 private:
  template <typename Visit>
  void for_each_bucket(const Box2& box, const Visit& visit) const;

  const TargetMeasure& measure_;
  Box2 box_;
  int side_ = 0;
  std::vector<std::vector<int>> buckets_;  // of regions: strips, then disks
};

struct CellIntegrals {
  std::vector<double> masses;
  std::vector<Vec2> moments;            ///< first moments of the measure
  std::vector<Vec2> collapsed_moments;  ///< the same with strips and disks drawn together onto their axes and centres
  std::vector<PointShare> point_shares;  ///< what points add to masses and moments
  std::vector<double> edge_slopes;      ///< per edge: -d mass_a / d psi_a across it = (density along it) / |s_a - s_b|
};

/// Masses, moments and Hessian entries of all cells, points aside. `starts` remembers where each strip and disk was found (any size).
CellIntegrals integrate_cells(const TargetMeasure& measure, const PowerDiagram& diagram, const std::vector<Vec2>& sites,
                              const std::vector<double>& psi, std::vector<int>& starts);
/// Adds what points give, as share_points found it.
void add_points(const TargetMeasure& measure, std::vector<PointShare> shares, CellIntegrals& cells);

}  // namespace lightmill::detail

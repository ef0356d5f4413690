// Exact integrals of a target measure (pixels, strips along curves, disks at points) over the cells of a power diagram.
#pragma once

#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/detail/power_diagram.h"
#include "design/target.h"

namespace lightmill::detail {

/// A piecewise constant density, prepared so that Green's theorem integrates it along edges: with the flux left of a
/// point, F(x, y) = int_{-inf}^{x} rho(t, y) dt, a cell's mass is the contour integral of F dy.
class PixelDensity {
 public:
  PixelDensity() = default;
  /// `flux` per pixel over `extent`, row 0 at the smallest y.
  PixelDensity(const Grid<double>& flux, const Box2& extent);

  struct Integral {
    double mass = 0;  ///< of F dy
    Vec2 moment{0, 0};
    double line = 0;  ///< of the density along the edge, flux per mm
  };
  /// Contribution of the directed edge from p to q; antisymmetric but for `line`.
  [[nodiscard]] Integral along(const Vec2& p, const Vec2& q) const;
  [[nodiscard]] bool empty() const { return width_ == 0; }

 private:
  struct Pixel {
    double rho;  // flux per pixel
    double c0;   // F(X) = c0 + rho X within the pixel (lengths in pixels)
    double c1;   // G(X) = int t rho dt = c1 + rho X^2 / 2
  };
  struct Beyond {  // integrals over y from the bottom of F, y F and G right of the last column
    double mass;
    double y_moment;
    double x_moment;
  };
  [[nodiscard]] Beyond beyond(double y) const;

  int width_ = 0;
  int height_ = 0;
  Vec2 origin_{0, 0};
  Vec2 pitch_{1, 1};
  std::vector<Pixel> pixels_;
  std::vector<Beyond> beyond_;
};

/// A straight piece of a curve as a strip of half width `radius`, flux per mm linear from `density_from` to
/// `density_to`.
struct Strip {
  Vec2 from;
  Vec2 direction;  ///< unit
  double length;
  double density_from;
  double density_to;
};

struct Disk {
  Vec2 centre;
  double flux;
};

/// The target inside the solver. Singular light is spread over strips and disks of half width `radius`.
struct TargetMeasure {
  PixelDensity pixels;
  std::vector<Strip> strips;
  std::vector<Disk> disks;
  double radius = 0;
};

struct CellIntegrals {
  std::vector<double> masses;
  std::vector<Vec2> moments;            ///< first moments of the measure
  std::vector<Vec2> collapsed_moments;  ///< the same with strips and disks drawn together onto their axes and centres
  std::vector<double> edge_slopes;      ///< per edge: -d mass_a / d psi_a across it = (density along it) / |s_a - s_b|
};

/// Masses, moments and Hessian entries of all cells. `starts` remembers where each strip and disk was found (any size).
CellIntegrals integrate_cells(const TargetMeasure& measure, const PowerDiagram& diagram, const std::vector<Vec2>& sites,
                              const std::vector<double>& psi, std::vector<int>& starts);

}  // namespace lightmill::detail

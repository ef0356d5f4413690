// Light traced forward through a surface onto the receiver, and how well it paints the target.
#pragma once

#include "design/core/grid.h"
#include "design/core/monitor.h"
#include "design/light.h"
#include "design/mesh.h"
#include "design/optics.h"
#include "design/target.h"

namespace lightmill {

/// What arrives: flux per pixel of a grid over `extent` on the receiver (row 0 at the smallest y). All light through the
/// surface is 1 = landed on the grid + outside_extent + totally_reflected + what else is lost.
struct Caustic {
  Box2 extent;
  Grid<double> flux;
  double outside_extent = 0;       ///< reaches the receiver's plane beside the grid, or never
  double totally_reflected = 0;
  double enters_by_rim = 0;        ///< would have to enter through the lens's side
  // trace_beams() only:
  double fresnel_reflected = 0;    ///< partly reflected at entry and exit
  double shadowed = 0;             ///< meets the relief a second time
  double leaves_by_rim = 0;        ///< share of the light on the back that meets the lens's side first; beside the sum
  Box2 reflected_from{}, shadowed_from{}, enters_rim_from{};  ///< where on the lens (x, y) it is lost; empty: nowhere
  Box2 leaves_rim_from{};          ///< where on the back
};

struct CausticOptions {
  int pixels = 512;                 ///< along the longer side of the picture
  double angular_diameter_rad = 0;  ///< of the light (the sun: 0.0093): blurs the picture
};

/// Refracted beams of triangles: a triangle's flux (its share of the lens area) is spread evenly over the triangle that its
/// vertices' rays, bent at the vertex normals, span on the receiver; the spread is exact over pixels.
/// Light is parallel along +Z. Flux is conserved to 1e-12.
Caustic trace_mesh(const SurfaceMesh& mesh, const Lens& lens, const Receiver& receiver, const Box2& extent,
                   const CausticOptions& options = {}, const Monitor& monitor = {});

/// Any light and receiver through heights on a regular grid (node (i, j) at extent.min + pitch * (i, j), row 0 at the
/// smallest y): each grid square is a beam; normals by central differences. `picture_extent` is on the receiver. A wide
/// light blurs by the disk that it makes on an upright wall.
Caustic trace_heights(const Grid<float>& heights_mm, const Box2& lens_extent, const Lens& lens, const Light& light,
                      const Receiver& receiver, const Box2& picture_extent, const CausticOptions& options = {},
                      const Monitor& monitor = {});

/// DESIGN.md, "Measures".
struct CausticMeasures {
  double l1_error = 0;
  double psnr_db = 0;
  double flux_outside_support = 0;
  double flux_totally_reflected = 0;
};

CausticMeasures measure_caustic(const Caustic& caustic, const TargetLight& target);

/// For the eye: the picture as its reader sees it (row 0 on top), irradiance scaled so that `white` times the mean is 1.
Grid<float> display_picture(const Grid<double>& flux, ViewedFrom viewed_from, double white);

}  // namespace lightmill

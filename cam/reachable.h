// What an ideal ball can leave of a surface: its morphological closing, and where that differs from the surface.
#pragma once

#include "cam/outline.h"
#include "cam/spline_surface.h"
#include "design/core/monitor.h"

namespace lightmill {

/// Heights on a regular grid over the lens (node (i, j) at extent.min + pitch * (i, j), row 0 at smallest y).
struct ReachableSurface {
  Box2 extent;
  double pitch_mm = 0;
  Grid<float> closing_mm;           ///< lowest heights an ideal ball of this radius can leave, error below 0.2 um
  Grid<float> residue_um;           ///< closing minus design, >= 0
  double unreachable_area_mm2 = 0;  ///< where the residue is above `threshold_um`
  double threshold_um = 0.1;
  double max_residue_um = 0;
};

ReachableSurface reachable_surface(const SplineSurface& surface, double ball_radius_mm, double pitch_mm,
                                   const Monitor& monitor = {});

/// The same with nothing out of reach outside the outline: no residue there, area and highest residue without it.
ReachableSurface within(ReachableSurface reachable, const Outline& outline);

/// Angle between the normals of the closing and of the design, which the light sees; 0 where the ball reaches. From differences
/// between the nodes.
Grid<float> residue_normals_mrad(const ReachableSurface& reachable);

}  // namespace lightmill

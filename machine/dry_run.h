// What the simulated machining means: machined surface against the design, and the light it casts.
#pragma once

#include <vector>

#include "cam/reachable.h"
#include "cam/spline_surface.h"
#include "design/caustic.h"
#include "machine/stock_model.h"

namespace lightmill {

struct DeviationOptions {
  double finishing_ball_radius_mm = 2;
  double gouge_tolerance_um = 1;
  double border_mm = 0;              ///< rim left out of the measures
};

/// Machined minus design, micrometres, positive where material is left.
struct Deviation {
  Grid<float> deviation_um;          ///< at the machined surface's nodes
  double max_gouge_um = 0;           ///< deepest below the reachable surface
  Vec2 gouge_place_mm = Vec2::Zero();
  double max_cusp_um = 0;            ///< highest peak above the design where the surface is reachable
  Vec2 cusp_place_mm = Vec2::Zero();
  double p99_cusp_um = 0;
  double residue_um = 0;             ///< highest above the design where it is not reachable
  double unreachable_area_mm2 = 0;   ///< closing differs from the design (concave creases sharper than the ball)
};

Deviation measure_deviation(const MachinedSurface& machined, const SplineSurface& design, const DeviationOptions& options,
                            const Monitor& monitor = {});

/// Hand polish as a model: a Gaussian low-pass of the heights, mirrored at the border. sigma 0: as milled.
Grid<float> polish(const Grid<float>& heights_mm, double pitch_mm, double sigma_um);

}  // namespace lightmill

// What the simulated machining means: machined surface against the design, and the light it casts.
#pragma once

#include <optional>
#include <vector>

#include "cam/reachable.h"
#include "cam/spline_surface.h"
#include "design/caustic.h"
#include "machine/stock_model.h"

namespace lightmill {

struct DeviationOptions {
  double finishing_ball_radius_mm = 2;
  bool rest_pass = false;  ///< a smaller ball goes where the finishing ball does not reach: only below the design it gouges there
  double gouge_tolerance_um = 1;
  double border_mm = 0;              ///< rim left out of the measures
  std::optional<Outline> outline = {};  ///< only within it is measured, but for a rim of at most 0.1 mm; empty: everywhere
};

/// Area (seen from above) by height over the reachable surface: bin k has what stands from first_um + k bin_um on, bin_um wide. It
/// spans all but the outer thousandths, which are `below` and `above`.
struct DeviationHistogram {
  double first_um = 0, bin_um = 0;
  std::vector<double> area_mm2;
  double below_mm2 = 0, above_mm2 = 0;
};

/// Machined minus design, micrometres, positive where material is left.
struct Deviation {
  Grid<float> deviation_um;          ///< at the machined surface's nodes
  double max_gouge_um = 0;           ///< deepest below the reachable surface
  Vec2 gouge_place_mm = Vec2::Zero();
  double gouged_area_mm2 = 0;        ///< deeper than the tolerance
  double max_cusp_um = 0;            ///< highest peak over the design, along its normal, where the surface is reachable
  Vec2 cusp_place_mm = Vec2::Zero();
  double p99_cusp_um = 0;            ///< of the nodes where the surface is reachable, each with its cell's peak
  double residue_um = 0;             ///< highest above the design where it is not reachable
  DeviationHistogram histogram;      ///< of all that is measured
  double unreachable_area_mm2 = 0;   ///< closing differs from the design (concave creases sharper than the ball)
};

/// "Reachable" is where the closing stands at most ReachableSurface::threshold_um above the design at all four corners of the
/// closing's cell. The closing is compared at a pitch of at most 0.05 mm, bilinear in between (0.16 um high in the fillet of a
/// 2 mm ball). Outside the design's rectangle nothing is measured.
Deviation measure_deviation(const MachinedSurface& machined, const SplineSurface& design, const DeviationOptions& options,
                            const Monitor& monitor = {});

/// The same against a reachable surface at hand (any pitch).
Deviation measure_deviation(const MachinedSurface& machined, const SplineSurface& design, const ReachableSurface& reachable,
                            const DeviationOptions& options, const Monitor& monitor = {});

/// Hand polish as a model: a Gaussian low-pass of the heights, which go on beyond the border by point
/// reflection (planes stay planes up to the rim). sigma 0: as milled.
Grid<float> polish(const Grid<float>& heights_mm, double pitch_mm, double sigma_um);

/// A polish takes away and adds nothing: how far below the milled surface the smoothed one must lie so that it is nowhere
/// above it, which is also the mean depth removed. Inside the lens's outline all but a rim is looked at.
double polish_removal_um(const MachinedSurface& milled, const Grid<float>& polished_mm, const Outline& outline, double rim_mm);

}  // namespace lightmill

#include <algorithm>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "machine/dry_run.h"

namespace lightmill {

namespace {

/// Pitch of the closing: its fillets have the ball's curvature, so that bilinear interpolation is at most
/// pitch^2 / 8 R high, 0.16 um at R 2 mm.
constexpr double kClosingPitch_mm = 0.05;

}  // namespace

Deviation measure_deviation(const MachinedSurface& machined, const SplineSurface& design, const DeviationOptions& options,
                            const Monitor& monitor) {
  if (!(options.finishing_ball_radius_mm > 0)) {
    throw InputError("finishing_ball_radius_mm must be above 0, not " + compact(options.finishing_ball_radius_mm, 4));
  }
  const ReachableSurface reachable =
      reachable_surface(design, options.finishing_ball_radius_mm, std::max(machined.pitch_mm, kClosingPitch_mm),
                        monitor.part(0, 0.6));
  return measure_deviation(machined, design, reachable, options, monitor.part(0.6, 1));
}

}  // namespace lightmill

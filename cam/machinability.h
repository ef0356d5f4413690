// Can this surface be milled as asked? Slopes against the axis, hollows against the ball, what stays: before any pass is planned.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "cam/creases.h"
#include "cam/finishing.h"
#include "cam/outline_region.h"

namespace lightmill {

/// Slopes and hollows over a dense scan of the lens.
struct SurfaceScan {
  double steepest_rad = 0;
  Vec2 steepest_mm = Vec2::Zero();
  double most_concave_per_mm = 0;  ///< curvature of the tightest hollow; 0: convex everywhere
  Vec2 concave_mm = Vec2::Zero();
  double sharper_mm2 = 0;          ///< area of hollows with a radius below the ball's
};
SurfaceScan scan_surface(const SplineSurface& surface, const OutlineRegion& lens, double ball_radius_mm, double pitch_mm);

/// Where on the ball a pass would cut with the axis that it asks for, between axis and normal, against the window.
struct ContactWindow {
  // With the axis asked for:
  double least_rad = 0, most_rad = 0;
  double outside_share = 0;  ///< of the lens, where the contact is outside the window
  double worst_rad = 0;      ///< the contact farthest outside, or nearest to its border
  Vec2 worst_mm = Vec2::Zero();
  /// The axis that planning would begin with, meant as those of FinishOptions; empty where it refuses, or is upright.
  std::optional<double> tilt_rad, direction_rad;
  std::string refusal;     ///< why planning refuses, with the remedy; empty where it does not
};
ContactWindow contact_window(const SplineSurface& surface, const FinishOptions& options, const OutlineRegion& lens, double pitch_mm);

/// What stays above the design where a ball does not reach.
struct Leftover {
  double area_mm2 = 0;   ///< above the reachable surface's threshold; the other figures are of the same places
  double highest_um = 0, rms_um = 0;
  double most_mrad = 0, rms_mrad = 0;  ///< of the normals
};
/// In the fillets along creases, and everywhere else.
struct Leftovers {
  Leftover in_creases, elsewhere;
};
Leftovers leftovers(const ReachableSurface& reachable, const std::vector<Crease>& creases);

}  // namespace lightmill

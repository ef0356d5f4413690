// Which way the ball's axis leans: one tilt for the whole pass, or a smooth field that follows the surface.
#pragma once

#include <vector>

#include "cam/outline_region.h"
#include "cam/finishing.h"

namespace lightmill::detail {

/// The angle between axis and surface normal stays within this window: below, the ball's dead centre rubs; above, the
/// contact nears the shank.
inline constexpr double kLeastContactAngle = 10 * kPi / 180;
inline constexpr double kMostContactAngle = 55 * kPi / 180;

struct FixedTilt {
  double tilt_rad = 0;
  double direction_rad = 0;
  double least_contact_rad = 0, most_contact_rad = 0;
  [[nodiscard]] Vec3 axis() const;
};

/// All fixed tilts that keep the window, the one asked for first (if it does), then by how little they differ from it
/// (a degree of tilt weighs as much as 15 degrees of direction). Throws InputError naming the slopes if there is none.
/// Looks at `within` only, or without it at the whole surface.
std::vector<FixedTilt> fixed_tilts(const SplineSurface& surface, double tilt_rad, double direction_rad,
                                   const OutlineRegion* within = nullptr);

/// Lead/tilt: the normal, low-passed by a Gaussian of a few mm, leant forward along the passes.
class LeadField {
 public:
  /// Raises the lead above `lead_rad` if the window or the distance from the vertical asks for it. Throws InputError
  /// naming the slopes when no lead will do.
  LeadField(const SplineSurface& surface, double lead_rad, const Vec2& along = {1, 0}, const OutlineRegion* within = nullptr);
  [[nodiscard]] Vec3 axis(double x, double y) const;
  [[nodiscard]] double lead_rad() const { return lead_; }

 private:
  [[nodiscard]] Vec2 slope(double x, double y) const;
  double lead_ = 0;
  Vec2 along_;  // the passes, as seen along Z
  Vec2 first_;
  double pitch_ = 0;
  Grid<Vec2> slopes_;
};

}  // namespace lightmill::detail

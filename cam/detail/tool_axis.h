// Which way the ball's axis leans: one tilt for the whole pass, or a smooth field that follows the surface.
#pragma once

#include <string>
#include <vector>

#include "cam/outline_region.h"
#include "cam/finishing.h"

namespace lightmill::detail {

/// Within an outline, axes and cusps are judged so far beyond the lens.
inline constexpr double kJudgedBeyondMm = 0.5;

/// How far the axis leans, and where to.
struct Lean {
  double angle_rad = 0;      ///< from +Z (fixed), or from the smoothed normal (lead/tilt)
  double direction_rad = 0;  ///< from +X (fixed), or in the surface from the passes' direction (0: lead; -90 degrees: tilt to the right)
  double least_contact_rad = 0, most_contact_rad = 0;
};

[[nodiscard]] Vec3 fixed_axis(const Lean& lean);

/// All fixed axes that keep the window, the one asked for first (if it does), then by how little they differ from it
/// (a degree of tilt weighs as much as 15 degrees of direction). Throws InputError naming pass, slopes and remedy if there
/// is none. Looks at `within` only, or without it at the whole surface.
std::vector<Lean> fixed_tilts(const SplineSurface& surface, double tilt_rad, double direction_rad,
                              const OutlineRegion* within = nullptr, const std::string& pass = "finish");

/// Lead/tilt: axes that lean alike everywhere from the normal, which is low-passed by a Gaussian of a few mm.
class LeadField {
 public:
  /// `along`: the passes, as seen along Z.
  explicit LeadField(const SplineSurface& surface, const Vec2& along = {1, 0});
  [[nodiscard]] Vec3 axis(double x, double y, const Lean& lean) const;
  /// Like `fixed_tilts`, in coarser steps: the first dozen that also stay 5 degrees off the vertical, where a rotary table
  /// would spin.
  [[nodiscard]] std::vector<Lean> leans(double angle_rad, double direction_rad, const OutlineRegion* within = nullptr,
                                        const std::string& pass = "finish") const;

 private:
  [[nodiscard]] Vec2 slope(double x, double y) const;
  [[nodiscard]] Vec3 axis(const Vec2& slope, const Lean& lean) const;
  const SplineSurface& surface_;
  Vec2 along_;
  Vec2 first_;
  double pitch_ = 0;
  Grid<Vec2> slopes_;
};

}  // namespace lightmill::detail

// Ball passes over the optical surface: cutter locations from the smooth surface, stepover from the cusp height.
#pragma once

#include <optional>
#include <vector>

#include "cam/blank.h"
#include "cam/outline.h"
#include "cam/spline_surface.h"
#include "cam/toolpath.h"
#include "design/core/monitor.h"

namespace lightmill {

enum class AxisPolicy { kFixed, kVertical, kLeadTilt };

/// The angle between axis and surface normal stays within this window (but with vertical axes): below, the ball's dead centre
/// rubs; above, the contact nears the shank.
inline constexpr double kLeastContactAngle = 10 * kPi / 180;
inline constexpr double kMostContactAngle = 55 * kPi / 180;

enum class Strategy {
  kOneWay,  ///< passes along one direction, beside each other, lifted back between them
  kZigZag,  ///< every other pass backwards: quicker, but the edge cuts now with, now against the feed
  kSpiral,  ///< from the outside in, in one go, clockwise: straight sides around a rectangle, or turns like a disk's or free outline's
};

struct FinishOptions {
  std::string pass = "finish";
  double cusp_um = 1.3;     ///< the guarantee on the reachable surface (1.5 less a margin)
  double allowance_mm = 0;  ///< left on the surface (semi-finishing: 0.05)
  Strategy strategy = Strategy::kOneWay;
  double angle_rad = 0;     ///< of the passes (of the spiral's rectangle) from +X
  AxisPolicy axis = AxisPolicy::kFixed;
  double tilt_rad = 30 * kPi / 180;  ///< of the fixed axis from +Z; of lead_tilt from the smoothed normal
  double tilt_direction_rad =
      -kPi / 2;                      ///< where the axis leans, from the passes' direction (0: lead; default: to their right,
                                     ///< which makes them climb milling); tilt and direction give way to the slopes
  double chord_tolerance_mm = 5e-5;  ///< of the ball's centre path
  double longest_segment_mm = 0.2;
  double link_feed_mm_per_s = 80;  ///< kLink moves
  double max_feed_mm_per_s = 100;  ///< of the tip in cutting moves, whatever the chip would allow
  double acceleration_mm_per_s2 = 2000;  ///< of the tip in cutting moves
  double clearance_mm = 5;         ///< of the tip above the blank for rapids
  /// Only what lies within is finished, passes landing and leaving beside it; empty: the whole surface, passes from beside
  /// the blank to beside it.
  std::optional<Outline> outline;
  std::optional<RestMaterial> standing{};  ///< what stands when the pass starts: shank and holder keep clear of it
  std::vector<std::vector<Vec2>> also_along{};  ///< lines (creases) the ball follows once more after the passes
};

/// Passes along one direction (climb milling) from right to left, each entered and left beside the part in air,
/// tangentially, zig-zag or a spiral; their spacing changes slowly, so that no line shows in the light; where a short stretch alone asks for much closer
/// passes it gets pieces of its own. What begins or ends within the lens lands in a groove that is cut already. Throws InputError when no fixed tilt
/// keeps the contact off the ball's centre and the shank off the part, naming the slopes.
ToolPath plan_finishing(const SplineSurface& surface, const Blank& blank, const Cutter& ball,
                        const FinishOptions& options, const Monitor& monitor = {});

/// Only along these lines, one after the other, each reached out of a groove that the path `before` has cut, and left into one, so
/// that the ball takes off nothing where it comes down within the lens.
ToolPath plan_along(const SplineSurface& surface, const Blank& blank, const Cutter& ball, const std::vector<std::vector<Vec2>>& lines,
                    const ToolPath& before, const FinishOptions& options, const Monitor& monitor = {});

/// How the ball meets the surface in a planned pass.
struct ContactSummary {
  double least_angle_rad = 0, most_angle_rad = 0;       ///< between axis and normal
  double slowest_m_per_min = 0, fastest_m_per_min = 0;  ///< cutting speed at the contact, 2 pi R n sin(angle)
  double least_diameter_mm = 0, most_diameter_mm = 0;   ///< of the circle the contact runs on, 2 R sin(angle)
  double cutting_mm = 0;                                ///< way of the tip in cutting moves: what wears the edge
  double climb_share = 0;                               ///< of the way on the lens: the edge at the contact runs against the feed
};
/// Of cutting moves that touch within the lens, at every 20th of them.
ContactSummary contact_summary(const SplineSurface& surface, const ToolPath& path, const FinishOptions& options);

/// Light scattered by the cusps of even passes, rms on the receiver across the passes, after a polish that smooths heights by
/// a Gaussian: the cusps' parabolas as a Fourier series. A model: no polish is that even.
double blur_on_screen_mm(double radius_mm, double cusp_um, double distance_mm, double refractive_index, double polish_sigma_mm);
/// The highest cusp, at most 100 um, that keeps the blur within the budget. Throws InputError when 0.01 um does not.
double cusp_for_blur_um(double radius_mm, double blur_mm, double distance_mm, double refractive_index, double polish_sigma_mm);

/// Sigma of the polish after which even passes `stepover_mm` apart change the brightness on the receiver by at most `ripple` (a
/// share). Polished less, each cusp is a rounded little lens that draws a line of light; left raw, it scatters evenly.
double polish_that_hides_mm(double radius_mm, double stepover_mm, double distance_mm, double refractive_index, double ripple);

/// z of the centre of a ball of radius R that rests on the surface over (x, y) without gouging it anywhere (the
/// surface's dilation); exact to 1e-6 mm by Newton on the smooth surface.
double ball_centre_height(const SplineSurface& surface, double radius_mm, double x, double y);

}  // namespace lightmill

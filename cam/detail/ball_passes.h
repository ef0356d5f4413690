// Where the passes of a ball cutter go: centre paths in upright planes, spaced by the cusp they leave.
#pragma once

#include <functional>
#include <utility>
#include <vector>

#include "cam/detail/ball_contact.h"
#include "cam/outline_region.h"
#include "design/core/monitor.h"

namespace lightmill::detail {

/// A vertex of a centre path.
struct PathPoint {
  double x = 0;
  double z = 0;  ///< of the ball's centre
  Vec2 contact = Vec2::Zero();
};

/// The way of a ball's centre along +X of turned axes in the plane y, as the polyline that will be milled.
struct CentrePath {
  Turn turn;
  double y = 0;
  bool joined = false;  ///< begins where the path before ends
  std::vector<PathPoint> points;
  /// How the ball gets there and away within the lens, in the workpiece's axes: it comes down in a groove that is cut already, where
  /// it takes off nothing, and goes over to the path; and so back. Empty: straight on.
  std::vector<Vec2> before, after;
};

struct PathTolerance {
  double chord_mm = 5e-5;
  double longest_mm = 0.2;
  double slope = 2e-3;        ///< between a chord and the exact path at its ends
  double shortest_mm = 0.01;  ///< at a kink (the ball changes flanks in a crease): the chord is above the path there
};

/// Vertices are exact; between them the chord stays within the tolerance.
CentrePath centre_path(const TurnedBall& ball, double y, double from_x, double to_x, const PathTolerance& tolerance);

/// Over the legs of a polyline in the plane, all but the first one joined.
std::vector<CentrePath> centre_paths_along(const BallContact& ball, const std::vector<Vec2>& line, const PathTolerance& tolerance);

/// In the passes' axes, but for `wanted`.
struct SpacingOptions {
  double cutting_radius_mm = 2;  ///< R of the cutter; `ball` has R + allowance
  double cusp_mm = 1.3e-3;       ///< highest cusp on the reachable surface, along its normal
  std::function<std::pair<double, double>(double y)> ends;  ///< x where a full pass begins and ends
  const OutlineRegion* wanted = nullptr;                     ///< where cusps matter; null: the surface's rectangle
  double from_y = 0, to_y = 0;   ///< of the first and the last pass, which lie up to half a spacing beyond
  double landing_mm = 2;         ///< on which infill comes down in the groove of the pass before, and lifts
  PathTolerance tolerance;
};

struct SpacedPasses {
  std::vector<CentrePath> paths;  ///< y growing; infill between the passes it belongs to
  double widest_mm = 0;           ///< distance between neighbouring full passes
  double highest_cusp_mm = 0;     ///< expected on the reachable surface
  double above_limit_mm2 = 0;     ///< reachable area where it is above the limit
  long infill_pieces = 0;
};

/// Passes as far from each other as the cusp allows, at a spacing that changes slowly with y: neighbouring cusps that
/// differ would leave lines in the light. Where a short stretch asks for much closer passes than all else (a crease) it
/// gets infill pieces instead, which begin and end in the groove of the pass before, or run out to where passes end. The cusp at a surface point is its distance to the nearest of the two polylines less R.
/// Points that no ball can reach (closing above the surface by 0.1 um) ask for nothing.
SpacedPasses space_passes(const TurnedBall& ball, const SpacingOptions& options, const Monitor& monitor);

/// A spiral of straight sides from the rectangle `around` to its middle, clockwise, in one go (the first side begins at
/// `begin_y`). Its turns are as far from each other as the cusp allows on all four sides, and their distance changes
/// slowly; where a short stretch asks for much closer turns there are pieces after the spiral.
SpacedPasses space_spiral(const TurnedBall& ball, const SpacingOptions& options, const Box2& around, double begin_y, const Monitor& monitor);

/// A spiral from a closed line to its middle, in one go: `outermost`, clockwise from its farthest place from `middle` on, and smaller
/// and smaller turns that are like it. They are as far from each other as the cusp allows all around, and their distance changes slowly;
/// where a short stretch asks for much closer turns there are pieces of them after the spiral.
SpacedPasses space_outline_spiral(const BallContact& ball, const SpacingOptions& options, const Vec2& middle, const std::vector<Vec2>& outermost,
                                  const Monitor& monitor);

/// Stepover on a plane along the passes, from the cusp: s = 2 sqrt(h (2 R - h)).
double flat_stepover_mm(double radius_mm, double cusp_mm);

}  // namespace lightmill::detail

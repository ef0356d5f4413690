// Corners of a contour that are rounded or chamfered, in closed form.
#pragma once

#include "machine/detail/cutter_compensation.h"

namespace lightmill::detail {

struct Corner {
  double size_mm = 0;  ///< the rounding's radius, or what a chamfer takes from either path
  bool chamfer = false;
};

/// What is left of the paths beside a corner, and what stands between; none of those that have no length.
struct CutCorner {
  std::optional<ContourMove> before, cut, next;
};

/// `before` leads from `from` to the corner, `next` on from there, both in the plane u, v alone; the cut has next's
/// feed. Rejects what is larger than the paths beside it.
CutCorner cut_corner(const AxisValues& from, const ContourMove& before, const ContourMove& next, int u, int v,
                     const Corner& corner, int column);

/// Where a move that begins at `from` leads first, and where at its end.
Vec2 first_direction(const AxisValues& from, const ContourMove& move, int u, int v);
Vec2 last_direction(const AxisValues& from, const ContourMove& move, int u, int v);

}  // namespace lightmill::detail

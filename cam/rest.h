// A rest pass: a smaller ball along the concave creases that the finishing ball does not reach into.
#pragma once

#include "cam/creases.h"
#include "cam/finishing.h"

namespace lightmill {

struct RestPlan {
  ToolPath path;                   ///< pass "rest"; without moves where there is no crease
  std::size_t ways = 0;            ///< along creases, several beside each other in each
  // Over all that the finishing ball does not reach, above the design:
  double highest_before_um = 0, highest_after_um = 0;
  double area_before_mm2 = 0, area_after_mm2 = 0;  ///< where more stands than the cusp height asked for
};

/// Ways along every crease beside each other, as wide as what `reachable` (of the finishing ball) says is not reached, one
/// stepover of the small ball apart. They come out of the grooves of `finish`, and go back into them. What they leave is predicted by the balls' undersides at the nodes of `reachable`.
/// Throws InputError as plan_finishing() does.
RestPlan plan_rest(const SplineSurface& surface, const Blank& blank, const Cutter& ball, const std::vector<Crease>& creases,
                   const ReachableSurface& reachable, const ToolPath& finish, const FinishOptions& options, const Monitor& monitor = {});

/// A crease's line without the steps of the grid it was found on, in legs of about 0.3 mm: where a ball can follow it.
std::vector<Vec2> line_to_follow(const Crease& crease);

}  // namespace lightmill

// Wanted slopes without hollows that no ball reaches.
#pragma once

#include <array>
#include <vector>

#include "design/core/geometry.h"
#include "design/detail/creases.h"

namespace lightmill::detail {

/// The slopes next to `slopes` whose change along each edge asks for no hollow sharper than `radius_mm`, creases apart: what is
/// too much is shared by both ends, again and again, until less than a hundredth of the limit is left or sweeps are used up.
std::vector<Vec2> limited_hollows(std::vector<Vec2> slopes, const std::vector<Vec3>& positions,
                                  const std::vector<std::array<int, 2>>& edges, const Creases& creases, double radius_mm);

}  // namespace lightmill::detail

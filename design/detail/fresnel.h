// Fresnel mapping: the slopes and normals that send parallel light to given points of the receiver.
#pragma once

#include <vector>

#include "design/mesh.h"
#include "design/optics.h"

namespace lightmill::detail {

/// Normals that bend light along +Z at each position into the direction of its target. Throws InputError where no
/// surface can bend light that far (n cos of the deviation must exceed 1).
std::vector<Vec3> fresnel_normals(const std::vector<Vec3>& positions, const std::vector<Vec2>& targets_mm,
                                  const Lens& lens, const Receiver& receiver);

/// The slopes (dz/dx, dz/dy) of a surface with these normals.
std::vector<Vec2> slopes_of(const std::vector<Vec3>& normals);

}  // namespace lightmill::detail

// Fresnel mapping: the slopes and normals that send light to given points of the receiver.
#pragma once

#include <vector>

#include "design/mesh.h"
#include "design/optics.h"

namespace lightmill::detail {

/// Normals that bend light of unit direction `incoming` (inside the lens) at each position towards its target. Throws
/// InputError with the place where no surface can bend light that far, or only an overhanging one.
std::vector<Vec3> fresnel_normals(const std::vector<Vec3>& positions, const std::vector<Vec3>& incoming,
                                  const std::vector<Vec2>& targets_mm, const Lens& lens, const Receiver& receiver);

/// The slopes (dz/dx, dz/dy) of a surface with these normals.
std::vector<Vec2> slopes_of(const std::vector<Vec3>& normals);

}  // namespace lightmill::detail

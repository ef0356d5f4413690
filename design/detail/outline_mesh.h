// Triangle meshes of outlines with holes, by constrained Delaunay refinement.
#pragma once

#include <array>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

struct PlanarMesh {
  std::vector<Vec2> vertices;
  std::vector<std::array<int, 3>> triangles;  ///< counter-clockwise
};

/// Fills the closed loops by the even-odd rule with triangles of edges about `edge_mm` or shorter. Loops may cross.
/// `inner` places within them become vertices too.
PlanarMesh outline_mesh(const std::vector<std::vector<Vec2>>& loops, double edge_mm,
                        const std::vector<Vec2>& inner = {});

/// The loop in equal steps of about `pitch_mm` between its corners, which stay.
std::vector<Vec2> resampled(const std::vector<Vec2>& loop, double pitch_mm);

/// Even-odd rule.
bool inside_outline(const std::vector<std::vector<Vec2>>& loops, const Vec2& place);

}  // namespace lightmill::detail

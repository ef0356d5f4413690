// The normal at a place of a surface that is known on one side only.
#pragma once

#include <optional>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

/// That of the parabola through `at` which fits the places around best, near ones before far ones; none where they are fewer than
/// six, lie nearly on a line, or on two, which say nothing of the slope across: its terms cancel with the curvature's.
std::optional<Vec3> parabola_normal(const Vec3& at, const std::vector<Vec3>& around);

}  // namespace lightmill::detail

// The block of material the lens is milled from.
#pragma once

#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"

namespace lightmill {

/// Room that clamps or a vise's jaws take beside or over the block: an upright box in the workpiece frame.
struct KeepOut {
  Vec3 min_mm = Vec3::Zero();
  Vec3 max_mm = Vec3::Zero();
};

/// A rectangular block standing on z = 0 of the workpiece frame, centred on the z axis.
struct Blank {
  Vec2 size_mm{100, 100};
  double height_mm = 0;
  std::vector<KeepOut> keep_outs{};  ///< nothing of a cutter may enter one
};

/// What stands when a pass is over: heights at even nodes from corner to corner of the blank.
struct RestMaterial {
  Box2 extent;
  Grid<float> heights_mm;
};

}  // namespace lightmill

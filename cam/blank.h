// The block of material the lens is milled from.
#pragma once

#include "design/core/geometry.h"

namespace lightmill {

/// A rectangular block standing on z = 0 of the workpiece frame, centred on the z axis.
struct Blank {
  Vec2 size_mm{100, 100};
  double height_mm = 0;
};

}  // namespace lightmill

// Lens, light and receiver as plain data, and refraction at one point.
#pragma once

#include "design/core/geometry.h"
#include "design/target.h"

namespace lightmill {

/// Refractive indices along the light: before and after a surface. (For the lens's exit: {1.49, 1}.)
struct Indices {
  double before = 1;
  double after = 1;
};

struct Lens {
  enum class Shape { kRectangle, kDisk };
  Shape shape = Shape::kRectangle;
  Vec2 size_mm{100, 100};
  double thickness_mm = 10;        ///< z of the lens's thinnest place (DESIGN.md, "Height gauge and d_TH")
  double refractive_index = 1.49;  ///< PMMA
};

/// A plane receiver z = lens.thickness_mm + distance_mm, origin on the z axis.
struct Receiver {
  double distance_mm = 300;
  ViewedFrom viewed_from = ViewedFrom::kLens;
};

/// Unit surface normal (towards the light's exit) that bends unit direction `before` into unit direction `after`:
/// parallel to n_i d_i - n_t d_t, turned to the side of the outgoing light.
Vec3 bending_normal(const Vec3& before, const Vec3& after, const Indices& indices);

/// Unit direction behind a surface with unit normal `normal` (either side). Returns false on total reflection.
bool refract(const Vec3& before, const Vec3& normal, const Indices& indices, Vec3& after);

}  // namespace lightmill

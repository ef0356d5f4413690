// Lens, light and receiver as plain data, and refraction at one point.
#pragma once

#include <vector>

#include "design/base.h"
#include "design/core/geometry.h"
#include "design/target.h"

namespace lightmill {

/// Refractive indices along the light: before and after a surface. (For the lens's exit: {1.49, 1}.)
struct Indices {
  double before = 1;
  double after = 1;
};

struct Lens {
  enum class Shape { kRectangle, kDisk, kOutline };
  Shape shape = Shape::kRectangle;
  Vec2 size_mm{100, 100};          ///< bounding box, centred; a disk's diameter twice
  std::vector<std::vector<Vec2>> outline_mm;  ///< closed loops of kOutline, inside by the even-odd rule: holes, parts
  double thickness_mm = 10;        ///< z of the lens's thinnest place (DESIGN.md, "Height gauge and d_TH")
  double refractive_index = 1.49;  ///< PMMA
  Base base;                       ///< the optical surface before it is designed
};

/// Whether a place lies on the lens as seen along Z, its rim included.
bool inside_lens(const Lens& lens, const Vec2& place_mm);
/// Whether light that meets `place_mm` and crossed z = 0 at `entry_mm` came in through the back; what comes straight up did.
bool enters_back(const Lens& lens, const Vec2& entry_mm, const Vec2& place_mm);

/// A plane receiver; its origin is at z = lens.thickness_mm + distance_mm, `shift_mm` beside the z axis.
struct Receiver {
  double distance_mm = 300;
  ViewedFrom viewed_from = ViewedFrom::kLens;
  Vec2 shift_mm{0, 0};
  Vec2 tilt_rad{0, 0};             ///< about the lens's X, then about its Y
};

/// Where the receiver is, in the lens frame: a point (x, y) of it is origin + x x_axis + y y_axis.
struct ReceiverFrame {
  Vec3 origin_mm, x_axis, y_axis, normal;
  /// Where a ray meets the plane, in receiver coordinates. False when it does not.
  bool meet(const Vec3& from_mm, const Vec3& direction, Vec2& place_mm) const;
};
ReceiverFrame receiver_frame(const Lens& lens, const Receiver& receiver);

/// Unit surface normal (towards the light's exit) that bends unit direction `before` into unit direction `after`:
/// parallel to n_i d_i - n_t d_t, turned to the side of the outgoing light.
Vec3 bending_normal(const Vec3& before, const Vec3& after, const Indices& indices);

/// Unit direction behind a surface with unit normal `normal` (either side). Returns false on total reflection.
bool refract(const Vec3& before, const Vec3& normal, const Indices& indices, Vec3& after);

}  // namespace lightmill

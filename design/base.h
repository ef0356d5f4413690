// The base surface: the shape of the optical surface before it is designed, which the source light passes [paper sec. 4.2].
#pragma once

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/detail/triangle_buckets.h"
#include "design/mesh.h"

namespace lightmill {

/// Heights over the lens's x-y plane. Only differences count: whoever places a base puts its lowest place at
/// z = lens.thickness_mm.
struct Base {
  enum class Kind { kFlat, kSphere, kCylinder, kImage, kMesh };
  Kind kind = Kind::kFlat;
  double radius_mm = 200;     ///< sphere and cylinder; above 0 bulges towards the exit, below 0 is hollow
  double axis_rad = 0;        ///< of the cylinder, from +X
  Grid<float> heights_mm;     ///< image: bilinear between the pixels' centres, row 0 at the smallest y
  Box2 extent;                ///< of the image
  SurfaceMesh mesh;           ///< a height field; linear on each triangle, normals interpolated
};

struct BasePoint {
  double height_mm = 0;
  Vec3 normal = Vec3::UnitZ();  ///< unit, towards the exit
};

/// A base prepared for look-ups; `base` must outlive it.
class BaseSurface {
 public:
  explicit BaseSurface(const Base& base);
  /// Throws InputError where there is none (beyond a sphere's equator, beside a mesh).
  [[nodiscard]] BasePoint at(const Vec2& place_mm) const;

 private:
  const Base& base_;
  detail::TriangleBuckets triangles_;  ///< of a mesh
};

}  // namespace lightmill

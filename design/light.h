// The light before the lens, and what of it meets the optical surface after the flat back z = 0.
#pragma once

#include <array>
#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/detail/triangle_buckets.h"
#include "design/optics.h"

namespace lightmill {

/// A beam as a triangle mesh: light leaves each vertex along its direction; in between all is linear.
struct LightMesh {
  std::vector<Vec3> positions_mm;         ///< behind the back, z <= 0
  std::vector<Vec3> directions;           ///< in air, z > 0
  std::vector<double> intensities;        ///< flux per mm^2 of the mesh
  std::vector<std::array<int, 3>> triangles;
};

/// A factor on the light over the back plane of the lens.
struct Profile {
  enum class Kind { kUniform, kGaussian, kImage };
  Kind kind = Kind::kUniform;
  double sigma_mm = 30;                   ///< gaussian
  Vec2 centre_mm{0, 0};
  Grid<float> image;                      ///< over the lens's bounding box, row 0 at the smallest y; no light beside it
};

struct Light {
  enum class Kind { kParallel, kPoint, kMesh };
  Kind kind = Kind::kParallel;
  Vec3 direction = Vec3::UnitZ();         ///< parallel: in air, z > 0; need not be unit
  Vec3 position_mm{0, 0, -500};           ///< point: z < 0; sends the same flux into every solid angle
  LightMesh mesh;
  Profile profile;
};

struct IncomingRay {
  Vec3 direction = Vec3::UnitZ();         ///< unit, inside the lens; beside a mesh light as its rim goes on
  double irradiance = 0;                  ///< flux per mm^2 of the plane z = const; 0 beside the light
  Vec2 entry_mm{0, 0};                    ///< where it came through the back
};

/// A light in front of the flat back of a lens, prepared for look-ups. Fresnel losses are not counted.
class Illumination {
 public:
  /// Throws InputError when the light cannot reach the lens. `lens` gives the index, the box and the reference height.
  Illumination(const Light& light, const Lens& lens);
  [[nodiscard]] IncomingRay at(const Vec3& point_mm) const;

 private:
  [[nodiscard]] double profile(const Vec2& entry) const;
  [[nodiscard]] IncomingRay from_point(const Vec3& point) const;
  [[nodiscard]] IncomingRay from_mesh(const Vec3& point) const;
  /// The triangle at a place, or the one that ends nearest to it, and the corners' weights there.
  [[nodiscard]] int triangle_at(const Vec2& place, Vec3& weights) const;

  Light light_;
  double index_;
  double reference_mm_;
  Box2 box_;
  // Mesh light, traced to z = reference.
  std::vector<Vec3> inside_;              // directions
  std::vector<Vec2> entries_;
  std::vector<Vec2> landed_;
  std::vector<double> densities_;         // flux per mm^2 of the plane z = reference
  struct RimEdge {
    int from, to, triangle;
  };
  std::vector<RimEdge> rim_;
  detail::TriangleBuckets buckets_;
};

}  // namespace lightmill

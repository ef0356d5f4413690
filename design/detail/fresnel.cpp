#include "design/detail/fresnel.h"

#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill::detail {

std::vector<Vec3> fresnel_normals(const std::vector<Vec3>& positions, const std::vector<Vec2>& targets_mm,
                                  const Lens& lens, const Receiver& receiver) {
  const double receiver_z = lens.thickness_mm + receiver.distance_mm;
  const Indices indices{lens.refractive_index, 1.0};
  std::vector<Vec3> normals(positions.size());
  for (std::size_t v = 0; v < positions.size(); ++v) {
    const Vec3 way = Vec3(targets_mm[v].x(), targets_mm[v].y(), receiver_z) - positions[v];
    const Vec3 after = way.normalized();
    if (!(way.z() > 0 && lens.refractive_index * after.z() > 1)) {
      throw InputError("surface: light would have to bend by " +
                       fixed(std::atan2(way.head<2>().norm(), way.z()) * 180 / kPi, 1) + " degrees, at most " +
                       fixed(std::acos(1 / lens.refractive_index) * 180 / kPi, 1) +
                       " are possible: enlarge receiver.distance_mm or make target.size_mm more like the lens");
    }
    normals[v] = bending_normal(Vec3::UnitZ(), after, indices);
  }
  return normals;
}

std::vector<Vec2> slopes_of(const std::vector<Vec3>& normals) {
  std::vector<Vec2> slopes(normals.size());
  for (std::size_t v = 0; v < normals.size(); ++v) slopes[v] = -normals[v].head<2>() / normals[v].z();
  return slopes;
}

}  // namespace lightmill::detail

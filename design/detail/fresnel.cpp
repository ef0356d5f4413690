#include "design/detail/fresnel.h"

#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill::detail {

std::vector<Vec3> fresnel_normals(const std::vector<Vec3>& positions, const std::vector<Vec3>& incoming,
                                  const std::vector<Vec2>& targets_mm, const Lens& lens, const Receiver& receiver) {
  constexpr double kSteepest = 0.05;  // z of the normal: 87 degrees
  const ReceiverFrame frame = receiver_frame(lens, receiver);
  const Indices indices{lens.refractive_index, 1.0};
  const auto place = [&](std::size_t v) {
    return " at lens x = " + fixed(positions[v].x(), 2) + ", y = " + fixed(positions[v].y(), 2) + " mm";
  };
  std::vector<Vec3> normals(positions.size());
  for (std::size_t v = 0; v < positions.size(); ++v) {
    const Vec3 target = frame.origin_mm + targets_mm[v].x() * frame.x_axis + targets_mm[v].y() * frame.y_axis;
    const Vec3 after = (target - positions[v]).normalized();
    if (!(after.dot(frame.normal) > 0)) {
      throw InputError("surface: light" + place(v) +
                       " would have to meet the receiver from behind: enlarge receiver.distance_mm or tilt it less");
    }
    const double cosine = std::clamp(incoming[v].dot(after), -1.0, 1.0);
    if (!(lens.refractive_index * cosine > 1)) {
      throw InputError("surface: light" + place(v) + " would have to bend by " +
                       fixed(std::acos(cosine) * 180 / kPi, 1) + " degrees, at most " +
                       fixed(std::acos(1 / lens.refractive_index) * 180 / kPi, 1) +
                       " are possible: enlarge receiver.distance_mm or make target.size_mm more like the lens");
    }
    normals[v] = bending_normal(incoming[v], after, indices);
    if (!(normals[v].z() > kSteepest)) {
      throw InputError("surface: it would have to stand upright or overhang" + place(v) +
                       ": bring the light nearer to the lens's axis, or the receiver");
    }
  }
  return normals;
}

std::vector<Vec2> slopes_of(const std::vector<Vec3>& normals) {
  std::vector<Vec2> slopes(normals.size());
  for (std::size_t v = 0; v < normals.size(); ++v) slopes[v] = -normals[v].head<2>() / normals[v].z();
  return slopes;
}

}  // namespace lightmill::detail

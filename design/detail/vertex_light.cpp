#include "design/detail/vertex_light.h"

#include <cmath>

#include "design/core/errors.h"
#include "design/core/parallel.h"

namespace lightmill::detail {

LitBase::LitBase(const Lens& lens, const Light& light, const Receiver& receiver, double base_floor_mm)
    : lens_(lens),
      base_(lens.base),
      illumination_(light, lens),
      frame_(receiver_frame(lens, receiver)),
      box_(Box2::centred(lens.size_mm)),
      lift_mm_(lens.thickness_mm - base_floor_mm) {}

/// Slanted rays leave the lens's box between the base and the relief: there the base goes on along its tangent.
BasePoint LitBase::base_beyond(const Vec2& place) const {
  const Vec2 inside = place.cwiseMax(box_.min).cwiseMin(box_.max);
  BasePoint point = base_.at(inside);
  point.height_mm -= point.normal.head<2>().dot(place - inside) / point.normal.z();
  return point;
}

VertexLight LitBase::at(const Vec3& point) const {
  const IncomingRay ray = illumination_.at(point);
  VertexLight light;
  light.direction = ray.direction;
  // Irradiance is told for planes z = const.
  light.flux = ray.irradiance / ray.direction.z() * ray.direction;

  // Where the ray meets the base: Newton along the ray. The base is known to be nearly flat beside the ray's slant.
  constexpr int kTurns = 30;
  constexpr double kClose = 1e-11;  // mm
  Vec3 place = point;
  BasePoint base = base_beyond(place.head<2>());
  for (int turn = 0; turn < kTurns; ++turn) {
    const double above = place.z() - base.height_mm - lift_mm_;
    if (std::abs(above) < kClose) break;
    const double approach = ray.direction.dot(base.normal) / base.normal.z();
    if (!(approach > 0)) return light;
    place -= above / approach * ray.direction;
    base = base_beyond(place.head<2>());
  }
  Vec3 unbent;
  light.mapped = refract(ray.direction, base.normal, {lens_.refractive_index, 1}, unbent) &&
                 frame_.meet(place, unbent, light.source_mm);
  return light;
}

std::vector<VertexLight> LitBase::at(const std::vector<Vec3>& points) const {
  std::vector<VertexLight> lights(points.size());
  parallel_blocks(points.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) lights[p] = at(points[p]);
  });
  return lights;
}

}  // namespace lightmill::detail

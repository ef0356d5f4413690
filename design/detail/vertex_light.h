// The light that meets a place of the optical surface, and where it would land if the surface were still the base.
#pragma once

#include <vector>

#include "design/light.h"
#include "design/optics.h"

namespace lightmill::detail {

struct VertexLight {
  Vec3 direction = Vec3::UnitZ();  ///< unit, inside the lens
  Vec3 flux = Vec3::Zero();        ///< flux per mm^2 of a plane at right angles, along `direction`
  Vec2 source_mm{0, 0};            ///< where it lands unbent, on the receiver: the place the transport map knows
  bool mapped = false;             ///< false: the base surface loses this ray
};

/// What a designed surface is lit by. The base stands on z = lens.thickness_mm with its lowest place on the lens.
class LitBase {
 public:
  /// `base_floor_mm`: height of the base's lowest place in the base's own heights.
  LitBase(const Lens& lens, const Light& light, const Receiver& receiver, double base_floor_mm);
  [[nodiscard]] VertexLight at(const Vec3& point_mm) const;
  [[nodiscard]] std::vector<VertexLight> at(const std::vector<Vec3>& points_mm) const;

 private:
  [[nodiscard]] BasePoint base_beyond(const Vec2& place_mm) const;

  const Lens& lens_;
  BaseSurface base_;
  Illumination illumination_;
  ReceiverFrame frame_;
  Box2 box_;
  double lift_mm_;
};

}  // namespace lightmill::detail

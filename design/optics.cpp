#include "design/optics.h"

#include <Eigen/Geometry>
#include <cmath>

#include "design/detail/outline_mesh.h"

namespace lightmill {

bool inside_lens(const Lens& lens, const Vec2& place) {
  constexpr double kRounding = 1 + 1e-9;
  if (lens.shape == Lens::Shape::kOutline) return detail::inside_outline(lens.outline_mm, place);
  if (lens.shape == Lens::Shape::kDisk) return place.norm() <= kRounding * lens.size_mm.x() / 2;
  return Box2::centred(kRounding * lens.size_mm).contains(place);
}

bool enters_back(const Lens& lens, const Vec2& entry, const Vec2& place) {
  constexpr double kStraight = 1e-9;  // mm, and as a share of the way: a vertex on the rim belongs to the lens
  const Vec2 way = place - entry;
  return way.norm() < kStraight || inside_lens(lens, entry) || inside_lens(lens, entry + kStraight * way);
}

Vec3 bending_normal(const Vec3& before, const Vec3& after, const Indices& indices) {
  const Vec3 normal = (indices.before * before - indices.after * after).normalized();
  return normal.dot(after) < 0 ? Vec3(-normal) : normal;
}

bool refract(const Vec3& before, const Vec3& normal, const Indices& indices, Vec3& after) {
  // Snell: the tangential part of index times direction is the same on both sides.
  const double along_normal = before.dot(normal);
  const Vec3 onward = along_normal < 0 ? Vec3(-normal) : normal;
  const Vec3 tangential = (indices.before / indices.after) * (before - std::abs(along_normal) * onward);
  const double cos_squared = 1.0 - tangential.squaredNorm();
  if (!(cos_squared >= 0.0)) return false;
  after = tangential + std::sqrt(cos_squared) * onward;
  return true;
}

bool ReceiverFrame::meet(const Vec3& from_mm, const Vec3& direction, Vec2& place_mm) const {
  const double approach = direction.dot(normal);
  const double along = (origin_mm - from_mm).dot(normal) / approach;
  if (!(approach > 0 && along > 0)) return false;
  const Vec3 offset = from_mm + along * direction - origin_mm;
  place_mm = {offset.dot(x_axis), offset.dot(y_axis)};
  return place_mm.allFinite();
}

ReceiverFrame receiver_frame(const Lens& lens, const Receiver& receiver) {
  const Eigen::Matrix3d turn = (Eigen::AngleAxisd(receiver.tilt_rad.y(), Vec3::UnitY()) *
                                Eigen::AngleAxisd(receiver.tilt_rad.x(), Vec3::UnitX()))
                                   .toRotationMatrix();
  return {Vec3(receiver.shift_mm.x(), receiver.shift_mm.y(), lens.thickness_mm + receiver.distance_mm), turn.col(0),
          turn.col(1), turn.col(2)};
}

}  // namespace lightmill

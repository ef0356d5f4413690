#include "design/optics.h"

#include <cmath>

namespace lightmill {

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

}  // namespace lightmill

#include "design/optics.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

namespace lightmill {
namespace {

Vec3 direction(double polar, double azimuth) {
  return {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth), std::cos(polar)};
}

double any_in(double low, double high) {
  return low + (high - low) * (*rc::gen::inRange(0, 1000001)) * 1e-6;
}

RC_GTEST_PROP(Refraction, SinesAreInTheRatioOfTheIndicesAndRaysInOnePlane, ()) {
  const Indices indices{any_in(1, 2), any_in(1, 2)};
  const Vec3 normal = direction(any_in(0, kPi), any_in(0, 2 * kPi));
  const Vec3 before = direction(any_in(0, kPi), any_in(0, 2 * kPi));
  Vec3 after;
  const double sin_before = before.cross(normal).norm();
  const double sin_after = indices.before / indices.after * sin_before;
  RC_PRE(std::abs(sin_after - 1) > 1e-6);
  RC_ASSERT(refract(before, normal, indices, after) == (sin_after < 1));
  if (sin_after >= 1) return;
  RC_ASSERT(std::abs(after.norm() - 1) < 1e-12);
  RC_ASSERT(std::abs(after.cross(normal).norm() - sin_after) < 1e-12);
  RC_ASSERT(std::abs(after.dot(before.cross(normal))) < 1e-12);
  RC_ASSERT(after.dot(normal) * before.dot(normal) >= 0);  // light goes on, it does not turn back
}

RC_GTEST_PROP(Refraction, EitherSideOfTheNormalGivesTheSameRay, ()) {
  const Vec3 normal = direction(any_in(0, 0.6), any_in(0, 2 * kPi));
  Vec3 one, other;
  RC_ASSERT(refract(Vec3::UnitZ(), normal, {1.49, 1}, one) && refract(Vec3::UnitZ(), -normal, {1.49, 1}, other));
  RC_ASSERT((one - other).norm() < 1e-15);
}

RC_GTEST_PROP(BendingNormal, BendsLightIntoTheWantedDirection, ()) {
  const double n = any_in(1.05, 2);
  // A ray that leaves the lens can bend by at most acos(1 / n).
  const Vec3 after = direction(any_in(0, 0.999) * std::acos(1 / n), any_in(0, 2 * kPi));
  const Vec3 normal = bending_normal(Vec3::UnitZ(), after, {n, 1});
  Vec3 bent;
  RC_ASSERT(std::abs(normal.norm() - 1) < 1e-12);
  RC_ASSERT(normal.dot(after) > 0);
  RC_ASSERT(refract(Vec3::UnitZ(), normal, {n, 1}, bent));
  RC_ASSERT((bent - after).norm() < 1e-6);  // at the limit the sine's derivative vanishes
}

TEST(BendingNormal, OfAPrismIsKnown) {
  // A surface tilted by 30 degrees in glass of index 1.5: asin(0.75) - 30 degrees = 18.59 degrees of deviation.
  const Vec3 normal(std::sin(kPi / 6), 0, std::cos(kPi / 6));
  Vec3 after;
  ASSERT_TRUE(refract(Vec3::UnitZ(), normal, {1.5, 1}, after));
  EXPECT_NEAR(std::atan2(-after.x(), after.z()), std::asin(0.75) - kPi / 6, 1e-12);  // away from the normal
  EXPECT_LT((bending_normal(Vec3::UnitZ(), after, {1.5, 1}) - normal).norm(), 1e-12);
}

}  // namespace
}  // namespace lightmill

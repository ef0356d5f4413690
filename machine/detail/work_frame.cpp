#include "machine/detail/work_frame.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

namespace lightmill::detail {

namespace {

constexpr double kPole = 1e-9;        // an axis nearer to the inner axis leaves its angle free
constexpr double kReachSlack = 1e-7;  // axes as measured miss the pole by some arc seconds
constexpr double kAngleSlack_rad = 1e-9;

/// Sine and cosine, exact at quarter turns.
std::pair<double, double> sine_cosine(double angle_rad) {
  const double quarters = angle_rad / (kPi / 2), nearest = std::round(quarters);
  if (std::abs(quarters - nearest) > 1e-12) return {std::sin(angle_rad), std::cos(angle_rad)};
  constexpr double kSines[] = {0, 1, 0, -1};
  const auto n = static_cast<std::size_t>(std::fmod(std::fmod(nearest, 4) + 4, 4));
  return {kSines[n], kSines[(n + 1) % 4]};
}

/// The angle plus whole turns, within the limits and as near to `from` as they allow.
std::optional<double> within(double angle, double from, const RotaryAxis& axis) {
  double q = from + std::remainder(angle - from, 2 * kPi);
  if (q < axis.min_rad - kAngleSlack_rad) q += 2 * kPi * std::ceil((axis.min_rad - kAngleSlack_rad - q) / (2 * kPi));
  if (q > axis.max_rad + kAngleSlack_rad) q -= 2 * kPi * std::ceil((q - axis.max_rad - kAngleSlack_rad) / (2 * kPi));
  if (!(q >= axis.min_rad - kAngleSlack_rad && q <= axis.max_rad + kAngleSlack_rad)) return {};
  return std::clamp(q, axis.min_rad, axis.max_rad);
}

}  // namespace

WorkFrame operator*(const WorkFrame& outer, const WorkFrame& inner) {
  return {outer.turn * inner.turn, outer.turn * inner.origin_mm + outer.origin_mm};
}

Eigen::Matrix3d turn_about(int axis, double angle_rad) {
  const auto [s, c] = sine_cosine(angle_rad);
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  R(u, u) = R(v, v) = c;
  R(v, u) = s;
  R(u, v) = -s;
  return R;
}

Eigen::Matrix3d turn_xyz(double x_rad, double y_rad, double z_rad) {
  return turn_about(2, z_rad) * turn_about(1, y_rad) * turn_about(0, x_rad);
}

std::vector<RotaryAngles> angles_for(const MachineModel& machine, WorkpieceView& view, const Vec3& axis_W,
                                     const RotaryAngles& from) {
  // On every chain the inner turn comes last between the machine's Z and the cutter's axis in the work, so the outer
  // angle alone decides on how far that leans from the inner axis k: k . axis(outer) = c0 + c1 cos + c2 sin, known from
  // three places.
  const auto axis = [&](double outer, double inner) { return view.cutter({0, 0, 0, outer, inner}, 0).axis; };
  const Vec3 wanted = axis_W.normalized(), k = machine.inner.axis.normalized();
  const double at_0 = k.dot(axis(0, 0)), at_90 = k.dot(axis(kPi / 2, 0)), at_180 = k.dot(axis(kPi, 0));
  const double c0 = (at_0 + at_180) / 2, c1 = (at_0 - at_180) / 2, c2 = at_90 - c0;
  const double reach = std::hypot(c1, c2);
  std::vector<RotaryAngles> found;
  if (!(reach > kPole)) return found;
  // One less the cosine of how far the outer angle is from the middle, by differences that keep small leans exact.
  const double lean = (reach + c0 - 1 + (k - wanted).squaredNorm() / 2) / reach;
  if (!(lean >= -kReachSlack && lean <= 2 + kReachSlack)) return found;
  const double middle = std::atan2(c2, c1), apart = 2 * std::asin(std::sqrt(std::clamp(lean / 2, 0.0, 1.0)));
  // How the inner angle turns the axis about k.
  for (const double outer_angle : {middle + apart, middle - apart}) {
    const std::optional<double> outer = within(outer_angle, from.outer_rad, machine.outer);
    if (!outer) continue;
    double inner_angle = from.inner_rad;
    const Vec3 at_rest = axis(*outer, 0);
    const Vec3 across = at_rest - k * k.dot(at_rest), across_wanted = wanted - k * k.dot(wanted);
    if (across.norm() > kPole && across_wanted.norm() > kPole) {
      const Vec3 quarter = axis(*outer, kPi / 2);
      const double sense = k.dot(across.cross(quarter)) > 0 ? 1 : -1;
      inner_angle = sense * std::atan2(k.dot(across.cross(across_wanted)), across.dot(across_wanted));
    }
    const std::optional<double> inner = within(inner_angle, from.inner_rad, machine.inner);
    if (!inner) continue;
    found.push_back({*outer, *inner});
    if (apart < kPole) break;  // both are one
  }
  return found;
}

}  // namespace lightmill::detail

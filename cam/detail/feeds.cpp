#include "cam/detail/feeds.h"

#include <algorithm>
#include <cmath>

namespace lightmill::detail {

namespace {

constexpr double kCornerMm = 0.2;
constexpr double kSharpest = 5;
// Feeds change in steps, so that programs do not say a new one in every block: fine ones where the contact drifts, coarse
// ones around bends.
constexpr double kChipLadder = 0.95;
constexpr double kBendLadder = 0.85;

bool cuts(const Move& move) { return move.kind == MoveKind::kCut || move.kind == MoveKind::kPlunge; }

/// The highest step of the ladder below `wanted` that is not above `limit`.
double step_down(double wanted, double limit, double ladder) {
  return limit >= wanted ? wanted : wanted * std::pow(ladder, std::ceil(std::log(limit / wanted) / std::log(ladder) - 1e-9));
}

}  // namespace

double chip_share(double radius_mm, double stepover_mm, double contact_angle_rad) {
  const double far_side = contact_angle_rad + std::asin(std::min(1.0, stepover_mm / (2 * radius_mm)));
  const double diameter = 2 * radius_mm * std::sin(std::min(far_side, kPi / 2));
  if (stepover_mm >= diameter / 2) return 1;
  const double from_middle = 1 - 2 * stepover_mm / diameter;
  return std::sqrt(1 - from_middle * from_middle);
}

double chip_feed(const Cutter& ball, double stepover_mm, double contact_angle_rad) {
  const double meant = chip_share(ball.radius_mm(), stepover_mm, kDataContactAngle);
  const double here = chip_share(ball.radius_mm(), stepover_mm, contact_angle_rad);
  return step_down(ball.feed_mm_per_s(), ball.feed_mm_per_s() * meant / here, kChipLadder);
}

void limit_acceleration(std::vector<Move>& moves, double acceleration_mm_per_s2) {
  const std::size_t count = moves.size();
  const auto length = [&](std::size_t i) { return (moves[i].pose.tip_mm - moves[i - 1].pose.tip_mm).norm(); };
  std::vector<double> limit(count, 0);
  for (std::size_t i = 1; i < count; ++i) limit[i] = moves[i].feed_mm_per_s;
  // Around a bend of radius L / (2 tan(angle / 2)) both moves go no faster than sqrt(a r).
  for (std::size_t i = 1; i + 1 < count; ++i) {
    if (!cuts(moves[i]) || !cuts(moves[i + 1])) continue;
    const double here = length(i), next = length(i + 1);
    if (here <= 0 || next <= 0) continue;
    const Vec3 before = (moves[i].pose.tip_mm - moves[i - 1].pose.tip_mm) / here;
    const Vec3 after = (moves[i + 1].pose.tip_mm - moves[i].pose.tip_mm) / next;
    // Of half the angle; where the way turns back the machine stops, whatever is said.
    const double tangent = std::min(kSharpest, (after - before).norm() / std::max(1e-12, (after + before).norm()));
    if (tangent < 1e-12) continue;
    const double radius = std::min(kCornerMm, (here + next) / 2) / (2 * tangent);
    const double most = std::sqrt(acceleration_mm_per_s2 * radius);
    limit[i] = std::min(limit[i], most);
    limit[i + 1] = std::min(limit[i + 1], most);
  }
  // Speeding up and slowing down along the way.
  const auto reach = [&](double from, double over) { return std::sqrt(from * from + 2 * acceleration_mm_per_s2 * over); };
  for (std::size_t i = 2; i < count; ++i) {
    if (cuts(moves[i]) && cuts(moves[i - 1])) limit[i] = std::min(limit[i], reach(limit[i - 1], length(i)));
  }
  for (std::size_t i = count; i-- > 2;) {
    if (cuts(moves[i]) && cuts(moves[i - 1])) limit[i - 1] = std::min(limit[i - 1], reach(limit[i], length(i - 1)));
  }
  for (std::size_t i = 1; i < count; ++i) {
    if (cuts(moves[i])) moves[i].feed_mm_per_s = step_down(moves[i].feed_mm_per_s, limit[i], kBendLadder);
  }
}

}  // namespace lightmill::detail

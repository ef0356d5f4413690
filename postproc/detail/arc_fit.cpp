#include "postproc/detail/arc_fit.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace lightmill::detail {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kLeastMoves = 3;  // an arc's block is as long as two straight ones
constexpr std::size_t kMostMoves = 4096;
constexpr double kMostTurn_rad = 2 * kPi / 3;
// Controls that count in 32-bit floats lose 0.06 um of a larger radius.
constexpr double kLargestRadius_mm = 1000;

// The plane in which the points bend most: across the normal of the triangle of both ends and the point in the middle.
int bending_plane(std::span<const Vec3> points) {
  const Vec3 chord = points.back() - points.front();
  int normal = 2;
  chord.cross(points[points.size() / 2] - points.front()).cwiseAbs().maxCoeff(&normal);
  return normal;
}

// Height over the middle of a chord of length 2 `half` of the circle through both its ends and a point (u, w), u from the first
// end.
double sagitta_through(double half, double u, double w) {
  if (w == 0) return 0;
  const double centre = (u * u + w * w - 2 * half * u) / (2 * w);  // height of the circle's centre
  const double radius = std::hypot(half, centre);
  return w > 0 ? half * half / (radius - centre) : -half * half / (radius + centre);
}

// The arc from first to last point that stays nearest to all between, if any stays within the tolerance.
std::optional<PlaneArc> fit(std::span<const Vec3> points, double tolerance_mm) {
  PlaneArc arc;
  arc.normal = bending_plane(points);
  const int a = first_axis(arc.normal), b = second_axis(arc.normal);
  const Vec3& from = points.front();
  const double du = points.back()[a] - from[a], dv = points.back()[b] - from[b];
  const double half = std::hypot(du, dv) / 2;
  if (!(half > 0)) return std::nullopt;
  const double ea = du / (2 * half), eb = dv / (2 * half);
  double least = -kInfinity, most = kInfinity;
  const auto keep_near = [&](double pa, double pb) {
    const double u = (pa - from[a]) * ea + (pb - from[b]) * eb, w = (pb - from[b]) * ea - (pa - from[a]) * eb;
    if (u <= 0 || u >= 2 * half) return false;
    least = std::max(least, sagitta_through(half, u, w - tolerance_mm));
    most = std::min(most, sagitta_through(half, u, w + tolerance_mm));
    return least <= most;
  };
  for (std::size_t i = 0; i + 1 < points.size(); ++i) {
    const Vec3 &p = points[i], &q = points[i + 1];
    if (i > 0 && !keep_near(p[a], p[b])) return std::nullopt;
    if (!keep_near((p[a] + q[a]) / 2, (p[b] + q[b]) / 2)) return std::nullopt;
  }
  const double sagitta = (least + most) / 2;
  if (sagitta == 0) return std::nullopt;
  const double centre = (sagitta - half * half / sagitta) / 2;
  if (std::hypot(half, centre) > kLargestRadius_mm) return std::nullopt;
  arc.clockwise = sagitta > 0;
  arc.centre_mm = from;
  arc.centre_mm[a] += half * ea - centre * eb;
  arc.centre_mm[b] += half * eb + centre * ea;
  return arc;
}

double radius_of(const PlaneArc& arc, const Vec3& p) {
  const int a = first_axis(arc.normal), b = second_axis(arc.normal);
  return std::hypot(p[a] - arc.centre_mm[a], p[b] - arc.centre_mm[b]);
}

// From one place to another in the arc's sense, from -pi to pi.
double turn_between(const PlaneArc& arc, const Vec3& from, const Vec3& to) {
  const int a = first_axis(arc.normal), b = second_axis(arc.normal);
  const double ua = from[a] - arc.centre_mm[a], ub = from[b] - arc.centre_mm[b];
  const double va = to[a] - arc.centre_mm[a], vb = to[b] - arc.centre_mm[b];
  return (arc.clockwise ? -1 : 1) * std::atan2(ua * vb - ub * va, ua * va + ub * vb);
}

}  // namespace

double arc_error(const PlaneArc& arc, std::span<const Vec3> points) {
  const int n = arc.normal;
  const Vec3 &from = points.front(), &to = points.back();
  const double r0 = radius_of(arc, from), r1 = radius_of(arc, to);
  const double turn = turn_between(arc, from, to);
  if (!(turn > 0 && turn <= kMostTurn_rad)) return kInfinity;
  double worst = std::abs(r1 - r0);
  double t_before = 0;
  for (std::size_t i = 1; i < points.size(); ++i) {
    const Vec3 &p = points[i - 1], &q = points[i];
    const double t = i + 1 == points.size() ? 1 : turn_between(arc, from, q) / turn;
    if (!(t > t_before && t <= 1)) return kInfinity;
    // Along a short chord the angle grows evenly.
    for (const double f : {0.25, 0.5, 0.75, 1.0}) {
      const Vec3 at = p + f * (q - p);
      const double s = t_before + f * (t - t_before);
      worst = std::max(worst, std::hypot(radius_of(arc, at) - (r0 + s * (r1 - r0)), at[n] - (from[n] + s * (to[n] - from[n]))));
    }
    t_before = t;
  }
  return worst;
}

double arc_length(const PlaneArc& arc, const Vec3& from, const Vec3& to) {
  return std::hypot(turn_between(arc, from, to) * radius_of(arc, from), to[arc.normal] - from[arc.normal]);
}

std::optional<ArcRun> longest_arc(std::span<const Vec3> points, double tolerance_mm, double unit_mm) {
  const auto on_grid = [&](const Vec3& v) { return Vec3((v / unit_mm).array().round() * unit_mm); };
  std::vector<Vec3> printed;
  const auto run_of = [&](std::size_t moves) -> std::optional<ArcRun> {
    const std::span<const Vec3> part = points.first(moves + 1);
    const auto arc = fit(part, std::max(tolerance_mm / 2, tolerance_mm - unit_mm));
    if (!arc) return std::nullopt;
    ArcRun run{moves, *arc, 0, 0};
    printed.assign(part.begin(), part.end());
    printed.front() = on_grid(part.front());
    printed.back() = on_grid(part.back());
    // Printed as the way from the arc's start.
    run.arc.centre_mm = printed.front() + on_grid(run.arc.centre_mm - printed.front());
    run.error_mm = arc_error(run.arc, printed);
    run.length_mm = arc_length(run.arc, printed.front(), printed.back());
    return run.error_mm <= tolerance_mm ? std::optional(run) : std::nullopt;
  };

  const std::size_t most = std::min(points.size() - 1, kMostMoves);
  std::optional<ArcRun> best;
  std::size_t good = 0, bad = most + 1;
  for (std::size_t moves = kLeastMoves; moves <= most;) {
    auto run = run_of(moves);
    if (!run) {
      bad = moves;
      break;
    }
    best = run;
    good = moves;
    if (moves == most) break;
    moves = std::min(2 * moves, most);
  }
  while (best && bad - good > 1 && bad <= most) {
    const std::size_t middle = good + (bad - good) / 2;
    if (auto run = run_of(middle)) {
      best = run;
      good = middle;
    } else {
      bad = middle;
    }
  }
  return best;
}

}  // namespace lightmill::detail

#include "cam/rest.h"

#include <algorithm>
#include <cmath>

#include "cam/detail/ball_passes.h"

namespace lightmill {

namespace {

constexpr double kLegMm = 0.3;
constexpr double kSmoothMm = 0.5;        ///< to either side
constexpr double kShareOfStepover = 0.85;  ///< flanks bend, and lines beside a bent one are not evenly apart
constexpr double kTightestShare = 0.75;  ///< of a hollow's radius: a ball that fits more tightly covers it by few lines
constexpr double kBeyondMm = 0.05;       ///< the fillet's border, so that the ball meets what finishing has cut
constexpr double kOverEndMm = 0.5;         ///< and twice the half width, for borders that cut a fillet off at a slant
constexpr double kShortestMm = 0.5;      ///< a shorter stretch is not worth its landing

/// A place along a crease with what is not reached to either side.
struct Station {
  Vec2 place, across;
  double half_width_mm = 0;
};

std::vector<Station> stations(const Crease& crease) {
  const std::vector<Vec2> line = line_to_follow(crease);
  if (line.size() < 2) return {};
  std::vector<Station> result;
  for (std::size_t k = 0; k < line.size(); ++k) {
    const Vec2 along = (line[std::min(k + 1, line.size() - 1)] - line[k > 0 ? k - 1 : 0]).normalized();
    Station s{line[k], {-along.y(), along.x()}, 0};
    // The widest place near, as seen from the line that is followed.
    for (std::size_t m = 0; m < crease.line_mm.size(); ++m) {
      const Vec2 away = crease.line_mm[m] - s.place;
      if (std::abs(away.dot(along)) <= kLegMm) s.half_width_mm = std::max(s.half_width_mm, std::abs(away.dot(s.across)) + crease.half_width_mm[m]);
    }
    result.push_back(s);
  }
  // Over the ends, where the fillet runs out or the lens ends.
  std::vector<Station> before, after;
  const auto go_on = [](Station s, double sense, std::vector<Station>& on) {
    const int legs = static_cast<int>(std::ceil((kOverEndMm + 2 * s.half_width_mm) / kLegMm));
    for (int k = 0; k < legs; ++k) {
      s.place += sense * kLegMm * Vec2(s.across.y(), -s.across.x());
      on.push_back(s);
    }
  };
  go_on(result.front(), -1, before);
  go_on(result.back(), 1, after);
  result.insert(result.begin(), before.rbegin(), before.rend());
  result.insert(result.end(), after.begin(), after.end());
  return result;
}

/// Between lines. Along a flank of angle a / 2 to the level a stepover is seen shorter from above, and in a hollow of radius rho the
/// contacts move faster than the centres: s^2 = 8 h R (rho - R) / rho, here by the tightest one that the ball reaches into.
double spacing_along(const SplineSurface& surface, const Crease& crease, double radius, double cusp_mm) {
  double tightest = 0;  // R / rho
  for (std::size_t m = 0; m < crease.line_mm.size(); ++m) {
    const double beside = crease.half_width_mm[m] / 2;
    for (int v = -1; v <= 1; ++v) {
      for (int u = -1; u <= 1; ++u) {
        const Vec2 p = crease.line_mm[m] + beside * Vec2(u, v);
        const double share = radius * hollow_curvature(surface.sample(p.x(), p.y()));
        if (share < 1) tightest = std::max(tightest, std::min(share, kTightestShare));
      }
    }
  }
  return kShareOfStepover * detail::flat_stepover_mm(radius, cusp_mm) * std::cos(crease.most_angle_rad / 2) * std::sqrt(1 - tightest);
}

/// Lines beside the crease, `spacing` apart, each as long as the fillet is so wide; from one side to the other. They end one place
/// out of `wanted`.
void add_lines(const std::vector<Station>& crease, double spacing, const Box2& wanted, std::vector<std::vector<Vec2>>& lines) {
  double widest = 0;
  for (const Station& s : crease) widest = std::max(widest, s.half_width_mm);
  const int beside = static_cast<int>(std::ceil((widest + kBeyondMm) / spacing - 0.5));
  for (int k = -beside; k <= beside; ++k) {
    const double offset = k * spacing;
    std::vector<Vec2> line;
    const auto wide_enough = [&](const Station& s) { return std::abs(offset) - spacing / 2 <= s.half_width_mm + kBeyondMm; };
    const auto first = std::find_if(crease.begin(), crease.end(), wide_enough);
    const auto last = std::find_if(crease.rbegin(), std::make_reverse_iterator(first), wide_enough).base();
    for (auto s = first; s < last; ++s) {
      const Vec2 place = s->place + offset * s->across;
      // On the inner side of a bend lines get shorter, and must not run backwards.
      if (!line.empty() && (place - line.back()).dot(Vec2(s->across.y(), -s->across.x())) < 0.2 * kLegMm) continue;
      line.push_back(place);
    }
    while (line.size() > 1 && !wanted.contains(line[line.size() - 2])) line.pop_back();
    while (line.size() > 1 && !wanted.contains(line[1])) line.erase(line.begin());
    double length = 0;
    for (std::size_t m = 1; m < line.size(); ++m) length += (line[m] - line[m - 1]).norm();
    if (length >= kShortestMm) lines.push_back(std::move(line));
  }
}

/// Lowers what stands at the nodes of `left_um` to the ball's underside along the path's cuts.
void cut(const SplineSurface& surface, const ReachableSurface& reachable, const ToolPath& path, Grid<float>& left_um) {
  constexpr double kStepMm = 0.02;
  const double radius = path.cutter.radius_mm();
  const double near = std::min(0.9 * radius, 0.5);
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (path.moves[k].kind != MoveKind::kCut) continue;
    const Vec3 from = path.moves[k - 1].pose.tip_mm + radius * path.moves[k - 1].pose.axis;
    const Vec3 to = path.moves[k].pose.tip_mm + radius * path.moves[k].pose.axis;
    const int steps = std::max(1, static_cast<int>(std::ceil((to - from).norm() / kStepMm)));
    for (int m = 0; m <= steps; ++m) {
      const Vec3 c = from + (to - from) * (static_cast<double>(m) / steps);
      const Vec2 low = (c.head<2>() - Vec2::Constant(near) - reachable.extent.min) / reachable.pitch_mm;
      const Vec2 high = (c.head<2>() + Vec2::Constant(near) - reachable.extent.min) / reachable.pitch_mm;
      for (int j = std::max(0, static_cast<int>(low.y())); j <= std::min(left_um.height - 1, static_cast<int>(high.y())); ++j) {
        for (int i = std::max(0, static_cast<int>(low.x())); i <= std::min(left_um.width - 1, static_cast<int>(high.x())); ++i) {
          float& left = left_um.at(i, j);
          if (left <= 0) continue;
          const Vec2 p = reachable.extent.min + reachable.pitch_mm * Vec2(i, j);
          const double d2 = (p - c.head<2>()).squaredNorm();
          if (d2 > near * near) continue;
          left = std::min(left, static_cast<float>((c.z() - std::sqrt(radius * radius - d2) - surface.height(p.x(), p.y())) * 1000));
        }
      }
    }
  }
}

}  // namespace

std::vector<Vec2> line_to_follow(const Crease& crease) {
  const std::vector<Vec2>& line = crease.line_mm;
  if (line.size() == 1) {
    // A spot: along its hollow, which lies across the flanks' normals.
    const Vec2 across = (crease.one_normal - crease.other_normal).head<2>();
    const Vec2 along = across.norm() > 1e-9 ? Vec2(Vec2(-across.y(), across.x()).normalized()) : Vec2(1, 0);
    return {line[0] - kLegMm / 2 * along, line[0] + kLegMm / 2 * along};
  }
  std::vector<double> at = {0};
  for (std::size_t k = 1; k < line.size(); ++k) at.push_back(at.back() + (line[k] - line[k - 1]).norm());
  if (line.size() < 2 || at.back() < 1e-9) return line;
  const int legs = std::max(1, static_cast<int>(std::lround(at.back() / kLegMm)));
  std::vector<Vec2> result;
  for (int k = 0; k <= legs; ++k) {
    const double here = at.back() * k / legs;
    // A window that shrinks towards the ends keeps them in their place.
    const double half = std::min({kSmoothMm, here, at.back() - here}) + 1e-9;
    Vec2 sum = Vec2::Zero();
    double weight = 0;
    for (std::size_t m = 0; m < line.size(); ++m) {
      const double away = std::abs(at[m] - here) / half;
      if (away > 1) continue;
      sum += (1 - away * away + 1e-6) * line[m];
      weight += 1 - away * away + 1e-6;
    }
    if (weight > 0) result.push_back(sum / weight);
  }
  return result;
}

RestPlan plan_rest(const SplineSurface& surface, const Blank& blank, const Cutter& ball, const std::vector<Crease>& creases,
                   const ReachableSurface& reachable, const ToolPath& finish, const FinishOptions& options, const Monitor& monitor) {
  RestPlan plan;
  const double cusp_mm = options.cusp_um * 1e-3;
  std::vector<std::vector<Vec2>> lines;
  Box2 wanted = surface.extent();
  wanted.min -= Vec2::Constant(kOverEndMm);
  wanted.max += Vec2::Constant(kOverEndMm);
  for (const Crease& crease : creases) {
    add_lines(stations(crease), spacing_along(surface, crease, ball.radius_mm(), cusp_mm), wanted, lines);
  }
  plan.ways = lines.size();
  plan.path.pass = options.pass;
  plan.path.cutter = ball;
  if (!lines.empty()) plan.path = plan_along(surface, blank, ball, lines, finish, options, monitor.part(0, 0.9));

  monitor.report("what the rest pass leaves", 0.9);
  Grid<float> left = reachable.residue_um;
  for (float& um : left.values) um = um > reachable.threshold_um ? um : 0;
  const auto measure = [&](double& highest, double& area) {
    for (const float um : left.values) {
      highest = std::max<double>(highest, um);
      if (um > options.cusp_um) area += reachable.pitch_mm * reachable.pitch_mm;
    }
  };
  measure(plan.highest_before_um, plan.area_before_mm2);
  cut(surface, reachable, plan.path, left);
  measure(plan.highest_after_um, plan.area_after_mm2);
  plan.path.predicted_cusp_um = plan.highest_after_um;
  return plan;
}

}  // namespace lightmill

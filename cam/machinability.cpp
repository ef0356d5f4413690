#include "cam/machinability.h"

#include <algorithm>
#include <cmath>

#include "cam/detail/ball_contact.h"
#include "cam/detail/tool_axis.h"
#include "design/core/errors.h"

namespace lightmill {

namespace {

/// Calls `look` at the middle of every cell of the pitch that lies on the lens.
template <class Look>
void over_lens(const SplineSurface& surface, const OutlineRegion& lens, double pitch_mm, const Look& look) {
  const Box2& extent = surface.extent();
  for (double y = extent.min.y() + pitch_mm / 2; y < extent.max.y(); y += pitch_mm) {
    for (double x = extent.min.x() + pitch_mm / 2; x < extent.max.x(); x += pitch_mm) {
      if (lens.contains({x, y})) look(Vec2(x, y), surface.sample(x, y));
    }
  }
}

class Summing {
 public:
  void add(double residue_um, double normal_mrad) {
    ++count_;
    result_.highest_um = std::max(result_.highest_um, residue_um);
    result_.most_mrad = std::max(result_.most_mrad, normal_mrad);
    squares_um_ += residue_um * residue_um;
    squares_mrad_ += normal_mrad * normal_mrad;
  }
  [[nodiscard]] Leftover result(double cell_mm2) const {
    Leftover r = result_;
    if (count_ == 0) return r;
    const auto count = static_cast<double>(count_);
    r.area_mm2 = count * cell_mm2;
    r.rms_um = std::sqrt(squares_um_ / count);
    r.rms_mrad = std::sqrt(squares_mrad_ / count);
    return r;
  }

 private:
  long count_ = 0;
  double squares_um_ = 0, squares_mrad_ = 0;
  Leftover result_;
};

}  // namespace

SurfaceScan scan_surface(const SplineSurface& surface, const OutlineRegion& lens, double ball_radius_mm, double pitch_mm) {
  SurfaceScan scan;
  double steepest = 0;
  over_lens(surface, lens, pitch_mm, [&](const Vec2& p, const SplineSurface::Sample& s) {
    const double slope = std::hypot(s.hx, s.hy);
    if (slope > steepest) {
      steepest = slope;
      scan.steepest_mm = p;
    }
    const double concave = hollow_curvature(s);
    if (concave * ball_radius_mm > 1) scan.sharper_mm2 += pitch_mm * pitch_mm;
    if (concave > scan.most_concave_per_mm) {
      scan.most_concave_per_mm = concave;
      scan.concave_mm = p;
    }
  });
  scan.steepest_rad = std::atan(steepest);
  return scan;
}

ContactWindow contact_window(const SplineSurface& surface, const FinishOptions& options, const OutlineRegion& lens, double pitch_mm) {
  ContactWindow window;
  std::optional<OutlineRegion> within;
  if (options.outline) within.emplace(*options.outline, detail::kJudgedBeyondMm);
  const OutlineRegion* region = within ? &*within : nullptr;
  const double direction = options.tilt_direction_rad + (options.axis == AxisPolicy::kFixed ? options.angle_rad : 0);
  const detail::Lean asked{options.tilt_rad, direction, 0, 0};
  std::optional<detail::LeadField> lead;
  if (options.axis == AxisPolicy::kLeadTilt) lead.emplace(surface, detail::Turn::by(options.angle_rad).along);
  const auto axis_at = [&](const Vec2& p) -> Vec3 {
    return options.axis == AxisPolicy::kVertical ? Vec3(Vec3::UnitZ()) : lead ? lead->axis(p.x(), p.y(), asked) : detail::fixed_axis(asked);
  };
  try {
    if (options.axis != AxisPolicy::kVertical) {
      const detail::Lean first = lead ? lead->leans(options.tilt_rad, direction, region, options.pass).front()
                                      : detail::fixed_tilts(surface, options.tilt_rad, direction, region, options.pass).front();
      window.tilt_rad = first.angle_rad;
      window.direction_rad = first.direction_rad - direction + options.tilt_direction_rad;
    }
  } catch (const InputError& e) {
    window.refusal = e.what();
  }
  window.least_rad = kPi;
  double farthest = -kPi;
  long nodes = 0, outside_nodes = 0;
  over_lens(surface, lens, pitch_mm, [&](const Vec2& p, const SplineSurface::Sample& s) {
    const Vec3 normal = Vec3(-s.hx, -s.hy, 1).normalized();
    const double angle = std::acos(std::clamp(axis_at(p).dot(normal), -1.0, 1.0));
    window.least_rad = std::min(window.least_rad, angle);
    window.most_rad = std::max(window.most_rad, angle);
    const double outside = std::max(kLeastContactAngle - angle, angle - kMostContactAngle);
    ++nodes;
    if (outside > 0) ++outside_nodes;
    if (outside > farthest) {
      farthest = outside;
      window.worst_rad = angle;
      window.worst_mm = p;
    }
  });
  window.least_rad = std::min(window.least_rad, window.most_rad);
  window.outside_share = nodes > 0 ? static_cast<double>(outside_nodes) / nodes : 0;
  return window;
}

Leftovers leftovers(const ReachableSurface& reachable, const std::vector<Crease>& creases) {
  const Grid<float>& residue = reachable.residue_um;
  Grid<char> in_crease(residue.width, residue.height, 0);
  for (const Crease& crease : creases) {
    for (std::size_t k = 0; k < crease.line_mm.size(); ++k) {
      // A node more: lines run from node to node.
      const Vec2 middle = (crease.line_mm[k] - reachable.extent.min) / reachable.pitch_mm;
      const double reach = crease.half_width_mm[k] / reachable.pitch_mm + 1;
      const auto from = [&](double at) { return std::max(0, static_cast<int>(std::ceil(at - reach))); };
      const auto to = [&](double at, int count) { return std::min(count - 1, static_cast<int>(std::floor(at + reach))); };
      for (int j = from(middle.y()); j <= to(middle.y(), residue.height); ++j) {
        for (int i = from(middle.x()); i <= to(middle.x(), residue.width); ++i) {
          if ((Vec2(i, j) - middle).norm() <= reach) in_crease.at(i, j) = 1;
        }
      }
    }
  }
  const Grid<float> normals = residue_normals_mrad(reachable);
  Summing inside, outside;
  for (std::size_t k = 0; k < residue.values.size(); ++k) {
    if (residue.values[k] <= reachable.threshold_um) continue;
    (in_crease.values[k] ? inside : outside).add(residue.values[k], normals.values[k]);
  }
  const double cell_mm2 = reachable.pitch_mm * reachable.pitch_mm;
  return {inside.result(cell_mm2), outside.result(cell_mm2)};
}

}  // namespace lightmill

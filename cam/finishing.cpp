#include "cam/finishing.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "cam/detail/ball_passes.h"
#include "cam/detail/feeds.h"
#include "cam/detail/tool_axis.h"
#include "cam/detail/tool_clearance.h"
#include "cam/outline_region.h"
#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

using detail::CentrePath;
using detail::PathPoint;

constexpr double kBesideMm = 0.5;     ///< air between the ball and the block's side where passes start and end
constexpr double kLinkAboveMm = 1.5;  ///< of links above the highest place on their way: more than earlier passes leave
// The curve on which an infill piece lands and leaves: 0.5 mm up at its far end in finishing, 2 mm where a pass before
// may have left a millimetre.
constexpr double kLandRadiusMm = 4;
constexpr double kLandMm = 2;
constexpr double kLandInStockMm = 4;
// Within an outline passes reach so far beyond it, contact for contact; semi-finishing farther, so that finishing lands where
// its allowance alone stands.
constexpr double kBeyondMm = 1;
constexpr double kBeyondInStockMm = kBeyondMm + kLandMm + 1;
constexpr double kOutlinePitchMm = 0.05;
constexpr double kMostTurnRad = 0.5 * kPi / 180;  ///< of the axis in one cutting move

void check(const SplineSurface& surface, const Blank& blank, const Cutter& ball, const FinishOptions& o) {
  const auto refuse = [&](const std::string& what) { throw InputError(o.pass + ": " + what); };
  if (!ball.is_ball() || !(ball.radius_mm() > 0))
    refuse("the cutter '" + ball.name + "' is no ball; give a ball cutter");
  if (!(o.cusp_um > 0 && o.cusp_um * 1e-3 < ball.radius_mm() / 4)) {
    refuse("cusp_um = " + compact(o.cusp_um, 6) + ": must be above 0 and small against the ball");
  }
  if (!(o.allowance_mm >= 0 && o.allowance_mm <= 5))
    refuse("allowance_mm = " + compact(o.allowance_mm, 6) + ": must be from 0 to 5");
  if (!(o.chord_tolerance_mm > 0 && o.longest_segment_mm > 0))
    refuse("chord tolerance and longest segment must be above 0");
  if (!(o.clearance_mm > 0 && o.link_feed_mm_per_s > 0)) refuse("clearance and link feed must be above 0");
  if (!(o.max_feed_mm_per_s > 0 && o.acceleration_mm_per_s2 > 0)) refuse("highest feed and acceleration must be above 0");
  if (!(ball.feed_mm_per_s() > 0 && ball.plunge_feed_mm_per_s > 0))
    refuse("the cutter '" + ball.name + "' has no feeds");
  if (!(o.tilt_rad >= 0 && o.tilt_rad < kPi / 2)) refuse("tilt must be from 0 to below 90 degrees");
  const Box2 block = Box2::centred(blank.size_mm);
  const Box2& lens = surface.extent();
  if (lens.min.x() < block.min.x() - 1e-6 || lens.min.y() < block.min.y() - 1e-6 ||
      lens.max.x() > block.max.x() + 1e-6 || lens.max.y() > block.max.y() + 1e-6) {
    refuse("the blank of " + compact(blank.size_mm.x(), 3) + " x " + compact(blank.size_mm.y(), 3) +
           " mm is smaller than the lens; give a larger one");
  }
}

/// Places on the border of what is to be finished.
std::vector<Vec2> border_places(const SplineSurface& surface, const std::optional<Outline>& outline) {
  if (outline) return outline_places(*outline, kOutlinePitchMm);
  const Box2& extent = surface.extent();
  std::vector<Vec2> places;
  const int steps = 8 * surface.spans_x();
  for (int i = 0; i <= steps; ++i) {
    const double x = extent.min.x() + extent.size().x() * i / steps;
    places.emplace_back(x, extent.min.y());
    places.emplace_back(x, extent.max.y());
  }
  return places;
}

/// Where the ball's centre is when it touches them.
std::vector<Vec2> centres_over(const SplineSurface& surface, double radius_mm, std::vector<Vec2> places) {
  for (Vec2& p : places) p += radius_mm * surface.normal(p.x(), p.y()).head<2>();
  return places;
}

/// A vertex of a pass with its axis.
struct Vertex {
  Vec3 centre = Vec3::Zero();
  Vec3 axis = Vec3::UnitZ();
  Vec3 normal = Vec3::UnitZ();  ///< of the surface where the ball rests
  bool landing = false;
};

class Planner {
 public:
  Planner(const SplineSurface& surface, const Blank& blank, const Cutter& cutter, const FinishOptions& options)
      : surface_(surface),
        blank_(blank),
        cutter_(cutter),
        options_(options),
        radius_(cutter.radius_mm()),
        ball_(surface, radius_ + options.allowance_mm, 2 * radius_ + options.allowance_mm + kBesideMm + 1) {
    box_ = Box2::centred(blank.size_mm);
    tolerance_.chord_mm = options.chord_tolerance_mm;
    tolerance_.longest_mm = options.longest_segment_mm;
    tolerance_.shortest_mm = std::min(0.01, options.longest_segment_mm);
  }

  ToolPath plan(const Monitor& monitor) {
    if (options_.outline) within_.emplace(*options_.outline, kBeyondMm / 2);
    // Whether an axis exists is known at once; the passes do not depend on it.
    choose_axes();
    detail::SpacingOptions spacing;
    spacing.cutting_radius_mm = radius_;
    spacing.cusp_mm = options_.cusp_um * 1e-3;
    const std::vector<Vec2> border = centres_over(surface_, ball_.radius_mm(), border_places(surface_, options_.outline));
    Box2 reach;
    for (const Vec2& centre : border) reach.include(centre);
    spacing.from_y = reach.min.y();
    spacing.to_y = reach.max.y();
    if (within_) {
      spacing.wanted = &*within_;
      const double beyond = options_.allowance_mm > 0 ? kBeyondInStockMm : kBeyondMm;
      spacing.ends = [&border, beyond](double y) { return reach_along_x(border, beyond, y); };
      spacing.from_y -= beyond - kBeyondMm;
      spacing.to_y += beyond - kBeyondMm;
    } else {
      const double beside = radius_ + kBesideMm;
      spacing.ends = [this, beside](double) { return std::pair(box_.min.x() - beside, box_.max.x() + beside); };
    }
    spacing.tolerance = tolerance_;
    const detail::SpacedPasses passes = detail::space_passes(ball_, spacing, monitor.part(0, 0.85));

    monitor.report("checking shank and holder", 0.87);
    settle_axis(passes.paths);
    monitor.report("linking passes", 0.93);
    ToolPath path;
    path.pass = options_.pass;
    path.cutter = cutter_;
    path.spindle_rpm = cutter_.spindle_rpm;
    path.stepover_mm = passes.widest_mm;
    path.predicted_cusp_um = passes.highest_cusp_mm * 1e3;
    path.above_limit_mm2 = passes.above_limit_mm2;
    path.clearance_z_mm =
        std::max(blank_.height_mm, surface_.highest() + options_.allowance_mm) + options_.clearance_mm;
    assemble(passes.paths, path);
    monitor.report("passes planned", 1);
    return path;
  }

 private:
  void choose_axes() {
    if (options_.axis == AxisPolicy::kVertical) {
      tilts_ = {{0, 0, 0, 0}};
    } else if (options_.axis == AxisPolicy::kFixed) {
      tilts_ = detail::fixed_tilts(surface_, options_.tilt_rad, options_.tilt_direction_rad, within());
    } else {
      lead_.emplace(surface_, options_.tilt_rad, within());
    }
  }

  [[nodiscard]] const OutlineRegion* within() const { return within_ ? &*within_ : nullptr; }

  /// The first tilt whose shank and holder stay clear of the part.
  void settle_axis(const std::vector<CentrePath>& paths) {
    // What may still stand above the surface: earlier passes' allowance; the holder keeps another half millimetre.
    const detail::ToolClearance clearance(surface_, blank_, options_.allowance_mm);
    constexpr std::size_t kMostTried = 24;
    std::optional<detail::ToolContact> first_contact;
    const std::size_t tries = lead_ ? 1 : std::min(kMostTried, tilts_.size());
    for (std::size_t k = 0; k < tries; ++k) {
      if (!lead_) axis_ = tilts_[k].axis();
      const auto contact = touching(paths, clearance);
      if (!contact) return;
      if (!first_contact) first_contact = contact;
    }
    const Vec3& p = first_contact->place_mm;
    throw InputError(options_.pass + ": the " + (first_contact->holder ? "holder" : "shank") + " of '" + cutter_.name +
                     "' would touch the part near x " + fixed(p.x(), 1) + ", y " + fixed(p.y(), 1) + ", z " +
                     fixed(p.z(), 1) + " mm" +
                     (tries > 1 ? " (and so with " + std::to_string(tries - 1) + " other tilts)" : "") +
                     (first_contact->holder ? "; use a cutter that reaches farther out of its holder"
                                            : "; use a cutter with a thinner shank or less tilt"));
  }

  [[nodiscard]] std::optional<detail::ToolContact> touching(const std::vector<CentrePath>& paths,
                                                            const detail::ToolClearance& clearance) const {
    constexpr double kEveryMm = 2;
    double last_y = -std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < paths.size(); ++k) {
      if (paths[k].infill || (paths[k].y < last_y + kEveryMm && k + 1 < paths.size())) continue;
      last_y = paths[k].y;
      double last_x = -std::numeric_limits<double>::infinity();
      for (const PathPoint& p : paths[k].points) {
        if (p.x < last_x + kEveryMm) continue;
        last_x = p.x;
        const Vec3 axis = axis_at(p.x, paths[k].y);
        if (auto contact = clearance.touches(cutter_, {Vec3(p.x, paths[k].y, p.z) - radius_ * axis, axis}))
          return contact;
      }
    }
    return std::nullopt;
  }

  [[nodiscard]] Vec3 axis_at(double x, double y) const { return lead_ ? lead_->axis(x, y) : axis_; }

  [[nodiscard]] Vertex vertex(const PathPoint& p, double y, double lift) const {
    const Vec2 away = (Vec2(p.x, y) - p.contact) / ball_.radius_mm();
    return {{p.x, y, p.z + lift}, axis_at(p.x, y), {away.x(), away.y(), std::sqrt(std::max(0.0, 1 - away.squaredNorm()))}, lift > 0};
  }

  /// The way of a path, an infill piece with its landing and leaving curves, vertices close enough for a turning axis.
  [[nodiscard]] std::vector<Vertex> vertices(const CentrePath& path) const {
    std::vector<Vertex> result;
    const double land = options_.allowance_mm > 0 ? kLandInStockMm : kLandMm;
    const auto lift = [](double away) { return away * away / (2 * kLandRadiusMm); };
    const double begin = path.points.front().x;
    const double end = path.points.back().x;
    const bool lands = path.infill || options_.outline;
    // A piece that begins at the blank's side comes in from beside it.
    const auto in_air = [&](double x) { return !options_.outline && (x <= box_.min.x() - radius_ - kBesideMm || x >= box_.max.x() + radius_ + kBesideMm); };
    if (lands && !in_air(begin - land)) {
      for (const PathPoint& p : detail::centre_path(ball_, path.y, begin - land, begin, tolerance_).points) {
        if (p.x < begin) add(result, vertex(p, path.y, lift(begin - p.x)));
      }
    }
    for (const PathPoint& p : path.points) add(result, vertex(p, path.y, 0));
    if (lands && !in_air(end + land)) {
      for (const PathPoint& p : detail::centre_path(ball_, path.y, end, end + land, tolerance_).points) {
        if (p.x > end) add(result, vertex(p, path.y, lift(p.x - end)));
      }
    }
    return result;
  }

  void add(std::vector<Vertex>& list, const Vertex& next) const {
    if (lead_ && !list.empty()) {
      const Vertex here = list.back();
      const double turn = std::acos(std::clamp(here.axis.dot(next.axis), -1.0, 1.0));
      if (turn > kMostTurnRad && next.centre.x() - here.centre.x() > 0.02) {
        const double x = (here.centre.x() + next.centre.x()) / 2;
        const double y = here.centre.y();
        const double chord = (here.centre.z() + next.centre.z()) / 2;
        add(list, {{x, y, next.landing || here.landing ? chord : ball_.at(x, y).z}, axis_at(x, y), next.normal, next.landing});
        add(list, next);
        return;
      }
    }
    list.push_back(next);
  }

  /// Highest centre over [from, to] (and a ball's width around) on the full passes next to number k.
  [[nodiscard]] double highest_near(const std::vector<CentrePath>& paths, std::size_t k, double from, double to) const {
    double highest = -std::numeric_limits<double>::infinity();
    const auto look = [&](const CentrePath& path) {
      for (const PathPoint& p : path.points) {
        if (p.x >= from - 2 * radius_ && p.x <= to + 2 * radius_) highest = std::max(highest, p.z);
      }
    };
    for (std::size_t below = k + 1; below-- > 0;) {
      look(paths[below]);
      if (!paths[below].infill) break;
    }
    for (std::size_t above = k + 1; above < paths.size(); ++above) {
      look(paths[above]);
      if (!paths[above].infill) break;
    }
    return highest;
  }

  [[nodiscard]] ToolPose pose(const Vec3& centre, const Vec3& axis) const { return {centre - radius_ * axis, axis}; }
  [[nodiscard]] ToolPose pose(const Vertex& v) const { return pose(v.centre, v.axis); }

  void assemble(const std::vector<CentrePath>& paths, ToolPath& out) const {
    // A tooth advances at most a third of the way to the next pass.
    const double teeth_per_s = cutter_.spindle_rpm / 60 * cutter_.edges;
    const double most_feed = std::min(teeth_per_s * out.stepover_mm / 3, options_.max_feed_mm_per_s);
    const auto feed_at = [&](const Vertex& v) {
      const double angle = std::acos(std::clamp(v.axis.dot(v.normal), -1.0, 1.0));
      return std::min(most_feed, detail::chip_feed(cutter_, out.stepover_mm, angle));
    };
    const auto link = [&](const ToolPose& to) {
      out.moves.push_back({to, MoveKind::kLink, options_.link_feed_mm_per_s});
    };
    const auto at_height = [](ToolPose p, double tip_z) {
      p.tip_mm.z() = tip_z;
      return p;
    };

    std::vector<Vertex> way = vertices(paths.front());
    out.moves.push_back({at_height(pose(way.front()), out.clearance_z_mm), MoveKind::kRapid, 0});
    for (std::size_t k = 0; k < paths.size(); ++k) {
      // Down beside the part (or above a landing curve), then the pass.
      link(pose(way.front()));
      for (std::size_t i = 1; i < way.size(); ++i) {
        const bool landing = way[i - 1].landing && i <= way.size() / 2;
        out.moves.push_back({pose(way[i]), landing ? MoveKind::kPlunge : MoveKind::kCut,
                             landing ? std::min(feed_at(way[i]), cutter_.plunge_feed_mm_per_s) : feed_at(way[i])});
      }
      if (k + 1 == paths.size()) break;
      // Up, back, down: just above the highest place on the way; a turning axis needs full clearance.
      std::vector<Vertex> next = vertices(paths[k + 1]);
      double tip_from = out.clearance_z_mm;
      if (!lead_) {
        const double from = std::min(way.back().centre.x(), next.front().centre.x());
        const double to = std::max(way.back().centre.x(), next.front().centre.x());
        const double centre =
            std::max({highest_near(paths, k, from, to) + kLinkAboveMm, way.back().centre.z(), next.front().centre.z()});
        tip_from = std::min(tip_from, centre - radius_ * axis_.z());
        tip_from = std::max({tip_from, pose(way.back()).tip_mm.z(), pose(next.front()).tip_mm.z()});
      }
      link(at_height(pose(way.back()), tip_from));
      link(at_height(pose(next.front()), tip_from));
      way = std::move(next);
    }
    link(at_height(pose(way.back()), out.clearance_z_mm));
    out.moves.push_back({at_height(pose(way.back()), out.clearance_z_mm + options_.clearance_mm), MoveKind::kRapid, 0});
    detail::limit_acceleration(out.moves, options_.acceleration_mm_per_s2);
  }

  const SplineSurface& surface_;
  const Blank& blank_;
  const Cutter& cutter_;
  const FinishOptions& options_;
  double radius_;
  detail::BallContact ball_;
  Box2 box_;
  detail::PathTolerance tolerance_;
  std::optional<OutlineRegion> within_;
  std::vector<detail::FixedTilt> tilts_;
  std::optional<detail::LeadField> lead_;
  Vec3 axis_ = Vec3::UnitZ();
};

}  // namespace

ToolPath plan_finishing(const SplineSurface& surface, const Blank& blank, const Cutter& ball,
                        const FinishOptions& options, const Monitor& monitor) {
  check(surface, blank, ball, options);
  return Planner(surface, blank, ball, options).plan(monitor);
}

ContactSummary contact_summary(const SplineSurface& surface, const ToolPath& path, const FinishOptions& options) {
  constexpr int kEvery = 20;
  const double radius = path.cutter.radius_mm();
  const detail::BallContact ball(surface, radius + options.allowance_mm, 2 * radius + options.allowance_mm + 1);
  std::optional<OutlineRegion> within;
  if (options.outline) within.emplace(*options.outline, 0);
  ContactSummary result;
  result.least_angle_rad = kPi;
  int count = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (path.moves[k].kind != MoveKind::kCut) continue;
    result.cutting_mm += (path.moves[k].pose.tip_mm - path.moves[k - 1].pose.tip_mm).norm();
    const Vec3& axis = path.moves[k].pose.axis;
    const bool measured = count++ % kEvery == 0;
    const Vec3 centre = path.moves[k].pose.tip_mm + radius * axis;
    if (!measured) continue;
    const detail::Contact contact = ball.at(centre.x(), centre.y());
    if (within ? !within->contains(contact.point) : !surface.extent().contains(contact.point)) continue;
    const Vec3 normal = Vec3(-contact.slope.x(), -contact.slope.y(), 1).normalized();
    const double angle = std::acos(std::clamp(axis.dot(normal), -1.0, 1.0));
    result.least_angle_rad = std::min(result.least_angle_rad, angle);
    result.most_angle_rad = std::max(result.most_angle_rad, angle);
  }
  const auto speed = [&](double angle) { return 2 * kPi * radius * path.spindle_rpm * std::sin(angle) / 1000; };
  result.least_angle_rad = std::min(result.least_angle_rad, result.most_angle_rad);
  result.slowest_m_per_min = speed(result.least_angle_rad);
  result.fastest_m_per_min = speed(result.most_angle_rad);
  result.least_diameter_mm = 2 * radius * std::sin(result.least_angle_rad);
  result.most_diameter_mm = 2 * radius * std::sin(result.most_angle_rad);
  return result;
}

double blur_on_screen_mm(double radius_mm, double cusp_um, double distance_mm, double refractive_index, double polish_sigma_mm) {
  // y^2 / 2 R between contacts s apart is a sum of cosines; the slope of the k-th has the amplitude s / (pi k R).
  const double stepover = detail::flat_stepover_mm(radius_mm, cusp_um * 1e-3);
  constexpr int kHarmonics = 200;
  double square = 0;
  for (int k = 1; k <= kHarmonics; ++k) {
    const double kept = std::exp(-0.5 * std::pow(2 * kPi * k * polish_sigma_mm / stepover, 2));
    square += 0.5 * std::pow(stepover / (kPi * k * radius_mm) * kept, 2);
  }
  return (refractive_index - 1) * distance_mm * std::sqrt(square);
}

double cusp_for_blur_um(double radius_mm, double blur_mm, double distance_mm, double refractive_index, double polish_sigma_mm) {
  constexpr double kLeastUm = 0.01, kMostUm = 100;
  const auto blur = [&](double cusp_um) { return blur_on_screen_mm(radius_mm, cusp_um, distance_mm, refractive_index, polish_sigma_mm); };
  if (!(blur(kLeastUm) <= blur_mm)) {
    throw InputError("finish.blur_mm = " + compact(blur_mm, 6) + ": even cusps of 0.01 um blur the picture by " + compact(blur(kLeastUm), 4) +
                     " mm; allow more, polish more (dry_run.polish_sigma_um), or move the wall nearer");
  }
  double low = kLeastUm, high = kMostUm;
  if (blur(high) <= blur_mm) return high;
  for (int k = 0; k < 60; ++k) {
    const double middle = std::sqrt(low * high);
    (blur(middle) <= blur_mm ? low : high) = middle;
  }
  return low;
}

double ball_centre_height(const SplineSurface& surface, double radius_mm, double x, double y) {
  return detail::ball_contact(surface, radius_mm, x, y).z;
}

}  // namespace lightmill

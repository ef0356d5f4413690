#include "cam/finishing.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <optional>
#include <set>

#include "cam/detail/ball_passes.h"
#include "cam/detail/feeds.h"
#include "cam/detail/grooves.h"
#include "cam/detail/tool_axis.h"
#include "cam/detail/tool_clearance.h"
#include "cam/outline_region.h"
#include "cam/work_holding.h"
#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

using detail::CentrePath;
using detail::Grooves;
using detail::PathPoint;
using detail::TurnedBall;

constexpr double kBesideMm = 0.5;     ///< air between the ball and the block's side where passes start and end
constexpr double kLinkAboveMm = 1.5;  ///< of links above the highest place on their way: more than earlier passes leave
// The arcs on which the ball lands and leaves. On the surface they end 0.5 mm up in finishing, 2 mm where a pass before may have
// left a millimetre; beside the block, where nothing stands, 0.33 mm.
constexpr double kLandMm = 2;
constexpr double kLandInStockMm = 4;
constexpr double kLandRadiusMm = 4.0 / 3;
constexpr double kLandInAirMm = 1;
constexpr double kLandInAirRadiusMm = 0.5;
constexpr double kArcLegMm = 0.1;
// Within an outline passes reach so far beyond it, contact for contact; semi-finishing farther, so that finishing lands where
// its allowance alone stands.
constexpr double kBeyondMm = 1;
constexpr double kBeyondInStockMm = kBeyondMm + kLandMm + 1;
constexpr double kOutlinePitchMm = 0.05;
constexpr double kRestsMm = 1e-6;  ///< above the rest by less: vertices of a pass are exact
constexpr double kUnbounded = std::numeric_limits<double>::infinity();
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
  // All that is planned is kept in memory.
  constexpr double kMostPoints = 3e7;
  const double points = surface.extent().size().prod() / (detail::flat_stepover_mm(ball.radius_mm(), o.cusp_um * 1e-3) * o.longest_segment_mm);
  if (!(points < kMostPoints)) {
    refuse("more than " + compact(points / 1e6, 0) + " million points would be planned, at most " + compact(kMostPoints / 1e6, 0) +
           " are; allow higher cusps (cusp_um) or longer segments (longest_segment_mm)");
  }
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
  const int steps_x = 8 * surface.spans_x();
  for (int i = 0; i <= steps_x; ++i) {
    const double x = extent.min.x() + extent.size().x() * i / steps_x;
    places.emplace_back(x, extent.min.y());
    places.emplace_back(x, extent.max.y());
  }
  const int steps_y = 8 * surface.spans_y();
  for (int j = 0; j <= steps_y; ++j) {
    const double y = extent.min.y() + extent.size().y() * j / steps_y;
    places.emplace_back(extent.min.x(), y);
    places.emplace_back(extent.max.x(), y);
  }
  return places;
}

/// Where the ball's centre is when it touches them, in the axes of `turn`.
std::vector<Vec2> centres_over(const SplineSurface& surface, double radius_mm, std::vector<Vec2> places, const detail::Turn& turn) {
  for (Vec2& p : places) p = turn.in(p + radius_mm * surface.normal(p.x(), p.y()).head<2>());
  return places;
}

/// The outermost turn of a spiral around a place: every centre at least so far within it, clockwise from its farthest place on. It has
/// no corner, and comes nowhere nearer to the middle than steeply aslant: bays deeper than that are passed over.
std::vector<Vec2> turn_around(const std::vector<Vec2>& centres, const Vec2& middle, double beyond_mm) {
  constexpr double kLegMm = 0.6, kRoundMm = 1, kAslant = 1.5;
  double farthest = 0;
  for (const Vec2& c : centres) farthest = std::max(farthest, (c - middle).norm() + beyond_mm);
  const int count = std::max(64, static_cast<int>(std::ceil(2 * kPi * farthest / kLegMm)));
  const double step = 2 * kPi / count;
  const auto at = [count](int i) { return ((i % count) + count) % count; };
  std::vector<double> radii(count, beyond_mm);
  for (const Vec2& c : centres) {
    const double away = (c - middle).norm(), angle = std::atan2(c.y() - middle.y(), c.x() - middle.x());
    const double half = away > beyond_mm ? std::asin(beyond_mm / away) : kPi;
    for (int i = static_cast<int>(std::ceil((angle - half) / step)); i <= static_cast<int>(std::floor((angle + half) / step)); ++i) {
      const double aside = away * std::sin(i * step - angle);
      double& radius = radii[at(i)];
      radius = std::max(radius, away * std::cos(i * step - angle) + std::sqrt(std::max(0.0, beyond_mm * beyond_mm - aside * aside)));
    }
  }
  for (int i = 1; i < 2 * count; ++i) radii[at(i)] = std::max(radii[at(i)], radii[at(i - 1)] * std::exp(-kAslant * step));
  for (int i = 2 * count; i > 0; --i) radii[at(i - 1)] = std::max(radii[at(i - 1)], radii[at(i)] * std::exp(-kAslant * step));
  // The farthest within a reach, and its mean over the same reach: nowhere less.
  const int reach = static_cast<int>(std::ceil(kRoundMm / kLegMm));
  std::vector<double> widest(count), smooth(count, 0.0);
  for (int i = 0; i < count; ++i) {
    for (int d = -reach; d <= reach; ++d) widest[i] = std::max(widest[i], radii[at(i + d)]);
  }
  for (int i = 0; i < count; ++i) {
    for (int d = -reach; d <= reach; ++d) smooth[i] += widest[at(i + d)] / (2 * reach + 1);
  }
  const auto first = static_cast<int>(std::max_element(smooth.begin(), smooth.end()) - smooth.begin());
  std::vector<Vec2> turn;
  for (int i = 0; i < count; ++i) {
    const int k = at(first - i);
    turn.emplace_back(middle + smooth[k] * Vec2(std::cos(k * step), std::sin(k * step)));
  }
  return turn;
}

/// An arc away from a pass whose curvature grows evenly from the pass's own to 1 / radius at its end.
struct Arc {
  double length_mm, radius_mm;
  [[nodiscard]] double lift(double away_mm) const { return away_mm * away_mm * away_mm / (6 * radius_mm * length_mm); }
};

/// A vertex of a pass with its axis.
struct Vertex {
  Vec3 centre = Vec3::Zero();
  Vec3 axis = Vec3::UnitZ();
  Vec3 normal = Vec3::UnitZ();  ///< of the surface where the ball rests
  double lift_mm = 0;           ///< over the rest, on a landing curve
};

class Planner {
 public:
  Planner(const SplineSurface& surface, const Blank& blank, const Cutter& cutter, const FinishOptions& options)
      : surface_(surface),
        blank_(blank),
        cutter_(cutter),
        options_(options),
        radius_(cutter.radius_mm()),
        ball_(surface, radius_ + options.allowance_mm, 2 * radius_ + options.allowance_mm + kBesideMm + kLandInAirMm + 0.5),
        turned_(ball_, detail::Turn::by(options.angle_rad)) {
    beside_ = Box2::centred(blank.size_mm + Vec2::Constant(2 * (radius_ + kBesideMm)));
    tolerance_.chord_mm = options.chord_tolerance_mm;
    tolerance_.longest_mm = options.longest_segment_mm;
    tolerance_.shortest_mm = std::min(0.01, options.longest_segment_mm);
    arc_tolerance_ = tolerance_;
    arc_tolerance_.longest_mm = std::min(kArcLegMm, options.longest_segment_mm);
  }

  ToolPath plan(const Monitor& monitor) {
    if (options_.outline) within_.emplace(*options_.outline, detail::kJudgedBeyondMm);
    // Whether an axis exists is known at once; the passes do not depend on it.
    choose_axes();
    detail::SpacingOptions spacing;
    spacing.cutting_radius_mm = radius_;
    spacing.cusp_mm = options_.cusp_um * 1e-3;
    const std::vector<Vec2> border =
        centres_over(surface_, ball_.radius_mm(), border_places(surface_, options_.outline), turned_.turn());
    Box2 reach;
    for (const Vec2& centre : border) reach.include(centre);
    const double beyond = options_.allowance_mm > 0 ? kBeyondInStockMm : kBeyondMm;
    if (within_) {
      spacing.wanted = &*within_;
      spacing.ends = [&border, beyond](double y) { return reach_along_x(border, beyond, y); };
      reach.min -= Vec2::Constant(beyond - kBeyondMm);
      reach.max += Vec2::Constant(beyond - kBeyondMm);
    } else {
      spacing.ends = [this](double y) { return between_sides({0, y}, {1, 0}); };
    }
    spacing.from_y = reach.min.y();
    spacing.to_y = reach.max.y();
    spacing.tolerance = tolerance_;
    spacing.landing_mm = on_surface().length_mm;
    detail::SpacedPasses passes;
    if (options_.strategy == Strategy::kSpiral && within_ && options_.outline->shape != Outline::Shape::kRectangle) {
      const std::vector<Vec2> centres = centres_over(surface_, ball_.radius_mm(), border_places(surface_, options_.outline), {});
      Box2 box;
      for (const Vec2& centre : centres) box.include(centre);
      const double outside = beyond + detail::flat_stepover_mm(radius_, spacing.cusp_mm);
      passes = detail::space_outline_spiral(ball_, spacing, box.centre(), turn_around(centres, box.centre(), outside), monitor.part(0, 0.85));
    } else if (options_.strategy == Strategy::kSpiral) {
      spacing.ends = [](double) { return std::pair(-kUnbounded, kUnbounded); };  // pieces of it end where they may
      const double begin_y = within_ ? reach.min.y() : between_sides({reach.min.x(), 0}, {0, 1}).first;
      passes = detail::space_spiral(turned_, spacing, reach, begin_y, monitor.part(0, 0.85));
    } else {
      passes = detail::space_passes(turned_, spacing, monitor.part(0, 0.85));
    }

    const std::size_t passes_end = passes.paths.size();
    for (const auto& line : options_.also_along) add_line(line, passes.paths);
    // A spiral's pieces come after it.
    const auto lifts = [](const CentrePath& p) { return !p.joined; };
    const auto begin = passes.paths.begin();
    const auto cut_end = options_.strategy == Strategy::kSpiral ? std::find_if(begin + 1, begin + passes_end, lifts) : begin + passes_end;
    if (cut_end != passes.paths.end()) {
      land_in(Grooves(centre_lines(begin, cut_end), over_lens()), passes.paths, cut_end - begin);
    }
    ToolPath path = finished(std::move(passes.paths), passes.widest_mm, monitor);
    path.predicted_cusp_um = passes.highest_cusp_mm * 1e3;
    path.above_limit_mm2 = passes.above_limit_mm2;
    return path;
  }

  ToolPath plan_along(const std::vector<std::vector<Vec2>>& lines, const ToolPath& before, const Monitor& monitor) {
    if (options_.outline) within_.emplace(*options_.outline, detail::kJudgedBeyondMm);
    choose_axes();
    std::vector<CentrePath> paths;
    for (const auto& line : lines) add_line(line, paths);
    land_in(Grooves(centre_lines(before), over_lens()), paths, 0);
    return finished(std::move(paths), detail::flat_stepover_mm(radius_, options_.cusp_um * 1e-3), monitor);
  }

 private:
  void add_line(const std::vector<Vec2>& line, std::vector<CentrePath>& paths) const {
    std::vector<CentrePath> legs = detail::centre_paths_along(ball_, line, tolerance_);
    std::move(legs.begin(), legs.end(), std::back_inserter(paths));
  }

  [[nodiscard]] std::function<bool(const Vec2&)> over_lens() const {
    return [this](const Vec2& centre) {
      const Vec2 touched = ball_.at(centre.x(), centre.y()).point;
      return options_.outline ? options_.outline->contains(touched) : surface_.extent().contains(touched);
    };
  }

  /// The ball's way over paths, from above.
  using Paths = std::vector<CentrePath>::const_iterator;
  [[nodiscard]] static std::vector<std::vector<Vec2>> centre_lines(Paths begin, Paths end) {
    std::vector<std::vector<Vec2>> lines;
    for (; begin != end; ++begin) {
      if (!begin->joined) lines.emplace_back();
      for (std::size_t k = begin->joined ? 1 : 0; k < begin->points.size(); ++k) lines.back().push_back(begin->turn.out({begin->points[k].x, begin->y}));
    }
    return lines;
  }

  /// Where this ball touches what a larger one has touched on its way. Where that went over to another flank the line breaks.
  [[nodiscard]] std::vector<std::vector<Vec2>> centre_lines(const ToolPath& path) const {
    const double radius = path.cutter.radius_mm();
    const detail::BallContact large(surface_, radius, 2 * radius + kBesideMm + kLandInAirMm + 0.5);
    std::vector<std::vector<Vec2>> lines(1);
    Vec3 last_centre = Vec3::Zero();
    for (const Move& move : path.moves) {
      std::vector<Vec2>& line = lines.back();
      const Vec3 centre = move.pose.tip_mm + radius * move.pose.axis;
      const std::optional<detail::Contact> contact = move.kind == MoveKind::kCut ? std::optional(large.at(centre.x(), centre.y())) : std::nullopt;
      const bool rests = contact && centre.z() - contact->z < kRestsMm;
      const Vec2 here = rests ? Vec2(contact->point + ball_.radius_mm() / radius * (centre.head<2>() - contact->point)) : Vec2::Zero();
      const bool goes_on = rests && (line.empty() || (here - line.back()).norm() < 1.5 * (centre - last_centre).norm());
      if (!goes_on && !line.empty()) lines.emplace_back();
      if (rests) lines.back().push_back(here);
      last_centre = centre;
    }
    return lines;
  }

  /// Paths from number `first` on that begin or end over the lens come out of a groove and go back into one; where none is near, from
  /// beside the lens.
  void land_in(const Grooves& grooves, std::vector<CentrePath>& paths, std::size_t first) const {
    const auto over = over_lens();
    const double landing_mm = on_surface().length_mm;
    const auto lands_on_lens = [&](const CentrePath& path, int sense) {
      const std::vector<Vec2> line = straight_on(path, sense);
      for (const double part : {0.0, 0.25, 0.5, 0.75, 1.0}) {
        if (over(line[0] + part * (line[1] - line[0]))) return true;
      }
      return false;
    };
    const auto way_to = [&](const Vec2& place, const Vec2& along) {
      std::vector<Vec2> way = grooves.way_to(place, along, landing_mm);
      if (!way.empty()) return way;
      Vec2 beside = place;
      while (over(beside)) beside -= kLandMm * along;
      return std::vector<Vec2>{beside - landing_mm * along, place};
    };
    for (std::size_t k = first; k < paths.size(); ++k) {
      CentrePath& path = paths[k];
      const Vec2& along = path.turn.along;
      if (!path.joined && path.before.empty() && lands_on_lens(path, -1))
        path.before = way_to(path.turn.out({path.points.front().x, path.y}), along);
      const bool ends = k + 1 == paths.size() || !paths[k + 1].joined;
      if (!ends || !path.after.empty() || !lands_on_lens(path, 1)) continue;
      path.after = way_to(path.turn.out({path.points.back().x, path.y}), -along);
      std::reverse(path.after.begin(), path.after.end());
    }
  }

  ToolPath finished(std::vector<CentrePath> paths, double stepover_mm, const Monitor& monitor) {
    monitor.report("checking shank and holder", 0.87);
    settle_axis(paths);
    monitor.report("linking passes", 0.93);
    ToolPath path;
    path.pass = options_.pass;
    path.cutter = cutter_;
    path.spindle_rpm = cutter_.spindle_rpm;
    path.stepover_mm = stepover_mm;
    path.clearance_z_mm = std::max(highest_obstacle_mm(blank_), surface_.highest() + options_.allowance_mm) + options_.clearance_mm;
    assemble(std::move(paths), path);
    refuse_contact(path, blank_.keep_outs);
    monitor.report("passes planned", 1);
    return path;
  }

  void choose_axes() {
    if (options_.axis == AxisPolicy::kVertical) {
      leans_ = {{0, 0, 0, 0}};
    } else if (options_.axis == AxisPolicy::kFixed) {
      leans_ = detail::fixed_tilts(surface_, options_.tilt_rad, options_.angle_rad + options_.tilt_direction_rad, within(), options_.pass);
    } else {
      lead_.emplace(surface_, turned_.turn().along);
      leans_ = lead_->leans(options_.tilt_rad, options_.tilt_direction_rad, within(), options_.pass);
    }
  }

  /// From where to where the ball on the line through `place` (in the passes' axes) is not clear of the block's sides.
  [[nodiscard]] std::pair<double, double> between_sides(const Vec2& place, const Vec2& along) const {
    const Vec2 p = turned_.turn().out(place);
    const Vec2 d = turned_.turn().out(along);
    std::pair range(-kUnbounded, kUnbounded);
    for (int k = 0; k < 2; ++k) {
      if (std::abs(d[k]) < 1e-9) continue;
      const double a = (beside_.min[k] - p[k]) / d[k];
      const double b = (beside_.max[k] - p[k]) / d[k];
      range = {std::max(range.first, std::min(a, b)), std::min(range.second, std::max(a, b))};
    }
    return range;
  }

  [[nodiscard]] const OutlineRegion* within() const { return within_ ? &*within_ : nullptr; }

  /// The first lean whose shank and holder stay clear of the part.
  void settle_axis(const std::vector<CentrePath>& paths) {
    // Against the surface under its allowance and what earlier passes leave over it; the holder keeps another half millimetre.
    const detail::ToolClearance clearance(surface_, blank_, options_.allowance_mm, std::min(0.25, radius_ / 8),
                                          options_.standing ? &*options_.standing : nullptr);
    constexpr std::size_t kMostTried = 100;
    std::optional<detail::ToolContact> first_contact;
    const std::size_t tries = std::min(kMostTried, leans_.size());
    for (std::size_t k = 0; k < tries; ++k) {
      lean_ = leans_[k];
      const auto contact = touching(paths, clearance);
      if (!contact) return;
      if (!first_contact) first_contact = contact;
    }
    const Vec3& p = first_contact->place_mm;
    throw InputError(options_.pass + ": the " + (first_contact->holder ? "holder" : cutter_.taper_rad > 0 ? "flank or shank" : "shank") + " of '" + cutter_.name +
                     "' would touch the part or what stands of the blank near x " + fixed(p.x(), 1) + ", y " + fixed(p.y(), 1) + ", z " +
                     fixed(p.z(), 1) + " mm" +
                     (tries > 1 ? " (and so with " + std::to_string(tries - 1) + " other tilts)" : "") +
                     (first_contact->holder ? "; use a cutter that reaches farther out of its holder"
                                            : cutter_.taper_rad > 0 ? "; use a cutter of less taper, or another tilt"
                                                                     : "; use a cutter with a thinner shank or less tilt"));
  }

  [[nodiscard]] std::optional<detail::ToolContact> touching(const std::vector<CentrePath>& paths,
                                                            const detail::ToolClearance& clearance) const {
    // One pose in every cell that the way goes through; a flank passes nearer to the surface than a shank.
    const double cell = cutter_.taper_rad > 0 ? 0.25 : 2;
    std::set<std::pair<int, int>> seen;
    std::optional<detail::ToolContact> contact;
    const auto touches = [&](const Vec2& place, const auto& z) {
      if (!seen.emplace(static_cast<int>(std::floor(place.x() / cell)), static_cast<int>(std::floor(place.y() / cell))).second) return false;
      const Vec3 axis = axis_at(place);
      contact = clearance.touches(cutter_, {Vec3(place.x(), place.y(), z()) - radius_ * axis, axis});
      return contact.has_value();
    };
    for (const CentrePath& path : paths) {
      for (const PathPoint& p : path.points) {
        if (touches(path.turn.out({p.x, path.y}), [&] { return p.z; })) return contact;
      }
      for (const std::vector<Vec2>* way : {&path.before, &path.after}) {
        for (const Vec2& p : *way) {
          if (touches(p, [&] { return ball_.at(p.x(), p.y()).z; })) return contact;
        }
      }
    }
    return std::nullopt;
  }

  [[nodiscard]] Vec3 axis_at(const Vec2& place) const { return lead_ ? lead_->axis(place.x(), place.y(), lean_) : detail::fixed_axis(lean_); }

  [[nodiscard]] Vertex vertex(const CentrePath& path, const PathPoint& p, double lift) const {
    const Vec2 place = path.turn.out({p.x, path.y});
    const Vec2 away = (place - path.turn.out(p.contact)) / ball_.radius_mm();
    return {{place.x(), place.y(), p.z + lift},
            axis_at(place),
            {away.x(), away.y(), std::sqrt(std::max(0.0, 1 - away.squaredNorm()))},
            lift};
  }

  /// Whether a ball over the place stands beside the block, or may come down there from above.
  [[nodiscard]] bool in_air(const Vec2& place) const {
    return !options_.outline && ((place - beside_.min).minCoeff() <= 1e-9 || (beside_.max - place).minCoeff() <= 1e-9);
  }

  /// Whether the straight way between two places stays on one side of the block.
  [[nodiscard]] bool stays_beside(const Vec2& from, const Vec2& to) const {
    const Vec2 low = from.cwiseMin(to), high = from.cwiseMax(to);
    return !options_.outline && ((low - beside_.max).maxCoeff() >= -1e-9 || (beside_.min - high).maxCoeff() >= -1e-9);
  }

  /// The way of path number k, landing and leaving on arcs but where it joins another path; vertices close enough for a turning
  /// axis.
  [[nodiscard]] std::vector<Vertex> vertices(const std::vector<CentrePath>& paths, std::size_t k) const {
    const CentrePath& path = paths[k];
    std::vector<Vertex> result;
    if (!path.joined) {
      const std::vector<Vertex> landing =
          leaving(path.before.empty() ? straight_on(path, -1) : std::vector<Vec2>(path.before.rbegin(), path.before.rend()));
      for (std::size_t m = landing.size() - 1; m > 0; --m) add(result, landing[m]);
    }
    for (const PathPoint& p : path.points) add(result, vertex(path, p, 0));
    if (k + 1 == paths.size() || !paths[k + 1].joined) {
      const std::vector<Vertex> lifting = leaving(path.after.empty() ? straight_on(path, 1) : path.after);
      for (std::size_t m = 1; m < lifting.size(); ++m) add(result, lifting[m]);
    }
    if (options_.strategy == Strategy::kZigZag && k % 2 == 1 && !path.joined && !(k + 1 < paths.size() && paths[k + 1].joined)) std::reverse(result.begin(), result.end());
    return result;
  }

  /// From where a path begins (sense -1) or ends as far as an arc needs.
  [[nodiscard]] std::vector<Vec2> straight_on(const CentrePath& path, int sense) const {
    const Vec2 end((sense < 0 ? path.points.front() : path.points.back()).x, path.y);
    const Vec2 place = path.turn.out(end);
    return {place, path.turn.out(end + Vec2(sense * arc_at(place).length_mm, 0))};
  }

  /// Along a line away from a path, lifting on its last stretch.
  [[nodiscard]] std::vector<Vertex> leaving(const std::vector<Vec2>& line) const {
    const Arc arc = arc_at(line.front());
    double lifts_in = -arc.length_mm;
    for (std::size_t m = 1; m < line.size(); ++m) lifts_in += (line[m] - line[m - 1]).norm();
    std::vector<Vertex> result;
    for (const CentrePath& leg : detail::centre_paths_along(ball_, line, arc_tolerance_)) {
      const double begin = leg.points.front().x;
      for (const PathPoint& p : leg.points) {
        if (p.x > begin || result.empty()) result.push_back(vertex(leg, p, arc.lift(std::max(0.0, p.x - begin - lifts_in))));
      }
      lifts_in -= leg.points.back().x - begin;
    }
    return result;
  }

  [[nodiscard]] Arc arc_at(const Vec2& place) const {
    if (in_air(place)) return {kLandInAirMm, kLandInAirRadiusMm};
    return on_surface();
  }
  [[nodiscard]] Arc on_surface() const { return {options_.allowance_mm > 0 ? kLandInStockMm : kLandMm, kLandRadiusMm}; }

  void add(std::vector<Vertex>& list, const Vertex& next) const {
    if (lead_ && !list.empty()) {
      const Vertex here = list.back();
      const double turn = std::acos(std::clamp(here.axis.dot(next.axis), -1.0, 1.0));
      if (turn > kMostTurnRad && (next.centre - here.centre).head<2>().norm() > 0.02) {
        Vec3 middle = (here.centre + next.centre) / 2;
        const double lift = (here.lift_mm + next.lift_mm) / 2;
        if (lift == 0) middle.z() = ball_.at(middle.x(), middle.y()).z;
        add(list, {middle, axis_at(middle.head<2>()), next.normal, lift});
        add(list, next);
        return;
      }
    }
    list.push_back(next);
  }

  /// Highest place of the ball's centre at rest on the straight way between two places.
  [[nodiscard]] double highest_between(const Vec2& from, const Vec2& to) const {
    constexpr double kEveryMm = 0.5;
    double highest = -kUnbounded;
    const int steps = std::max(1, static_cast<int>(std::ceil((to - from).norm() / kEveryMm)));
    for (int k = 0; k <= steps; ++k) {
      const Vec2 p = from + (to - from) * (static_cast<double>(k) / steps);
      highest = std::max(highest, ball_.at(p.x(), p.y()).z);
    }
    return highest;
  }

  [[nodiscard]] ToolPose pose(const Vec3& centre, const Vec3& axis) const { return {centre - radius_ * axis, axis}; }
  [[nodiscard]] ToolPose pose(const Vertex& v) const { return pose(v.centre, v.axis); }

  /// Each path is let go once its moves are made: millions of them are most of the memory that planning takes.
  void assemble(std::vector<CentrePath> paths, ToolPath& out) const {
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

    constexpr std::size_t kBesides = 64;  // moves of landing, leaving and linking
    std::size_t expected = 0;
    for (const CentrePath& path : paths) expected += path.points.size() + kBesides;
    out.moves.reserve(expected);
    std::vector<Vertex> way = vertices(paths, 0);
    out.moves.push_back({at_height(pose(way.front()), out.clearance_z_mm), MoveKind::kRapid, 0});
    for (std::size_t k = 0; k < paths.size(); ++k) {
      // Down beside the part (or above a landing curve), then the pass.
      if (!paths[k].joined) link(pose(way.front()));
      for (std::size_t i = 1; i < way.size(); ++i) {
        const bool landing = way[i - 1].lift_mm > way[i].lift_mm && !in_air(way[i].centre.head<2>());
        out.moves.push_back({pose(way[i]), landing ? MoveKind::kPlunge : MoveKind::kCut,
                             landing ? std::min(feed_at(way[i]), cutter_.plunge_feed_mm_per_s) : feed_at(way[i])});
      }
      if (k + 1 == paths.size()) break;
      paths[k].points = {};
      std::vector<Vertex> next = vertices(paths, k + 1);
      const Vertex& here = way.back();
      const Vertex& there = next.front();
      if (!paths[k + 1].joined && (lead_ || !stays_beside(here.centre.head<2>(), there.centre.head<2>()))) {
        // Up, back, down: just above the highest place on the way; a turning axis needs full clearance.
        double tip_from = out.clearance_z_mm;
        if (!lead_) {
          // A step to the next pass needs no more than where both of them come down.
          const bool near = (here.centre - there.centre).head<2>().norm() <= kLandMm;
          const double above = near ? std::min(kLinkAboveMm, std::max(here.lift_mm, there.lift_mm)) : kLinkAboveMm;
          const double centre = std::max({highest_between(here.centre.head<2>(), there.centre.head<2>()) + above,
                                          here.centre.z(), there.centre.z()});
          tip_from = std::min(tip_from, centre - radius_ * std::cos(lean_.angle_rad));
          tip_from = std::max({tip_from, pose(here).tip_mm.z(), pose(there).tip_mm.z()});
        }
        link(at_height(pose(here), tip_from));
        link(at_height(pose(there), tip_from));
      }
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
  TurnedBall turned_;
  Box2 beside_;  ///< a ball whose centre is outside does not touch the block
  detail::PathTolerance tolerance_, arc_tolerance_;
  std::optional<OutlineRegion> within_;
  std::vector<detail::Lean> leans_;  ///< that keep the contact window, the best first
  std::optional<detail::LeadField> lead_;
  detail::Lean lean_;
};

}  // namespace

ToolPath plan_finishing(const SplineSurface& surface, const Blank& blank, const Cutter& ball,
                        const FinishOptions& options, const Monitor& monitor) {
  check(surface, blank, ball, options);
  return Planner(surface, blank, ball, options).plan(monitor);
}

ToolPath plan_along(const SplineSurface& surface, const Blank& blank, const Cutter& ball, const std::vector<std::vector<Vec2>>& lines,
                    const ToolPath& before, const FinishOptions& options, const Monitor& monitor) {
  check(surface, blank, ball, options);
  if (std::none_of(lines.begin(), lines.end(), [](const auto& line) { return line.size() > 1; })) throw InputError(options.pass + ": no line to follow");
  return Planner(surface, blank, ball, options).plan_along(lines, before, monitor);
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
  double way_mm = 0, climb_mm = 0;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (path.moves[k].kind != MoveKind::kCut) continue;
    const Vec3 way = path.moves[k].pose.tip_mm - path.moves[k - 1].pose.tip_mm;
    result.cutting_mm += way.norm();
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
    way_mm += way.norm();
    // M3 turns clockwise as seen from the spindle; the contact lies along -normal from the centre.
    if (axis.cross(normal).dot(way) < 0) climb_mm += way.norm();
  }
  if (way_mm > 0) result.climb_share = climb_mm / way_mm;
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

double polish_that_hides_mm(double radius_mm, double stepover_mm, double distance_mm, double refractive_index, double ripple) {
  // Curvature bunches light: of the parabolas' Fourier series the first cosine, curved by 2 / R, outlives all others.
  const double bunching = 2 * (refractive_index - 1) * distance_mm / radius_mm;
  return bunching > ripple ? stepover_mm / kPi * std::sqrt(0.5 * std::log(bunching / ripple)) : 0;
}

double ball_centre_height(const SplineSurface& surface, double radius_mm, double x, double y) {
  return detail::ball_contact(surface, radius_mm, x, y).z;
}

}  // namespace lightmill

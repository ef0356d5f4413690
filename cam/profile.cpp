#include "cam/profile.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "cam/detail/feeds.h"
#include "cam/work_holding.h"
#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kRampSlope = 0.0524;     ///< 3 degrees: the steepest way down with the centre in material
constexpr double kLookMm = 0.5;           ///< between places where material is looked for under the mill
constexpr double kShareOfDiameter = 0.4;  ///< between neighbouring turns on the land

/// A closed way, clockwise, by its length from the first place.
struct Loop {
  std::vector<Vec2> places;
  std::vector<double> at;  ///< of places, and of the whole at the end

  explicit Loop(std::vector<Vec2> counter_clockwise) : places(counter_clockwise.rbegin(), counter_clockwise.rend()) {
    at.push_back(0);
    for (std::size_t k = 0; k < places.size(); ++k) at.push_back(at.back() + (places[(k + 1) % places.size()] - places[k]).norm());
  }
  [[nodiscard]] double length() const { return at.back(); }
  /// Place at a length from 0 to length().
  [[nodiscard]] Vec2 place(double along) const {
    const auto next = std::upper_bound(at.begin() + 1, at.end() - 1, along);
    const std::size_t k = static_cast<std::size_t>(next - at.begin()) - 1;
    const double t = at[k + 1] > at[k] ? (along - at[k]) / (at[k + 1] - at[k]) : 0;
    return places[k] + t * (places[(k + 1) % places.size()] - places[k]);
  }
};

/// Way that a tab takes from the bottom: itself, the mill over it, its ramps.
double tab_way_mm(const ProfileOptions& options, const Cutter& mill) {
  return options.tab_width_mm + mill.diameter_mm + 2 * (options.tab_height_mm - options.skin_mm) / kRampSlope;
}

constexpr double kLeastTabWidthMm = 2, kLeastTabHeightMm = 0.5;

ProfileOptions with_least_tabs(ProfileOptions options) {
  options.tab_width_mm = std::min(options.tab_width_mm, kLeastTabWidthMm);
  options.tab_height_mm = std::min(options.tab_height_mm, std::max(kLeastTabHeightMm, 2 * options.skin_mm));
  return options;
}

/// "profile.tabs = 1 fits, or 2 with profile.tab_width_mm = 2 and profile.tab_height_mm = 0.5".
std::string tabs_that_fit(const ProfileOptions& options, const Cutter& mill, double way_mm) {
  const auto most = [&](const ProfileOptions& o) { return static_cast<int>(way_mm / tab_way_mm(o, mill)); };
  const ProfileOptions least = with_least_tabs(options);
  const int count = most(options), small = most(least);
  std::string text;
  if (count > 0) text = "profile.tabs = " + std::to_string(count) + " fits";
  if (small > count) {
    text += (count > 0 ? ", or " : "profile.tabs = ") + std::to_string(small) + " with profile.tab_width_mm = " + compact(least.tab_width_mm, 3) +
            " and profile.tab_height_mm = " + compact(least.tab_height_mm, 3) + (count > 0 ? "" : " fits");
  }
  if (std::max(count, small) == 0) return "none fit: hold the part from above or below and set profile.tabs = 0, or use a thinner roughing mill";
  if (std::max(count, small) < 3) text += "; so few may let the part tip, so hold it from below (tape) as well, or use a thinner roughing mill";
  return text;
}

class Cutout {
 public:
  Cutout(const SplineSurface& surface, const Blank& blank, const Cutter& mill, const ProfileOptions& options)
      : surface_(surface), blank_(blank), mill_(mill), options_(options), feed_(std::min(mill.feed_mm_per_s() / 2, options.max_feed_mm_per_s)) {}

  ToolPath plan(const Outline& optical, const Monitor& monitor) {
    clearance_z_ = highest_obstacle_mm(blank_) + options_.clearance_mm;
    const double radius = mill_.radius_mm();
    const Outline part = with_land(optical, options_.land_mm);
    if (options_.land_mm > 0) {
      // Rings from outside in, the last one along the optical surface.
      const double step = kShareOfDiameter * mill_.diameter_mm;
      const int rings = 1 + static_cast<int>(std::ceil(std::max(0.0, options_.land_mm - 2 * radius) / step));
      for (int k = rings - 1; k >= 0; --k) {
        monitor.report("milling the land", 0.4 * (rings - 1 - k) / rings);
        helix(Loop(way_around(optical, radius + std::min(k * step, std::max(0.0, options_.land_mm - radius)))), options_.land_z_mm, false);
      }
    }
    monitor.report("cutting out", 0.5);
    helix(Loop(way_around(part, radius)), options_.skin_mm, options_.tabs > 0);

    ToolPath path;
    path.pass = "profile";
    path.cutter = mill_;
    path.spindle_rpm = mill_.spindle_rpm;
    path.stepover_mm = mill_.diameter_mm;
    path.clearance_z_mm = clearance_z_;
    path.moves = std::move(moves_);
    const Vec3 end = path.moves.back().pose.tip_mm;
    path.moves.push_back({{{end.x(), end.y(), clearance_z_ + options_.clearance_mm}, Vec3::UnitZ()}, MoveKind::kRapid, 0});
    detail::limit_acceleration(path.moves, options_.acceleration_mm_per_s2);
    refuse_contact(path, blank_.keep_outs);
    monitor.report("cut-out planned", 1);
    return path;
  }

 private:
  /// Highest material under the mill anywhere on the way.
  [[nodiscard]] double highest_on(const Loop& loop) const {
    double highest = 0;
    const int across = static_cast<int>(std::ceil(mill_.radius_mm() / kLookMm));
    for (double along = 0; along < loop.length(); along += kLookMm) {
      const Vec2 centre = loop.place(along);
      for (int j = -across; j <= across; ++j) {
        for (int i = -across; i <= across; ++i) {
          const Vec2 p = centre + mill_.radius_mm() / across * Vec2(i, j);
          highest = std::max(highest, surface_.height(p.x(), p.y()));
        }
      }
    }
    return std::min(highest + options_.most_over_surface_mm, blank_.height_mm);
  }

  /// Lowest tip that leaves the tabs alone.
  [[nodiscard]] double over_tabs(const Loop& loop, double along) const {
    const double every = loop.length() / options_.tabs;
    // The first one half a spacing from the start; distances go around.
    const double phase = std::fmod(along, every);
    const double beside = std::max(0.0, std::abs(phase - every / 2) - options_.tab_width_mm / 2 - mill_.radius_mm());
    return options_.tab_height_mm - beside * kRampSlope;
  }

  void helix(const Loop& loop, double bottom_z, bool tabs) {
    const auto refuse = [](const std::string& what) { throw InputError("profile: " + what); };
    const double top = highest_on(loop);
    const double depth = top - bottom_z;
    const double reach = std::min(mill_.flute_length_mm, mill_.holder.empty() ? mill_.length_mm : mill_.holder.front().from_mm - options_.clearance_mm / 2);
    if (blank_.height_mm - bottom_z > reach) {
      refuse("cutting " + compact(blank_.height_mm - bottom_z, 2) + " mm deep needs longer flutes and reach than the " + compact(reach, 2) +
             " mm of '" + mill_.name + "'; use a longer mill or a lower blank, or leave it out (profile.cut = false)");
    }
    if (options_.stepdown_mm > kRampSlope * loop.length()) {
      refuse("a turn of " + compact(loop.length(), 1) + " mm around the part is too short to go down " + compact(options_.stepdown_mm, 3) +
             " mm at 3 degrees; set rough.stepdown_mm to at most " + compact(kRampSlope * loop.length(), 2));
    }
    if (tabs && options_.tabs * tab_way_mm(options_, mill_) > loop.length()) {
      refuse(std::to_string(options_.tabs) + " tabs of " + compact(options_.tab_width_mm, 2) + " mm and their ramps do not fit on " +
             compact(loop.length(), 1) + " mm; " + tabs_that_fit(options_, mill_, loop.length()));
    }
    const Vec2 start = loop.places.front();
    if (moves_.empty()) {
      moves_.push_back({{{start.x(), start.y(), clearance_z_}, Vec3::UnitZ()}, MoveKind::kRapid, 0});
    } else {
      push(start, clearance_z_, MoveKind::kRapid, 0);
    }
    push(start, top, MoveKind::kLink, options_.link_feed_mm_per_s);
    // Down in a helix, then once around on the bottom. Where tabs begin and end there are vertices.
    const double turns = std::max(0.0, depth / options_.stepdown_mm);
    const double down = turns * loop.length();
    const double ramp_feed = std::min(feed_, mill_.plunge_feed_mm_per_s);
    std::vector<double> stops;
    const double whole = down + loop.length();
    for (std::size_t turn = 0; static_cast<double>(turn) * loop.length() < whole; ++turn) {
      for (std::size_t k = 0; k < loop.places.size(); ++k) stops.push_back(static_cast<double>(turn) * loop.length() + loop.at[k]);
      for (double along = 0; tabs && along < loop.length(); along += 0.25) stops.push_back(static_cast<double>(turn) * loop.length() + along);
    }
    stops.push_back(down);
    stops.push_back(whole);
    std::sort(stops.begin(), stops.end());
    const auto height = [&](double s) {
      const double z = std::max(bottom_z, top - s / loop.length() * options_.stepdown_mm);
      return tabs ? std::max(z, over_tabs(loop, std::fmod(s, loop.length()))) : z;
    };
    Vec3 before(start.x(), start.y(), height(0));
    double last = 0;
    for (const double s : stops) {
      if (s <= last + 1e-6 || s > whole) continue;
      const Vec2 p = loop.place(std::fmod(s, loop.length()));
      const Vec3 here(p.x(), p.y(), height(s));
      const bool sinks = here.z() < before.z() - 1e-9;
      push(p, here.z(), sinks ? MoveKind::kPlunge : MoveKind::kCut, sinks ? ramp_feed : feed_);
      before = here;
      last = s;
    }
    push({before.x(), before.y()}, clearance_z_, MoveKind::kLink, options_.link_feed_mm_per_s);
  }

  void push(const Vec2& at, double z, MoveKind kind, double feed) { moves_.push_back({{{at.x(), at.y(), z}, Vec3::UnitZ()}, kind, feed}); }

  const SplineSurface& surface_;
  const Blank& blank_;
  const Cutter& mill_;
  const ProfileOptions& options_;
  double feed_;
  double clearance_z_ = 0;
  std::vector<Move> moves_;
};

}  // namespace

ProfileOptions with_fitting_tabs(ProfileOptions options, const Outline& optical, const Cutter& mill) {
  constexpr int kLeastTabs = 3;  // two would let the part tip
  const double way = Loop(way_around(with_land(optical, options.land_mm), mill.radius_mm())).length();
  const auto fits = [&](const ProfileOptions& o) { return o.tabs * tab_way_mm(o, mill) <= way; };
  if (fits(options)) return options;
  ProfileOptions fewer = options;
  while (fewer.tabs > kLeastTabs && !fits(fewer)) --fewer.tabs;
  if (fits(fewer)) return fewer;
  const ProfileOptions least = with_least_tabs(fewer);
  if (!fits(least)) return options;
  // As wide and high as fits between the two: the way grows evenly.
  const double share = (way / fewer.tabs - tab_way_mm(least, mill)) / (tab_way_mm(fewer, mill) - tab_way_mm(least, mill));
  const double taken = std::max(0.0, share - 1e-9);
  fewer.tab_width_mm = least.tab_width_mm + taken * (fewer.tab_width_mm - least.tab_width_mm);
  fewer.tab_height_mm = least.tab_height_mm + taken * (fewer.tab_height_mm - least.tab_height_mm);
  return fewer;
}

ToolPath plan_profile(const SplineSurface& surface, const Blank& blank, const Outline& optical, const Cutter& mill,
                      const ProfileOptions& options, const Monitor& monitor) {
  const auto refuse = [](const std::string& what) { throw InputError("profile: " + what); };
  if (!(mill.radius_mm() > 0 && mill.feed_mm_per_s() > 0 && mill.plunge_feed_mm_per_s > 0)) refuse("the cutter '" + mill.name + "' has no diameter or no feeds");
  if (!(options.stepdown_mm >= 0.05)) refuse("stepdown_mm must be at least 0.05");
  if (!(options.skin_mm >= 0 && options.skin_mm < blank.height_mm)) refuse("skin_mm must be from 0 to below the blank's height");
  if (options.tabs < 0 || (options.tabs > 0 && !(options.tab_width_mm > 0 && options.tab_height_mm > options.skin_mm))) {
    refuse("tabs need a width above 0 and a height above the skin of " + compact(options.skin_mm, 3) + " mm");
  }
  if (options.land_mm > 0 && !(options.land_z_mm > std::max(options.skin_mm, options.tabs > 0 ? options.tab_height_mm : 0))) {
    refuse("the land lies " + compact(options.land_z_mm, 2) + " mm over the back, below the tabs; make the lens thicker or the land less deep (lens.land_drop_mm)");
  }
  return Cutout(surface, blank, mill, options).plan(optical, monitor);
}

}  // namespace lightmill

#include "cam/detail/ball_passes.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

constexpr double kReachableMm = 1.1e-4;  ///< closing above the surface by less (0.1 um and a little): reachable
constexpr double kJumpMm = 2e-4;         ///< of the centre in y, while the contact still moves far: it jumps
constexpr double kIntoJumpMm = 0.01;     ///< steps into the unreachable from its border
constexpr double kStationMm = 0.015;     ///< stations nearer than this are one
constexpr double kLeastOfFlat = 0.25;    ///< a march never takes smaller steps than this share of the flat stepover
constexpr double kMostOfFlat = 2.0;
constexpr double kInfillLeastOfFlat = 1.0 / 16;
constexpr double kInfillGrowMm = 0.6;  ///< an infill piece starts before and ends after the stretch that asks for it
constexpr double kInfillMergeMm = 4;   ///< pieces nearer than this become one

PathPoint point_at(const BallContact& ball, double x, double y) {
  const Contact contact = ball.at(x, y);
  return {x, contact.z, contact.slope.x(), contact.point};
}

/// Squared distance in the plane of a path from (x, z) to the segment between two vertices.
double squared_distance(const PathPoint& a, const PathPoint& b, double x, double z) {
  const double dx = b.x - a.x;
  const double dz = b.z - a.z;
  const double px = x - a.x;
  const double pz = z - a.z;
  const double t = std::clamp((px * dx + pz * dz) / (dx * dx + dz * dz), 0.0, 1.0);
  const double ex = px - t * dx;
  const double ez = pz - t * dz;
  return ex * ex + ez * ez;
}

/// Distance from q to a path, by walking downhill from the segment after vertex `hint`, looking a little ahead because
/// of kinks. Should a nearer place lie behind a hill, the answer is too large, never too small.
double distance(const CentrePath& path, std::size_t hint, const Vec3& q) {
  const auto& points = path.points;
  const int last = static_cast<int>(points.size()) - 2;
  const auto at = [&](int k) { return squared_distance(points[k], points[k + 1], q.x(), q.z()); };
  const int start = std::clamp(static_cast<int>(hint), 0, last);
  double best = at(start);
  for (const int direction : {1, -1}) {
    constexpr double kAheadMm = 0.1;
    double from_x = points[start].x;
    for (int k = start + direction; k >= 0 && k <= last; k += direction) {
      const double d = at(k);
      if (d < best) {
        best = d;
        from_x = points[k].x;
      } else if (std::abs(points[k].x - from_x) > kAheadMm) {
        break;
      }
    }
  }
  const double dy = q.y() - path.y;
  return std::sqrt(best + dy * dy);
}

/// What two neighbouring paths leave at one place along them.
struct Station {
  double x = 0;
  double length = 0;  ///< of path that it stands for
  double width = 0;   ///< between the two contacts
  double cusp = 0;    ///< highest on the reachable surface between the contacts, mm
  bool jump = false;  ///< the contacts are far apart: cusp grows with the spacing, not with its square
};

class Spacer {
 public:
  Spacer(const BallContact& ball, const SpacingOptions& options)
      : ball_(ball), options_(options), flat_(flat_stepover_mm(options.cutting_radius_mm, options.cusp_mm)) {
    wanted_ = ball.surface().extent();
    wanted_.min -= Vec2::Constant(2 * flat_);
    wanted_.max += Vec2::Constant(2 * flat_);
  }

  [[nodiscard]] double flat() const { return flat_; }

  [[nodiscard]] CentrePath path(double y) const {
    return centre_path(ball_, y, options_.from_x, options_.to_x, options_.tolerance);
  }

  /// All passes from path `first` up to and without one at `end_y`.
  void march(double start_y, double end_y, SpacedPasses& result) const {
    CentrePath here = path(start_y);
    double spacing = 0.95 * flat_;
    const double least = kLeastOfFlat * flat_;
    const double most = kMostOfFlat * flat_;
    while (here.y < end_y) {
      CentrePath next;
      std::vector<Station> stations;
      spacing = std::clamp(spacing, least, most);
      for (int trial = 0; trial < 4; ++trial) {
        double next_y = here.y + spacing;
        // No sliver before the end: the last two steps share what is left.
        if (next_y > end_y - 1e-9)
          next_y = end_y;
        else if (next_y > end_y - least)
          next_y = (here.y + end_y) / 2;
        next = path(next_y);
        stations = leftover(here, next, -kInfinity, kInfinity);
        const double taken = next_y - here.y;
        const double wish = std::clamp(cheapest(stations, taken), least, most);
        const bool at_end = next_y < here.y + spacing;
        if (wish < 0.995 * taken) {
          spacing = wish * 0.997;
        } else if (wish > 1.015 * taken && !at_end && trial < 2 && taken < 0.999 * most) {
          spacing = wish;
        } else {
          break;
        }
        if (taken <= least * 1.0001 && wish <= least) break;
      }
      result.widest_mm = std::max(result.widest_mm, next.y - here.y);
      spacing = next.y - here.y;
      std::vector<CentrePath> pieces;
      settle(here, next, stations, 0, pieces, result);
      std::stable_sort(pieces.begin(), pieces.end(), [](const CentrePath& a, const CentrePath& b) {
        return a.y != b.y ? a.y < b.y : a.points.front().x < b.points.front().x;
      });
      result.paths.push_back(std::move(here));
      for (auto& piece : pieces) result.paths.push_back(std::move(piece));
      here = std::move(next);
    }
  }

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  /// The point of the (offset) surface over p, and its distance from being cut by either path: the cusp there.
  struct Left {
    double a = 0, b = 0;
    Vec3 on_surface;
    [[nodiscard]] double cusp() const { return std::min(a, b); }
  };
  [[nodiscard]] Left left_at(const CentrePath& a, std::size_t i, const CentrePath& b, std::size_t j,
                             const Vec2& p) const {
    Left left;
    const double allowance = ball_.radius_mm() - options_.cutting_radius_mm;
    Vec3 q;
    if (allowance > 0) {
      const auto s = ball_.surface().sample(p.x(), p.y());
      left.on_surface = {p.x(), p.y(), s.h};
      q = left.on_surface + allowance / std::sqrt(1 + s.hx * s.hx + s.hy * s.hy) * Vec3(-s.hx, -s.hy, 1);
    } else {
      left.on_surface = {p.x(), p.y(), ball_.surface().height(p.x(), p.y())};
      q = left.on_surface;
    }
    left.a = distance(a, i, q) - options_.cutting_radius_mm;
    left.b = distance(b, j, q) - options_.cutting_radius_mm;
    return left;
  }

  /// Highest cusp between two paths at x, by following the contact as the ball goes from one to the other. Everything
  /// it touches is reachable. Where it jumps, a ball rests on two flanks at once, and what is between is reachable only
  /// so far as that ball leaves less than 0.1 um there.
  class Follower {
   public:
    Follower(const Spacer& spacer, const CentrePath& a, std::size_t i, const CentrePath& b, std::size_t j, double x)
        : spacer_(spacer), a_(a), b_(b), i_(i), j_(j), x_(x), close_mm_(0.3 * (b.y - a.y)) {}

    double highest(const Vec2& pa, const Vec2& pb) {
      consider(pa);
      consider(pb);
      follow(a_.y, pa, b_.y, pb);
      return highest_;
    }

   private:
    void consider(const Vec2& p) {
      if (spacer_.wanted_.contains(p)) highest_ = std::max(highest_, spacer_.left_at(a_, i_, b_, j_, p).cusp());
    }

    void follow(double y1, const Vec2& p1, double y2, const Vec2& p2) {
      const double width = (p2 - p1).norm();
      if (width <= close_mm_) return;
      const double y = (y1 + y2) / 2;
      const Contact middle = spacer_.ball_.at(x_, y);
      if (y2 - y1 > kJumpMm) {
        consider(middle.point);
        follow(y1, p1, y, middle.point);
        follow(y, middle.point, y2, p2);
        return;
      }
      const Vec3 centre(x_, y, middle.z);
      for (const int from_first : {1, 0}) {
        for (double t = kIntoJumpMm; t < width; t += kIntoJumpMm) {
          const Vec2 p = from_first ? Vec2(p1 + (p2 - p1) * (t / width)) : Vec2(p2 + (p1 - p2) * (t / width));
          const Vec3 q(p.x(), p.y(), spacer_.ball_.surface().height(p.x(), p.y()));
          if ((centre - q).norm() - spacer_.ball_.radius_mm() > kReachableMm) break;
          consider(p);
        }
      }
    }

    const Spacer& spacer_;
    const CentrePath& a_;
    const CentrePath& b_;
    std::size_t i_, j_;
    double x_;
    double close_mm_;
    double highest_ = 0;
  };

  /// Stations at the vertices of both paths within [from_x, to_x]; `a` and `b` may be of different lengths.
  [[nodiscard]] std::vector<Station> leftover(const CentrePath& a, const CentrePath& b, double from_x,
                                              double to_x) const {
    const double spacing = b.y - a.y;
    const double low = std::max({from_x, a.points.front().x, b.points.front().x});
    const double high = std::min({to_x, a.points.back().x, b.points.back().x});
    std::vector<double> xs;
    std::size_t i = 0, j = 0;
    while (i < a.points.size() || j < b.points.size()) {
      double x;
      if (j >= b.points.size() || (i < a.points.size() && a.points[i].x <= b.points[j].x))
        x = a.points[i++].x;
      else
        x = b.points[j++].x;
      if (x >= low && x <= high && (xs.empty() || x - xs.back() > kStationMm)) xs.push_back(x);
    }
    // Where the ball touches from each path; where a contact goes far between stations, more of them.
    struct Touch {
      double x;
      std::size_t i, j;
      Vec2 pa, pb;
    };
    std::vector<Touch> touches;
    i = j = 0;
    const auto follow = [](const CentrePath& path, double x, std::size_t& at) {
      while (at + 1 < path.points.size() && std::abs(path.points[at + 1].x - x) <= std::abs(path.points[at].x - x))
        ++at;
    };
    const auto touch_at = [&](double x, bool exact) {
      follow(a, x, i);
      follow(b, x, j);
      Touch t{x, i, j, a.points[i].contact, b.points[j].contact};
      if (exact && a.points[i].x != x) t.pa = ball_.at(x, a.y).point;
      if (exact && b.points[j].x != x) t.pb = ball_.at(x, b.y).point;
      return t;
    };
    const double fine = 0.07 * flat_;
    for (const double x : xs) {
      Touch next = touch_at(x, false);
      if (!touches.empty() && x - touches.back().x > fine) {
        const Touch last = touches.back();
        const double dx = x - last.x;
        const double far = 2 * dx + 0.5 * spacing;
        if ((next.pa - last.pa).norm() > far || (next.pb - last.pb).norm() > far ||
            (next.pb - next.pa).norm() > 2.2 * spacing || (last.pb - last.pa).norm() > 2.2 * spacing) {
          i = last.i;
          j = last.j;
          const int pieces = static_cast<int>(std::ceil(dx / fine));
          for (int m = 1; m < pieces; ++m) touches.push_back(touch_at(last.x + dx * m / pieces, true));
          next = touch_at(x, false);
        }
      }
      touches.push_back(next);
    }
    std::vector<Station> stations;
    for (std::size_t k = 0; k < touches.size(); ++k) {
      const Touch& t = touches[k];
      const Vec2 chord = t.pb - t.pa;
      Station station;
      station.x = t.x;
      station.length = (touches[std::min(k + 1, touches.size() - 1)].x - touches[k > 0 ? k - 1 : 0].x) / 2;
      station.width = chord.norm();
      station.jump = station.width > 2.2 * spacing;
      // Half-way, then where both paths leave the same (each leftover grows with the square of the way).
      if (!station.jump) {
        const Vec2 half = t.pa + chord / 2;
        const Left left = left_at(a, t.i, b, t.j, half);
        const double ra = std::sqrt(std::max(left.a, 1e-9));
        const double rb = std::sqrt(std::max(left.b, 1e-9));
        const Vec2 even = t.pa + chord * (rb / (ra + rb));
        if (wanted_.contains(half)) station.cusp = std::max(station.cusp, left.cusp());
        if (wanted_.contains(even)) station.cusp = std::max(station.cusp, left_at(a, t.i, b, t.j, even).cusp());
      }
      // A wide way may hold places that no ball reaches.
      if (station.jump || (station.cusp > options_.cusp_mm && station.width > 1.3 * spacing)) {
        station.cusp = Follower(*this, a, t.i, b, t.j, t.x).highest(t.pa, t.pb);
      }
      stations.push_back(station);
    }
    return stations;
  }

  /// The spacing with the least path per area: every station is content, or the discontent get infill.
  [[nodiscard]] double cheapest(const std::vector<Station>& stations, double spacing) const {
    const double aim = 0.99 * options_.cusp_mm;
    struct Wish {
      double spacing, length;
    };
    std::vector<Wish> wishes;
    double total = 0;
    for (const Station& s : stations) {
      const double ratio = aim / std::max(s.cusp, 1e-3 * aim);
      wishes.push_back({spacing * (s.jump ? (ratio < 1 ? ratio : 10) : std::sqrt(ratio)), s.length});
      total += s.length;
    }
    if (wishes.empty() || total <= 0) return kMostOfFlat * flat_;
    std::vector<Wish> sorted = wishes;
    std::stable_sort(sorted.begin(), sorted.end(), [](const Wish& a, const Wish& b) { return a.spacing < b.spacing; });
    double best_spacing = sorted.front().spacing;
    double best_cost = 1 / std::max(best_spacing, kLeastOfFlat * flat_);
    double share = 0;
    std::size_t at = 0;
    for (const double part : {0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4}) {
      while (at + 1 < sorted.size() && share < part * total) share += sorted[at++].length;
      const double s = sorted[at].spacing;
      // Infill halves the spacing until it fits; each piece costs its way in and out besides.
      double extra = 0;
      double last_end = -kInfinity;
      for (std::size_t k = 0; k < wishes.size(); ++k) {
        if (wishes[k].spacing >= s) continue;
        const double x = stations[k].x;
        if (x > last_end + kInfillMergeMm)
          extra += 2 * kInfillGrowMm + 6;
        else
          extra += std::max(0.0, x - last_end - wishes[k].length);
        last_end = std::max(last_end, x);
        extra += wishes[k].length * (std::exp2(std::ceil(std::log2(s / wishes[k].spacing))) - 1);
      }
      const double cost = (1 + extra / total) / std::min(s, kMostOfFlat * flat_);
      if (cost < 0.98 * best_cost) {
        best_cost = cost;
        best_spacing = s;
      }
    }
    return best_spacing;
  }

  /// Infill between two neighbours until every reachable place is within the limit or the pieces lie too close.
  void settle(const CentrePath& a, const CentrePath& b, const std::vector<Station>& stations, int depth,
              std::vector<CentrePath>& pieces, SpacedPasses& result) const {
    const double spacing = b.y - a.y;
    const bool may_divide = spacing / 2 >= kInfillLeastOfFlat * flat_;
    std::size_t k = 0;
    while (k < stations.size()) {
      const Station& s = stations[k];
      if (s.cusp <= options_.cusp_mm || !may_divide) {
        result.highest_cusp_mm = std::max(result.highest_cusp_mm, s.cusp);
        if (s.cusp > options_.cusp_mm) result.above_limit_mm2 += s.length * std::min(s.width, spacing);
        ++k;
        continue;
      }
      std::size_t last = k;
      for (std::size_t m = k + 1; m < stations.size() && stations[m].x - stations[last].x < kInfillMergeMm; ++m) {
        if (stations[m].cusp > options_.cusp_mm) last = m;
      }
      const double from = stations[k].x - kInfillGrowMm;
      const double to = stations[last].x + kInfillGrowMm;
      CentrePath piece = centre_path(ball_, (a.y + b.y) / 2, std::max(from, options_.from_x),
                                     std::min(to, options_.to_x), options_.tolerance);
      piece.infill = true;
      ++result.infill_pieces;
      const double inner_from = stations[k].x;
      const double inner_to = stations[last].x;
      settle(a, piece, leftover(a, piece, inner_from, inner_to), depth + 1, pieces, result);
      settle(piece, b, leftover(piece, b, inner_from, inner_to), depth + 1, pieces, result);
      pieces.push_back(std::move(piece));
      k = last + 1;
    }
  }

  const BallContact& ball_;
  const SpacingOptions& options_;
  double flat_;
  Box2 wanted_;  // the lens and what is just beyond its border, so that the last point on it is looked at from both
                 // sides
};

}  // namespace

double flat_stepover_mm(double radius_mm, double cusp_mm) {
  return 2 * std::sqrt(cusp_mm * (2 * radius_mm - cusp_mm));
}

CentrePath centre_path(const BallContact& ball, double y, double from_x, double to_x, const PathTolerance& tolerance) {
  CentrePath path;
  path.y = y;
  path.points.push_back(point_at(ball, from_x, y));
  double step = tolerance.longest_mm;
  while (path.points.back().x < to_x) {
    const PathPoint& here = path.points.back();
    step = std::clamp(step, tolerance.shortest_mm, tolerance.longest_mm);
    PathPoint next;
    double error = 0;  // as a multiple of the tolerance
    while (true) {
      // No sliver at the end.
      double length = step;
      if (here.x + length > to_x - 1e-9)
        length = to_x - here.x;
      else if (here.x + 1.5 * length > to_x)
        length = (to_x - here.x) / 2;
      next = point_at(ball, here.x + length, y);
      if (length == to_x - here.x) next.x = to_x;
      const double chord = (next.z - here.z) / length;
      const double bend = std::max(std::abs(here.slope - chord), std::abs(next.slope - chord));
      // A parabola of that end slope stands length * bend / 4 above its chord, measured across it a little less.
      error = std::max(bend * length / 4 / tolerance.chord_mm / std::sqrt(1 + chord * chord), bend / tolerance.slope);
      if (error <= 1 || length <= tolerance.shortest_mm) break;
      step = std::max(tolerance.shortest_mm, length * std::clamp(0.95 / std::sqrt(error), 0.2, 0.9));
    }
    step = (next.x - here.x) * std::clamp(0.93 / std::sqrt(std::max(error, 1e-3)), 0.5, 3.0);
    path.points.push_back(next);
  }
  return path;
}

SpacedPasses space_passes(const BallContact& ball, const SpacingOptions& options, const Monitor& monitor) {
  const Spacer spacer(ball, options);
  // Bands of y march on their own, in parallel; where they meet a pass is given. Their count depends on the part alone.
  const double height = options.to_y - options.from_y;
  const int bands = std::clamp(static_cast<int>(height / (40 * spacer.flat())), 1, 16);
  constexpr int kGroup = 4;
  std::vector<SpacedPasses> parts(bands);
  for (int first = 0; first < bands; first += kGroup) {
    monitor.report("spacing passes", static_cast<double>(first) / bands);
    const int count = std::min(kGroup, bands - first);
    parallel_blocks(count, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const int band = first + static_cast<int>(k);
        spacer.march(options.from_y + height * band / bands, options.from_y + height * (band + 1) / bands, parts[band]);
      }
    });
  }
  SpacedPasses all;
  for (SpacedPasses& part : parts) {
    for (CentrePath& path : part.paths) all.paths.push_back(std::move(path));
    all.widest_mm = std::max(all.widest_mm, part.widest_mm);
    all.highest_cusp_mm = std::max(all.highest_cusp_mm, part.highest_cusp_mm);
    all.above_limit_mm2 += part.above_limit_mm2;
    all.infill_pieces += part.infill_pieces;
  }
  all.paths.push_back(spacer.path(options.to_y));
  return all;
}

}  // namespace lightmill::detail

#include "cam/detail/ball_passes.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

constexpr double kReachableMm = 1e-4;    ///< closing above the surface by less: reachable
constexpr double kLeastOfFlat = 0.25;    ///< a march never takes smaller steps than this share of the flat stepover
constexpr double kMostOfFlat = 2.0;
constexpr double kInfillLeastOfFlat = 1.0 / 16;
constexpr double kInfillGrowMm = 0.6;    ///< an infill piece starts before and ends after the stretch that asks for it
constexpr double kInfillMergeMm = 4;     ///< pieces nearer than this become one

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

/// Distance from q to a path, by walking downhill from the segment after vertex `hint` (looking two segments ahead).
double distance(const CentrePath& path, std::size_t hint, const Vec3& q) {
  const auto& points = path.points;
  const int last = static_cast<int>(points.size()) - 2;
  const auto at = [&](int k) { return squared_distance(points[k], points[k + 1], q.x(), q.z()); };
  const int start = std::clamp(static_cast<int>(hint), 0, last);
  double best = at(start);
  for (const int direction : {1, -1}) {
    int worse = 0;
    for (int k = start + direction; k >= 0 && k <= last && worse < 2; k += direction) {
      const double d = at(k);
      if (d < best) {
        best = d;
        worse = 0;
      } else {
        ++worse;
      }
    }
  }
  const double dy = q.y() - path.y;
  return std::sqrt(best + dy * dy);
}

/// What two neighbouring paths leave at one place along them.
struct Station {
  double x = 0;
  double length = 0;    ///< of path that it stands for
  double width = 0;     ///< between the two contacts
  double cusp = 0;      ///< highest on the reachable surface between the contacts, mm
  bool jump = false;    ///< the contacts are far apart: cusp grows with the spacing, not with its square
};

class Spacer {
 public:
  Spacer(const BallContact& ball, const SpacingOptions& options)
      : ball_(ball), options_(options), flat_(flat_stepover_mm(options.cutting_radius_mm, options.cusp_mm)) {}

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
        if (next_y > end_y - 1e-9) next_y = end_y;
        else if (next_y > end_y - least) next_y = (here.y + end_y) / 2;
        next = path(next_y);
        stations = leftover(here, next, -kInfinity, kInfinity);
        const double taken = next_y - here.y;
        const double wish = std::clamp(cheapest(stations, taken), least, most);
        const bool at_end = next_y < here.y + spacing;
        if (wish < 0.995 * taken) {
          spacing = wish * 0.997;
        } else if (wish > 1.03 * taken && !at_end && trial < 2 && taken < 0.999 * most) {
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
  [[nodiscard]] Left left_at(const CentrePath& a, std::size_t i, const CentrePath& b, std::size_t j, const Vec2& p) const {
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

  [[nodiscard]] bool reachable(const Vec3& q, const CentrePath& a, const CentrePath& b) const {
    // The ball that touches q, or comes nearest, is between or close to the two paths.
    const auto s = ball_.surface().sample(q.x(), q.y());
    const double w = ball_.radius_mm() / std::sqrt(1 + s.hx * s.hx + s.hy * s.hy);
    const Vec2 touching(q.x() - s.hx * w, std::clamp(q.y() - s.hy * w, a.y, b.y));
    return closing_gap_mm(ball_, q, touching, 0.5 * (b.y - a.y), kReachableMm) <= kReachableMm;
  }

  /// Stations at the vertices of `a` within [from_x, to_x]; `a` and `b` may be of different lengths.
  [[nodiscard]] std::vector<Station> leftover(const CentrePath& a, const CentrePath& b, double from_x, double to_x) const {
    const Box2& extent = ball_.surface().extent();
    const double spacing = b.y - a.y;
    const double low = std::max({from_x, a.points.front().x, b.points.front().x});
    const double high = std::min({to_x, a.points.back().x, b.points.back().x});
    std::vector<Station> stations;
    std::size_t j = 0;
    for (std::size_t i = 0; i < a.points.size(); ++i) {
      const PathPoint& pa = a.points[i];
      if (pa.x < low || pa.x > high) continue;
      while (j + 1 < b.points.size() && std::abs(b.points[j + 1].x - pa.x) <= std::abs(b.points[j].x - pa.x)) ++j;
      const PathPoint& pb = b.points[j];
      const Vec2 chord = pb.contact - pa.contact;
      Station station;
      station.x = pa.x;
      station.length = ((i + 1 < a.points.size() ? a.points[i + 1].x : pa.x) - (i > 0 ? a.points[i - 1].x : pa.x)) / 2;
      station.width = chord.norm();
      station.jump = station.width > 2.2 * spacing;
      if (!station.jump) {
        // Half-way, then where both paths leave the same (each leftover grows with the square of the way).
        const Vec2 half = pa.contact + chord / 2;
        const Left left = left_at(a, i, b, j, half);
        if (extent.contains(half)) consider(station, left, a, b);
        const double ra = std::sqrt(std::max(left.a, 1e-9));
        const double rb = std::sqrt(std::max(left.b, 1e-9));
        const Vec2 even = pa.contact + chord * (rb / (ra + rb));
        if (extent.contains(even)) consider(station, left_at(a, i, b, j, even), a, b);
      } else {
        // From either flank inwards, until no ball reaches.
        const int steps = std::clamp(static_cast<int>(std::ceil(station.width / (0.25 * spacing))), 4, 200);
        bool open = true;
        for (int k = 0; k <= steps && open; ++k) {
          const Vec2 p = pa.contact + chord * (static_cast<double>(k) / steps);
          if (extent.contains(p)) open = consider(station, left_at(a, i, b, j, p), a, b);
        }
        if (!open) {
          open = true;
          for (int k = steps; k >= 0 && open; --k) {
            const Vec2 p = pa.contact + chord * (static_cast<double>(k) / steps);
            if (extent.contains(p)) open = consider(station, left_at(a, i, b, j, p), a, b);
          }
        }
      }
      stations.push_back(station);
    }
    return stations;
  }

  /// Takes a place into account if it is reachable; false if not.
  bool consider(Station& station, const Left& left, const CentrePath& a, const CentrePath& b) const {
    const double cusp = left.cusp();
    if (cusp <= station.cusp) return true;
    if (cusp > options_.cusp_mm && !reachable(left.on_surface, a, b)) return false;
    station.cusp = cusp;
    return true;
  }

  /// The spacing with the least path per area: every station is content, or the discontent get infill.
  [[nodiscard]] double cheapest(const std::vector<Station>& stations, double spacing) const {
    const double aim = 0.985 * options_.cusp_mm;
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
        if (x > last_end + kInfillMergeMm) extra += 2 * kInfillGrowMm + 6;
        else extra += std::max(0.0, x - last_end - wishes[k].length);
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
      CentrePath piece = centre_path(ball_, (a.y + b.y) / 2, std::max(from, options_.from_x), std::min(to, options_.to_x),
                                     options_.tolerance);
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
      if (here.x + length > to_x - 1e-9) length = to_x - here.x;
      else if (here.x + 1.5 * length > to_x) length = (to_x - here.x) / 2;
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

double closing_gap_mm(const BallContact& ball, const Vec3& q, const Vec2& start, double step_mm, double enough_mm) {
  const auto gap = [&](const Vec2& c) {
    return (Vec3(c.x(), c.y(), ball.at(c.x(), c.y()).z) - q).norm() - ball.radius_mm();
  };
  Vec2 best_place = start;
  double best = gap(start);
  constexpr double kLeastStepMm = 1e-3;
  constexpr double kDiagonal = 0.70710678118654752;
  static const Vec2 kDirections[8] = {{0, 1},  {0, -1}, {1, 0}, {-1, 0}, {kDiagonal, kDiagonal}, {-kDiagonal, kDiagonal},
                                      {kDiagonal, -kDiagonal}, {-kDiagonal, -kDiagonal}};
  for (double step = step_mm; step > kLeastStepMm && best > enough_mm; step /= 2) {
    for (int repeat = 0; repeat < 8; ++repeat) {
      const Vec2 from = best_place;
      for (const Vec2& direction : kDirections) {
        const Vec2 place = from + direction * step;
        const double g = gap(place);
        if (g < best) {
          best = g;
          best_place = place;
        }
      }
      if (best_place == from || best <= enough_mm) break;
    }
  }
  return best;
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

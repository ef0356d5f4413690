#include "cam/detail/ball_passes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>

#include "cam/detail/grooves.h"
#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kParabola = 0.985;       ///< of the chord tolerance: between its ends a path may bend a little more than a parabola
constexpr double kReachableMm = 1.1e-4;  ///< closing above the surface by less (0.1 um and a little): reachable
constexpr double kJumpMm = 2e-4;         ///< of the centre in y, while the contact still moves far: it jumps
constexpr double kIntoJumpMm = 0.01;     ///< steps into the unreachable from its border
constexpr double kStationMm = 0.015;     ///< stations nearer than this are one
constexpr double kEvenMm = 1e-5;         ///< between a place's distances to both paths: the ridge is at most half of that higher
constexpr int kMostLooks = 4;            ///< for a ridge
constexpr double kBeyondOfFlat = 0.75;   ///< ridges so far beyond the lens count: half-way from the last contact on it to the next one
constexpr double kLeastOfFlat = 0.25;    ///< full passes are never nearer than this share of the flat stepover
constexpr double kMostOfFlat = 2.0;
constexpr double kSurveyOfFlat = 0.9;  ///< even passes that tell what each place allows
constexpr double kAim = 0.995;         ///< of the cusp, for passes not yet placed
constexpr double kSmoothMm = 3;        ///< to either side: spacing goes from one value to another over twice this
constexpr double kSmoothLoss = 0.003;  ///< share of the spacing that smoothness may cost everywhere
constexpr int kMostRounds = 4;         ///< of placing passes
constexpr double kInfillSaves = 0.25;   ///< share of the path that infill must save, for its borders show in the light
constexpr double kInfillLeastOfFlat = 1.0 / 16;
constexpr double kInfillGrowMm = 0.6;  ///< an infill piece starts before and ends after the stretch that asks for it
constexpr double kSagittaOfFlat = 0.01;  ///< of legs of a spiral that become one
constexpr double kInfillMergeMm = 12;  ///< pieces nearer than this become one: two ways out of the groove and back are longer

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

/// The x of the lens's middle, in the ball's axes.
double middle_of(const TurnedBall& ball) { return ball.turn().in(ball.ball().surface().extent().centre()).x(); }

/// What two neighbouring paths leave at one place along them.
struct Station {
  double x = 0;
  double length = 0;  ///< of path that it stands for
  double width = 0;   ///< between the two contacts
  double cusp = 0;    ///< highest on the reachable surface between the contacts, mm
  bool jump = false;  ///< the contacts are far apart: cusp grows with the spacing, not with its square
};

/// Distance between neighbouring passes as a function of y: limits are gathered, and what is taken stays below them and
/// changes slowly. (Light through the polished surface sees the mean height of the cusps, a third of the highest: where
/// it changes within a millimetre by some nanometres, there is a line in the picture.)
class SpacingField {
 public:
  /// Cells of at most `pitch_mm` that divide the way evenly, so that a mirrored part gets mirrored passes.
  SpacingField(double from_y, double to_y, double pitch_mm, double most_mm) : from_(from_y), to_(to_y) {
    const double cells = std::max(1.0, std::ceil((to_y - from_y) / pitch_mm - 1e-9));
    pitch_ = (to_y - from_y) / cells;
    limits_.assign(static_cast<std::size_t>(cells), most_mm);
  }

  /// Of the cells: passes for a survey.
  [[nodiscard]] std::vector<double> nodes() const {
    std::vector<double> ys;
    for (std::size_t k = 0; k <= limits_.size(); ++k) ys.push_back(from_ + pitch_ * static_cast<double>(k));
    return ys;
  }

  /// Between these two places passes must not be farther from each other than this.
  void limit(double from_y, double to_y, double spacing_mm) {
    const auto cell = [&](double y) {
      return std::clamp(static_cast<int>(std::floor((y - from_) / pitch_)), 0, static_cast<int>(limits_.size()) - 1);
    };
    // A cell that is only just touched is the neighbour's.
    for (int k = cell(from_y + 1e-3 * pitch_); k <= cell(to_y - 1e-3 * pitch_); ++k)
      limits_[k] = std::min(limits_[k], spacing_mm);
  }

  /// Passes from the first place to the last; what the last spacing is too long by stands out evenly at both ends.
  [[nodiscard]] std::vector<double> places() const {
    const std::vector<double> smooth = smooth_envelope();
    // Spacings passed by the middle of every cell; between the middles the spacing is linear in y.
    const double half_first = pitch_ / 2 / smooth.front();
    std::vector<double> count = {half_first};
    const auto spacings = [](double from, double to, double length) {
      const double bend = (to - from) / from;
      return length / from * (std::abs(bend) < 1e-6 ? 1 - bend / 2 : std::log1p(bend) / bend);
    };
    for (std::size_t k = 1; k < smooth.size(); ++k)
      count.push_back(count.back() + spacings(smooth[k - 1], smooth[k], pitch_));
    const double total = count.back() + pitch_ / 2 / smooth.back();
    const int passes = static_cast<int>(std::ceil(total - 1e-9)) + 1;
    const double surplus = (passes - 1 - total) / 2;
    std::vector<double> ys;
    std::size_t k = 0;
    for (int pass = 0; pass < passes; ++pass) {
      const double at = pass - surplus;
      if (at <= count.front()) {
        ys.push_back(from_ + at * smooth.front());
      } else if (at >= count.back()) {
        ys.push_back(to_ - (total - at) * smooth.back());
      } else {
        while (count[k + 1] < at) ++k;
        const double bend = (smooth[k + 1] - smooth[k]) / smooth[k];
        const double way = (at - count[k]) * smooth[k];  // at the spacing of the cell's middle
        const double x = way * bend / pitch_;
        ys.push_back(from_ + (static_cast<double>(k) + 0.5) * pitch_ + (std::abs(x) < 1e-6 ? way * (1 + x / 2) : way * std::expm1(x) / x));
      }
    }
    return ys;
  }

 private:
  /// The lowest of the limits near, those farther away counting as q d^2 higher, averaged three times over a third of
  /// the reach. Averaging with variance v adds at most q v to any limit, which is taken off: none is exceeded.
  [[nodiscard]] std::vector<double> smooth_envelope() const {
    const int count = static_cast<int>(limits_.size());
    const int third = std::max(1, static_cast<int>(std::ceil(kSmoothMm / 3 / pitch_)));
    const int reach = 3 * third + 1;
    const double variance = third * (third + 1.0);  // of three means over 2 third + 1 cells, in cells^2
    const double lowest = *std::min_element(limits_.begin(), limits_.end());
    const double rise = kSmoothLoss * lowest / variance;
    std::vector<double> values(count);
    for (int k = 0; k < count; ++k) {
      values[k] = limits_[k];
      for (int d = -reach; d <= reach; ++d)
        values[k] = std::min(values[k], limits_[std::clamp(k + d, 0, count - 1)] + rise * d * d);
    }
    for (int pass = 0; pass < 3; ++pass) {
      std::vector<double> mean(count);
      for (int k = 0; k < count; ++k) {
        double sum = 0;
        for (int d = -third; d <= third; ++d) sum += values[std::clamp(k + d, 0, count - 1)];
        mean[k] = sum / (2 * third + 1);
      }
      values = std::move(mean);
    }
    for (double& value : values) value -= kSmoothLoss * lowest;
    return values;
  }

  double from_, to_, pitch_;
  std::vector<double> limits_;  // of the cells between the nodes
};

/// Moves the paths of `part` over, and its figures.
void take_over(SpacedPasses& all, SpacedPasses& part) {
  for (CentrePath& piece : part.paths) all.paths.push_back(std::move(piece));
  all.highest_cusp_mm = std::max(all.highest_cusp_mm, part.highest_cusp_mm);
  all.above_limit_mm2 += part.above_limit_mm2;
  all.infill_pieces += part.infill_pieces;
}

class Spacer {
 public:
  Spacer(const TurnedBall& ball, const SpacingOptions& options)
      : ball_(ball), options_(options), flat_(flat_stepover_mm(options.cutting_radius_mm, options.cusp_mm)) {
    wanted_ = ball.ball().surface().extent();
    wanted_.min -= Vec2::Constant(kBeyondOfFlat * flat_);
    wanted_.max += Vec2::Constant(kBeyondOfFlat * flat_);
  }

  /// What there is between two neighbouring passes.
  struct Between {
    double wish_mm = 0;   ///< the spacing that would suit best here
    bool content = true;  ///< the spacing taken does
    SpacedPasses pieces;  ///< infill, and figures of what is left
  };

  /// Between `a` and `b`, which lies at a greater y.
  [[nodiscard]] Between look(const CentrePath& a, const CentrePath& b, bool with_infill) const {
    const double taken = b.y - a.y;
    const std::vector<Station> stations = leftover(a, b, -kInfinity, kInfinity);
    Between here;
    here.wish_mm = std::max(cheapest(stations, taken, kAim * options_.cusp_mm), kLeastOfFlat * flat_);
    if (!with_infill) return here;
    here.content = cheapest(stations, taken, options_.cusp_mm) >= taken || taken <= kLeastOfFlat * flat_ * 1.0001;
    settle(a, b, a, stations, here.pieces.paths, here.pieces);
    std::stable_sort(here.pieces.paths.begin(), here.pieces.paths.end(), [](const CentrePath& p, const CentrePath& q) {
      return p.y != q.y ? p.y < q.y : p.points.front().x < q.points.front().x;
    });
    return here;
  }

  [[nodiscard]] double flat_mm() const { return flat_; }

  /// f(0..count), in parallel, telling of it now and then.
  template <class F>
  static void in_groups(std::size_t count, const Monitor& monitor, const F& f) {
    constexpr std::size_t kGroup = 64;
    for (std::size_t first = 0; first < count; first += kGroup) {
      monitor.report("spacing passes", static_cast<double>(first) / static_cast<double>(count));
      parallel_blocks(std::min(kGroup, count - first), 4, [&](std::size_t begin, std::size_t end) {
        for (std::size_t k = begin; k < end; ++k) f(first + k);
      });
    }
  }

  /// A survey, passes placed by what it allows, a look at what they leave.
  [[nodiscard]] SpacedPasses plan(const Monitor& monitor) const {
    SpacingField field(options_.from_y, options_.to_y, kSurveyOfFlat * flat_, kMostOfFlat * flat_);
    std::vector<double> ys = field.nodes();
    std::vector<CentrePath> paths = compute_paths(ys, monitor.part(0, 0.2));
    std::vector<Between> between = look_between(paths, false, monitor.part(0.2, 0.4));
    for (std::size_t k = 0; k + 1 < ys.size(); ++k) field.limit(ys[k], ys[k + 1], between[k].wish_mm);
    // What the survey foretells for other passes is right to about a hundredth; where it is not, the field gives way.
    for (int round = 0;; ++round) {
      const Monitor part = monitor.part(0.4 + 0.15 * round, 0.4 + 0.15 * (round + 1));
      ys = field.places();
      paths = {};  // not both at once
      between = {};
      paths = compute_paths(ys, part.part(0, 0.5));
      between = look_between(paths, true, part.part(0.5, 1));
      bool content = true;
      for (std::size_t k = 0; k + 1 < ys.size(); ++k) {
        if (between[k].content) continue;
        content = false;
        field.limit(ys[k], ys[k + 1], between[k].wish_mm);
      }
      if (content || round + 1 == kMostRounds) break;
    }
    SpacedPasses all;
    for (std::size_t k = 0; k < paths.size(); ++k) {
      all.paths.push_back(std::move(paths[k]));
      if (k + 1 == paths.size()) break;
      all.widest_mm = std::max(all.widest_mm, ys[k + 1] - ys[k]);
      take_over(all, between[k].pieces);
    }
    return all;
  }

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
      if (x >= low && x <= high) xs.push_back(x);
    }
    thin(xs);
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
        } else {
          // Chords are up to their tolerance above the path between its vertices, and so is what they leave.
          touches.push_back({last.x + dx / 2, last.i, last.j, (last.pa + next.pa) / 2, (last.pb + next.pb) / 2});
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
      if (!station.jump) station.cusp = ridge_between(a, t.i, b, t.j, t.pa, t.pb);
      // A wide way may hold places that no ball reaches.
      if (station.jump || (station.cusp > options_.cusp_mm && station.width > 1.3 * spacing)) {
        station.cusp = Follower(*this, a, t.i, b, t.j, t.x).highest(t.pa, t.pb);
      }
      stations.push_back(station);
    }
    return stations;
  }

  /// Growing places without those too near to one that is nearer to the lens's middle.
  void thin(std::vector<double>& xs) const {
    const auto half = std::lower_bound(xs.begin(), xs.end(), middle_of(ball_));
    const auto near = [](double a, double b) { return std::abs(a - b) <= kStationMm; };
    const auto end = std::unique(half, xs.end(), near);
    const auto begin = std::unique(std::make_reverse_iterator(half), xs.rend(), near).base();
    xs = std::vector<double>(begin, end);
  }

  /// The spacing at which no station's cusp is above `aim`; or a wider one, with infill for the discontent, where that
  /// saves much of the path.
  [[nodiscard]] double cheapest(const std::vector<Station>& stations, double spacing, double aim) const {
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
    double best_cost = (1 - kInfillSaves) / std::max(best_spacing, kLeastOfFlat * flat_);
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
          extra += 2 * (kInfillGrowMm + kGoOverMm) + 6;
        else
          extra += std::max(0.0, x - last_end - wishes[k].length);
        last_end = std::max(last_end, x);
        extra += wishes[k].length * (std::exp2(std::ceil(std::log2(s / wishes[k].spacing))) - 1);
      }
      const double cost = (1 + extra / total) / std::min(s, kMostOfFlat * flat_);
      if (cost < best_cost) {
        best_cost = cost;
        best_spacing = s;
      }
    }
    return best_spacing;
  }

 private:
  [[nodiscard]] std::vector<CentrePath> compute_paths(const std::vector<double>& ys, const Monitor& monitor) const {
    std::vector<CentrePath> paths(ys.size());
    in_groups(paths.size(), monitor, [&](std::size_t k) {
      const auto [from_x, to_x] = options_.ends(ys[k]);
      paths[k] = centre_path(ball_, ys[k], from_x, to_x, options_.tolerance);
    });
    return paths;
  }

  [[nodiscard]] std::vector<Between> look_between(const std::vector<CentrePath>& paths, bool with_infill,
                                                  const Monitor& monitor) const {
    std::vector<Between> result(paths.size() - 1);
    in_groups(result.size(), monitor, [&](std::size_t k) { result[k] = look(paths[k], paths[k + 1], with_infill); });
    return result;
  }

  [[nodiscard]] bool is_wanted(const Vec2& p) const {
    const Vec2 place = ball_.turn().out(p);
    return wanted_.contains(place) && (!options_.wanted || options_.wanted->contains(place));
  }

  /// Distance of the (offset) surface's point over p from being cut by either path: the cusp there.
  struct Left {
    double a = 0, b = 0;
    [[nodiscard]] double cusp() const { return std::min(a, b); }
  };
  [[nodiscard]] Left left_at(const CentrePath& a, std::size_t i, const CentrePath& b, std::size_t j,
                             const Vec2& p) const {
    Left left;
    const double allowance = ball_.radius_mm() - options_.cutting_radius_mm;
    Vec3 q(p.x(), p.y(), ball_.height(p));
    if (allowance > 0) q += allowance * ball_.normal(p);
    left.a = distance(a, i, q) - options_.cutting_radius_mm;
    left.b = distance(b, j, q) - options_.cutting_radius_mm;
    return left;
  }

  /// The cusp on the straight way between two places, highest where both paths leave the same. Looked for from half-way on, so that
  /// mirrored parts get the same.
  [[nodiscard]] double ridge_between(const CentrePath& a, std::size_t i, const CentrePath& b, std::size_t j, const Vec2& from, const Vec2& to) const {
    double highest = 0;
    double share = 0.5, before = 0, before_uneven = 0;
    for (int look = 0; look < kMostLooks; ++look) {
      const Vec2 p = from + share * (to - from);
      const Left left = left_at(a, i, b, j, p);
      if (is_wanted(p)) highest = std::max(highest, left.cusp());
      const double uneven = left.a - left.b;
      if (std::abs(uneven) < kEvenMm) break;
      double next = 0;
      if (look == 0) {
        // What they leave grows about with the square of the way from their contacts.
        const double ra = std::sqrt(std::max(left.a, 1e-9)) / share;
        const double rb = std::sqrt(std::max(left.b, 1e-9)) / (1 - share);
        next = rb / (ra + rb);
      } else {
        next = share - uneven * (share - before) / (uneven - before_uneven);
      }
      before = share;
      before_uneven = uneven;
      share = std::isfinite(next) ? std::clamp(next, 0.02, 0.98) : 0.5;
    }
    return highest;
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
      if (spacer_.is_wanted(p)) highest_ = std::max(highest_, spacer_.left_at(a_, i_, b_, j_, p).cusp());
    }

    void follow(double y1, const Vec2& p1, double y2, const Vec2& p2) {
      const double width = (p2 - p1).norm();
      if (width <= close_mm_) {
        highest_ = std::max(highest_, spacer_.ridge_between(a_, i_, b_, j_, p1, p2));
        return;
      }
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
          const Vec3 q(p.x(), p.y(), spacer_.ball_.height(p));
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

  /// Infill between two neighbours until every reachable place is within the limit or the pieces lie too close. `groove` is the
  /// pass before, which is cut by then.
  void settle(const CentrePath& a, const CentrePath& b, const CentrePath& groove, const std::vector<Station>& stations,
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
      const double inner_from = stations[k].x;
      const double inner_to = stations[last].x;
      CentrePath piece = infill(groove, (a.y + b.y) / 2, inner_from - kInfillGrowMm, inner_to + kInfillGrowMm);
      ++result.infill_pieces;
      settle(a, piece, groove, leftover(a, piece, inner_from, inner_to), pieces, result);
      settle(piece, b, groove, leftover(piece, b, inner_from, inner_to), pieces, result);
      pieces.push_back(std::move(piece));
      k = last + 1;
    }
  }

  /// A piece at `y`, out of a groove and back into it; where that has no room it runs out to where passes end.
  [[nodiscard]] CentrePath infill(const CentrePath& groove, double y, double from_x, double to_x) const {
    const double room = kGoOverMm + options_.landing_mm;
    const auto [first_x, last_x] = options_.ends(y);
    // Spirals' sides end in corners, which are drawn out.
    const double beside = std::isfinite(first_x) ? 0 : kMostOfFlat * flat_;
    const bool comes_over = from_x - room >= std::max(first_x, groove.points.front().x + beside);
    const bool goes_back = to_x + room <= std::min(last_x, groove.points.back().x - beside);
    if (!comes_over && std::isfinite(first_x)) from_x = first_x;
    if (!goes_back && std::isfinite(last_x)) to_x = last_x;
    CentrePath piece = centre_path(ball_, y, from_x, to_x, options_.tolerance);
    if (comes_over) {
      piece.before = over({from_x - kGoOverMm, groove.y}, {from_x, y});
      piece.before.insert(piece.before.begin(), ball_.turn().out({from_x - room, groove.y}));
    }
    if (goes_back) {
      piece.after = over({to_x, y}, {to_x + kGoOverMm, groove.y});
      piece.after.push_back(ball_.turn().out({to_x + room, groove.y}));
    }
    return piece;
  }

  /// An S from one place to another, along X at both.
  [[nodiscard]] std::vector<Vec2> over(const Vec2& from, const Vec2& to) const {
    const Turn& turn = ball_.turn();
    return bend(turn.out(from), turn.along, turn.out(to), turn.along, to.x() - from.x());
  }

  TurnedBall ball_;
  const SpacingOptions& options_;
  double flat_;
  Box2 wanted_;  // the lens and what is just beyond its border, so that the last point on it is looked at from both
                 // sides
};

/// From the end of a line back into the groove of its last turn, which lies beside it after vertex `turn`, and in it round
/// and round until the ball has lifted.
std::vector<Vec2> around_again(const std::vector<Vec2>& line, std::size_t turn, double spacing, double landing_mm) {
  const auto along = [&](std::size_t k) { return Vec2((line[k + 1] - line[k]).normalized()); };
  constexpr int kLegs = 12;
  const std::vector<Vec2> back = bend(line.back(), along(line.size() - 2), line[turn], along(turn), 2 * spacing, kLegs);
  std::vector<Vec2> result = {line.back()};
  for (double lifting = 0; lifting < landing_mm;) {
    if (result.size() > 1) lifting += 2 * spacing;
    result.insert(result.end(), back.begin() + 1, back.end());
    for (std::size_t k = turn + 1; k < line.size(); ++k) {
      lifting += (line[k] - line[k - 1]).norm();
      result.push_back(line[k]);
    }
  }
  return result;
}

/// Places a spiral's turns by depth: a survey, turns by what it allows, and a look at what they leave, after which the field gives way
/// where that is too much. `look(depths, placed, monitor)` tells what is between every two depths, with `wish_mm` and `content`; a
/// placed turn is beside `reach` depths from its own on.
template <class Look>
auto place_turns(SpacingField field, std::size_t reach, const Look& look, const Monitor& monitor, std::vector<double>& depths) {
  depths = field.nodes();
  auto between = look(depths, false, monitor.part(0, 0.4));
  for (std::size_t k = 0; k < between.size(); ++k) field.limit(depths[k], depths[k + 1], between[k].wish_mm);
  for (int round = 0;; ++round) {
    depths = field.places();
    between = {};
    between = look(depths, true, monitor.part(0.4 + 0.15 * round, 0.4 + 0.15 * (round + 1)));
    bool content = true;
    for (std::size_t k = 0; k < between.size(); ++k) {
      if (between[k].content) continue;
      content = false;
      field.limit(depths[k], depths[std::min(k + reach, depths.size() - 1)], between[k].wish_mm);
    }
    if (content || round + 1 == kMostRounds) return between;
  }
}

/// A spiral as rings of four sides, each side in axes of its own in which it runs along +X and the middle lies at smaller y.
class SpiralSpacer {
 public:
  SpiralSpacer(const TurnedBall& ball, const SpacingOptions& options, const Box2& around, double begin_y)
      : ball_(ball), options_(options), around_(around), begin_y_(begin_y), depth_(around.size().minCoeff() / 2) {
    constexpr std::array<int, 8> kAlong = {0, 1, 1, 0, 0, -1, -1, 0};  // up, right, down, left
    for (int side = 0; side < 4; ++side) {
      turns_[side].along = ball.turn().out({kAlong[2 * side], kAlong[2 * side + 1]});
      spacers_.emplace_back(TurnedBall(ball.ball(), turns_[side]), options);
    }
  }

  [[nodiscard]] SpacedPasses plan(const Monitor& monitor) const {
    const double flat = spacers_[0].flat_mm();
    std::vector<double> depths;
    std::vector<Between> between =
        place_turns(SpacingField(0, depth_, kSurveyOfFlat * flat, kMostOfFlat * flat), 1,
                    [this](const std::vector<double>& at, bool placed, const Monitor& part) { return look(at, placed, part); }, monitor, depths);
    SpacedPasses all;
    all.paths = sides(depths);
    for (std::size_t k = 0; k < between.size(); ++k) {
      all.widest_mm = std::max(all.widest_mm, depths[k + 1] - depths[k]);
      for (SpacedPasses& part : between[k].pieces) take_over(all, part);
    }
    return all;
  }

 private:
  struct Between {
    double wish_mm = kInfinity;
    bool content = true;
    std::array<SpacedPasses, 4> pieces;
  };

  /// The ring so deep in the rectangle; the last one is the middle line.
  [[nodiscard]] Box2 ring(double depth) const {
    Box2 box = around_;
    const double in = std::min(depth, depth_);
    box.min += Vec2::Constant(in);
    box.max -= Vec2::Constant(in);
    return box;
  }

  /// A ring's corners in the order of the sides' beginnings.
  [[nodiscard]] static std::array<Vec2, 4> corners(const Box2& box) {
    return {box.min, Vec2(box.min.x(), box.max.y()), box.max, Vec2(box.max.x(), box.min.y())};
  }

  /// Side of a ring from corner to corner, in its own axes.
  [[nodiscard]] CentrePath side_path(const Box2& box, int side) const {
    const auto at = corners(box);
    const Vec2 from = turns_[side].in(ball_.turn().out(at[side]));
    const Vec2 to = turns_[side].in(ball_.turn().out(at[(side + 1) % 4]));
    return centre_path(TurnedBall(ball_.ball(), turns_[side]), from.y(), from.x(), std::max(to.x(), from.x() + 1e-3), options_.tolerance);
  }

  [[nodiscard]] std::vector<Between> look(const std::vector<double>& depths, bool with_infill, const Monitor& monitor) const {
    std::vector<std::array<CentrePath, 4>> paths(depths.size());
    Spacer::in_groups(depths.size(), monitor.part(0, 0.5), [&](std::size_t k) {
      for (int side = 0; side < 4; ++side) paths[k][side] = side_path(ring(depths[k]), side);
    });
    std::vector<Between> result(depths.size() - 1);
    Spacer::in_groups(result.size(), monitor.part(0.5, 1), [&](std::size_t k) {
      for (int side = 0; side < 4; ++side) {
        if (paths[k + 1][side].y >= paths[k][side].y - 1e-9) continue;
        Spacer::Between here = spacers_[side].look(paths[k + 1][side], paths[k][side], with_infill);
        result[k].wish_mm = std::min(result[k].wish_mm, here.wish_mm);
        result[k].content = result[k].content && here.content;
        result[k].pieces[side] = std::move(here.pieces);
      }
    });
    return result;
  }

  /// The whole way: every side ends at the next one, the last side of a ring at the next ring. Half-way between two sharp
  /// corners it would be sqrt(2) (2 - sqrt(2)) / 2 = 0.59 of the spacing to the nearest way; corners are drawn out to make it
  /// a half.
  [[nodiscard]] std::vector<CentrePath> sides(const std::vector<double>& depths) const {
    constexpr double kDrawnOut = 0.1465;  // of the spacing: 1 - 0.5 (1 + 1 / sqrt(2))
    constexpr double kBeside = 0.3;       // so far before and behind the corner: less than half, or the next turn's would be as far
    std::vector<Vec2> line = {{ring(depths.front()).min.x(), begin_y_}};
    std::vector<double> spacing = {0};
    for (std::size_t k = 0; k < depths.size(); ++k) {
      const bool middle = k + 1 == depths.size();
      const Box2 box = ring(depths[k]);
      std::vector<Vec2> turns = {{box.min.x(), box.max.y()}, box.max};
      if (!middle) turns.insert(turns.end(), {{box.max.x(), box.min.y()}, {ring(depths[k + 1]).min.x(), box.min.y()}});
      const double outwards = k > 0 ? ring(depths[k]).min.x() - ring(depths[k - 1]).min.x() : depths[1] - depths[0];
      for (const Vec2& corner : turns) {
        if ((corner - line.back()).norm() < 1e-6) continue;
        line.push_back(corner);
        spacing.push_back(outwards);
      }
    }
    std::vector<Vec2> drawn = {line.front()};
    for (std::size_t k = 1; k + 1 < line.size(); ++k) {
      const Vec2 in = (line[k] - line[k - 1]).normalized();
      const Vec2 out = (line[k + 1] - line[k]).normalized();
      drawn.push_back(line[k] - kBeside * spacing[k] * in);
      drawn.push_back(line[k] + kDrawnOut * spacing[k] * (in - out));
      drawn.push_back(line[k] + kBeside * spacing[k] * out);
    }
    drawn.push_back(line.back());
    std::vector<Vec2> after = line.size() > 4 ? around_again(drawn, 3 * (line.size() - 4), spacing.back(), options_.landing_mm) : std::vector<Vec2>();
    for (Vec2& p : drawn) p = ball_.turn().out(p);
    for (Vec2& p : after) p = ball_.turn().out(p);
    std::vector<CentrePath> paths = centre_paths_along(ball_.ball(), drawn, options_.tolerance);
    paths.back().after = std::move(after);
    return paths;
  }

  TurnedBall ball_;
  const SpacingOptions& options_;
  Box2 around_;
  double begin_y_;
  double depth_;  // of the middle
  std::array<Turn, 4> turns_;
  std::vector<Spacer> spacers_;
};

/// A spiral of turns that are all like the outermost one, smaller and smaller: `outermost` about `middle`, clockwise, from its farthest
/// place on. Each leg of a turn is parallel to the same leg of the next one, and judged against it as passes are.
class OutlineSpiralSpacer {
 public:
  OutlineSpiralSpacer(const BallContact& ball, const SpacingOptions& options, const Vec2& middle, const std::vector<Vec2>& outermost)
      : ball_(ball), options_(options), middle_(middle), outermost_(outermost) {
    for (std::size_t i = 0; i < legs(); ++i) {
      const Vec2 leg = corner(i + 1) - corner(i);
      turns_.push_back({leg.normalized()});
      depth_ = std::max(depth_, turns_.back().in(corner(i) - middle_).y());
      spacers_.emplace_back(TurnedBall(ball, turns_.back()), options);
    }
    // Half-way between two corners of this turning angle it is so much farther to the nearest way than half the spacing, and legs
    // that become one stand away from their places, on either side.
    for (std::size_t i = 0; i < legs(); ++i) {
      const double turning = std::max(turning_at(i), turning_at(i + 1));
      farther_.push_back(2 / (1 + std::cos(turning / 2)) + 2 * kSagittaOfFlat);
    }
  }

  [[nodiscard]] SpacedPasses plan(const Monitor& monitor) const {
    const double flat = spacers_.front().flat_mm();
    std::vector<double> depths;
    // A turn goes over from one depth to the next, and is beside both.
    std::vector<Turns> between =
        place_turns(SpacingField(0, depth_, kSurveyOfFlat * flat, kMostOfFlat * flat), 2,
                    [this](const std::vector<double>& at, bool placed, const Monitor& part) { return look(at, placed, part); }, monitor, depths);
    SpacedPasses all;
    all.paths = way(depths);
    for (std::size_t k = 0; k < between.size(); ++k) {
      all.widest_mm = std::max(all.widest_mm, depths[k + 1] - depths[k]);
      take_over(all, between[k].pieces);
    }
    return all;
  }

 private:
  [[nodiscard]] std::size_t legs() const { return outermost_.size(); }
  [[nodiscard]] const Vec2& corner(std::size_t i) const { return outermost_[i % legs()]; }
  [[nodiscard]] double turning_at(std::size_t i) const {
    const Vec2 in = corner(i) - corner(i + legs() - 1), out = corner(i + 1) - corner(i);
    return std::abs(std::atan2(in.x() * out.y() - in.y() * out.x(), in.dot(out)));
  }
  [[nodiscard]] Vec2 place(double depth, std::size_t i) const { return middle_ + std::max(0.0, 1 - depth / depth_) * (corner(i) - middle_); }

  /// Depth so many turns from the beginning.
  [[nodiscard]] static double depth_after(const std::vector<double>& depths, double turns) {
    const auto k = std::min(static_cast<std::size_t>(std::max(turns, 0.0)), depths.size() - 1);
    if (k + 1 == depths.size()) return depths.back();
    return depths[k] + (turns - static_cast<double>(k)) * (depths[k + 1] - depths[k]);
  }
  [[nodiscard]] double depth_at(const std::vector<double>& depths, double turns, std::size_t leg) const {
    return depth_after(depths, turns + (static_cast<double>(leg) + 0.5) / static_cast<double>(legs()));
  }

  /// A leg of the turn at this depth, as straight as the next turn's.
  [[nodiscard]] CentrePath leg_path(double depth, std::size_t i) const {
    const Turn& turn = turns_[i];
    const Vec2 from = turn.in(place(depth, i)), to = turn.in(place(depth, i + 1));
    return centre_path(TurnedBall(ball_, turn), from.y(), from.x(), std::max(to.x(), from.x() + 1e-3), options_.tolerance);
  }

  /// What a turn leaves beside the next one, all around; x is the way along the outer of the two.
  struct Turns {
    double wish_mm = kInfinity;
    bool content = true;
    SpacedPasses pieces;
  };
  struct LegStations {
    std::vector<Station> stations;
    double highest = 0;
  };
  [[nodiscard]] LegStations left_on(double outer, double inner, std::size_t i) const {
    LegStations result;
    const CentrePath a = leg_path(inner, i), b = leg_path(outer, i);
    if (b.y - a.y < 1e-6) return result;
    result.stations = spacers_[i].leftover(a, b, -kInfinity, kInfinity);
    for (Station& s : result.stations) {
      s.cusp *= farther_[i] * farther_[i];
      result.highest = std::max(result.highest, s.cusp);
    }
    return result;
  }

  [[nodiscard]] std::vector<Turns> look(const std::vector<double>& depths, bool placed, const Monitor& monitor) const {
    std::vector<Turns> result(depths.size() - 1);
    Spacer::in_groups(result.size(), monitor, [&](std::size_t k) {
      const double spacing = depths[k + 1] - depths[k];
      std::vector<Station> around;
      std::vector<double> highest;
      double along = 0;
      for (std::size_t i = 0; i < legs(); ++i) {
        const double outer = placed ? depth_at(depths, static_cast<double>(k), i) : depths[k];
        const double inner = placed ? depth_at(depths, static_cast<double>(k) + 1, i) : depths[k + 1];
        const LegStations leg = left_on(outer, inner, i);
        highest.push_back(leg.highest);
        const double begin = leg.stations.empty() ? 0 : leg.stations.front().x;
        for (Station s : leg.stations) {
          s.x += along - begin;
          around.push_back(s);
        }
        along += (place(outer, i + 1) - place(outer, i)).norm();
      }
      const double least = kLeastOfFlat * spacers_.front().flat_mm();
      result[k].wish_mm = std::max(spacers_.front().cheapest(around, spacing, kAim * options_.cusp_mm), least);
      if (!placed) return;
      result[k].content = spacers_.front().cheapest(around, spacing, options_.cusp_mm) >= spacing || spacing <= least * 1.0001;
      settle(depths, static_cast<double>(k), static_cast<double>(k) + 1, 0, legs(), result[k].pieces);
    });
    return result;
  }

  /// Pieces of turns between these two, on legs [first, end), until every reachable place is within the limit or they lie too close.
  void settle(const std::vector<double>& depths, double outer_turns, double inner_turns, std::size_t first, std::size_t end, SpacedPasses& result) const {
    std::vector<bool> above(end - first);
    for (std::size_t i = first; i < end; ++i) {
      const double outer = depth_at(depths, outer_turns, i), inner = depth_at(depths, inner_turns, i);
      const LegStations leg = left_on(outer, inner, i);
      const bool may_divide = (inner - outer) / 2 >= kInfillLeastOfFlat * spacers_.front().flat_mm();
      above[i - first] = may_divide && leg.highest > options_.cusp_mm;
      if (above[i - first]) continue;
      result.highest_cusp_mm = std::max(result.highest_cusp_mm, leg.highest);
      for (const Station& s : leg.stations) {
        if (s.cusp > options_.cusp_mm) result.above_limit_mm2 += s.length * std::min(s.width, inner - outer);
      }
    }
    const double middle_turns = (outer_turns + inner_turns) / 2;
    for (std::size_t i = first; i < end; ++i) {
      if (!above[i - first]) continue;
      std::size_t last = i;
      double gap = 0;
      for (std::size_t m = i + 1; m < end && gap < kInfillMergeMm; ++m) {
        if (above[m - first]) last = m, gap = 0;
        gap += (place(depth_at(depths, middle_turns, m), m + 1) - place(depth_at(depths, middle_turns, m), m)).norm();
      }
      std::vector<Vec2> line;
      for (std::size_t m = i; m <= last + 1; ++m) line.push_back(place(depth_after(depths, middle_turns + static_cast<double>(m) / static_cast<double>(legs())), m));
      std::vector<CentrePath> piece = centre_paths_along(ball_, line, options_.tolerance);
      result.paths.insert(result.paths.end(), std::make_move_iterator(piece.begin()), std::make_move_iterator(piece.end()));
      ++result.infill_pieces;
      settle(depths, outer_turns, middle_turns, i, last + 1, result);
      settle(depths, middle_turns, inner_turns, i, last + 1, result);
      i = last;
    }
  }

  /// The whole way; legs that are short and hardly turn become one.
  [[nodiscard]] std::vector<CentrePath> way(const std::vector<double>& depths) const {
    constexpr double kLongestLegMm = 1;
    const double sagitta = kSagittaOfFlat * spacers_.front().flat_mm();
    const std::size_t count = (depths.size() - 1) * legs();
    const auto turns_at = [this](std::size_t n) { return static_cast<double>(n) / static_cast<double>(legs()); };
    const auto place_at = [&](std::size_t n) { return place(depth_after(depths, turns_at(n)), n % legs()); };
    std::vector<Vec2> line;
    std::vector<double> turns;  // to each vertex
    double turned = 0;
    for (std::size_t n = 0; n <= count; ++n) {
      if (n > 0 && n < count) {
        turned += turning_at(n % legs());
        const double length = (place_at(n + 1) - line.back()).norm();
        if (length < kLongestLegMm && length * turned / 8 < sagitta) continue;
      }
      const Vec2 here = place_at(n);
      if (!line.empty() && (here - line.back()).norm() < 1e-6) continue;
      line.push_back(here);
      turns.push_back(turns_at(n));
      turned = 0;
    }
    std::vector<CentrePath> paths = centre_paths_along(ball_, line, options_.tolerance);
    // Back into the groove of the turn before the last one, to lift there.
    constexpr double kTurnsBack = 2;
    const auto groove = static_cast<std::size_t>(std::lower_bound(turns.begin(), turns.end(), turns.back() - kTurnsBack) - turns.begin());
    if (groove + 2 < line.size()) paths.back().after = around_again(line, groove, depths.back() - depths[depths.size() - 2], options_.landing_mm);
    return paths;
  }

  const BallContact& ball_;
  const SpacingOptions& options_;
  Vec2 middle_;
  std::vector<Vec2> outermost_;
  double depth_ = 0;  ///< of the middle, from the leg that is farthest from it
  std::vector<Turn> turns_;
  std::vector<Spacer> spacers_;
  std::vector<double> farther_;
};

/// Vertices from one x to another, either way.
std::vector<PathPoint> vertices_towards(const TurnedBall& ball, double y, double from_x, double to_x, const PathTolerance& tolerance) {
  const double sense = to_x < from_x ? -1 : 1;
  Contact resting = ball.at(from_x, y);
  std::vector<PathPoint> points = {{from_x, resting.z, resting.point}};
  double step = tolerance.longest_mm;
  while (points.back().x != to_x) {
    const PathPoint here = points.back();
    const double rest = sense * (to_x - here.x);
    const double slope = resting.slope.x();  // of the exact centre path
    step = std::clamp(step, tolerance.shortest_mm, tolerance.longest_mm);
    PathPoint next;
    double error = 0;  // as a multiple of the tolerance
    while (true) {
      // No sliver at the end.
      double length = step;
      const bool arrives = length > rest - 1e-9;
      if (arrives)
        length = rest;
      else if (1.5 * length > rest)
        length = rest / 2;
      const double x = arrives ? to_x : here.x + sense * length;
      resting = ball.at(x, y);
      next = {x, resting.z, resting.point};
      const double chord = sense * (next.z - here.z) / length;
      const double bend = std::max(std::abs(slope - chord), std::abs(resting.slope.x() - chord));
      // A parabola of that end slope stands length * bend / 4 above its chord, measured across it a little less.
      error = std::max(bend * length / 4 / (kParabola * tolerance.chord_mm) / std::sqrt(1 + chord * chord), bend / tolerance.slope);
      // The last length may be longer than the shortest step, by rounding.
      if (error <= 1 || step <= tolerance.shortest_mm) break;
      step = std::max(tolerance.shortest_mm, length * std::clamp(0.95 / std::sqrt(error), 0.2, 0.9));
    }
    points.push_back(next);
    step = std::abs(next.x - here.x) * std::clamp(0.93 / std::sqrt(std::max(error, 1e-3)), 0.5, 3.0);
  }
  return points;
}

}  // namespace

double flat_stepover_mm(double radius_mm, double cusp_mm) {
  return 2 * std::sqrt(cusp_mm * (2 * radius_mm - cusp_mm));
}

CentrePath centre_path(const TurnedBall& ball, double y, double from_x, double to_x, const PathTolerance& tolerance) {
  CentrePath path;
  path.turn = ball.turn();
  path.y = y;
  to_x = std::max(from_x, to_x);
  // From the middle of the lens outwards, so that a mirrored part, or one elsewhere in its blank, gets the same vertices.
  const double middle_x = std::clamp(middle_of(ball), from_x, to_x);
  path.points = vertices_towards(ball, y, middle_x, from_x, tolerance);
  std::reverse(path.points.begin(), path.points.end());
  const std::vector<PathPoint> on = vertices_towards(ball, y, middle_x, to_x, tolerance);
  path.points.insert(path.points.end(), on.begin() + 1, on.end());
  path.points.shrink_to_fit();
  return path;
}

std::vector<CentrePath> centre_paths_along(const BallContact& ball, const std::vector<Vec2>& line, const PathTolerance& tolerance) {
  std::vector<CentrePath> paths;
  for (std::size_t k = 1; k < line.size(); ++k) {
    const double length = (line[k] - line[k - 1]).norm();
    if (length < 1e-9) continue;
    const TurnedBall turned(ball, {(line[k] - line[k - 1]) / length});
    const Vec2 from = turned.turn().in(line[k - 1]);
    CentrePath& path = paths.emplace_back();
    path.turn = turned.turn();
    path.y = from.y();
    path.joined = paths.size() > 1;
    path.points = vertices_towards(turned, from.y(), from.x(), from.x() + length, tolerance);
  }
  return paths;
}

SpacedPasses space_passes(const TurnedBall& ball, const SpacingOptions& options, const Monitor& monitor) {
  return Spacer(ball, options).plan(monitor);
}

SpacedPasses space_spiral(const TurnedBall& ball, const SpacingOptions& options, const Box2& around, double begin_y, const Monitor& monitor) {
  return SpiralSpacer(ball, options, around, begin_y).plan(monitor);
}

SpacedPasses space_outline_spiral(const BallContact& ball, const SpacingOptions& options, const Vec2& middle, const std::vector<Vec2>& outermost,
                                  const Monitor& monitor) {
  return OutlineSpiralSpacer(ball, options, middle, outermost).plan(monitor);
}

}  // namespace lightmill::detail

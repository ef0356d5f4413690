#include "cam/detail/wall_curve.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace lightmill::detail {

namespace {

constexpr double kCornerRad = 0.25;
constexpr double kBulgeMm = 0.05;
constexpr double kDistinctMm = 2e-3;  ///< places nearer to the one before are none: OpenCASCADE's edges need a length
constexpr double kAtRest = 1e-6;      ///< of a curve's speed, which is about 1
constexpr int kArcKnots = 128;        ///< of half a circle
constexpr double kGauss[3] = {0.5 - 0.3872983346207417, 0.5, 0.5 + 0.3872983346207417};
constexpr double kWeight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};

double cross(const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); }

std::size_t interval_of(const std::vector<double>& knots, double t) {
  const auto above = std::upper_bound(knots.begin(), knots.end() - 1, t);
  return above == knots.begin() ? 0 : static_cast<std::size_t>(above - knots.begin()) - 1;
}

/// Half a circle about the origin from this angle on.
WallPiece half_circle(double radius_mm, double from) {
  WallPiece piece;
  piece.radius_mm = radius_mm;
  for (int k = 0; k <= kArcKnots; ++k) {
    const double angle = from + kPi * k / kArcKnots;
    piece.knots.push_back(angle);
    piece.places.emplace_back(radius_mm * std::cos(angle), radius_mm * std::sin(angle));
    piece.speeds.emplace_back(-piece.places.back().y(), piece.places.back().x());
  }
  return piece;
}

WallPiece line(const Vec2& from, const Vec2& to) {
  const Vec2 along = (to - from).normalized();
  return {{0, (to - from).norm()}, {from, to}, {along, along}};
}

std::vector<Vec2> distinct(const std::vector<Vec2>& loop) {
  std::vector<Vec2> places;
  for (const Vec2& p : loop) {
    if (places.empty() || (p - places.back()).norm() > kDistinctMm) places.push_back(p);
  }
  while (places.size() > 3 && (places.back() - places.front()).norm() <= kDistinctMm) places.pop_back();
  return places;
}

/// The part of a loop of places from one on to another, which is beyond the first; it may go on past the last place.
class LoopCurves {
 public:
  explicit LoopCurves(std::vector<Vec2> loop) : loop_(std::move(loop)) {}

  [[nodiscard]] int size() const { return static_cast<int>(loop_.size()); }
  [[nodiscard]] const Vec2& at(int k) const { return loop_[((k % size()) + size()) % size()]; }

  [[nodiscard]] bool corner(int k) const {
    const Vec2 before = at(k) - at(k - 1), after = at(k + 1) - at(k);
    const double turn = std::abs(std::atan2(cross(before, after), before.dot(after)));
    return turn > kCornerRad || turn * std::max(before.norm(), after.norm()) / 8 > kBulgeMm;
  }

  /// Tangents are those of the parabolas through three places, chords being the parameter.
  [[nodiscard]] WallPiece curve(int first, int last, bool closed) const {
    if (last - first == 1) return line(at(first), at(last));
    WallPiece piece;
    for (int k = first; k <= last; ++k) {
      piece.knots.push_back(k == first ? 0 : piece.knots.back() + (at(k) - at(k - 1)).norm());
      piece.places.push_back(at(k));
      piece.speeds.push_back(tangent(k));
    }
    if (!closed) {
      piece.speeds.front() = 2 * (at(first + 1) - at(first)).normalized() - piece.speeds[1];
      piece.speeds.back() = 2 * (at(last) - at(last - 1)).normalized() - piece.speeds[piece.speeds.size() - 2];
    }
    return piece;
  }

 private:
  [[nodiscard]] Vec2 tangent(int k) const {
    const Vec2 before = at(k) - at(k - 1), after = at(k + 1) - at(k);
    const double b = before.norm(), a = after.norm();
    return (before * (a / b) + after * (b / a)) / (a + b);
  }

  std::vector<Vec2> loop_;
};

}  // namespace

Vec2 WallPiece::place(double t) const {
  if (radius_mm > 0) return radius_mm * Vec2(std::cos(t), std::sin(t));
  const std::size_t k = interval_of(knots, t);
  const double h = knots[k + 1] - knots[k];
  const double u = (t - knots[k]) / h, v = 1 - u;
  if (u <= 0) return places[k];
  if (u >= 1) return places[k + 1];
  return v * v * (1 + 2 * u) * places[k] + u * u * (1 + 2 * v) * places[k + 1] + u * v * h * (v * speeds[k] - u * speeds[k + 1]);
}

Vec2 WallPiece::speed(double t) const {
  if (radius_mm > 0) return radius_mm * Vec2(-std::sin(t), std::cos(t));
  const std::size_t k = interval_of(knots, t);
  const double h = knots[k + 1] - knots[k];
  const double u = (t - knots[k]) / h, v = 1 - u;
  return 6 * u * v / h * (places[k + 1] - places[k]) + v * (1 - 3 * u) * speeds[k] + u * (1 - 3 * v) * speeds[k + 1];
}

std::vector<double> WallPiece::turns(int axis) const {
  std::vector<double> result{knots.front()};
  const auto add = [&](double t) {
    if (t > result.back() && t < knots.back()) result.push_back(t);
  };
  if (radius_mm > 0) {
    for (int quarter = 1; quarter < 4; ++quarter) add(quarter * kPi / 2);
  } else if (!straight()) {
    for (std::size_t k = 0; k + 1 < knots.size(); ++k) {
      // The speed is q0 (1-u)^2 + 2 q1 u (1-u) + q2 u^2.
      const double h = knots[k + 1] - knots[k];
      const double q0 = speeds[k][axis], q2 = speeds[k + 1][axis];
      const double q1 = 3 * (places[k + 1][axis] - places[k][axis]) / h - q0 - q2;
      const double a = q0 - 2 * q1 + q2, b = q1 - q0;
      const double root = b * b - a * q0;
      if (std::abs(q0) < kAtRest) add(knots[k]);  // rounding puts the root on either side of the knot
      if (root <= 0) continue;
      const double q = -(b + std::copysign(std::sqrt(root), b));
      double u[2] = {a != 0 ? q / a : -1, q != 0 ? q0 / q : -1};
      std::sort(u, u + 2);
      for (const double at : u) {
        if (at > 0 && at < 1) add(knots[k] + at * h);
      }
    }
  }
  result.push_back(knots.back());
  return result;
}

std::vector<WallPiece> wall_pieces(const Outline& outline) {
  if (outline.shape == Outline::Shape::kDisk) {
    std::vector<WallPiece> halves{half_circle(outline.size_mm.x() / 2, 0), half_circle(outline.size_mm.x() / 2, kPi)};
    return halves;
  }
  if (outline.shape == Outline::Shape::kRectangle) {
    const Vec2 h = outline.size_mm / 2;
    const Vec2 corners[4] = {{-h.x(), -h.y()}, {h.x(), -h.y()}, {h.x(), h.y()}, {-h.x(), h.y()}};
    std::vector<WallPiece> sides;
    for (int k = 0; k < 4; ++k) sides.push_back(line(corners[k], corners[(k + 1) % 4]));
    return sides;
  }
  const LoopCurves loop(distinct(outline.loop_mm));
  std::vector<int> corners;
  for (int k = 0; k < loop.size(); ++k) {
    if (loop.corner(k)) corners.push_back(k);
  }
  if (corners.empty()) return {loop.curve(0, loop.size() / 2, true), loop.curve(loop.size() / 2, loop.size(), true)};
  std::vector<WallPiece> pieces;
  for (std::size_t c = 0; c < corners.size(); ++c) {
    const int first = corners[c];
    const int last = c + 1 < corners.size() ? corners[c + 1] : corners[0] + loop.size();
    if (corners.size() > 1) {
      pieces.push_back(loop.curve(first, last, false));
    } else {
      // A drop: no edge may end where it begins.
      const int middle = (first + last) / 2;
      pieces.push_back(loop.curve(first, middle, false));
      pieces.push_back(loop.curve(middle, last, false));
    }
  }
  return pieces;
}

double area_within_mm2(const std::vector<WallPiece>& walls) {
  double twice = 0;
  for (const WallPiece& wall : walls) {
    for (std::size_t k = 0; k + 1 < wall.knots.size(); ++k) {
      const double h = wall.knots[k + 1] - wall.knots[k];
      for (int g = 0; g < 3; ++g) twice += h * kWeight[g] * cross(wall.place(wall.knots[k] + kGauss[g] * h), wall.speed(wall.knots[k] + kGauss[g] * h));
    }
  }
  return twice / 2;
}

double volume_within(const SplineSurface& surface, const std::vector<WallPiece>& walls) {
  double volume = 0;
  const Vec2 span = surface.span_mm(), origin = surface.extent().min;
  // Between the curves and chords of at most a span: triangles from each chord's beginning.
  std::vector<Vec2> chords;
  for (const WallPiece& wall : walls) {
    for (std::size_t k = 0; k + 1 < wall.knots.size(); ++k) {
      const int pieces = wall.straight() ? 1 : static_cast<int>(std::ceil((wall.places[k + 1] - wall.places[k]).norm() / span.minCoeff()));
      const double h = (wall.knots[k + 1] - wall.knots[k]) / pieces;
      for (int piece = 0; piece < pieces; ++piece) {
        const double first = wall.knots[k] + piece * h;
        const Vec2& from = chords.emplace_back(piece == 0 ? wall.places[k] : wall.place(first));
        if (wall.straight()) continue;
        for (int g = 0; g < 3; ++g) {
          const double t = first + kGauss[g] * h;
          const Vec2 middle = (from + 2 * wall.place(t)) / 3;
          volume += h * kWeight[g] * cross(wall.place(t) - from, wall.speed(t)) / 2 * surface.height(middle.x(), middle.y());
        }
      }
    }
  }
  // Within the chords: slabs in which everything is smooth, from where chords end or cross the surface's knots; rows exact along x.
  std::vector<double> levels;
  for (std::size_t c = 0; c < chords.size(); ++c) {
    const Vec2 &a = chords[c], along = chords[(c + 1) % chords.size()] - a;
    levels.push_back(a.y());
    for (const int axis : {0, 1}) {
      const double from = (a[axis] - origin[axis]) / span[axis], to = from + along[axis] / span[axis];
      for (double k = std::ceil(std::min(from, to)); k < std::max(from, to); ++k) levels.push_back(a.y() + (k - from) / (to - from) * along.y());
    }
  }
  std::sort(levels.begin(), levels.end());
  std::vector<double> crossings;
  for (std::size_t slab = 0; slab + 1 < levels.size(); ++slab) {
    const double thick = levels[slab + 1] - levels[slab];
    if (thick < 1e-12) continue;
    for (int row = 0; row < 3; ++row) {
      const double y = levels[slab] + kGauss[row] * thick;
      crossings.clear();
      for (std::size_t k = 0; k < chords.size(); ++k) {
        const Vec2 &a = chords[k], &b = chords[(k + 1) % chords.size()];
        if ((a.y() > y) != (b.y() > y)) crossings.push_back(a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
      }
      std::sort(crossings.begin(), crossings.end());
      for (std::size_t c = 0; c + 1 < crossings.size(); c += 2) {
        double x = crossings[c];
        while (x < crossings[c + 1]) {
          const double knot = origin.x() + span.x() * (std::floor((x - origin.x()) / span.x() + 1e-9) + 1);
          const double next = std::min(knot, crossings[c + 1]);
          for (int g = 0; g < 3; ++g) volume += kWeight[row] * thick * kWeight[g] * (next - x) * surface.height(x + kGauss[g] * (next - x), y);
          x = next;
        }
      }
    }
  }
  return volume;
}

}  // namespace lightmill::detail

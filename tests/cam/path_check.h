// Independent judges of tool paths for the tests: the swept ball by brute force, surfaces with known closed forms.
#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "cam/cutter.h"
#include "cam/detail/ball_contact.h"
#include "cam/spline_surface.h"
#include "cam/toolpath.h"

namespace lightmill::test {

/// One of the cutters that come with Lightmill.
inline Cutter cutter(const std::string& name) {
  return read_cutter(std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters" / (name + ".toml"));
}

/// A spline through f to fourth order: coefficients f - (1/6) of the second differences, exact for bicubic polynomials.
inline SplineSurface spline_of(const Box2& extent, int spans_x, int spans_y,
                               const std::function<double(double, double)>& f) {
  const double px = extent.size().x() / spans_x;
  const double py = extent.size().y() / spans_y;
  Grid<double> c(spans_x + 3, spans_y + 3);
  const auto along_x = [&](double x, double y) { return f(x, y) - (f(x - px, y) - 2 * f(x, y) + f(x + px, y)) / 6; };
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) {
      const double x = extent.min.x() + (i - 1) * px;
      const double y = extent.min.y() + (j - 1) * py;
      c.at(i, j) = along_x(x, y) - (along_x(x, y - py) - 2 * along_x(x, y) + along_x(x, y + py)) / 6;
    }
  }
  return SplineSurface(extent, spans_x, spans_y, std::move(c));
}

/// All feed moves of a ball, in bins: the distance from a point to the nearest way of the ball's centre.
class SweptBall {
 public:
  explicit SweptBall(const ToolPath& path) : radius_(path.cutter.radius_mm()) {
    for (std::size_t k = 1; k < path.moves.size(); ++k) {
      const MoveKind kind = path.moves[k].kind;
      if (kind != MoveKind::kCut && kind != MoveKind::kPlunge) continue;
      segments_.push_back({centre(path.moves[k - 1].pose), centre(path.moves[k].pose), k});
    }
    for (const auto& s : segments_) {
      box_.include(s.a.head<2>());
      box_.include(s.b.head<2>());
    }
    if (segments_.empty()) return;
    columns_ = static_cast<int>(box_.size().x() / kBinMm) + 1;
    rows_ = static_cast<int>(box_.size().y() / kBinMm) + 1;
    bins_.resize(static_cast<std::size_t>(columns_) * rows_);
    for (std::size_t k = 0; k < segments_.size(); ++k) {
      const auto& s = segments_[k];
      for (int j = row(std::min(s.a.y(), s.b.y())); j <= row(std::max(s.a.y(), s.b.y())); ++j) {
        for (int i = column(std::min(s.a.x(), s.b.x())); i <= column(std::max(s.a.x(), s.b.x())); ++i) {
          bins_[static_cast<std::size_t>(j) * columns_ + i].push_back(static_cast<int>(k));
        }
      }
    }
  }

  struct Segment {
    Vec3 a, b;
    std::size_t move;
    [[nodiscard]] double squared_distance(const Vec3& q) const {
      const Vec3 d = b - a;
      const double length2 = d.squaredNorm();
      const double t = length2 > 0 ? std::clamp((q - a).dot(d) / length2, 0.0, 1.0) : 0;
      return (a + t * d - q).squaredNorm();
    }
  };

  /// Leftover (> 0) or gouge (< 0) at q: distance to the nearest centre less the radius.
  [[nodiscard]] double left_mm(const Vec3& q) const {
    double best = std::numeric_limits<double>::infinity();
    for_near(q, radius_ + 0.2, [&](const Segment& s) { best = std::min(best, s.squared_distance(q)); });
    return std::sqrt(best) - radius_;
  }

  /// Of the moves before one, those that pass a centre by no farther than about this, as seen from above.
  [[nodiscard]] std::vector<Segment> near(const Vec3& centre, double reach_mm, std::size_t before_move) const {
    std::vector<Segment> result;
    for_near(centre, reach_mm, [&](const Segment& s) {
      if (s.move < before_move) result.push_back(s);
    });
    return result;
  }

 private:
  static constexpr double kBinMm = 0.4;
  template <class F>
  void for_near(const Vec3& q, double reach, const F& f) const {
    for (int j = std::max(0, row(q.y() - reach)); j <= std::min(rows_ - 1, row(q.y() + reach)); ++j) {
      for (int i = std::max(0, column(q.x() - reach)); i <= std::min(columns_ - 1, column(q.x() + reach)); ++i) {
        for (const int k : bins_[static_cast<std::size_t>(j) * columns_ + i]) f(segments_[k]);
      }
    }
  }
  [[nodiscard]] Vec3 centre(const ToolPose& pose) const { return pose.tip_mm + radius_ * pose.axis; }
  [[nodiscard]] int column(double x) const { return static_cast<int>(std::floor((x - box_.min.x()) / kBinMm)); }
  [[nodiscard]] int row(double y) const { return static_cast<int>(std::floor((y - box_.min.y()) / kBinMm)); }
  double radius_;
  std::vector<Segment> segments_;
  Box2 box_;
  int columns_ = 0, rows_ = 0;
  std::vector<std::vector<int>> bins_;
};

/// What the ball takes off while it comes down to the surface or lifts from it, at places that count.
struct LandingCut {
  int arcs = 0;        ///< that touch such a place or stand over it
  double most_mm = 0;  ///< depth, along the ball's radius
  Vec3 where = Vec3::Zero();
};

/// A ball that lands in a groove may take off what the groove's chords stand above the exact way: their tolerance.
constexpr double kLandingCutMm = 5e-5;

/// By places on the ball's underside, every 0.04 mm of the way and 0.02 rad, against the moves before that pass near (others take
/// off nothing where this ball may touch), also those of an earlier path. `stock_mm` stands on the surface before all that.
inline LandingCut landing_cut(const SplineSurface& surface, const ToolPath& path, double stock_mm, const std::function<bool(const Vec2&)>& counts,
                              const ToolPath& earlier = {}) {
  const double radius = path.cutter.radius_mm();
  const double earlier_radius = earlier.cutter.radius_mm();
  const SweptBall swept(path), swept_earlier(earlier);
  const auto centre = [&](std::size_t k) { return Vec3(path.moves[k].pose.tip_mm + radius * path.moves[k].pose.axis); };
  const detail::BallContact ball(surface, radius, 2 * radius + 2);
  std::vector<bool> lifted, feeds;
  for (std::size_t k = 0; k < path.moves.size(); ++k) {
    const Vec3 c = centre(k);
    feeds.push_back(path.moves[k].kind == MoveKind::kCut || path.moves[k].kind == MoveKind::kPlunge);
    lifted.push_back(c.z() - ball.at(c.x(), c.y()).z > 1e-6);
  }
  const auto on_arc = [&](std::size_t k) { return feeds[k] && (lifted[k - 1] || lifted[k]); };
  LandingCut result;
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (!on_arc(k)) continue;
    const std::size_t first = k;
    bool over = false;
    for (; k < path.moves.size() && on_arc(k); ++k) {
      const Vec3 from = centre(k - 1), to = centre(k);
      const int steps = static_cast<int>(std::ceil((to - from).norm() / 0.04));
      for (int m = 1; m <= steps; ++m) {
        const Vec3 c = from + (to - from) * m / steps;
        const std::vector<SweptBall::Segment> before = swept.near(c, 0.4, first);
        const std::vector<SweptBall::Segment> earlier_before = swept_earlier.near(c, 0.9, earlier.moves.size());
        for (double u = -0.3; u < 0.31; u += 0.02) {
          for (double v = -0.3; v < 0.31; v += 0.02) {
            const Vec3 q = c + radius * Vec3(u, v, -std::sqrt(1 - u * u - v * v));
            if (!counts(q.head<2>())) continue;
            over = true;
            double depth = surface.height(q.x(), q.y()) + stock_mm - q.z();
            const auto spared = [&](const std::vector<SweptBall::Segment>& segments, double by_radius) {
              for (std::size_t s = 0; s < segments.size() && depth > result.most_mm; ++s)
                depth = std::min(depth, std::sqrt(segments[s].squared_distance(q)) - by_radius);
            };
            spared(before, radius);
            spared(earlier_before, earlier_radius);
            if (depth > result.most_mm) result.most_mm = depth, result.where = q;
          }
        }
      }
    }
    if (over) ++result.arcs;
  }
  return result;
}

}  // namespace lightmill::test

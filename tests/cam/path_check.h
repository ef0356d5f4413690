// Independent judges of tool paths for the tests: the swept ball by brute force, surfaces with known closed forms.
#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "cam/cutter.h"
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
      segments_.push_back({centre(path.moves[k - 1].pose), centre(path.moves[k].pose)});
    }
    for (const auto& s : segments_) {
      box_.include(s.a.head<2>());
      box_.include(s.b.head<2>());
    }
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

  /// Leftover (> 0) or gouge (< 0) at q: distance to the nearest centre less the radius.
  [[nodiscard]] double left_mm(const Vec3& q) const {
    double best = std::numeric_limits<double>::infinity();
    const double reach = radius_ + 0.2;
    for (int j = std::max(0, row(q.y() - reach)); j <= std::min(rows_ - 1, row(q.y() + reach)); ++j) {
      for (int i = std::max(0, column(q.x() - reach)); i <= std::min(columns_ - 1, column(q.x() + reach)); ++i) {
        for (const int k : bins_[static_cast<std::size_t>(j) * columns_ + i]) {
          const Vec3 d = segments_[k].b - segments_[k].a;
          const double length2 = d.squaredNorm();
          const double t = length2 > 0 ? std::clamp((q - segments_[k].a).dot(d) / length2, 0.0, 1.0) : 0;
          best = std::min(best, (segments_[k].a + t * d - q).squaredNorm());
        }
      }
    }
    return std::sqrt(best) - radius_;
  }

 private:
  static constexpr double kBinMm = 0.4;
  struct Segment {
    Vec3 a, b;
  };
  [[nodiscard]] Vec3 centre(const ToolPose& pose) const { return pose.tip_mm + radius_ * pose.axis; }
  [[nodiscard]] int column(double x) const { return static_cast<int>(std::floor((x - box_.min.x()) / kBinMm)); }
  [[nodiscard]] int row(double y) const { return static_cast<int>(std::floor((y - box_.min.y()) / kBinMm)); }
  double radius_;
  std::vector<Segment> segments_;
  Box2 box_;
  int columns_ = 0, rows_ = 0;
  std::vector<std::vector<int>> bins_;
};

}  // namespace lightmill::test

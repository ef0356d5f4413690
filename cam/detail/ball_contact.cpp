#include "cam/detail/ball_contact.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "cam/detail/spline_hull.h"
#include "design/core/parallel.h"

namespace lightmill::detail {

namespace {

/// Climbs from `start` to the local maximum of f(p) = h(p) + sqrt(R^2 - |p - c|^2).
/// Newton where f is concave, else along the gradient; a step that loses height is halved, none is longer than
/// `most_step` (or it might leave for a lower hill).
Contact climb(const SplineSurface& surface, double radius, const Vec2& centre, const Vec2& start, double most_step) {
  constexpr int kMostSteps = 60;
  constexpr double kLastStepMm = 1e-4;  // Newton converges quadratically: what is left after such a step is below 1e-8
  const double r2 = radius * radius;
  const double farthest = 0.9999 * radius;
  Vec2 p = start;
  Contact best;
  best.z = -std::numeric_limits<double>::infinity();
  Vec2 best_step = Vec2::Zero();
  for (int iteration = 0; iteration < kMostSteps; ++iteration) {
    double ux = p.x() - centre.x();
    double uy = p.y() - centre.y();
    const double length = std::sqrt(ux * ux + uy * uy);
    if (length > farthest) {
      ux *= farthest / length;
      uy *= farthest / length;
      p = centre + Vec2(ux, uy);
    }
    const SplineSurface::Sample s = surface.sample(p.x(), p.y());
    const double w = 1 / std::sqrt(r2 - ux * ux - uy * uy);
    const double f = s.h + 1 / w;
    if (f < best.z) {
      best_step /= 2;
      if (best_step.squaredNorm() < 1e-18) break;
      p = best.point + best_step;
      continue;
    }
    const double gx = s.hx - ux * w;
    const double gy = s.hy - uy * w;
    const double w3 = w * w * w;
    double a = s.hxx - w - ux * ux * w3;
    double b = s.hxy - ux * uy * w3;
    double d = s.hyy - w - uy * uy * w3;
    double det = a * d - b * b;
    Vec2 step;
    if (a < 0 && det > 1e-6 * w * w) {
      step = Vec2(b * gy - d * gx, b * gx - a * gy) / det;
    } else {
      step = Vec2(gx, gy) * (radius / 2);
    }
    const double size = step.norm();
    if (size > most_step) step *= most_step / size;
    best = {f, p, Vec2(ux * w, uy * w)};
    best_step = step;
    if (size < kLastStepMm && a < 0 && det > 0) {
      // The last step's gain to second order, and the contact after it.
      best.z += 0.5 * (gx * step.x() + gy * step.y());
      best.point += step;
      best.slope = Vec2(s.hx + s.hxx * step.x() + s.hxy * step.y(), s.hy + s.hxy * step.x() + s.hyy * step.y());
      break;
    }
    p += step;
  }
  return best;
}

/// Outermost place of a contact along x (to the side of `sign`), for that outermost slope along x and slopes across.
float reach_along(double radius, double slope, const Range& across, int sign) {
  const double least = across.least <= 0 && across.most >= 0 ? 0 : std::min(std::abs(across.least), std::abs(across.most));
  const double beside = slope * sign > 0 ? least : across.magnitude();
  constexpr double kRoundedMm = 1e-5;  // slopes are floats
  return static_cast<float>(radius * slope / std::sqrt(1 + slope * slope + beside * beside) + sign * kRoundedMm);
}

}  // namespace

Turn Turn::by(double angle_rad) {
  const auto exact = [](double v) { return std::abs(v) < 1e-12 ? 0.0 : std::abs(std::abs(v) - 1) < 1e-12 ? std::copysign(1.0, v) : v; };
  return {{exact(std::cos(angle_rad)), exact(std::sin(angle_rad))}};
}

BallContact::BallContact(const SplineSurface& surface, double radius_mm, double margin_mm)
    : surface_(&surface), radius_mm_(radius_mm) {
  // Four samples a span, or two hills on a crease look like one; but no finer than the ball can feel and no coarser than
  // it can bridge.
  const Box2& extent = surface.extent();
  const Vec2 wish = (surface.span_mm() / 4).cwiseMax(radius_mm / 32).cwiseMin(radius_mm / 8);
  Vec2 size = extent.size() + Vec2::Constant(2 * margin_mm);
  const int nx = static_cast<int>(std::ceil(size.x() / wish.x()));
  const int ny = static_cast<int>(std::ceil(size.y() / wish.y()));
  first_ = extent.min - Vec2::Constant(margin_mm);
  pitch_mm_ = Vec2(size.x() / nx, size.y() / ny);
  samples_ = Grid<float>(nx + 1, ny + 1);
  base_mm_ = surface.height(extent.centre().x(), extent.centre().y());
  std::vector<double> steepest2(ny + 1, 0);
  std::vector<double> bend(ny + 1, 0);  // of the surface, 1/mm
  parallel_blocks(ny + 1, 16, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int i = 0; i <= nx; ++i) {
        const auto s = surface.sample(first_.x() + i * pitch_mm_.x(), first_.y() + j * pitch_mm_.y());
        samples_.at(i, j) = static_cast<float>(s.h - base_mm_);
        steepest2[j] = std::max(steepest2[j], s.hx * s.hx + s.hy * s.hy);
        bend[j] = std::max(bend[j], std::abs(s.hxx) + std::abs(s.hxy) + std::abs(s.hyy));
      }
    }
  });
  // Between samples a slope can be a little steeper.
  const double steepest = 1.05 * std::sqrt(*std::max_element(steepest2.begin(), steepest2.end())) + 0.01;
  // A sample lies within half a cell's diagonal of any maximum of f, and there f is lower by at most half its curvature
  // (the ball's at the steepest contact, and the surface's) times the square of that.
  const double curvature = std::pow(1 + steepest * steepest, 1.5) / radius_mm + *std::max_element(bend.begin(), bend.end());
  missed_mm_ = std::min(0.5 * radius_mm, curvature / 2 * pitch_mm_.squaredNorm() / 4);
  reaches_ = reaches();
}

Grid<BallContact::Reach> BallContact::reaches() const {
  const double margin = surface_->extent().min.x() - first_.x() + radius_mm_;
  const SplineHull hull(*surface_, margin);
  Grid<std::array<float, 4>> slopes(hull.cells_x(), hull.cells_y());  // least and most along x, y
  parallel_blocks(slopes.height, 16, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int i = 0; i < slopes.width; ++i) {
        const auto s = hull.slopes(i, j);
        slopes.at(i, j) = {static_cast<float>(s.x.least), static_cast<float>(s.x.most), static_cast<float>(s.y.least), static_cast<float>(s.y.most)};
      }
    }
  });
  // Where contacts can be bounds the slopes there, and slopes where contacts can be.
  const auto narrowed = [&](const Vec2& low, const Vec2& high, Reach reach, int rounds) {
    for (int round = 0; round < rounds; ++round) {
      Range x, y;
      for (int j = hull.row(low.y() + reach.min_y); j <= hull.row(high.y() + reach.max_y); ++j) {
        for (int i = hull.column(low.x() + reach.min_x); i <= hull.column(high.x() + reach.max_x); ++i) {
          const auto& s = slopes.at(i, j);
          x.include(Range{s[0], s[1]});
          y.include(Range{s[2], s[3]});
        }
      }
      reach = {reach_along(radius_mm_, x.least, y, -1), reach_along(radius_mm_, x.most, y, 1), reach_along(radius_mm_, y.least, x, -1),
               reach_along(radius_mm_, y.most, x, 1)};
    }
    return reach;
  };
  // From the whole ball inwards, for large squares and then for those within.
  constexpr int kLarge = 8;
  Grid<Reach> result((samples_.width + kSquare - 1) / kSquare, (samples_.height + kSquare - 1) / kSquare);
  const Vec2 square = kSquare * pitch_mm_;
  parallel_blocks((result.height + kLarge - 1) / kLarge, 1, [&](std::size_t begin, std::size_t end) {
    const float r = static_cast<float>(radius_mm_);
    for (int b = kLarge * static_cast<int>(begin); b < kLarge * static_cast<int>(end); b += kLarge) {
      for (int a = 0; a < result.width; a += kLarge) {
        const Vec2 corner = first_ + square.cwiseProduct(Vec2(a, b));
        const Reach reach = narrowed(corner, corner + kLarge * square, {-r, r, -r, r}, 3);
        for (int j = b; j < std::min(b + kLarge, result.height); ++j) {
          for (int i = a; i < std::min(a + kLarge, result.width); ++i) {
            const Vec2 low = first_ + square.cwiseProduct(Vec2(i, j));
            result.at(i, j) = narrowed(low, low + square, reach, 2);
          }
        }
      }
    }
  });
  return result;
}

Contact BallContact::at(double x, double y) const {
  const double from_x = (x - first_.x()) / pitch_mm_.x(), from_y = (y - first_.y()) / pitch_mm_.y();
  if (!(from_x >= 0 && from_y >= 0 && from_x < samples_.width && from_y < samples_.height)) return ball_contact(*surface_, radius_mm_, x, y);
  const Reach& reach = reaches_.at(static_cast<int>(from_x) / kSquare, static_cast<int>(from_y) / kSquare);
  const int i0 = static_cast<int>(std::floor(from_x + reach.min_x / pitch_mm_.x())) - 1;
  const int i1 = static_cast<int>(std::ceil(from_x + reach.max_x / pitch_mm_.x())) + 1;
  const int j0 = static_cast<int>(std::floor(from_y + reach.min_y / pitch_mm_.y())) - 1;
  const int j1 = static_cast<int>(std::ceil(from_y + reach.max_y / pitch_mm_.y())) + 1;
  constexpr int kWidest = 96;
  if (i0 < 0 || j0 < 0 || i1 >= samples_.width || j1 >= samples_.height || i1 - i0 >= kWidest || j1 - j0 >= kWidest) {
    return ball_contact(*surface_, radius_mm_, x, y);
  }

  // Height of the ball's centre if it rested on each sample.
  const int columns = i1 - i0 + 1;
  const int rows = j1 - j0 + 1;
  std::array<float, kWidest> across2;
  for (int i = 0; i < columns; ++i) {
    const double dx = first_.x() + (i0 + i) * pitch_mm_.x() - x;
    across2[i] = static_cast<float>(dx * dx);
  }
  std::array<float, kWidest * kWidest> f;
  std::array<float, kWidest> row_best;
  float best = -std::numeric_limits<float>::infinity();
  for (int j = 0; j < rows; ++j) {
    const double dy = first_.y() + (j0 + j) * pitch_mm_.y() - y;
    const float left2 = static_cast<float>(radius_mm_ * radius_mm_ - dy * dy);
    const float* h = &samples_.at(i0, j0 + j);
    float* row = &f[static_cast<std::size_t>(j) * columns];
    for (int i = 0; i < columns; ++i) {
      const float inside = left2 - across2[i];
      row[i] = h[i] + __builtin_sqrtf(inside > 0 ? inside : 0);
    }
    float highest = row[0];
    for (int i = 1; i < columns; ++i) highest = row[i] > highest ? row[i] : highest;
    row_best[j] = highest;
    best = std::max(best, highest);
  }

  // Every local maximum among the samples that may belong to the highest one is climbed.
  const float enough = best - static_cast<float>(missed_mm_);
  Contact winner;
  winner.z = -std::numeric_limits<double>::infinity();
  for (int j = 0; j < rows; ++j) {
    if (row_best[j] < enough) continue;
    for (int i = 0; i < columns; ++i) {
      const float value = f[static_cast<std::size_t>(j) * columns + i];
      if (value < enough) continue;
      // Against the four neighbours only: two hills may touch at a corner.
      const float* at = &f[static_cast<std::size_t>(j) * columns + i];
      const bool highest = !(i > 0 && at[-1] > value) && !(i + 1 < columns && at[1] > value) &&
                           !(j > 0 && at[-columns] > value) && !(j + 1 < rows && at[columns] > value);
      if (!highest) continue;
      const Contact contact =
          climb(*surface_, radius_mm_, {x, y},
                {first_.x() + (i0 + i) * pitch_mm_.x(), first_.y() + (j0 + j) * pitch_mm_.y()}, pitch_mm_.minCoeff());
      if (contact.z > winner.z) winner = contact;
    }
  }
  return winner;
}

Contact ball_contact(const SplineSurface& surface, double radius_mm, double x, double y) {
  const Vec2 wish = (surface.span_mm() / 4).cwiseMax(radius_mm / 64).cwiseMin(radius_mm / 12);
  const int nx = static_cast<int>(std::ceil(radius_mm / wish.x()));
  const int ny = static_cast<int>(std::ceil(radius_mm / wish.y()));
  const double px = radius_mm / nx;
  const double py = radius_mm / ny;
  Grid<double> f(2 * nx + 1, 2 * ny + 1, -std::numeric_limits<double>::infinity());
  double best = -std::numeric_limits<double>::infinity();
  for (int j = -ny; j <= ny; ++j) {
    for (int i = -nx; i <= nx; ++i) {
      const double inside = radius_mm * radius_mm - i * px * i * px - j * py * j * py;
      if (inside < 0) continue;
      const double value = surface.height(x + i * px, y + j * py) + std::sqrt(inside);
      f.at(i + nx, j + ny) = value;
      best = std::max(best, value);
    }
  }
  const double enough = best - 2 * std::max(px * px, py * py);
  Contact winner;
  winner.z = -std::numeric_limits<double>::infinity();
  for (int j = 0; j < f.height; ++j) {
    for (int i = 0; i < f.width; ++i) {
      const double value = f.at(i, j);
      if (value < enough) continue;
      bool highest = true;
      for (int jj = std::max(0, j - 1); jj <= std::min(f.height - 1, j + 1); ++jj) {
        for (int ii = std::max(0, i - 1); ii <= std::min(f.width - 1, i + 1); ++ii) {
          highest = highest && f.at(ii, jj) <= value;
        }
      }
      if (!highest) continue;
      const Contact contact =
          climb(surface, radius_mm, {x, y}, {x + (i - nx) * px, y + (j - ny) * py}, std::min(px, py));
      if (contact.z > winner.z) winner = contact;
    }
  }
  return winner;
}

}  // namespace lightmill::detail

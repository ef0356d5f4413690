#include "design/detail/pixel_density.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "design/detail/clip.h"

namespace lightmill::detail {

namespace {

constexpr double kRounding = 1e-11;  // of the brightest jump: what is left when the jumps along a row have been summed

/// Density along a pixel's left side, constant between steps.
class Profile {
 public:
  struct Step {
    double v;  // from here to the next step, or to 1
    double density;
  };

  void add(double v0, double v1, double jump) {
    const std::size_t first = cut(v0);
    const std::size_t last = cut(v1);
    for (std::size_t k = first; k < last; ++k) steps_[k].density += jump;
  }
  /// Takes rounding for what it is: black is black, and equal densities are one.
  void tidy(double rounding) {
    std::size_t kept = 0;
    for (Step step : steps_) {
      if (std::abs(step.density) <= rounding) step.density = 0;
      if (kept > 0 && std::abs(step.density - steps_[kept - 1].density) <= rounding) continue;
      steps_[kept++] = step;
    }
    steps_.resize(kept);
  }
  [[nodiscard]] bool even() const { return steps_.size() == 1; }
  [[nodiscard]] const std::vector<Step>& steps() const { return steps_; }
  [[nodiscard]] double end(std::size_t k) const { return k + 1 < steps_.size() ? steps_[k + 1].v : 1; }

 private:
  /// The step that begins at v.
  std::size_t cut(double v) {
    if (v >= 1) return steps_.size();
    std::size_t k = steps_.size();
    while (k > 0 && steps_[k - 1].v >= v) --k;
    if (k < steps_.size() && steps_[k].v == v) return k;
    if (k == 0) return 0;
    steps_.insert(steps_.begin() + static_cast<std::ptrdiff_t>(k), {v, steps_[k - 1].density});
    return k;
  }

  std::vector<Step> steps_{{0, 0}};
};

}  // namespace

/// A border's part in one pixel.
struct PixelDensity::Piece {
  int row;
  int column;
  Border border;
};

PixelDensity::PixelDensity(const Grid<double>& flux, const Box2& extent, const std::vector<AreaBorder>& borders)
    : width_(flux.width),
      height_(flux.height),
      origin_(extent.min),
      pitch_(extent.size().x() / flux.width, extent.size().y() / flux.height),
      before_(static_cast<std::size_t>(flux.width + 1) * flux.height),
      beyond_(flux.height + 1) {
  const std::vector<Piece> pieces = pieces_of(borders);
  double brightest = 0;
  for (const auto& border : borders) brightest = std::max(brightest, std::abs(border.jump) * pitch_.prod());
  if (!pieces.empty()) mixed_before_.resize(flux.values.size() + 1);
  beyond_[0] = {0, 0, 0};
  std::span<const Piece> left(pieces);
  double y_before = 0;
  for (int row = 0; row < height_; ++row) {
    const auto end = std::find_if(left.begin(), left.end(), [&](const Piece& piece) { return piece.row > row; });
    const std::size_t count = end - left.begin();
    y_before = add_row(row, &flux.values[flux.index(0, row)], left.first(count), kRounding * brightest, y_before);
    left = left.subspan(count);
  }
  if (!pieces.empty()) {
    mixed_before_.back() = static_cast<std::int32_t>(mixed_.size());
    mixed_.push_back({borders_.size(), {}, y_before});
  }
}

std::vector<PixelDensity::Piece> PixelDensity::pieces_of(const std::vector<AreaBorder>& borders) const {
  std::vector<Piece> pieces;
  for (const auto& border : borders) {
    const auto in_pixels = [&](const Vec2& p) {
      return Vec2(std::clamp((p.x() - origin_.x()) / pitch_.x(), 0.0, static_cast<double>(width_)),
                  std::clamp((p.y() - origin_.y()) / pitch_.y(), 0.0, static_cast<double>(height_)));
    };
    const Vec2 low = in_pixels(border.low);
    const Vec2 high = in_pixels(border.high);
    const auto add = [&](int row, const Vec2& p, const Vec2& q) {
      const int column = static_cast<int>((p.x() + q.x()) / 2);
      if (column >= width_ || !(q.y() > p.y())) return;  // on the right side of everything
      const auto u = [&](double x) { return std::clamp(x - column, 0.0, 1.0); };
      pieces.push_back({row, column, {u(p.x()), p.y() - row, u(q.x()), q.y() - row, border.jump * pitch_.prod()}});
    };
    const double slope = high.y() > low.y() ? (high.x() - low.x()) / (high.y() - low.y()) : 0;
    Vec2 from = low;
    for (int row = std::min(static_cast<int>(low.y()), height_ - 1); from.y() < high.y(); ++row) {
      Vec2 to = high;
      if (high.y() > row + 1) to = {low.x() + (row + 1 - low.y()) * slope, row + 1};
      // From side to side of pixels.
      Vec2 at = from;
      const int sense = to.x() > from.x() ? 1 : -1;
      double side = sense > 0 ? std::floor(from.x()) + 1 : std::ceil(from.x()) - 1;
      for (; sense > 0 ? side < to.x() : side > to.x(); side += sense) {
        const double t = (side - from.x()) / (to.x() - from.x());
        const Vec2 cut(side, std::clamp(from.y() + t * (to.y() - from.y()), at.y(), to.y()));
        add(row, at, cut);
        at = cut;
      }
      add(row, at, to);
      from = to;
    }
  }
  std::stable_sort(pieces.begin(), pieces.end(),
                   [](const Piece& a, const Piece& b) { return a.row != b.row ? a.row < b.row : a.column < b.column; });
  return pieces;
}

double PixelDensity::add_row(int row, const double* flux, std::span<const Piece> pieces, double rounding,
                             double y_before) {
  const double y_at_start = y_before;
  Profile profile;
  double mass = 0;
  double moment = 0;
  std::vector<Border> inside;
  Before* const before = &before_[static_cast<std::size_t>(row) * (width_ + 1)];
  auto piece = pieces.begin();
  for (int column = 0; column < width_; ++column) {
    before[column] = {mass, moment};
    if (!mixed_before_.empty())
      mixed_before_[static_cast<std::size_t>(row) * width_ + column] = static_cast<std::int32_t>(mixed_.size());
    inside.clear();
    for (; piece != pieces.end() && piece->column == column; ++piece) {
      const Border& border = piece->border;
      if (border.u0 > 0 || border.u1 > 0) {
        inside.push_back(border);
      } else {
        profile.add(border.v0, border.v1, border.jump);
        profile.tidy(rounding);
      }
    }
    if (profile.even() && inside.empty()) {
      const double rho = flux[column] + profile.steps().front().density;
      mass += rho;
      moment += rho * (column + 0.5);
      continue;
    }
    const std::size_t first = borders_.size();
    for (std::size_t k = 0; k < profile.steps().size(); ++k) {
      const auto& step = profile.steps()[k];
      if (const double density = step.density + flux[column]; density != 0)
        borders_.push_back({0, step.v, 0, profile.end(k), density});
    }
    borders_.insert(borders_.end(), inside.begin(), inside.end());
    const Sum whole = sum_along(std::span(borders_).subspan(first), 1, 0, 1, 1);
    mixed_.push_back({first, whole, y_before});
    mass += whole.mass;
    moment += column * whole.mass + whole.x;
    y_before += whole.y - whole.mass / 2;
    for (const Border& border : inside) profile.add(border.v0, border.v1, border.jump);
    profile.tidy(rounding);
  }
  before[width_] = {mass, moment};
  const Beyond& below = beyond_[row];
  beyond_[row + 1] = {below.mass + mass, below.y_moment + mass * (row + 0.5) + y_before - y_at_start,
                      below.x_moment + moment};
  return y_before;
}

PixelDensity::Beyond PixelDensity::beyond(double y) const {
  const int row = std::clamp(static_cast<int>(y), 0, height_ - 1);
  const Beyond& below = beyond_[row];
  const Beyond& above = beyond_[row + 1];
  const double part = y - row;
  const double mass = above.mass - below.mass;
  const double y_more = above.y_moment - below.y_moment - mass * (row + 0.5);
  return {below.mass + part * mass,
          below.y_moment + mass * (y * y - static_cast<double>(row) * row) / 2 + part * y_more,
          below.x_moment + part * (above.x_moment - below.x_moment)};
}

PixelDensity::Sum PixelDensity::sum_along(std::span<const Border> borders, double u0, double v0, double u1, double v1) {
  Sum sum;
  const double du = u1 - u0;
  const double dv = v1 - v0;
  for (const Border& border : borders) {
    // The part of the edge at the border's heights, and right of it: d is how far.
    double from = 0;
    double to = 1;
    if (dv > 0) {
      from = std::max(0.0, (border.v0 - v0) / dv);
      to = std::min(1.0, (border.v1 - v0) / dv);
      if (!(from < to)) continue;
    } else if (v0 < border.v0 || v0 >= border.v1) {
      continue;
    }
    const auto right_of = [&](double t) {
      const double s = std::clamp((v0 + t * dv - border.v0) / (border.v1 - border.v0), 0.0, 1.0);
      return u0 + t * du - (border.u0 + s * (border.u1 - border.u0));
    };
    double d0 = right_of(from);
    double d1 = right_of(to);
    if (d0 <= 0 && d1 <= 0) {
      if (d0 == 0 && d1 == 0) sum.line += border.jump * (to - from) / 2;  // along the border itself
      continue;
    }
    if (d0 < 0) {
      from += (to - from) * d0 / (d0 - d1);
      d0 = 0;
    } else if (d1 < 0) {
      to -= (to - from) * d1 / (d1 - d0);
      d1 = 0;
    }
    sum.line += border.jump * (to - from);
    const double flux = border.jump * dv * (to - from);
    const double e0 = u0 + from * du;
    const double e1 = u0 + to * du;
    const double b0 = e0 - d0;
    const double b1 = e1 - d1;
    const double va = v0 + from * dv;
    const double vb = v0 + to * dv;
    sum.mass += flux * (d0 + d1) / 2;
    sum.x += flux * (e0 * e0 + e0 * e1 + e1 * e1 - b0 * b0 - b0 * b1 - b1 * b1) / 6;
    sum.y += flux * (d0 * (2 * va + vb) + d1 * (va + 2 * vb)) / 6;
  }
  return sum;
}

PixelDensity::Sum PixelDensity::owed(int column, int row, double y) const {
  const std::size_t index = static_cast<std::size_t>(row) * width_ + column;
  const std::int32_t k = mixed_before_[index];
  if (mixed_before_[index + 1] == k) return {};
  const Mixed& pixel = mixed_[k];
  const double v = std::clamp(y - row, 0.0, 1.0);
  Sum sum = sum_along(borders_of(k), 1, 0, 1, v);
  sum.mass -= v * pixel.whole.mass;
  sum.x -= v * pixel.whole.x;
  sum.y -= v * (v * pixel.whole.mass / 2 + pixel.whole.y - pixel.whole.mass / 2);
  return {sum.mass, sum.x + column * sum.mass, sum.y + row * sum.mass, 0};
}

PixelDensity::Integral PixelDensity::along(const Vec2& p, const Vec2& q) const {
  Integral result;
  // In pixels, upwards; the sign of the contour integrals follows the direction.
  double ax = (p.x() - origin_.x()) / pitch_.x();
  double ay = (p.y() - origin_.y()) / pitch_.y();
  double bx = (q.x() - origin_.x()) / pitch_.x();
  double by = (q.y() - origin_.y()) / pitch_.y();
  double sign = 1;
  if (by < ay || (by == ay && bx < ax)) {
    std::swap(ax, bx);
    std::swap(ay, by);
    sign = -1;
  }
  if (by <= 0 || ay >= height_) return result;
  const double dx = bx - ax;
  const double dy = by - ay;
  double t0 = 0;
  double t1 = 1;
  if (!clip(ay, dy, 0, height_, t0, t1)) return result;

  Sum sum;  // `line` is of rho dt

  // Right of the last column everything has been passed: closed form.
  const auto right = [&](double from, double to) {
    if (to <= from) return;
    const Beyond low = beyond(std::clamp(ay + from * dy, 0.0, static_cast<double>(height_)));
    const Beyond high = beyond(std::clamp(ay + to * dy, 0.0, static_cast<double>(height_)));
    sum.mass += high.mass - low.mass;
    sum.y += high.y_moment - low.y_moment;
    sum.x += high.x_moment - low.x_moment;
  };
  double in = t0;
  double out = t1;
  if (!clip(ax, dx, 0, width_, in, out)) {
    if (ax + dx * (t0 + t1) / 2 >= width_) right(t0, t1);
    in = out = t1;
  } else {
    if (dx < 0) right(t0, in);
    if (dx > 0) right(out, t1);
  }

  // Every vertex counts as being in one column, whichever edge it ends, so that a contour comes over the sides of mixed
  // pixels as often one way as the other. Nothing is owed at the bottom and the top.
  const bool shapes = !mixed_.empty();
  const auto column_of = [&](double x) { return x < 0 ? -1 : x >= width_ ? width_ : static_cast<int>(x); };
  int side = column_of(ay < 0 ? ax + t0 * dx : ax);
  const auto come_to = [&](int to, int row, double y) {
    for (; side != to; side += side < to ? 1 : -1) {
      const int passed = side < to ? side : side - 1;
      if (passed < 0 || passed >= width_) continue;
      const Sum more = owed(passed, row, y);
      const double way = side < to ? -1 : 1;
      sum.mass += way * more.mass;
      sum.x += way * more.x;
      sum.y += way * more.y;
    }
  };

  // From pixel to pixel.
  double x = std::clamp(ax + in * dx, 0.0, static_cast<double>(width_));
  double y = std::clamp(ay + in * dy, 0.0, static_cast<double>(height_));
  int row = std::clamp(static_cast<int>(y), 0, height_ - 1);
  if (out > in) {
    int column = static_cast<int>(x);
    if (dx < 0 && column == x) --column;
    column = std::clamp(column, 0, width_ - 1);
    if (shapes) come_to(column, row, y);
    const int sense = dx > 0 ? 1 : -1;
    constexpr double kNever = 1e300;
    const double per_column = dx != 0 ? 1 / std::abs(dx) : kNever;
    const double per_row = dy > 0 ? 1 / dy : kNever;
    double next_column = dx > 0 ? (column + 1 - ax) / dx : dx < 0 ? (column - ax) / dx : kNever;
    double next_row = dy > 0 ? (row + 1 - ay) / dy : kNever;
    double t = in;
    while (t < out) {
      const bool sideways = next_column < next_row;
      double to = sideways ? next_column : next_row;
      double x1;
      double y1;
      if (to >= out) {
        to = out;
        x1 = ax + out * dx;
        y1 = ay + out * dy;
      } else {
        x1 = ax + to * dx;
        y1 = ay + to * dy;
      }
      const Before* const before = &before_[static_cast<std::size_t>(row) * (width_ + 1) + column];
      const double rise = y1 - y;
      const double u0 = x - column;
      const double u1 = x1 - column;
      bool even = true;
      if (shapes) {
        const std::int32_t* const in_row = &mixed_before_[static_cast<std::size_t>(row) * width_];
        const std::int32_t k = in_row[column];
        sum.y += rise * (mixed_[k].y_before - mixed_[in_row[0]].y_before);
        even = in_row[column + 1] == k;
        if (!even) {
          const Sum part = sum_along(borders_of(k), u0, y - row, u1, y1 - row);
          sum.mass += rise * before->mass + part.mass;
          sum.x += rise * before->moment + column * part.mass + part.x;
          sum.y += rise * before->mass * (y + y1) / 2 + row * part.mass + part.y;
          if (to > t) sum.line += part.line * (to - t);
        }
      }
      if (even) {
        const double rho = before[1].mass - before->mass;
        const double f0 = before->mass + rho * u0;
        const double f1 = before->mass + rho * u1;
        sum.mass += rise * (f0 + f1) / 2;
        sum.x += rise * (before->moment + rho * (column * (u0 + u1) / 2 + (u0 * u0 + u0 * u1 + u1 * u1) / 6));
        sum.y += rise * (f0 * (2 * y + y1) + f1 * (y + 2 * y1)) / 6;
        if (to > t) sum.line += rho * (to - t);
      }
      t = std::max(t, to);
      x = x1;
      y = y1;
      if (to == out) break;
      if (sideways) {
        column += sense;
        next_column += per_column;
        if (shapes) come_to(column, row, y);
        if (column < 0 || column >= width_) break;
      } else {
        if (row + 1 >= height_) break;
        ++row;
        next_row += per_row;
      }
    }
  }
  if (shapes) come_to(column_of(by > height_ ? ax + t1 * dx : bx), row, y);

  result.mass = sign * sum.mass;
  result.moment = sign * Vec2(origin_.x() * sum.mass + pitch_.x() * sum.x, origin_.y() * sum.mass + pitch_.y() * sum.y);
  result.line = sum.line * (q - p).norm() / pitch_.prod();
  return result;
}

}  // namespace lightmill::detail

#include "design/detail/svg_gradient.h"

#include <algorithm>
#include <cmath>

#include "design/detail/svg.h"

namespace lightmill::detail {

namespace {

constexpr double kMostPeriods = 64;

double folded(double t, Gradient::Spread spread) {
  if (spread == Gradient::Spread::kPad) return std::clamp(t, 0.0, 1.0);
  const double period = std::floor(t);
  const double rest = t - period;
  return spread == Gradient::Spread::kReflect && std::fmod(std::abs(period), 2) == 1 ? 1 - rest : rest;
}

/// Colour codes and opacity are linear between stops.
Colour colour_at(const std::vector<Gradient::Stop>& stops, double t) {
  if (t <= stops.front().offset) return stops.front().colour;
  for (std::size_t k = 1; k < stops.size(); ++k) {
    if (t > stops[k].offset) continue;
    const Colour& a = stops[k - 1].colour;
    const Colour& b = stops[k].colour;
    const double s = (t - stops[k - 1].offset) / (stops[k].offset - stops[k - 1].offset);
    const auto mix = [&](double x, double y) { return x + s * (y - x); };
    return {mix(a.red, b.red), mix(a.green, b.green), mix(a.blue, b.blue), mix(a.opacity, b.opacity)};
  }
  return stops.back().colour;
}

/// The mean over [t0, t1]: three places of Gauss.
Band mean(const Gradient& gradient, double t0, double t1) {
  double shown = 0;
  double opacity = 0;
  for (const auto& [place, weight] :
       {std::pair(-std::sqrt(0.6), 5.0 / 18), std::pair(0.0, 8.0 / 18), std::pair(std::sqrt(0.6), 5.0 / 18)}) {
    const Colour colour = colour_at(gradient.stops, folded(t0 + (t1 - t0) * (0.5 + 0.5 * place), gradient.spread));
    shown += weight * colour.opacity * colour.light();
    opacity += weight * colour.opacity;
  }
  return {{}, opacity > 0 ? shown / opacity : 0, opacity};
}

/// Where bands end within (low, high), and these two: every step, and every stop.
std::vector<double> cuts_of(const Gradient& gradient, double low, double high) {
  std::vector<double> cuts{low, high};
  const auto add = [&](double t) {
    if (t > low && t < high) cuts.push_back(t);
  };
  const bool pad = gradient.spread == Gradient::Spread::kPad;
  const double first = pad ? 0 : std::floor(low);
  const double last = pad ? 1 : std::ceil(high);
  for (double period = first; period < last; ++period) {
    for (int k = 0; k <= kGradientBands; ++k) add(period + static_cast<double>(k) / kGradientBands);
    const bool mirrored = folded(period + 0.25, gradient.spread) > 0.5;
    for (const auto& stop : gradient.stops) add(period + (mirrored ? 1 - stop.offset : stop.offset));
  }
  std::sort(cuts.begin(), cuts.end());
  cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  return cuts;
}

bool is_regular(const Eigen::Affine2d& map) {
  const double det = map.linear().determinant();
  return std::isfinite(det) && std::abs(det) > 1e-12 * map.linear().squaredNorm();
}

std::vector<Vec2> corners_of(const Box2& box) {
  return {box.min, {box.max.x(), box.min.y()}, box.max, {box.min.x(), box.max.y()}};
}

std::vector<Band> linear_bands(const Gradient& gradient, const Box2& box_mm) {
  // t along the gradient, s across it.
  const Vec2 d = gradient.to - gradient.from;
  Eigen::Affine2d own = Eigen::Affine2d::Identity();
  own.linear() << d.x(), -d.y(), d.y(), d.x();
  own.translation() = gradient.from;
  const Eigen::Affine2d to_mm = gradient.to_mm * own;
  if (!is_regular(to_mm)) return {};
  const Eigen::Affine2d back = to_mm.inverse();
  Box2 box;
  for (const Vec2& corner : corners_of(box_mm)) box.include(back * corner);
  if (gradient.spread != Gradient::Spread::kPad && box.size().x() > kMostPeriods) return {};
  std::vector<Band> bands;
  const std::vector<double> cuts = cuts_of(gradient, box.min.x(), box.max.x());
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
    Band band = mean(gradient, cuts[k], cuts[k + 1]);
    band.shape.outlines_mm = {{to_mm * Vec2(cuts[k], box.min.y()), to_mm * Vec2(cuts[k + 1], box.min.y()),
                               to_mm * Vec2(cuts[k + 1], box.max.y()), to_mm * Vec2(cuts[k], box.max.y())}};
    bands.push_back(std::move(band));
  }
  return bands;
}

std::vector<Band> radial_bands(const Gradient& gradient, const Box2& box_mm) {
  if (!(gradient.radius > 0) || !is_regular(gradient.to_mm)) return {};
  const Eigen::Affine2d back = gradient.to_mm.inverse();
  double most = 1;
  for (const Vec2& corner : corners_of(box_mm)) {
    most = std::max(most, (back * corner - gradient.to).norm() / gradient.radius);
  }
  if (gradient.spread == Gradient::Spread::kPad) most = 1;
  if (most > kMostPeriods) return {};
  const double stretch = gradient.to_mm.linear().norm();
  const auto circle = [&](double t) {
    const Vec2 centre = gradient.from + t * (gradient.to - gradient.from);
    const double radius_mm = std::max(t * gradient.radius * stretch, 2 * kFlatteningTolerance_mm);
    const int sides =
        std::clamp(static_cast<int>(std::ceil(kPi / std::acos(1 - kFlatteningTolerance_mm / radius_mm))), 8, 4096);
    std::vector<Vec2> outline;
    for (int k = 0; k < sides; ++k) {
      const double angle = 2 * kPi * k / sides;
      outline.push_back(gradient.to_mm * Vec2(centre + t * gradient.radius * Vec2(std::cos(angle), std::sin(angle))));
    }
    return outline;
  };
  std::vector<Band> bands;
  const std::vector<double> cuts = cuts_of(gradient, 0, most);
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
    Band band = mean(gradient, cuts[k], cuts[k + 1]);
    band.shape.rule = FillRule::kEvenOdd;
    band.shape.outlines_mm.push_back(circle(cuts[k + 1]));
    if (cuts[k] > 0) band.shape.outlines_mm.push_back(circle(cuts[k]));
    bands.push_back(std::move(band));
  }
  // Beyond the last circle.
  Band rest = mean(gradient, most, most);
  const Colour& last = gradient.stops.back().colour;
  if (gradient.spread == Gradient::Spread::kPad) rest = {{}, last.light(), last.opacity};
  Box2 around = box_mm;
  for (const Vec2& p : bands.back().shape.outlines_mm.front()) around.include(p);
  rest.shape = {{corners_of(around), bands.back().shape.outlines_mm.front()}, FillRule::kEvenOdd};
  bands.push_back(std::move(rest));
  return bands;
}

}  // namespace

std::vector<Band> bands_of(const Gradient& gradient, const Box2& box_mm) {
  std::vector<Band> bands = gradient.radial ? radial_bands(gradient, box_mm) : linear_bands(gradient, box_mm);
  if (!bands.empty()) return bands;
  // Without extent, or finer than can be drawn: what it comes to.
  const Colour& last = gradient.stops.back().colour;
  Band even = gradient.spread == Gradient::Spread::kPad ? Band{{}, last.light(), last.opacity} : mean_of(gradient);
  even.shape.outlines_mm = {corners_of(box_mm)};
  return {even};
}

Band mean_of(const Gradient& gradient) {
  double shown = 0;
  double opacity = 0;
  const std::vector<double> cuts = cuts_of(gradient, 0, 1);
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
    const Band band = mean(gradient, cuts[k], cuts[k + 1]);
    shown += (cuts[k + 1] - cuts[k]) * band.light * band.opacity;
    opacity += (cuts[k + 1] - cuts[k]) * band.opacity;
  }
  return {{}, opacity > 0 ? shown / opacity : 0, opacity};
}

}  // namespace lightmill::detail

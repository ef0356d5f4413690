// Random lights, lenses and mixes: the solver converges on every one, within its budget.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <cmath>

#include "design/core/errors.h"
#include "design/detail/fills.h"
#include "design/transport.h"

namespace lightmill {
namespace {

template <std::size_t N>
double one_of(const std::array<double, N>& values) {
  return values[*rc::gen::inRange<std::size_t>(0, N)];
}

/// Corners of an 8 x 8 raster of the picture, so that places coincide, lie on pixel borders and on the picture's; some
/// are moved off it by less than the solver's widths.
Vec2 any_place(const Box2& extent) {
  const Vec2 corner(*rc::gen::inRange(0, 9), *rc::gen::inRange(0, 9));
  const double off = one_of(std::array{0.0, 1e-3, 1e-6, 0.3});
  return (extent.min + extent.size().cwiseProduct(corner) / 8 + Vec2(off, -0.7 * off))
      .cwiseMax(extent.min)
      .cwiseMin(extent.max);
}

SourceLight any_source() {
  SourceLight source;
  const int kind = *rc::gen::inRange(0, 4);
  if (kind == 1) {
    source.shape = SourceLight::Shape::kDisk;
    return source;
  }
  Lens lens;
  lens.size_mm.y() = 100 / one_of(std::array{1.0, 1.7, 10.0, 100.0});
  source.size_mm = lens.size_mm;
  if (kind == 0) return source;
  Light light;
  Receiver receiver;
  if (kind == 2) {  // a star, which may touch itself
    lens.shape = Lens::Shape::kOutline;
    lens.outline_mm.resize(1);
    const int corners = *rc::gen::inRange(3, 12);
    for (int k = 0; k < corners; ++k) {
      const double angle = 2 * kPi * k / corners;
      lens.outline_mm[0].emplace_back(*rc::gen::inRange(5, 50) * Vec2(std::cos(angle), std::sin(angle)));
    }
    lens.size_mm = {100, 100};
  } else {
    light.profile.kind = Profile::Kind::kGaussian;
    light.profile.sigma_mm = lens.size_mm.y() * one_of(std::array{1.0, 0.3, 0.15});
  }
  receiver.shift_mm.x() = one_of(std::array{0.0, 30.0, 1000.0});  // samples beside the picture
  return trace_source(lens, light, receiver, 12).source;
}

TargetLight any_target() {
  TargetLight target;
  Vec2 size(100, 100 / one_of(std::array{1.0, 3.0, 10.0}));
  if (*rc::gen::inRange(0, 2) == 1) std::swap(size.x(), size.y());
  target.extent = Box2::centred(size);
  const int points = *rc::gen::inRange(0, 6);
  for (int k = 0; k < points; ++k)
    target.points.push_back({any_place(target.extent), one_of(std::array{1.0, 1e-2, 1e-6, 1e3})});
  const int curves = *rc::gen::inRange(0, 4);
  for (int k = 0; k < curves; ++k) {
    CurveLight curve;
    const int vertices = *rc::gen::inRange(2, 5);
    for (int v = 0; v < vertices; ++v) {
      curve.vertices_mm.push_back(any_place(target.extent));
      curve.density_per_mm.push_back(one_of(std::array{1.0, 0.0, 1e-3, 30.0}) / 100);
    }
    target.curves.push_back(curve);
  }
  const int width = *rc::gen::inRange(0, 9);
  const int height = *rc::gen::inRange(1, 9);
  if (width > 0) {
    target.area_flux = Grid<double>(width, height);
    for (double& flux : target.area_flux.values)
      flux = one_of(std::array{1.0, 0.0, 0.1, 1e-4, 50.0}) / (width * height);
  }
  detail::FilledShapes shapes;
  const int fills = *rc::gen::inRange(0, 3);
  for (int k = 0; k < fills; ++k) {
    detail::Fill fill;
    fill.shape.rule = *rc::gen::element(detail::FillRule::kNonZero, detail::FillRule::kEvenOdd);
    fill.shape.outlines_mm.resize(1);
    const int corners = *rc::gen::inRange(3, 7);
    for (int v = 0; v < corners; ++v) fill.shape.outlines_mm[0].push_back(any_place(target.extent));
    fill.light = one_of(std::array{1.0, 0.0, 0.05}) / target.extent.size().prod();
    shapes.fills.push_back(fill);
  }
  if (fills > 0) target.area_borders = detail::borders_of(shapes, target.extent);
  RC_PRE(target.total() > 0);
  target.normalise();
  return target;
}

/// Centre of all light in closed form.
Vec2 centre_of(const TargetLight& target) {
  Vec2 sum(0, 0);
  const auto& area = target.area_flux;
  for (int row = 0; row < area.height; ++row) {
    for (int column = 0; column < area.width; ++column) {
      const Vec2 at = Vec2(column + 0.5, row + 0.5).cwiseQuotient(Vec2(area.width, area.height));
      sum += area.at(column, row) * (target.extent.min + target.extent.size().cwiseProduct(at));
    }
  }
  for (const auto& border : target.area_borders) {
    // Of the light between the border and x = 0.
    const Vec2 &a = border.low, &b = border.high;
    const double rise = border.jump * (b.y() - a.y());
    sum.x() -= rise * (a.x() * a.x() + a.x() * b.x() + b.x() * b.x()) / 6;
    sum.y() -= rise * (2 * a.x() * a.y() + a.x() * b.y() + b.x() * a.y() + 2 * b.x() * b.y()) / 6;
  }
  for (const auto& curve : target.curves) {
    for (std::size_t k = 0; k + 1 < curve.vertices_mm.size(); ++k) {
      const Vec2 way = curve.vertices_mm[k + 1] - curve.vertices_mm[k];
      const double from = curve.density_per_mm[k];
      const double to = curve.density_per_mm[k + 1];
      sum += way.norm() * ((from + to) / 2 * curve.vertices_mm[k] + (from / 6 + to / 3) * way);
    }
  }
  for (const auto& point : target.points) sum += point.flux * point.position_mm;
  return sum;
}

RC_GTEST_PROP(TransportRobustness, EveryLightIsTransported, ()) {
  const SourceLight source = any_source();
  const TargetLight target = any_target();
  TransportOptions options;
  options.samples = *rc::gen::inRange(16, 300);
  TransportMap map;
  try {
    map = solve_transport(source, target, options);
  } catch (const NumericalError& e) {
    RC_FAIL(e.what());
  }
  // Moments of thin strips are differences: a centroid is good to about 1e-8 mm.
  const Box2 grown{target.extent.min.array() - 1e-7, target.extent.max.array() + 1e-7};
  Vec2 mean(0, 0);
  for (std::size_t i = 0; i < map.sites_mm.size(); ++i) {
    RC_ASSERT(std::isfinite(map.weights_mm2[i]));
    RC_ASSERT(grown.contains(map.target_centroids_mm[i]));
    mean += map.target_masses[i] * map.target_centroids_mm[i];
  }
  RC_ASSERT((mean - centre_of(target)).norm() < 1e-8 * target.extent.size().norm());
  RC_ASSERT(map.summary.empty_cells == 0);
  RC_ASSERT(map.summary.l1_mass_error <= options.l1_tolerance);
  RC_ASSERT(map.summary.max_mass_error <= options.max_tolerance);
}

}  // namespace
}  // namespace lightmill

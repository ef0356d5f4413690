#include "design/target.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "design/detail/coverage.h"
#include "design/detail/fills.h"
#include "design/detail/svg.h"

namespace lightmill {

namespace {

constexpr double kDefaultCurveFlux = 0.5;
constexpr double kStretch = 0.01;  // of a picture that passes without a word

void check(const TargetSpec& spec) {
  if (spec.image.empty() && spec.drawing.empty()) throw InputError("target: give an image, a drawing or both");
  if (!(spec.size_mm.x() > 0 && spec.size_mm.y() > 0)) throw InputError("target.size_mm must be above 0 in x and y");
  if (spec.curve_flux > 1)
    throw InputError("target.curve_flux = " + compact(spec.curve_flux, 6) + ": must be a share from 0 to 1");
  if (!(spec.background >= 0))
    throw InputError("target.background = " + compact(spec.background, 6) + ": must be at least 0");
}

}  // namespace

double CurveLight::flux() const {
  double sum = 0;
  for (std::size_t k = 0; k + 1 < vertices_mm.size(); ++k) {
    sum += (vertices_mm[k + 1] - vertices_mm[k]).norm() * (density_per_mm[k] + density_per_mm[k + 1]) / 2;
  }
  return sum;
}

double TargetLight::area_total() const {
  double sum = std::accumulate(area_flux.values.begin(), area_flux.values.end(), 0.0);
  // A border lights what lies between it and the right side of the extent.
  for (const auto& border : area_borders) {
    sum += border.jump * (border.high.y() - border.low.y()) *
           (extent.max.x() - (border.low.x() + border.high.x()) / 2);
  }
  return sum;
}

double TargetLight::curve_total() const {
  double sum = 0;
  for (const auto& curve : curves) sum += curve.flux();
  return sum;
}

double TargetLight::point_total() const {
  double sum = 0;
  for (const auto& point : points) sum += point.flux;
  return sum;
}

void TargetLight::normalise() {
  const double sum = total();
  if (!(sum > 0) || !std::isfinite(sum))
    throw InputError("the target has no light at all; give a picture that is not all black");
  scale_area(*this, 1 / sum);
  for (auto& curve : curves) {
    for (double& density : curve.density_per_mm) density /= sum;
  }
  for (auto& point : points) point.flux /= sum;
}

TargetLight load_target(const TargetSpec& spec) {
  check(spec);
  TargetLight target;
  target.extent = Box2::centred(spec.size_mm);
  detail::Drawing drawing;
  if (!spec.drawing.empty()) drawing = detail::read_drawing(spec.drawing, spec.size_mm, spec.viewed_from);
  target.warnings = drawing.warnings;

  // Area light: the image and the drawing's fills. White is 1 per mm2 in both; light adds, so an image beneath shines
  // through the fills.
  const double size = spec.size_mm.prod();
  if (!spec.image.empty()) {
    Picture picture = read_picture(spec.image, spec.transfer, spec.color_mask);
    Grid<float>& gray = picture.gray;
    if (spec.color_mask && !picture.red.empty()) {
      for (std::size_t i = 0; i < gray.values.size(); ++i)
        gray.values[i] = std::max({picture.red.values[i], picture.green.values[i], picture.blue.values[i]});
    }
    target.warnings.insert(target.warnings.end(), picture.warnings.begin(), picture.warnings.end());
    const double stretch = spec.size_mm.x() * gray.height / (spec.size_mm.y() * gray.width);
    if (std::abs(std::log(stretch)) > kStretch) {
      target.warnings.push_back("picture " + spec.image.string() + " of " + std::to_string(gray.width) + " x " +
                                std::to_string(gray.height) + " pixels is stretched onto " + compact(spec.size_mm.x(), 3) +
                                " x " + compact(spec.size_mm.y(), 3) + " mm; give target.size_mm its proportions");
    }
    target.area_flux = Grid<double>(gray.width, gray.height);
    const double pixel = size / static_cast<double>(gray.values.size());
    for (int row = 0; row < gray.height; ++row) {
      for (int column = 0; column < gray.width; ++column) {
        // As as_seen() does, the other way and without a copy.
        const int x = spec.viewed_from == ViewedFrom::kLens ? gray.width - 1 - column : column;
        target.area_flux.at(x, gray.height - 1 - row) = gray.at(column, row) * pixel;
      }
    }
    if (!(target.area_total() > 0)) {
      throw InputError("picture " + spec.image.string() + " is all black; give one that has light");
    }
  }
  try {
    target.area_borders = detail::borders_of(drawing.shapes, target.extent);
  } catch (const InputError& e) {
    throw InputError("drawing " + spec.drawing.string() + ": " + e.what());
  }
  const double area = target.area_total();
  if (!(area > 0)) target.area_borders.clear();

  // Singular light, inside the picture only.
  for (const auto& stroke : drawing.strokes) {
    for (auto& part : detail::clipped(stroke, target.extent)) target.curves.push_back(std::move(part));
  }
  target.points = drawing.points;
  if (!spec.drawing.empty() && spec.image.empty() && !(area > 0) && target.curves.empty() && target.points.empty()) {
    std::string hint = target.warnings.empty() ? "" : " (" + target.warnings.front() + ")";
    throw InputError("drawing " + spec.drawing.string() +
                     " has nothing that shines: black fills are no light; draw fills or strokes in white or gray" +
                     hint);
  }

  // All strokes together count 1 against the points' data-flux; both together have curve_flux of all light.
  const double strokes = target.curve_total();
  if (strokes > 0) {
    for (auto& curve : target.curves) {
      for (double& density : curve.density_per_mm) density /= strokes;
    }
  }
  const double singular = (strokes > 0 ? 1 : 0) + target.point_total();
  if (area > 0 && spec.background > 0) {
    if (target.area_flux.empty()) target.area_flux = Grid<double>(1, 1);
    const double floor = spec.background * area / static_cast<double>(target.area_flux.values.size());
    for (double& flux : target.area_flux.values) flux += floor;
  }
  if (area > 0 && singular > 0) {
    const double share = spec.curve_flux < 0 ? kDefaultCurveFlux : spec.curve_flux;
    scale_area(target, (1 - share) / target.area_total());
    for (auto& curve : target.curves) {
      for (double& density : curve.density_per_mm) density *= share / singular;
    }
    for (auto& point : target.points) point.flux *= share / singular;
    if (share == 0) {
      target.curves.clear();
      target.points.clear();
    }
    if (share == 1) {
      target.area_flux = {};
      target.area_borders.clear();
    }
  }
  target.normalise();
  return target;
}

void scale_area(TargetLight& target, double factor) {
  for (double& flux : target.area_flux.values) flux *= factor;
  for (auto& border : target.area_borders) border.jump *= factor;
}

Grid<double> rasterise_area(const TargetLight& target, int width, int height) {
  Grid<double> flux =
      target.area_flux.empty() ? Grid<double>(width, height) : detail::box_filtered(target.area_flux, width, height);
  detail::add_borders(flux, target.extent, target.area_borders);
  return flux;
}

Grid<double> rasterise(const TargetLight& target, int width, int height) {
  Grid<double> flux = rasterise_area(target, width, height);
  for (const auto& curve : target.curves) {
    for (std::size_t k = 0; k + 1 < curve.vertices_mm.size(); ++k) {
      detail::add_segment(flux, target.extent, curve.vertices_mm[k], curve.vertices_mm[k + 1], curve.density_per_mm[k],
                          curve.density_per_mm[k + 1]);
    }
  }
  const Vec2 pitch = target.extent.size().cwiseQuotient(Vec2(width, height));
  for (const auto& point : target.points) {
    if (!target.extent.contains(point.position_mm)) continue;
    const Vec2 at = (point.position_mm - target.extent.min).cwiseQuotient(pitch);
    flux.at(std::min(static_cast<int>(at.x()), width - 1), std::min(static_cast<int>(at.y()), height - 1)) +=
        point.flux;
  }
  return flux;
}

}  // namespace lightmill

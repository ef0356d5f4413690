#include "design/target.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "design/core/errors.h"

namespace lightmill {

double CurveLight::flux() const {
  double sum = 0;
  for (std::size_t k = 0; k + 1 < vertices_mm.size(); ++k) {
    sum += (vertices_mm[k + 1] - vertices_mm[k]).norm() * (density_per_mm[k] + density_per_mm[k + 1]) / 2;
  }
  return sum;
}

double TargetLight::area_total() const {
  return std::accumulate(area_flux.values.begin(), area_flux.values.end(), 0.0);
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
  for (double& flux : area_flux.values) flux /= sum;
  for (auto& curve : curves) {
    for (double& density : curve.density_per_mm) density /= sum;
  }
  for (auto& point : points) point.flux /= sum;
}

TargetLight load_target(const TargetSpec& spec) {
  TargetLight target;
  target.extent = Box2::centred(spec.size_mm);
  if (!spec.image.empty()) {
    const Picture picture = read_picture(spec.image, spec.transfer);
    const Grid<float> seen = as_seen(picture.gray, spec.viewed_from);  // its own inverse
    target.area_flux = Grid<double>(seen.width, seen.height);
    std::copy(seen.values.begin(), seen.values.end(), target.area_flux.values.begin());
  }
  target.normalise();
  return target;
}

}  // namespace lightmill

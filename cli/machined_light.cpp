#include "cli/machined_light.h"

#include "cam/outline_region.h"
#include "cli/stage_runs.h"
#include "design/core/parallel.h"
#include "machine/dry_run.h"

namespace lightmill {

MachinedLight::MachinedLight(const Job& job, const SplineSurface& design, const Blank& blank)
    : job_(job), design_(design), scene_(scene_of(job)), outline_(outline_of(scene_.lens)), target_(target_of(job)) {
  beside_ = outline_.shape != Outline::Shape::kRectangle || (blank.size_mm - job.lens.size_mm).maxCoeff() > 0;
  if (beside_ && scene_.lens.shape == Lens::Shape::kRectangle) {
    scene_.lens.shape = Lens::Shape::kOutline;
    scene_.lens.outline_mm = {outline_places(outline_, job.lens.size_mm.maxCoeff())};
  }
}

std::optional<Outline> MachinedLight::outline_if_beside() const {
  return beside_ ? std::optional(outline_) : std::nullopt;
}

Grid<float> MachinedLight::polished(const MachinedSurface& machined, double sigma_um) const {
  if (!beside_) return polish(machined.heights_mm, machined.pitch_mm, sigma_um);
  Grid<float> heights = machined.heights_mm;
  const OutlineRegion part(outline_, -0.02);
  parallel_blocks(heights.height, 16, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int i = 0; i < heights.width; ++i) {
        const Vec2 p = machined.extent.min + machined.pitch_mm * Vec2(i, j);
        if (!part.contains(p)) heights.at(i, j) = static_cast<float>(design_.height(p.x(), p.y()));
      }
    }
  });
  return polish(heights, machined.pitch_mm, sigma_um);
}

Caustic MachinedLight::cast(const Grid<float>& heights_mm, const Box2& extent, const Monitor& monitor) const {
  CausticOptions options;
  options.angular_diameter_rad = job_.light.angular_diameter_rad;
  return trace_heights(heights_mm, extent, scene_.lens, scene_.light, job_.receiver, target_.extent, options, monitor);
}

CausticMeasures MachinedLight::measure(const Grid<float>& heights_mm, const Box2& extent) const {
  return measure_caustic(cast(heights_mm, extent), target_);
}

}  // namespace lightmill

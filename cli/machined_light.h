// Light through a milled surface, the same way in the dry run and in studies.
#pragma once

#include <optional>

#include "cam/blank.h"
#include "cam/spline_surface.h"
#include "cli/job.h"
#include "cli/job_light.h"
#include "design/caustic.h"
#include "machine/stock_model.h"

namespace lightmill {

class MachinedLight {
 public:
  /// `design` must outlive it.
  MachinedLight(const Job& job, const SplineSurface& design, const Blank& blank);

  [[nodiscard]] const TargetLight& target() const { return target_; }
  [[nodiscard]] const Outline& outline() const { return outline_; }
  /// The lens's outline where the blank is larger than the lens.
  [[nodiscard]] std::optional<Outline> outline_if_beside() const;
  /// The low-pass of the job's polish model; beside the outline the designed surface goes on, so that the slot around the
  /// part is not drawn into its rim.
  [[nodiscard]] Grid<float> polished(const MachinedSurface& machined, double sigma_um) const;
  [[nodiscard]] Caustic cast(const Grid<float>& heights_mm, const Box2& extent, const Monitor& monitor = {}) const;
  [[nodiscard]] CausticMeasures measure(const Grid<float>& heights_mm, const Box2& extent) const;

 private:
  const Job& job_;
  const SplineSurface& design_;
  Scene scene_;
  Outline outline_;
  bool beside_ = false;
  TargetLight target_;
};

}  // namespace lightmill

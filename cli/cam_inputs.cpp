#include "cli/cam_inputs.h"

#include <algorithm>
#include <cmath>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

double tenths_up(double mm) { return std::ceil(mm * 10 - 1e-6) / 10; }

}  // namespace

double least_blank_mm(const SplineSurface& surface) { return tenths_up(surface.highest()); }

Blank blank_of(const Job& job, const SplineSurface& surface) {
  Blank blank;
  blank.keep_outs = keep_outs_of(job);
  blank.size_mm = blank_size_mm(job);
  const double highest = surface.highest();
  if (!job.stock.height_mm) {
    blank.height_mm = tenths_up(highest + job.stock.allowance_mm);
    return blank;
  }
  blank.height_mm = *job.stock.height_mm;
  if (highest > blank.height_mm) {
    throw InputError("the relief is too tall for the blank: the lens is " + fixed(highest, 2) + " mm high, stock.height_mm = " +
                     compact(blank.height_mm, 3) + " is " + fixed(highest - blank.height_mm, 2) + " mm too low; take a blank of at least " +
                     fixed(least_blank_mm(surface), 1) + " mm, move the receiver farther away, or make the lens thinner (lens.thickness_mm)");
  }
  return blank;
}

std::optional<Outline> finishing_border(const Job& job, const Outline& outline) {
  const bool has_land = job.land.width_mm > 0;
  const bool has_margin = (blank_size_mm(job) - job.lens.size_mm).maxCoeff() > 0;
  if (outline.shape == Outline::Shape::kRectangle && !has_land && !has_margin) return std::nullopt;
  return outline;
}

double land_z_mm(const Job& job, const SplineSurface& surface, const Outline& outline) {
  return border_heights(surface, outline).lowest_mm - job.land.drop_mm;
}

ReachableSurface reachable_by_finishing(const Job& job, const SplineSurface& surface, const Outline& outline, const Monitor& monitor) {
  constexpr double kMostMm = 600;
  const Vec2 size = surface.extent().size();
  if (size.maxCoeff() > kMostMm) {
    throw InputError("lens.size_mm: milling is planned on grids of a tenth of a millimetre, for lenses of up to " + compact(kMostMm, 0) + " mm; this one is " +
                     compact(size.x(), 3) + " x " + compact(size.y(), 3) + " mm");
  }
  // Half a finishing stepover sees every fillet that matters; a tenth of a mm bounds the work.
  const double pitch = std::clamp(size.maxCoeff() / 1000, 0.05, 0.1);
  return within(reachable_surface(surface, job.finish.cutter.radius_mm(), pitch, monitor), outline);
}

ProfileOptions profile_options(const Job& job, const SplineSurface& surface, const Outline& outline) {
  ProfileOptions profile = job.profile.options;
  profile.land_mm = job.land.width_mm;
  if (profile.land_mm > 0) profile.land_z_mm = land_z_mm(job, surface, outline);
  return job.profile.tabs_give_way ? with_fitting_tabs(profile, outline, job.rough.cutter) : profile;
}

}  // namespace lightmill

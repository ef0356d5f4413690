// Where a ball rests on the smooth surface: the surface's dilation by a ball, many centres at a time.
#pragma once

#include <vector>

#include "cam/spline_surface.h"
#include "design/core/geometry.h"

namespace lightmill::detail {

/// A ball at rest on the surface.
struct Contact {
  double z = 0;               ///< of the ball's centre, mm: the dilation D(x, y)
  Vec2 point = Vec2::Zero();  ///< (x, y) of the place where it touches (the highest one if several)
  Vec2 slope = Vec2::Zero();  ///< of the surface there; also the gradient of D (envelope theorem)
};

/// The dilation D(c) = max over p of h(p) + sqrt(R^2 - |p - c|^2) of one surface by one ball. A scan of height samples
/// finds every local maximum that can win, Newton on the C2 spline makes them exact (below 1e-8 mm). Only places with
/// |p - c| <= R s / sqrt(1 + s^2), s the steepest slope of the surface, can hold a contact, so only those are scanned.
/// Immutable after construction: safe to use from several threads.
class BallContact {
 public:
  /// Samples the surface up to `margin_mm` outside its rectangle (centres up to about margin - R outside are quick,
  /// those farther out are still exact but slow). `surface` must outlive this.
  BallContact(const SplineSurface& surface, double radius_mm, double margin_mm);

  [[nodiscard]] double radius_mm() const { return radius_mm_; }
  [[nodiscard]] const SplineSurface& surface() const { return *surface_; }
  /// Steepest slope on the sampled region.
  [[nodiscard]] double steepest() const { return steepest_; }
  [[nodiscard]] Contact at(double x, double y) const;

 private:
  const SplineSurface* surface_;
  double radius_mm_;
  double steepest_ = 0;
  double reach_mm_ = 0;   // how far from the centre a contact can be
  double missed_mm_ = 0;  // how much lower than a maximum the sample next to it can be
  double base_mm_ = 0;    // subtracted from the samples, which are floats
  Vec2 first_;            // of the sample grid
  Vec2 pitch_mm_;
  Grid<float> samples_;
};

/// The same for a single centre, without preparation: scans the whole disc below the ball.
Contact ball_contact(const SplineSurface& surface, double radius_mm, double x, double y);

}  // namespace lightmill::detail

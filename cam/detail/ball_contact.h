// Where a ball rests on the smooth surface: the surface's dilation by a ball, many centres at a time.
#pragma once

#include <cmath>
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
/// finds every local maximum that can win, Newton on the C2 spline makes them exact (below 1e-8 mm). At a contact
/// p - c = R grad h / sqrt(1 + |grad h|^2): bounds on the slopes around c tell where contacts can be, and only that is scanned.
/// Immutable after construction: safe to use from several threads.
class BallContact {
 public:
  /// Samples the surface up to `margin_mm` outside its rectangle (centres up to about margin - R outside are quick,
  /// those farther out are still exact but slow). `surface` must outlive this.
  BallContact(const SplineSurface& surface, double radius_mm, double margin_mm);

  [[nodiscard]] double radius_mm() const { return radius_mm_; }
  [[nodiscard]] const SplineSurface& surface() const { return *surface_; }
  [[nodiscard]] Contact at(double x, double y) const;

 private:
  struct Reach {
    float min_x, max_x, min_y, max_y;
  };
  /// Where contacts can be, from the centre, for centres in each square of kSquare x kSquare samples.
  [[nodiscard]] Grid<Reach> reaches() const;
  static constexpr int kSquare = 4;

  const SplineSurface* surface_;
  double radius_mm_;
  double missed_mm_ = 0;  // how much lower than a maximum the sample next to it can be
  double base_mm_ = 0;    // subtracted from the samples, which are floats
  Vec2 first_;            // of the sample grid
  Vec2 pitch_mm_;
  Grid<float> samples_;
  Grid<Reach> reaches_;
};

/// Axes in the plane, turned so that the first one points along `along` (a unit vector).
struct Turn {
  Vec2 along{1, 0};
  /// By an angle; right angles are exact.
  static Turn by(double angle_rad);
  /// From these axes to the workpiece's, and back.
  [[nodiscard]] Vec2 out(const Vec2& p) const { return {along.x() * p.x() - along.y() * p.y(), along.y() * p.x() + along.x() * p.y()}; }
  [[nodiscard]] Vec2 in(const Vec2& p) const { return {along.x() * p.x() + along.y() * p.y(), along.x() * p.y() - along.y() * p.x()}; }
};

/// The ball and its surface as seen from turned axes; heights are the same.
class TurnedBall {
 public:
  TurnedBall(const BallContact& ball, const Turn& turn) : ball_(&ball), turn_(turn) {}
  [[nodiscard]] const BallContact& ball() const { return *ball_; }
  [[nodiscard]] const Turn& turn() const { return turn_; }
  [[nodiscard]] double radius_mm() const { return ball_->radius_mm(); }
  [[nodiscard]] Contact at(double x, double y) const {
    const Vec2 p = turn_.out({x, y});
    const Contact contact = ball_->at(p.x(), p.y());
    return {contact.z, turn_.in(contact.point), turn_.in(contact.slope)};
  }
  /// Of the surface.
  [[nodiscard]] double height(const Vec2& place) const {
    const Vec2 p = turn_.out(place);
    return ball_->surface().height(p.x(), p.y());
  }
  [[nodiscard]] Vec3 normal(const Vec2& place) const {
    const Vec2 p = turn_.out(place);
    const auto s = ball_->surface().sample(p.x(), p.y());
    const Vec2 slope = turn_.in({s.hx, s.hy});
    return Vec3(-slope.x(), -slope.y(), 1) / std::sqrt(1 + slope.squaredNorm());
  }

 private:
  const BallContact* ball_;
  Turn turn_;
};

/// The same for a single centre, without preparation: scans the whole disc below the ball.
Contact ball_contact(const SplineSurface& surface, double radius_mm, double x, double y);

}  // namespace lightmill::detail

// What one straight motion of a cutter covers, as chords of lines along x, y or z.
#pragma once

#include <array>
#include <optional>

#include "machine/detail/stock_sweep.h"
#include "machine/detail/stock_tool.h"

namespace lightmill {

/// Places along a line parallel to a coordinate axis.
struct Chord {
  double from = kNothing, to = -kNothing;
  void include(const Chord& other) {
    from = std::min(from, other.from);
    to = std::max(to, other.to);
  }
  [[nodiscard]] bool empty() const { return !(from < to); }
};

/// The cutting part of a cutter (its flutes up to their end) that moves straight with its axis as it is: a convex body, so that
/// a line meets it in one chord. Closed forms for balls and, where their corner is not met, upright mills; else Newton from
/// both sides.
class SweptBody {
 public:
  /// The axis is that of the motion's middle. A margin grows the cutter by so much all around, or shrinks it.
  SweptBody(const Tool& tool, const ToolPose& from, const ToolPose& to, double margin_mm = 0);

  [[nodiscard]] const Vec3& low() const { return low_; }    ///< corners of a box around it
  [[nodiscard]] const Vec3& high() const { return high_; }
  /// A rectangle around what of it is no higher than this, seen from above; empty where nothing is.
  [[nodiscard]] Box2 below(double z_mm) const;
  /// Of the line along coordinate axis 0, 1 or 2 through `place`, whose own coordinate along it does not matter.
  [[nodiscard]] Chord chord(int along, const Vec3& place) const;

 private:
  enum class Kind { kUpright, kBall, kOther };
  struct Capsule {
    Vec3 from, way;
    double length2 = 0;
  };
  [[nodiscard]] Chord upright_chord(int along, const Vec3& place) const;
  [[nodiscard]] Chord ball_chord(int along, const Vec3& place) const;
  [[nodiscard]] Chord other_chord(int along, const Vec3& place) const;
  [[nodiscard]] Chord capsule_chord(const Capsule& capsule, int along, const Vec3& place) const;

  Kind kind_ = Kind::kOther;
  RoundedCylinder body_;
  double radius_ = 0, top_ = 0;  ///< of the whole; of the flutes above the tip
  Vec3 tip_, motion_, axis_;
  Vec3 low_, high_;
  Sweep upright_;  ///< kUpright: its underside
  // kBall: the ball's centre sweeps a parallelogram, spanned by the motion and the flutes' length.
  std::array<Capsule, 4> rims_;
  int rim_count_ = 0;
  bool flat_ = false;  ///< the parallelogram has a plane
  Vec3 normal_, along_motion_, along_axis_;  ///< unit; shares of a place in the plane
};

/// How deep the body is inside a solid's material along z; where it passes between the z rays, along x or y.
StockField::Probe touch(const SolidStock& solid, const SweptBody& body);

}  // namespace lightmill

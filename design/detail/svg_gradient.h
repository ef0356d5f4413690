// Gradients of an SVG drawing, as narrow bands of even light.
#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "design/detail/fills.h"
#include "design/detail/svg_colour.h"

namespace lightmill::detail {

/// Bands per gradient, from its first to its last stop; each has the mean light of what it stands for.
inline constexpr int kGradientBands = 64;

struct Gradient {
  enum class Spread { kPad, kReflect, kRepeat };
  struct Stop {
    double offset;  ///< from 0 to 1, never falling
    Colour colour;
  };
  std::vector<Stop> stops;  ///< at least one
  Spread spread = Spread::kPad;
  bool radial = false;
  Vec2 from{0, 0};  ///< linear: start; radial: the focus
  Vec2 to{1, 0};    ///< linear: end; radial: the centre
  double radius = 0;
  Eigen::Affine2d to_mm = Eigen::Affine2d::Identity();  ///< from its own coordinates
};

struct Band {
  Region shape;
  double light;
  double opacity;
};

/// Bands that cover the box.
std::vector<Band> bands_of(const Gradient& gradient, const Box2& box_mm);

/// What the gradient is on average from its first to its last stop.
Band mean_of(const Gradient& gradient);

}  // namespace lightmill::detail

// Feeds along a way: chips no thicker than the cutter's data mean, no more acceleration than a machine gives.
#pragma once

#include <vector>

#include "cam/toolpath.h"

namespace lightmill::detail {

/// The contact angle for which feeds per tooth in cutter files are meant: the usual tilt on level ground.
inline constexpr double kDataContactAngle = 30 * kPi / 180;

/// Thickest chip of a ball as a share of its feed per tooth. The edge runs on a circle of the effective diameter
/// D = 2 R sin(angle at the far side of the cut) and engages by the stepover s: sqrt(1 - (1 - 2 s / D)^2), 1 from s = D / 2 on.
double chip_share(double radius_mm, double stepover_mm, double contact_angle_rad);

/// The cutter's feed, less where the contact nears the ball's centre so that the chip stays as thin as at kDataContactAngle.
double chip_feed(const Cutter& ball, double stepover_mm, double contact_angle_rad);

/// Lowers the feeds of cutting moves and plunges so that neither bends (a corner counts as rounded over 0.2 mm) nor changes
/// of feed accelerate the tip by more than `acceleration`. Feeds are lowered in steps of 15 %.
void limit_acceleration(std::vector<Move>& moves, double acceleration_mm_per_s2);

}  // namespace lightmill::detail

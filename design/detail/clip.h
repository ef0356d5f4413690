// The part of a segment between two parallel lines.
#pragma once

#include <algorithm>
#include <utility>

namespace lightmill::detail {

/// Keeps of the parameters [t0, t1] those with lo <= p + t d <= hi; false when nothing is left.
inline bool clip(double p, double d, double lo, double hi, double& t0, double& t1) {
  if (d == 0) return p >= lo && p <= hi;
  double enter = (lo - p) / d;
  double leave = (hi - p) / d;
  if (enter > leave) std::swap(enter, leave);
  t0 = std::max(t0, enter);
  t1 = std::min(t1, leave);
  return t0 <= t1;
}

}  // namespace lightmill::detail

// The transport map between its samples, up to the border of the light and along its creases.
#pragma once

#include <vector>

#include "design/detail/natural_neighbour.h"
#include "design/transport.h"

namespace lightmill::detail {

/// Natural neighbour interpolation of the map [paper sec. 5]. The map is the gradient of a convex function, whose
/// values at the sites are the potentials: where it jumps, a place belongs to the branch on which that function is the
/// highest, and takes its target from that branch alone.
class MapInterpolation {
 public:
  MapInterpolation(const TransportMap& map, const SourceLight& source);

  /// Targets of places on the receiver where unbent light arrives.
  [[nodiscard]] std::vector<Vec2> at(const std::vector<Vec2>& places_mm) const;

 private:
  struct Site {
    Vec2 place_mm;
    Vec2 target_mm;
    double potential_mm2 = 0;
    double stretch = 1;  ///< how far targets are apart, over how far sites are, on this side of any crease
    Eigen::Matrix2d gradient = Eigen::Matrix2d::Zero();
  };
  [[nodiscard]] bool same_branch(const Site& a, const Site& b) const;

  std::vector<Site> sites_;
  std::unique_ptr<NaturalNeighbours> neighbours_;
};

}  // namespace lightmill::detail

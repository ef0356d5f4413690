// Where a ball comes down within the lens: in grooves that are cut already, where it takes off nothing, and over to its own way.
#pragma once

#include <functional>
#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"

namespace lightmill::detail {

/// On this way a ball goes over from a groove to its own line, touching the surface. Where the two run beside each other the mean
/// height of the cusps falls by up to h / 3 on it, an S: with h = 1.3 um the slope bends by 6 h / 3 / l^2 at most, and light at
/// 300 mm gets brighter by 0.49 * 300 of that, 2.4 %.
inline constexpr double kGoOverMm = 4;

/// The cubic from one place to another with unit vectors along it at both, in even legs of about 0.2 mm or `legs`; `reach_mm` is
/// the length of its tangents.
std::vector<Vec2> bend(const Vec2& from, const Vec2& from_along, const Vec2& to, const Vec2& to_along, double reach_mm, int legs = 0);

/// Ways of a ball's centre that leave nothing for it to cut.
class Grooves {
 public:
  /// Lines end where the ball has lifted: `over_lens` says whether that matters for the light. All in the workpiece's axes.
  Grooves(std::vector<std::vector<Vec2>> lines, std::function<bool(const Vec2&)> over_lens);

  /// How a ball gets to a place, then going along a unit vector: `landing_mm` in a groove, and over. Of the grooves near, the one from
  /// which the way bends least. Empty when there is none.
  [[nodiscard]] std::vector<Vec2> way_to(const Vec2& place, const Vec2& along, double landing_mm) const;

 private:
  struct Vertex {
    int line, index;
  };
  /// The last `length_mm` to a vertex, from the farther end; straight on where the groove ends beside the lens. Empty when it ends
  /// over the lens.
  [[nodiscard]] std::vector<Vec2> stretch_to(const Vertex& vertex, int sense, double length_mm) const;
  [[nodiscard]] Eigen::Vector2i cell(const Vec2& place) const;

  std::vector<std::vector<Vec2>> lines_;
  std::function<bool(const Vec2&)> over_lens_;
  Box2 box_;
  Grid<std::vector<Vertex>> cells_;
};

}  // namespace lightmill::detail

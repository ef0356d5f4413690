// The loop through the picture: what the surface paints too bright or too dark, as a change of where its light shall go.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/detail/creases.h"
#include "design/target.h"

namespace lightmill::detail {

/// What light that is asked for on one side of a crease does to the other: kJoined pulls it along, as hard as the triangles between
/// them are stiff (little, as far as they stretch across the dark); kParted leaves it alone.
enum class Seams { kJoined, kParted };

/// Beams of triangles against a picture. Beside curves and points nothing is asked for: their light has no area. Triangles that
/// aim there, and those that a crease crosses, are not steered.
class PictureLoop {
 public:
  /// `places`: where the vertices' light lands unbent; `targets`: where it shall go; `flux`: the light through each
  /// triangle, of all light.
  PictureLoop(const TargetLight& picture, int pixels, const std::vector<std::array<int, 3>>& triangles, std::vector<double> flux,
              const std::vector<Vec2>& places, const std::vector<Vec2>& targets, const Creases& creases, Seams seams);
  ~PictureLoop();
  PictureLoop(const PictureLoop&) = delete;
  PictureLoop& operator=(const PictureLoop&) = delete;

  struct Errors {
    Grid<double> missing;  ///< light per pixel that steered triangles shall bring, below 0: take away; the sum is 0
    double sum = 0;        ///< of all differences between picture and light
  };
  /// When the vertices' rays land here.
  [[nodiscard]] Errors errors(const std::vector<Vec2>& landed_mm) const;

  /// How far each target shall move, at most half a pixel. A change d of the map T moves its light f by div(f d) on the receiver; d
  /// is the gradient of a potential over the places, because slopes must be. Weakly, with a hat function u of each vertex:
  /// sum over triangles of f grad u . DT^-1 d = sum of u missing (a Newton step on the Monge-Ampere equation). Light for curves
  /// is stiff: it stays, and what lies around it slides only towards it or away, so that the slopes remain a surface's.
  [[nodiscard]] std::vector<Vec2> moves(const Errors& errors, const std::vector<Vec2>& landed_mm) const;

 private:
  struct Factor;
  [[nodiscard]] std::vector<Vec2> in_pixels(const std::vector<Vec2>& landed_mm) const;

  const std::vector<std::array<int, 3>>& triangles_;
  std::vector<double> flux_;
  std::vector<std::array<Vec2, 3>> gradients_;  // of the corners' hat functions over the places
  std::vector<double> areas_;                   // of triangles over the places; 0: a crease crosses it
  std::vector<char> steered_;                   // triangles
  Box2 extent_;
  Grid<double> wanted_;
  std::vector<char> judged_;                    // pixels away from curves and points
  std::unique_ptr<Factor> factor_;
};

}  // namespace lightmill::detail

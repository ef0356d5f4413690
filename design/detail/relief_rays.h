// Does a ray that starts on a vertex of the relief meet the relief again?
#pragma once

#include <vector>

#include "design/mesh.h"

namespace lightmill::detail {

class ReliefRays {
 public:
  explicit ReliefRays(const SurfaceMesh& mesh);

  /// Triangles around the vertex itself do not count.
  [[nodiscard]] bool meets(int vertex, const Vec3& direction) const;

 private:
  [[nodiscard]] bool cell_meets(int cell, int vertex, const Vec3& origin, const Vec3& direction) const;

  const SurfaceMesh& mesh_;
  Box2 box_;
  double lowest_ = 0, highest_ = 0;
  int columns_ = 1, rows_ = 1;
  double cell_mm_ = 1;
  std::vector<int> first_;      // of each cell in triangles_
  std::vector<int> triangles_;  // that touch the cell's box
  std::vector<double> bottom_, top_;
};

}  // namespace lightmill::detail

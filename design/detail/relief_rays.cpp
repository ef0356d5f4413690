#include "design/detail/relief_rays.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace lightmill::detail {

namespace {
constexpr double kInfinity = std::numeric_limits<double>::infinity();
}

ReliefRays::ReliefRays(const SurfaceMesh& mesh) : mesh_(mesh) {
  lowest_ = kInfinity;
  highest_ = -kInfinity;
  for (const Vec3& v : mesh.vertices) {
    box_.include(v.head<2>());
    lowest_ = std::min(lowest_, v.z());
    highest_ = std::max(highest_, v.z());
  }
  const Vec2 size = box_.size().cwiseMax(Vec2::Constant(1e-9));
  // About two triangles per cell.
  cell_mm_ = std::max(std::sqrt(2 * size.prod() / std::max<double>(1, static_cast<double>(mesh.triangles.size()))),
                      size.maxCoeff() / 4096);
  columns_ = 1 + static_cast<int>(size.x() / cell_mm_);
  rows_ = 1 + static_cast<int>(size.y() / cell_mm_);
  const std::size_t cells = static_cast<std::size_t>(columns_) * rows_;
  bottom_.assign(cells, kInfinity);
  top_.assign(cells, -kInfinity);
  first_.assign(cells + 1, 0);
  const auto each_cell = [&](const std::array<int, 3>& t, const auto& visit) {
    Box2 reach;
    for (const int v : t) reach.include(mesh.vertices[v].head<2>());
    const int i0 = std::clamp(static_cast<int>((reach.min.x() - box_.min.x()) / cell_mm_), 0, columns_ - 1);
    const int i1 = std::clamp(static_cast<int>((reach.max.x() - box_.min.x()) / cell_mm_), 0, columns_ - 1);
    const int j0 = std::clamp(static_cast<int>((reach.min.y() - box_.min.y()) / cell_mm_), 0, rows_ - 1);
    const int j1 = std::clamp(static_cast<int>((reach.max.y() - box_.min.y()) / cell_mm_), 0, rows_ - 1);
    for (int j = j0; j <= j1; ++j) {
      for (int i = i0; i <= i1; ++i) visit(j * columns_ + i);
    }
  };
  for (const auto& t : mesh.triangles) {
    each_cell(t, [&](int cell) {
      ++first_[cell + 1];
      for (const int v : t) {
        bottom_[cell] = std::min(bottom_[cell], mesh.vertices[v].z());
        top_[cell] = std::max(top_[cell], mesh.vertices[v].z());
      }
    });
  }
  for (std::size_t c = 0; c < cells; ++c) first_[c + 1] += first_[c];
  triangles_.resize(first_.back());
  std::vector<int> next(first_.begin(), first_.end() - 1);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    each_cell(mesh.triangles[t], [&](int cell) { triangles_[next[cell]++] = static_cast<int>(t); });
  }
}

bool ReliefRays::cell_meets(int cell, int vertex, const Vec3& origin, const Vec3& direction) const {
  for (int k = first_[cell]; k < first_[cell + 1]; ++k) {
    const auto& t = mesh_.triangles[triangles_[k]];
    if (t[0] == vertex || t[1] == vertex || t[2] == vertex) continue;
    // [Moeller and Trumbore 1997]; a ray within a triangle's plane does not meet it.
    const Vec3 u = mesh_.vertices[t[1]] - mesh_.vertices[t[0]];
    const Vec3 v = mesh_.vertices[t[2]] - mesh_.vertices[t[0]];
    const Vec3 across = direction.cross(v);
    const double determinant = u.dot(across);
    if (std::abs(determinant) < 1e-14 * u.norm() * v.norm()) continue;
    const Vec3 from = origin - mesh_.vertices[t[0]];
    const double a = from.dot(across) / determinant;
    const Vec3 up = from.cross(u);
    const double b = direction.dot(up) / determinant;
    const double way = v.dot(up) / determinant;
    if (a >= 0 && b >= 0 && a + b <= 1 && way > 1e-9 * cell_mm_) return true;
  }
  return false;
}

bool ReliefRays::meets(int vertex, const Vec3& direction) const {
  const Vec3& origin = mesh_.vertices[vertex];
  if (direction.head<2>().norm() < 1e-12) return false;  // straight up or down a height field: nothing in the way
  // The ray ends where it leaves the relief's heights.
  const double end = direction.z() > 0   ? (highest_ - origin.z()) / direction.z()
                     : direction.z() < 0 ? (lowest_ - origin.z()) / direction.z()
                                         : kInfinity;
  int i = std::clamp(static_cast<int>((origin.x() - box_.min.x()) / cell_mm_), 0, columns_ - 1);
  int j = std::clamp(static_cast<int>((origin.y() - box_.min.y()) / cell_mm_), 0, rows_ - 1);
  const int step_i = direction.x() > 0 ? 1 : -1;
  const int step_j = direction.y() > 0 ? 1 : -1;
  const auto way_to = [&](int line, int axis) {
    return direction[axis] == 0 ? kInfinity : (box_.min[axis] + line * cell_mm_ - origin[axis]) / direction[axis];
  };
  double here = 0;
  while (here <= end && i >= 0 && j >= 0 && i < columns_ && j < rows_) {
    const double next_i = way_to(i + (step_i > 0), 0);
    const double next_j = way_to(j + (step_j > 0), 1);
    const double there = std::min({next_i, next_j, end});
    const double z_here = origin.z() + here * direction.z();
    const double z_there = origin.z() + there * direction.z();
    const int cell = j * columns_ + i;
    if (std::max(z_here, z_there) >= bottom_[cell] && std::min(z_here, z_there) <= top_[cell] && cell_meets(cell, vertex, origin, direction)) return true;
    if (next_i < next_j) {
      i += step_i;
    } else {
      j += step_j;
    }
    here = std::min(next_i, next_j);
  }
  return false;
}

}  // namespace lightmill::detail

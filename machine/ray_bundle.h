// Parallel rays and the material along each: one of the three bundles of a solid.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "design/core/grid.h"

namespace lightmill {

/// Material along a ray, mm from the workpiece's origin.
struct Span {
  float from = 0, to = 0;
  [[nodiscard]] bool empty() const { return to <= from; }
  [[nodiscard]] bool meets(const Span& other) const { return from < other.to && other.from < to; }
};

/// Most rays have one span, which lies in the grid; the others' are kept by row, so that rows can be cut by different threads.
class RayBundle {
 public:
  RayBundle() = default;
  RayBundle(int columns, int rows, Span whole) : rays_(columns, rows, Ray{whole, 0}), many_(rows) {}

  [[nodiscard]] int columns() const { return rays_.width; }
  [[nodiscard]] int rows() const { return rays_.height; }
  /// The spans of a ray in order; they neither touch nor overlap.
  [[nodiscard]] std::span<const Span> at(int column, int row) const {
    const Ray& ray = rays_.at(column, row);
    if (ray.many > 0) return many_[row][ray.many - 1];
    return {&ray.only, ray.only.empty() ? 0U : 1U};
  }
  void subtract(int column, int row, Span cut);
  void set(int column, int row, std::span<const Span> spans);
  /// Of all spans.
  [[nodiscard]] double length_mm() const;
  [[nodiscard]] std::size_t bytes() const;

 private:
  struct Ray {
    Span only;
    std::uint32_t many = 0;  ///< from 1: where in its row's `many_` its spans are; 0: it has at most the one
  };
  Grid<Ray> rays_;
  std::vector<std::vector<std::vector<Span>>> many_;
};

}  // namespace lightmill

// A dense two-dimensional array in row-major order.
#pragma once

#include <cassert>
#include <cstddef>
#include <vector>

namespace lightmill {

/// `width` x `height` values; at(column, row). Which way rows run is said where a grid is used:
/// image files have row 0 at the top, grids in a geometric frame have row 0 at the smallest y.
template <typename T>
struct Grid {
  int width = 0;
  int height = 0;
  std::vector<T> values;

  Grid() = default;
  Grid(int w, int h, T fill = T{}) : width(w), height(h), values(static_cast<std::size_t>(w) * h, fill) {}

  [[nodiscard]] bool empty() const { return values.empty(); }
  [[nodiscard]] std::size_t index(int column, int row) const {
    assert(column >= 0 && column < width && row >= 0 && row < height);
    return static_cast<std::size_t>(row) * width + column;
  }
  [[nodiscard]] T& at(int column, int row) { return values[index(column, row)]; }
  [[nodiscard]] const T& at(int column, int row) const { return values[index(column, row)]; }
};

/// The same picture with the row order turned upside down (between files and geometric frames).
template <typename T>
Grid<T> flipped_rows(const Grid<T>& grid) {
  Grid<T> result(grid.width, grid.height);
  for (int row = 0; row < grid.height; ++row) {
    for (int column = 0; column < grid.width; ++column) {
      result.at(column, grid.height - 1 - row) = grid.at(column, row);
    }
  }
  return result;
}

/// The same picture with the column order reversed.
template <typename T>
Grid<T> flipped_columns(const Grid<T>& grid) {
  Grid<T> result(grid.width, grid.height);
  for (int row = 0; row < grid.height; ++row) {
    for (int column = 0; column < grid.width; ++column) {
      result.at(grid.width - 1 - column, row) = grid.at(column, row);
    }
  }
  return result;
}

}  // namespace lightmill

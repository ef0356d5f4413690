#include "cam/detail/spline_refinement.h"

#include <cmath>
#include <vector>

namespace lightmill::detail {

namespace {

using Line = std::vector<double>;

Line halved(const Line& c) {
  Line fine(2 * c.size() - 3);
  for (std::size_t i = 0; i + 1 < c.size(); ++i) {
    fine[2 * i] = (c[i] + c[i + 1]) / 2;
    if (i > 0) fine[2 * i - 1] = (c[i - 1] + 6 * c[i] + c[i + 1]) / 8;
  }
  return fine;
}

/// The inverse of halved() on its range.
Line doubled(const Line& f) {
  Line c((f.size() + 3) / 2);
  for (std::size_t i = 1; i + 1 < c.size(); ++i) c[i] = 2 * f[2 * i - 1] - (f[2 * i - 2] + f[2 * i]) / 2;
  c.front() = 2 * f.front() - c[1];
  c.back() = 2 * f.back() - c[c.size() - 2];
  return c;
}

/// `change` of every row, then of every column.
template <typename Change>
Grid<double> both_ways(const Grid<double>& grid, Change change) {
  std::vector<Line> rows;
  for (int j = 0; j < grid.height; ++j) {
    const auto row = grid.values.begin() + static_cast<std::ptrdiff_t>(j) * grid.width;
    rows.push_back(change(Line(row, row + grid.width)));
  }
  Line column(rows.size());
  Grid<double> result;
  for (std::size_t i = 0; i < rows.front().size(); ++i) {
    for (std::size_t j = 0; j < rows.size(); ++j) column[j] = rows[j][i];
    const Line changed = change(column);
    if (i == 0) result = Grid<double>(static_cast<int>(rows.front().size()), static_cast<int>(changed.size()));
    for (std::size_t j = 0; j < changed.size(); ++j) result.at(static_cast<int>(i), static_cast<int>(j)) = changed[j];
  }
  return result;
}

}  // namespace

Grid<double> with_spans_halved(const Grid<double>& coefficients) {
  return both_ways(coefficients, halved);
}

std::optional<Grid<double>> with_spans_doubled(const Grid<double>& coefficients, double tolerance_mm) {
  const auto even = [](int count) { return count >= 5 && count % 2 == 1; };  // spans + 3
  if (!even(coefficients.width) || !even(coefficients.height)) return std::nullopt;
  Grid<double> coarse = both_ways(coefficients, doubled);
  const Grid<double> again = with_spans_halved(coarse);
  for (std::size_t k = 0; k < again.values.size(); ++k) {
    if (!(std::abs(again.values[k] - coefficients.values[k]) <= tolerance_mm)) return std::nullopt;
  }
  return coarse;
}

}  // namespace lightmill::detail

// A uniform cubic spline on spans of half the size, and back where that loses nothing.
#pragma once

#include <optional>

#include "design/core/grid.h"

namespace lightmill::detail {

/// The same surface on twice as many spans along x and y: coefficients by knot insertion.
Grid<double> with_spans_halved(const Grid<double>& coefficients);

/// The same surface on half as many spans, if it is one within `tolerance_mm` of every coefficient; none for an odd number of
/// spans.
std::optional<Grid<double>> with_spans_doubled(const Grid<double>& coefficients, double tolerance_mm);

}  // namespace lightmill::detail

// Exact flux of grids, evenly lit areas and lines on the pixels of a grid.
#pragma once

#include <vector>

#include "design/core/geometry.h"
#include "design/core/grid.h"
#include "design/target.h"

namespace lightmill::detail {

/// Flux onto another grid over the same rectangle, by exact overlap.
Grid<double> box_filtered(const Grid<double>& flux, int width, int height);

/// Adds the flux of the areas between borders; what lies outside the grid is left out. Analytic, to rounding; what is
/// less than that of the brightest pixel is black.
void add_borders(Grid<double>& flux, const Box2& extent, const std::vector<AreaBorder>& borders);

/// Adds the flux of a segment with a linear density per mm to the pixels it passes; what lies outside the grid is left
/// out.
void add_segment(Grid<double>& flux, const Box2& extent, const Vec2& from, const Vec2& to, double density_from,
                 double density_to);

}  // namespace lightmill::detail

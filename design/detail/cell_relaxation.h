// Coordinate descent on the dual for single power cells: those with too little light grow, the others stay as they are.
#pragma once

#include <vector>

#include "design/detail/power_diagram.h"
#include "design/detail/target_measure.h"

namespace lightmill::detail {

struct RelaxationOptions {
  double below = 0.2;      ///< cells with less than this share of their mass grow, until they have
  double least = 0.5;      ///< at least this share and
  double most = 1.0;       ///< at most this one: up to its full share, a cell that grows lowers the dual
  int moves_per_cell = 3;  ///< for each cell that has too little at first; where more follow, all have to move together
  double reach = 0;        ///< no light is farther than this from the origin in x or y
};

/// Grows cells with too little light one after the other, each among the others as they are by then, and those that have lost
/// too much to a neighbour after them. Returns the new potentials; `diagram` belongs to `psi`, `masses` and `wanted` are
/// the cells' own and the source's. Neighbours are looked for in `diagram`, which ages on the way: whether the dual has
/// really fallen is for the caller to see.
std::vector<double> relax_cells(const TargetMeasure& measure, const PowerDiagram& diagram, const std::vector<Vec2>& sites,
                                const std::vector<double>& psi, const std::vector<double>& masses,
                                const std::vector<double>& wanted, const RelaxationOptions& options);

}  // namespace lightmill::detail

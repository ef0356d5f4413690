// The ridges between ball passes, as high as they really are: from the envelope of all motions, not from the nodes.
#pragma once

#include "machine/detail/stock_field.h"

namespace lightmill {

/// As in MachinedSurface.
struct RidgePeaks {
  Grid<float> heights_mm;
  Grid<PeakOffset> offsets;
};

/// Along the lines of the mesh the surface E is the least of the heights of all motions of balls. From a place q on a line through
/// node n, at most w, half a pitch, away, it is carried to the node along its slope over a pitch:
///     F(q) = E(q) - (q - n) (E(q + w) - E(q - w)) / 2w,
/// and the peak is where F is the greatest. On a flank F(q) <= E(n), so ridges, and the middles between nodes, are all that must be
/// looked at; at a ridge between equal flanks on a plane F is the ridge's height over the node, exactly. As it is made of E alone, and
/// moves by no more than twice what E moves, neither the order of the motions nor how they are split matters.
RidgePeaks ridge_peaks(const StockField& field);

}  // namespace lightmill

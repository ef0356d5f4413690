// The lens as a boundary representation of OpenCASCADE: for solid.cpp only.
#pragma once

#include <TopoDS_Shape.hxx>

#include "cam/solid.h"

namespace lightmill::detail {

// Of edges and vertices. Neighbours share exact poles, so that this only covers rounding in the file's decimals.
constexpr double kToleranceMm = 1e-7;

/// One solid: the surface's tiles and walls within the outline, on the land with its mounting features. Edges are shared.
TopoDS_Shape lens_shape(const SplineSurface& surface, const SolidOptions& options);

}  // namespace lightmill::detail

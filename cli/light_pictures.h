// Pictures of how a lens sorts its light [paper fig. 9 to 11]. Pictures of the lens are seen from +Z with +X to the
// right, pictures of the receiver as their reader sees them.
#pragma once

#include <filesystem>
#include <vector>

#include "design/beams.h"
#include "design/transport.h"

namespace lightmill {

/// Mean curvature of the surface, red where it bulges and blue where it is hollow; full colour for the strongest
/// fiftieth.
void write_curvature_picture(const std::filesystem::path& path, const SurfaceMesh& mesh, const Box2& lens_box);

/// A checkerboard of `squares` along the longer side of `picture` on the receiver, as seen through the lens; gray where
/// no light passes. `ends` as ray_ends() gives.
void write_checkerboard_picture(const std::filesystem::path& path, const SurfaceMesh& mesh,
                                const std::vector<RayEnds>& ends, const Box2& lens_box, const Box2& picture,
                                int squares = 20);

/// Regularly placed samples on their straight way from source to target, in four stills; coloured by where they
/// started.
void write_samples_picture(const std::filesystem::path& path, const TransportMap& map, const Box2& source_box,
                           const Box2& picture, ViewedFrom viewed_from);

/// The power cells that share the target.
void write_cells_picture(const std::filesystem::path& path, const TransportMap& map, const Box2& picture,
                         ViewedFrom viewed_from);

/// Two photographs of one caustic: half a second on the left and two seconds on the right. `white` times the mean
/// irradiance is white after two seconds, four times that after half a second; what is brighter is clipped, nothing
/// else is changed.
void write_exposures(const std::filesystem::path& path, const Grid<double>& flux, ViewedFrom viewed_from, double white);

}  // namespace lightmill

// Pictures for the eye: relief, tool paths, deviation. Heights and deviations are grids in the lens frame (row 0 at the
// smallest y); pictures show the part as seen from +Z, +X to the right, +Y up.
#pragma once

#include <filesystem>
#include <functional>

#include "cam/blank.h"
#include "cam/spline_surface.h"
#include "cam/toolpath.h"
#include "design/core/grid.h"
#include "design/mesh.h"

namespace lightmill {

/// Heights of a mesh at the centres of a grid over `extent`; NaN beside the mesh.
/// Values of a mesh's vertices, linear in between, over `extent`; NaN where no triangle is.
Grid<float> rasterise_values(const SurfaceMesh& mesh, const std::vector<double>& values, const Box2& extent, int pixels);
Grid<float> rasterise_heights(const SurfaceMesh& mesh, const Box2& extent, int pixels_along_longer_side);
/// Heights of the spline, or anything that follows from it, at the centres of a grid over its extent.
Grid<float> sample_heights(const SplineSurface& surface, int pixels_along_longer_side);
Grid<float> sample_surface(const SplineSurface& surface, int pixels_along_longer_side,
                           const std::function<double(const Vec2& place_mm, const SplineSurface::Sample&)>& value);

/// Height as colour, slope as shade, with a scale in mm.
void write_height_picture(const std::filesystem::path& path, const Grid<float>& heights_mm, double pixel_mm);

/// One pass seen from above: cuts coloured by height, links and rapids in their own colours; where passes lie closer than a
/// few pixels only some are drawn.
void write_toolpath_picture(const std::filesystem::path& path, const ToolPath& tool_path, const Blank& blank);

/// Material left in red, material missing in blue, with a scale of +-range_um; larger grids are reduced to the strongest
/// value per pixel. What is not a number is left out, and all around it.
void write_deviation_picture(const std::filesystem::path& path, const Grid<float>& deviation_um, double range_um, const std::string& unit = "um");

}  // namespace lightmill

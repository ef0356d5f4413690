// The spline surface that cam cut, kept for the dry run to measure against.
#pragma once

#include <filesystem>

#include "cam/spline_surface.h"

namespace lightmill {

/// Little-endian, versioned; whole or absent.
void write_spline(const std::filesystem::path& path, const SplineSurface& surface);
/// Throws InputError when the file is not one of ours.
SplineSurface read_spline(const std::filesystem::path& path);

}  // namespace lightmill

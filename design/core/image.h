// Pictures in and out of files (OpenImageIO behind it). Grids here have row 0 at the top, as files do.
#pragma once

#include <filesystem>

#include "design/core/grid.h"

namespace lightmill {

/// A picture in linear light, each value >= 0; alpha has been multiplied in (transparent is black).
struct Picture {
  Grid<float> gray;                ///< luminance (Rec. 709 weights)
  Grid<float> red, green, blue;    ///< empty for a gray file
};

/// How code values in a file become light.
enum class Transfer { kAuto, kSrgb, kLinear };

/// Reads PNG, TIFF, EXR... kAuto: 8-bit files are sRGB, 16-bit and float files are linear.
/// Throws InputError naming the file and the reason (unreadable, no pixels, negative or not finite values).
Picture read_picture(const std::filesystem::path& path, Transfer transfer = Transfer::kAuto);

/// Reads one float channel as it is (a height map).
Grid<float> read_float_image(const std::filesystem::path& path);

/// 8-bit sRGB for the eye: linear light in [0, 1] (clamped) becomes sRGB code values.
void write_png8(const std::filesystem::path& path, const Grid<float>& linear_light);
void write_png8(const std::filesystem::path& path, const Grid<float>& red, const Grid<float>& green, const Grid<float>& blue);
/// 16-bit linear: values in [0, 1] (clamped).
void write_png16(const std::filesystem::path& path, const Grid<float>& linear);
/// Float as it is: the extension says EXR or TIFF (deflate).
void write_float_image(const std::filesystem::path& path, const Grid<float>& values);

}  // namespace lightmill

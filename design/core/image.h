// Pictures in and out of files (OpenImageIO behind it). Grids here have row 0 at the top, as files do.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "design/core/grid.h"

namespace lightmill {

/// A picture in linear light, each value >= 0; alpha has been multiplied in (transparent is black).
struct Picture {
  Grid<float> gray;                   ///< luminance (Rec. 709 weights)
  Grid<float> red{}, green{}, blue{};   ///< if asked for, and the file has colours
  std::vector<std::string> warnings;  ///< what of the file was not taken as it is, each beginning with its name
};

/// How code values in a file become light.
enum class Transfer { kAuto, kSrgb, kLinear };

/// Reads PNG, TIFF, EXR...: gray, gray and alpha, RGB or RGBA of any depth. kAuto: 8-bit files are sRGB, 16-bit and float
/// files are linear. Rotations that the file asks for are done; an EXR's data window lies in its display window on black.
/// Throws InputError naming the file and the reason (unreadable, cut short, no pixels, other channels, negative or not
/// finite values and where).
Picture read_picture(const std::filesystem::path& path, Transfer transfer = Transfer::kAuto, bool with_colours = false);

/// Reads one float channel as it is (a height map).
Grid<float> read_float_image(const std::filesystem::path& path);

/// 8-bit sRGB for the eye: linear light in [0, 1] (clamped) becomes sRGB code values.
void write_png8(const std::filesystem::path& path, const Grid<float>& linear_light);
/// `dots_per_inch` above 0 is stated in the file, for who prints it.
void write_png8(const std::filesystem::path& path, const Grid<float>& red, const Grid<float>& green, const Grid<float>& blue,
                double dots_per_inch = 0);
/// 16-bit linear: values in [0, 1] (clamped).
void write_png16(const std::filesystem::path& path, const Grid<float>& linear);
/// Float as it is: the extension says EXR or TIFF (deflate).
void write_float_image(const std::filesystem::path& path, const Grid<float>& values);

}  // namespace lightmill

// The colour mask as files to print: PNG and SVG frame with registration marks.
#pragma once

#include <filesystem>
#include <string>

#include "design/color_mask.h"

namespace lightmill {

inline constexpr double kMaskDotsPerInch = 300;
inline constexpr double kMaskMargin_mm = 10;  ///< film around the lens's box, which carries the marks

/// The print: `mask` covers the lens's box and the margin; cross hairs stand 5 mm beyond the corners of the box, the
/// one at +X +Y is filled so that the film cannot be turned or flipped. Seen from +Z, +X to the right; its resolution
/// is in the file.
void write_mask_png(const std::filesystem::path& path, const ColourGrid& mask);

/// The same page in mm with the PNG `image_name` in it, lens outline, marks, and which side goes where.
void write_mask_svg(const std::filesystem::path& path, const std::string& image_name, const Lens& lens,
                    const std::string& part);

}  // namespace lightmill

// Cutter files: one shape, cutting data for each material.
#pragma once

#include <string>
#include <string_view>

#include "cam/cutter.h"

namespace lightmill {

/// The name by which cutter files know a material: "PMMA" of "PMMA, cast, annealed".
std::string material_name(std::string_view description);

/// With the cutting data of the table [material.NAME], or with those beside the shape, which are for whatever is milled. An empty name
/// takes the first table: where only the shape matters, as in read_cutter(path). Throws InputError naming file, line, key and rule; of
/// a material that the file has no data for, the ones it knows.
Cutter read_cutter(const std::filesystem::path& path, std::string_view material);

}  // namespace lightmill

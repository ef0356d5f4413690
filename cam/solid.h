// The lens and its blank as STEP solids (OpenCASCADE behind this wall).
#pragma once

#include <filesystem>
#include <string>

#include "cam/blank.h"
#include "cam/spline_surface.h"
#include "design/core/monitor.h"

namespace lightmill {

struct SolidSummary {
  bool valid = false;  ///< BRepCheck, closed, no free edge; after reading the file back
  int faces = 0;
  int free_edges = 0;
  double volume_mm3 = 0;         ///< of the solid read back, integrated with a tight epsilon
  double spline_volume_mm3 = 0;  ///< the B-spline's own integral
  double max_deviation_um = 0;   ///< of the faces read back from the spline
  std::uintmax_t file_bytes = 0;
  double seconds = 0;
};

/// Flat back in z = 0, four walls, and a top of B-spline tiles of about 80 spans that share exact edges. AP214/AP242,
/// mm. Written whole or not at all, read back and checked. Throws NumericalError if OpenCASCADE calls the result
/// invalid.
SolidSummary write_lens_step(const std::filesystem::path& path, const SplineSurface& surface,
                             const std::string& product_name, const Monitor& monitor = {});

void write_blank_step(const std::filesystem::path& path, const Blank& blank);

}  // namespace lightmill

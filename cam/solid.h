// The lens and its blank as STEP solids (OpenCASCADE behind this wall).
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "cam/blank.h"
#include "cam/mount.h"
#include "cam/outline.h"
#include "cam/print_mesh.h"
#include "cam/spline_surface.h"
#include "design/core/monitor.h"

namespace lightmill {

enum class StepSchema { kAp242, kAp214 };

struct SolidOptions {
  std::string product_name = "lens";
  std::string author = {};
  std::string material = {};                ///< into the product's description
  StepSchema schema = StepSchema::kAp242;
  std::optional<Outline> outline = {};      ///< empty: all of the surface's rectangle
  double land_mm = 0;                       ///< width of a flat land around the outline; 0: none
  double land_z_mm = 0;
  MountOptions mount = {};                  ///< cut into the land
  double mesh_tolerance_mm = 0;             ///< above 0: also a mesh of the solid for a printer, at most so far from it
};

struct SolidSummary {
  bool valid = false;  ///< BRepCheck, closed, no free edge; after reading the file back
  int faces = 0;
  int free_edges = 0;
  double volume_mm3 = 0;           ///< of the solid read back, integrated with a tight epsilon
  double expected_volume_mm3 = 0;  ///< the B-spline's own integral within the outline, and the land
  double max_deviation_um = 0;     ///< of the faces read back from the spline
  std::uintmax_t file_bytes = 0;
  PrintMesh mesh;                  ///< empty without mesh_tolerance_mm
  double seconds = 0;
};

/// Flat back in z = 0, walls along the outline, and a top of B-spline tiles of about 80 spans that share exact edges,
/// trimmed by the outline. mm. Written whole or not at all, read back and checked. Throws InputError when the optical
/// surface comes down to the back or the land does not lie below it, NumericalError if OpenCASCADE calls the result invalid.
SolidSummary write_lens_step(const std::filesystem::path& path, const SplineSurface& surface,
                             const SolidOptions& options = {}, const Monitor& monitor = {});

void write_blank_step(const std::filesystem::path& path, const Blank& blank);

}  // namespace lightmill

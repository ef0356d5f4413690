// `lightmill trace`: light through any surface mesh.
#pragma once

#include <filesystem>
#include <optional>

#include "cli/progress.h"
#include "design/core/geometry.h"

namespace lightmill {

/// What is not given is as the job says.
struct TraceOptions {
  std::filesystem::path surface;  ///< PLY, OBJ or STL
  std::filesystem::path job;
  std::filesystem::path picture;  ///< PNG to write; empty: none
  int pixels = 512;
  int lamp_samples = 64;
  bool fresnel = false;
  bool colours = false;
  std::optional<Vec3> direction;
  std::optional<Vec3> lamp_mm;
  double lamp_diameter_mm = 0;
  std::optional<Vec2> tilt_rad;
  int movie = 0;  ///< stills beside the picture while the lens turns into its place
};

int trace(const TraceOptions& options, Progress& progress);

}  // namespace lightmill

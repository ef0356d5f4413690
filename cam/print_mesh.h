// Triangle meshes for printers: a watertight solid as STL and 3MF.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill {

/// Triangles counter-clockwise seen from outside; corners at one place are one vertex. mm.
struct PrintMesh {
  std::vector<Vec3> vertices;
  std::vector<std::array<int, 3>> triangles;
};

/// Every edge runs once each way, so that there is an inside.
bool is_watertight(const PrintMesh& mesh);
double enclosed_volume_mm3(const PrintMesh& mesh);

/// Binary STL (floats, mm, no header fields of meaning). Whole or not at all.
void write_stl(const std::filesystem::path& path, const PrintMesh& mesh);
/// 3MF core specification: one object in millimetres, stored without compression. Whole or not at all.
void write_3mf(const std::filesystem::path& path, const PrintMesh& mesh, const std::string& title);

}  // namespace lightmill

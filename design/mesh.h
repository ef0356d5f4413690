// The optical surface as a triangle mesh in the lens frame, and PLY files of it.
#pragma once

#include <array>
#include <filesystem>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill {

/// Triangles are counter-clockwise seen from +Z; normals are unit and point to +Z's side. mm.
struct SurfaceMesh {
  std::vector<Vec3> vertices;
  std::vector<Vec3> normals;                  ///< one per vertex
  std::vector<std::array<int, 3>> triangles;
};

/// Angle-weighted vertex normals [Botsch et al. 2010, p. 41].
std::vector<Vec3> angle_weighted_normals(const std::vector<Vec3>& vertices, const std::vector<std::array<int, 3>>& triangles);

/// Vertices on the border of the mesh (an edge with one triangle), as flags.
std::vector<bool> border_vertices(const SurfaceMesh& mesh);

/// Triangles whose projection onto z = 0 is not counter-clockwise.
int count_inverted(const SurfaceMesh& mesh);

/// Binary little-endian PLY, float64 `x y z nx ny nz` per vertex, in mm; written whole or not at all.
void write_ply(const std::filesystem::path& path, const SurfaceMesh& mesh);

/// Reads binary or ASCII PLY, polygons cut into fans; normals are computed if absent. Throws InputError with the reason.
SurfaceMesh read_ply(const std::filesystem::path& path);

/// Reads PLY, OBJ or STL by extension. OBJ: v and f, the rest is passed over. STL, text or binary: corners at exactly the same
/// place become one vertex. Normals are angle-weighted unless a PLY has its own. Throws InputError naming line or byte.
SurfaceMesh read_surface(const std::filesystem::path& path);

/// The part of anybody's mesh that light leaves through: the triangles that face +Z (by more than a thousandth; walls count as
/// walls), with normals of their own. What was left out is counted.
struct OpticalPart {
  SurfaceMesh mesh;
  int walls_and_bottom = 0;  ///< triangles left out: not facing +Z
};
/// Throws InputError when no triangle faces +Z. A mesh that is an optical surface already comes back as it is.
OpticalPart optical_part(const SurfaceMesh& mesh);

/// A mesh with the vertex property `intensity` (empty when the file has none).
struct IntensityMesh {
  SurfaceMesh mesh;
  std::vector<double> intensities;
};
IntensityMesh read_intensity_ply(const std::filesystem::path& path);

}  // namespace lightmill

// The refracting surface that realises a transport map: Fresnel mapping and normal integration in turn [paper sec. 5].
#pragma once

#include <string>
#include <vector>

#include "design/core/monitor.h"
#include "design/mesh.h"
#include "design/optics.h"
#include "design/transport.h"

namespace lightmill {

/// Weights of the compound energy [paper eq. 5]. Every term is dimensionless (lengths by the mesh's edge length, fluxes by
/// the mean triangle's; see the room's README), so that one set works at every mesh and lens size.
struct SurfaceWeights {
  double integration = 1;
  double barrier = 1;
  double direction = 1e-4;
  double flux = 1e-3;
  double smoothness = 1e-5;
};

struct SurfaceOptions {
  int mesh = 321;                 ///< vertices along the longer side
  SurfaceWeights weights;
  int outer_iterations = 4;       ///< at most this many turns of Fresnel mapping and integration; the first and the last move
                                  ///< heights only, so that vertices slide from 3 turns on
  double height_tolerance_mm = 2e-5;  ///< stop when no vertex's height changes by more in a turn
};

struct SurfaceSummary {
  int vertices = 0;
  double seconds = 0;
  int outer_iterations = 0;
  std::vector<double> energy_history;     ///< compound energy after each integration
  int inverted_triangles = 0;
  double height_range_mm = 0;             ///< highest minus lowest vertex
  double min_concave_radius_mm = 0;       ///< smallest radius of concave curvature (99.9th percentile of curvature along
                                          ///< edges, off the border); infinite where nothing is concave
  double final_height_change_mm = 0;
  std::string reason;
};

struct OpticalSurface {
  SurfaceMesh mesh;                  ///< lens frame; lowest vertex at z = lens.thickness_mm
  std::vector<Vec2> targets_mm;      ///< where each vertex shall send its light on the receiver
  std::vector<Vec2> entry_mm;        ///< x, y of the incoming ray each vertex started on
  SurfaceSummary summary;
};

/// The regular start mesh of a lens (flat, z = thickness): a grid for a rectangle, rings of triangles for a disk.
SurfaceMesh start_mesh(const Lens& lens, int vertices_along_longer_side);

/// Natural neighbour (Sibson) interpolation of the map at points of the source plane, extrapolated at the border [paper fig. 7].
std::vector<Vec2> interpolate_map(const TransportMap& map, const SourceLight& source, const std::vector<Vec2>& points_mm);

/// Parallel light along +Z through the flat back, refracted at the surface only. Throws NumericalError when Ceres fails.
OpticalSurface solve_surface(const Lens& lens, const Receiver& receiver, const TransportMap& map,
                             const SurfaceOptions& options = {}, const Monitor& monitor = {});

/// The same from given target points per vertex of start_mesh (for ground truth and for maps from elsewhere).
OpticalSurface solve_surface(const Lens& lens, const Receiver& receiver, const std::vector<Vec2>& targets_mm,
                             const SurfaceOptions& options = {}, const Monitor& monitor = {});

}  // namespace lightmill

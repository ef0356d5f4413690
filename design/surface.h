// The refracting surface that realises a transport map: Fresnel mapping and normal integration in turn [paper sec. 5].
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "design/core/monitor.h"
#include "design/mesh.h"
#include "design/optics.h"
#include "design/target.h"
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

/// kCreases: heights everywhere by themselves, all three coordinates in Ceres near creases.
/// kEverywhere: the paper's own, all three coordinates of all vertices in Ceres at once; many times slower.
/// kHeightField: no creases, for comparison: a regular height field, one unknown per vertex.
enum class SurfaceSolver { kCreases, kEverywhere, kHeightField };

struct SurfaceOptions {
  SurfaceSolver solver = SurfaceSolver::kCreases;
  int mesh = 321;                 ///< vertices along the longer side
  SurfaceWeights weights;
  int outer_iterations = 4;       ///< at most this many turns of Fresnel mapping and integration; the first and the last move
                                  ///< heights only, so that vertices slide from 3 turns on
  int picture_turns = 4;          ///< at most this many corrections by the predicted picture, where one is given; 0: none
  double height_tolerance_mm = 2e-5;  ///< stop when no vertex's height changes by more in a turn
  double min_concave_radius_mm = 2;   ///< what a finishing ball can reach: sharper hollows are reported
  bool limit_hollows = false;         ///< and slopes are asked for that make none, creases apart; their light goes astray
};

struct SurfaceSummary {
  int vertices = 0;
  double seconds = 0;
  int outer_iterations = 0;
  std::vector<double> energy_history;     ///< compound energy after each integration
  std::vector<double> picture_errors;     ///< of the predicted picture before any correction, after each: sum of the differences
                                          ///< to the wanted light on about 256 x 256 pixels
  int inverted_triangles = 0;
  int sliding_vertices = 0;               ///< that may move in all coordinates, most of any turn
  int held_back_vertices = 0;             ///< moved back because a turn had folded their triangles, all turns
  int unmapped_vertices = 0;              ///< whose light the base surface loses; they follow their neighbours
  double height_range_mm = 0;             ///< highest minus lowest vertex
  double min_concave_radius_mm = 0;       ///< smallest radius of concave curvature (99.9th percentile of curvature along
                                          ///< edges, off the border); infinite where nothing is concave
  double sharper_area_share = 0;          ///< of the lens, in triangles along whose edges hollows are sharper than
                                          ///< options.min_concave_radius_mm
  double sharper_light_share = 0;         ///< of the light, through them
  double final_height_change_mm = 0;
  std::string reason;
};

struct OpticalSurface {
  SurfaceMesh mesh;                  ///< lens frame; lowest vertex at z = lens.thickness_mm
  std::vector<Vec2> targets_mm;      ///< where each vertex shall send its light on the receiver
  std::vector<Vec2> entry_mm;        ///< x, y of each vertex before any slid: on the start mesh, or drawn to a crease
  SurfaceSummary summary;
};

/// The regular start mesh of a lens (flat, z = thickness): a grid for a rectangle, rings of triangles for a disk; for an
/// outline a grid inside and triangles of similar size along the outline.
SurfaceMesh start_mesh(const Lens& lens, int vertices_along_longer_side);

/// Natural neighbour (Sibson) interpolation of the map at places of the receiver where unbent light arrives, extrapolated
/// at the border of the light [paper fig. 7] and one-sided at creases.
std::vector<Vec2> interpolate_map(const TransportMap& map, const SourceLight& source, const std::vector<Vec2>& points_mm);

/// Where on the receiver the light shall go that would arrive at these places unbent.
using TargetFunction = std::function<std::vector<Vec2>(const std::vector<Vec2>& source_mm)>;

/// `map` is that of trace_source(lens, light, receiver). Throws InputError where no surface can do it, NumericalError when
/// Ceres fails.
OpticalSurface solve_surface(const Lens& lens, const Light& light, const Receiver& receiver, const TransportMap& map,
                             const SurfaceOptions& options = {}, const Monitor& monitor = {});

/// The same, and the light that it predicts is held against `picture`: where that is too bright or too dark, the map is
/// changed a little, as long as that brings the prediction closer.
OpticalSurface solve_surface(const Lens& lens, const Light& light, const Receiver& receiver, const TransportMap& map,
                             const TargetLight& picture, const SurfaceOptions& options = {}, const Monitor& monitor = {});

/// The same from any map (for ground truth and for maps from elsewhere).
OpticalSurface solve_surface(const Lens& lens, const Light& light, const Receiver& receiver, const TargetFunction& target,
                             const SurfaceOptions& options = {}, const Monitor& monitor = {});

}  // namespace lightmill

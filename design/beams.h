// Light through a surface with what a real lamp and lens do to it: any light, wide lamps, losses, colours, a tilted wall.
#pragma once

#include "design/caustic.h"
#include "design/light.h"

namespace lightmill {

struct BeamOptions {
  int pixels = 512;                 ///< along the longer side of the picture
  /// How wide the light is, seen from the middle of the lens's back (the sun: 0.0093): parallel and mesh light come from a
  /// disk of directions, a point light is a disk that faces the lens.
  double angular_diameter_rad = 0;
  int lamp_samples = 64;            ///< places of a wide light, each traced exactly: blur is resolved to its width / sqrt(lamp_samples)
  bool fresnel = false;             ///< losses by reflection at entry and exit, unpolarised light
  bool shadows = true;              ///< light that meets the relief again is lost, not landed
};

/// All light that meets the surface is 1 = landed + outside_extent + totally_reflected + fresnel_reflected + shadowed +
/// enters_by_rim. Beams are the mesh's triangles as in trace_mesh(). What reflects, is shadowed or would have to enter
/// through the lens's side is found ray by ray at the corners; each stands for its third of the triangle's light.
/// Throws InputError for a light that does not shine on the flat back.
Caustic trace_beams(const SurfaceMesh& mesh, const Lens& lens, const Light& light, const Receiver& receiver, const Box2& extent,
                    const BeamOptions& options = {}, const Monitor& monitor = {});

/// Where the ray through each vertex enters the back and lands on the receiver, from the middle of the light.
struct RayEnds {
  Vec2 entry_mm{0, 0};   ///< on z = 0
  Vec2 landed_mm{0, 0};  ///< receiver coordinates
  bool lands = false;    ///< false: no light, totally reflected, or off the receiver's plane
};
std::vector<RayEnds> ray_ends(const SurfaceMesh& mesh, const Lens& lens, const Light& light, const Receiver& receiver);

/// Share of unpolarised light that passes a surface at this cosine of the angle before it; 0 on total reflection.
double fresnel_transmission(double cos_before, const Indices& indices);

/// Index of PMMA at a wavelength in micrometres, 0.436 to 1.052 [Kasarova et al. 2007].
double pmma_index(double wavelength_um);

/// Dominant wavelengths of the sRGB primaries, micrometres: red, green, blue.
inline constexpr double kPrimaryWavelengthsUm[3] = {0.6114, 0.5491, 0.4642};

/// The lens at a wavelength: its index is what the job says at 0.5876 um and differs elsewhere as PMMA's does.
Lens lens_at(const Lens& lens, double wavelength_um);

}  // namespace lightmill

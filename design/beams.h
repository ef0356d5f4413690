// Light through a surface with what a real lamp and lens do to it: slanted, near and wide light, losses, colours, a tilted wall.
#pragma once

#include "design/caustic.h"

namespace lightmill {

/// A lamp before the flat back, lens frame: parallel light, or a small lamp that shines alike in all directions.
struct Lamp {
  enum class Kind { kParallel, kPoint };
  Kind kind = Kind::kParallel;
  Vec3 direction{0, 0, 1};        ///< parallel: where the light goes (z > 0), any length
  Vec3 position_mm{0, 0, -1000};  ///< point: the lamp's centre (z < 0)
  double angular_diameter_rad = 0;  ///< parallel: a disk in the sky (the sun: 0.0093)
  double diameter_mm = 0;           ///< point: a disk that faces the lens's centre
};

/// A plane receiver in the lens frame: picture coordinates (x, y) lie at centre + x right + y up.
struct ReceiverPlane {
  Vec3 centre_mm{0, 0, 310};
  Vec3 right{1, 0, 0};  ///< unit
  Vec3 up{0, 1, 0};     ///< unit, at right angles to `right`; light arrives along right x up, not against it
};

/// `tilt_rad`: turned first about +X, then about +Y, through the centre; `shift_mm` moves the centre in x and y.
ReceiverPlane receiver_plane(const Lens& lens, const Receiver& receiver, const Vec2& tilt_rad = {0, 0}, const Vec2& shift_mm = {0, 0});

struct BeamOptions {
  int pixels = 512;     ///< along the longer side of the picture
  /// Places (or directions) of an extended lamp, each traced exactly: blur is resolved to lamp diameter / sqrt(lamp_samples).
  int lamp_samples = 64;
  bool fresnel = false; ///< losses by reflection at entry and exit, unpolarised light
  bool shadows = true;  ///< light that meets the relief again is lost, not landed
};

/// All light through the surface is 1 = landed + outside_extent + totally_reflected + fresnel_reflected + shadowed + through_rim.
/// Beams are the mesh's triangles as in trace_mesh(). What reflects, is shadowed or would have to enter through the lens's
/// side is found ray by ray at the corners; each stands for a third of its triangle's light.
/// Throws InputError for a lamp that does not shine on the flat back.
Caustic trace_beams(const SurfaceMesh& mesh, const Lens& lens, const Lamp& lamp, const ReceiverPlane& receiver, const Box2& extent,
                    const BeamOptions& options = {}, const Monitor& monitor = {});

/// Share of unpolarised light that passes a surface at this cosine of the angle before it; 0 on total reflection.
double fresnel_transmission(double cos_before, const Indices& indices);

/// Index of PMMA at a wavelength in micrometres, 0.436 to 1.052 [Kasarova et al. 2007].
double pmma_index(double wavelength_um);

/// Dominant wavelengths of the sRGB primaries, micrometres: red, green, blue.
inline constexpr double kPrimaryWavelengthsUm[3] = {0.6114, 0.5491, 0.4642};

/// The lens at a wavelength: its index is what the job says at 0.5876 um and differs elsewhere as PMMA's does.
Lens lens_at(const Lens& lens, double wavelength_um);

}  // namespace lightmill

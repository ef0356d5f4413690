// Light that the cusps of even passes send aside: they are a phase grating.
#pragma once

#include <vector>

namespace lightmill {

struct CuspGrating {
  double period_mm = 0;       ///< stepover
  double cusp_um = 0;         ///< peak to valley, as milled
  double polish_sigma_um = 0; ///< Gaussian low-pass of the heights
  double refractive_index = 1.49;
  double distance_mm = 300;   ///< to the wall
  double wavelength_um = 0.55;
};

struct DiffractionOrder {
  int order = 0;         ///< the same to either side
  double offset_mm = 0;  ///< on the wall, across the passes
  double share = 0;      ///< of the light, in each of the two (order 0: in all)
};

struct CuspDiffraction {
  double phase_rad = 0;         ///< amplitude of the phase
  double order_spacing_mm = 0;
  double rms_mm = 0;            ///< of the light's offsets
  std::vector<DiffractionOrder> orders;  ///< until 99.9 % of the light is told
};

/// Scalar theory for a thin grating: the fundamental of the cusps' parabolas, 4 / pi^2 of their height, damped by the
/// polish; order m gets J_m(phase)^2 at m wavelength distance / period. Throws InputError for a period or wavelength that
/// is not above 0.
CuspDiffraction cusp_diffraction(const CuspGrating& grating);

}  // namespace lightmill

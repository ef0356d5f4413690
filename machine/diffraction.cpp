#include "machine/diffraction.h"

#include <cmath>

#include "design/core/errors.h"
#include "design/core/geometry.h"
#include "design/core/text.h"

namespace lightmill {

namespace {
constexpr double kTold = 0.999;
constexpr int kMostOrders = 1000;
}  // namespace

CuspDiffraction cusp_diffraction(const CuspGrating& grating) {
  if (!(grating.period_mm > 0)) throw InputError("the cusps' period must be above 0, not " + compact(grating.period_mm, 6) + " mm");
  if (!(grating.wavelength_um > 0)) throw InputError("the wavelength must be above 0, not " + compact(grating.wavelength_um, 6) + " um");
  const double smoothing = kPi * grating.polish_sigma_um / (grating.period_mm * 1000);
  const double amplitude_um = 4 / (kPi * kPi) * grating.cusp_um * std::exp(-2 * smoothing * smoothing);
  CuspDiffraction result;
  result.phase_rad = 2 * kPi * (grating.refractive_index - 1) * amplitude_um / grating.wavelength_um;
  result.order_spacing_mm = grating.wavelength_um / 1000 * grating.distance_mm / grating.period_mm;
  // sum of m^2 J_m^2 over all orders is phase^2 / 2.
  result.rms_mm = result.order_spacing_mm * result.phase_rad / std::sqrt(2.0);
  double told = 0;
  for (int m = 0; m < kMostOrders && told < kTold; ++m) {
    const double bessel = std::cyl_bessel_j(static_cast<double>(m), result.phase_rad);
    result.orders.push_back({m, m * result.order_spacing_mm, bessel * bessel});
    told += (m == 0 ? 1 : 2) * bessel * bessel;
  }
  return result;
}

}  // namespace lightmill

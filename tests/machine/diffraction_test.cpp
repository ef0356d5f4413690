#include "machine/diffraction.h"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>

#include "design/core/errors.h"
#include "design/core/geometry.h"

namespace lightmill {
namespace {

// The orders of exp(i phase cos t) by quadrature over a period, and their sum.
TEST(CuspDiffraction, OrdersAreTheFourierCoefficientsOfThePhase) {
  for (const double cusp : {0.05, 0.5, 1.5, 6.0}) {
    const CuspDiffraction d = cusp_diffraction({.period_mm = 0.155, .cusp_um = cusp});
    EXPECT_NEAR(d.phase_rad, 2 * kPi * 0.49 * 4 / (kPi * kPi) * cusp / 0.55, 1e-12);
    EXPECT_NEAR(d.order_spacing_mm, 0.55e-3 * 300 / 0.155, 1e-12);
    double told = 0;
    for (const DiffractionOrder& order : d.orders) {
      std::complex<double> sum = 0;
      constexpr int kSamples = 4096;
      for (int k = 0; k < kSamples; ++k) {
        const double t = 2 * kPi * k / kSamples;
        sum += std::polar(1.0 / kSamples, d.phase_rad * std::cos(t) - order.order * t);
      }
      EXPECT_NEAR(order.share, std::norm(sum), 1e-12) << cusp << " order " << order.order;
      EXPECT_NEAR(order.offset_mm, order.order * d.order_spacing_mm, 1e-12);
      told += (order.order == 0 ? 1 : 2) * order.share;
    }
    EXPECT_GT(told, 0.999);
    EXPECT_LE(told, 1 + 1e-12);
  }
}

// Many orders spread the light as rays do: rms slope of the sine, refracted, over the distance.
TEST(CuspDiffraction, SpreadsAsGeometricalOpticsDoes) {
  const CuspDiffraction d = cusp_diffraction({.period_mm = 0.2, .cusp_um = 4});
  const double slope = 2 * kPi / 0.2 * (4 / (kPi * kPi) * 0.004) / std::sqrt(2.0);
  EXPECT_NEAR(d.rms_mm, 300 * 0.49 * slope, 1e-9);
  double squares = 0;
  for (const DiffractionOrder& order : d.orders) squares += 2 * order.share * order.offset_mm * order.offset_mm;
  EXPECT_NEAR(std::sqrt(squares), d.rms_mm, 0.02 * d.rms_mm);
}

TEST(CuspDiffraction, PolishPutsTheLightBackIntoOrderZero) {
  const CuspGrating raw{.period_mm = 0.155, .cusp_um = 1.5};
  CuspGrating polished = raw;
  polished.polish_sigma_um = 100;
  EXPECT_LT(cusp_diffraction(raw).orders[0].share, 0.5);
  EXPECT_GT(cusp_diffraction(polished).orders[0].share, 0.999);
  EXPECT_EQ(cusp_diffraction({.period_mm = 0.155, .cusp_um = 0}).orders[0].share, 1);
  EXPECT_THROW(cusp_diffraction({.period_mm = 0}), InputError);
}

}  // namespace
}  // namespace lightmill

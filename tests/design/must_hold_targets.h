// The targets on which the transport's error bounds must hold, for tests and benchmarks.
#pragma once

#include <unistd.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <string>

#include "design/target.h"

namespace lightmill::test {

inline constexpr std::array kMustHold{
    "photo", "rings", "strokes", "strokes_over_photo", "disks", "point_in_the_dark", "gradient_16_bit"};

/// A closed network: three Lissajous strokes of different weight on black.
inline TargetLight network_of_strokes() {
  TargetLight target;
  target.extent = Box2::centred({100, 100});
  for (int k = 0; k < 3; ++k) {
    CurveLight curve;
    for (int i = 0; i <= 600; ++i) {
      const double t = 2 * kPi * i / 600;
      curve.vertices_mm.emplace_back(42 * std::sin((k + 1) * t + 0.4), 42 * std::sin((k + 2) * t + 0.9 * k));
      curve.density_per_mm.push_back(1 + 0.5 * k);
    }
    target.curves.push_back(curve);
  }
  target.normalise();
  return target;
}

/// Two thirds of the light in a point, the rest in a field that fades to true black.
inline TargetLight point_in_the_dark() {
  TargetLight target;
  target.extent = Box2::centred({100, 100});
  target.area_flux = Grid<double>(64, 64);
  for (int row = 0; row < 64; ++row) {
    for (int column = 0; column < 64; ++column)
      target.area_flux.at(column, row) = std::max(0.0, std::sin(0.09 * column + 0.05 * row)) / 1400;
  }
  const double field = target.area_total();
  target.points = {{{21.3, -8.9}, 2 * field}};
  target.normalise();
  return target;
}

/// A 16-bit file from black to white, read as a job's picture is.
inline TargetLight gradient_16_bit() {
  const auto file = std::filesystem::temp_directory_path() / ("gradient_" + std::to_string(getpid()) + ".png");
  Grid<float> gradient(1024, 32);
  for (int row = 0; row < gradient.height; ++row) {
    for (int column = 0; column < gradient.width; ++column)
      gradient.at(column, row) = static_cast<float>(column) / 1023.0F;
  }
  write_png16(file, gradient);
  TargetSpec spec;
  spec.image = file;
  const TargetLight target = load_target(spec);
  std::filesystem::remove(file);
  return target;
}

inline TargetLight must_hold_target(const std::string& name) {
  if (name == "strokes") return network_of_strokes();
  if (name == "point_in_the_dark") return point_in_the_dark();
  if (name == "gradient_16_bit") return gradient_16_bit();
  const std::string pictures = LIGHTMILL_FIXTURES "/pictures/";
  TargetSpec spec;
  if (name == "photo" || name == "strokes_over_photo") spec.image = pictures + "astronaut.png";
  if (name == "strokes_over_photo") spec.drawing = pictures + "signature.svg";
  if (name == "rings" || name == "disks") spec.drawing = pictures + name + ".svg";
  return load_target(spec);
}

}  // namespace lightmill::test

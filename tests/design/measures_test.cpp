// The measures of DESIGN.md against a second, plain implementation that works in the reader's coordinates of picture and wall.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <random>
#include <vector>

#include "design/caustic.h"
#include "design/core/image.h"

namespace lightmill {
namespace {

constexpr int kCells = 256;

/// Light by column from the reader's left and row from the top, some cells around the picture included.
struct Cells {
  static constexpr int kAround = 4;
  std::vector<double> light = std::vector<double>((kCells + 2 * kAround) * (kCells + 2 * kAround));
  double ignored = 0;
  double& operator()(int c, int r) {
    const int side = kCells + 2 * kAround;
    c += kAround;
    r += kAround;
    return c < 0 || r < 0 || c >= side || r >= side ? ignored : light[r * side + c];
  }
};

/// Shares a rectangle's light out over cells by the areas that overlap. Reader's millimetres: u to the right, v down.
void share(Cells& cells, const Vec2& from, const Vec2& to, double light, const Vec2& picture) {
  const Vec2 cell = picture / kCells;
  const auto index = [&](double mm, int axis) { return static_cast<int>(std::floor((mm + picture[axis] / 2) / cell[axis])); };
  const double area = (to - from).prod();
  for (int r = index(from.y(), 1); r <= index(to.y(), 1); ++r) {
    for (int c = index(from.x(), 0); c <= index(to.x(), 0); ++c) {
      const Vec2 low = Vec2(c, r).cwiseProduct(cell) - picture / 2;
      const Vec2 overlap = (to.cwiseMin(low + cell) - from.cwiseMax(low)).cwiseMax(0.0);
      cells(c, r) += light * overlap.prod() / area;
    }
  }
}

CausticMeasures plainly(const Grid<float>& picture_file, const Vec2& size, const Caustic& caustic, ViewedFrom viewed_from) {
  Cells wanted, light;
  double all = 0;
  for (const float f : picture_file.values) all += f;
  const Vec2 pixel = size.cwiseQuotient(Vec2(picture_file.width, picture_file.height));
  for (int row = 0; row < picture_file.height; ++row) {
    for (int column = 0; column < picture_file.width; ++column) {
      const Vec2 from = Vec2(column, row).cwiseProduct(pixel) - size / 2;
      if (picture_file.at(column, row) > 0) share(wanted, from, from + pixel, picture_file.at(column, row) / all, size);
    }
  }
  const Vec2 step = caustic.extent.size().cwiseQuotient(Vec2(caustic.flux.width, caustic.flux.height));
  for (int j = 0; j < caustic.flux.height; ++j) {
    for (int i = 0; i < caustic.flux.width; ++i) {
      const Vec2 at = caustic.extent.min + step.cwiseProduct(Vec2(i, j));
      // Who stands at the lens and looks along +Z has +X on the left; the wall's other side has it on the right.
      const double u = viewed_from == ViewedFrom::kLens ? -(at.x() + step.x()) : at.x();
      const Vec2 from(u, -(at.y() + step.y()));
      share(light, from, from + step, caustic.flux.at(i, j), size);
    }
  }
  CausticMeasures m;
  const double cells = kCells * kCells;
  constexpr double kRounding = 1e-15;  // areas of pixels that only touch a cell
  double squares = 0, peak = 0, within = 0;
  for (int r = 0; r < kCells; ++r) {
    for (int c = 0; c < kCells; ++c) {
      const double difference = cells * (light(c, r) - wanted(c, r));
      m.l1_error += std::abs(difference) / cells;
      squares += difference * difference / cells;
      peak = std::max(peak, cells * wanted(c, r));
    }
  }
  m.psnr_db = 10 * std::log10(peak * peak / squares);
  for (int r = -2; r < kCells + 2; ++r) {
    for (int c = -2; c < kCells + 2; ++c) {
      bool supported = false;
      for (const auto& [dr, dc] : {std::pair(0, 0), {0, 1}, {0, 2}, {1, 0}, {1, 1}, {2, 0}, {0, -1}, {0, -2}, {-1, 0}, {-1, -1}, {-2, 0}, {1, -1}, {-1, 1}}) {
        supported |= wanted(c + dc, r + dr) > kRounding;
      }
      if (supported) within += light(c, r);
    }
  }
  m.flux_outside_support = 1 - caustic.totally_reflected - within;
  m.flux_totally_reflected = caustic.totally_reflected;
  return m;
}

TEST(Measures, AreWhatAPlainReaderFinds) {
  const auto file = std::filesystem::temp_directory_path() / ("measures_" + std::to_string(getpid()) + ".png");
  std::mt19937 random(11);
  std::uniform_real_distribution<double> any(0, 1);
  for (const Vec2& size : {Vec2(40, 30), Vec2(18, 47)}) {
    // Mostly black, so that there is light beside the motif; touching one border, so that the grown support sticks out.
    Grid<float> picture(37, 23);
    for (int row = 0; row < 23; ++row) {
      for (int column = 0; column < 37; ++column) {
        const double code = column < 9 || (row + column) % 7 == 0 ? std::round(any(random) * 65535) / 65535 : 0;
        picture.at(column, row) = static_cast<float>(code);
      }
    }
    write_png16(file, picture);
    for (const ViewedFrom viewed_from : {ViewedFrom::kLens, ViewedFrom::kBehind}) {
      TargetSpec spec;
      spec.image = file;
      spec.size_mm = size;
      spec.viewed_from = viewed_from;
      const TargetLight target = load_target(spec);
      // Light on another grid over a larger, lopsided part of the wall; some is lost inside the lens, some beside it all.
      Caustic caustic;
      caustic.extent = {-0.61 * size, 0.55 * size};
      caustic.flux = Grid<double>(61, 83);
      double all = 0;
      for (double& f : caustic.flux.values) all += f = any(random) * any(random);
      for (double& f : caustic.flux.values) f *= 0.87 / all;
      caustic.totally_reflected = 0.05;
      caustic.outside_extent = 0.08;
      const CausticMeasures ours = measure_caustic(caustic, target);
      const CausticMeasures plain = plainly(picture, size, caustic, viewed_from);
      EXPECT_NEAR(ours.l1_error, plain.l1_error, 1e-6);
      EXPECT_NEAR(ours.psnr_db, plain.psnr_db, 1e-4);
      EXPECT_NEAR(ours.flux_outside_support, plain.flux_outside_support, 1e-6);
      EXPECT_EQ(ours.flux_totally_reflected, plain.flux_totally_reflected);
      // The other way round the picture is another.
      const ViewedFrom other = viewed_from == ViewedFrom::kLens ? ViewedFrom::kBehind : ViewedFrom::kLens;
      EXPECT_GT(std::abs(plainly(picture, size, caustic, other).l1_error - plain.l1_error), 1e-4);
    }
  }
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace lightmill

#include "design/detail/picture_loop.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace lightmill::detail {
namespace {

constexpr double kWidth = 40, kHeight = 30;

/// Even light on a grid of vertices, and a target a little brighter here and there: 1 + amplitude cos(3 pi x / width).
struct Waves {
  std::vector<Vec2> places;
  std::vector<std::array<int, 3>> triangles;
  std::vector<double> flux;
  TargetLight target;

  explicit Waves(double amplitude) {
    constexpr int kColumns = 80, kRows = 60;
    for (int j = 0; j <= kRows; ++j) {
      for (int i = 0; i <= kColumns; ++i) places.emplace_back(-kWidth / 2 + kWidth * i / kColumns, -kHeight / 2 + kHeight * j / kRows);
    }
    for (int j = 0; j < kRows; ++j) {
      for (int i = 0; i < kColumns; ++i) {
        const int a = j * (kColumns + 1) + i, d = a + kColumns + 1;
        triangles.push_back({a, a + 1, d + 1});
        triangles.push_back({a, d + 1, d});
      }
    }
    flux.assign(triangles.size(), 1.0 / static_cast<double>(triangles.size()));
    target.extent = Box2::centred({kWidth, kHeight});
    target.area_flux = Grid<double>(160, 120);
    for (int j = 0; j < 120; ++j) {
      for (int i = 0; i < 160; ++i) target.area_flux.at(i, j) = 1 + amplitude * std::cos(3 * kPi * (i + 0.5) / 160);
    }
    target.normalise();
  }
};

TEST(PictureLoop, MovesLightAsTheLinearisedMapDoes) {
  // From even to 1 + a cos(kx) light moves by -(a / k) sin(kx), x from the left border.
  constexpr double kAmplitude = 0.05;
  const Waves waves(kAmplitude);
  const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, waves.places, Creases{}, Seams::kJoined);
  const auto errors = loop.errors(waves.places);
  EXPECT_NEAR(errors.sum, 2 / kPi * kAmplitude, 1e-3);
  const std::vector<Vec2> moves = loop.moves(errors, waves.places);
  const double k = 3 * kPi / kWidth;
  for (std::size_t v = 0; v < moves.size(); ++v) {
    const double wanted = -kAmplitude / k * std::sin(k * (waves.places[v].x() + kWidth / 2));
    EXPECT_NEAR(moves[v].x(), wanted, 0.07 * kAmplitude / k) << waves.places[v].transpose();
    EXPECT_NEAR(moves[v].y(), 0, 0.02 * kAmplitude / k);
  }
}

TEST(PictureLoop, ConvergesLikeNewton) {
  const Waves waves(0.3);
  const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, waves.places, Creases{}, Seams::kJoined);
  std::vector<Vec2> landed = waves.places;
  std::vector<double> sums;
  for (int turn = 0; turn < 4; ++turn) {
    const auto errors = loop.errors(landed);
    sums.push_back(errors.sum);
    const auto moves = loop.moves(errors, landed);
    for (std::size_t v = 0; v < landed.size(); ++v) landed[v] += moves[v];
  }
  EXPECT_NEAR(sums[0], 2 / kPi * 0.3, 2e-3);
  EXPECT_LT(sums[3], 0.1 * sums[0]);
}

TEST(PictureLoop, JoinedSeamsOfASmoothMapAreNone) {
  const Waves waves(0.05);
  Creases creases;
  for (int j = 0; j < 60; ++j) creases.shares[Creases::key(81 * j + 40, 81 * j + 41)] = 0.5;  // the middle column, torn
  const auto moves_with = [&](const Creases& torn, Seams seams) {
    const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, waves.places, torn, seams);
    return loop.moves(loop.errors(waves.places), waves.places);
  };
  const std::vector<Vec2> smooth = moves_with({}, Seams::kJoined);
  const std::vector<Vec2> joined = moves_with(creases, Seams::kJoined);
  const std::vector<Vec2> parted = moves_with(creases, Seams::kParted);
  double largest = 0, of_joined = 0, of_parted = 0;
  for (std::size_t v = 0; v < smooth.size(); ++v) {
    largest = std::max(largest, smooth[v].norm());
    of_joined = std::max(of_joined, (joined[v] - smooth[v]).norm());
    of_parted = std::max(of_parted, (parted[v] - smooth[v]).norm());
  }
  EXPECT_LT(of_joined, 0.15 * largest);
  EXPECT_GT(of_parted, 0.5 * largest);
}

TEST(PictureLoop, AsksForNothingBesideCurves) {
  Waves waves(0);
  // All that is wrong is beside a curve across the middle.
  waves.target.curves.push_back({{{-5, 1}, {5, 1}}, {0.02, 0.02}});
  const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, waves.places, Creases{}, Seams::kJoined);
  const auto errors = loop.errors(waves.places);
  EXPECT_GT(errors.sum, 0.1);
  for (const double missing : errors.missing.values) EXPECT_LT(std::abs(missing), 1e-12);
}

TEST(PictureLoop, AsksNobodyToTakeBackWhatOthersSpill) {
  // A dark half; triangles across a crease throw their light there.
  Waves waves(0);
  for (int j = 0; j < 120; ++j) {
    for (int i = 80; i < 160; ++i) waves.target.area_flux.at(i, j) = 0;
  }
  waves.target.normalise();
  Creases creases;
  std::vector<Vec2> landed = waves.places;
  for (Vec2& p : landed) p.x() = p.x() / 2 - kWidth / 4;
  for (std::size_t v = 0; v < waves.places.size(); ++v) {
    const int n = static_cast<int>(v) + 1;
    if (std::abs(waves.places[v].x()) > 0.1) continue;
    creases.shares.emplace(Creases::key(n - 1, n), 0.5);
    landed[v].x() = kWidth / 4;
  }
  const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, landed, creases, Seams::kParted);
  const auto errors = loop.errors(landed);
  EXPECT_GT(errors.sum, 0.02);
  double sum = 0;
  for (int j = 0; j < errors.missing.height; ++j) {
    for (int i = 0; i < errors.missing.width; ++i) {
      sum += errors.missing.at(i, j);
      if (i > 30) {
        EXPECT_EQ(errors.missing.at(i, j), 0) << i << " " << j;
      }
    }
  }
  EXPECT_NEAR(sum, 0, 1e-12);
}

TEST(PictureLoop, LightForACurveStaysAndTheLightBesideItDoesNotSlideAlong) {
  constexpr double kAmplitude = 0.05;
  Waves waves(kAmplitude);
  waves.target.curves.push_back({{{-kWidth / 2, 1}, {kWidth / 2, 1}}, {1e-3, 1e-3}});
  const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, waves.places, Creases{}, Seams::kJoined);
  const std::vector<Vec2> moves = loop.moves(loop.errors(waves.places), waves.places);
  const double typical = kAmplitude / (3 * kPi / kWidth);
  double farthest = 0;
  for (std::size_t v = 0; v < moves.size(); ++v) {
    const double beside = std::abs(waves.places[v].y() - 0.5);  // the curve is in one row of pixels, and three each way are its own
    if (beside < 3) {
      EXPECT_LT(moves[v].norm(), 0.01 * typical) << waves.places[v].transpose();
    }
    if (beside < 4.6) {
      EXPECT_LT(std::abs(moves[v].x()), 0.4 * typical) << waves.places[v].transpose();
    }
    farthest = std::max(farthest, std::abs(moves[v].x()));
  }
  EXPECT_GT(farthest, 0.7 * typical);
}

TEST(PictureLoop, MovesNothingAcrossACrease) {
  const Waves waves(0.05);
  Creases creases;
  for (const auto& t : waves.triangles) {
    for (int k = 0; k < 3; ++k) {
      const int a = t[k], b = t[(k + 1) % 3];
      if ((waves.places[a].x() < 0.1) != (waves.places[b].x() < 0.1)) creases.shares.emplace(Creases::key(a, b), 0.5);
    }
  }
  const PictureLoop loop(waves.target, 40, waves.triangles, waves.flux, waves.places, waves.places, creases, Seams::kParted);
  const std::vector<Vec2> moves = loop.moves(loop.errors(waves.places), waves.places);
  // The crease is a border: light stays on its side, so that nothing moves beside it. (Without it: a / k = 0.2 mm.)
  for (std::size_t v = 0; v < moves.size(); ++v) {
    if (std::abs(waves.places[v].x() - 0.25) < 0.3) {
      EXPECT_LT(std::abs(moves[v].x()), 0.06);
    }
  }
}

}  // namespace
}  // namespace lightmill::detail

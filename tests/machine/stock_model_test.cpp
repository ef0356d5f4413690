#include "machine/stock_model.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <random>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

using Path = std::vector<ToolPose>;

Cutter ball(double diameter) {
  Cutter cutter;
  cutter.name = "ball";
  cutter.number = 2;
  cutter.diameter_mm = diameter;
  cutter.corner_radius_mm = diameter / 2;
  cutter.flute_length_mm = 2.5 * diameter;
  cutter.shank_diameter_mm = diameter;
  cutter.length_mm = 12 * diameter;
  return cutter;
}

Cutter mill(double diameter, double corner) {
  Cutter cutter = ball(diameter);
  cutter.name = "mill";
  cutter.corner_radius_mm = corner;
  return cutter;
}

Vec3 leaning(double degrees, double direction_degrees) {
  const double t = degrees * kPi / 180;
  const double d = direction_degrees * kPi / 180;
  return {std::sin(t) * std::cos(d), std::sin(t) * std::sin(d), std::cos(t)};
}

/// A pose whose ball has its centre there.
ToolPose pose_of_centre(const Vec3& centre, double radius, const Vec3& axis = Vec3::UnitZ()) {
  return {centre - radius * axis, axis};
}

void feed(StockModel& model, const Path& path, long first_line = 1, bool spindle_on = true) {
  for (std::size_t k = 1; k < path.size(); ++k) {
    SweptMove move;
    move.line = first_line + static_cast<long>(k) - 1;
    move.from = path[k - 1];
    move.to = path[k];
    move.spindle_on = spindle_on;
    model.move(move);
  }
}

void rapid(StockModel& model, const ToolPose& from, const ToolPose& to, long line, bool spindle_on = true) {
  SweptMove move;
  move.line = line;
  move.from = from;
  move.to = to;
  move.rapid = true;
  move.spindle_on = spindle_on;
  model.move(move);
}

MachinedSurface cut(const Blank& blank, double pitch, const Cutter& cutter, const Path& path) {
  StockModel model(blank, {pitch, 0});
  model.set_cutter(cutter);
  feed(model, path);
  model.flush();
  return model.surface();
}

double largest_difference(const Grid<float>& a, const Grid<float>& b) {
  EXPECT_EQ(a.width, b.width);
  EXPECT_EQ(a.height, b.height);
  double most = 0;
  for (std::size_t k = 0; k < a.values.size(); ++k) most = std::max<double>(most, std::abs(a.values[k] - b.values[k]));
  return most;
}

/// The lowest height of any cutter shape along a path by dense search: `bottom(rho)` is its profile, vertical axis.
template <typename Bottom>
double searched(const Path& path, double x, double y, double radius, Bottom&& bottom) {
  double lowest = 1e9;
  for (std::size_t k = 1; k < path.size(); ++k) {
    const Vec3 a = path[k - 1].tip_mm;
    const Vec3 d = path[k].tip_mm - a;
    const auto at = [&](double t) {
      const Vec3 tip = a + t * d;
      const double rho = std::hypot(x - tip.x(), y - tip.y());
      return rho > radius ? 1e9 : tip.z() + bottom(rho);
    };
    int best = 0;
    constexpr int kSteps = 100;
    for (int i = 1; i <= kSteps; ++i) {
      if (at(i / double(kSteps)) < at(best / double(kSteps))) best = i;
    }
    double low = std::max(0, best - 1) / double(kSteps);
    double high = std::min(kSteps, best + 1) / double(kSteps);
    lowest = std::min(lowest, at(best / double(kSteps)));
    for (int i = 0; i < 60; ++i) {
      const double m1 = low + (high - low) * 0.382;
      const double m2 = low + (high - low) * 0.618;
      (at(m1) < at(m2) ? high : low) = at(m1) < at(m2) ? m2 : m1;
    }
    lowest = std::min(lowest, at((low + high) / 2));
  }
  return lowest;
}

TEST(StockModel, TakesTheVolumeOfASlotFromTheBlock) {
  // A ball of radius 2 sunk 1.2 deep all across a 12 mm block: a circular segment times 12.
  const Blank blank{{12, 8}, 6};
  const double depth = 1.2;
  const double r = 2;
  const MachinedSurface surface = cut(
      blank, 0.02, ball(4), {pose_of_centre({-9, 0.4, 6 - depth + r}, r), pose_of_centre({9, 0.4, 6 - depth + r}, r)});
  const double segment = r * r * std::acos((r - depth) / r) - (r - depth) * std::sqrt(2 * r * depth - depth * depth);
  EXPECT_NEAR(surface.removed_mm3 / (segment * 12), 1, 2e-4);
  // A flat end mill 6 mm wide, 2 deep, over half the block, its round end included.
  const MachinedSurface flat = cut(blank, 0.02, mill(6, 0), {{{-9, 0, 4}, Vec3::UnitZ()}, {{1, 0, 4}, Vec3::UnitZ()}});
  // Its walls are upright: each is off by up to half a pitch.
  EXPECT_NEAR(flat.removed_mm3 / (2 * (7 * 6 + kPi * 9 / 2)), 1, 0.02 / 6);
}

TEST(StockModel, ScallopsOfParallelPassesHaveTheirClosedFormHeight) {
  const double r = 2;
  const double floor = 3;
  for (const double stepover : {0.155, 0.1234}) {
    Path path;
    for (int k = -20; k <= 20; ++k) {
      const double y = k * stepover + 0.0037;
      // There and back again in air at the ends.
      path.push_back(pose_of_centre({k % 2 == 0 ? -6.0 : 6.0, y, floor + r}, r));
      path.push_back(pose_of_centre({k % 2 == 0 ? 6.0 : -6.0, y, floor + r}, r));
    }
    const MachinedSurface surface = cut({{4, 3}, 5}, 0.02, ball(4), path);
    const double cusp = r - std::sqrt(r * r - stepover * stepover / 4);
    double highest_peak = 0;
    double highest_node = 0;
    double lowest_row_peak = 1e9;
    for (int j = 0; j < surface.heights_mm.height; ++j) {
      for (int i = 0; i < surface.heights_mm.width; ++i) {
        highest_peak = std::max<double>(highest_peak, surface.peaks_mm.at(i, j) - floor);
        highest_node = std::max<double>(highest_node, surface.heights_mm.at(i, j) - floor);
        EXPECT_GE(surface.peaks_mm.at(i, j), surface.heights_mm.at(i, j));
      }
    }
    EXPECT_NEAR(highest_peak, cusp, 3e-6) << stepover;
    EXPECT_LE(highest_node, cusp + 1e-6);
    // Every single ridge is found at its height, although nodes may miss each by up to half a pitch times its slope.
    double largest_miss = 0;
    for (int k = -8; k < 8; ++k) {
      const double ridge = (k + 0.5) * stepover + 0.0037;
      double peak = 0;
      double node = 0;
      for (int j = 0; j < surface.heights_mm.height; ++j) {
        const double y = surface.extent.min.y() + surface.pitch_mm * j;
        if (std::abs(y - ridge) > 0.03) continue;
        peak = std::max<double>(peak, surface.peaks_mm.at(77, j) - floor);
        node = std::max<double>(node, surface.heights_mm.at(77, j) - floor);
      }
      EXPECT_NEAR(peak, cusp, 3e-6) << "ridge " << k;
      lowest_row_peak = std::min(lowest_row_peak, peak);
      largest_miss = std::max(largest_miss, cusp - node);
    }
    // Nodes alone under-read; if they did not, the peaks would prove nothing here.
    if (stepover == 0.155) {
      EXPECT_GT(largest_miss, 2e-4);
    }
  }
}

TEST(StockModel, ScallopsOnASlopeKeepTheirHeightAlongItsNormal) {
  // Passes along x on a plane that climbs in y by 20 degrees and in x by 10: seen along its normal it is a flat one.
  const double r = 2;
  const double slope_x = std::tan(10 * kPi / 180);
  const double slope_y = std::tan(20 * kPi / 180);
  const Vec3 normal = Vec3(-slope_x, -slope_y, 1).normalized();
  const auto plane = [&](double x, double y) { return 4 + slope_x * x + slope_y * y; };
  const double step_y = 0.13;
  Path path;
  for (int k = -30; k <= 30; ++k) {
    const double y = k * step_y + 0.004;
    const bool forth = k % 2 == 0;
    for (int part = 0; part <= 40; ++part) {
      const double x = (forth ? -1 : 1) * (-4 + 0.2 * part);
      path.push_back(pose_of_centre(Vec3(x, y, plane(x, y)) + r * normal, r));
    }
  }
  const MachinedSurface surface = cut({{4, 3}, 8}, 0.02, ball(4), path);
  // Distance between neighbouring lines of centres in space.
  const Vec3 along = Vec3(1, 0, slope_x).normalized();
  const Vec3 across = Vec3(0, step_y, slope_y * step_y);
  const double stepover = (across - across.dot(along) * along).norm();
  const double cusp_vertical = (r - std::sqrt(r * r - stepover * stepover / 4)) / normal.z();
  double highest = 0;
  for (int j = 5; j < surface.heights_mm.height - 5; ++j) {
    for (int i = 5; i < surface.heights_mm.width - 5; ++i) {
      const double x = surface.extent.min.x() + surface.pitch_mm * i;
      const double y = surface.extent.min.y() + surface.pitch_mm * j;
      EXPECT_GT(surface.heights_mm.at(i, j), plane(x, y) - 1e-5);
      const Vec2 place = surface.peak_place_mm(i, j);
      highest = std::max(highest, surface.peaks_mm.at(i, j) - plane(place.x(), place.y()));
    }
  }
  EXPECT_NEAR(highest, cusp_vertical, 3e-6);
}

TEST(StockModel, ScallopsOnACapFollowItsCurvature) {
  // A convex cap of radius 40 with passes along x whose centres lie on the sphere of radius 42 at equal steps in y. At
  // the ridge between two passes at y = +-s/2 on the meridian: centres at 42 (0, +-sin a, cos a).
  const double r = 2;
  const double big = 40;
  const double top = 6;
  const double step = 0.14;
  Path path;
  for (int k = -12; k <= 11; ++k) {
    const double y = (k + 0.5) * step;
    for (int part = 0; part <= 400; ++part) {
      const double x = (k % 2 == 0 ? 1 : -1) * (-4 + 0.02 * part);
      path.push_back(pose_of_centre({x, y, top - big + std::sqrt((big + r) * (big + r) - x * x - y * y)}, r));
    }
  }
  const MachinedSurface surface = cut({{4, 2}, 7}, 0.02, ball(4), path);
  const double sine = step / 2 / (big + r);
  const double expected = (big + r) * std::sqrt(1 - sine * sine) - std::sqrt(r * r - step * step / 4) - big;
  const int i = (surface.peaks_mm.width - 1) / 2;
  double peak = -1;
  for (int j = 0; j < surface.peaks_mm.height; ++j) {
    const double y = surface.node_place_mm(i, j).y();
    if (std::abs(y) < 0.03) peak = std::max<double>(peak, surface.peaks_mm.at(i, j) - top);
  }
  EXPECT_NEAR(peak, expected, 3e-6);
  // And everywhere: peaks above the cap are between zero and that of the widest step on it.
  double highest = 0;
  for (int j = 3; j < surface.peaks_mm.height - 3; ++j) {
    for (int k = 3; k < surface.peaks_mm.width - 3; ++k) {
      const auto cap = [&](const Vec2& p) { return top - big + std::sqrt(big * big - p.squaredNorm()); };
      EXPECT_GT(surface.heights_mm.at(k, j), cap(surface.node_place_mm(k, j)) - 2e-6);
      highest = std::max(highest, surface.peaks_mm.at(k, j) - cap(surface.peak_place_mm(k, j)));
    }
  }
  EXPECT_LT(highest, expected * 1.01 + 2e-5);
}

TEST(StockModel, PeaksOnAWavySurfaceEqualADenseSearch) {
  // Faceted passes over strong waves; the truth is the envelope searched densely between the nodes.
  const double r = 2;
  const auto design = [](double x, double y) {
    return 3 + 0.25 * std::sin(0.9 * x + 0.4) * std::cos(0.8 * y) + 0.3 * x - 0.2 * y;
  };
  const auto slope = [&](double x, double y) {
    const double e = 1e-5;
    return Vec2((design(x + e, y) - design(x - e, y)) / (2 * e), (design(x, y + e) - design(x, y - e)) / (2 * e));
  };
  Path path;
  std::vector<std::pair<Vec3, Vec3>> near;  // motions of the centre that matter to the little block
  for (int k = -12; k <= 12; ++k) {
    Path pass;
    for (int part = 0; part <= 34; ++part) {
      const double x = -2.5 + 0.15 * part + 0.004 * k;
      const double y = 0.135 * k + 0.011;
      const Vec2 g = slope(x, y);
      pass.push_back(pose_of_centre(Vec3(x, y, design(x, y)) + r * Vec3(-g.x(), -g.y(), 1).normalized(), r));
    }
    for (std::size_t n = 1; n < pass.size(); ++n) {
      near.emplace_back(pass[n - 1].tip_mm + r * Vec3::UnitZ(), pass[n].tip_mm + r * Vec3::UnitZ());
    }
    path.insert(path.end(), pass.begin(), pass.end());
    // Back high above.
    path.push_back({pass.back().tip_mm + Vec3(0, 0, 9), Vec3::UnitZ()});
    path.push_back({pass.front().tip_mm + Vec3(0, 0, 9), Vec3::UnitZ()});
  }
  const MachinedSurface surface = cut({{0.6, 0.5}, 4}, 0.02, ball(4), path);
  const auto envelope = [&](double x, double y) {
    double lowest = 1e9;
    for (const auto& [a, b] : near) {
      const Vec3 d = b - a;
      const auto at = [&](double t) {
        const Vec3 c = a + t * d;
        const double q = r * r - (x - c.x()) * (x - c.x()) - (y - c.y()) * (y - c.y());
        return q < 0 ? 1e9 : c.z() - std::sqrt(q);
      };
      if (at(0.5) > lowest + 0.02) continue;
      double low = 0;
      double high = 1;
      for (int k = 0; k < 30; ++k) {
        const double m1 = low + (high - low) * 0.382;
        const double m2 = low + (high - low) * 0.618;
        (at(m1) < at(m2) ? high : low) = at(m1) < at(m2) ? m2 : m1;
      }
      lowest = std::min(lowest, at((low + high) / 2));
    }
    return lowest;
  };
  double highest_peak = 0;
  double highest_found = 0;
  for (int j = 1; j + 1 < surface.heights_mm.height; ++j) {
    for (int i = 1; i + 1 < surface.heights_mm.width; ++i) {
      const double x = surface.extent.min.x() + surface.pitch_mm * i;
      const double y = surface.extent.min.y() + surface.pitch_mm * j;
      const Vec2 place = surface.peak_place_mm(i, j);
      EXPECT_LE((place - Vec2(x, y)).cwiseAbs().maxCoeff(), surface.pitch_mm / 2 + 1e-12);
      const double peak = surface.peaks_mm.at(i, j) - design(place.x(), place.y());
      double found = 0;
      for (int b = -4; b <= 4; ++b) {
        for (int a = -2; a <= 2; ++a) {
          const double px = x + a * 0.005;
          const double py = y + b * 0.0025;
          found = std::max(found, envelope(px, py) - design(px, py));
        }
      }
      highest_peak = std::max(highest_peak, peak);
      highest_found = std::max(highest_found, found);
      // Between samples a ridge rises by less than its flanks' slope (0.04) times half their distance: 0.05 um.
      EXPECT_LT(peak, found + 7e-5) << x << " " << y;
    }
  }
  EXPECT_GT(highest_found, 1e-3);
  EXPECT_NEAR(highest_peak, highest_found, 5e-5);
}

TEST(StockModel, ABallLeavesTheSameSurfaceHoweverItsAxisLeans) {
  const double r = 2;
  const Blank blank{{8, 5}, 5};
  std::vector<Vec3> centres;
  for (int k = 0; k <= 40; ++k) {
    const double x = -6 + 0.3 * k;
    centres.emplace_back(x, 0.5 * std::sin(x), 4.6 + r + 0.2 * std::cos(1.3 * x));
  }
  Path vertical, leaning_path, turning;
  for (std::size_t k = 0; k < centres.size(); ++k) {
    vertical.push_back(pose_of_centre(centres[k], r));
    leaning_path.push_back(pose_of_centre(centres[k], r, leaning(30, 70)));
    turning.push_back(pose_of_centre(centres[k], r, leaning(10 + 0.4 * k, 200 - 2.0 * k)));
  }
  const MachinedSurface a = cut(blank, 0.05, ball(4), vertical);
  const MachinedSurface b = cut(blank, 0.05, ball(4), leaning_path);
  const MachinedSurface c = cut(blank, 0.05, ball(4), turning);
  EXPECT_GT(a.removed_mm3, 5);
  EXPECT_LT(largest_difference(a.heights_mm, b.heights_mm), 2e-6);
  // While the axis turns with the tip on a line the centre bows by R angle^2 / 8 between given poses (0.035 rad: 0.3
  // um).
  EXPECT_LT(largest_difference(a.heights_mm, c.heights_mm), 3e-3);
}

TEST(StockModel, BallEqualsADenseSearchOnRandomPolylines) {
  const double r = 1.5;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> place(-4, 4), height(1.5, 4.5), little(-0.15, 0.15);
    const Blank blank{{6, 5}, 5};
    Path path;
    Vec3 tip(place(random), place(random), height(random));
    for (int k = 0; k < 60; ++k) {
      path.push_back({tip, Vec3::UnitZ()});
      const bool jump = seed % 3 == 0 || k % 13 == 0;
      if (jump) {
        tip = Vec3(place(random), place(random), height(random));
      } else {
        tip += Vec3(little(random), little(random), k % 7 == 0 ? little(random) * 3 : little(random));
        if (k % 11 == 0) tip.head<2>() = path.back().tip_mm.head<2>();  // a plunge or lift
        tip.z() = std::clamp(tip.z(), 0.5, 5.5);
      }
    }
    const MachinedSurface surface = cut(blank, 0.17, ball(2 * r), path);
    for (int j = 0; j < surface.heights_mm.height; ++j) {
      for (int i = 0; i < surface.heights_mm.width; ++i) {
        const double x = surface.extent.min.x() + surface.pitch_mm * i;
        const double y = surface.extent.min.y() + surface.pitch_mm * j;
        const double expected =
            std::min(5.0, searched(path, x, y, r, [&](double rho) { return r - std::sqrt(r * r - rho * rho); }));
        ASSERT_NEAR(surface.heights_mm.at(i, j), std::max(expected, 0.0), 2e-6)
            << "seed " << seed << " at " << x << " " << y;
      }
    }
  }
}

TEST(StockModel, MillsEqualADenseSearchOnRandomPolylines) {
  for (const double corner : {0.0, 0.5}) {
    const double r = 1.6;
    for (unsigned seed = 21; seed <= 24; ++seed) {
      std::mt19937 random(seed);
      std::uniform_real_distribution<double> place(-4, 4), height(1.5, 4.5), little(-0.4, 0.4);
      Path path;
      Vec3 tip(place(random), place(random), height(random));
      for (int k = 0; k < 40; ++k) {
        path.push_back({tip, Vec3::UnitZ()});
        tip += Vec3(little(random), little(random), k % 3 == 0 ? little(random) : 0.0);
        if (k % 9 == 0) tip = Vec3(place(random), place(random), path.back().tip_mm.z());
        tip.z() = std::clamp(tip.z(), 0.5, 5.5);
      }
      const MachinedSurface surface = cut({{6, 5}, 5}, 0.17, mill(2 * r, corner), path);
      const auto bottom = [&](double rho) {
        const double out = rho - (r - corner);
        return out <= 0 ? 0.0 : corner - std::sqrt(std::max(0.0, corner * corner - out * out));
      };
      int off = 0;
      for (int j = 0; j < surface.heights_mm.height; ++j) {
        for (int i = 0; i < surface.heights_mm.width; ++i) {
          const double x = surface.extent.min.x() + surface.pitch_mm * i;
          const double y = surface.extent.min.y() + surface.pitch_mm * j;
          const double expected = std::min(5.0, searched(path, x, y, r, bottom));
          // At the rim the profile ends in a wall and the search may miss the best moment by one step: a slightly wider
          // mill that it finds as well must be lower.
          ASSERT_LT(surface.heights_mm.at(i, j), expected + 3e-6) << "seed " << seed << " at " << x << " " << y;
          const double wider =
              std::min(5.0, searched(path, x, y, r + 0.01, [&](double rho) { return bottom(std::min(rho, r)); }));
          ASSERT_GT(surface.heights_mm.at(i, j), std::min(expected - 3e-6, wider - 3e-6)) << "seed " << seed;
          if (surface.heights_mm.at(i, j) < expected - 1e-4) ++off;
        }
      }
      if (corner > 0) {
        EXPECT_LT(off, 0.002 * surface.heights_mm.values.size()) << "seed " << seed;
      }
    }
  }
}

TEST(StockModel, ATiltedFlatEndMillLeavesItsInclinedFloor) {
  // Sunk along its axis, a flat end leaves the plane through its tip at right angles to the axis.
  const Vec3 axis = leaning(25, 0);
  const MachinedSurface surface = cut({{6, 5}, 5}, 0.05, mill(3, 0), {{{-0.3, -1, 4}, axis}, {{-0.3, 1, 4}, axis}});
  int inside = 0;
  for (int j = 0; j < surface.heights_mm.height; ++j) {
    for (int i = 0; i < surface.heights_mm.width; ++i) {
      const double x = surface.extent.min.x() + surface.pitch_mm * i + 0.3;
      const double y = surface.extent.min.y() + surface.pitch_mm * j;
      if (std::abs(y) > 0.9 || std::abs(x) > 1.3 * std::cos(25 * kPi / 180)) continue;
      EXPECT_NEAR(surface.heights_mm.at(i, j), std::min(5.0, 4 - x * std::tan(25 * kPi / 180)), 2e-6);
      ++inside;
    }
  }
  EXPECT_GT(inside, 1000);
}

TEST(StockModel, CutsCommuteRepeatAndSplitWithoutChange) {
  const double r = 2;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> little(-0.4, 0.4);
  Path path;
  Vec3 tip(-3, -2, 4);
  for (int k = 0; k < 300; ++k) {
    path.push_back({tip, leaning(20, 40)});
    tip += Vec3(little(random), little(random), little(random) * 0.3);
    tip = tip.cwiseMax(Vec3(-5, -4, 2)).cwiseMin(Vec3(5, 4, 5));
  }
  const Blank blank{{7, 5}, 5};
  const MachinedSurface once = cut(blank, 0.05, ball(2 * r), path);

  Path twice = path;
  twice.insert(twice.end(), path.begin(), path.end());
  Path backwards(path.rbegin(), path.rend());
  Path split;
  for (std::size_t k = 0; k + 1 < path.size(); ++k) {
    for (int part = 0; part < 10; ++part) {
      split.push_back({path[k].tip_mm + part / 10.0 * (path[k + 1].tip_mm - path[k].tip_mm), path[k].axis});
    }
  }
  split.push_back(path.back());
  // Going twice adds a way back from the end to the start, which cuts as well: give it to the single one, too.
  Path closed = path;
  closed.push_back(path.front());
  EXPECT_EQ(largest_difference(cut(blank, 0.05, ball(2 * r), twice).heights_mm,
                               cut(blank, 0.05, ball(2 * r), closed).heights_mm),
            0);
  EXPECT_LT(largest_difference(once.heights_mm, cut(blank, 0.05, ball(2 * r), backwards).heights_mm), 1e-6);
  EXPECT_LT(largest_difference(once.heights_mm, cut(blank, 0.05, ball(2 * r), split).heights_mm), 1e-6);

  // Neither the threads nor where the moves are flushed matters.
  set_thread_count(1);
  EXPECT_EQ(cut(blank, 0.05, ball(2 * r), path).heights_mm.values, once.heights_mm.values);
  EXPECT_EQ(cut(blank, 0.05, ball(2 * r), path).peaks_mm.values, once.peaks_mm.values);
  EXPECT_EQ(cut(blank, 0.05, ball(2 * r), path).peak_offsets.values, once.peak_offsets.values);
  set_thread_count(0);
  StockModel pieces(blank, {0.05, 0});
  pieces.set_cutter(ball(2 * r));
  Grid<float> last(once.heights_mm.width, once.heights_mm.height, 5.0F);
  for (std::size_t k = 1; k < path.size(); ++k) {
    feed(pieces, {path[k - 1], path[k]}, static_cast<long>(k));
    if (k % 50 != 0) continue;
    pieces.flush();
    // The stock never grows.
    const MachinedSurface now = pieces.surface();
    for (std::size_t n = 0; n < last.values.size(); ++n) ASSERT_LE(now.heights_mm.values[n], last.values[n]);
    last = now.heights_mm;
  }
  pieces.flush();
  EXPECT_LT(largest_difference(once.heights_mm, pieces.surface().heights_mm), 1e-6);
}

struct Cut {
  Cutter cutter;
  Path path;
};

MachinedSurface cut(const Blank& blank, double pitch, const std::vector<Cut>& cuts) {
  StockModel model(blank, {pitch, 0});
  for (const Cut& c : cuts) {
    model.set_cutter(c.cutter);
    feed(model, c.path);
  }
  model.flush();
  return model.surface();
}

double number_between(double least, double most) { return least + (most - least) * *rc::gen::inRange(0, 1000001) / 1e6; }

/// Each a few hundredths of the reach deep, over one plane, so that ridges and rims are everywhere. Most are balls, some lean.
std::vector<Cut> random_cuts(double reach) {
  const double climb_x = number_between(-0.4, 0.4), climb_y = number_between(-0.4, 0.4);
  std::vector<Cut> cuts(*rc::gen::inRange(2, 7));
  for (Cut& c : cuts) {
    const double diameter = number_between(1.5, 5);
    const int shape = *rc::gen::inRange(0, 5);
    const bool leans = shape < 2, is_ball = shape < 3;
    c.cutter = is_ball ? ball(diameter) : mill(diameter, shape == 3 ? 0 : diameter / 8);
    const Vec3 axis = leans ? leaning(25, number_between(0, 360)) : Vec3(Vec3::UnitZ());
    const int count = *rc::gen::inRange(2, 5);
    for (int k = 0; k < count; ++k) {
      const double x = number_between(-reach, reach), y = number_between(-reach, reach);
      const double lowest = 3 + climb_x * x + climb_y * y - number_between(0, 0.02) * reach;
      c.path.push_back(pose_of_centre({x, y, lowest + diameter / 2}, diameter / 2, axis));
    }
  }
  return cuts;
}

RC_GTEST_PROP(StockModel, HeightsAndPeaksKnowNeitherOrderNorRepeatsNorSplits, ()) {
  const double pitch = *rc::gen::element(0.02, 0.05, 0.2);
  const Blank blank{{34 * pitch, 27 * pitch}, 5};
  const std::vector<Cut> cuts = random_cuts(25 * pitch);
  std::vector<Cut> shuffled = cuts, twice = cuts, split;
  std::shuffle(shuffled.begin(), shuffled.end(), std::mt19937(*rc::gen::arbitrary<unsigned>()));
  twice.insert(twice.end(), cuts.begin(), cuts.end());
  for (const Cut& c : cuts) {
    split.push_back({c.cutter, {}});
    for (std::size_t k = 0; k + 1 < c.path.size(); ++k) {
      for (int part = 0; part < 10; ++part) {
        split.back().path.push_back({c.path[k].tip_mm + part / 10.0 * (c.path[k + 1].tip_mm - c.path[k].tip_mm), c.path[k].axis});
      }
    }
    split.back().path.push_back(c.path.back());
  }
  const MachinedSurface once = cut(blank, pitch, cuts);
  const auto check = [&](const std::vector<Cut>& others) {
    const MachinedSurface other = cut(blank, pitch, others);
    // A sloped mill is placed to 1e-5 mm, on the steep side of its corner.
    RC_ASSERT(largest_difference(other.heights_mm, once.heights_mm) < 2e-5);
    RC_ASSERT(largest_difference(other.peaks_mm, once.peaks_mm) < 5e-5);
    RC_ASSERT(other.peak_offsets.values == once.peak_offsets.values);
  };
  check(shuffled);
  check(twice);
  check(split);
}

TEST(StockModel, RapidsThroughStockAreCaughtAndOthersAreNot) {
  const Blank blank{{20, 12}, 8};
  StockModel model(blank, {0.05, 0});
  model.set_cutter(ball(4));
  const ToolPose high{{-8, 0, 13}, Vec3::UnitZ()};
  const ToolPose above{{8, 3, 13}, Vec3::UnitZ()};
  const ToolPose beside{{13, 3, 3}, Vec3::UnitZ()};
  rapid(model, high, above, 1);
  rapid(model, above, {{13, 3, 13}, Vec3::UnitZ()}, 2);
  rapid(model, {{13, 3, 13}, Vec3::UnitZ()}, beside, 3);  // down beside the block, 1 mm of air
  const ToolPose in{{4, 3, 6}, Vec3::UnitZ()};
  feed(model, {beside, {{13, 3, 6}, Vec3::UnitZ()}, in}, 4);
  rapid(model, in, {{4, 3, 13}, Vec3::UnitZ()}, 6);  // straight up out of its own slot
  model.flush();
  EXPECT_TRUE(model.faults().empty()) << model.faults()[0].message;

  const double before = model.surface().removed_mm3;
  rapid(model, {{4, 3, 13}, Vec3::UnitZ()}, {{4, 3, 6}, Vec3::UnitZ()}, 7);    // back down into the slot: nothing there
  rapid(model, {{4, 3, 6}, Vec3::UnitZ()}, {{-4, 3, 6.5}, Vec3::UnitZ()}, 8);  // out of its end: through stock
  rapid(model, {{-4, 3, 6.5}, Vec3::UnitZ()}, {{-4, 1, 6.5}, Vec3::UnitZ()}, 9);
  rapid(model, {{-4, 1, 6.5}, Vec3::UnitZ()}, {{-4, 1, 13}, Vec3::UnitZ()}, 10);
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].kind, "rapid_in_stock");
  EXPECT_EQ(model.faults()[0].line, 8);
  EXPECT_NEAR(model.faults()[0].amount_mm, 1.9, 0.15);
  EXPECT_EQ(model.faults()[0].last_line, 9);
  EXPECT_EQ(model.faults()[0].worst_line, 8);
  EXPECT_GT(model.surface().removed_mm3, before + 1) << "what a crash takes along is gone";
}

TEST(StockModel, RapidsKeepTheAskedDistance) {
  for (const double height : {5.2, 5.9}) {
    StockModel model({{10, 8}, 5}, {0.05, 0.5});
    model.set_cutter(mill(6, 0.5));
    rapid(model, {{-9, 1, height}, Vec3::UnitZ()}, {{9, 1, height}, Vec3::UnitZ()}, 1);
    model.flush();
    EXPECT_EQ(model.faults().size(), height < 5.5 ? 1U : 0U) << height;
    EXPECT_EQ(model.surface().removed_mm3, 0);
  }
}

TEST(StockModel, CuttingWithTheSpindleOffIsCaughtAndMovingInAirIsNot) {
  StockModel model({{10, 8}, 5}, {0.05, 0});
  model.set_cutter(ball(4));
  feed(model, {{{-9, 0, 5.5}, Vec3::UnitZ()}, {{9, 0, 5.5}, Vec3::UnitZ()}, {{9, 0, 4.8}, Vec3::UnitZ()}}, 1, false);
  model.flush();
  EXPECT_TRUE(model.faults().empty());
  feed(model, {{{9, 0, 4.8}, Vec3::UnitZ()}, {{-9, 0, 4.8}, Vec3::UnitZ()}}, 3, false);
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].kind, "spindle_off_in_cut");
  EXPECT_EQ(model.faults()[0].line, 3);
  EXPECT_NEAR(model.faults()[0].amount_mm, 0.2, 2e-3);
}

// One forgotten M3 is one fault, whatever rapids lie between its rows; the next stop of the spindle is another.
TEST(StockModel, TheSpindleOffIsOneFaultUntilItTurnsAgain) {
  StockModel model({{10, 8}, 5}, {0.05, 0});
  model.set_cutter(ball(4));
  long line = 1;
  const auto row = [&](double y, double z, bool spindle_on) {
    feed(model, {{{-9, y, z}, Vec3::UnitZ()}, {{9, y, z}, Vec3::UnitZ()}}, line, spindle_on);
    rapid(model, {{9, y, z}, Vec3::UnitZ()}, {{9, y, 8}, Vec3::UnitZ()}, line + 2, spindle_on);
    rapid(model, {{9, y, 8}, Vec3::UnitZ()}, {{-9, y + 2, 8}, Vec3::UnitZ()}, line + 3, spindle_on);
    line += 10;
  };
  row(-3, 4.9, false);
  row(-1, 4.6, false);
  row(1, 4.8, false);
  row(3, 4.8, true);
  row(-3, 4.5, false);
  model.flush();
  ASSERT_EQ(model.faults().size(), 2U);
  EXPECT_EQ(model.faults()[0].line, 1);
  EXPECT_NEAR(model.faults()[0].amount_mm, 0.4, 2e-3) << "the worst";
  EXPECT_NEAR(model.faults()[0].place_mm.y(), -1, 0.1);
  EXPECT_NE(model.faults()[0].message.find("the worst of 3 moves"), std::string::npos) << model.faults()[0].message;
  EXPECT_EQ(model.faults()[1].line, 41);
}

TEST(StockModel, ThePartBelowTheTableIsAFault) {
  StockModel model({{10, 8}, 5}, {0.05, 0});
  model.set_cutter(ball(4));
  feed(model, {{{-9, 0, 0.0}, Vec3::UnitZ()}, {{9, 0, 0.0}, Vec3::UnitZ()}, {{9, 0, -0.25}, Vec3::UnitZ()}});
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].kind, "table");
  EXPECT_EQ(model.faults()[0].line, 2);
  EXPECT_NEAR(model.faults()[0].amount_mm, 0.25, 1e-9);
}

TEST(StockModel, AHolderThatHitsWhatStillStandsIsCaughtAndWhatIsGoneIsNot) {
  Cutter cutter = ball(4);
  cutter.flute_length_mm = 14;
  cutter.length_mm = 40;
  cutter.holder = {{14, 40, 6, 10}};
  const Blank blank{{40, 30}, 25};
  // A ball slot 11 mm deep along x (in one go: only geometry matters here), then 18 deep: there the holder's rim, 14
  // above the tip, is 4 mm below the top beside the slot.
  const auto slot = [](double depth) {
    return Path{{{-30, 2, 25 - depth}, Vec3::UnitZ()}, {{30, 2, 25 - depth}, Vec3::UnitZ()}};
  };
  StockModel model(blank, {0.1, 0});
  model.set_cutter(cutter);
  feed(model, slot(11), 10);
  model.flush();
  EXPECT_TRUE(model.faults().empty()) << model.faults()[0].message;
  feed(model, slot(18), 20);
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].kind, "collision");
  EXPECT_EQ(model.faults()[0].line, 20);
  EXPECT_NEAR(model.faults()[0].amount_mm, 4, 0.01);
  EXPECT_NE(model.faults()[0].message.find("holder"), std::string::npos);

  // The same after a wide mill has cleared the way: order in time counts, within one batch, too.
  for (const bool cleared_first : {true, false}) {
    StockModel again(blank, {0.1, 0});
    again.set_cutter(mill(30, 0));
    if (cleared_first) feed(again, {{{-40, 2, 20}, Vec3::UnitZ()}, {{40, 2, 20}, Vec3::UnitZ()}}, 1);
    again.set_cutter(cutter);
    feed(again, slot(18), 20);
    again.set_cutter(mill(30, 0));
    if (!cleared_first) feed(again, {{{-40, 2, 20}, Vec3::UnitZ()}, {{40, 2, 20}, Vec3::UnitZ()}}, 30);
    again.flush();
    EXPECT_EQ(again.faults().size(), cleared_first ? 0U : 1U);
  }
}

TEST(StockModel, ATaperedBallCutsAGrooveOfItsOwnProfile) {
  // Along x, upright and leaning across: seen along x the cutter is its profile, turned by the lean.
  const double taper = 20 * kPi / 180;
  Cutter cutter = ball(2);
  cutter.taper_rad = taper;
  cutter.flute_length_mm = 9;
  cutter.shank_diameter_mm = 2;
  cutter.length_mm = 40;
  for (const double lean : {0.0, 12.0, -25.0}) {
    const double t = lean * kPi / 180;
    StockModel model({{12, 14}, 12}, {0.05, 0});
    model.set_cutter(cutter);
    const Vec3 axis(0, std::sin(t), std::cos(t));
    const Vec3 centre(0, 0.313, 8.5);
    feed(model, {pose_of_centre(centre - Vec3(9, 0, 0), 1, axis), pose_of_centre(centre + Vec3(9, 0, 0), 1, axis)});
    model.flush();
    EXPECT_TRUE(model.faults().empty()) << lean << " " << model.faults()[0].message;
    const MachinedSurface surface = model.surface();
    // Height of the profile's lower side over y: the ball's, or that of the flank's line towards this side.
    const auto expected = [&](double y) {
      const double d = y - centre.y();
      double low = std::abs(d) < 1 ? centre.z() - std::sqrt(1 - d * d) : 1e9;
      for (const double side : {-1.0, 1.0}) {
        // The flank's outward normal is `side` across the axis and `taper` downwards; tangent to the ball there.
        const double angle = side * (kPi / 2 - taper) - t;  // of the normal against straight down, towards +y
        const Vec2 touch(std::sin(angle), -std::cos(angle));
        if (side * (d - touch.x()) <= 0 || touch.y() >= 0) continue;  // leaning over, it is above the ball
        const double along = (d - touch.x()) / -touch.y();
        low = std::min(low, centre.z() + touch.y() + along * touch.x());
      }
      return std::min(low, 12.0);
    };
    const int i = surface.heights_mm.width / 2;
    double worst = 0;
    int flank = 0;
    for (int j = 0; j < surface.heights_mm.height; ++j) {
      const double y = surface.extent.min.y() + j * surface.pitch_mm;
      const double z = expected(y);
      worst = std::max(worst, std::abs(surface.heights_mm.at(i, j) - z));
      flank += z < 11.99 && std::abs(y - centre.y()) > 1;
    }
    EXPECT_LT(worst, 2e-6) << "leaning " << lean;
    EXPECT_GT(flank, 10);
  }
  // A neck that is wider than the flank's end runs into the groove's sides, and by how much.
  cutter.flute_length_mm = 3;
  cutter.shank = {{3, 10, 2.5, 2.5}};
  StockModel model({{12, 14}, 12}, {0.05, 0});
  model.set_cutter(cutter);
  feed(model, {pose_of_centre({-9, 0, 8}, 1), pose_of_centre({9, 0, 8}, 1)});
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].kind, "collision");
  EXPECT_NEAR(model.faults()[0].amount_mm, 12 - 10, 0.01);
}

TEST(StockModel, AShankThatLeansIntoAWallIsCaught) {
  // A wall 12 mm high; the ball runs along its foot. Upright it clears by 0.5 mm; leaning towards the wall it cannot.
  for (const double lean : {0.0, 35.0, -35.0}) {
    StockModel model({{20, 20}, 14}, {0.1, 0});
    model.set_cutter(mill(10, 0));
    for (const double x : {-8.0, -2.0}) {
      feed(model, {{{x, -16, 2}, Vec3::UnitZ()}, {{x, 16, 2}, Vec3::UnitZ()}});
    }
    model.flush();
    ASSERT_TRUE(model.faults().empty());
    Cutter cutter = ball(4);
    cutter.flute_length_mm = 5;
    model.set_cutter(cutter);
    const Vec3 axis = leaning(lean, 0);
    feed(model, {pose_of_centre({0.5, -16, 4.5}, 2, axis), pose_of_centre({0.5, 16, 4.5}, 2, axis)}, 50);
    model.flush();
    if (lean > 0) {
      ASSERT_EQ(model.faults().size(), 1U);
      EXPECT_EQ(model.faults()[0].kind, "collision");
      EXPECT_EQ(model.faults()[0].line, 50);
    } else {
      EXPECT_TRUE(model.faults().empty()) << lean << " " << model.faults()[0].message;
    }
  }
}

TEST(StockModel, NoFalseAlarmsAtThirtyDegreesOverACurvedSurface) {
  // One-way passes over a wavy surface of slopes to 0.45, links and rapids between, holder and all.
  const double r = 2;
  Cutter cutter = ball(4);
  cutter.flute_length_mm = 8;
  cutter.length_mm = 45;
  cutter.holder = {{22, 30, 8, 8}, {30, 45, 12, 16}};
  const auto height = [](double x, double y) { return 6 + 0.9 * std::sin(0.5 * x) * std::cos(0.45 * y); };
  const Vec3 axis = leaning(30, 90);
  StockModel model({{16, 12}, 7}, {0.05, 0});
  model.set_cutter(cutter);
  long line = 1;
  const auto centre = [&](double x, double y) {
    const double e = 1e-5;
    const Vec3 n =
        Vec3(-(height(x + e, y) - height(x - e, y)) / (2 * e), -(height(x, y + e) - height(x, y - e)) / (2 * e), 1)
            .normalized();
    return Vec3(Vec3(x, y, height(x, y)) + r * n);
  };
  ToolPose last{{-20, -10, 30}, axis};
  for (double y = -6.5; y <= 6.5; y += 0.4) {
    Path pass;
    for (double x = -12; x <= 12; x += 0.15) pass.push_back(pose_of_centre(centre(x, y), r, axis));
    const ToolPose over{pass.front().tip_mm + Vec3(0, 0, 6), axis};
    rapid(model, last, over, line++);
    feed(model, {over, pass.front()}, line++);
    feed(model, pass, line);
    line += static_cast<long>(pass.size());
    last = {pass.back().tip_mm + Vec3(0, 0, 8), axis};
    rapid(model, pass.back(), last, line++);
  }
  model.flush();
  EXPECT_TRUE(model.faults().empty()) << model.faults()[0].message;
  EXPECT_GT(model.surface().removed_mm3, 50);
}

TEST(StockModel, FlutesOfALeaningBallTakeTheWallThatTheyLeanInto) {
  // The cylinder above a ball that leans 40 degrees towards +x cuts what stands above its underside, the line at its
  // side.
  StockModel model({{16, 8}, 6}, {0.05, 0});
  Cutter cutter = ball(2);
  cutter.flute_length_mm = 14;
  model.set_cutter(cutter);
  const Vec3 axis = leaning(40, 0);
  feed(model, {pose_of_centre({-6, -8, 2}, 1, axis), pose_of_centre({-6, 8, 2}, 1, axis)});
  model.flush();
  const MachinedSurface surface = model.surface();
  const int row = surface.heights_mm.height / 2;
  // Underside of the cylinder in its plane: from the point on the equator at 40 degrees below the horizontal, along the
  // axis.
  for (double x = -5.1; x < -3; x += 0.25) {
    const int i = static_cast<int>(std::lround((x - surface.extent.min.x()) / 0.05));
    const double node_x = surface.extent.min.x() + 0.05 * i;
    const double expected =
        2 - std::sin(40 * kPi / 180) + (node_x + 6 - std::cos(40 * kPi / 180)) / std::tan(40 * kPi / 180);
    EXPECT_NEAR(surface.heights_mm.at(i, row), std::min(6.0, expected), 1e-5) << x;
  }
}

// A clamp 5 mm high from x = 6 on: a ball beside it, into it, over it.
TEST(StockModel, NothingOfACutterMayEnterAKeepOut) {
  Blank blank{{8, 10}, 3};
  blank.keep_outs = {{{6, -5, 0}, {12, 5, 5}}};
  const auto faults_at = [&](const Vec3& centre) {
    StockModel model(blank, {0.2, 0});
    model.set_cutter(ball(4));
    feed(model, {pose_of_centre({-3, 0, 9}, 2), pose_of_centre(centre, 2)});
    model.flush();
    return model.faults();
  };
  EXPECT_TRUE(faults_at({3.9, 0, 5}).empty());
  EXPECT_TRUE(faults_at({5, 0, 8}).empty());
  const auto faults = faults_at({5, 0, 5});
  ASSERT_EQ(faults.size(), 1U);
  EXPECT_EQ(faults[0].kind, "collision");
  EXPECT_EQ(faults[0].line, 1);
  EXPECT_NE(faults[0].message.find("keep-out 1"), std::string::npos) << faults[0].message;
  // Over the box's edge, 1 mm off its axis, the ball's underside is at 5 - sqrt(4 - 1).
  EXPECT_NEAR(faults[0].amount_mm, std::sqrt(3.0), 0.1);
  EXPECT_NE(faults[0].picture.find("<svg"), std::string::npos);
  EXPECT_NE(faults[0].picture.find("<polygon"), std::string::npos);
}

TEST(StockModel, AToolThatLeansIntoTheTableIsCaughtWithItsNose) {
  StockOptions options{0.5, 0};
  options.table = KeepOut{{-100, -100, -50}, {100, 100, -2}};
  Cutter cutter = ball(4);
  cutter.shank_diameter_mm = 4;
  cutter.length_mm = 40;
  cutter.holder = {{40, 60, 25, 25}};
  for (const double lean : {20.0, 80.0}) {
    StockModel model({{8, 10}, 3}, options);
    model.set_cutter(cutter);
    const Vec3 axis = leaning(lean, 0);
    feed(model, {pose_of_centre({0, 0, 9}, 2, axis), pose_of_centre({0, 0, 6}, 2, axis)});
    model.flush();
    if (lean < 45) {
      EXPECT_TRUE(model.faults().empty());
      continue;
    }
    ASSERT_EQ(model.faults().size(), 1U);
    EXPECT_NE(model.faults()[0].message.find("the spindle nose is"), std::string::npos) << model.faults()[0].message;
    // The nose's lower rim: (6 - 2 cos) + 40 cos - 25 sin above the back.
    const double rim = 6 + 38 * axis.z() - 25 * axis.x();
    EXPECT_NEAR(model.faults()[0].amount_mm, -2 - rim, 0.6);
  }
}

// One part of the tool is wide and comes down 3 mm beside what stands there, 0.7 mm too low; all others pass it.
TEST(StockModel, EveryPartOfTheToolIsCaughtInWhateverStandsInItsWay) {
  const Vec3 up = Vec3::UnitZ();
  constexpr double kTop_mm = 50, kDepth_mm = 0.7, kWide_mm = 6, kSlim_mm = 1;
  const std::vector<std::string> parts = {"cutter", "shank", "holder", "spindle nose"};
  const std::vector<double> heights_mm = {0, 5, 20, 30, 40};  // of the parts' ends above the tip
  for (std::size_t part = 0; part < parts.size(); ++part) {
    const auto radius = [&](std::size_t k) { return k == part ? kWide_mm : kSlim_mm; };
    Cutter cutter = mill(2 * radius(0), 0);
    cutter.flute_length_mm = heights_mm[1];
    cutter.length_mm = heights_mm[3];
    cutter.shank_diameter_mm = 2 * radius(1);
    cutter.holder = {{heights_mm[2], heights_mm[3], radius(2), radius(2)}, {heights_mm[3], heights_mm[4], radius(3), radius(3)}};
    for (const std::string obstacle : {"stock", "solid", "keep-out 1", "the table"}) {
      const bool stock = obstacle == "stock" || obstacle == "solid";
      Blank blank{{stock ? 20.0 : 4.0, 20}, stock ? kTop_mm : 5.0};
      StockOptions options{0.25, 0};
      const KeepOut box{{10, -5, -60}, {20, 5, kTop_mm}};
      if (obstacle == "solid") options.solid_pitch_mm = 0.5;
      if (obstacle == "keep-out 1") blank.keep_outs = {box};
      if (obstacle == "the table") options.table = box;
      StockModel model(blank, options);
      model.set_cutter(cutter);
      // The blank ends at x = 10, the box begins there.
      const double x = stock ? 13 : 7;
      const double tip = kTop_mm - kDepth_mm - heights_mm[part];
      feed(model, {{{x, 0.1, 60}, up}, {{x, 0.1, 58}, up}}, 6);
      // A cutter may cut, but not rapidly.
      if (stock && part == 0) {
        rapid(model, {{x, 0.1, 58}, up}, {{x, 0.1, tip}, up}, 7);
      } else {
        feed(model, {{{x, 0.1, 58}, up}, {{x, 0.1, tip}, up}}, 7);
      }
      model.flush();
      const std::string what = parts[part] + " in " + obstacle;
      ASSERT_EQ(model.faults().size(), 1U) << what;
      const Fault& fault = model.faults()[0];
      EXPECT_EQ(fault.kind, stock && part == 0 ? "rapid_in_stock" : "collision") << what;
      EXPECT_EQ(fault.line, 7) << what;
      EXPECT_NEAR(fault.amount_mm, kDepth_mm, 2e-3) << what;
      EXPECT_NEAR(fault.place_mm.x(), 10, 3.01) << what;
      EXPECT_NEAR(fault.place_mm.z(), kTop_mm, kDepth_mm + 2e-3) << what;
      EXPECT_NE(fault.message.find("the " + parts[part]), std::string::npos) << fault.message;
      if (!stock) {
        EXPECT_NE(fault.message.find(obstacle), std::string::npos) << fault.message;
      }
      EXPECT_NE(fault.picture.find("<svg"), std::string::npos) << what;
    }
  }
}

TEST(StockModel, AFeedFarOverTheCuttersDataIsCaughtInTheCutOnly) {
  Cutter cutter = mill(4, 0);
  cutter.feed_per_tooth_mm = 0.05;
  cutter.edges = 2;
  const auto faults_of = [&](double chip_mm, double z) {
    StockModel model({{20, 10}, 5}, {0.1, 0});
    model.set_cutter(cutter);
    SweptMove move;
    move.line = 7;
    move.from = {{-15, 0, z}, Vec3::UnitZ()};
    move.to = {{15, 0, z}, Vec3::UnitZ()};
    move.spindle_on = true;
    move.spindle_rpm = 12000;
    move.seconds = 30 / (12000 / 60.0 * 2 * chip_mm);
    model.move(move);
    model.flush();
    return model.faults();
  };
  EXPECT_TRUE(faults_of(0.1, 4).empty()) << "twice the data";
  EXPECT_TRUE(faults_of(0.5, 5.1).empty()) << "a link through air";
  const auto faults = faults_of(0.5, 4);
  ASSERT_EQ(faults.size(), 1U);
  EXPECT_EQ(faults.front().kind, "feed");
  EXPECT_EQ(faults.front().line, 7);
  EXPECT_NEAR(faults.front().amount_mm, 0.5, 1e-9);
  EXPECT_NE(faults.front().message.find("10 times"), std::string::npos) << faults.front().message;
}

TEST(StockModel, AHolderUnderAnOverhangMeetsTheSolidAndNotTheHeights) {
  // A mill lying down by 60 degrees undercuts the block; then a thick shank comes down on what hangs over.
  for (const double solid_pitch_mm : {0.0, 0.1}) {
    StockOptions options;
    options.pitch_mm = 0.1;
    options.solid_pitch_mm = solid_pitch_mm;
    StockModel model({{12, 9}, 5}, options);
    Cutter thin = mill(1, 0);
    thin.flute_length_mm = 20;
    model.set_cutter(thin);
    const Vec3 axis = leaning(60, 0);
    feed(model, {{{2, -9, 2}, axis}, {{2, 9, 2}, axis}});
    Cutter thick = ball(1);
    thick.flute_length_mm = 1;
    thick.shank_diameter_mm = 2;
    model.set_cutter(thick);
    rapid(model, {{4, 0, 9}, Vec3::UnitZ()}, {{4, 0, 5.5}, Vec3::UnitZ()}, 10);
    feed(model, {{{4, 0, 5.5}, Vec3::UnitZ()}, {{4, 0, 3.5}, Vec3::UnitZ()}}, 11);
    model.flush();
    EXPECT_EQ(model.faults().size(), solid_pitch_mm > 0 ? 1U : 0U);
    EXPECT_EQ(model.solid() != nullptr, solid_pitch_mm > 0);
  }
}

/// A block with a solid, slit along y by a mill that leans 60 degrees: from x = 2 on material hangs over the slit.
void undercut(StockModel& model) {
  Cutter thin = mill(1, 0);
  thin.flute_length_mm = 20;
  model.set_cutter(thin);
  const Vec3 axis = leaning(60, 0);
  feed(model, {{{2, -9, 2}, axis}, {{2, 9, 2}, axis}});
  model.flush();
}

TEST(StockModel, ARapidThroughWhatHangsOverAnUndercutMeetsTheSolidAndNotTheHeights) {
  // Level through the overhang, 0.6 mm below its top; and the slit itself is free for the mill that cut it.
  for (const double solid_pitch_mm : {0.0, 0.2}) {
    for (const bool rapidly : {true, false}) {
      StockOptions options;
      options.pitch_mm = 0.2;
      options.solid_pitch_mm = solid_pitch_mm;
      StockModel model({{12, 9}, 5}, options);
      undercut(model);
      const Vec3 axis = leaning(60, 0);
      rapid(model, {{2, 9, 2}, axis}, {{2, -9, 2}, axis}, 5);
      model.flush();
      EXPECT_TRUE(model.faults().empty()) << model.faults()[0].message;
      const ToolPose from{{4.5, -9, 4.4}, Vec3::UnitZ()}, to{{4.5, 9, 4.4}, Vec3::UnitZ()};
      model.set_cutter(mill(1, 0));
      if (rapidly) {
        rapid(model, from, to, 10);
        rapid(model, to, from, 30);  // what a crash takes along is gone
      } else {
        feed(model, {from, to}, 10, false);
      }
      model.flush();
      if (solid_pitch_mm == 0) {
        EXPECT_TRUE(model.faults().empty());
        continue;
      }
      ASSERT_EQ(model.faults().size(), 1U);
      const Fault& fault = model.faults()[0];
      EXPECT_EQ(fault.kind, rapidly ? "rapid_in_stock" : "spindle_off_in_cut");
      EXPECT_EQ(fault.line, 10);
      EXPECT_NEAR(fault.amount_mm, 0.6, 1e-2);
      EXPECT_NEAR(fault.place_mm.x(), 4.5, 0.51);
      EXPECT_NEAR(fault.place_mm.z(), 4.4, 0.02);
      EXPECT_NE(fault.message.find("inside the material"), std::string::npos) << fault.message;
      EXPECT_NE(fault.picture.find("<svg"), std::string::npos);
    }
  }
}

TEST(StockModel, ARapidThroughATabIsOneFaultForHeightsAndSolid) {
  // A slot right through but for a tab 1 mm high and 3 mm long.
  StockModel model({{20, 12}, 4}, {.pitch_mm = 0.1, .solid_pitch_mm = 0.2});
  model.set_cutter(mill(3, 0));
  const Vec3 up = Vec3::UnitZ();
  feed(model, {{{-12, 0, 0}, up}, {{-3, 0, 0}, up}, {{-3, 0, 1}, up}, {{3, 0, 1}, up}, {{3, 0, 0}, up}, {{12, 0, 0}, up}});
  model.flush();
  rapid(model, {{12, 0, 0}, up}, {{3, 0, 0}, up}, 20);
  rapid(model, {{3, 0, 1}, up}, {{-3, 0, 1}, up}, 21);
  rapid(model, {{-3, 0, 1}, up}, {{-3, 0, 0}, up}, 22);
  model.flush();
  EXPECT_TRUE(model.faults().empty()) << model.faults()[0].message;
  rapid(model, {{-3, 0, 0}, up}, {{3, 0, 0}, up}, 25);
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].kind, "rapid_in_stock");
  EXPECT_EQ(model.faults()[0].line, 25);
  EXPECT_NEAR(model.faults()[0].amount_mm, 1, 2e-3);
  EXPECT_LT(std::abs(model.faults()[0].place_mm.x()), 3);
  EXPECT_EQ(model.solid()->pieces().size(), 2U) << "a rapid through a tab breaks it";
}

TEST(StockModel, AWallThinnerThanTheRaysOfTheSolidIsMet) {
  // 0.08 mm of material between two slots, between the nodes and the z rays: the y rays cross it.
  StockModel model({{12, 10}, 4}, {.pitch_mm = 0.1, .solid_pitch_mm = 0.4});
  model.set_cutter(mill(4, 0));
  const Vec3 up = Vec3::UnitZ();
  feed(model, {{{-9, -1.99, 2}, up}, {{9, -1.99, 2}, up}});
  feed(model, {{{9, 2.09, 2}, up}, {{-9, 2.09, 2}, up}}, 4);
  rapid(model, {{-9, 2.09, 2}, up}, {{9, 2.09, 2}, up}, 6);
  model.flush();
  EXPECT_TRUE(model.faults().empty()) << model.faults()[0].message;
  rapid(model, {{-9, -1.95, 2}, up}, {{9, -1.95, 2}, up}, 9);
  model.flush();
  ASSERT_EQ(model.faults().size(), 1U);
  EXPECT_EQ(model.faults()[0].line, 9);
  EXPECT_NEAR(model.faults()[0].amount_mm, 0.04 - 1e-3, 1e-5);
  EXPECT_NEAR(model.faults()[0].place_mm.y(), 0.01, 1e-5);
}

TEST(StockModel, FilesReadBackAsWritten) {
  const test::ScratchFolder folder;
  const auto path = folder / "machined.tif";
  const MachinedSurface surface =
      cut({{5, 3}, 4}, 0.05, ball(4), {pose_of_centre({-4, 0.7, 5}, 2), pose_of_centre({4, -0.3, 4.5}, 2), pose_of_centre({-4, -0.6, 5}, 2)});
  write_machined(path, surface);
  const MachinedSurface back = read_machined(path);
  EXPECT_EQ(back.heights_mm.values, surface.heights_mm.values);
  EXPECT_EQ(back.peaks_mm.values, surface.peaks_mm.values);
  EXPECT_EQ(back.peak_offsets.values, surface.peak_offsets.values);
  EXPECT_TRUE(back.peak_offsets.values != Grid<PeakOffset>(101, 61).values);
  EXPECT_EQ(back.pitch_mm, surface.pitch_mm);
  EXPECT_EQ(back.extent.min, surface.extent.min);
  EXPECT_EQ(back.extent.max, surface.extent.max);
  EXPECT_EQ(back.removed_mm3, surface.removed_mm3);
  std::filesystem::remove(folder / "machined.json");
  EXPECT_THROW(read_machined(path), InputError);
}

TEST(StockModel, RefusesWhatCannotBe) {
  EXPECT_THROW(StockModel({{10, 10}, 0}, {}), InputError);
  EXPECT_THROW(StockModel({{10, 10}, 5}, {0, 0}), InputError);
  EXPECT_THROW(StockModel({{100, 100}, 5}, {0.001, 0}), InputError);
  StockModel model({{10, 10}, 5}, {0.1, 0});
  EXPECT_THROW(model.move({}), InputError);
  EXPECT_THROW(model.set_cutter({}), InputError);
}

}  // namespace
}  // namespace lightmill

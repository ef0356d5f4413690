#include "cam/solid.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <algorithm>
#include <cmath>
#include <random>
#include <string>

#include "cam/detail/spline_refinement.h"
#include "cam/mount.h"
#include "design/core/files.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

class Solid : public testing::Test {
 protected:
  test::ScratchFolder folder_;
};

/// The spline that is a0 + a x^2 + b y^2 + c x y exactly: on uniform knots of width w the coefficient of x^2 is x^2 -
/// w^2 / 3 at the middle knot (its blossom).
SplineSurface paraboloid(const Box2& extent, int spans_x, int spans_y, double a0, double a, double b, double c) {
  Grid<double> k(spans_x + 3, spans_y + 3);
  const Vec2 w = extent.size().cwiseQuotient(Vec2(spans_x, spans_y));
  for (int j = 0; j < k.height; ++j) {
    for (int i = 0; i < k.width; ++i) {
      const double x = extent.min.x() + (i - 1) * w.x();
      const double y = extent.min.y() + (j - 1) * w.y();
      k.at(i, j) = a0 + a * (x * x - w.x() * w.x() / 3) + b * (y * y - w.y() * w.y() / 3) + c * x * y;
    }
  }
  return {extent, spans_x, spans_y, k};
}

double paraboloid_volume(const Box2& e, double a0, double a, double b, double c) {
  const auto moment = [](double from, double to, int n) {
    return (std::pow(to, n + 1) - std::pow(from, n + 1)) / (n + 1);
  };
  const auto mx = [&](int n) { return moment(e.min.x(), e.max.x(), n); };
  const auto my = [&](int n) { return moment(e.min.y(), e.max.y(), n); };
  return a0 * mx(0) * my(0) + a * mx(2) * my(0) + b * mx(0) * my(2) + c * mx(1) * my(1);
}

int count(const std::string& text, const std::string& word) {
  int n = 0;
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) ++n;
  return n;
}

const Box2 kExtent{{-31, -12}, {23, 17}};

TEST_F(Solid, OneTileHasThePolynomialsVolume) {
  const SplineSurface surface = paraboloid(kExtent, 20, 11, 12, -0.002, 0.001, 0.0015);
  const SolidSummary summary = write_lens_step(folder_ / "lens.step", surface, {.product_name = "test lens"});
  EXPECT_TRUE(summary.valid);
  EXPECT_EQ(summary.faces, 6);
  EXPECT_EQ(summary.free_edges, 0);
  const double truth = paraboloid_volume(kExtent, 12, -0.002, 0.001, 0.0015);
  EXPECT_NEAR(summary.volume_mm3 / truth, 1, 1e-7);
  EXPECT_NEAR(summary.expected_volume_mm3 / truth, 1, 1e-12);
  EXPECT_LT(summary.max_deviation_um, 1e-6);
  EXPECT_EQ(summary.file_bytes, fs::file_size(folder_ / "lens.step"));
}

TEST_F(Solid, TilesShareTheirEdges) {
  // 170 spans make 2 tiles, 100 make 1; a surface that is no polynomial.
  SplineSurface flat = paraboloid(kExtent, 170, 100, 12, -0.002, 0.001, 0.0015);
  Grid<double> c = flat.coefficients();
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i)
      c.at(i, j) += 0.2 * std::sin(0.3 * i) * std::cos(0.2 * j) + 0.05 * std::abs(i - 80 - j);
  }
  const SplineSurface surface(kExtent, 170, 100, c);
  const SolidSummary summary = write_lens_step(folder_ / "lens.step", surface, {.product_name = "two tiles"});
  EXPECT_TRUE(summary.valid);
  EXPECT_EQ(summary.faces, 2 + 5);
  EXPECT_EQ(summary.free_edges, 0);
  EXPECT_NEAR(summary.volume_mm3 / surface.volume_mm3(), 1, 1e-6);
  EXPECT_LT(summary.max_deviation_um, 1e-6);

  // The file as text: a second look that is not OpenCASCADE's.
  const std::string text = read_whole(folder_ / "lens.step");
  EXPECT_EQ(count(text, "B_SPLINE_SURFACE_WITH_KNOTS"), 2);
  EXPECT_EQ(count(text, "ADVANCED_FACE"), 7);
  EXPECT_EQ(count(text, "CLOSED_SHELL"), 1);
  EXPECT_EQ(count(text, "MANIFOLD_SOLID_BREP"), 1);
  // Tops: 2 x 4 edges with one shared; walls and back: 4 + 4 more.
  EXPECT_EQ(count(text, "EDGE_CURVE"), 7 + 8);
  EXPECT_EQ(count(text, "PRODUCT('two tiles','two tiles'"), 1);
  EXPECT_EQ(count(text, "SI_UNIT(.MILLI.,.METRE.)"), 1);
  EXPECT_EQ(count(text, "'AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF"), 1);
}

TEST_F(Solid, TilesOfDifferentSpansShareTheirEdges) {
  // 160 x 80 spans in two tiles; only the right one needs them, the left one is as well on half as many.
  Grid<double> coarse = paraboloid(kExtent, 80, 40, 12, -0.002, 0.001, 0.0015).coefficients();
  for (int j = 0; j < coarse.height; ++j) {
    for (int i = 0; i < coarse.width; ++i) coarse.at(i, j) += 0.2 * std::sin(0.6 * i) * std::cos(0.4 * j);
  }
  Grid<double> c = detail::with_spans_halved(coarse);
  const SplineSurface even(kExtent, 160, 80, c);
  for (int j = 0; j < c.height; ++j) {
    for (int i = 85; i < c.width; ++i) c.at(i, j) += 0.05 * std::abs(i - 110 - j);
  }
  const SplineSurface surface(kExtent, 160, 80, c);
  const SolidSummary summary = write_lens_step(folder_ / "lens.step", surface, {.product_name = "two tiles"});
  EXPECT_TRUE(summary.valid);
  EXPECT_EQ(summary.faces, 2 + 5);
  EXPECT_EQ(summary.free_edges, 0);
  EXPECT_NEAR(summary.volume_mm3 / surface.volume_mm3(), 1, 1e-6);
  EXPECT_LT(summary.max_deviation_um, 1e-6);
  // Poles of 83 x 83 and 43 x 43 in a fourth of the room; edges and vertices come to a few hundred.
  const int points = count(read_whole(folder_ / "lens.step"), "CARTESIAN_POINT");
  EXPECT_NEAR(points, 83 * 83 + 43 * 43, 700);
  write_lens_step(folder_ / "even.step", even, {.product_name = "two tiles"});
  EXPECT_NEAR(count(read_whole(folder_ / "even.step"), "CARTESIAN_POINT"), 2 * 43 * 43, 500);
}

TEST_F(Solid, ASphericalCapHasItsVolume) {
  constexpr double kRadius = 80;
  const Box2 extent{{-12, -9}, {10, 9}};
  SurfaceMesh mesh;
  constexpr int kNx = 89, kNy = 73;
  const auto height = [](double x, double y) { return std::sqrt(kRadius * kRadius - x * x - y * y) - 70; };
  for (int j = 0; j < kNy; ++j) {
    for (int i = 0; i < kNx; ++i) {
      const double x = extent.min.x() + extent.size().x() * i / (kNx - 1);
      const double y = extent.min.y() + extent.size().y() * j / (kNy - 1);
      mesh.vertices.emplace_back(x, y, height(x, y));
    }
  }
  for (int j = 0; j + 1 < kNy; ++j) {
    for (int i = 0; i + 1 < kNx; ++i) {
      const int a = j * kNx + i;
      mesh.triangles.push_back({a, a + 1, a + kNx + 1});
      mesh.triangles.push_back({a, a + kNx + 1, a + kNx});
    }
  }
  mesh.normals = angle_weighted_normals(mesh.vertices, mesh.triangles);
  const SolidSummary summary = write_lens_step(folder_ / "cap.step", fit_spline(mesh, extent).surface, {.product_name = "cap"});
  // Integral of sqrt(r^2 - x^2 - y^2) over [0, a] x [0, b] in closed form.
  const auto quadrant = [](double a, double b) {
    const double r = kRadius, w = std::sqrt(r * r - a * a - b * b);
    return a * b * w / 3 + a / 6 * (3 * r * r - a * a) * std::atan2(b, w) +
           b / 6 * (3 * r * r - b * b) * std::atan2(a, w) - r * r * r / 3 * std::atan2(a * b, r * w);
  };
  const double truth = 2 * (quadrant(12, 9) + quadrant(10, 9)) - 70 * 22 * 18;
  EXPECT_NEAR(summary.volume_mm3 / truth, 1, 1e-6);
}

/// An ellipse about the origin as a loop of places.
Outline ellipse(double a, double b, int places) {
  Outline outline;
  outline.shape = Outline::Shape::kLoop;
  for (int k = 0; k < places; ++k) outline.loop_mm.emplace_back(a * std::cos(2 * kPi * k / places), b * std::sin(2 * kPi * k / places));
  return outline;
}

TEST_F(Solid, WithinADiskOrALoopHasItsVolumeAndItsLand) {
  // Over a disk of radius r about the origin a0 + a x^2 + b y^2 + c x y has the mean a0 + (a + b) r^2 / 4; over an ellipse
  // a0 + a p^2 / 4 + b q^2 / 4.
  const SplineSurface surface = paraboloid(Box2::centred({26, 22}), 130, 22, 12, -0.004, 0.002, 0.003);
  SolidOptions options;
  options.outline = Outline{Outline::Shape::kDisk, {20, 20}, {}};
  const SolidSummary disk = write_lens_step(folder_ / "disk.step", surface, options);
  EXPECT_TRUE(disk.valid);
  EXPECT_EQ(disk.faces, 2 + 1 + 1);  // tiles, wall, back
  EXPECT_NEAR(disk.volume_mm3 / (kPi * 100 * (12 - 0.002 * 100 / 4)), 1, 1e-6);
  EXPECT_LT(disk.max_deviation_um, 1e-6);

  options.land_mm = 2;
  options.land_z_mm = 9;
  options.mesh_tolerance_mm = 0.02;
  const SolidSummary with_rim = write_lens_step(folder_ / "land.step", surface, options);
  EXPECT_EQ(with_rim.free_edges, 0);
  EXPECT_TRUE(is_watertight(with_rim.mesh));
  // Off by the tolerance over its faces at most.
  EXPECT_NEAR(enclosed_volume_mm3(with_rim.mesh), with_rim.volume_mm3, 0.02 * (kPi * 144 + 24 * kPi * 12));
  EXPECT_NEAR(with_rim.volume_mm3 / (disk.volume_mm3 + 9 * kPi * (144 - 100)), 1, 1e-6);

  options = {};
  options.outline = ellipse(11, 8, 60);
  const SolidSummary loop = write_lens_step(folder_ / "loop.step", surface, options);
  EXPECT_TRUE(loop.valid);
  EXPECT_NEAR(loop.volume_mm3 / (kPi * 88 * (12 - 0.004 * 121 / 4 + 0.002 * 64 / 4)), 1, 1e-5);
}

/// A polygon with corners, star-shaped about the origin; some of its sides are level, upright, or through the middle of a span.
Outline random_star(std::mt19937& random, double radius) {
  Outline outline;
  outline.shape = Outline::Shape::kLoop;
  const int corners = std::uniform_int_distribution(3, 12)(random);
  for (int k = 0; k < corners; ++k) {
    const double angle = 2 * kPi * (k + std::uniform_real_distribution(0.0, 0.7)(random)) / corners;
    Vec2 p = radius * std::uniform_real_distribution(0.35, 1.0)(random) * Vec2(std::cos(angle), std::sin(angle));
    if (k % 3 == 1) p = (p * 2).array().round() / 2;
    outline.loop_mm.push_back(p);
  }
  return outline;
}

Outline rectangle_loop(const Vec2& h) {
  return {Outline::Shape::kLoop, {}, {{-h.x(), -h.y()}, {h.x(), -h.y()}, {h.x(), h.y()}, {-h.x(), h.y()}}};
}

TEST_F(Solid, EveryOutlineMakesAClosedSolid) {
  // Of four tiles and a surface that is no polynomial: sides along the surface's own border, ovals that touch it, any star.
  const SplineSurface flat = paraboloid(Box2::centred({40, 36}), 121, 120, 12, -0.002, 0.001, 0.0015);
  Grid<double> c = flat.coefficients();
  for (int j = 0; j < c.height; ++j) {
    for (int i = 0; i < c.width; ++i) c.at(i, j) += 0.2 * std::sin(0.3 * i) * std::cos(0.2 * j) + 0.02 * std::abs(i - 50 - j);
  }
  const SplineSurface surface(flat.extent(), 121, 120, c);
  std::vector<Outline> outlines{rectangle_loop({18, 16}), rectangle_loop({20, 18}), ellipse(20, 18, 200), ellipse(19.6, 12, 90)};
  // A border of tiles through two places, but for rounding.
  outlines.push_back(ellipse(17, 18, 100));
  std::rotate(outlines.back().loop_mm.begin(), outlines.back().loop_mm.begin() + 10, outlines.back().loop_mm.end());
  std::mt19937 random(7);
  for (int k = 0; k < 4; ++k) outlines.push_back(random_star(random, 18));
  for (std::size_t k = 0; k < outlines.size(); ++k) {
    SolidOptions options;
    options.outline = outlines[k];
    if (k % 2 == 1) {
      options.land_mm = 1.5;
      options.land_z_mm = 4;
      options.mesh_tolerance_mm = 0.1;
    }
    try {
      const SolidSummary solid = write_lens_step(folder_ / "lens.step", surface, options);
      EXPECT_TRUE(solid.valid) << k;
      EXPECT_NEAR(solid.volume_mm3 / solid.expected_volume_mm3, 1, 1e-8) << k;
      EXPECT_LT(solid.max_deviation_um, 1e-6) << k;
    } catch (const std::exception& error) {
      ADD_FAILURE() << k << ": " << error.what();
    }
  }
}

/// Area of a regular polygon or a smooth loop moved inwards by t goes down by P t - k t^2: k is pi for a smooth one, 4 for a
/// rectangle. Both edges' chamfers.
double chamfers_mm3(double perimeter, double k, double c) {
  return 2 * (perimeter * c * c / 2 - k * c * c * c / 3);
}

TEST_F(Solid, ChamferDowelsAndLabelTakeTheirVolumeAndNoMore) {
  const SplineSurface surface = paraboloid(Box2::centred({26, 22}), 26, 22, 12, -0.004, 0.002, 0.003);
  SolidOptions options;
  options.land_mm = 5;
  options.land_z_mm = 9;
  options.mesh_tolerance_mm = 0.02;
  MountOptions mount;
  mount.chamfer_mm = 0.4;
  mount.dowel_diameter_mm = 3;
  mount.label = "7 L";
  mount.label_height_mm = 2;
  mount.label_depth_mm = 0.25;
  constexpr int kDots = 11 + 11;
  const double dot = 0.75 * 2 / 6.75 / 2;
  const double dots_mm3 = kDots * kPi * dot * dot * 0.25;

  const auto held_against = [&](const std::string& what, const Vec2& dowel, double depth, double taken_mm3) {
    options.mount = {};
    const SolidSummary plain = write_lens_step(folder_ / "plain.step", surface, options);
    options.mount = mount;
    options.mount.dowels_mm = {dowel, -dowel};
    options.mount.dowel_depth_mm = depth;
    const SolidSummary mounted = write_lens_step(folder_ / "mounted.step", surface, options);
    EXPECT_TRUE(mounted.valid) << what;
    EXPECT_EQ(mounted.free_edges, 0) << what;
    const double deep = depth > 0 ? depth : 9;
    EXPECT_NEAR(plain.volume_mm3 - mounted.volume_mm3, taken_mm3 + dots_mm3 + 2 * kPi * 1.5 * 1.5 * deep, 2e-6 * plain.volume_mm3) << what;
    EXPECT_TRUE(is_watertight(mounted.mesh)) << what;
    EXPECT_NEAR(enclosed_volume_mm3(mounted.mesh), mounted.volume_mm3, 0.02 * mounted.volume_mm3 / 9) << what;
  };

  options.outline = Outline{Outline::Shape::kDisk, {20, 20}, {}};
  held_against("disk, through", {12.5, 0}, 0, chamfers_mm3(kPi * 30, kPi, 0.4));
  options.outline = Outline{Outline::Shape::kRectangle, {26, 22}, {}};
  mount.label_on_back = true;
  held_against("rectangle, blind, label on the back", {15.5, 0}, 6, chamfers_mm3(2 * (36 + 32), 4, 0.4));
  options.outline = ellipse(11, 8, 60);
  double perimeter = 0;
  const std::vector<Vec2> rim = with_land(*options.outline, 5).loop_mm;
  for (std::size_t k = 0; k < rim.size(); ++k) perimeter += (rim[(k + 1) % rim.size()] - rim[k]).norm();
  held_against("outline", {13.5, 0}, 0, chamfers_mm3(perimeter, kPi, 0.4));
}

TEST(Mount, DowelsAndLettersStandWhereTheyAreSeen) {
  MountOptions mount;
  mount.dowel_diameter_mm = 2;
  mount.dowels_mm = {{12, 3}};
  mount.label = "L";
  mount.label_height_mm = 2;
  const Land land{Outline{Outline::Shape::kRectangle, {20, 16}, {}}, Outline{Outline::Shape::kRectangle, {30, 26}, {}}, 9};
  const std::vector<RoundHole> seen = mount_holes(mount, land);
  ASSERT_GT(seen.size(), 2U);
  EXPECT_EQ(seen[0].middle_mm, Vec2(12, 3));
  EXPECT_EQ(seen[0].from_mm, 0) << "drilled from the back";
  mount.dowel_depth_mm = 4;
  mount.label_on_back = true;
  const std::vector<RoundHole> turned = mount_holes(mount, land);
  ASSERT_EQ(turned.size(), seen.size());
  EXPECT_EQ(turned[0].middle_mm, Vec2(12, 3)) << "places are the lens's, whatever side it is seen from";
  EXPECT_EQ(turned[0].to_mm, 4);
  EXPECT_TRUE(turned[0].open_below && !turned[0].open_above);

  // An L has its stroke at the reader's left, all its height, and a foot below; the land's middle is at y = -10.5.
  const auto dots = [](const std::vector<RoundHole>& holes, double x) {
    std::vector<double> heights;
    for (std::size_t k = 1; k < holes.size(); ++k) {
      if (std::abs(holes[k].middle_mm.x() - x) < 1e-9) heights.push_back(holes[k].middle_mm.y());
    }
    std::sort(heights.begin(), heights.end());
    return heights;
  };
  const double pitch = 2 / 6.75;
  for (const auto& [holes, left] : {std::pair{seen, -2 * pitch}, {turned, 2 * pitch}}) {
    const auto stroke = dots(holes, left), tip = dots(holes, -left);
    ASSERT_EQ(stroke.size(), 7U);
    EXPECT_NEAR(stroke.back() - stroke.front(), 6 * pitch, 1e-9);
    EXPECT_NEAR((stroke.back() + stroke.front()) / 2, -10.5, 1e-9);
    ASSERT_EQ(tip.size(), 1U);
    EXPECT_NEAR(tip[0], stroke.front(), 1e-9) << "its foot is below";
  }
  EXPECT_TRUE(seen[1].open_above && turned[1].open_below);
}

TEST_F(Solid, RefusesMountingFeaturesThatDoNotFitTheLand) {
  const SplineSurface surface = paraboloid(Box2::centred({26, 22}), 26, 22, 12, -0.004, 0.002, 0.003);
  SolidOptions options;
  options.outline = Outline{Outline::Shape::kDisk, {20, 20}, {}};
  const auto refused = [&](const std::string& words, const auto& change) {
    SolidOptions changed = options;
    change(changed);
    try {
      write_lens_step(folder_ / "refused.step", surface, changed);
      ADD_FAILURE() << "not refused: " << words;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
  };
  refused("need a land", [](SolidOptions& o) { o.mount.chamfer_mm = 0.3; });
  options.land_mm = 4;
  options.land_z_mm = 9;
  refused("mount.chamfer_mm = 4 is too large", [](SolidOptions& o) { o.mount.chamfer_mm = 4; });
  refused("x 10.00, y 0.00 mm (4 mm) is not within the land", [](SolidOptions& o) { o.mount.dowels_mm = {{10, 0}}; });
  refused("not within the land", [](SolidOptions& o) { o.mount.dowels_mm = {{0, 0}}; });
  refused("runs into", [](SolidOptions& o) {
    o.mount.dowel_diameter_mm = 2;
    o.mount.dowels_mm = {{12, 0}, {12, 1}};
  });
  refused("leaves no bottom", [](SolidOptions& o) {
    o.mount.dowel_diameter_mm = 2;
    o.mount.dowels_mm = {{12, 0}};
    o.mount.dowel_depth_mm = 9;
  });
  refused("'&' is not among the letters", [](SolidOptions& o) { o.mount.label = "A&B"; });
  refused("mount.label: the hole", [](SolidOptions& o) { o.mount.label = "TOO LONG FOR THE LAND"; });
  EXPECT_TRUE(fs::is_empty(folder_.root()));
}

TEST_F(Solid, IsSilentAndKeepsTheFolderClean) {
  testing::internal::CaptureStdout();
  write_lens_step(folder_ / "deep" / "lens.step", paraboloid(kExtent, 5, 4, 12, 0, 0, 0), {.product_name = "quiet"});
  write_blank_step(folder_ / "deep" / "stock.step", {{50, 40}, 14});
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  int files = 0;
  for ([[maybe_unused]] const auto& entry : fs::directory_iterator(folder_ / "deep")) ++files;
  EXPECT_EQ(files, 2);
}

TEST_F(Solid, RefusesASurfaceThroughTheBackAndLeavesNothing) {
  EXPECT_THROW(write_lens_step(folder_ / "lens.step", paraboloid(kExtent, 5, 4, 0.5, -0.01, 0, 0), {.product_name = "thin"}), InputError);
  EXPECT_TRUE(fs::is_empty(folder_.root()));
}

TEST_F(Solid, AStopLeavesNothing) {
  Monitor monitor;
  int calls = 0;
  monitor.should_stop = [&] { return ++calls > 2; };
  EXPECT_THROW(write_lens_step(folder_ / "lens.step", paraboloid(kExtent, 5, 4, 12, 0, 0, 0), {.product_name = "stopped"}, monitor),
               Stopped);
  EXPECT_TRUE(fs::is_empty(folder_.root()));
}

TEST_F(Solid, AFolderThatCannotBeIsAnIoError) {
  write_whole(folder_ / "file", "not a folder");
  EXPECT_THROW(write_blank_step(folder_ / "file" / "stock.step", {{50, 40}, 14}), IoError);
}

TEST_F(Solid, TheBlankIsABlock) {
  write_blank_step(folder_ / "stock.step", {{50, 40}, 14});
  const std::string text = read_whole(folder_ / "stock.step");
  EXPECT_EQ(count(text, "ADVANCED_FACE"), 6);
  EXPECT_EQ(count(text, "PLANE("), 6);
  // Its eight corners.
  EXPECT_EQ(count(text, "VERTEX_POINT"), 8);
  EXPECT_GT(count(text, "(-25.,-20.,14.)"), 0);
  EXPECT_GT(count(text, "(25.,20.,0.)"), 0);
  EXPECT_THROW(write_blank_step(folder_ / "none.step", {{50, 0}, 14}), InputError);
}

}  // namespace
}  // namespace lightmill

#include "design/target.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <random>
#include <string>

#include "design/core/errors.h"
#include "design/detail/fills.h"
#include "design/detail/svg.h"
#include "design/detail/target_measure.h"
#include "tests/design/drawing_fixture.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;

class TargetTest : public DrawingFixture {};

Vec2 centroid(const TargetLight& target) {
  return detail::spread_of(target, 0).mean;
}

TEST_F(TargetTest, StraightShapesHaveTheirAreas) {
  EXPECT_NEAR(light_of(R"svg(<rect x="120.37" y="10.11" width="31.7" height="17.9" fill="white"/>)svg"), 31.7 * 17.9,
              1e-9);
  EXPECT_NEAR(light_of(R"svg(<polygon points="120,20 150.5,25 133,71.25" fill="white"/>)svg"),
              0.5 * std::abs(30.5 * 51.25 - 13.0 * 5.0), 1e-9);
  EXPECT_NEAR(light_of(R"svg(<path d="m 120 20 h 10 v 5 l -10 0 z" fill="white"/>)svg"), 50, 1e-9);
}

TEST_F(TargetTest, RoundShapesHaveTheirAreasToTheFlatteningTolerance) {
  const auto near = [&](const std::string& body, double area, double perimeter) {
    EXPECT_NEAR(light_of(body), area, perimeter * detail::kFlatteningTolerance_mm) << body;
  };
  near(R"svg(<circle cx="150" cy="50" r="17.3" fill="white"/>)svg", kPi * 17.3 * 17.3, 2 * kPi * 17.3);
  near(R"svg(<ellipse cx="150" cy="50" rx="30" ry="12" fill="white"/>)svg", kPi * 30 * 12, 2 * kPi * 30);
  near(R"svg(<rect x="120" y="20" width="50" height="30" rx="9" ry="5" fill="white"/>)svg", 1500 - (4 - kPi) * 45, 160);
  // A parabola cuts 2/3 off the triangle of its control points [Archimedes].
  near(R"svg(<path d="M120 20 Q140 80 170 20 Z" fill="white"/>)svg", 2.0 / 3 * 0.5 * 50 * 60, 150);
}

TEST_F(TargetTest, FillRules) {
  const std::string outer = "M110.3 10.7H190.3V90.7H110.3Z";
  const std::string same = "M130.9 30.2H160.9V60.2H130.9Z";
  const std::string opposite = "M130.9 30.2V60.2H160.9V30.2Z";
  const auto path = [](const std::string& d, const char* rule) {
    return "<path fill=\"white\" fill-rule=\"" + std::string(rule) + "\" d=\"" + d + "\"/>";
  };
  EXPECT_NEAR(light_of(path(outer + same, "nonzero")), 6400, 1e-7);
  EXPECT_NEAR(light_of(path(outer + same, "evenodd")), 6400 - 900, 1e-7);
  EXPECT_NEAR(light_of(path(outer + opposite, "nonzero")), 6400 - 900, 1e-7);
  // A pentagram: what its own crossings enclose counts by one rule and not by the other.
  std::string star;
  const double r = 38;
  for (int k = 0; k < 5; ++k) {
    const double angle = 0.2 + k * 4 * kPi / 5;
    star +=
        (k ? " L" : "M") + std::to_string(150 + r * std::cos(angle)) + " " + std::to_string(50 + r * std::sin(angle));
  }
  star += "Z";
  const double tip = kPi / 10;  // half the angle at a point of the star
  const double inner = r * std::sin(tip) / std::sin(kPi - tip - kPi / 5);
  const double whole = 10 * 0.5 * r * inner * std::sin(kPi / 5);
  const double core = 5 * 0.5 * inner * inner * std::sin(2 * kPi / 5);
  EXPECT_NEAR(light_of(path(star, "nonzero")), whole, 1e-2);  // six decimals in the path
  EXPECT_NEAR(light_of(path(star, "evenodd")), whole - core, 1e-2);
}

TEST_F(TargetTest, FillsOfRandomPolygonsAreWhatSamplingFinds) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> x(-1.5, 9.5);  // partly outside the grid
  std::uniform_real_distribution<double> y(-1.5, 6.5);
  const Box2 extent{{0, 0}, {8, 5}};
  for (int trial = 0; trial < 12; ++trial) {
    std::vector<std::vector<Vec2>> outlines(2);
    for (auto& outline : outlines) {
      for (int k = 0; k < 5; ++k) outline.emplace_back(x(random), y(random));
    }
    for (const auto rule : {detail::FillRule::kNonZero, detail::FillRule::kEvenOdd}) {
      TargetLight target;
      target.extent = extent;
      target.area_borders = detail::borders_of({{{{outlines, rule}, 0.5, 1, -1, {}}}, {}, {}}, extent);
      const Grid<double> grid = rasterise_area(target, 4, 5);  // pixels of 2 x 1
      constexpr int kSide = 60;
      for (int row = 0; row < 5; ++row) {
        for (int column = 0; column < 4; ++column) {
          int inside = 0;
          for (int s = 0; s < kSide * kSide; ++s) {
            const Vec2 p(2 * (column + (s % kSide + 0.5) / kSide), row + (s / kSide + 0.5) / kSide);
            int winding = 0;
            for (const auto& outline : outlines) {
              for (std::size_t k = 0; k < outline.size(); ++k) {
                const Vec2& a = outline[k];
                const Vec2& b = outline[(k + 1) % outline.size()];
                if ((a.y() <= p.y()) == (b.y() <= p.y())) continue;
                const double at = a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
                if (at < p.x()) winding += a.y() < b.y() ? 1 : -1;
              }
            }
            inside += rule == detail::FillRule::kNonZero ? winding != 0 : winding % 2 != 0;
          }
          EXPECT_NEAR(grid.at(column, row), inside / double(kSide * kSide), 0.03) << "seed 7, trial " << trial;
        }
      }
    }
  }
}

TEST_F(TargetTest, NestedTransformsMultiply) {
  // Inside out: skew, scale, rotate, move.
  const TargetLight target =
      load_target(drawing(R"svg(<g transform="translate(120, 30) rotate(30)"><g transform="scale(2 3) skewX(20)">
    <rect x="1" y="2" width="6" height="4" fill="white" transform="matrix(1 0 0 1 0.5 0)"/></g></g>)svg"));
  const double c = std::cos(kPi / 6);
  const double s = std::sin(kPi / 6);
  const Vec2 skewed(4.5 + 4 * std::tan(20 * kPi / 180), 4);
  const Vec2 scaled(2 * skewed.x(), 3 * skewed.y());
  const Vec2 user(120 + c * scaled.x() - s * scaled.y(), 30 + s * scaled.x() + c * scaled.y());
  EXPECT_LT((centroid(target) - Vec2(user.x() - 100, 50 - user.y())).norm(), 1e-9);
  EXPECT_NEAR(light_of(R"svg(<g transform="translate(120, 30) rotate(30)"><g transform="scale(2 3) skewX(20)">
    <rect x="1" y="2" width="6" height="4" fill="white"/></g></g>)svg"),
              24 * 6, 1e-9);
  EXPECT_NEAR(
      light_of(
          R"svg(<g transform="rotate(-15 150 50)"><rect x="140" y="40" width="6" height="4" fill="white"/></g>)svg"),
      24, 1e-9);
}

TEST_F(TargetTest, UseDrawsAgainWhereItSays) {
  const std::string body = R"svg(<defs><rect id="r" x="0" y="0" width="10" height="5"/></defs>
    <use href="#r" x="120" y="20" fill="white"/><use href="#r" transform="translate(150 60) scale(2)" style="fill:#fff"/>)svg";
  EXPECT_NEAR(light_of(body), 50 + 200, 1e-9);
}

TEST_F(TargetTest, ColoursBecomeLinearLight) {
  const auto square = [&](const std::string& attributes) {
    return light_of("<rect x=\"120\" y=\"20\" width=\"10\" height=\"10\" " + attributes + "/>") / 100;
  };
  EXPECT_NEAR(square("fill=\"white\""), 1, 1e-12);
  EXPECT_NEAR(square("fill=\"#fff\""), 1, 1e-12);
  EXPECT_NEAR(square("fill=\"#808080\""), 0.215860500, 1e-8);  // IEC 61966-2-1
  EXPECT_NEAR(square("fill=\"gray\""), 0.215860500, 1e-8);
  EXPECT_NEAR(square("fill=\"rgb(128,128,128)\""), 0.215860500, 1e-8);
  EXPECT_NEAR(square("fill=\"red\""), 0.2126, 1e-12);
  EXPECT_NEAR(square("fill=\"hsl(120, 100%, 50%)\""), 0.7152, 1e-12);
  EXPECT_NEAR(square("fill=\"white\" opacity=\"0.5\" fill-opacity=\"0.5\""), 0.25, 1e-12);
  EXPECT_NEAR(square("style=\"fill:white;opacity:50%\" fill=\"black\""), 0.5, 1e-12);
  EXPECT_NEAR(square("fill=\"#ffffff80\""), 128 / 255.0, 1e-12);
  EXPECT_NEAR(square(""), 0, 1e-12);  // black by default
}

TEST_F(TargetTest, LaterFillsCoverEarlierOnesAsInAViewer) {
  EXPECT_NEAR(
      light_of(
          R"svg(<rect x="120" y="20" width="40" height="40" fill="white"/><rect x="130" y="30" width="10" height="20"/>)svg"),
      1600 - 200, 1e-9);
}

TEST_F(TargetTest, StrokesCarryLuminanceTimesWidthTimesLength) {
  const TargetLight target = load_target(drawing(R"svg(
    <path d="M10 50h30" fill="none" stroke="white" stroke-width="2"/>
    <circle cx="150" cy="50" r="20" fill="none" stroke="white" stroke-opacity="0.5"/>
    <g transform="scale(0.5)"><line x1="100" y1="20" x2="100" y2="60" stroke="white" stroke-width="3"/></g>)svg"));
  ASSERT_EQ(target.curves.size(), 3U);
  EXPECT_TRUE(target.area_flux.empty());
  const double shares[] = {2 * 30, 0.5 * 2 * kPi * 20, 1.5 * 20};
  const double sum = shares[0] + shares[1] + shares[2];
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(target.curves[k].flux(), shares[k] / sum, 1e-4);
  // No chord of the circle is farther from it than the tolerance, and no vertex off it.
  const auto& circle = target.curves[1].vertices_mm;
  EXPECT_EQ(circle.front(), circle.back());
  for (std::size_t k = 0; k + 1 < circle.size(); ++k) {
    EXPECT_NEAR((circle[k] - Vec2(50, 0)).norm(), 20, 1e-9);
    EXPECT_GT(((circle[k] + circle[k + 1]) / 2 - Vec2(50, 0)).norm(), 20 - detail::kFlatteningTolerance_mm);
  }
}

TEST_F(TargetTest, StrokesEndAtThePicturesBorder) {
  const TargetLight target = load_target(drawing(R"svg(<path d="M-50 20 H250" fill="none" stroke="white"/>
    <path d="M100 -100 V40" fill="none" stroke="white"/>)svg"));
  ASSERT_EQ(target.curves.size(), 2U);
  EXPECT_NEAR(target.curves[0].flux() / target.curves[1].flux(), 200.0 / 40, 1e-12);
  for (const auto& curve : target.curves) {
    for (const auto& v : curve.vertices_mm) EXPECT_TRUE(target.extent.contains(v));
  }
}

TEST_F(TargetTest, DashesAreTheirShareOfTheStroke) {
  // Dashes of 3 and 1 with gaps of 2 and 4, entered 1 into the first: [0,2] [4,5] [9,12] [14,15] [19,20].
  TargetLight target = load_target(drawing(
      R"svg(<path d="M10 50h8v12" fill="none" stroke="white" stroke-dasharray="3,2 1 4" stroke-dashoffset="1"/>)svg"));
  const double lengths[] = {2, 1, 3, 1, 1};
  ASSERT_EQ(target.curves.size(), 5U);
  for (int k = 0; k < 5; ++k) EXPECT_NEAR(target.curves[k].flux(), lengths[k] / 8, 1e-12) << k;
  EXPECT_LT((target.curves[0].vertices_mm.front() - Vec2(-90, 0)).norm(), 1e-12);
  EXPECT_LT((target.curves[2].vertices_mm.front() - Vec2(-82, -1)).norm(), 1e-12);
  // A dash turns the corner; an odd list counts twice; a negative offset walks back.
  target = load_target(drawing(
      R"svg(<path d="M10 50h8v12" fill="none" stroke="white" stroke-dasharray="5" stroke-dashoffset="-7"/>)svg"));
  ASSERT_EQ(target.curves.size(), 3U);  // [0,2] [7,12] [17,20]
  EXPECT_EQ(target.curves[1].vertices_mm.size(), 3U);
  EXPECT_NEAR(target.curves[1].flux(), 0.5, 1e-12);
  // Dashes are lengths in user units, before the transform.
  target = load_target(
      drawing(R"svg(<path transform="scale(4 2)" d="M5 5h10" fill="none" stroke="white" stroke-dasharray="1 9"/>)svg"));
  ASSERT_EQ(target.curves.size(), 1U);
  EXPECT_NEAR((target.curves[0].vertices_mm.back() - target.curves[0].vertices_mm.front()).norm(), 4, 1e-12);
  target = load_target(drawing(R"svg(<path d="M0 0h9" stroke="white" fill="none" stroke-dasharray="1 -1"/>)svg"));
  EXPECT_THAT(target.warnings.front(), HasSubstr("drawing.svg:2: stroke-dasharray"));
  EXPECT_EQ(target.curves.size(), 1U);
}

TEST_F(TargetTest, DataFluxVariesTheDensityAlongArcLength) {
  TargetLight target = load_target(drawing(
      R"svg(<path d="M10 50h30v10" data-flux="1 3 0" fill="none" stroke="white"/><path d="M90 10h25" fill="none" stroke="white"/>)svg"));
  ASSERT_EQ(target.curves.size(), 2U);
  EXPECT_NEAR(target.curves[0].flux() / target.curves[1].flux(), (30 * 2 + 10 * 1.5) / 25, 1e-12);
  EXPECT_NEAR(target.curves[0].density_per_mm[1] / target.curves[0].density_per_mm[0], 3, 1e-12);
  // Along a quarter circle: linear in the angle. The flux is the mean density times the length.
  target = load_target(drawing(
      R"svg(<path d="M130 50A20 20 0 0 1 150 70" data-flux="2 6" fill="none" stroke="white" stroke-width="2"/>)svg"));
  const CurveLight& arc = target.curves.front();
  const double scale = arc.density_per_mm.front() / 2;
  double length = 0;
  for (std::size_t k = 0; k < arc.vertices_mm.size(); ++k) {
    if (k > 0) length += (arc.vertices_mm[k] - arc.vertices_mm[k - 1]).norm();
    EXPECT_NEAR(arc.density_per_mm[k] / scale, 2 + 4 * length / (10 * kPi), 1e-3);
  }
  // A closed path comes back to its first value, and dashes carry the density where they lie.
  target = load_target(drawing(
      R"svg(<path d="M10 10h10v10h-10z" data-flux="1 0 0 0" fill="none" stroke="white" stroke-dasharray="5"/>)svg"));
  ASSERT_EQ(target.curves.size(), 2U);  // the first halves of the first and the last side; the others are dark
  const double sides[] = {5 * 0.75, 5 * 0.25};
  EXPECT_NEAR(target.curves[0].flux(), sides[0] / (sides[0] + sides[1]), 1e-12);
}

TEST_F(TargetTest, DataFluxOfAnotherCountIsNamed) {
  const TargetLight target = load_target(drawing(
      R"svg(<path d="M0 9h9v9" data-flux="1 2" fill="none" stroke="white"/><path d="M0 5h9" stroke="white" fill="none"/>)svg"));
  ASSERT_EQ(target.warnings.size(), 1U);
  EXPECT_THAT(target.warnings[0], HasSubstr("drawing.svg:2: data-flux has 2 values, but the path has 3 vertices"));
  EXPECT_EQ(target.curves.size(), 1U);
}

TEST_F(TargetTest, CurveFluxIsTheShareOfTheCurves) {
  TargetSpec spec;
  spec.image = LIGHTMILL_FIXTURES "/pictures/astronaut.png";
  spec.drawing = LIGHTMILL_FIXTURES "/pictures/signature.svg";
  for (const double share : {0.1, 0.5, -1.0}) {
    spec.curve_flux = share;
    const TargetLight target = load_target(spec);
    EXPECT_NEAR(target.total(), 1, 1e-12);
    EXPECT_NEAR(target.curve_total(), share < 0 ? 0.5 : share, 1e-12);
    EXPECT_TRUE(target.warnings.empty());
    // Bottom right, as the reader sees it.
    const Grid<double> seen = as_seen(rasterise({target.extent, {}, {}, target.curves, {}, {}}, 4, 4), spec.viewed_from);
    EXPECT_NEAR(seen.at(2, 3) + seen.at(3, 3), target.curve_total(), 1e-12);
  }
}

TEST_F(TargetTest, PointsShareByTheirFlux) {
  TargetLight target = load_target(drawing(
      R"svg(<circle class="point" data-flux="3" cx="20" cy="10"/><circle class="bright point" data-flux="7" cx="150" cy="80"/>)svg"));
  ASSERT_EQ(target.points.size(), 2U);
  EXPECT_NEAR(target.points[0].flux, 0.3, 1e-15);
  EXPECT_NEAR(target.points[1].flux, 0.7, 1e-15);
  EXPECT_LT((target.points[0].position_mm - Vec2(-80, 40)).norm(), 1e-12);
  EXPECT_LT((target.points[1].position_mm - Vec2(50, -30)).norm(), 1e-12);
  // All strokes together count one.
  target = load_target(drawing(
      R"svg(<circle class="point" data-flux="3" cx="20" cy="10"/><path d="M0 0H50" stroke="white" fill="none"/>)svg"));
  EXPECT_NEAR(target.points[0].flux, 0.75, 1e-12);
  EXPECT_NEAR(target.curve_total(), 0.25, 1e-12);
}

TEST_F(TargetTest, APictureRunsAsItsReaderSeesIt) {
  for (const auto viewed_from : {ViewedFrom::kLens, ViewedFrom::kBehind}) {
    TargetSpec spec;
    spec.drawing = LIGHTMILL_FIXTURES "/pictures/letter_f.svg";
    spec.viewed_from = viewed_from;
    const TargetLight target = load_target(spec);
    // The stem of an F is on the reader's left: at +X for someone at the lens.
    EXPECT_EQ(centroid(target).x() > 0, viewed_from == ViewedFrom::kLens);
    EXPECT_GT(centroid(target).y(), 0);
    const Grid<double> seen = as_seen(rasterise(target, 10, 10), viewed_from);
    EXPECT_GT(seen.at(3, 8), 0);  // foot of the stem
    EXPECT_EQ(seen.at(6, 8), 0);
    EXPECT_GT(seen.at(6, 2), 0);  // upper arm
  }
}

TEST_F(TargetTest, AnImagesTopLeftIsWhereTheReaderLooksForIt) {
  // Light grows towards the top left; a portable gray map is 8-bit sRGB.
  TargetSpec spec;
  spec.image = write("corner.pgm", "P2\n3 2\n255\n255 0 0\n0 0 0\n");
  spec.size_mm = {90, 40};
  spec.viewed_from = ViewedFrom::kLens;
  EXPECT_LT((centroid(load_target(spec)) - Vec2(30, 10)).norm(), 1e-12);
  spec.viewed_from = ViewedFrom::kBehind;
  EXPECT_LT((centroid(load_target(spec)) - Vec2(-30, 10)).norm(), 1e-12);
}

TEST_F(TargetTest, ImageAndFillsAdd) {
  TargetSpec spec = drawing(
      R"svg(<rect x="100" y="0" width="100" height="100" fill="white"/><rect x="0" y="0" width="1" height="1" fill="black"/>)svg");
  spec.image = write("white.pgm", "P2\n2 1\n255\n255 255\n");
  const TargetLight target = load_target(spec);
  const Grid<double> halves = rasterise(target, 2, 1);
  EXPECT_NEAR(halves.at(0, 0), 1.0 / 3, 1e-12);
  EXPECT_NEAR(halves.at(1, 0), 2.0 / 3, 1e-12);
}

TEST_F(TargetTest, BackgroundIsAShareOfTheMean) {
  TargetSpec spec;
  spec.image = write("half.pgm", "P2\n2 1\n255\n255 0\n");
  spec.background = 0.1;
  spec.viewed_from = ViewedFrom::kBehind;
  EXPECT_NEAR(load_target(spec).area_flux.at(1, 0), 0.05 / 1.1, 1e-12);
}

TEST_F(TargetTest, BackgroundLiesUnderDrawingsToo) {
  TargetSpec spec = drawing(R"svg(<rect width="50" height="100" fill="white"/>)svg");
  spec.background = 0.2;
  const Grid<double> quarters = rasterise(load_target(spec), 4, 1);
  EXPECT_NEAR(quarters.at(0, 0), 1.05 / 1.2, 1e-12);
  EXPECT_NEAR(quarters.at(3, 0), 0.05 / 1.2, 1e-12);
}

TEST_F(TargetTest, RasteriseKeepsAllFluxInItsPlace) {
  TargetLight target;
  target.extent = {{-30, -10}, {50, 30}};
  target.area_flux = Grid<double>(7, 5);
  std::mt19937 random(3);
  for (double& flux : target.area_flux.values) flux = std::uniform_real_distribution<double>(0, 1)(random);
  target.curves = {{{{-29, 3}, {49, 3}, {49, 29}}, {1, 3, 0}}};
  target.points = {{{50, 30}, 0.25}};
  target.normalise();
  for (const auto& [w, h] : {std::pair(1, 1), std::pair(16, 9), std::pair(3, 50)}) {
    const Grid<double> grid = rasterise(target, w, h);
    EXPECT_NEAR(std::accumulate(grid.values.begin(), grid.values.end(), 0.0), 1, 1e-13);
  }
  // A curve along a row: flux per cell is the integral of its density.
  TargetLight line;
  line.extent = {{0, 0}, {10, 10}};
  line.curves = {{{{0, 2.5}, {10, 2.5}}, {0, 2}}};
  const Grid<double> grid = rasterise(line, 5, 2);
  for (int k = 0; k < 5; ++k) EXPECT_NEAR(grid.at(k, 0), 0.4 * (2 * k + 1), 1e-13);
}

std::string complaint(const TargetSpec& spec) {
  try {
    load_target(spec);
  } catch (const InputError& e) {
    return e.what();
  }
  return "no complaint";
}

TEST_F(TargetTest, BadInputsAreNamed) {
  TargetSpec black;
  black.image = write("black.pgm", "P2\n2 2\n255\n0 0 0 0\n");
  EXPECT_THAT(complaint(black), HasSubstr("all black"));
  TargetSpec broken;
  broken.image = write("broken.png", "\x89PNG\r\n\x1a\nnothing");
  EXPECT_THAT(complaint(broken), HasSubstr("broken.png"));
  EXPECT_THAT(complaint(drawing(R"svg(<path d="M0 0 H10 V10 Z"/>)svg")), HasSubstr("nothing that shines"));
  EXPECT_THAT(complaint(drawing("<text>hello</text>")), HasSubstr("turn text into paths"));
  EXPECT_THAT(complaint(drawing("<g>\n<rect></g>")), HasSubstr("drawing.svg:3"));
  TargetSpec sizeless;
  sizeless.drawing = write("sizeless.svg", "<svg><rect width=\"1\" height=\"1\" fill=\"white\"/></svg>");
  EXPECT_THAT(complaint(sizeless), HasSubstr("viewBox"));
  TargetSpec nothing;
  EXPECT_THAT(complaint(nothing), HasSubstr("give an image"));
  TargetSpec absent;
  absent.drawing = folder_ / "absent.svg";
  EXPECT_THAT(complaint(absent), HasSubstr("absent.svg"));
  TargetSpec share = drawing(R"svg(<rect width="1" height="1" fill="white"/>)svg");
  share.curve_flux = 1.5;
  EXPECT_THAT(complaint(share), HasSubstr("1.5"));
}

TEST_F(TargetTest, WhatIsNotUnderstoodIsAWarningWithItsLine) {
  const TargetLight target = load_target(
      drawing("<rect width=\"9\" height=\"9\" fill=\"white\"/>\n<rect width=\"9\" height=\"9\" fill=\"url(#g)\"/>\n"
              "<blob/>\n<g transform=\"wobble(3)\"><rect/></g>\n<path d=\"M0 0 L5 5 L!\" fill=\"white\"/>"));
  ASSERT_EQ(target.warnings.size(), 4U);
  EXPECT_THAT(target.warnings[0], HasSubstr("drawing.svg:3: paint \"url(#g)\""));
  EXPECT_THAT(target.warnings[1], HasSubstr("drawing.svg:4: <blob>"));
  EXPECT_THAT(target.warnings[2], HasSubstr("drawing.svg:5: transform"));
  EXPECT_THAT(target.warnings[3], HasSubstr("drawing.svg:6: path data"));
}

TEST_F(TargetTest, ExplodingUsesAndDeepNestingAreRefused) {
  std::string body = R"svg(<rect id="u0" width="1" height="1" fill="white"/>)svg";
  for (int k = 1; k < 14; ++k) {
    const std::string one = "<use href=\"#u" + std::to_string(k - 1) + "\"/>";
    body += "<g id=\"u" + std::to_string(k) + "\">";
    for (int copy = 0; copy < 10; ++copy) body += one;
    body += "</g>";
  }
  EXPECT_THROW(load_target(drawing(body)), InputError);
  std::string deep;
  for (int k = 0; k < 5000; ++k) deep += "<g>";
  deep += R"svg(<rect width="9" height="9" fill="white"/>)svg";
  for (int k = 0; k < 5000; ++k) deep += "</g>";
  EXPECT_THROW(load_target(drawing(deep)), InputError);
}

TEST_F(TargetTest, AUseThatContainsItselfEnds) {
  const TargetLight target =
      load_target(drawing(R"svg(<g id="a"><rect width="9" height="9" fill="white"/><use href="#a" x="10"/></g>)svg"));
  EXPECT_THAT(target.warnings.back(), HasSubstr("too deeply"));
}

}  // namespace
}  // namespace lightmill

#include "design/detail/svg.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "design/core/errors.h"
#include "design/detail/svg_gradient.h"
#include "tests/design/drawing_fixture.h"

namespace lightmill {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class SvgTest : public DrawingFixture {
 protected:
  /// Light in each of 20 x 10 squares of 10 mm, row 0 at the bottom, in units of white area.
  Grid<double> squares(const TargetSpec& spec) const {
    const detail::Drawing drawing = detail::read_drawing(spec.drawing, spec.size_mm, spec.viewed_from);
    TargetLight target;
    target.extent = Box2::centred(spec.size_mm);
    target.area_borders = detail::borders_of(drawing.shapes, target.extent);
    return rasterise_area(target, 20, 10);
  }
  std::vector<std::string> warnings(const std::string& body) const {
    return load_target(drawing(R"svg(<rect x="190" width="1" height="1" fill="white"/>)svg" + body)).warnings;
  }
};

double srgb_to_linear(double code) {
  return code <= 0.04045 ? code / 12.92 : std::pow((code + 0.055) / 1.055, 2.4);
}

/// Of a function over [0, 1].
template <typename F>
double mean(const F& f) {
  double sum = 0;
  constexpr int kSteps = 20000;
  for (int k = 0; k < kSteps; ++k) sum += f((k + 0.5) / kSteps) / kSteps;
  return sum;
}

TEST_F(SvgTest, StyleSheetsApplyByTypeClassAndId) {
  const std::string square = R"(x="120" y="20" width="10" height="10")";
  const auto light = [&](const std::string& css, const std::string& attributes) {
    return light_of("<style>" + css + "</style><rect " + square + " " + attributes + "/>") / 100;
  };
  EXPECT_NEAR(light("rect { fill: white }", ""), 1, 1e-12);
  EXPECT_NEAR(light("/* a { */ circle, .a , path{fill:white;}", "class=\"b a\""), 1, 1e-12);
  EXPECT_NEAR(light("#it{fill:white}", "id=\"it\""), 1, 1e-12);
  EXPECT_NEAR(light("rect.a.b{fill:white}", "class=\"a\""), 0, 1e-12);
  EXPECT_NEAR(light("rect.a.b{fill:white}", "class=\"b x a\""), 1, 1e-12);
  EXPECT_NEAR(light("*{fill:white}", ""), 1, 1e-12);
  EXPECT_NEAR(light("<![CDATA[ .a{fill:white} ]]>", "class=\"a\""), 1, 1e-12);
  // Weakest first: attribute, type, class, id, the later of two, the style attribute, what is important.
  EXPECT_NEAR(light("rect{fill:white}", "fill=\"black\""), 1, 1e-12);
  EXPECT_NEAR(light(".a{fill:white}rect{fill:black}", "class=\"a\""), 1, 1e-12);
  EXPECT_NEAR(light("#it{fill:white}.a{fill:black}", "class=\"a\" id=\"it\""), 1, 1e-12);
  EXPECT_NEAR(light(".a{fill:black}.b{fill:white}", "class=\"b a\""), 1, 1e-12);
  EXPECT_NEAR(light("#it{fill:black}", "id=\"it\" style=\"fill:white\""), 1, 1e-12);
  EXPECT_NEAR(light("rect{fill:white ! important}", "style=\"fill:black\""), 1, 1e-12);
  EXPECT_NEAR(light("rect{fill:black!important}", "style=\"fill:white!important\""), 1, 1e-12);
}

TEST_F(SvgTest, StyleThatIsNotUnderstoodIsNamedWithItsLine) {
  const auto found =
      load_target(drawing("<style>\n@media print { rect { fill: black } }\ng > rect { fill: black }\n"
                          "rect { fill: white; wobble: 3;\n  sparkle }\n</style>\n"
                          "<rect width=\"9\" height=\"9\" style=\"shimmer:1; font-size:3px; mask:url(#m)\"/>"))
          .warnings;
  ASSERT_EQ(found.size(), 6U);
  EXPECT_THAT(found[0], HasSubstr("drawing.svg:3: style rule \"@media print\""));
  EXPECT_THAT(found[1], HasSubstr("drawing.svg:4: selector \"g > rect\""));
  EXPECT_THAT(found[2], HasSubstr("drawing.svg:5: property \"wobble\""));
  EXPECT_THAT(found[3], HasSubstr("drawing.svg:6: style \"sparkle\""));
  EXPECT_THAT(found[4], HasSubstr("drawing.svg:8: property \"shimmer\""));
  EXPECT_THAT(found[5], HasSubstr("drawing.svg:8: mask \"url(#m)\""));
}

TEST_F(SvgTest, AViewBoxIsFittedAsPreserveAspectRatioSays) {
  // A square page with light in its lower left quarter, on a picture twice as wide.
  const auto quarter = [&](const std::string& ratio) {
    const Grid<double> light =
        squares(whole("<svg viewBox=\"10 20 50 50\" " + ratio +
                      "><rect x=\"10\" y=\"45\" width=\"25\" height=\"25\" fill=\"white\"/></svg>"));
    Box2 box;
    for (int row = 0; row < 10; ++row) {
      for (int column = 0; column < 20; ++column) {
        if (light.at(column, row) < 99.9) continue;
        box.include(Vec2(column, row));
        box.include(Vec2(column + 1, row + 1));
      }
    }
    return std::vector<double>{box.min.x(), box.max.x(), box.min.y(), box.max.y()};
  };
  EXPECT_THAT(quarter(""), ElementsAre(5, 10, 0, 5));
  EXPECT_THAT(quarter("preserveAspectRatio=\"xMidYMid meet\""), ElementsAre(5, 10, 0, 5));
  EXPECT_THAT(quarter("preserveAspectRatio=\"xMinYMax\""), ElementsAre(0, 5, 0, 5));
  EXPECT_THAT(quarter("preserveAspectRatio=\"xMaxYMin meet\""), ElementsAre(10, 15, 0, 5));
  EXPECT_THAT(quarter("preserveAspectRatio=\"none\""), ElementsAre(0, 10, 0, 5));
  EXPECT_THAT(quarter("preserveAspectRatio=\"xMinYMax slice\""), ElementsAre(0, 10, 0, 10));
  EXPECT_THAT(quarter("preserveAspectRatio=\"xMidYMid slice\""), ElementsAre(0, 10, 0, 5));
  // The page is what a viewer shows: twice as wide as its view box here, and as wide as the picture.
  EXPECT_THAT(quarter("width=\"40mm\" height=\"2cm\""), ElementsAre(5, 10, 0, 5));
  EXPECT_THAT(quarter("width=\"40mm\" height=\"20mm\" preserveAspectRatio=\"none\""), ElementsAre(0, 10, 0, 5));
  EXPECT_THAT(quarter("width=\"100%\" height=\"50%\""), ElementsAre(5, 10, 0, 5));
  EXPECT_THAT(quarter("width=\"10mm\""), ElementsAre(5, 10, 0, 5));
}

TEST_F(SvgTest, LightBesideThePictureIsCutAndSaid) {
  TargetSpec spec = whole(R"svg(<svg viewBox="0 0 100 100" preserveAspectRatio="xMidYMid slice">
<rect width="400" height="400" x="-100" y="-100"/>
<rect width="100" height="50" fill="white"/>
<path d="M0 0V100" stroke="white"/><path d="M50 50h9" stroke="white"/></svg>)svg");
  EXPECT_THAT(
      load_target(spec).warnings,
      ElementsAre(HasSubstr("drawing.svg:3: reaches out of the picture and is cut at its border (and so at 1 more")));
  spec = whole(
      "<svg viewBox=\"0 0 200 100\"><rect width=\"200\" height=\"100\" fill=\"white\"/>\n<circle class=\"point\" "
      "cx=\"201\" cy=\"9\"/></svg>");
  EXPECT_THAT(load_target(spec).warnings, ElementsAre(HasSubstr("drawing.svg:2: a point lies outside")));
}

TEST_F(SvgTest, LightBesideThePageIsCutAndSaid) {
  // A square page in the middle of a picture twice as wide.
  const auto drawn = [&](const std::string& attributes) {
    return whole("<svg viewBox=\"0 0 50 50\" " + attributes +
                 "><rect x=\"-20\" width=\"45\" height=\"50\" fill=\"white\"/>"
                 "<path d=\"M10 10H70\" stroke=\"white\"/>\n<circle class=\"point\" cx=\"60\" cy=\"9\"/></svg>");
  };
  const TargetLight target = load_target(drawn(""));
  EXPECT_THAT(target.warnings, ElementsAre(HasSubstr("drawing.svg:2: a point lies outside"),
                                           HasSubstr("drawing.svg:1: reaches out of the picture and is cut")));
  const Grid<double> light = squares(drawn(""));
  for (int row = 0; row < 10; ++row) {
    for (int column = 0; column < 20; ++column) EXPECT_EQ(light.at(column, row) > 0, column >= 5 && column < 10);
  }
  ASSERT_EQ(target.curves.size(), 1U);
  EXPECT_NEAR(target.curves[0].vertices_mm.back().x(), 50, 1e-9);
  EXPECT_EQ(load_target(drawn("overflow=\"visible\"")).points.size(), 1U);
}

TEST_F(SvgTest, NestedPagesPlaceAndClip) {
  const auto in = [&](const std::string& attributes) {
    return light_of("<svg x=\"120\" y=\"20\" width=\"40\" height=\"20\" " + attributes +
                    "><rect width=\"10\" height=\"30\" fill=\"white\"/></svg>");
  };
  EXPECT_NEAR(in(""), 10 * 20, 1e-9);  // cut at its border
  EXPECT_NEAR(in("overflow=\"visible\""), 10 * 30, 1e-9);
  EXPECT_NEAR(in("viewBox=\"0 0 40 40\""), 5 * 15, 1e-9);
  EXPECT_NEAR(in("viewBox=\"0 0 40 40\" preserveAspectRatio=\"none\""), 10 * 15, 1e-9);
  EXPECT_NEAR(in("viewBox=\"0 0 40 40\" preserveAspectRatio=\"xMinYMin slice\""), 10 * 20, 1e-9);
  // Percentages are of the page that they are in.
  EXPECT_NEAR(
      light_of(
          R"svg(<svg x="60%" width="20%" height="40%" viewBox="0 0 10 10"><rect width="50%" height="50%" fill="white"/></svg>)svg"),
      20 * 20, 1e-9);
}

TEST_F(SvgTest, SymbolsFillTheSpaceThatTheirUseGives) {
  const std::string symbol =
      R"svg(<symbol id="s" viewBox="0 0 10 10"><rect width="5" height="20" fill="white"/></symbol>)svg";
  EXPECT_NEAR(light_of(symbol + R"svg(<use href="#s" x="120" y="10" width="20" height="40"/>)svg"), 10 * 30, 1e-9);
  EXPECT_NEAR(
      light_of(symbol + R"svg(<use xlink:href="#s" x="120" y="10" width="20" height="20" transform="scale(1 2)"/>)svg"),
      10 * 40, 1e-9);
  EXPECT_NEAR(
      light_of(
          R"svg(<symbol id="s"><rect width="5" height="7" class="k"/></symbol><style>.k{fill:white}</style><use href="#s" x="120" y="10"/>)svg"),
      35, 1e-9);
  EXPECT_THAT(warnings("\n<use href=\"other.svg#s\"/>"),
              ElementsAre(HasSubstr("drawing.svg:3: <use> of \"other.svg#s\"")));
}

TEST_F(SvgTest, LengthsHaveUnits) {
  const double mm = 96 / 25.4;
  for (const auto& [text, user] : std::initializer_list<std::pair<const char*, double>>{{"2mm", 2 * mm},
                                                                                        {"1cm", 10 * mm},
                                                                                        {"0.25in", 24},
                                                                                        {"9pt", 12},
                                                                                        {"1pc", 16},
                                                                                        {"7px", 7},
                                                                                        {"5%", 10},
                                                                                        {"1.5em", 15},
                                                                                        {"2rem", 32},
                                                                                        {"4Q", mm},
                                                                                        {"3E0", 3}}) {
    EXPECT_NEAR(light_of("<rect x=\"120\" y=\"5\" height=\"10\" fill=\"white\" font-size=\"10\" width=\"" +
                         std::string(text) + "\"/>"),
                10 * user, 1e-9)
        << text;
  }
  EXPECT_THAT(warnings("\n<rect width=\"3parsec\" height=\"1\"/>"),
              ElementsAre(HasSubstr("drawing.svg:3: width = \"3parsec\" is not a length")));
}

TEST_F(SvgTest, TransformsAreThoseOfAttributesAndOfStyle) {
  const auto at = [&](const std::string& transform) {
    const TargetLight target =
        load_target(drawing("<g " + transform + "><circle class=\"point\" cx=\"30\" cy=\"10\"/></g>"));
    return Vec2(target.points.front().position_mm.x() + 100, 50 - target.points.front().position_mm.y());
  };
  const auto near = [&](const std::string& transform, const Vec2& wanted) {
    EXPECT_LT((at("transform=\"" + transform + "\"") - wanted).norm(), 1e-9) << transform;
    EXPECT_LT((at("style=\"transform:" + transform + "\"") - wanted).norm(), 1e-9) << transform;
  };
  near("translate(5) , translate(0,7)", {35, 17});
  near("translate(5px, 7px)", {35, 17});
  near("translateX(5)translateY(-7px)", {35, 3});
  near("scale(2 3)", {60, 30});
  near("scaleX(2) scaleY(4)", {60, 40});
  near("translate(50 10)rotate(90)", {40, 40});
  near("translate(50 10)rotate(0.25turn)", {40, 40});
  near("rotate(90deg 20 10)", {20, 20});
  near("skewX(45)", {40, 10});
  near("matrix(0 1 1 0 1 2)", {11, 32});
  EXPECT_THAT(warnings("\n<g transform=\"rotate(1foo)\"/>"),
              ElementsAre(HasSubstr("drawing.svg:3: transform \"rotate(1foo)\" is not understood; <g> is left out")));
}

TEST_F(SvgTest, AGroupWithOpacityIsOneLayer) {
  const std::string two =
      R"svg(<rect x="120" y="20" width="20" height="10" fill="white"/><rect x="130" y="20" width="20" height="10" fill="white"/>)svg";
  EXPECT_NEAR(light_of("<g opacity=\"0.5\">" + two + "</g>"), 300 * 0.5, 1e-9);
  EXPECT_NEAR(light_of("<g fill-opacity=\"0.5\">" + two + "</g>"), 200 * 0.5 + 100 * 0.75, 1e-9);
  // Layers within layers, over what lies beneath.
  EXPECT_NEAR(
      light_of(
          R"svg(<rect x="110" y="20" width="60" height="10" fill="white"/><g opacity="0.5"><g opacity="0.5"><rect x="120" y="20" width="20" height="10"/></g>
      <rect x="130" y="20" width="20" height="10"/></g>)svg"),
      600 - 100 * 0.25 - 200 * 0.5, 1e-9);
  EXPECT_NEAR(light_of("<g style=\"opacity:0.5\"><rect x=\"110\" y=\"20\" width=\"60\" height=\"10\" fill=\"white\" "
                       "opacity=\"0.5\"/></g>"),
              150, 1e-9);
}

TEST_F(SvgTest, ClipPathsCutFillsStrokesAndPoints) {
  const std::string clip =
      R"svg(<clipPath id="c"><circle cx="150" cy="50" r="10"/><rect x="155" y="45" width="20" height="10"/></clipPath>
      <clipPath id="h"><path clip-rule="evenodd" d="M130 30h40v40h-40z M140 40h20v20h-20z"/></clipPath>
      <clipPath id="b" clipPathUnits="objectBoundingBox"><rect width="0.5" height="0.25"/></clipPath>)svg";
  const std::string all = R"svg(<rect x="110" y="10" width="80" height="80" fill="white")svg";
  EXPECT_NEAR(light_of(clip + all + " clip-path=\"url(#h)\"/>"), 1600 - 400, 1e-9);
  EXPECT_NEAR(light_of(clip + all + " style=\"clip-path:url('#b')\"/>"), 1600 * 0.5, 1e-9);
  EXPECT_NEAR(light_of(clip + "<g clip-path=\"url(#h)\" transform=\"translate(10 0)\">" + all +
                       "/><rect x=\"130\" y=\"30\" width=\"1\" height=\"1\"/></g>"),
              1200 - 1, 1e-9);
  // The union of parts; the circle's chord within the rectangle is 2 sqrt(r^2 - 5^2) wide at its height.
  const double part = [&] {  // of the circle inside the rectangle
    double sum = 0;
    for (int k = 0; k < 100000; ++k) sum += (std::sqrt(100 - std::pow(10 * ((k + 0.5) / 100000 - 0.5), 2)) - 5) * 1e-4;
    return sum;
  }();
  EXPECT_NEAR(light_of(clip + all + " clip-path=\"url(#c)\"/>"), kPi * 100 + 200 - part, 0.7);
  const TargetLight target =
      load_target(drawing(clip + R"svg(<g clip-path="url(#h)"><path d="M100 50h100" stroke="white" fill="none"/>
      <circle class="point" cx="150" cy="50"/><circle class="point" cx="135" cy="50"/></g>)svg"));
  ASSERT_EQ(target.curves.size(), 2U);
  EXPECT_NEAR(target.curves[0].vertices_mm.front().x(), 30, 1e-12);
  EXPECT_NEAR(target.curves[0].vertices_mm.back().x(), 40, 1e-12);
  EXPECT_NEAR(target.curves[1].vertices_mm.back().x(), 70, 1e-12);
  EXPECT_EQ(target.points.size(), 1U);
  EXPECT_THAT(warnings("\n<rect width=\"1\" height=\"1\" clip-path=\"inset(5%)\"/>"),
              ElementsAre(HasSubstr("drawing.svg:3: clip-path \"inset(5%)\"")));
}

TEST_F(SvgTest, GradientsHaveTheLightOfTheirColours) {
  const double ramp = mean(srgb_to_linear);  // black to white, mixed in sRGB
  const std::string stops = R"svg(<stop offset="0" stop-color="black"/><stop offset="100%" stop-color="#fff"/>)svg";
  const auto rect = [](const std::string& gradient, const std::string& more = "") {
    return "<defs>" + gradient + "</defs><rect x=\"120\" y=\"20\" width=\"40\" height=\"20\" fill=\"url(#g)\" " + more +
           "/>";
  };
  EXPECT_NEAR(light_of(rect("<linearGradient id=\"g\">" + stops + "</linearGradient>")) / 800, ramp, 1e-6);
  // Along the diagonal of the box: the density of t there rises and falls.
  EXPECT_NEAR(light_of(rect("<linearGradient id=\"g\" x2=\"1\" y2=\"1\">" + stops + "</linearGradient>")) / 800,
              mean([](double t) { return srgb_to_linear(t) * (t < 0.5 ? 4 * t : 4 * (1 - t)); }), 1e-4);
  // A quarter ramp, white beyond it, by reference to another's stops.
  EXPECT_NEAR(light_of(rect("<linearGradient id=\"s\">" + stops +
                            "</linearGradient><linearGradient id=\"g\" href=\"#s\" gradientUnits=\"userSpaceOnUse\" "
                            "x1=\"120\" x2=\"130\"/>")) /
                  800,
              (ramp + 3) / 4, 1e-6);
  EXPECT_NEAR(light_of(rect("<linearGradient id=\"g\" spreadMethod=\"reflect\" gradientTransform=\"scale(0.1 1)\">" +
                            stops + "</linearGradient>")) /
                  800,
              ramp, 1e-6);
  // A hard step, exactly.
  EXPECT_NEAR(light_of(rect("<linearGradient id=\"g\"><stop offset=\"0.3\" stop-color=\"black\"/><stop offset=\"0.3\" "
                            "stop-color=\"white\" stop-opacity=\"0.5\"/></linearGradient>")) /
                  800,
              0.35, 1e-9);
  // A cone: t is the radius, on a disk.
  EXPECT_NEAR(light_of("<radialGradient id=\"g\">" + stops +
                       "</radialGradient><circle cx=\"150\" cy=\"50\" r=\"30\" fill=\"url(#g)\" opacity=\"0.5\"/>") /
                  (kPi * 900),
              0.5 * mean([](double t) { return 2 * t * srgb_to_linear(t); }), 2e-4);
  EXPECT_THAT(
      warnings("\n<linearGradient id=\"g\">" + stops + "</linearGradient><path d=\"M0 5h9\" stroke=\"url(#g)\"/>"),
      ElementsAre(HasSubstr("drawing.svg:3: the gradient \"url(#g)\" of a stroke is drawn as its mean")));
}

TEST_F(SvgTest, BandsOfAGradientCoverABoxOnce) {
  const Box2 box{{-7, 2}, {9, 8}};
  for (const bool radial : {false, true}) {
    for (const auto spread :
         {detail::Gradient::Spread::kPad, detail::Gradient::Spread::kReflect, detail::Gradient::Spread::kRepeat}) {
      detail::Gradient gradient;
      gradient.stops = {{0.1, {0.2, 0.2, 0.2, 1}}, {0.6, {0.9, 0.9, 0.9, 0.5}}};
      gradient.spread = spread;
      gradient.radial = radial;
      gradient.from = {1, 3};
      gradient.to = {2, 5};
      if (radial) gradient.from = gradient.to;
      gradient.radius = 2.5;
      detail::FilledShapes shapes;
      for (const auto& band : detail::bands_of(gradient, box)) {
        EXPECT_GE(band.light, srgb_to_linear(0.2) - 1e-12);
        EXPECT_LE(band.light, srgb_to_linear(0.9) + 1e-12);
        shapes.fills.push_back({band.shape, 1, 0.5, -1, {}});  // twice would be 0.75
      }
      TargetLight target;
      target.extent = box;
      target.area_borders = detail::borders_of(shapes, box);
      EXPECT_NEAR(target.area_total(), 0.5 * 16 * 6, 1e-9);
      for (const double flux : rasterise_area(target, 32, 12).values) EXPECT_NEAR(flux, 0.125, 1e-9);
    }
  }
}

TEST_F(SvgTest, ColoursAreThoseOfCss) {
  const auto square = [&](const std::string& fill, const std::string& more = "") {
    return light_of("<rect x=\"120\" y=\"20\" width=\"10\" height=\"10\" fill=\"" + fill + "\" " + more + "/>") / 100;
  };
  const double half = srgb_to_linear(0.5);
  EXPECT_NEAR(square("#FFF8"), 8 / 15.0, 1e-12);
  EXPECT_NEAR(square("#ffffff33"), 0.2, 1e-12);
  EXPECT_NEAR(square("rgb(50%, 50%, 50%)"), half, 1e-12);
  EXPECT_NEAR(square("rgb(100% 100% 100% / 25%)"), 0.25, 1e-12);
  EXPECT_NEAR(square("rgba(255,255,255,.5)"), 0.5, 1e-12);
  EXPECT_NEAR(square("hsl(0, 0%, 50%)"), half, 1e-12);
  EXPECT_NEAR(square("hsla(240, 100%, 50%, 0.5)"), 0.0361, 1e-12);
  EXPECT_NEAR(square("hsl(0.5turn 100% 50%)"), 0.7152 + 0.0722, 1e-12);
  EXPECT_NEAR(square("WHITE"), 1, 1e-12);
  EXPECT_NEAR(square("currentColor", "color=\"white\""), 1, 1e-12);
  EXPECT_NEAR(
      light_of("<g color=\"white\" fill=\"currentColor\"><rect x=\"120\" y=\"20\" width=\"10\" height=\"10\"/></g>"),
      100, 1e-9);
  EXPECT_NEAR(square("white", "visibility=\"hidden\""), 0, 1e-12);
  EXPECT_NEAR(square("white", "display=\"none\""), 0, 1e-12);
  EXPECT_NEAR(light_of("<g visibility=\"hidden\"><rect x=\"120\" y=\"20\" width=\"10\" height=\"10\" fill=\"white\" "
                       "visibility=\"visible\"/></g>"),
              100, 1e-9);
  EXPECT_NEAR(light_of("<g display=\"none\"><rect x=\"120\" y=\"20\" width=\"10\" height=\"10\" fill=\"white\" "
                       "display=\"inline\"/></g>"),
              0, 1e-9);
  EXPECT_NEAR(square("url(#nothing) white"), 1, 1e-12);
}

TEST_F(SvgTest, NothingIsDroppedWithoutAWord) {
  const auto first = [&](const std::string& body) {
    const auto found = warnings("\n" + body);
    return found.size() == 1 ? found[0] : std::to_string(found.size()) + " warnings";
  };
  EXPECT_THAT(first("<text>hello</text>"), HasSubstr("drawing.svg:3: <text>"));
  EXPECT_THAT(first("<image href=\"a.png\"/>"), HasSubstr("target.image"));
  EXPECT_THAT(first("<foreignObject/>"), HasSubstr("<foreignObject>"));
  EXPECT_THAT(first("<animate/>"), HasSubstr("<animate>"));
  EXPECT_THAT(first("<rect width=\"1\" height=\"1\"><title>t</title><animate/></rect>"),
              HasSubstr("<animate> in <rect>"));
  EXPECT_THAT(first("<foo:bar xmlns:foo=\"http://example.org/foo\"/>"), HasSubstr("<foo:bar> is not SVG"));
  EXPECT_THAT(first("<pattern id=\"p\"/><rect width=\"1\" height=\"1\" fill=\"url(#p)\"/>"),
              HasSubstr("paint \"url(#p)\" is not understood; taken as none"));
  EXPECT_THAT(first("<rect width=\"1\" height=\"1\" fill-rule=\"sometimes\"/>"), HasSubstr("fill-rule \"sometimes\""));
  EXPECT_THAT(first("<rect width=\"1\" height=\"1\" filter=\"url(#f)\"/>"), HasSubstr("filter"));
  EXPECT_THAT(first("<path d=\"M0 0h9\" marker-end=\"url(#m)\"/>"), HasSubstr("marker-end"));
  EXPECT_THAT(first("<g visibility=\"maybe\"/>"), HasSubstr("visibility"));
  EXPECT_THAT(first("<rect width=\"1\" height=\"1\" fill=\"rgb(1,2)\"/>"), HasSubstr("rgb(1,2)"));
  EXPECT_THAT(first("<rect width=\"1\" height=\"1\" transform=\"translate(1e300)scale(1e10)\"/>"),
              HasSubstr("a million pictures far"));
  EXPECT_THAT(first("<switch><rect width=\"1\" height=\"1\"/></switch>"), HasSubstr("<switch>"));
  // What does not change the picture, and editors' own notes.
  EXPECT_THAT(
      warnings(
          R"svg(<title>t</title><desc/><metadata><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"/></metadata>
    <sodipodi:namedview xmlns:sodipodi="http://sodipodi.sourceforge.net/DTD/sodipodi-0.dtd"/><i:pgf xmlns:i="&ns_ai;"/>
    <g style="font-family:serif;stroke-linejoin:round;-inkscape-stroke:none;paint-order:stroke" stroke-linecap="round" id="a" data-x="1"/>)svg"),
      IsEmpty());
  // Whatever prefix stands for SVG.
  const TargetLight target = load_target(whole(
      R"svg(<s:svg xmlns:s="http://www.w3.org/2000/svg" viewBox="0 0 200 100"><s:rect width="9" height="9" fill="white"/></s:svg>)svg"));
  EXPECT_THAT(target.warnings, IsEmpty());
  // A flood of warnings ends.
  std::string flood;
  for (int k = 0; k < 300; ++k) flood += "\n<blob/>";
  EXPECT_EQ(warnings(flood).size(), 101U);
  EXPECT_THAT(warnings(flood).back(), HasSubstr("200 more warnings"));
}

TEST_F(SvgTest, DashesFollowPathLengthAndFixedWidthsThePage) {
  TargetLight target = load_target(drawing(
      R"svg(<path d="M10 50h40" pathLength="8" fill="none" stroke="white" stroke-dasharray="1 3" stroke-dashoffset="-1"/>)svg"));
  ASSERT_EQ(target.curves.size(), 2U);
  EXPECT_NEAR(target.curves[0].vertices_mm.front().x(), -100 + 15, 1e-12);
  EXPECT_NEAR(target.curves[0].vertices_mm.back().x(), -100 + 20, 1e-12);
  target = load_target(drawing(
      R"svg(<path d="M10 50h40" stroke="white"/><path d="M10 10h10" transform="scale(4)" stroke="white" vector-effect="non-scaling-stroke"/>)svg"));
  ASSERT_EQ(target.curves.size(), 2U);
  EXPECT_NEAR(target.curves[0].flux(), target.curves[1].flux(), 1e-12);
}

TEST_F(SvgTest, StrokesAndPointsWithoutLightAreSaid) {
  EXPECT_THAT(warnings("\n<path d=\"M5 5h0\" stroke=\"white\"/>"),
              ElementsAre(HasSubstr("drawing.svg:3: a stroke or dash without length")));
  EXPECT_THAT(warnings("\n<path d=\"M5 5h9\" stroke=\"white\" stroke-dasharray=\"0 2\" stroke-linecap=\"round\"/>"),
              ElementsAre(HasSubstr("drawing.svg:3: a stroke or dash without length")));
  EXPECT_THAT(warnings("\n<g stroke=\"black\"><path d=\"M5 5h9\"/>\n<path d=\"M5 6h9\"/></g>"),
              ElementsAre(HasSubstr("drawing.svg:3: a black stroke is no light and takes none away; draw dark lines as "
                                    "filled shapes (and so at 1 more")));
  // Opacity is light for points too.
  const TargetLight target = load_target(drawing(
      R"svg(<g opacity="0.5"><circle class="point" data-flux="2" cx="5" cy="5" opacity="0.5"/></g><circle class="point" cx="9" cy="9"/>)svg"));
  EXPECT_NEAR(target.points[0].flux / target.points[1].flux, 0.5, 1e-12);
}

TEST_F(SvgTest, ACompressedDrawingIsNamed) {
  TargetSpec spec = whole("\x1f\x8b\x08...");
  try {
    load_target(spec);
    FAIL();
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("compressed"));
  }
}

}  // namespace
}  // namespace lightmill

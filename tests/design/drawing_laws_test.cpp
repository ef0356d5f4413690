// Laws of drawings as light: what maps, splits and winding rules do to flux, and that no text brings the reader down.
#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <chrono>
#include <cmath>
#include <fstream>
#include <iterator>
#include <random>
#include <sstream>

#include "design/core/errors.h"
#include "design/detail/svg.h"

namespace lightmill {
namespace {

using Polygon = std::vector<Vec2>;

TargetLight light_of(const std::string& body) {
  const Vec2 size(200, 100);
  const detail::Drawing drawing = detail::parse_drawing(
      "<svg viewBox=\"0 0 200 100\" fill=\"white\">" + body + "</svg>", "drawing", size, ViewedFrom::kBehind);
  TargetLight target;
  target.extent = Box2::centred(size);
  target.area_borders = detail::borders_of(drawing.shapes, target.extent);
  target.curves = drawing.strokes;
  return target;
}
double area_of(const std::string& body) {
  return light_of(body).area_total();
}

std::string text_of(double value) {
  std::ostringstream text;
  text.precision(17);
  text << value;
  return text.str();
}
std::string data_of(const Polygon& polygon, bool closed = true) {
  std::string data;
  for (std::size_t k = 0; k < polygon.size(); ++k)
    data += (k == 0 ? "M" : "L") + text_of(polygon[k].x()) + " " + text_of(polygon[k].y());
  return data + (closed ? "Z" : "");
}
std::string path_of(const std::string& data, const std::string& more = "") {
  return "<path d=\"" + data + "\" " + more + "/>";
}

/// Corners anywhere, or on a coarse lattice where edges meet and coincide.
Polygon any_polygon(const Vec2& low, const Vec2& high) {
  const int steps = *rc::gen::element(8, 100000);
  Polygon polygon(*rc::gen::inRange(3, 9));
  for (Vec2& p : polygon) {
    for (int axis = 0; axis < 2; ++axis)
      p[axis] = low[axis] + (high[axis] - low[axis]) * *rc::gen::inRange(0, steps + 1) / steps;
  }
  return polygon;
}
Polygon reversed(Polygon polygon) {
  std::reverse(polygon.begin(), polygon.end());
  return polygon;
}

TEST(DrawingLaws, AffineMapsScaleLightByTheirDeterminant) {
  EXPECT_TRUE(rc::check("polygons, by any rule", [] {
    const Polygon polygon = any_polygon({-10, -10}, {10, 10});
    double m[4];
    for (double& entry : m) entry = *rc::gen::inRange(-2000, 2001) / 1000.0;
    const std::string rule = *rc::gen::element<std::string>("evenodd", "nonzero");
    const std::string path = path_of(data_of(polygon), "fill-rule=\"" + rule + "\"");
    const double before = area_of("<g transform=\"translate(100 50)\">" + path + "</g>");
    const double after = area_of("<g transform=\"matrix(" + text_of(m[0]) + " " + text_of(m[1]) + " " + text_of(m[2]) +
                                 " " + text_of(m[3]) + " 100 50)\">" + path + "</g>");
    RC_ASSERT(std::abs(after - std::abs(m[0] * m[3] - m[1] * m[2]) * before) < 1e-9);
  }));
  EXPECT_TRUE(rc::check("curves, to the flattening tolerance", [] {
    const Polygon p = any_polygon({-10, -10}, {10, 10});
    std::string data = "M" + text_of(p[0].x()) + " " + text_of(p[0].y()) + "C";
    for (int k = 0; k < 3; ++k) data += text_of(p[k].x()) + " " + text_of(p[2 - k].y()) + " ";
    data += "Q" + text_of(p[1].x()) + " 3 5 " + text_of(p[2].y()) + "A7 4 " + text_of(p[1].y()) + " 1 0 -4 2Z";
    const double turn = *rc::gen::inRange(0, 360);
    const double scale = *rc::gen::inRange(100, 2000) / 1000.0;
    const double before = area_of("<g transform=\"translate(100 50)\">" + path_of(data) + "</g>");
    const double after = area_of("<g transform=\"translate(100 50)rotate(" + text_of(turn) + ")scale(" +
                                 text_of(scale) + ")\">" + path_of(data) + "</g>");
    RC_ASSERT(std::abs(after - scale * scale * before) <
              300 * detail::kFlatteningTolerance_mm * std::max(1.0, scale * scale));
  }));
}

TEST(DrawingLaws, WindingRulesCountAsTheyShould) {
  EXPECT_TRUE(rc::check("two polygons", [] {
    const Polygon a = any_polygon({20, 10}, {120, 90});
    const Polygon b = any_polygon({60, 10}, {180, 90});
    const auto shape = [](const Polygon& first, const Polygon& second, const char* rule) {
      return path_of(data_of(first) + data_of(second), std::string("fill-rule=\"") + rule + "\"");
    };
    const double tolerance = 1e-8;
    const auto odd = [](const Polygon& p) { return area_of(path_of(data_of(p), "fill-rule=\"evenodd\"")); };
    // Turning everything round changes nothing, a shape twice is none by one rule and itself by the other.
    for (const char* rule : {"evenodd", "nonzero"})
      RC_ASSERT(std::abs(area_of(shape(a, b, rule)) - area_of(shape(reversed(b), reversed(a), rule))) < tolerance);
    RC_ASSERT(area_of(shape(a, a, "evenodd")) < tolerance);
    RC_ASSERT(std::abs(area_of(shape(a, a, "nonzero")) - area_of(path_of(data_of(a)))) < tolerance);
    // Even-odd is the symmetric difference; a clip is what both have.
    const double both = area_of("<clipPath id=\"c\"><path clip-rule=\"evenodd\" d=\"" + data_of(b) + "\"/></clipPath>" +
                                path_of(data_of(a), "fill-rule=\"evenodd\" clip-path=\"url(#c)\""));
    RC_ASSERT(std::abs(area_of(shape(a, b, "evenodd")) - (odd(a) + odd(b) - 2 * both)) < tolerance);
    // Two white shapes are their union.
    RC_ASSERT(
        std::abs(area_of(path_of(data_of(a), "fill-rule=\"evenodd\"") + path_of(data_of(b), "fill-rule=\"evenodd\"")) -
                 (odd(a) + odd(b) - both)) < tolerance);
  }));
}

TEST(DrawingLaws, SplittingAPathKeepsItsLight) {
  EXPECT_TRUE(rc::check("fills and strokes", [] {
    const Polygon a = any_polygon({10, 10}, {90, 90});
    const Polygon b = any_polygon({110, 10}, {190, 90});
    RC_ASSERT(std::abs(area_of(path_of(data_of(a) + data_of(b))) - area_of(path_of(data_of(a)) + path_of(data_of(b)))) <
              1e-9);
    const std::string stroke = "stroke=\"white\" fill=\"none\" stroke-width=\"0.7\"";
    const std::size_t at = *rc::gen::inRange<std::size_t>(1, a.size());
    const Polygon first(a.begin(), a.begin() + static_cast<std::ptrdiff_t>(at) + 1 - (at + 1 > a.size() ? 1 : 0));
    const Polygon second(a.begin() + static_cast<std::ptrdiff_t>(at), a.end());
    const double whole = light_of(path_of(data_of(a, false), stroke)).curve_total();
    RC_ASSERT(std::abs(light_of(path_of(data_of(first, false) + data_of(second, false), stroke)).curve_total() -
                       whole) < 1e-9);
  }));
}

/// Text that is almost a drawing: bytes, slices and numbers of a real one changed.
std::string mutated(std::string text, std::mt19937& random) {
  static const std::vector<std::string> bits{"1e308",
                                             "-1e-308",
                                             "0",
                                             "-1",
                                             "1e9",
                                             "nan",
                                             "99999999999",
                                             "\"",
                                             "<",
                                             ">",
                                             "/>",
                                             "<g>",
                                             "</g>",
                                             "&#0;",
                                             "&",
                                             "url(#a)",
                                             "evenodd",
                                             "none",
                                             "Z",
                                             "A",
                                             "M",
                                             "C 1 1",
                                             "opacity=\"0.5\"",
                                             "transform=\"scale(1e5)\"",
                                             "<use href=\"#a\"/>",
                                             "{",
                                             "}",
                                             ":",
                                             ";",
                                             "%",
                                             "em",
                                             "\xff\xfe",
                                             "<!--",
                                             "]]>",
                                             "stroke-dasharray=\"1e-7\""};
  const auto below = [&](std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1)(random); };
  const std::size_t changes = 1 + below(4);
  for (std::size_t k = 0; k < changes && !text.empty(); ++k) {
    const std::size_t at = below(text.size());
    const std::size_t length = 1 + below(30);
    switch (below(5)) {
      case 0:
        text[at] = static_cast<char>(below(256));
        break;
      case 1:
        text.erase(at, length);
        break;
      case 2:
        text.insert(below(text.size()), text.substr(at, length));
        break;
      case 3:
        text.insert(at, bits[below(bits.size())]);
        break;
      default: {
        const std::size_t digit = text.find_first_of("0123456789", at);
        if (digit != std::string::npos)
          text.replace(digit, std::min(text.find_first_not_of("0123456789.", digit), text.size()) - digit,
                       bits[below(7)]);
      }
    }
  }
  return text;
}

TEST(DrawingLaws, NoTextBringsTheReaderDown) {
  std::vector<std::string> seeds{
      R"svg(<svg viewBox="0 0 100 100" width="10mm"><style>.a, #b{fill:#fff;stroke:red!important} /* c */</style>
<defs><linearGradient id="l" x2="1"><stop offset="0" stop-color="red"/><stop offset="50%" stop-color="rgb(1,2,3)"/></linearGradient>
<radialGradient id="r" href="#l" fx="0.2" spreadMethod="repeat"/><clipPath id="c"><circle r="20" cx="50" cy="50"/></clipPath>
<symbol id="s" viewBox="0 0 5 5"><path d="M0 0h5v5z"/></symbol></defs>
<g opacity="0.5" clip-path="url(#c)" transform="rotate(30 5 5) skewX(3)"><rect id="a" class="a" width="50%" height="3em" rx="2" fill="url(#l)"/>
<ellipse cx="50" cy="50" rx="20" ry="9" fill="url(#r)" stroke="white" stroke-dasharray="3 2"/><use href="#s" width="20" height="9"/></g>
<path id="b" d="M10 10C20 20 40 0 50 50S9 9 3 4Q1 2 3 4T5 6A5 6 7 0 1 20 20z m5 5h3v3z" data-flux="1 2" fill-rule="evenodd"/>
<polygon points="1,2 3,4 5,6"/><circle class="point" cx="3" cy="4" data-flux="3"/><svg x="3" width="20" viewBox="0 0 9 9" preserveAspectRatio="xMaxYMin slice"><line x2="5"/></svg></svg>)svg"};
  for (const char* name : {"rings.svg", "letter_f.svg", "signature.svg", "logo.svg", "point.svg"}) {
    std::ifstream in(std::string(LIGHTMILL_FIXTURES "/pictures/") + name);
    seeds.emplace_back(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
    ASSERT_FALSE(seeds.back().empty()) << name;
  }
  std::mt19937 random(2014);
  int read = 0;
  const Vec2 size(120, 80);
  for (int trial = 0; trial < 600; ++trial) {
    const std::string text = mutated(seeds[trial % seeds.size()], random);
    const auto start = std::chrono::steady_clock::now();
    try {
      const detail::Drawing drawing = detail::parse_drawing(text, "fuzz", size, ViewedFrom::kLens);
      TargetLight target;
      target.extent = Box2::centred(size);
      target.area_borders = detail::borders_of(drawing.shapes, target.extent);
      ASSERT_GE(target.area_total(), -1e-6) << text;
      ASSERT_LE(target.area_total(), size.prod() * (1 + 1e-9)) << text;  // white is the most
      for (const auto& curve : drawing.strokes) ASSERT_TRUE(std::isfinite(curve.flux())) << text;
      for (const auto& point : drawing.points) ASSERT_TRUE(target.extent.contains(point.position_mm)) << text;
      ++read;
    } catch (const InputError&) {
    }
    ASSERT_LT(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), 20) << text;
  }
  EXPECT_GT(read, 200);
}

}  // namespace
}  // namespace lightmill

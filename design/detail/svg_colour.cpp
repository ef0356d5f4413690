#include "design/detail/svg_colour.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

struct Named {
  std::string_view name;
  std::uint32_t rgb;
};

// CSS Color Module Level 4, sec. 6.1, sorted by name.
constexpr Named kNamed[] = {{"aliceblue", 0xf0f8ff},
                            {"antiquewhite", 0xfaebd7},
                            {"aqua", 0x00ffff},
                            {"aquamarine", 0x7fffd4},
                            {"azure", 0xf0ffff},
                            {"beige", 0xf5f5dc},
                            {"bisque", 0xffe4c4},
                            {"black", 0x000000},
                            {"blanchedalmond", 0xffebcd},
                            {"blue", 0x0000ff},
                            {"blueviolet", 0x8a2be2},
                            {"brown", 0xa52a2a},
                            {"burlywood", 0xdeb887},
                            {"cadetblue", 0x5f9ea0},
                            {"chartreuse", 0x7fff00},
                            {"chocolate", 0xd2691e},
                            {"coral", 0xff7f50},
                            {"cornflowerblue", 0x6495ed},
                            {"cornsilk", 0xfff8dc},
                            {"crimson", 0xdc143c},
                            {"cyan", 0x00ffff},
                            {"darkblue", 0x00008b},
                            {"darkcyan", 0x008b8b},
                            {"darkgoldenrod", 0xb8860b},
                            {"darkgray", 0xa9a9a9},
                            {"darkgreen", 0x006400},
                            {"darkgrey", 0xa9a9a9},
                            {"darkkhaki", 0xbdb76b},
                            {"darkmagenta", 0x8b008b},
                            {"darkolivegreen", 0x556b2f},
                            {"darkorange", 0xff8c00},
                            {"darkorchid", 0x9932cc},
                            {"darkred", 0x8b0000},
                            {"darksalmon", 0xe9967a},
                            {"darkseagreen", 0x8fbc8f},
                            {"darkslateblue", 0x483d8b},
                            {"darkslategray", 0x2f4f4f},
                            {"darkslategrey", 0x2f4f4f},
                            {"darkturquoise", 0x00ced1},
                            {"darkviolet", 0x9400d3},
                            {"deeppink", 0xff1493},
                            {"deepskyblue", 0x00bfff},
                            {"dimgray", 0x696969},
                            {"dimgrey", 0x696969},
                            {"dodgerblue", 0x1e90ff},
                            {"firebrick", 0xb22222},
                            {"floralwhite", 0xfffaf0},
                            {"forestgreen", 0x228b22},
                            {"fuchsia", 0xff00ff},
                            {"gainsboro", 0xdcdcdc},
                            {"ghostwhite", 0xf8f8ff},
                            {"gold", 0xffd700},
                            {"goldenrod", 0xdaa520},
                            {"gray", 0x808080},
                            {"green", 0x008000},
                            {"greenyellow", 0xadff2f},
                            {"grey", 0x808080},
                            {"honeydew", 0xf0fff0},
                            {"hotpink", 0xff69b4},
                            {"indianred", 0xcd5c5c},
                            {"indigo", 0x4b0082},
                            {"ivory", 0xfffff0},
                            {"khaki", 0xf0e68c},
                            {"lavender", 0xe6e6fa},
                            {"lavenderblush", 0xfff0f5},
                            {"lawngreen", 0x7cfc00},
                            {"lemonchiffon", 0xfffacd},
                            {"lightblue", 0xadd8e6},
                            {"lightcoral", 0xf08080},
                            {"lightcyan", 0xe0ffff},
                            {"lightgoldenrodyellow", 0xfafad2},
                            {"lightgray", 0xd3d3d3},
                            {"lightgreen", 0x90ee90},
                            {"lightgrey", 0xd3d3d3},
                            {"lightpink", 0xffb6c1},
                            {"lightsalmon", 0xffa07a},
                            {"lightseagreen", 0x20b2aa},
                            {"lightskyblue", 0x87cefa},
                            {"lightslategray", 0x778899},
                            {"lightslategrey", 0x778899},
                            {"lightsteelblue", 0xb0c4de},
                            {"lightyellow", 0xffffe0},
                            {"lime", 0x00ff00},
                            {"limegreen", 0x32cd32},
                            {"linen", 0xfaf0e6},
                            {"magenta", 0xff00ff},
                            {"maroon", 0x800000},
                            {"mediumaquamarine", 0x66cdaa},
                            {"mediumblue", 0x0000cd},
                            {"mediumorchid", 0xba55d3},
                            {"mediumpurple", 0x9370db},
                            {"mediumseagreen", 0x3cb371},
                            {"mediumslateblue", 0x7b68ee},
                            {"mediumspringgreen", 0x00fa9a},
                            {"mediumturquoise", 0x48d1cc},
                            {"mediumvioletred", 0xc71585},
                            {"midnightblue", 0x191970},
                            {"mintcream", 0xf5fffa},
                            {"mistyrose", 0xffe4e1},
                            {"moccasin", 0xffe4b5},
                            {"navajowhite", 0xffdead},
                            {"navy", 0x000080},
                            {"oldlace", 0xfdf5e6},
                            {"olive", 0x808000},
                            {"olivedrab", 0x6b8e23},
                            {"orange", 0xffa500},
                            {"orangered", 0xff4500},
                            {"orchid", 0xda70d6},
                            {"palegoldenrod", 0xeee8aa},
                            {"palegreen", 0x98fb98},
                            {"paleturquoise", 0xafeeee},
                            {"palevioletred", 0xdb7093},
                            {"papayawhip", 0xffefd5},
                            {"peachpuff", 0xffdab9},
                            {"peru", 0xcd853f},
                            {"pink", 0xffc0cb},
                            {"plum", 0xdda0dd},
                            {"powderblue", 0xb0e0e6},
                            {"purple", 0x800080},
                            {"rebeccapurple", 0x663399},
                            {"red", 0xff0000},
                            {"rosybrown", 0xbc8f8f},
                            {"royalblue", 0x4169e1},
                            {"saddlebrown", 0x8b4513},
                            {"salmon", 0xfa8072},
                            {"sandybrown", 0xf4a460},
                            {"seagreen", 0x2e8b57},
                            {"seashell", 0xfff5ee},
                            {"sienna", 0xa0522d},
                            {"silver", 0xc0c0c0},
                            {"skyblue", 0x87ceeb},
                            {"slateblue", 0x6a5acd},
                            {"slategray", 0x708090},
                            {"slategrey", 0x708090},
                            {"snow", 0xfffafa},
                            {"springgreen", 0x00ff7f},
                            {"steelblue", 0x4682b4},
                            {"tan", 0xd2b48c},
                            {"teal", 0x008080},
                            {"thistle", 0xd8bfd8},
                            {"tomato", 0xff6347},
                            {"turquoise", 0x40e0d0},
                            {"violet", 0xee82ee},
                            {"wheat", 0xf5deb3},
                            {"white", 0xffffff},
                            {"whitesmoke", 0xf5f5f5},
                            {"yellow", 0xffff00},
                            {"yellowgreen", 0x9acd32}};

double linear(double code) {
  code = std::clamp(code, 0.0, 1.0);
  return code <= 0.04045 ? code / 12.92 : std::pow((code + 0.055) / 1.055, 2.4);
}

/// The arguments of a function such as rgb(1, 2, 3), percentages as shares of `full`; empty when they are not numbers.
std::vector<double> arguments(std::string_view inside, double full) {
  std::vector<double> values;
  std::size_t at = 0;
  while (at < inside.size()) {
    if (std::string_view(" ,/\t\n").find(inside[at]) != std::string_view::npos) {
      ++at;
      continue;
    }
    if (inside[at] == '+') ++at;
    double value = 0;
    const auto [end, error] = std::from_chars(inside.data() + at, inside.data() + inside.size(), value);
    if (error != std::errc()) return {};
    at = end - inside.data();
    if (at < inside.size() && inside[at] == '%') {
      value *= (values.size() == 3 ? 1 : full) / 100;
      ++at;
    } else if (inside.substr(at, 3) == "deg") {
      at += 3;
    } else if (inside.substr(at, 4) == "turn") {
      value *= 360;
      at += 4;
    }
    values.push_back(value);
  }
  return values;
}

}  // namespace

double Colour::light() const {
  return 0.2126 * linear(red) + 0.7152 * linear(green) + 0.0722 * linear(blue);
}

std::optional<Colour> parse_colour(std::string_view text) {
  const std::string lower = lower_case(trimmed(text));
  if (lower == "transparent") return Colour{0, 0, 0, 0};
  if (lower.starts_with('#')) {
    const std::size_t digits = lower.size() - 1;
    if (digits != 3 && digits != 4 && digits != 6 && digits != 8) return std::nullopt;
    const std::size_t each = digits <= 4 ? 1 : 2;
    std::array<double, 4> channel{0, 0, 0, 1};
    for (std::size_t k = 0; k * each < digits; ++k) {
      unsigned value = 0;
      const char* begin = lower.data() + 1 + k * each;
      const auto [end, error] = std::from_chars(begin, begin + each, value, 16);
      if (error != std::errc() || end != begin + each) return std::nullopt;
      channel[k] = each == 1 ? value / 15.0 : value / 255.0;
    }
    return Colour{channel[0], channel[1], channel[2], channel[3]};
  }
  const std::size_t open = lower.find('(');
  if (open != std::string::npos && lower.back() == ')') {
    const std::string_view name = std::string_view(lower).substr(0, open);
    const std::string_view inside = std::string_view(lower).substr(open + 1, lower.size() - open - 2);
    const bool rgb = name == "rgb" || name == "rgba";
    if (!rgb && name != "hsl" && name != "hsla") return std::nullopt;
    const auto v = arguments(inside, rgb ? 255 : 1);
    if (v.size() != 3 && v.size() != 4) return std::nullopt;
    const double opacity = v.size() == 4 ? std::clamp(v[3], 0.0, 1.0) : 1;
    if (rgb) return Colour{v[0] / 255, v[1] / 255, v[2] / 255, opacity};
    const auto channel = [&](double n) {  // CSS Color Module Level 4, sec. 7.1
      const double saturation = std::clamp(v[1], 0.0, 1.0);
      const double lightness = std::clamp(v[2], 0.0, 1.0);
      const double k = std::fmod(std::fmod(n + v[0] / 30, 12) + 12, 12);
      return lightness -
             saturation * std::min(lightness, 1 - lightness) * std::max(-1.0, std::min({k - 3, 9 - k, 1.0}));
    };
    return Colour{channel(0), channel(8), channel(4), opacity};
  }
  const auto* found = std::lower_bound(std::begin(kNamed), std::end(kNamed), lower,
                                       [](const Named& named, const std::string& name) { return named.name < name; });
  if (found == std::end(kNamed) || found->name != lower) return std::nullopt;
  return Colour{(found->rgb >> 16) / 255.0, (found->rgb >> 8 & 255) / 255.0, (found->rgb & 255) / 255.0, 1};
}

}  // namespace lightmill::detail

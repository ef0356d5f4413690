// CSS colours.
#pragma once

#include <optional>
#include <string_view>

namespace lightmill::detail {

/// sRGB code values and opacity, from 0 to 1.
struct Colour {
  double red = 0;
  double green = 0;
  double blue = 0;
  double opacity = 1;
  [[nodiscard]] double light() const;  ///< linear luminance (Rec. 709 weights)
};

/// Names, #rgb, #rgba, #rrggbb, #rrggbbaa, rgb(), rgba(), hsl(), hsla(); nothing if it is none of these.
std::optional<Colour> parse_colour(std::string_view text);

}  // namespace lightmill::detail

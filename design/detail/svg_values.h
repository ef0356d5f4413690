// Values in the text of SVG attributes and CSS properties: numbers, lengths, transforms, aspect ratios.
#pragma once

#include <2geom/affine.h>
#include <2geom/rect.h>

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace lightmill::detail {

[[nodiscard]] std::string_view trimmed(std::string_view text);
[[nodiscard]] std::string lower_case(std::string_view text);

/// The leading number of `text`, which is shortened by it.
std::optional<double> take_number(std::string_view& text);

/// The word, up to a blank or comma, that `text` begins with; `text` is shortened by it and what separates.
std::string_view take_word(std::string_view& text);

/// Numbers separated by blanks and commas; nothing if there is anything else.
std::optional<std::vector<double>> numbers_of(std::string_view text);

/// A length in user units; a percentage is of `whole`, an em is `font_size`.
std::optional<double> parse_length(std::string_view text, double whole, double font_size = 16);

/// The transform attribute [SVG 1.1, sec. 7.6] or what CSS writes for it in px and angles; nothing when it is not well
/// formed.
std::optional<Geom::Affine> parse_transform(std::string_view text);

/// How a view box is fitted into a rectangle [SVG 1.1, sec. 7.8].
struct AspectRatio {
  enum class Scale { kMeet, kSlice, kStretch };
  Scale scale = Scale::kMeet;
  double x = 0.5;  ///< where what is left over or cut off lies: 0 all after, 1 all before
  double y = 0.5;
};
std::optional<AspectRatio> parse_aspect_ratio(std::string_view text);

/// The map of the unit square onto a bounding box.
Geom::Affine box_to_user(const Geom::Rect& box);

/// The map from `from` into `to`.
Geom::Affine fitted(const Geom::Rect& from, const Geom::Rect& to, const AspectRatio& ratio);

}  // namespace lightmill::detail

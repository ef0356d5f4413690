#include "design/detail/svg_values.h"

#include <2geom/transforms.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>

#include "design/core/geometry.h"

namespace lightmill::detail {

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\n\r\f";
  const std::size_t first = std::min(text.find_first_not_of(kBlanks), text.size());
  text.remove_prefix(first);
  return text.substr(0, text.find_last_not_of(kBlanks) + 1);
}

std::string lower_case(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c + ('a' - 'A'));
  }
  return lower;
}

std::optional<double> take_number(std::string_view& text) {
  text = trimmed(text);
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || !std::isfinite(value)) return std::nullopt;
  text.remove_prefix(end - text.data());
  return value;
}

std::string_view take_word(std::string_view& text) {
  text = trimmed(text);
  const std::size_t end = std::min(text.find_first_of(", \t\r\n"), text.size());
  const std::string_view word = text.substr(0, end);
  text = trimmed(text.substr(end));
  if (text.starts_with(',')) text = trimmed(text.substr(1));
  return word;
}

std::optional<std::vector<double>> numbers_of(std::string_view text) {
  std::vector<double> values;
  for (;;) {
    text = trimmed(text);
    if (text.starts_with(',')) text = trimmed(text.substr(1));
    if (text.empty()) return values;
    const auto value = take_number(text);
    if (!value) return std::nullopt;
    values.push_back(*value);
  }
}

std::optional<double> parse_length(std::string_view text, double whole, double font_size) {
  const auto value = take_number(text);
  if (!value) return std::nullopt;
  static const std::map<std::string_view, double> units{{"", 1},           {"px", 1},         {"pt", 96.0 / 72},
                                                        {"pc", 16},        {"in", 96},        {"mm", 96 / 25.4},
                                                        {"cm", 96 / 2.54}, {"q", 96 / 101.6}, {"rem", 16}};
  const std::string unit = lower_case(trimmed(text));
  if (unit == "%") return *value * whole / 100;
  if (unit == "em") return *value * font_size;
  if (unit == "ex") return *value * font_size / 2;
  const auto found = units.find(unit);
  if (found == units.end()) return std::nullopt;
  return *value * found->second;
}

namespace {

/// Arguments of a transform: numbers, lengths in px, angles in degrees or what CSS turns into them.
std::optional<std::vector<double>> transform_arguments(std::string_view text) {
  std::vector<double> values;
  while (!(text = trimmed(text)).empty()) {
    if (text.starts_with(',')) text = trimmed(text.substr(1));
    auto value = take_number(text);
    if (!value) return std::nullopt;
    const std::size_t end = std::min(text.find_first_not_of("abcdefghijklmnopqrstuvwxyz"), text.size());
    const std::string_view unit = text.substr(0, end);
    text.remove_prefix(end);
    if (unit == "rad") {
      *value *= 180 / kPi;
    } else if (unit == "turn") {
      *value *= 360;
    } else if (unit == "grad") {
      *value *= 0.9;
    } else if (!unit.empty() && unit != "deg" && unit != "px") {
      return std::nullopt;
    }
    values.push_back(*value);
  }
  return values;
}

/// One step of a transform; nothing when it is not well formed.
std::optional<Geom::Affine> transform_step(std::string_view name, const std::vector<double>& a) {
  const std::size_t n = a.size();
  const auto skew = [](double degrees) { return std::tan(degrees * kPi / 180); };
  if (name == "matrix" && n == 6) return Geom::Affine(a[0], a[1], a[2], a[3], a[4], a[5]);
  if (name == "translate" && (n == 1 || n == 2)) return Geom::Translate(a[0], n == 2 ? a[1] : 0);
  if (name == "translateX" && n == 1) return Geom::Translate(a[0], 0);
  if (name == "translateY" && n == 1) return Geom::Translate(0, a[0]);
  if (name == "scale" && (n == 1 || n == 2)) return Geom::Affine(a[0], 0, 0, n == 2 ? a[1] : a[0], 0, 0);
  if (name == "scaleX" && n == 1) return Geom::Affine(a[0], 0, 0, 1, 0, 0);
  if (name == "scaleY" && n == 1) return Geom::Affine(1, 0, 0, a[0], 0, 0);
  if (name == "rotate" && (n == 1 || n == 3)) {
    const Geom::Point centre(n == 3 ? a[1] : 0, n == 3 ? a[2] : 0);
    return Geom::Translate(-centre) * Geom::Rotate::from_degrees(a[0]) * Geom::Translate(centre);
  }
  if (name == "skewX" && n == 1) return Geom::Affine(1, 0, skew(a[0]), 1, 0, 0);
  if (name == "skewY" && n == 1) return Geom::Affine(1, skew(a[0]), 0, 1, 0, 0);
  return std::nullopt;
}

}  // namespace

std::optional<Geom::Affine> parse_transform(std::string_view text) {
  Geom::Affine result;  // identity; lib2geom multiplies row vectors, so the innermost transform comes first
  for (;;) {
    text = trimmed(text);
    while (text.starts_with(',')) text = trimmed(text.substr(1));
    if (text.empty() || text == "none") return result;
    const std::size_t open = text.find('(');
    const std::size_t close = text.find(')');
    if (open == std::string_view::npos || close == std::string_view::npos || close < open) return std::nullopt;
    const auto arguments = transform_arguments(text.substr(open + 1, close - open - 1));
    const auto step = arguments ? transform_step(trimmed(text.substr(0, open)), *arguments) : std::nullopt;
    if (!step) return std::nullopt;
    text.remove_prefix(close + 1);
    result = *step * result;
  }
}

std::optional<AspectRatio> parse_aspect_ratio(std::string_view text) {
  AspectRatio ratio;
  std::string_view align = take_word(text);
  if (align == "defer") align = take_word(text);
  const std::string_view scale = take_word(text);
  if (!text.empty()) return std::nullopt;
  if (align == "none") {
    ratio.scale = AspectRatio::Scale::kStretch;
    return ratio;
  }
  const auto place = [](std::string_view word) -> std::optional<double> {
    if (word == "Min") return 0;
    if (word == "Mid") return 0.5;
    if (word == "Max") return 1;
    return std::nullopt;
  };
  if (align.size() != 8 || align[0] != 'x' || align[4] != 'Y') return std::nullopt;
  const auto x = place(align.substr(1, 3));
  const auto y = place(align.substr(5, 3));
  if (!x || !y) return std::nullopt;
  if (scale == "slice") {
    ratio.scale = AspectRatio::Scale::kSlice;
  } else if (!scale.empty() && scale != "meet") {
    return std::nullopt;
  }
  ratio.x = *x;
  ratio.y = *y;
  return ratio;
}

Geom::Affine box_to_user(const Geom::Rect& box) {
  return {box.width(), 0, 0, box.height(), box.left(), box.top()};
}

Geom::Affine fitted(const Geom::Rect& from, const Geom::Rect& to, const AspectRatio& ratio) {
  double sx = to.width() / from.width();
  double sy = to.height() / from.height();
  if (ratio.scale == AspectRatio::Scale::kMeet) sx = sy = std::min(sx, sy);
  if (ratio.scale == AspectRatio::Scale::kSlice) sx = sy = std::max(sx, sy);
  const double x = to.left() + ratio.x * (to.width() - sx * from.width());
  const double y = to.top() + ratio.y * (to.height() - sy * from.height());
  return {sx, 0, 0, sy, x - sx * from.left(), y - sy * from.top()};
}

}  // namespace lightmill::detail

#include "design/detail/svg_strokes.h"

#include <algorithm>
#include <cmath>

#include "design/detail/svg_values.h"

namespace lightmill::detail {

namespace {

constexpr int kMostDashes = 1000000;  // per stroke

/// The relative density at each flattened vertex: data-flux at the path's own vertices, linear along arc length in mm
/// between them; 1 without. Nothing when data-flux is wrong, which is a warning.
std::vector<std::vector<double>> flux_profiles(SvgDocument& document, const pugi::xml_node& node,
                                               const std::vector<Flattened>& flattened) {
  std::vector<std::vector<double>> profiles;
  for (const auto& flat : flattened) profiles.emplace_back(flat.vertices_mm.size(), 1.0);
  const auto attribute = node.attribute("data-flux");
  if (!attribute) return profiles;
  const auto given = numbers_of(attribute.value());
  if (!given || std::any_of(given->begin(), given->end(), [](double value) { return value < 0; })) {
    document.warn(node, std::string("data-flux \"") + attribute.value() +
                            "\" is not a list of numbers of at least 0; the stroke is left out");
    return {};
  }
  // A closed subpath ends with the value that it starts with.
  std::size_t expected = 0;
  for (std::size_t k = 0; k < flattened.size(); ++k)
    expected += flattened[k].corners.size() - (flattened[k].closed ? 1 : 0);
  if (given->size() != expected) {
    document.warn(node, "data-flux has " + std::to_string(given->size()) + " values, but the path has " +
                            std::to_string(expected) + " vertices; the stroke is left out. Give one value per vertex");
    return {};
  }
  std::size_t next = 0;
  for (std::size_t k = 0; k < flattened.size(); ++k) {
    const auto& flat = flattened[k];
    const std::size_t count = flat.corners.size() - (flattened[k].closed ? 1 : 0);
    for (std::size_t c = 0; c + 1 < flat.corners.size(); ++c) {
      const double from = (*given)[next + c];
      const double to = (*given)[next + (c + 1) % count];
      const std::size_t first = flat.corners[c];
      const std::size_t last = flat.corners[c + 1];
      double length = 0;
      for (std::size_t i = first; i < last; ++i) length += (flat.vertices_mm[i + 1] - flat.vertices_mm[i]).norm();
      double at = 0;
      for (std::size_t i = first; i <= last; ++i) {
        if (i > first) at += (flat.vertices_mm[i] - flat.vertices_mm[i - 1]).norm();
        profiles[k][i] = length > 0 ? from + (to - from) * (at / length) : to;
      }
    }
    next += count;
  }
  return profiles;
}

/// Lengths of dashes and gaps in user units; empty for a solid stroke.
std::vector<double> dash_pattern(SvgDocument& document, const pugi::xml_node& node, const SvgStyle& style,
                                 const Vec2& view) {
  if (style.dashes == "none") return {};
  std::vector<double> pattern;
  double sum = 0;
  std::string_view rest = style.dashes;
  while (!(rest = trimmed(rest)).empty()) {
    const std::size_t end = std::min(rest.find_first_of(", \t\r\n"), rest.size());
    const auto value = parse_length(rest.substr(0, end), diagonal(view), style.font_size);
    if (!value || *value < 0) {
      document.warn(node,
                    "stroke-dasharray \"" + style.dashes + "\" is not a list of lengths of at least 0; drawn solid");
      return {};
    }
    pattern.push_back(*value);
    sum += *value;
    rest.remove_prefix(std::min(end, rest.size()));
    rest = trimmed(rest);
    if (rest.starts_with(',')) rest.remove_prefix(1);
  }
  if (!(sum > 0)) return {};  // all zero is solid [SVG 1.1, sec. 11.4]
  if (pattern.size() % 2 != 0) pattern.insert(pattern.end(), pattern.begin(), pattern.end());
  return pattern;
}

/// Adds the dashes of a curve; `along` is the arc length at its vertices, in the pattern's units.
void cut_dashes(SvgDocument& document, const pugi::xml_node& node, const CurveLight& curve,
                const std::vector<double>& along, const std::vector<double>& pattern, double offset,
                std::vector<CurveLight>& dashes) {
  double period = 0;
  for (const double length : pattern) period += length;
  if (along.back() / period * static_cast<double>(pattern.size()) > kMostDashes) {
    document.warn(node,
                  "stroke-dasharray cuts the stroke into over " + std::to_string(kMostDashes) + " dashes; drawn solid");
    dashes.push_back(curve);
    return;
  }
  const auto at = [&](double s, std::size_t k) {
    const double t = std::clamp((s - along[k]) / (along[k + 1] - along[k]), 0.0, 1.0);
    return std::pair<Vec2, double>((1 - t) * curve.vertices_mm[k] + t * curve.vertices_mm[k + 1],
                                   (1 - t) * curve.density_per_mm[k] + t * curve.density_per_mm[k + 1]);
  };
  std::size_t entry = 0;
  double start = -(offset - std::floor(offset / period) * period);
  std::size_t k = 0;  // the piece that holds the start of the dash
  for (; start < along.back(); start += pattern[entry], entry = (entry + 1) % pattern.size()) {
    const double from = std::max(start, 0.0);
    const double to = std::min(start + pattern[entry], along.back());
    if (entry % 2 != 0 || !(to > from)) continue;
    while (k + 2 < along.size() && along[k + 1] <= from) ++k;
    CurveLight dash;
    const auto add = [&](const std::pair<Vec2, double>& vertex) {
      dash.vertices_mm.push_back(vertex.first);
      dash.density_per_mm.push_back(vertex.second);
    };
    add(at(from, k));
    while (k + 2 < along.size() && along[k + 1] < to) {
      ++k;
      add({curve.vertices_mm[k], curve.density_per_mm[k]});
    }
    add(at(to, k));
    dashes.push_back(std::move(dash));
  }
}

}  // namespace

std::vector<CurveLight> strokes_of(SvgDocument& document, const pugi::xml_node& node, const SvgStyle& style,
                                   const Vec2& view, const std::vector<Flattened>& flattened, double density) {
  const auto profiles = flux_profiles(document, node, flattened);
  std::vector<double> pattern = dash_pattern(document, node, style, view);
  auto offset = parse_length(style.dash_offset, diagonal(view), style.font_size);
  if (!offset) document.warn(node, "stroke-dashoffset \"" + style.dash_offset + "\" is not a length; taken as 0");
  if (const auto given = node.attribute("pathLength"); given && !pattern.empty()) {
    double whole = 0;
    for (const auto& flat : flattened) whole += flat.along.back();
    const auto stated = numbers_of(given.value());
    if (stated && stated->size() == 1 && stated->front() > 0) {
      for (double& dash : pattern) dash *= whole / stated->front();
      if (offset) *offset *= whole / stated->front();
    } else {
      document.warn(node, std::string("pathLength \"") + given.value() + "\" is not a number above 0, and ignored");
    }
  }
  std::vector<CurveLight> curves;
  const bool dots =
      std::any_of(flattened.begin(), flattened.end(), [](const Flattened& flat) { return flat.along.back() == 0; });
  const bool dark_dashes = !pattern.empty() && [&] {
    for (std::size_t k = 0; k < pattern.size(); k += 2) {
      if (pattern[k] > 0) return false;
    }
    return true;
  }();
  if (dots || dark_dashes)
    document.warn(node, "a stroke or dash without length has no light; mark points by class=\"point\"");
  for (std::size_t k = 0; k < flattened.size() && k < profiles.size(); ++k) {
    if (flattened[k].vertices_mm.size() < 2) continue;
    CurveLight curve{flattened[k].vertices_mm, profiles[k]};
    for (double& value : curve.density_per_mm) value *= density;
    if (pattern.empty()) {
      curves.push_back(std::move(curve));
    } else {
      cut_dashes(document, node, curve, flattened[k].along, pattern, offset.value_or(0), curves);
    }
  }
  return curves;
}

}  // namespace lightmill::detail

#include "cli/restart_picture.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "design/core/geometry.h"
#include "design/core/markup.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kPanel = 460;  // pixels
constexpr double kMargin = 44;
constexpr double kTop = 92;  // of the panels, below title and legend
constexpr const char* kCut = "#b4b9c0";
constexpr const char* kOverlap = "#e8860c";
constexpr const char* kLeft = "#2468b0";
constexpr const char* kEntry = "#c81e28";

/// A panel that shows a window of a plane; y grows upwards.
struct Panel {
  Box2 window;
  double left = 0;
  [[nodiscard]] double scale() const { return kPanel / window.size().maxCoeff(); }
  [[nodiscard]] std::string x(const Vec2& p) const { return fixed(left + (p.x() - window.min.x()) * scale(), 2); }
  [[nodiscard]] std::string y(const Vec2& p) const {
    return fixed(kTop + kPanel - (p.y() - window.min.y()) * scale(), 2);
  }
  [[nodiscard]] std::string line(const Vec2& a, const Vec2& b, const char* style) const {
    return "<line x1='" + x(a) + "' y1='" + y(a) + "' x2='" + x(b) + "' y2='" + y(b) + "' " + style + "/>\n";
  }
};

Box2 square(const Vec2& centre, double half) {
  return {centre - Vec2(half, half), centre + Vec2(half, half)};
}

std::string words(double x, double y, const std::string& text, const char* style = "") {
  return "<text x='" + fixed(x, 1) + "' y='" + fixed(y, 1) + "' " + style + ">" + escaped(text) + "</text>\n";
}

/// A length that reads well, about a fifth of the window.
double scale_bar(double window_mm) {
  double length = std::pow(10.0, std::floor(std::log10(window_mm / 4)));
  for (const double factor : {5.0, 2.0}) {
    if (length * factor <= window_mm / 4) return length * factor;
  }
  return length;
}

}  // namespace

std::string restart_picture(const Restart& restart, const std::vector<PathPiece>& pieces, const std::string& title) {
  const Vec3 place = restart.place.tip_mm, from = restart.stand_off.tip_mm;
  double reach = 1;
  for (const PathPiece& piece : pieces) {
    if (!piece.rapid) reach = std::max(reach, std::min((piece.to - place).norm(), 2 * restart.overlap_mm + 3));
  }
  // Seen from the side: along the horizontal in which the tool leans, or the cut goes.
  Vec2 across = restart.place.axis.head<2>();
  if (across.norm() < 1e-3) across = Vec2::UnitX();
  across.normalize();
  const auto above = [](const Vec3& p) -> Vec2 { return p.head<2>(); };
  const auto beside = [&](const Vec3& p) { return Vec2(across.dot(p.head<2>()), p.z()); };

  const double width = 2 * kPanel + 3 * kMargin, height = kTop + kPanel + 40;
  std::string svg =
      "<svg xmlns='http://www.w3.org/2000/svg' width='" + fixed(width, 0) + "' height='" + fixed(height, 0) +
      "' font-family='sans-serif' font-size='13' fill='#262b33'>\n<rect width='100%' height='100%' fill='white'/>\n";
  svg += words(kMargin, 26, title, "font-size='17'");
  double at = kMargin;
  const std::array<std::pair<const char*, const char*>, 4> legend{
      {{kCut, "cut"}, {kOverlap, "gone over again"}, {kLeft, "left to cut"}, {kEntry, "entry along the tool's axis"}}};
  for (const auto& [colour, what] : legend) {
    svg += "<rect x='" + fixed(at, 0) + "' y='42' width='22' height='6' fill='" + colour + "'/>\n" +
           words(at + 28, 50, what);
    at += 150;
  }

  const double side_reach = std::max(reach, 0.55 * (from - place).norm());
  const std::array<Panel, 2> panels{
      {{square(above(place), reach), kMargin}, {square(beside((from + place) / 2), side_reach), 2 * kMargin + kPanel}}};
  for (int view = 0; view < 2; ++view) {
    const Panel& panel = panels[static_cast<std::size_t>(view)];
    const std::string clip = view == 0 ? "above" : "beside";
    svg += words(
        panel.left, kTop - 10,
        view == 0 ? "from above: x to the right, y up" : "from the side: the tool leans in the picture's plane, z up");
    svg += "<clipPath id='" + clip + "'><rect x='" + fixed(panel.left, 1) + "' y='" + fixed(kTop, 1) + "' width='" +
           fixed(kPanel, 1) + "' height='" + fixed(kPanel, 1) + "'/></clipPath>\n<rect x='" + fixed(panel.left, 1) +
           "' y='" + fixed(kTop, 1) + "' width='" + fixed(kPanel, 1) + "' height='" + fixed(kPanel, 1) +
           "' fill='none' stroke='#d5d8dc'/>\n<g clip-path='url(#" + clip + ")' stroke-linecap='round'>\n";
    const auto point = [&](const Vec3& p) { return view == 0 ? above(p) : beside(p); };
    for (const PathPiece& piece : pieces) {
      // From the side only what lies near the plane, or rows would hide each other.
      if (view == 1) {
        const Vec2 normal(-across.y(), across.x());
        if (std::abs(normal.dot((piece.to - place).head<2>())) > std::max(0.6 * restart.overlap_mm, 0.5)) continue;
      }
      const char* colour = piece.line < restart.first_line ? kCut : piece.line < restart.uncut_line ? kOverlap : kLeft;
      const std::string style = std::string("stroke='") + colour + "' stroke-width='" +
                                (piece.rapid          ? "1' stroke-dasharray='5 4'"
                                 : colour == kOverlap ? "4'"
                                                      : "2'");
      svg += panel.line(point(piece.from), point(piece.to), style.c_str());
    }
    const std::string entry = std::string("stroke='") + kEntry + "' stroke-width='2.5'";
    if (restart.entry_lines > 0) svg += panel.line(point(from), point(place), entry.c_str());
    svg += "<circle cx='" + panel.x(point(place)) + "' cy='" + panel.y(point(place)) + "' r='5' fill='" + kEntry +
           "'/>\n</g>\n";
    const double bar = scale_bar(panel.window.size().x());
    const double y = kTop + kPanel + 18;
    svg += "<line x1='" + fixed(panel.left, 1) + "' y1='" + fixed(y, 1) + "' x2='" +
           fixed(panel.left + bar * panel.scale(), 1) + "' y2='" + fixed(y, 1) +
           "' stroke='#262b33' stroke-width='2'/>\n" +
           words(panel.left + bar * panel.scale() + 8, y + 4, compact(bar, 3) + " mm");
  }
  svg += words(kMargin, height - 4,
               "restart at x " + fixed(place.x(), 3) + ", y " + fixed(place.y(), 3) + ", z " + fixed(place.z(), 3) +
                   " mm of the workpiece, line " + std::to_string(restart.first_line) + "; cut before line " +
                   std::to_string(restart.uncut_line));
  return svg + "</svg>\n";
}

}  // namespace lightmill

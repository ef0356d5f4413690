#include "machine/detail/fault_picture.h"

#include <algorithm>
#include <cmath>

#include "design/core/markup.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kWidth_mm = 40, kHeight_mm = 30;  ///< what is seen around the fault
constexpr double kPixelsPerMm = 14;
constexpr int kColumns = 400;

std::string picture_of(double width, double height) {
  const std::string w = compact(width, 0), h = compact(height, 0);
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " + w + " " + h + "\" width=\"" + w + "\" height=\"" + h + "\">\n<rect width=\"" + w +
         "\" height=\"" + h + "\" fill=\"#ffffff\"/>\n";
}

}  // namespace

std::string svg_words(double x, double y, const std::string& text, int size) {
  return "<text x=\"" + compact(x, 0) + "\" y=\"" + compact(y, 0) + "\" font-family=\"DejaVu Sans, Arial, sans-serif\" font-size=\"" +
         std::to_string(size) + "\" fill=\"#1c2430\">" + escaped(text) + "</text>\n";
}

std::string fault_picture(const StockField& field, const SolidStock* solid, const Tool& tool, const ToolPose& pose, const Vec3& motion_mm,
                          const Vec3& place_mm, const std::vector<KeepOut>& obstacles) {
  Vec2 along = pose.axis.head<2>();
  if (along.norm() < 1e-3) along = motion_mm.head<2>();
  along = along.norm() > 1e-9 ? along.normalized().eval() : Vec2(1, 0);
  const Vec2 centre = place_mm.head<2>();
  const double left = -kWidth_mm / 2, bottom = place_mm.z() - kHeight_mm * 0.4;
  const auto x = [&](double s) { return compact((s - left) * kPixelsPerMm, 1); };
  const auto y = [&](double z) { return compact((kHeight_mm - (z - bottom)) * kPixelsPerMm, 1); };
  const auto point = [&](double s, double z) { return x(s) + "," + y(z) + " "; };
  std::string svg = picture_of(kWidth_mm * kPixelsPerMm, kHeight_mm * kPixelsPerMm);

  // The stock along the plane: the heights' outline, or the spans of the solid's nearest rays.
  const auto polygon = [&](const std::string& points) {
    svg += "<polygon points=\"" + points + "\" fill=\"#bcd3ea\" stroke=\"#3b6ea5\"/>\n";
  };
  if (solid != nullptr) {
    const auto spans_at = [&](int column) -> std::span<const Span> {
      const Vec2 p = centre + (left + kWidth_mm * (column + 0.5) / kColumns) * along;
      const auto i = solid->cells(0, p.x() - solid->pitch_mm().x() / 2, kNothing), j = solid->cells(1, p.y() - solid->pitch_mm().y() / 2, kNothing);
      const Vec2 beside = (p.cwiseAbs() - solid->blank().size_mm / 2);
      if (beside.maxCoeff() > 0 || i.empty() || j.empty()) return {};
      return solid->rays(2).at(i.from, j.from);
    };
    // Columns with the same number of spans are drawn together.
    for (int k = 0; k < kColumns;) {
      int end = k + 1;
      while (end < kColumns && spans_at(end).size() == spans_at(k).size()) ++end;
      for (std::size_t n = 0; n < spans_at(k).size(); ++n) {
        std::string tops, bottoms;
        for (int column = k; column < end; ++column) {
          const Span& span = spans_at(column)[n];
          for (const int side : {0, 1}) {
            const double s = left + kWidth_mm * (column + side) / kColumns;
            tops += point(s, span.to);
            bottoms.insert(0, point(s, span.from));
          }
        }
        polygon(tops + bottoms);
      }
      k = end;
    }
  } else {
    const auto height_at = [&](double s) {
      const Vec2 p = centre + s * along;
      const double i = std::round((p.x() - field.extent().min.x()) / field.pitch_mm()), j = std::round((p.y() - field.extent().min.y()) / field.pitch_mm());
      const Grid<float>& heights = field.heights();
      if (i < 0 || j < 0 || i >= heights.width || j >= heights.height) return 0.0;
      return static_cast<double>(heights.at(static_cast<int>(i), static_cast<int>(j)));
    };
    std::string outline = point(left, std::min(0.0, bottom));
    for (int k = 0; k <= kColumns; ++k) {
      const double s = left + kWidth_mm * k / kColumns;
      outline += point(s, height_at(s));
    }
    polygon(outline + point(-left, std::min(0.0, bottom)));
  }

  // Clamps and table, where the plane meets them.
  for (const KeepOut& box : obstacles) {
    double from = left, to = -left;
    for (int axis = 0; axis < 2; ++axis) {
      if (std::abs(along[axis]) < 1e-9) {
        if (centre[axis] < box.min_mm[axis] || centre[axis] > box.max_mm[axis]) to = from;
        continue;
      }
      const double a = (box.min_mm[axis] - centre[axis]) / along[axis], b = (box.max_mm[axis] - centre[axis]) / along[axis];
      from = std::max(from, std::min(a, b));
      to = std::min(to, std::max(a, b));
    }
    if (to <= from) continue;
    const double low = std::max(box.min_mm.z(), bottom - 10);
    svg += "<polygon points=\"" + point(from, low) + point(from, box.max_mm.z()) + point(to, box.max_mm.z()) + point(to, low) +
           "\" fill=\"#9aa3ad\" stroke=\"#5b6675\"/>\n";
  }

  // The tool: its outline in the plane, that of a body of revolution whose axis lies in it.
  const double tip_s = (pose.tip_mm.head<2>() - centre).dot(along);
  const Vec2 axis = Vec2(pose.axis.head<2>().dot(along), pose.axis.z()).normalized();
  const Vec2 across(axis.y(), -axis.x());
  const Vec2 tip(tip_s, pose.tip_mm.z());
  const auto part = [&](const std::vector<Vec2>& side, const char* fill) {
    std::string points;
    for (const Vec2& p : side) {
      const Vec2 q = tip + p.y() * axis + p.x() * across;
      points += point(q.x(), q.y());
    }
    for (std::size_t k = side.size(); k-- > 0;) {
      const Vec2 q = tip + side[k].y() * axis - side[k].x() * across;
      points += point(q.x(), q.y());
    }
    svg += "<polygon points=\"" + points + "\" fill=\"" + fill + "\" fill-opacity=\"0.75\" stroke=\"#1c2430\" stroke-width=\"0.7\"/>\n";
  };
  std::vector<Vec2> end{{0, 0}};
  for (int k = 0; k <= 16; ++k) {
    const double angle = kPi / 2 * k / 16;
    end.emplace_back(tool.radius_mm - tool.corner_mm + tool.corner_mm * std::sin(angle), tool.corner_mm * (1 - std::cos(angle)));
  }
  part(end, "#e8b04a");
  for (const Tool::Slice& slice : tool.slices) {
    const char* fill = slice.part == Tool::Part::kFlutes ? "#e8b04a" : slice.part == Tool::Part::kShank ? "#c9ced6" : "#8f98a3";
    part({{slice.body.from_radius_mm, slice.body.from_mm}, {slice.body.to_radius_mm, slice.body.to_mm}}, fill);
  }

  svg += "<circle cx=\"" + x(0) + "\" cy=\"" + y(place_mm.z()) + "\" r=\"9\" fill=\"none\" stroke=\"#b3261e\" stroke-width=\"2.5\"/>\n";
  const double low = kHeight_mm * kPixelsPerMm - 14;
  svg += "<line x1=\"10\" y1=\"" + compact(low, 0) + "\" x2=\"" + compact(10 + 5 * kPixelsPerMm, 0) + "\" y2=\"" + compact(low, 0) +
         "\" stroke=\"#1c2430\" stroke-width=\"3\"/>\n";
  svg += svg_words(10 + 5 * kPixelsPerMm + 8, low + 5, "5 mm");
  return svg + "</svg>\n";
}

std::string travel_picture(const MachineModel& machine, const JointPosition& at, const JointPosition& target) {
  struct Bar {
    std::string letter, unit;
    double least, most, from, to;
  };
  constexpr double kDegreesPerRad = 180 / kPi;
  std::vector<Bar> bars;
  const auto linear = [&](const char* letter, const LinearAxis& axis, double from, double to) {
    bars.push_back({letter, " mm", axis.min_mm, axis.max_mm, from, to});
  };
  const auto rotary = [&](const RotaryAxis& axis, double from, double to) {
    // An endless axis has no travel to draw.
    if (!std::isfinite(axis.min_rad) || !std::isfinite(axis.max_rad)) return;
    bars.push_back({std::string(1, axis.letter), " deg", axis.min_rad * kDegreesPerRad, axis.max_rad * kDegreesPerRad, from * kDegreesPerRad, to * kDegreesPerRad});
  };
  linear("X", machine.x, at.x_mm, target.x_mm);
  linear("Y", machine.y, at.y_mm, target.y_mm);
  linear("Z", machine.z, at.z_mm, target.z_mm);
  if (machine.has_rotary()) {
    rotary(machine.outer, at.outer_rad, target.outer_rad);
    rotary(machine.inner, at.inner_rad, target.inner_rad);
  }
  constexpr double kBarLeft = 150, kBarWidth = 300, kBeside = 90, kRow = 46, kBarHeight = 16, kTop = 52;
  std::string svg = picture_of(kWidth_mm * kPixelsPerMm, kTop + 10 + kRow * static_cast<double>(bars.size()));
  double top = kTop;
  for (const Bar& bar : bars) {
    const double scale = kBarWidth / std::max(bar.most - bar.least, 1e-9);
    // What lies far outside is drawn at the picture's edge.
    const auto x = [&](double value) { return compact(kBarLeft + std::clamp((value - bar.least) * scale, -kBeside, kBarWidth + kBeside), 1); };
    constexpr double kSlack = 1e-6;
    const bool passes = bar.to < bar.least - kSlack || bar.to > bar.most + kSlack;
    const std::string colour = passes ? "#b3261e" : "#1d7a46";
    const std::string middle = compact(top + kBarHeight / 2, 1);
    svg += "<rect x=\"" + compact(kBarLeft, 0) + "\" y=\"" + compact(top, 0) + "\" width=\"" + compact(kBarWidth, 0) + "\" height=\"" + compact(kBarHeight, 0) +
           "\" fill=\"#dde2e8\"/>\n<line x1=\"" + x(bar.from) + "\" y1=\"" + middle + "\" x2=\"" + x(bar.to) + "\" y2=\"" + middle + "\" stroke=\"" + colour +
           "\" stroke-width=\"4\"/>\n<circle cx=\"" + x(bar.to) + "\" cy=\"" + middle + "\" r=\"6\" fill=\"" + colour + "\"/>\n" +
           svg_words(10, top + 13, bar.letter + " to " + compact(bar.to, 2) + bar.unit) + svg_words(kBarLeft, top + kBarHeight + 14, compact(bar.least, 1)) +
           svg_words(kBarLeft + kBarWidth - 30, top + kBarHeight + 14, compact(bar.most, 1));
    top += kRow;
  }
  return svg + "</svg>\n";
}

}  // namespace lightmill

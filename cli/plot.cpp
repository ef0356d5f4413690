#include "cli/plot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "design/core/markup.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr std::array kColours{"#173d8c", "#b3261e", "#1d7a46", "#a15c00", "#6a3d9a", "#0b7285", "#5b6675"};
constexpr const char* kText = "font-family=\"DejaVu Sans, Arial, sans-serif\" font-size=\"13\" fill=\"#1c2430\"";

std::string at(double v) { return compact(v, 1); }

std::string text(double x, double y, const std::string& words, const char* anchor, const std::string& more = "") {
  return "<text x=\"" + at(x) + "\" y=\"" + at(y) + "\" text-anchor=\"" + anchor + "\" " + kText + more + ">" + escaped(words) + "</text>\n";
}

std::string stroke(double x0, double y0, double x1, double y1, const char* colour, double width) {
  return "<line x1=\"" + at(x0) + "\" y1=\"" + at(y0) + "\" x2=\"" + at(x1) + "\" y2=\"" + at(y1) + "\" stroke=\"" + colour +
         "\" stroke-width=\"" + at(width) + "\"/>\n";
}

struct Scale {
  double least = 0, most = 1;
  bool log = false;
  [[nodiscard]] double share(double v) const {
    return log ? std::log(v / least) / std::log(most / least) : (v - least) / (most - least);
  }
  /// Round values within.
  [[nodiscard]] std::vector<double> ticks() const {
    std::vector<double> result;
    if (log) {
      for (double decade = std::pow(10, std::floor(std::log10(least))); decade <= most; decade *= 10) {
        for (const double m : {1.0, 2.0, 5.0}) {
          if (m * decade >= least * (1 - 1e-9) && m * decade <= most * (1 + 1e-9)) result.push_back(m * decade);
        }
      }
      return result;
    }
    const double rough = (most - least) / 5, decade = std::pow(10, std::floor(std::log10(rough)));
    const double tick = rough / decade < 1.5 ? decade : rough / decade < 3.5 ? 2 * decade : rough / decade < 7.5 ? 5 * decade : 10 * decade;
    for (double v = std::ceil(least / tick - 1e-9) * tick; v <= most + 1e-9 * tick; v += tick) result.push_back(std::abs(v) < tick / 1000 ? 0 : v);
    return result;
  }
};

Scale scale_of(const std::vector<double>& values, bool log) {
  Scale scale;
  scale.log = log;
  scale.least = *std::min_element(values.begin(), values.end());
  scale.most = *std::max_element(values.begin(), values.end());
  if (log) {
    scale.least /= 1.15;
    scale.most *= 1.15;
  } else {
    scale.least = std::min(0.0, scale.least);
    scale.most = scale.most > scale.least ? scale.most + 0.06 * (scale.most - scale.least) : scale.least + 1;
  }
  return scale;
}

}  // namespace

std::string line_plot(const std::vector<PlotLine>& lines, const PlotAxes& axes) {
  constexpr double kWidth = 860, kHeight = 400, kLeft = 70, kRight = 150, kTop = 20, kBottom = 52;
  std::vector<double> xs, ys;
  for (const PlotLine& line : lines) {
    for (const auto& [x, y] : line.points) {
      xs.push_back(x);
      ys.push_back(y);
    }
  }
  if (xs.empty()) return "";
  const Scale across = scale_of(xs, axes.log_across), up = scale_of(ys, axes.log_up);
  const auto px = [&](double v) { return kLeft + across.share(v) * (kWidth - kLeft - kRight); };
  const auto py = [&](double v) { return kHeight - kBottom - up.share(v) * (kHeight - kTop - kBottom); };
  std::string svg = "<svg viewBox=\"0 0 " + at(kWidth) + " " + at(kHeight) + "\" width=\"" + at(kWidth) + "\">\n";
  for (const double v : across.ticks()) {
    svg += stroke(px(v), kTop, px(v), kHeight - kBottom, "#e4e8ed", 1) + text(px(v), kHeight - kBottom + 18, compact(v, 3), "middle");
  }
  for (const double v : up.ticks()) {
    svg += stroke(kLeft, py(v), kWidth - kRight, py(v), "#e4e8ed", 1) + text(kLeft - 8, py(v) + 4, compact(v, 4), "end");
  }
  svg += text((kLeft + kWidth - kRight) / 2, kHeight - 12, axes.across, "middle");
  svg += text(0, 0, axes.up, "middle", " transform=\"translate(18 " + at((kTop + kHeight - kBottom) / 2) + ") rotate(-90)\"");
  // Names beside the lines' ends, moved apart where they would meet.
  std::vector<std::pair<double, std::size_t>> names;
  for (std::size_t k = 0; k < lines.size(); ++k) {
    const char* colour = kColours[k % kColours.size()];
    std::string points;
    for (const auto& [x, y] : lines[k].points) {
      points += at(px(x)) + "," + at(py(y)) + " ";
      svg += "<circle cx=\"" + at(px(x)) + "\" cy=\"" + at(py(y)) + "\" r=\"3\" fill=\"" + colour + "\"/>\n";
    }
    svg += "<polyline fill=\"none\" stroke=\"" + std::string(colour) + "\" stroke-width=\"2\" points=\"" + points + "\"/>\n";
    if (!lines[k].points.empty()) names.emplace_back(py(lines[k].points.back().second), k);
  }
  std::sort(names.begin(), names.end());
  double above = -std::numeric_limits<double>::infinity();
  for (const auto& [y, k] : names) {
    above = std::max(y, above + 16);
    svg += "<text x=\"" + at(kWidth - kRight + 10) + "\" y=\"" + at(above + 4) + "\" font-family=\"DejaVu Sans, Arial, sans-serif\" font-size=\"13\" fill=\"" +
           kColours[k % kColours.size()] + "\">" + escaped(lines[k].name) + "</text>\n";
  }
  return svg + "</svg>";
}

std::string histogram_plot(double first, double width, const std::vector<double>& values, const PlotAxes& axes) {
  if (values.empty()) return "";
  constexpr double kWidth = 380, kHeight = 270, kLeft = 62, kRight = 14, kTop = 14, kBottom = 48;
  const double last = first + width * static_cast<double>(values.size());
  const Scale across{first, last, false}, up = scale_of(values, false);
  const auto px = [&](double v) { return kLeft + across.share(v) * (kWidth - kLeft - kRight); };
  const auto py = [&](double v) { return kHeight - kBottom - up.share(v) * (kHeight - kTop - kBottom); };
  std::string svg = "<svg viewBox=\"0 0 " + at(kWidth) + " " + at(kHeight) + "\">\n";
  for (const double v : up.ticks()) svg += stroke(kLeft, py(v), kWidth - kRight, py(v), "#e4e8ed", 1) + text(kLeft - 8, py(v) + 4, compact(v, 4), "end");
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double from = first + width * static_cast<double>(k);
    svg += "<rect x=\"" + at(px(from)) + "\" y=\"" + at(py(values[k])) + "\" width=\"" + at(px(from + width) - px(from)) + "\" height=\"" +
           at(py(0) - py(values[k])) + "\" fill=\"" + (from + width / 2 < 0 ? "#2166ac" : "#b2182b") + "\" stroke=\"#fff\" stroke-width=\"0.5\"/>\n";
  }
  for (const double v : across.ticks()) svg += stroke(px(v), py(0), px(v), py(0) + 5, "#5b6675", 1) + text(px(v), kHeight - kBottom + 20, compact(v, 3), "middle");
  svg += stroke(kLeft, py(0), kWidth - kRight, py(0), "#5b6675", 1) + text((kLeft + kWidth - kRight) / 2, kHeight - 10, axes.across, "middle");
  svg += text(0, 0, axes.up, "middle", " transform=\"translate(18 " + at((kTop + kHeight - kBottom) / 2) + ") rotate(-90)\"");
  return svg + "</svg>";
}

std::string bar_plot(const std::vector<PlotBar>& bars, const std::string& title) {
  if (bars.empty()) return "";
  constexpr double kWidth = 860, kLeft = 330, kRight = 80, kTop = 40, kRow = 26;
  const double height = kTop + kRow * static_cast<double>(bars.size()) + 14;
  std::vector<double> values{0};
  for (const PlotBar& bar : bars) values.push_back(bar.value);
  const Scale scale = scale_of(values, false);
  const auto px = [&](double v) { return kLeft + scale.share(v) * (kWidth - kLeft - kRight); };
  std::string svg = "<svg viewBox=\"0 0 " + at(kWidth) + " " + at(height) + "\" width=\"" + at(kWidth) + "\">\n";
  svg += text(kLeft, 22, title, "start");
  for (std::size_t k = 0; k < bars.size(); ++k) {
    const double y = kTop + kRow * static_cast<double>(k), zero = px(0), end = px(bars[k].value);
    svg += text(kLeft - 12, y + 16, bars[k].name, "end");
    svg += "<rect x=\"" + at(std::min(zero, end)) + "\" y=\"" + at(y + 3) + "\" width=\"" + at(std::max(1.0, std::abs(end - zero))) +
           "\" height=\"" + at(kRow - 8) + "\" fill=\"" + (bars[k].value >= 0 ? "#b3261e" : "#1d7a46") + "\"/>\n";
    svg += text(std::max(zero, end) + 6, y + 16, fixed(bars[k].value, 4), "start");
  }
  svg += stroke(px(0), kTop - 4, px(0), height - 10, "#5b6675", 1);
  return svg + "</svg>";
}

}  // namespace lightmill

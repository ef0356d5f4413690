// Plots as SVG, for pages.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace lightmill {

struct PlotLine {
  std::string name;
  std::vector<std::pair<double, double>> points;
};
struct PlotAxes {
  std::string across, up;
  bool log_across = false, log_up = false;
};
/// Lines with their names beside them; the ordinate begins at 0 unless it is logarithmic.
std::string line_plot(const std::vector<PlotLine>& lines, const PlotAxes& axes);

/// Upright bars side by side, bar k from first + k width on; blue below zero, red above.
std::string histogram_plot(double first, double width, const std::vector<double>& values, const PlotAxes& axes);

struct PlotBar {
  std::string name;
  double value = 0;
};
/// Horizontal bars, from zero to either side.
std::string bar_plot(const std::vector<PlotBar>& bars, const std::string& title);

}  // namespace lightmill

// A folder for drawings that a test writes, and how much light they come to.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "design/target.h"

namespace lightmill {

/// A folder that goes away with the test.
class DrawingFixture : public ::testing::Test {
 protected:
  DrawingFixture() {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::temp_directory_path() /
              ("lightmill_drawing_" + std::string(info->name()) + "_" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder_);
  }
  ~DrawingFixture() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return folder_ / name;
  }
  /// A whole drawing on 200 x 100 mm, seen from behind: x to the right, y up, origin in the centre.
  TargetSpec whole(const std::string& svg) const {
    TargetSpec spec;
    spec.drawing = write("drawing.svg", svg);
    spec.size_mm = {200, 100};
    spec.viewed_from = ViewedFrom::kBehind;
    return spec;
  }
  /// The same of 200 x 100 user units, with a body that begins on line 2.
  TargetSpec drawing(const std::string& body) const {
    return whole(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" viewBox=\"0 0 200 "
        "100\">\n" +
        body + "\n</svg>\n");
  }
  /// Light of `body`, drawn in the right half, in units of white area [mm^2], against a white square in the left half.
  double light_of(const std::string& body) const {
    const TargetLight target = load_target(
        drawing("<rect x=\"13.3\" y=\"27.1\" width=\"40\" height=\"40\" style=\"fill:white !important\"/>" + body));
    const Grid<double> halves = rasterise_area(target, 2, 1);
    return halves.at(1, 0) / halves.at(0, 0) * 1600;
  }

  std::filesystem::path folder_;
};

}  // namespace lightmill

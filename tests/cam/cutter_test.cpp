#include "cam/cutter.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "design/core/errors.h"

namespace lightmill {
namespace {

using ::testing::HasSubstr;

const std::filesystem::path kCutters = std::filesystem::path(LIGHTMILL_FIXTURES) / "cutters";

constexpr const char* kGood = R"(name = "ball"
number = 7
diameter_mm = 3.0
corner_radius_mm = 1.5
edges = 2
flute_length_mm = 5
shank_diameter_mm = 4
length_mm = 60.0
centre_cutting = true
spindle_rpm = 30000
feed_per_tooth_mm = 0.02
plunge_feed_mm_per_min = 120
coolant = "mist"
shank = [[4, 3, 4]]
holder = [[10, 12, 17], [30.0, 20.0, 24]]
)";

class CutterFile : public ::testing::Test {
 protected:
  std::filesystem::path write(const std::string& text) {
    const auto path =
        std::filesystem::path(::testing::TempDir()) /
        (std::string("cutter_") + ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".toml");
    std::ofstream(path) << text;
    return path;
  }
  /// kGood with one line replaced (or left out).
  std::string with(const std::string& key, const std::string& line) {
    std::string text = kGood;
    const auto at = text.find("\n" + key + " =") + 1;
    text.replace(at, text.find('\n', at) + 1 - at, line.empty() ? "" : line + "\n");
    return text;
  }
  std::string complaint(const std::string& text) {
    try {
      read_cutter(write(text));
    } catch (const InputError& e) {
      return e.what();
    }
    return "no complaint";
  }
};

TEST_F(CutterFile, GivesWhatItSays) {
  const Cutter c = read_cutter(write(kGood));
  EXPECT_EQ(c.name, "ball");
  EXPECT_EQ(c.number, 7);
  EXPECT_TRUE(c.is_ball());
  EXPECT_TRUE(c.centre_cutting);
  EXPECT_DOUBLE_EQ(c.radius_mm(), 1.5);
  EXPECT_DOUBLE_EQ(c.plunge_feed_mm_per_s, 2);
  EXPECT_DOUBLE_EQ(c.feed_mm_per_s(), 500 * 2 * 0.02);
  ASSERT_EQ(c.holder.size(), 2u);
  EXPECT_DOUBLE_EQ(c.holder[0].to_radius_mm, 8.5);
  EXPECT_DOUBLE_EQ(c.holder[1].from_mm, 30);
  EXPECT_DOUBLE_EQ(c.holder[1].to_mm, 60);
  EXPECT_DOUBLE_EQ(c.reach_mm(), 20);
  ASSERT_EQ(c.shank.size(), 1u);
  EXPECT_DOUBLE_EQ(c.shank[0].from_mm, 5);
  EXPECT_DOUBLE_EQ(c.shank[0].to_mm, 9);
  EXPECT_DOUBLE_EQ(c.shank[0].from_radius_mm, 1.5);
  EXPECT_DOUBLE_EQ(c.shank[0].to_radius_mm, 2);
}

TEST_F(CutterFile, HasDataForEachMaterialAndNamesThoseItKnows) {
  std::string shape, data;
  std::istringstream lines(kGood);
  for (std::string line; std::getline(lines, line);) {
    const bool of_cutting = line.starts_with("spindle_rpm") || line.starts_with("feed_per_tooth") || line.starts_with("plunge_feed") || line.starts_with("coolant");
    (of_cutting ? data : shape) += line + "\n";
  }
  const std::string slower = "spindle_rpm = 300\nfeed_per_tooth_mm = 0.01\nplunge_feed_mm_per_min = 60\nsource = \"a table\"\n";
  const auto path = write(shape + "[material.PMMA]\n" + data + "[material.PC]\n" + slower);
  EXPECT_DOUBLE_EQ(read_cutter(path, "PMMA").feed_mm_per_s(), 500 * 2 * 0.02);
  const Cutter pc = read_cutter(path, material_name("PC, extruded"));
  EXPECT_DOUBLE_EQ(pc.feed_mm_per_s(), 300 / 60.0 * 2 * 0.01);
  EXPECT_EQ(pc.source, "a table");
  EXPECT_DOUBLE_EQ(pc.radius_mm(), 1.5);
  EXPECT_DOUBLE_EQ(read_cutter(path).radius_mm(), 1.5) << "where only the shape matters";
  try {
    read_cutter(path, "glass");
    FAIL() << "no error";
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("no cutting data for the material 'glass', only for PC, PMMA"));
  }
  // A table that is not chosen is read as strictly; data beside tables is unknown, and none at all is missing.
  EXPECT_THAT(complaint(shape + "[material.PMMA]\n" + data + "[material.PC]\nspindle_rpm = 0\n"), HasSubstr("material.PC.spindle_rpm"));
  EXPECT_THAT(complaint(shape + data + "[material.PC]\n" + slower), HasSubstr("unknown key"));
  EXPECT_THAT(complaint(shape), HasSubstr("spindle_rpm: is missing"));
  EXPECT_EQ(material_name("PMMA"), "PMMA");
}

TEST_F(CutterFile, AllFixturesAreRead) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kCutters)) {
    const Cutter c = read_cutter(entry.path());
    EXPECT_GT(c.feed_mm_per_s(), 0) << entry.path();
    EXPECT_FALSE(c.holder.empty()) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 3);
  EXPECT_TRUE(read_cutter(kCutters / "finish_4mm_ball.toml").is_ball());
  EXPECT_FALSE(read_cutter(kCutters / "rough_10mm.toml").is_ball());
}

TEST_F(CutterFile, ErrorsNameFileLineKeyAndRule) {
  EXPECT_THAT(complaint(with("diameter_mm", "diameter_mm = -1")), HasSubstr(".toml:3: diameter_mm = -1"));
  EXPECT_THAT(complaint(with("diameter_mm", "diameter_mm = \"3\"")), HasSubstr("diameter_mm"));
  EXPECT_THAT(complaint(with("diameter_mm", "")), HasSubstr("diameter_mm: is missing"));
  EXPECT_THAT(complaint(with("corner_radius_mm", "corner_radius_mm = 2")), HasSubstr("at most half of diameter_mm"));
  EXPECT_THAT(complaint(with("number", "number = 0")), HasSubstr("number"));
  EXPECT_THAT(complaint(with("coolant", "coolant = \"beer\"")), HasSubstr("\"mist\""));
  EXPECT_THAT(complaint(with("coolant", "colour = \"red\"")), HasSubstr("unknown key 'colour'"));
  EXPECT_THAT(complaint(with("holder", "holder = [[20, 30, 6, 8]]")), HasSubstr("rows of 3"));
  EXPECT_THAT(complaint(with("holder", "holder = [[20, 30, \"8\"]]")), HasSubstr("rows of 3"));
  EXPECT_THAT(complaint(with("holder", "holder = [[0, 12, 16]]")), HasSubstr("each above 0"));
  EXPECT_THAT(complaint(with("holder", "holder = [[56, 12, 16]]")), HasSubstr("gauge line"));
  EXPECT_THAT(complaint(with("shank", "shank = [[16, 3, 4]]")), HasSubstr("1 mm inside the holder"));
  EXPECT_THAT(complaint("name = "), HasSubstr("not valid TOML"));
  EXPECT_THROW(read_cutter("/nowhere/cutter.toml"), InputError);
}

TEST_F(CutterFile, TakesATaperedBallWhoseConeEndsWithinTheShank) {
  const std::string wide = with("shank", "shank = [[4, 4, 5]]");
  const Cutter cutter = read_cutter(write(wide + "taper_deg = 5\n"));
  EXPECT_NEAR(cutter.taper_rad, 5 * 3.14159265358979 / 180, 1e-9);
  // The cone touches the ball: its distance from the centre is the radius, at right angles.
  const double t = cutter.taper_rad;
  EXPECT_NEAR(cutter.flute_radius_mm(cutter.side_from_mm()), 1.5 * std::cos(t), 1e-12);
  EXPECT_NEAR(cutter.flute_radius_mm(3) - cutter.flute_radius_mm(2), std::tan(t), 1e-12);
  EXPECT_THAT(complaint(wide + "taper_deg = 10\n"), HasSubstr("wider than the shank"));
  EXPECT_THAT(complaint(with("corner_radius_mm", "corner_radius_mm = 1") + "taper_deg = 5\n"), HasSubstr("only balls"));
}

}  // namespace
}  // namespace lightmill

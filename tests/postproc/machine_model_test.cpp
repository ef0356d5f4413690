#include "postproc/machine_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "tests/postproc/support.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

using testing::HasSubstr;

const std::filesystem::path kFixture = std::filesystem::path(LIGHTMILL_FIXTURES) / "machines/hsm400u_grblhal.toml";

// The message of reading the fixture with `find` replaced by `replace` (all of its first occurrence).
std::string complaint(const std::string& find, const std::string& replace) {
  std::string text = read_whole(kFixture);
  const std::size_t at = text.find(find);
  EXPECT_NE(at, std::string::npos) << find;
  text.replace(at, find.size(), replace);
  const test::ScratchFolder folder;
  const auto path = folder / "machine_model_test.toml";
  write_whole(path, text);
  try {
    read_machine(path);
  } catch (const InputError& e) {
    EXPECT_THAT(e.what(), HasSubstr("machine_model_test.toml")) << "the file is named";
    return e.what();
  }
  return "accepted";
}

TEST(ReadMachine, TurnsUnitsIntoMmRadAndSeconds) {
  const MachineModel machine = read_machine(kFixture);
  EXPECT_EQ(machine.outer.letter, 'B');
  EXPECT_EQ(machine.inner.letter, 'C');
  EXPECT_DOUBLE_EQ(machine.x.max_speed_mm_per_s, 40000 / 60.0);
  EXPECT_DOUBLE_EQ(machine.outer.max_rad, 110 * kPi / 180);
  EXPECT_DOUBLE_EQ(machine.inner.max_speed_rad_per_s, 1500 * kPi / 180);
  EXPECT_TRUE(std::isinf(machine.inner.max_rad));
  EXPECT_EQ(machine.outer.direction, -1);
  EXPECT_EQ(machine.max_tool_length_mm, 120);
  EXPECT_THAT(machine.notes, HasSubstr("nverified"));
}

TEST(ReadMachine, EveryFixtureIsGood) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kFixture.parent_path())) {
    if (entry.path().extension() != ".toml") continue;
    EXPECT_NO_THROW(read_machine(entry.path())) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 8);
  for (const char* ready : {"mikron_hsm400u_itnc530", "trunnion_linuxcnc", "desktop_5axis_grblhal", "vmc_ac_fanuc",
                            "head_table_siemens840d", "router_grblhal"}) {
    EXPECT_TRUE(std::filesystem::exists(kFixture.parent_path() / (std::string(ready) + ".toml"))) << ready;
  }
}

// A figure that can crash a machine says where it comes from, or that nobody has checked it.
TEST(ReadMachine, EveryFieldOfEveryFixtureHasItsSource) {
  for (const auto& entry : std::filesystem::directory_iterator(kFixture.parent_path())) {
    std::ifstream in(entry.path());
    for (std::string line; std::getline(in, line);) {
      const bool value = !line.empty() && line.front() != '#' && line.find(" = ") != std::string::npos;
      if (!value || line.starts_with("name = ") || line.starts_with("notes = ")) continue;
      EXPECT_NE(line.find(" # "), std::string::npos) << entry.path() << ": " << line;
    }
  }
}

TEST(ReadMachine, RefusesNamingKeyAndRule) {
  EXPECT_THAT(complaint("retract_z_mm", "retractz_mm"), HasSubstr("retract"));
  EXPECT_THAT(complaint("[spindle]", "[spindel]"), HasSubstr("spind"));
  EXPECT_THAT(complaint("min_mm = -250.0", "min_mm = 251.0"),
              HasSubstr("x.max_mm = 250.0: must be greater than min_mm"));
  EXPECT_THAT(complaint("max_mm = 250.0", "max_mm = \"wide\""), HasSubstr("x.max_mm"));
  EXPECT_THAT(complaint("acceleration_mm_per_s2 = 10000", "acceleration_mm_per_s2 = 0"),
              HasSubstr("must be greater than 0"));
  EXPECT_THAT(complaint("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 0.0]"), HasSubstr("outer.axis"));
  EXPECT_THAT(complaint("axis = [0.0, 0.0, 1.0]", "axis = [0.0, 2.0, 0.0]"), HasSubstr("parallel to outer.axis"));
  EXPECT_THAT(complaint("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 1.0]"), HasSubstr("parallel"));
  EXPECT_THAT(complaint("direction = -1", "direction = 0.5"), HasSubstr("outer.direction"));
  EXPECT_THAT(complaint("min_deg = -110.0", "#"), HasSubstr("min_deg and max_deg"));
  EXPECT_THAT(complaint("min_deg = -110.0", "min_deg = 10.0"), HasSubstr("enclose 0"));
  EXPECT_THAT(complaint("letter = \"C\"", "letter = \"B\""), HasSubstr("inner.letter"));
  EXPECT_THAT(complaint("letter = \"C\"", "letter = \"U\""), HasSubstr("inner.letter"));
  EXPECT_THAT(complaint("point_mm = [0.0, 0.0, -380.0]", "point_mm = [5000.0, 0.0, -380.0]"),
              HasSubstr("impossible pivot"));
  EXPECT_THAT(complaint("table_radius_mm", "chain = \"three_axis\"\ntable_radius_mm"), HasSubstr("has no place"));
  EXPECT_THAT(complaint("kind = \"grblhal\"", "kind = \"abacus\""), HasSubstr("controller.kind"));
  EXPECT_THAT(complaint("retract_z_mm = 0.0 ", "retract_z_mm = 5.0 "), HasSubstr("within the travel of z"));
  EXPECT_THAT(complaint("tool_change_mm = [-240.0", "tool_change_mm = [-260.0"), HasSubstr("within the travels"));
  EXPECT_THAT(complaint("max_rpm = 36000", "max_rpm = 500"), HasSubstr("spindle.max_rpm"));
  EXPECT_THAT(complaint("point_mm = [0.0, 0.0, -380.0]", "point_mm = [0.0, 0.0]"), HasSubstr("outer.point_mm"));
}

TEST(ReadMachine, TakesJerkParkAndStraightRapids) {
  std::string text = read_whole(kFixture);
  text.replace(text.find("acceleration_mm_per_s2"), 0, "jerk_mm_per_s3 = 250000\n");
  text.replace(text.find("acceleration_deg_per_s2"), 0, "jerk_deg_per_s3 = 36000\n");
  text.replace(text.find("retract_z_mm"), 0, "park_mm = [12, 34]\n");
  text.replace(text.find("kind = "), 0, "straight_rapids = false\n");
  const test::ScratchFolder folder;
  const auto path = folder / "machine_model_jerk.toml";
  write_whole(path, text);
  const MachineModel machine = read_machine(path);
  EXPECT_EQ(machine.x.jerk_mm_per_s3, 250000);
  EXPECT_DOUBLE_EQ(machine.outer.jerk_rad_per_s3, 36000 * kPi / 180);
  EXPECT_EQ(machine.y.jerk_mm_per_s3, 0) << "not known";
  EXPECT_EQ(*machine.park_mm, Vec2(12, 34));
  EXPECT_FALSE(machine.has_straight_rapids());
  MachineModel fanuc = read_machine(kFixture);
  EXPECT_TRUE(fanuc.has_straight_rapids());
  fanuc.controller = "fanuc";
  EXPECT_FALSE(fanuc.has_straight_rapids()) << "as delivered";
}

TEST(ReadMachine, NormalisesAxes) {
  std::string text = read_whole(kFixture);
  text.replace(text.find("[0.0, 1.0, 0.0]"), 15, "[0.0, 3.0, 4.0]");
  const test::ScratchFolder folder;
  const auto path = folder / "machine_model_axis.toml";
  write_whole(path, text);
  EXPECT_LT((read_machine(path).outer.axis - Vec3(0, 0.6, 0.8)).norm(), 1e-15);
}

}  // namespace
}  // namespace lightmill

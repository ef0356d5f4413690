#include "cam/toolpath.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>

#include "design/core/errors.h"
#include "design/core/files.h"
#include "tests/scratch_folder.h"

namespace lightmill {
namespace {

std::filesystem::path file(const std::string& name) {
  static const test::ScratchFolder folder;
  return folder / name;
}

std::vector<ToolPath> some_passes() {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> u(-1, 1);
  std::vector<ToolPath> passes;
  for (const char* name : {"rough", "finish"}) {
    ToolPath pass;
    pass.pass = name;
    pass.cutter.name = std::string("cutter of ") + name;
    pass.cutter.number = 4;
    pass.cutter.diameter_mm = 4;
    pass.cutter.taper_rad = 0.1;
    pass.cutter.shank = {{12, 20, 2, 3}};
    pass.cutter.holder = {{30, 40, 5, 6}, {40, 50, 7, 8}};
    pass.cutter.coolant = "air";
    pass.spindle_rpm = 36000;
    pass.stepover_mm = 0.14;
    pass.predicted_cusp_um = 1.25;
    pass.above_limit_mm2 = 0.5;
    pass.clearance_z_mm = 20;
    for (int k = 0; k < 50; ++k) {
      pass.moves.push_back({{Vec3(u(random), u(random), u(random)), Vec3(u(random), u(random), 2).normalized()},
                            static_cast<MoveKind>(k % 4),
                            k % 4 ? 10 + u(random) : 0});
    }
    passes.push_back(pass);
  }
  return passes;
}

TEST(ToolPathFile, GivesBackWhatWasWrittenBitByBit) {
  const auto passes = some_passes();
  write_toolpaths(file("round.bin"), passes);
  const auto again = read_toolpaths(file("round.bin"));
  ASSERT_EQ(again.size(), passes.size());
  for (std::size_t p = 0; p < passes.size(); ++p) {
    EXPECT_EQ(again[p].pass, passes[p].pass);
    EXPECT_EQ(again[p].cutter.name, passes[p].cutter.name);
    EXPECT_EQ(again[p].cutter.coolant, "air");
    EXPECT_EQ(again[p].cutter.taper_rad, 0.1);
    ASSERT_EQ(again[p].cutter.shank.size(), 1u);
    EXPECT_EQ(again[p].cutter.shank[0].to_radius_mm, 3);
    EXPECT_EQ(again[p].cutter.holder.size(), 2u);
    EXPECT_EQ(again[p].cutter.holder[1].to_radius_mm, 8);
    EXPECT_EQ(again[p].stepover_mm, passes[p].stepover_mm);
    EXPECT_EQ(again[p].above_limit_mm2, passes[p].above_limit_mm2);
    ASSERT_EQ(again[p].moves.size(), passes[p].moves.size());
    for (std::size_t k = 0; k < passes[p].moves.size(); ++k) {
      EXPECT_EQ(again[p].moves[k].pose.tip_mm, passes[p].moves[k].pose.tip_mm);
      EXPECT_EQ(again[p].moves[k].pose.axis, passes[p].moves[k].pose.axis);
      EXPECT_EQ(again[p].moves[k].kind, passes[p].moves[k].kind);
      EXPECT_EQ(again[p].moves[k].feed_mm_per_s, passes[p].moves[k].feed_mm_per_s);
    }
  }
  write_toolpaths(file("round2.bin"), again);
  EXPECT_EQ(read_whole(file("round.bin")), read_whole(file("round2.bin")));
  write_toolpaths(file("none.bin"), {});
  EXPECT_TRUE(read_toolpaths(file("none.bin")).empty());
}

TEST(ToolPathFile, AnyDamageIsRefused) {
  write_toolpaths(file("good.bin"), some_passes());
  const std::string good = read_whole(file("good.bin"));
  std::mt19937 random(11);
  const auto refused = [&](const std::string& bytes) {
    std::ofstream(file("bad.bin"), std::ios::binary) << bytes;
    EXPECT_THROW(read_toolpaths(file("bad.bin")), InputError);
  };
  for (int k = 0; k < 300; ++k) {  // one bit anywhere
    std::string bad = good;
    bad[random() % bad.size()] ^= static_cast<char>(1 << (random() % 8));
    refused(bad);
  }
  for (const std::size_t length : {std::size_t{0}, std::size_t{5}, std::size_t{12}, good.size() / 2, good.size() - 1}) {
    refused(good.substr(0, length));
  }
  refused(good + "x");
  EXPECT_THROW(read_toolpaths(file("absent.bin")), InputError);
}

TEST(ToolPathMeasures, LengthAndTimeOfAKnownPath) {
  ToolPath path;
  path.moves = {{{Vec3(0, 0, 10), Vec3::UnitZ()}, MoveKind::kRapid, 0},
                {{Vec3(30, 40, 10), Vec3::UnitZ()}, MoveKind::kRapid, 0},
                {{Vec3(30, 40, 4), Vec3::UnitZ()}, MoveKind::kLink, 2},
                {{Vec3(30, 52, 9), Vec3::UnitZ()}, MoveKind::kCut, 1}};
  EXPECT_DOUBLE_EQ(path.length_mm(), 50 + 6 + 13);
  EXPECT_DOUBLE_EQ(path.minutes(100), (0.5 + 3 + 13) / 60);
}

}  // namespace
}  // namespace lightmill

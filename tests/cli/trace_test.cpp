#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/cli/command_rig.h"

namespace lightmill::test {
namespace {

using ::testing::HasSubstr;

/// A closed box as another program writes it, 12 x 10 mm like the tiny job's lens, its top at the lens's thinnest height.
constexpr const char* kBox =
    "v -6 -5 0\nv 6 -5 0\nv 6 5 0\nv -6 5 0\nv -6 -5 4\nv 6 -5 4\nv 6 5 4\nv -6 5 4\n"
    "f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

TEST(TraceCommand, TakesAForeignSolidAndWritesStillsOfOneExposure) {
  const ScratchFolder folder;
  spill(folder / "box.obj", kBox);
  const std::string job = std::string(LIGHTMILL_FIXTURES) + "/jobs/tiny.toml";
  const CommandResult run = lightmill_command({"trace", (folder / "box.obj").string(), "--job", job, "-o", (folder / "light.png").string(),
                                               "--fresnel", "--colours", "--movie", "2", "--pixels", "32", "--json"});
  ASSERT_EQ(run.code, 0) << run.err;
  for (const char* name : {"light.png", "light_0001.png", "light_0002.png"}) EXPECT_FALSE(slurp(folder / name).empty()) << name;
  EXPECT_FALSE(fs::exists(folder / "light_0003.png"));
  // A plate passes all light but what its two faces reflect: index 1.49.
  const std::size_t at = (run.out + run.err).find("\"fresnel_reflected\":");
  ASSERT_NE(at, std::string::npos) << run.out;
  const double passes = 1 - (0.49 / 2.49) * (0.49 / 2.49);
  EXPECT_NEAR(std::strtod((run.out + run.err).c_str() + at + 20, nullptr), 1 - passes * passes, 1e-9);
}

TEST(TraceCommand, SaysWhatItCannotTrace) {
  const ScratchFolder folder;
  const std::string job = std::string(LIGHTMILL_FIXTURES) + "/jobs/tiny.toml";
  spill(folder / "bad.obj", "v 0 0 0\nf 1 2 3\n");
  const CommandResult bad = lightmill_command({"trace", (folder / "bad.obj").string(), "--job", job});
  EXPECT_EQ(bad.code, 2);
  EXPECT_THAT(bad.err, HasSubstr("bad.obj: line 2"));
  spill(folder / "down.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 3 2\n");
  EXPECT_THAT(lightmill_command({"trace", (folder / "down.obj").string(), "--job", job}).err, HasSubstr("faces +Z"));
  spill(folder / "box.obj", kBox);
  const CommandResult backwards = lightmill_command({"trace", (folder / "box.obj").string(), "--job", job, "--direction=0,0,-1"});
  EXPECT_EQ(backwards.code, 2);
  EXPECT_THAT(backwards.err, HasSubstr("along +Z"));
}

}  // namespace
}  // namespace lightmill::test

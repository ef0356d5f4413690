#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/cli/command_rig.h"

namespace lightmill::test {
namespace {

using ::testing::AllOf;
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

TEST(TraceCommand, SaysWhereLightIsLost) {
  const ScratchFolder folder;
  constexpr int kColumns = 61;  // light is looked at where the plate has vertices
  std::string plate;
  for (int k = 0; k < 2 * kColumns; ++k) plate += "v " + std::to_string(-6 + 0.2 * (k % kColumns)) + (k < kColumns ? " -5 4\n" : " 5 4\n");
  for (int k = 1; k < kColumns; ++k) {
    const auto corner = [](int vertex) { return " " + std::to_string(vertex); };
    plate += "f" + corner(k) + corner(k + 1) + corner(k + 1 + kColumns) + corner(k + kColumns) + "\n";
  }
  spill(folder / "plate.obj", plate);
  const CommandResult run = lightmill_command({"trace", (folder / "plate.obj").string(), "--job", std::string(LIGHTMILL_FIXTURES) + "/jobs/tiny.toml",
                                               "--direction=0.5,0,1", "--json"});
  ASSERT_EQ(run.code, 0) << run.err;
  const std::size_t at = run.out.find("{\"event\":\"trace\"");
  ASSERT_NE(at, std::string::npos) << run.out;
  const auto measures = nlohmann::json::parse(run.out.substr(at, run.out.find('\n', at) - at)).at("measures");
  // Within 4 mm of acrylic the light goes 4 tan(asin(sin(atan(0.5)) / 1.49)) = 1.26 mm aside, on a back of 12 mm.
  const double aside = 4 * std::tan(std::asin(0.5 / std::sqrt(1.25) / 1.49));
  EXPECT_NEAR(measures.at("leaves_by_rim").get<double>(), aside / 12, 0.01);
  EXPECT_NEAR(measures.at("lost_from_mm").at("leaves_by_rim").at(2).get<double>(), 6, 1e-9);
  EXPECT_EQ(measures.at("shadowed"), 0);
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
  const auto refusal = [&](const std::vector<std::string>& options) {
    std::vector<std::string> words{"trace", (folder / "box.obj").string(), "--job", job};
    words.insert(words.end(), options.begin(), options.end());
    const CommandResult run = lightmill_command(words);
    EXPECT_EQ(run.code, 2) << options.front();
    return run.err;
  };
  EXPECT_THAT(refusal({"--direction=0,0,0"}), HasSubstr("along +Z"));
  EXPECT_THAT(refusal({"--direction=1,0,0"}), HasSubstr("along +Z"));
  EXPECT_THAT(refusal({"--tilt-deg=95,0"}), HasSubstr("at most 80 degrees"));
  EXPECT_THAT(refusal({"--lamp-diameter-mm=5"}), HasSubstr("--lamp"));
  EXPECT_THAT(refusal({"--lamp=0,0,-100", "--direction=0,0,1"}), HasSubstr("--direction"));
}

TEST(TraceCommand, AMovieNeedsRoomBetweenLensAndLight) {
  const ScratchFolder folder;
  spill(folder / "box.obj", kBox);
  // A beam along +Z, 40 mm wide, that reaches in front of a lens turned by 22.5 degrees unless it is cut 20 tan(22.5) = 8.28 mm behind.
  const auto movie = [&](const std::string& z) {
    std::string ply =
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\n"
        "property float ny\nproperty float nz\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";
    for (const char* corner : {"-20 -20 ", "20 -20 ", "20 20 ", "-20 20 "}) ply += corner + z + " 0 0 1\n";
    spill(folder / "beam.ply", ply + "3 0 1 2\n3 0 2 3\n");
    spill(folder / "job.toml", "[target]\nimage = \"" LIGHTMILL_FIXTURES "/pictures/tiny.png\"\n[light]\nkind = \"mesh\"\nmesh = \"beam.ply\"\n"
                               "[lens]\nsize_mm = [12, 10]\nthickness_mm = 4\n");
    return lightmill_command({"trace", (folder / "box.obj").string(), "--job", (folder / "job.toml").string(), "-o",
                              (folder / "light.png").string(), "--movie", "2", "--pixels", "16"});
  };
  const CommandResult near = movie("-8");
  EXPECT_EQ(near.code, 2);
  EXPECT_THAT(near.err, AllOf(HasSubstr("--movie"), HasSubstr("0.284 mm further back")));
  EXPECT_FALSE(fs::exists(folder / "light.png"));
  const CommandResult far = movie("-8.3");
  EXPECT_EQ(far.code, 0) << far.err;
  EXPECT_TRUE(fs::exists(folder / "light_0002.png"));
}

}  // namespace
}  // namespace lightmill::test

// Designs from jobs to pictures: the paper's set-ups scaled down, colour masks, the gallery.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "cli/job.h"
#include "command_rig.h"
#include "design/core/image.h"

namespace lightmill::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

/// A job of the fixtures with fewer samples and a coarser mesh, as a file in `folder`.
fs::path scaled_down(const ScratchFolder& folder, const std::string& name, int samples, int mesh) {
  Job job = read_job(fs::path(LIGHTMILL_FIXTURES) / "jobs" / (name + ".toml"));
  job.transport.samples = samples;
  job.surface.mesh = mesh;
  const fs::path path = folder / (name + ".toml");
  spill(path, resolved_toml(job));
  return path;
}

struct PaperJob {
  const char* name;
  double distance_mm, curve_share;
  int samples, mesh;        // the paper's
  double largest_l1_error;  // scaled down: where something is wrong it is over 1
  double most_light_outside;
};

class PaperSetUp : public ::testing::TestWithParam<PaperJob> {};

TEST_P(PaperSetUp, HasThePapersSizesAndCastsItsPictureScaledDown) {
  const PaperJob& set_up = GetParam();
  const Job job = read_job(fs::path(LIGHTMILL_FIXTURES) / "jobs" / (std::string(set_up.name) + ".toml"));
  EXPECT_EQ(job.receiver.distance_mm, set_up.distance_mm);
  EXPECT_NEAR(job.transport.samples, set_up.samples, 0.01 * set_up.samples);
  EXPECT_EQ(job.surface.mesh, set_up.mesh);

  const ScratchFolder scratch;
  const CommandResult run = lightmill_command({"make", scaled_down(scratch, set_up.name, 784, 41).string(), "-o",
                                               (scratch / "run").string(), "--until", "design", "-q"});
  ASSERT_EQ(run.code, 0) << run.err;
  const json report = json::parse(slurp(scratch / "run/report.json"));
  EXPECT_NEAR(report.at("/design/target/curve_share"_json_pointer), set_up.curve_share, 1e-9);
  EXPECT_EQ(report.at("/design/transport/empty_cells"_json_pointer), 0);
  EXPECT_EQ(report.at("/design/surface/inverted_triangles"_json_pointer), 0);
  EXPECT_LT(report.at("/design/caustic/l1_error"_json_pointer), set_up.largest_l1_error);
  EXPECT_LT(report.at("/design/caustic/flux_outside_support"_json_pointer), set_up.most_light_outside);

  const CommandResult gallery =
      lightmill_command({"gallery", (scratch / "run").string(), "-o", (scratch / "page/gallery.html").string()});
  ASSERT_EQ(gallery.code, 0) << gallery.err;
  const std::string page = slurp(scratch / "page/gallery.html");
  EXPECT_THAT(page, HasSubstr("../run/design/caustic.png"));
  EXPECT_THAT(page, HasSubstr(set_up.name));
}

INSTANTIATE_TEST_SUITE_P(Figures, PaperSetUp,
                         ::testing::Values(PaperJob{"paper_portrait", 300, 0.5, 261000, 641, 0.9, 1},
                                           PaperJob{"paper_rings", 300, 0, 261000, 641, 0.6, 0.3},
                                           PaperJob{"paper_brain", 400, 1, 163000, 641, 1.5, 0.7},
                                           PaperJob{"paper_logo", 300, 0, 254000, 641, 0.7, 0.3},
                                           PaperJob{"paper_photo", 100, 0, 1300000, 1281, 0.4, 1}),
                         [](const ::testing::TestParamInfo<PaperJob>& job) { return std::string(job.param.name); });

std::uint32_t big_endian(const std::string& bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (int k = 0; k < 4; ++k) value = 256 * value + static_cast<unsigned char>(bytes[at + k]);
  return value;
}

TEST(ColourMaskPrint, StatesItsResolutionAndMarksItsCorners) {
  const ScratchFolder scratch;
  // Left half of the picture red, right half blue.
  Grid<float> red(12, 10), green(12, 10), blue(12, 10);
  for (int y = 0; y < 10; ++y) {
    for (int x = 0; x < 12; ++x) (x < 6 ? red : blue).at(x, y) = 0.5F;
  }
  write_png8(scratch / "colours.png", red, green, blue);
  spill(scratch / "job.toml",
        "[target]\nimage = \"colours.png\"\nsize_mm = [12, 10]\ncolor_mask = true\n[lens]\nsize_mm = [12, "
        "10]\nthickness_mm = 4\n"
        "[receiver]\ndistance_mm = 80\n[transport]\nsamples = 256\n[surface]\nmesh = 25\n");
  const CommandResult run = lightmill_command(
      {"make", (scratch / "job.toml").string(), "-o", (scratch / "run").string(), "--until", "design", "-q"});
  ASSERT_EQ(run.code, 0) << run.err;
  const fs::path file = scratch / "run/design/color_mask.png";
  const std::string bytes = slurp(file);
  const std::size_t resolution = bytes.find("pHYs");
  ASSERT_NE(resolution, std::string::npos);
  EXPECT_NEAR(big_endian(bytes, resolution + 4), 300 / 0.0254, 1);
  EXPECT_NEAR(big_endian(bytes, resolution + 8), 300 / 0.0254, 1);
  EXPECT_EQ(bytes[resolution + 12], 1);  // per metre

  const Picture mask = read_picture(file, Transfer::kAuto, true);
  const double per_mm = 300 / 25.4;
  ASSERT_EQ(mask.red.width, std::lround(32 * per_mm));
  const auto at = [&](const Grid<float>& channel, double x, double y) {  // lens frame, mm
    return channel.at(static_cast<int>((x + 16) * per_mm), static_cast<int>((15 - y) * per_mm));
  };
  // Equal halves: the light hardly moves. From the lens's side the picture's left is at +X, as on the film seen from
  // +Z.
  EXPECT_EQ(at(mask.red, 3, 1), 1);
  EXPECT_EQ(at(mask.blue, 3, 1), 0);
  EXPECT_EQ(at(mask.blue, -3, -2), 1);
  EXPECT_EQ(at(mask.red, -3, -2), 0);
  EXPECT_EQ(at(mask.gray, 0, 6.5), 1);  // film beside the lens
  // Marks stand 5 mm beyond the corners, at (11, 10): hairs on all, only the one at +X +Y is filled.
  EXPECT_EQ(at(mask.gray, 14, 10), 0);
  EXPECT_EQ(at(mask.gray, -14, -10), 0);
  EXPECT_EQ(at(mask.gray, 12, 11), 0);
  EXPECT_EQ(at(mask.gray, -12, -11), 1);
  EXPECT_EQ(at(mask.gray, 12, -11), 1);
  const std::string page = slurp(scratch / "run/design/color_mask.svg");
  EXPECT_THAT(page, HasSubstr("width=\"32mm\" height=\"30mm\""));
  EXPECT_THAT(page, HasSubstr("color_mask.png"));
}

TEST(Gallery, SaysWhichFolderHasNoDesign) {
  const ScratchFolder scratch;
  fs::create_directories(scratch / "empty");
  const CommandResult run =
      lightmill_command({"gallery", (scratch / "empty").string(), "-o", (scratch / "gallery.html").string()});
  EXPECT_EQ(run.code, 2);
  EXPECT_FALSE(fs::exists(scratch / "gallery.html"));
}

}  // namespace
}  // namespace lightmill::test

// Other people's programs: what LinuxCNC ships, read by us and by its own rs274. Skipped where LinuxCNC is not
// installed.
#include <gtest/gtest.h>

#include <filesystem>

#include "machine_rig.h"
#include "rs274.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

/// The ends of moves that differ from the one before; LinuxCNC also names moves of no length.
std::vector<Vec3> ends(const std::vector<test::CanonMove>& moves) {
  std::vector<Vec3> points;
  Vec3 at = Vec3::Zero();
  for (const test::CanonMove& move : moves) {
    if (!((move.to - at).norm() <= 5e-3)) points.push_back(at = move.to);
  }
  return points;
}

struct Sample {
  const char* file;
  const char* stops_at;  ///< the rule by which we stop; nullptr: read whole
};

// What our reader leaves out, and says so: probing, threading, lathe cycles, splines,
// axes that this machine has not got.
const Sample kSamples[] = {{"3D_Chips.ngc", nullptr},
                           {"3dtest.ngc", nullptr},
                           {"arcspiral.ngc", nullptr},
                           {"b-index.ngc", nullptr},
                           {"cds.ngc", nullptr},
                           {"factorial.ngc", nullptr},
                           {"flowsnake.ngc", nullptr},
                           {"plasmatest.ngc", nullptr},
                           {"skeleton.ngc", nullptr},
                           {"polar.ngc", nullptr},
                           {"spiral.ngc", nullptr},
                           {"toplevel.ngc", nullptr},
                           {"tort.ngc", nullptr},
                           {"comp.ngc", nullptr},
                           {"comp-g1.ngc", nullptr},
                           {"comp311.ngc", nullptr},
                           {"cone.ngc", "word W is not known"},
                           {"daisy.ngc", "word A is not known"},
                           {"gridprobe.ngc", "the probe made no contact"},
                           {"lathe_g7x_quadrants.ngc", "G70 is for lathes"},
                           {"mmount.ngc", "G33.1 waits for a spindle encoder"},
                           {"systems.ngc", nullptr},
                           {"threading.ngc", "G33 waits for a spindle encoder"}};

TEST(ProgramReader, AgreesWithLinuxCncOnItsOwnPrograms) {
  const fs::path programs = "/usr/share/linuxcnc/ncfiles";
  if (!test::Rs274::installed() || !fs::exists(programs)) GTEST_SKIP() << "LinuxCNC is not installed";
  const double diameter = 2.54;
  const test::Rs274 rs274(diameter);
  ReaderSetup setup;
  setup.most_blocks = 1'000'000;
  for (int n = 1; n <= 55; ++n) {
    setup.tool_length_mm[n] = 0;
    setup.tool_diameter_mm[n] = diameter;
  }
  long compared = 0;
  for (const Sample& sample : kSamples) {
    if (!fs::exists(programs / sample.file)) continue;
    const std::vector<Vec3> theirs = ends(rs274.run_file(programs / sample.file).moves);
    const test::OwnRun run = test::read_as_canon(read_whole(programs / sample.file), test::skew_machine(), setup);
    const std::vector<Vec3> ours = ends(run.moves);
    const std::optional<ProgramError>& error = run.result.error;
    if (sample.stops_at == nullptr) {
      EXPECT_FALSE(error) << sample.file << ": " << error->line << ": " << error->rule;
      EXPECT_EQ(ours.size(), theirs.size()) << sample.file;
    } else {
      EXPECT_TRUE(error && error->rule.find(sample.stops_at) != std::string::npos)
          << sample.file << ": " << (error ? error->rule : "");
      EXPECT_LE(ours.size(), theirs.size()) << sample.file;
    }
    for (std::size_t i = 0; i < std::min(ours.size(), theirs.size()); ++i) {
      // Four decimals, also of inches.
      if (theirs[i].hasNaN()) continue;  // a spline, whose points rs274 does not tell
      ASSERT_LT((ours[i] - theirs[i]).norm(), 3e-3)
          << sample.file << ", point " << i << ": " << ours[i].transpose() << " against " << theirs[i].transpose();
      ++compared;
    }
  }
  EXPECT_GT(compared, 1000);
}

}  // namespace
}  // namespace lightmill

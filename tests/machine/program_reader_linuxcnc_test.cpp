// Other people's programs: what LinuxCNC ships, read by us and by its own rs274. Skipped where LinuxCNC is not
// installed.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <map>

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

/// Where our reader stops in LinuxCNC's programs and rs274 does not, and the rule it names: axes and encoders that this machine
/// has not got, lathes, a tool renumbered by hand, probes (rs274's always touches).
const std::map<std::string, const char*> kStops = {{"daisy.ngc", "word A is not known"},
                                                   {"gridprobe.ngc", "the probe made no contact"},
                                                   {"lathe_g70_71_demo.ngc", "G71.1 is for lathes"},
                                                   {"lathe_g7x_face_boring.ngc", "G72 is for lathes"},
                                                   {"lathe_g7x_quadrants.ngc", "G70 is for lathes"},
                                                   {"mmount.ngc", "G33.1 waits for a spindle encoder"},
                                                   {"offsets.ngc", "M61 is not known"},
                                                   {"smartprobe.ngc", "the probe has no contact that could open"},
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
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(programs)) {
    if (entry.path().extension() == ".ngc") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  for (const fs::path& file : files) {
    const std::string name = file.filename();
    const test::CanonRun canon = rs274.run_file(file);
    const std::vector<Vec3> theirs = ends(canon.moves);
    const test::OwnRun run = test::read_as_canon(read_whole(file), test::skew_machine(), setup);
    const std::vector<Vec3> ours = ends(run.moves);
    const std::optional<ProgramError>& error = run.result.error;
    const auto stop = kStops.find(name);
    if (stop == kStops.end()) {
      // What rs274 refuses is refused.
      EXPECT_EQ(error.has_value(), !canon.error.empty()) << name << ": " << (error ? error->rule : "") << "; rs274: " << canon.error;
      EXPECT_EQ(ours.size(), theirs.size()) << name;
    } else {
      EXPECT_TRUE(error && error->rule.find(stop->second) != std::string::npos) << name << ": " << (error ? error->rule : "");
      EXPECT_LE(ours.size(), theirs.size()) << name;
    }
    for (std::size_t i = 0; i < std::min(ours.size(), theirs.size()); ++i) {
      // Four decimals, also of inches.
      if (theirs[i].hasNaN()) continue;  // a spline, whose points rs274 does not tell
      ASSERT_LT((ours[i] - theirs[i]).norm(), 3e-3) << name << ", point " << i << ": " << ours[i].transpose() << " against " << theirs[i].transpose();
      ++compared;
    }
  }
  EXPECT_GT(files.size(), 50U);
  EXPECT_GT(compared, 1000);
}

}  // namespace
}  // namespace lightmill

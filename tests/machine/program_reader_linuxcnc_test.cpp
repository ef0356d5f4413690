// Other people's programs: what LinuxCNC ships, read by us and by its own rs274. Skipped where LinuxCNC is not
// installed.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>

#include "design/core/files.h"
#include "machine/program_reader.h"
#include "machine_rig.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

using Points = std::vector<Vec3>;

/// Points that differ from the one before; both start at the origin, and LinuxCNC also names moves of no length.
void add(Points& points, const Vec3& p) {
  if ((p - (points.empty() ? Vec3::Zero() : points.back())).norm() > 5e-3) points.push_back(p);
}

/// The end points of rs274's canonical moves, mm.
Points canonical(const std::string& listing) {
  Points points;
  double unit = 1;
  char plane = 'Z';
  static const std::regex call(
      R"((USE_LENGTH_UNITS|STRAIGHT_FEED|STRAIGHT_TRAVERSE|ARC_FEED|SELECT_PLANE)\(([^)]*)\))");
  for (std::sregex_iterator it(listing.begin(), listing.end(), call), end; it != end; ++it) {
    const std::string name = (*it)[1], text = (*it)[2];
    if (name == "USE_LENGTH_UNITS") {
      unit = text.find("INCH") != std::string::npos ? 25.4 : 1;
    } else if (name == "SELECT_PLANE") {
      plane = text.find("XY") != std::string::npos ? 'Z' : text.find("XZ") != std::string::npos ? 'Y' : 'X';
    } else {
      std::vector<double> v;
      std::istringstream in(text);
      for (std::string part; std::getline(in, part, ',');) v.push_back(std::stod(part));
      Vec3 p(v.at(0), v.at(1), v.at(2));
      if (name == "ARC_FEED") {
        p = plane == 'Z'   ? Vec3(v.at(0), v.at(1), v.at(5))
            : plane == 'Y' ? Vec3(v.at(1), v.at(5), v.at(0))
                           : Vec3(v.at(5), v.at(0), v.at(1));
      }
      add(points, p * unit);
    }
  }
  return points;
}

struct Sample {
  const char* file;
  const char* stops_at;  ///< the rule by which we stop; nullptr: read whole
};

// What our reader leaves out, and says so: cutter radius compensation, probing, threading, lathe cycles, splines,
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
                           {"comp.ngc", "G42 is not known"},
                           {"comp-g1.ngc", "G41 is not known"},
                           {"comp311.ngc", "G41 is not known"},
                           {"cone.ngc", "word W is not known"},
                           {"daisy.ngc", "word A is not known"},
                           {"gridprobe.ngc", "G38.2 is not known"},
                           {"lathe_g7x_quadrants.ngc", "G70 is not known"},
                           {"mmount.ngc", "G41 is not known"},
                           {"systems.ngc", "G5.1 is not known"},
                           {"threading.ngc", "G33 is not known"}};

TEST(ProgramReader, AgreesWithLinuxCncOnItsOwnPrograms) {
  const fs::path programs = "/usr/share/linuxcnc/ncfiles";
  if (std::system("command -v rs274 > /dev/null") != 0 || !fs::exists(programs))
    GTEST_SKIP() << "LinuxCNC is not installed";
  const fs::path folder = fs::temp_directory_path() / ("lightmill_rs274_" + std::to_string(getpid()));
  fs::create_directories(folder);
  std::ofstream(folder / "mm.ini") << "[TRAJ]\nLINEAR_UNITS = mm\n[RS274NGC]\nPARAMETER_FILE = prog.var\n";
  std::ofstream tools(folder / "tool.tbl");
  ReaderSetup setup;
  setup.most_blocks = 1'000'000;
  for (int n = 1; n <= 55; ++n) {
    tools << "T" << n << " P" << n << " D0.1 Z+0 ;any\n";
    setup.tool_length_mm[n] = 0;
  }
  tools.close();
  long compared = 0;
  for (const Sample& sample : kSamples) {
    if (!fs::exists(programs / sample.file)) continue;
    // A HOME of its own: rs274 empties the user's tool table.
    const std::string command = "cd '" + folder.string() + "' && HOME=. timeout 20 rs274 -g -i mm.ini -t tool.tbl '" +
                                (programs / sample.file).string() + "' out.txt > log.txt 2>&1";
    static_cast<void>(std::system(command.c_str()));
    const Points theirs = canonical(read_whole(folder / "out.txt"));
    Points ours;
    const ReadResult result = read_program(read_whole(programs / sample.file), ReaderDialect::kLinuxCnc,
                                           test::skew_machine(), setup, [&](const ProgramStep& step) {
                                             if (step.kind == ProgramStep::kMove && step.whole)
                                               add(ours, {step.programmed[0], step.programmed[1], step.programmed[2]});
                                           });
    if (sample.stops_at == nullptr) {
      EXPECT_FALSE(result.error) << sample.file << ": " << result.error->line << ": " << result.error->rule;
      EXPECT_EQ(ours.size(), theirs.size()) << sample.file;
    } else {
      EXPECT_TRUE(result.error && result.error->rule.find(sample.stops_at) != std::string::npos) << sample.file;
      EXPECT_LE(ours.size(), theirs.size()) << sample.file;
    }
    for (std::size_t i = 0; i < std::min(ours.size(), theirs.size()); ++i) {
      // Four decimals, also of inches.
      ASSERT_LT((ours[i] - theirs[i]).norm(), 3e-3)
          << sample.file << ", point " << i << ": " << ours[i].transpose() << " against " << theirs[i].transpose();
      ++compared;
    }
  }
  EXPECT_GT(compared, 1000);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace lightmill

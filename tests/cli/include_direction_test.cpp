// Includes point one way only: cli -> machine -> postproc -> cam -> design (DESIGN.md, "Rooms").
#include <gtest/gtest.h>

#include <map>
#include <regex>
#include <set>

#include "command_rig.h"

namespace lightmill {
namespace {

namespace fs = std::filesystem;

const std::vector<std::string> kRooms = {"design", "cam", "postproc", "machine", "cli"};

std::size_t level(const std::string& room) { return std::find(kRooms.begin(), kRooms.end(), room) - kRooms.begin(); }

struct Include {
  fs::path from;       // relative to the source tree
  std::string path;    // as written
};

std::vector<Include> includes_of_all_rooms() {
  static const std::regex kInclude(R"(^\s*#\s*include\s*["<]([^">]+)[">])");
  std::vector<Include> includes;
  for (const auto& room : kRooms) {
    for (const auto& entry : fs::recursive_directory_iterator(fs::path(LIGHTMILL_SOURCE_DIR) / room)) {
      if (entry.path().extension() != ".h" && entry.path().extension() != ".cpp") continue;
      std::istringstream text(test::slurp(entry.path()));
      std::string line;
      std::smatch match;
      while (std::getline(text, line)) {
        if (std::regex_search(line, match, kInclude)) includes.push_back({fs::relative(entry.path(), LIGHTMILL_SOURCE_DIR), match[1]});
      }
    }
  }
  return includes;
}

std::string room_of(const fs::path& path) { return path.begin()->string(); }

TEST(Includes, PointOneWayOnly) {
  int seen = 0;
  for (const auto& [from, path] : includes_of_all_rooms()) {
    const std::size_t to = level(room_of(path));
    if (to == kRooms.size()) continue;
    ++seen;
    EXPECT_LE(to, level(room_of(from))) << from << " includes " << path;
  }
  EXPECT_GT(seen, 100) << "the scan must have found the tree";
}

TEST(Includes, CarryTheFullPath) {
  for (const auto& [from, path] : includes_of_all_rooms()) {
    const fs::path beside = fs::path(LIGHTMILL_SOURCE_DIR) / from.parent_path() / path;
    EXPECT_FALSE(fs::exists(beside)) << from << " includes " << path << " without the room's name";
  }
}

TEST(Includes, TheMachineKnowsOfThePostOnlyTheMachineFile) {
  for (const auto& [from, path] : includes_of_all_rooms()) {
    if (room_of(from) != "machine" || room_of(path) != "postproc") continue;
    EXPECT_EQ(path, "postproc/machine_model.h") << from << " shares code with the post: errors would cancel";
  }
}

TEST(Includes, TheMachineReachesNoPostThroughOthersEither) {
  // Everything a machine/ source reads, through any chain of headers.
  std::map<std::string, std::set<std::string>> graph;
  for (const auto& [from, path] : includes_of_all_rooms()) graph[from.string()].insert(path);
  for (const auto& [file, ignored] : graph) {
    if (room_of(file) != "machine") continue;
    std::set<std::string> reached;
    std::vector<std::string> open = {file};
    while (!open.empty()) {
      const std::string next = open.back();
      open.pop_back();
      for (const auto& path : graph[next]) {
        if (reached.insert(path).second) open.push_back(path);
      }
    }
    for (const char* barred : {"postproc/kinematics.h", "postproc/axis_motion.h", "postproc/program.h"}) {
      EXPECT_FALSE(reached.contains(barred)) << file << " reaches " << barred;
    }
  }
}

TEST(Includes, HeavyHeadersStayBehindWalls) {
  static const std::regex kHeavy(R"(^(CGAL/|ceres/|OpenImageIO/|libserial/|SerialPort|TopoDS|BRep|Geom_|STEPControl|toml\+\+))");
  for (const auto& [from, path] : includes_of_all_rooms()) {
    if (from.extension() != ".h" || from.string().find("/detail/") != std::string::npos) continue;
    EXPECT_FALSE(std::regex_search(path, kHeavy)) << from << " includes " << path;
  }
}

}  // namespace
}  // namespace lightmill

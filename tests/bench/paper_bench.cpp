// The paper's five set-ups: paper_bench [portrait|rings|brain|logo|photo]... [--scale K] [--smooth]
// [--picture-turns N] [--out DIR]
// At full size, or with a mesh K times coarser and K^2 times fewer samples. --smooth: height fields without creases, and
// without corrections by the picture, in folders of their own; --picture-turns: so many corrections at most.
// Designs each with the lightmill command in a process of its own and prints a row of the README's table per set-up;
// run folders stay in DIR (default: paper in the temporary folder), for `lightmill gallery`.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli/job.h"
#include "design/core/files.h"

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Runs the command; its CPU seconds and peak memory in MB.
struct Cost {
  bool done = false;
  double cpu_seconds = 0, peak_mb = 0;
};

Cost design(const std::string& job, const std::string& folder) {
  const pid_t child = fork();
  if (child == 0) {
    if (std::freopen("/dev/null", "w", stdout) == nullptr) _exit(127);  // the table stays a table
    execl(LIGHTMILL_BINARY, LIGHTMILL_BINARY, "make", job.c_str(), "-o", folder.c_str(), "--until", "design", "-q",
          nullptr);
    _exit(127);
  }
  int status = 0;
  rusage usage{};
  wait4(child, &status, 0, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return {WIFEXITED(status) && WEXITSTATUS(status) == 0, seconds(usage.ru_utime) + seconds(usage.ru_stime),
          static_cast<double>(usage.ru_maxrss) / 1024};
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> names;
  fs::path out = fs::temp_directory_path() / "paper";
  int scale = 1;
  bool smooth = false;
  int picture_turns = -1;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--out" && i + 1 < argc) {
      out = argv[++i];
    } else if (word == "--scale" && i + 1 < argc) {
      scale = std::max(1, std::atoi(argv[++i]));
    } else if (word == "--picture-turns" && i + 1 < argc) {
      picture_turns = std::max(0, std::atoi(argv[++i]));
    } else if (word == "--smooth") {
      smooth = true;
    } else {
      names.push_back(word);
    }
  }
  if (names.empty()) names = {"portrait", "rings", "brain", "logo", "photo"};
  fs::create_directories(out);
  std::printf("| set-up | samples | transport s | vertices | surface s | CPU s | MB | l1_error | outside support |\n");
  std::printf("|---|---|---|---|---|---|---|---|---|\n");
  int failures = 0;
  for (const std::string& name : names) {
    const std::string title =
        "paper_" + name + (smooth ? "_smooth" : "") + (picture_turns >= 0 ? "_turns_" + std::to_string(picture_turns) : "");
    const fs::path folder = out / title;
    fs::remove_all(folder);
    lightmill::Job job = lightmill::read_job(std::string(LIGHTMILL_FIXTURES) + "/jobs/paper_" + name + ".toml");
    job.transport.samples /= scale * scale;
    job.surface.mesh = (job.surface.mesh - 1) / scale + 1;
    job.name = title;
    if (picture_turns >= 0) job.surface.picture_turns = picture_turns;
    if (smooth) {
      job.surface.solver = lightmill::SurfaceSolver::kHeightField;
      job.surface.picture_turns = 0;
    }
    const fs::path file = out / (title + ".toml");
    lightmill::write_whole(file, lightmill::resolved_toml(job));
    const Cost cost = design(file.string(), folder.string());
    if (!cost.done) {
      std::printf("| %s | failed |\n", name.c_str());
      ++failures;
      continue;
    }
    const json report = json::parse(lightmill::read_whole(folder / "report.json"))["design"];
    const auto figure = [&](const char* part, const char* key) { return report[part][key].get<double>(); };
    std::printf("| %s | %.0f | %.0f | %.0f | %.0f | %.0f | %.0f | %.3f | %.2f %% |\n", name.c_str(),
                figure("transport", "samples"), figure("transport", "seconds"), figure("surface", "vertices"),
                figure("surface", "seconds"), cost.cpu_seconds, cost.peak_mb, figure("caustic", "l1_error"),
                100 * figure("caustic", "flux_outside_support"));
    std::fflush(stdout);
  }
  return failures == 0 ? 0 : 1;
}

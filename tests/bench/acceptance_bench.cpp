// What must hold, as figures beside their bars: acceptance_bench [design|surface|portrait|small]... [--run DIR] [--out DIR]
//   surface   closed forms and pictures at mesh 641, by surface_bench too; minutes, and only when asked for
//   design    point and circle against the closed form, rings, portrait: runs surface_bench, which must be built
//   portrait  the main job through the whole chain; or --run DIR, a finished run folder of it
//   small     the five-axis job through the whole chain
// Prints one line per figure and ends with 1 if one is past its bar.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "design/core/files.h"

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

int failures = 0;

enum class Bar { kAtMost, kAtLeast };

void judge(const std::string& what, double value, Bar bar, double limit) {
  const bool holds = bar == Bar::kAtMost ? value <= limit : value >= limit;  // false for NaN
  std::printf("%-58s %12.6g  %s %-10.6g %s\n", what.c_str(), value, bar == Bar::kAtMost ? "at most " : "at least",
              limit, holds ? "holds" : "FAILS");
  std::fflush(stdout);
  failures += holds ? 0 : 1;
}

std::string quoted(const std::string& text) {
  return "'" + text + "'";
}

/// What a command prints; a command that fails counts as a failure.
std::string output_of(const std::string& command) {
  std::string text;
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) std::abort();
  std::array<char, 4096> some{};
  while (const std::size_t n = std::fread(some.data(), 1, some.size(), pipe)) text.append(some.data(), n);
  const int status = pclose(pipe);
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    std::printf("FAILS: %s\n", command.c_str());
    ++failures;
  }
  return text;
}

/// The number after `label`, which follows `start` in the text; NaN if there is none.
double number_after(const std::string& text, const std::string& start, const std::string& label) {
  std::size_t at = text.find(start);
  if (at != std::string::npos) at = text.find(label, at);
  return at == std::string::npos ? std::nan("") : std::strtod(text.c_str() + at + label.size(), nullptr);
}

/// Figures of the designed surface at mesh 321 on a 100 mm lens at 300 mm; light conservation with them.
void design(const fs::path& bench_folder) {
  const std::string text =
      output_of(quoted((bench_folder / "surface_bench").string()) + " point circle rings portrait");
  judge("point: RMS height error against the hyperboloid, um", number_after(text, "point: RMS", "error"), Bar::kAtMost,
        1);
  judge("circle: RMS height error against the oval, um", number_after(text, "circle: RMS", "error"), Bar::kAtMost, 2);
  judge("rings: light outside their support", number_after(text, "rings: transport", "outside support"), Bar::kAtMost,
        0.04);
  judge("portrait without signature: l1_error", number_after(text, "portrait: transport", "l1_error"), Bar::kAtMost,
        0.10);
  for (const char* name : {"rings", "portrait"}) {
    judge(std::string(name) + ": |light in - light out|",
          std::abs(number_after(text, std::string(name) + ": transport", "light - 1 =")), Bar::kAtMost, 1e-9);
  }
}

/// The surface at its full size: mesh 641, 82 thousand samples for the circle, 262 thousand for pictures.
void surface(const fs::path& bench_folder) {
  const std::string bench = quoted((bench_folder / "surface_bench").string()) + " --mesh 641 ";
  for (const char* name : {"point", "slanted", "near", "sphere", "line", "two", "five", "cone"}) {
    const std::string start = std::string(name) + ": RMS";
    judge(std::string(name) + ": RMS height error, um", number_after(output_of(bench + name), start, "error"), Bar::kAtMost, 0.5);
  }
  judge("circle by 81,920 samples: RMS height error, um",
        number_after(output_of(bench + "circle_map --samples 81920"), "circle_map: RMS", "error"), Bar::kAtMost, 0.3);
  const auto picture = [&](const std::string& name) { return output_of(bench + name + " --samples 262144"); };
  judge("rings: light outside their support", number_after(picture("rings"), "rings: transport", "outside support"), Bar::kAtMost, 0.01);
  judge("portrait: l1_error", number_after(picture("portrait"), "portrait: transport", "l1_error"), Bar::kAtMost, 0.035);
  judge("signed portrait: the curves' light within 0.5 mm of them", number_after(picture("signed"), "signed: curves", "have"), Bar::kAtLeast, 0.99);
}

/// LinuxCNC's interpreter on a program, in a folder and HOME of its own; its tool table is in inches.
bool rs274_reads(const fs::path& program, const fs::path& scratch) {
  fs::create_directories(scratch);
  lightmill::write_whole(scratch / "tool.tbl",
                         "T1 P1 D0.3937008 Z3.5433071\nT2 P2 D0.1574803 Z3.3464567\nT3 P3 D0.1574803 Z3.3464567\n");
  const std::string command = "cd " + quoted(scratch.string()) + " && HOME=" + quoted(scratch.string()) +
                              " rs274 -g -t tool.tbl " + quoted(fs::absolute(program).string()) +
                              " out.txt > log.txt 2>&1";
  return std::system(command.c_str()) == 0 &&
         lightmill::read_whole(scratch / "out.txt").find("PROGRAM_END") != std::string::npos;
}

void judge_run(const std::string& name, const fs::path& run, bool main_job) {
  const json report = json::parse(lightmill::read_whole(run / "report.json"));
  const auto figure = [&](const char* pointer) {
    const json::json_pointer at(pointer);
    if (!report.contains(at)) return std::nan("");
    const json& value = report.at(at);
    return value.is_boolean()  ? static_cast<double>(value.get<bool>())
           : value.is_number() ? value.get<double>()
                               : std::nan("");
  };
  const auto at_most = [&](const char* pointer, double limit) {
    judge(name + ": " + (pointer + 1), figure(pointer), Bar::kAtMost, limit);
  };
  at_most("/design/transport/empty_cells", 0);
  at_most("/design/surface/inverted_triangles", 0);
  if (main_job) at_most("/design/caustic/l1_error", 0.10);
  judge(name + ": cam/solid/valid", figure("/cam/solid/valid"), Bar::kAtLeast, 1);
  at_most("/cam/solid/free_edges", 0);
  judge(name + ": STEP volume off the spline's, relative",
        std::abs(figure("/cam/solid/volume_mm3") / figure("/cam/solid/spline_volume_mm3") - 1), Bar::kAtMost, 1e-6);
  at_most("/cam/solid/rms_deviation_um", 0.5);
  for (const char* pass : {"rough", "semi_finish", "finish"}) {
    at_most(("/postproc/" + std::string(pass) + "/max_axis_speed_ratio").c_str(), 1);
  }
  at_most("/dry_run/faults", 0);
  at_most("/dry_run/max_gouge_um", 1);
  at_most("/dry_run/max_cusp_um", 1.5);
  at_most("/dry_run/limit_violations", 0);
  at_most("/dry_run/collisions", 0);
  at_most("/dry_run/link/bytes_lost", 0);
  if (main_job) {
    judge(name + ": dry_run/link/lines_per_second", figure("/dry_run/link/lines_per_second"), Bar::kAtLeast, 10000);
    at_most("/dry_run/seconds", 180);
  }
  const bool has_rs274 = std::system("command -v rs274 > /dev/null 2>&1") == 0;
  if (!has_rs274)
    std::printf("%s: rs274 is not installed: apt-get install --no-install-recommends linuxcnc-uspace\n", name.c_str());
  for (const char* program : {"10_rough.nc", "20_semi_finish.nc", "30_finish.nc"}) {
    if (!has_rs274) break;
    const fs::path scratch = fs::temp_directory_path() / ("acceptance_rs274_" + std::to_string(getpid()));
    judge(name + ": rs274 reads " + program, rs274_reads(run / "program" / program, scratch) ? 1 : 0, Bar::kAtLeast, 1);
    fs::remove_all(scratch);
  }
}

/// The whole chain of one job; with its time and memory if it is the main one.
void chain(const std::string& name, const fs::path& run, bool main_job) {
  const auto start = std::chrono::steady_clock::now();
  output_of(quoted(LIGHTMILL_BINARY) + " make " + quoted(std::string(LIGHTMILL_FIXTURES) + "/jobs/" + name + ".toml") +
            " -q -o " + quoted(run.string()));
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  rusage usage{};
  getrusage(RUSAGE_CHILDREN, &usage);
  if (main_job) {
    judge(name + ": seconds (only if made afresh)", seconds, Bar::kAtMost, 600);
    judge(name + ": peak memory of a process so far, GB", usage.ru_maxrss / 1048576.0, Bar::kAtMost, 6);
  }
  judge_run(name, run, main_job);
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> cases;
  fs::path finished, out = fs::temp_directory_path() / "lightmill_acceptance";
  for (int a = 1; a < argc; ++a) {
    const std::string word = argv[a];
    if (word == "--run" && a + 1 < argc) {
      finished = argv[++a];
    } else if (word == "--out" && a + 1 < argc) {
      out = argv[++a];
    } else {
      cases.push_back(word);
    }
  }
  if (cases.empty()) cases = {"design", "portrait", "small"};
  for (const std::string& name : cases) {
    if (name == "design") {
      design(fs::read_symlink("/proc/self/exe").parent_path());
    } else if (name == "surface") {
      surface(fs::read_symlink("/proc/self/exe").parent_path());
    } else if (name == "portrait" && !finished.empty()) {
      judge_run("portrait", finished, true);
    } else if (name == "portrait") {
      chain("portrait", out / "portrait", true);
    } else if (name == "small") {
      chain("small_5axis", out / "small_5axis", false);
    } else {
      std::fprintf(stderr, "unknown case %s: design, surface, portrait, small\n", name.c_str());
      return 2;
    }
  }
  std::printf("%d figure%s past the bar\n", failures, failures == 1 ? "" : "s");
  return failures == 0 ? 0 : 1;
}

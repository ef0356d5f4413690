#include "cli/shop_tools.h"

#include <sys/statvfs.h>
#include <sys/sysinfo.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>

#include "cli/cam_inputs.h"
#include "cli/commands.h"
#include "cli/crease_report.h"
#include "cli/job_light.h"
#include "cli/machinability_report.h"
#include "cli/posted_programs.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/text.h"
#include "machine/pseudo_terminal.h"
#include "machine/serial_ports.h"
#include "postproc/machine_model.h"
#include "postproc/program.h"

namespace lightmill {

namespace fs = std::filesystem;

namespace {

std::vector<fs::path> files_of(const fs::path& folder, const std::string& extension) {
  std::vector<fs::path> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    if (entry.path().extension() == extension) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

bool on_path(const char* program) {
  const char* path = std::getenv("PATH");
  std::string folders = path ? path : "";
  std::size_t start = 0;
  while (start <= folders.size()) {
    const std::size_t end = std::min(folders.find(':', start), folders.size());
    if (::access((folders.substr(start, end - start) + "/" + program).c_str(), X_OK) == 0) return true;
    start = end + 1;
  }
  return false;
}

bool say(bool good, const std::string& what, const std::string& remedy = "") {
  std::printf("%-5s %s%s\n", good ? "ok" : "NO", what.c_str(), good || remedy.empty() ? "" : (": " + remedy).c_str());
  return good;
}

}  // namespace

int list_ports() {
  const auto ports = serial_ports();
  for (const auto& port : ports) {
    const bool usable = ::access(port.path.c_str(), R_OK | W_OK) == 0;
    const std::string usb = port.usb_name.empty() ? "" : "  " + port.usb_name;
    std::printf("%s%s%s\n", port.path.c_str(), usb.c_str(), usable ? "" : "  (no permission: add yourself to the group dialout and log in again)");
  }
  if (ports.empty()) std::printf("no serial port found; plug the controller in and look again\n");
  return kExitDone;
}

int list_machines() {
  for (const auto& file : files_of(fixtures_folder() / "machines", ".toml")) {
    const MachineModel machine = read_machine(file);
    if (!machine.has_rotary()) {
      std::printf("%s\n  %s\n  X %s Y %s Z %s mm, no rotary axis; spindle to %s rpm; tools to %s mm\n", file.c_str(), machine.name.c_str(),
                  compact(machine.x.max_mm - machine.x.min_mm, 1).c_str(), compact(machine.y.max_mm - machine.y.min_mm, 1).c_str(),
                  compact(machine.z.max_mm - machine.z.min_mm, 1).c_str(), compact(machine.max_spindle_rpm, 0).c_str(),
                  compact(machine.max_tool_length_mm, 1).c_str());
      if (!machine.notes.empty()) std::printf("  %s\n", machine.notes.c_str());
      continue;
    }
    std::printf("%s\n  %s\n  X %s Y %s Z %s mm, %s %s to %s deg, %s; spindle to %s rpm; tools to %s mm\n", file.c_str(), machine.name.c_str(),
                compact(machine.x.max_mm - machine.x.min_mm, 1).c_str(), compact(machine.y.max_mm - machine.y.min_mm, 1).c_str(),
                compact(machine.z.max_mm - machine.z.min_mm, 1).c_str(), std::string(1, machine.outer.letter).c_str(),
                compact(machine.outer.min_rad * 180 / kPi, 1).c_str(), compact(machine.outer.max_rad * 180 / kPi, 1).c_str(),
                (std::string(1, machine.inner.letter) + (std::isinf(machine.inner.max_rad) ? " endless" : " limited")).c_str(),
                compact(machine.max_spindle_rpm, 0).c_str(), compact(machine.max_tool_length_mm, 1).c_str());
    if (!machine.notes.empty()) std::printf("  %s\n", machine.notes.c_str());
  }
  std::printf("cutters:\n");
  for (const auto& file : files_of(fixtures_folder() / "cutters", ".toml")) {
    const Cutter cutter = read_cutter(file);
    std::printf("  T%d %s\n     %s\n", cutter.number, file.c_str(), cutter.name.c_str());
  }
  return kExitDone;
}

int list_dialects() {
  for (const DialectFacts& dialect : dialects()) {
    std::printf("%-14s %s; %s; at most %d decimals; *%s\n", dialect.name.c_str(), dialect.title.c_str(),
                dialect.tcp ? "kinematics in the post or tool-centre-point control" : "kinematics in the post", dialect.most_decimals,
                dialect.extension.c_str());
  }
  return kExitDone;
}

int doctor() {
  bool good = say(true, std::to_string(std::thread::hardware_concurrency()) + " cores");
  struct sysinfo memory = {};
  ::sysinfo(&memory);
  const double gib = static_cast<double>(memory.totalram) * memory.mem_unit / (1 << 30);
  good &= say(gib >= 5.5, fixed(gib, 1) + " GiB memory", "a full job takes up to 6; use a smaller mesh and fewer samples");
  struct statvfs disk = {};
  const double free_gib = ::statvfs(".", &disk) == 0 ? static_cast<double>(disk.f_bavail) * disk.f_frsize / (1 << 30) : 0;
  good &= say(free_gib >= 1, fixed(free_gib, 1) + " GiB free in this folder", "a run folder takes about 0.3");
  try {
    const PseudoTerminal terminal{fs::path()};
    say(true, "pseudo-terminals (" + terminal.far_end() + ")");
  } catch (const IoError& e) {
    good &= say(false, "pseudo-terminals", e.what());
  }
  std::error_code error;
  good &= say(fs::exists(fixtures_folder() / "machines", error), "machines and cutters in " + fixtures_folder().string(),
              "set LIGHTMILL_FIXTURES to the folder that holds machines/ and cutters/");
  say(on_path("rs274"), "LinuxCNC's rs274 (optional second opinion on programs)", "apt-get install linuxcnc-uspace");
  const auto ports = serial_ports();
  say(!ports.empty(), std::to_string(ports.size()) + " serial ports (needed for stream only)", "plug the controller in");
  for (const auto& port : ports) {
    say(::access(port.path.c_str(), R_OK | W_OK) == 0, port.path.string(), "no permission; add yourself to the group dialout and log in again");
  }
  return good ? kExitDone : kExitIo;
}

int check_machinability(const Job& job, const RunFolder& folder) {
  const SurfaceMesh mesh = read_ply(folder.needed("design/surface.ply", "design"));
  const SplineFit fit = fit_spline(mesh, Box2::centred(job.lens.size_mm), job.spline_fit);
  const Outline outline = outline_of(scene_of(job).lens);
  const SplineSurface surface = faded_outside(fit.surface, outline, job.land.drop_mm);
  const ReachableSurface reachable = reachable_by_finishing(job, surface, outline);
  nlohmann::json found = machinability_json(job, surface, outline, reachable);
  nlohmann::json& refusals = found["refusals"];
  // What only planning sees, as shanks that would touch, from the last time.
  const std::string refused = folder.refusal(Stage::kCam, stage_digest(Stage::kCam, job, folder));
  if (!refused.empty() && std::find(refusals.begin(), refusals.end(), refused) == refusals.end()) refusals.push_back(refused);
  const nlohmann::json cam = folder.report().value("cam", nlohmann::json::object());
  // Limits of the axes, where the tool paths of this job are there.
  const bool planned = folder.is_done(Stage::kCam, stage_digest(Stage::kCam, job, folder));
  if (planned) {
    try {
      posted_programs(job, folder);
    } catch (const InputError& e) {
      refusals.push_back(e.what());
    }
  }
  std::fputs(machinability_text(found, creases_json(surface, reachable, job), cam).c_str(), stdout);
  if (!planned) std::fputs("axis limits       not looked at: that takes the tool paths (lightmill make --until cam)\n", stdout);
  if (refusals.empty()) return kExitDone;
  std::fprintf(stderr, "lightmill: this lens cannot be milled as the job asks: %s\n", refusals.front().get<std::string>().c_str());
  return kExitBadInput;
}

}  // namespace lightmill

#include "cli/commands.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>

#include "cli/errors_file.h"
#include "cli/fault_files.h"
#include "cli/job.h"
#include "cli/machinability_report.h"
#include "cli/mill_proof.h"
#include "cli/operator_keys.h"
#include "cli/pages.h"
#include "cli/progress.h"
#include "cli/run_folder.h"
#include "cli/shop_tools.h"
#include "cli/simulation.h"
#include "cli/stage_runs.h"
#include "cli/stages.h"
#include "cli/stream_command.h"
#include "cli/study.h"
#include "cli/trace_command.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/image.h"
#include "design/core/parallel.h"
#include "design/core/text.h"
#include "machine/fault_words.h"
#include "postproc/kinematics.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Options of every command.
struct Common {
  bool json_events = false;
  bool quiet = false;
  int threads = 0;
  [[nodiscard]] Progress::Style style() const {
    return json_events ? Progress::Style::kJson : quiet ? Progress::Style::kQuiet : Progress::Style::kAuto;
  }
};

/// "100x80x14" as three lengths, and the like.
template <int N>
Eigen::Matrix<double, N, 1> parse_numbers(const std::string& text, char separator, const char* option, const char* example) {
  Eigen::Matrix<double, N, 1> value;
  std::size_t start = 0;
  for (int i = 0; i < N; ++i) {
    const std::size_t end = i < N - 1 ? text.find(separator, start) : text.size();
    const std::string part = end == std::string::npos ? "" : text.substr(start, end - start);
    const auto result = std::from_chars(part.data(), part.data() + part.size(), value[i]);
    if (part.empty() || result.ec != std::errc() || result.ptr != part.data() + part.size() || !std::isfinite(value[i])) {
      throw InputError(std::string(option) + " " + text + ": must be " + std::to_string(N) + " numbers like " + example);
    }
    start = end + 1;
  }
  return value;
}

Vec3 parse_three(const std::string& text, char separator, const char* option, const char* example) {
  return parse_numbers<3>(text, separator, option, example);
}

KeepOut parse_keep_out(const std::string& text) {
  const auto corners = parse_numbers<6>(text, ',', "--keep-out", "-60,-10,0,-50,10,20");
  const KeepOut box{corners.head<3>(), corners.tail<3>()};
  if (!((box.max_mm - box.min_mm).minCoeff() > 0)) throw InputError("--keep-out " + text + ": the first corner must be below the second in every axis");
  return box;
}

Blank parse_blank(const std::string& text) {
  const Vec3 size = parse_three(text, 'x', "--blank", "100x80x14");
  if (!(size.minCoeff() > 0)) throw InputError("--blank " + text + ": lengths must be above 0 mm");
  return {size.head<2>(), size.z(), {}};
}

Job job_of(const RunFolder& folder) { return read_job(folder.file("job.toml")); }

void print_summary(const RunFolder& folder, Progress& progress) {
  const json report = folder.report();
  const auto figure = [&](const char* pointer, int decimals) -> std::string {
    const json::json_pointer p(pointer);
    return report.contains(p) && report.at(p).is_number() ? fixed(report.at(p).get<double>(), decimals) : "-";
  };
  for (const char* part : {"target", "source"}) {
    const json::json_pointer warnings("/design/" + std::string(part) + "/warnings");
    if (!report.contains(warnings)) continue;
    for (const auto& warning : report.at(warnings)) progress.say("warning:  " + std::string(part) + ": " + warning.get<std::string>());
  }
  if (report.contains("/design/caustic"_json_pointer)) {
    progress.say("design:   caustic error " + figure("/design/caustic/l1_error", 3) + " (l1), " + figure("/design/caustic/psnr_db", 1) +
                 " dB; relief " + figure("/design/surface/height_range_mm", 2) + " mm");
  }
  // Every pass there is, the rest pass and the cut-out among them.
  const auto each_pass = [&](const std::string& room, const char* key, int decimals) {
    std::string text;
    for (const char* pass : kPassNames) {
      const std::string at = "/" + room + "/" + pass + key;
      if (report.contains(json::json_pointer(at))) text += (text.empty() ? "" : ", ") + std::string(pass) + " " + figure(at.c_str(), decimals);
    }
    return text;
  };
  if (report.contains("/cam/finish"_json_pointer)) {
    progress.say("cam:      blank " + figure("/cam/blank/height_mm", 1) + " mm high; minutes: " + (report.contains("/cam/rough/minutes"_json_pointer) ? "" : "nothing to rough, ") +
                 each_pass("cam", "/minutes", 1));
  }
  if (report.contains("/postproc/finish"_json_pointer)) {
    progress.say("programs: blocks: " + each_pass("postproc", "/blocks", 0) + " in " + folder.file("program").string());
  }
  if (report.contains("/dry_run/faults"_json_pointer)) {
    progress.say("dry run:  gouge " + figure("/dry_run/max_gouge_um", 2) + " um, cusp " + figure("/dry_run/max_cusp_um", 2) +
                 " um, caustic error polished " + figure("/dry_run/caustic/polished/l1_error", 3) + ", raw " +
                 figure("/dry_run/caustic/raw/l1_error", 3) + "; faults: " + figure("/dry_run/faults", 0));
  }
  progress.say("report:   " + folder.file("report.html").string());
  progress.event({{"event", "report"}, {"path", folder.file("report.json").string()}, {"report", report}});
}

/// What is worth knowing at once of a stage that is done.
void print_warnings(Stage stage, const RunFolder& folder, Progress& progress) {
  const json report = folder.report();
  const json::json_pointer machinability("/cam/machinability");
  if (stage == Stage::kCam && report.contains(machinability)) {
    for (const std::string& change : changed_axes(report.at(machinability))) progress.say("warning:  " + change);
  }
  if (stage != Stage::kPost) return;
  const json postproc = report.value("postproc", json::object());
  for (const char* pass : kPassNames) {
    const json rate = postproc.value(pass, json::object()).value("data_rate", json::object());
    if (const double share = rate.value("starved_share", 0.0); share > 0) {
      const std::string part = share < 0.001 ? "less than 0.1" : fixed(100 * share, 1);
      progress.say("warning:  " + std::string(pass) + " may starve in " + part + " % of its cutting time (the dry run tells): " + rate.value("remedy", ""));
    }
  }
}

int make(const Common& common, const std::string& job_path, const std::string& out, const std::string& until) {
  const Job given = read_job(job_path);
  check_job(given);
  Progress progress(common.style());
  RunFolder folder(out, true);
  // The run uses the job as written: what is in the folder is what was run.
  const std::string resolved = resolved_toml(given);
  const Job job = read_job_text(resolved, folder.file("job.toml").string(), folder.root());
  write_whole(folder.file("job.toml"), resolved);

  const Stage last = until == "transport" ? Stage::kTransport : until == "design" ? Stage::kSurface : until == "cam" ? Stage::kCam : until == "post" ? Stage::kPost : Stage::kDryRun;
  for (const Stage stage : kAllStages) {
    if (stage > last) break;
    const Monitor monitor = progress.stage(stage_name(stage));
    const std::string digest = stage_digest(stage, job, folder);
    if (!digest.empty() && folder.is_done(stage, digest)) {
      progress.done("nothing changed, kept");
      print_warnings(stage, folder, progress);
      continue;
    }
    run_stage(stage, job, folder, monitor);
    write_pages(job, folder);
    progress.done();
    print_warnings(stage, folder, progress);
  }
  write_pages(job, folder);
  print_summary(folder, progress);
  return last == Stage::kDryRun ? dry_run_verdict(folder) : kExitDone;
}

/// A what-if study of a job; what it needs of the chain is made first, or kept.
int study(const Common& common, const std::string& what, const std::string& job_path, const std::string& out, const StudyOptions& options) {
  if (const int code = make(common, job_path, out, "post"); code != kExitDone) return code;
  Progress progress(common.style());
  const RunFolder folder(out, false);
  const Job job = job_of(folder);
  (what == "cusp" ? study_cusp : study_errors)(job, folder, options, progress.stage("study"));
  progress.done();
  progress.say("study:    " + folder.file("study/study_" + what + ".html").string());
  return kExitDone;
}

int run_stages(const Common& common, const std::string& dir, const std::vector<Stage>& stages, const ShopOverrides& overrides = {}) {
  Progress progress(common.style());
  RunFolder folder(dir, false);
  const Job job = job_of(folder);
  for (const Stage stage : stages) {
    run_stage(stage, job, folder, progress.stage(stage_name(stage)), overrides);
    write_pages(job, folder);
    progress.done();
    print_warnings(stage, folder, progress);
  }
  print_summary(folder, progress);
  return stages.back() == Stage::kDryRun ? dry_run_verdict(folder) : kExitDone;
}

int dry_run_programs(const Common& common, const std::vector<std::string>& programs, SimulatedShop shop, const std::string& out) {
  Progress progress(common.style());
  const std::vector<fs::path> paths(programs.begin(), programs.end());
  // grblHAL is fed over a wire; the other controls run files.
  const std::string dialect = read_machine(shop.machine_file).controller;
  const SimulationOutcome outcome = dialect == "grblhal"
                                        ? simulate_programs(shop, paths, fs::absolute(out), progress.stage("dry-run"))
                                        : run_program_files(shop, dialect, paths, fs::absolute(out), progress.stage("dry-run"));
  progress.done();
  const FaultFiles files = write_fault_pictures(out, "", outcome.faults, [&](const std::string& program) {
    const auto found = std::find_if(paths.begin(), paths.end(), [&](const fs::path& path) { return path.filename() == program; });
    return found == paths.end() ? std::string() : read_whole(*found);
  });
  write_whole(fs::path(out) / "faults.json", json({{"faults", files.list}, {"pictures", files.picture_count()}}).dump(2) + "\n");
  write_proof(out, shop, paths, outcome.faults.size());
  progress.say("lines: " + std::to_string(outcome.lines) + ", minutes: " + fixed(total_minutes(outcome.timing), 1) + ", removed: " +
               fixed(outcome.removed_mm3, 1) + " mm3, faults: " + std::to_string(outcome.faults.size()));
  if (outcome.faults.empty()) return kExitDone;
  std::fprintf(stderr, "lightmill: the dry run found %zu fault(s), first: %s; see %s\n", outcome.faults.size(),
               described(outcome.faults.front()).c_str(), (fs::path(out) / "faults.json").c_str());
  return kExitDryRunFault;
}

/// Options for a shop floor, shared by `machine` and `dry-run PROGRAM...`.
struct ShopOptions {
  std::string machine;
  std::vector<std::string> cutters;
  std::string material;
  std::string blank;
  std::vector<std::string> keep_outs;
  std::string origin;
  std::string errors;
  int work_offset = 54;
  double pitch_um = 20;
  double solid_pitch_um = 0;
  double starvation_mark_um = 1;
  double time_factor = 0;
  std::optional<int> pace_baud;  ///< else the command's own
  bool line_times = false;
  std::string protocol = "grblhal";
  std::vector<std::string> line_faults;
  unsigned fault_seed = 1;

  void add(CLI::App* app) {
    app->add_option("--machine", machine, "machine file (fixtures/machines/*.toml)");
    app->add_option("--cutters", cutters, "cutter files of the tool magazine");
    app->add_option("--material", material, "whose cutting data of the cutter files count (default: each file's first by name)");
    app->add_option("--blank", blank, "blank as WIDTHxDEPTHxHEIGHT in mm, e.g. 100x100x14");
    app->add_option("--keep-out", keep_outs, "a clamp or jaw as x0,y0,z0,x1,y1,z1 in mm, workpiece frame; as many as there are");
    app->add_option("--origin", origin, "where the blank's back centre stands, machine frame, x,y,z in mm (default: the table's centre)");
    app->add_option("--work-offset", work_offset, "the offset that is zeroed on the workpiece, 54 to 59")->check(CLI::Range(54, 59));
    app->add_option("--errors", errors, "file with the keys of [dry_run.errors]: how the true machine differs from its file");
    app->add_option("--pitch-um", pitch_um, "grid of the simulated stock in micrometres")->check(CLI::Range(1.0, 1000.0));
    app->add_option("--solid-pitch-um", solid_pitch_um, "grid of a true solid beside it, for walls and undercuts, in micrometres; 0: none")->check(CLI::Range(0.0, 5000.0));
    app->add_option("--starvation-mark-um", starvation_mark_um, "depth of the mark that a cutter leaves which the line lets stand in the cut")->check(CLI::Range(0.0, 1000.0));
    app->add_option("--time-factor", time_factor, "0: as fast as it can, 1: real time")->check(CLI::Range(0.0, 1e6));
    app->add_option("--pace-baud", pace_baud, "pace the simulated line by the byte; 0: not paced (dry-run: the job's, or 115200)")->check(CLI::Range(0, 4000000));
  }
  [[nodiscard]] SimulatedShop shop(int default_baud) const {
    SimulatedShop result;
    result.machine_file = machine.empty() ? fixtures_folder() / "machines/hsm400u_grblhal.toml" : fs::absolute(machine);
    for (const auto& file : cutters) result.cutter_files.push_back(fs::absolute(file));
    if (result.cutter_files.empty()) {
      for (const char* name : {"rough_10mm", "semi_finish_4mm_ball", "finish_4mm_ball"}) {
        result.cutter_files.push_back(fixtures_folder() / "cutters" / (std::string(name) + ".toml"));
      }
    }
    result.material = material;
    if (blank.empty()) throw InputError("no blank given; name its size with --blank, for example --blank 100x100x14");
    result.blank = parse_blank(blank);
    for (const std::string& box : keep_outs) result.blank.keep_outs.push_back(parse_keep_out(box));
    result.workpiece_origin_mm = origin.empty() ? work_on_table(read_machine(result.machine_file), Vec3::Zero(), work_offset).origin_mm
                                                : parse_three(origin, ',', "--origin", "0,0,-420");
    result.work_offset = work_offset;
    if (!errors.empty()) {
      TomlTable table = TomlTable::from_file(errors);
      result.errors = read_machine_errors(table);
      table.finish();
    }
    result.pitch_um = pitch_um;
    result.solid_pitch_um = solid_pitch_um;
    result.starvation_mark_um = starvation_mark_um;
    result.time_factor = time_factor;
    result.baud = pace_baud.value_or(default_baud);
    result.line_times = line_times ? "on" : "off";
    result.protocol = protocol;
    result.line_faults = line_faults;
    result.fault_seed = fault_seed;
    return result;
  }
};

}  // namespace

int run_command_line(int argc, char** argv) {
  catch_stop_signals();
  CLI::App app{"lightmill: from a picture to a milled lens that casts it.\nExample: lightmill make fixtures/jobs/portrait.toml -o out"};
  app.set_version_flag("--version", "lightmill " LIGHTMILL_VERSION);
  app.require_subcommand(1);
  Common common;
  int code = kExitDone;
  const auto command = [&](const char* name, const char* what, const char* example) {
    CLI::App* sub = app.add_subcommand(name, what);
    sub->footer(std::string("Example: lightmill ") + example);
    sub->add_flag("--json", common.json_events, "progress and results as JSON lines on stdout");
    sub->add_flag("-q,--quiet", common.quiet, "no progress");
    sub->add_option("--threads", common.threads, "threads to use (default: all cores)")->check(CLI::Range(0, 1024));
    return sub;
  };
  // Runs after everything is parsed, so that --threads holds wherever it stands.
  std::function<int()> action;
  const auto on = [&](CLI::App* sub, std::function<int()> run) { sub->callback([&action, run = std::move(run)] { action = run; }); };

  std::string job, out, until = "dry-run", dir, link;
  TraceOptions traced;
  std::string trace_direction, trace_lamp, trace_tilt;
  std::vector<std::string> programs;
  StreamChoices streamed;
  ShopOptions shop;

  CLI::App* sub = command("make", "the whole chain: design, tool paths, programs, dry run and report", "make portrait.toml -o out");
  sub->add_option("job", job, "job file (.toml), picture or drawing")->required();
  sub->add_option("-o,--out", out, "run folder")->required();
  sub->add_option("--until", until, "stop after this stage")->check(CLI::IsMember({"transport", "design", "cam", "post", "dry-run"}));
  on(sub, [&] { return make(common, job, out, until); });

  const auto add_streaming = [](CLI::App* to, StreamChoices& choices) {
    to->footer(to->get_footer() + "\n\nKeys while a program streams to grblHAL or grbl (at a terminal):\n" + key_list());
    to->add_option("--port", choices.port, "serial port, or tcp://host:port of a network serial server (default: the job's)");
    to->add_option("--baud", choices.baud, "line speed (default: the job's, 115200)")->check(CLI::Range(300, 4000000));
    to->add_option("--format", choices.format, "data bits, parity, stop bits: 8N1, 7E1... (default: the job's, or the protocol's)");
    to->add_flag("--unproven", choices.unproven, "stream what no dry run has proven; the word is to be typed at the terminal");
    to->add_flag("--no-check", choices.no_check, "leave out the pass in the controller's check mode");
    to->add_flag("--one-at-a-time", choices.one_at_a_time, "wait for each line's ok instead of keeping the buffer full (slower)");
    to->add_option("--pause-at", choices.pause_at, "stop before these lines of the text and ask");
    to->add_flag("--single-block", choices.single_block, "stop before every line and ask");
    to->add_flag("--optional-stops", choices.optional_stops, "stop behind M1 and ask");
    to->add_flag("--confirm-all", choices.confirm_all, "go on at tool changes and pauses without asking (a tool changer, a simulated machine)");
  };
  ResumeChoices resumed;
  sub = command("resume", "go on after an interruption: of a stream, from where its journal proves; else from the first stage that is not done",
                "resume out\n         lightmill resume out --port /dev/ttyUSB0 --overlap 3");
  sub->add_option("folder", resumed.stream.what, "run folder")->required();
  sub->add_option("--from", resumed.from_line, "first line of the program that may not be cut (default: what the journal proves)")->check(CLI::PositiveNumber);
  sub->add_option("--overlap", resumed.overlap_mm, "way in mm that is gone over again before it")->check(CLI::Range(0.0, 1000.0));
  sub->add_option("--program", resumed.program, "that broke off, e.g. 30_FINISH.H, on a control that runs files (with --from)");
  sub->add_flag("--yes", resumed.yes, "stream without a typed confirmation");
  sub->add_option("--protocol", resumed.stream.protocol, "grblhal, grbl, drip or fe (default: the job's)")->check(CLI::IsMember({"grblhal", "grbl", "drip", "fe"}));
  add_streaming(sub, resumed.stream);
  on(sub, [&] {
    const std::string& folder = resumed.stream.what;
    if (std::error_code error; !fs::exists(fs::path(folder) / "job.toml", error)) {
      throw InputError(folder + " is no run folder (it has no job.toml); make one with: lightmill make JOB -o " + folder);
    }
    if (can_resume(resumed)) {
      Progress progress(common.style());
      return resume_stream(resumed, progress);
    }
    if (resumed.from_line > 0 || !resumed.stream.port.empty())
      throw InputError("no stream of the programs in " + folder + " broke off; begin one with: lightmill stream " + folder);
    return make(common, (fs::path(folder) / "job.toml").string(), folder, "dry-run");
  });

  sub = command("design", "design again: light transport, optical surface, predicted picture", "design out");
  sub->add_option("folder", dir, "run folder")->required();
  on(sub, [&] { return run_stages(common, dir, {Stage::kTransport, Stage::kSurface}); });
  sub = command("cam", "solid and tool paths again, from the surface in the run folder", "cam out");
  sub->add_option("folder", dir, "run folder")->required();
  on(sub, [&] { return run_stages(common, dir, {Stage::kCam}); });
  sub = command("post", "programs again, from the tool paths in the run folder", "post out");
  sub->add_option("folder", dir, "run folder")->required();
  on(sub, [&] { return run_stages(common, dir, {Stage::kPost}); });

  CLI::App* dry = command("dry-run", "mill on the simulated machine: a run folder's programs, or any programs",
                          "dry-run out\n         lightmill dry-run part.nc --blank 100x100x14 -o check");
  dry->add_option("what", programs, "run folder, or program files")->required();
  dry->add_option("-o,--out", out, "folder for the results (program files only)");
  shop.add(dry);
  dry->add_flag("--line-times", shop.line_times, "write line_times.csv: seconds, feeds, speed and acceleration of every line");
  on(dry, [&] {
    std::error_code error;
    if (programs.size() > 1 || !fs::is_directory(programs[0], error)) {
      if (out.empty()) throw InputError("name a folder for the results with -o, for example -o check");
      return dry_run_programs(common, programs, shop.shop(StreamSpec{}.baud), out);
    }
    ShopOverrides overrides;
    if (!shop.machine.empty()) overrides.machine_file = fs::absolute(shop.machine);
    for (const auto& file : shop.cutters) overrides.cutter_files.push_back(fs::absolute(file));
    if (dry->count("--work-offset") > 0) overrides.work_offset = shop.work_offset;
    overrides.pace_baud = shop.pace_baud;
    overrides.line_times = shop.line_times;
    for (const char* option : {"--material", "--blank", "--keep-out", "--origin", "--errors", "--pitch-um", "--time-factor"}) {
      if (dry->count(option) > 0) throw InputError(std::string(option) + " belongs to program files; a run folder's job.toml says it");
    }
    return run_stages(common, programs[0], {Stage::kDryRun}, overrides);
  });

  sub = command("stream", "send programs to a controller over a serial port", "stream out --port /dev/ttyUSB0\n         lightmill stream part.nc --proof check --port /dev/ttyUSB0");
  sub->add_option("what", streamed.what, "run folder or program file")->required();
  sub->add_option("--protocol", streamed.protocol, "grblhal, grbl; drip: XON/XOFF to controls that mill what comes; fe: Heidenhain blockwise to the disk (default: the job's, or by its dialect)")
      ->check(CLI::IsMember({"grblhal", "grbl", "drip", "fe"}));
  sub->add_option("--proof", streamed.proof, "of a single program: the folder of its dry run (lightmill dry-run PROGRAM -o FOLDER)");
  add_streaming(sub, streamed);
  on(sub, [&] {
    Progress progress(common.style());
    return stream(streamed, progress);
  });

  sub = command("machine", "the simulated machine behind a pseudo-terminal, until Ctrl-C; then what it milled is in --out",
                "machine --pty /tmp/mill --blank 100x100x14 --out milled");
  sub->add_option("--pty", link, "link that other programs open as their serial port")->required();
  sub->add_option("--out", out, "folder for machined.tif and result.json")->required();
  shop.add(sub);
  sub->add_option("--protocol", shop.protocol, "whose manners the control has on the line")->check(CLI::IsMember({"grblhal", "grbl", "drip", "fe"}));
  sub->add_option("--line-fault", shop.line_faults, "plant a fault on the line, e.g. flip@120 (the 120th byte) or drop-ok@3, or in the control, e.g. reset@400 (the program line); without a place the seed chooses");
  sub->add_option("--fault-seed", shop.fault_seed, "for line faults that name no place");
  on(sub, [&] {
    serve_machine(shop.shop(0), fs::absolute(link), fs::absolute(out), stop_requested);
    return int{kExitDone};
  });

  StudyOptions studied;
  std::string study_what;
  sub = command("study", "what-if: which cusps are good enough for the picture, which machine errors hurt it most",
                "study cusp portrait.toml -o out\n         lightmill study errors portrait.toml -o out --pitch-um 80");
  sub->add_option("what", study_what, "cusp or errors")->required()->check(CLI::IsMember({"cusp", "errors"}));
  sub->add_option("job", job, "job file (.toml), picture or drawing")->required();
  sub->add_option("-o,--out", out, "run folder; what it holds of the job is kept, the study goes into its study/")->required();
  sub->add_option("--pitch-um", studied.pitch_um, "grid of the simulated stock in micrometres")->check(CLI::Range(5.0, 1000.0));
  sub->add_option("--cusps-um", studied.cusps_um, "cusp heights to plan")->check(CLI::Range(0.05, 100.0));
  sub->add_option("--polish-um", studied.polish_sigmas_um, "polish depths (sigma)")->check(CLI::Range(0.0, 10000.0));
  sub->add_option("--seeds", studied.seeds, "draws of the errors' signs; the worst counts (1: signs as given)")->check(CLI::Range(1, 100));
  on(sub, [&] { return study(common, study_what, job, out, studied); });

  std::vector<std::string> gallery_folders;
  std::string gallery_file;
  sub = command("gallery", "one page of pictures and figures of several designs", "gallery out/paper_rings out/paper_logo -o out/gallery.html");
  sub->add_option("folders", gallery_folders, "run folders that have a design")->required();
  sub->add_option("-o,--out", gallery_file, "page to write (HTML); its pictures stay in the run folders")->required();
  on(sub, [&] {
    write_whole(gallery_file, gallery_page({gallery_folders.begin(), gallery_folders.end()}, gallery_file));
    return static_cast<int>(kExitDone);
  });

  sub = command("trace", "light through any surface mesh", "trace surface.ply --job portrait.toml -o caustic.png");
  sub->add_option("surface", traced.surface, "PLY, OBJ or STL mesh, mm, lens frame, fine as design/surface.ply (cam/lens.stl is too coarse for light); walls and bottom are left out")->required();
  sub->add_option("--job", traced.job, "job with target, lens, light and receiver")->required();
  sub->add_option("-o,--out", traced.picture, "picture to write (PNG)");
  sub->add_option("--pixels", traced.pixels, "along the picture's longer side")->check(CLI::Range(1, 16384));
  sub->add_flag("--fresnel", traced.fresnel, "count what both faces reflect (unpolarised light)");
  sub->add_flag("--colours", traced.colours, "red, green and blue bent as acrylic bends them");
  CLI::Option* const direction = sub->add_option("--direction", trace_direction, "parallel light along x,y,z instead of the job's light");
  CLI::Option* const lamp = sub->add_option("--lamp", trace_lamp, "a lamp at x,y,z in mm instead, z below 0")->excludes(direction);
  sub->add_option("--lamp-diameter-mm", traced.lamp_diameter_mm, "of that lamp, a disk")->check(CLI::Range(0.0, 1e5))->needs(lamp);
  sub->add_option("--lamp-samples", traced.lamp_samples, "places of an extended lamp; the blur is resolved to diameter / sqrt of it")->check(CLI::Range(1, 100000));
  sub->add_option("--tilt-deg", trace_tilt, "the wall's tilt about x, then y, e.g. 0,30");
  sub->add_option("--movie", traced.movie, "so many stills beside the picture while the lens turns 22.5 degrees into its place")->check(CLI::Range(0, 9999));
  on(sub, [&] {
    if (!trace_direction.empty()) traced.direction = parse_three(trace_direction, ',', "--direction", "0.1,0,1");
    if (!trace_lamp.empty()) traced.lamp_mm = parse_three(trace_lamp, ',', "--lamp", "0,0,-1000");
    if (!trace_tilt.empty()) traced.tilt_rad = parse_three(trace_tilt + ",0", ',', "--tilt-deg", "0,30").head<2>() * kPi / 180;
    Progress progress(common.style());
    return trace(traced, progress);
  });

  sub = command("check", "can this lens be milled? slopes, radii, what the ball cannot reach", "check out");
  sub->add_option("folder", dir, "run folder")->required();
  on(sub, [&] {
    const RunFolder folder(dir, false);
    return check_machinability(job_of(folder), folder);
  });
  on(command("ports", "serial ports of this computer", "ports"), list_ports);
  on(command("machines", "machines and cutters that come with Lightmill", "machines"), list_machines);
  on(command("dialects", "controller dialects the post-processor writes", "dialects"), list_dialects);
  on(command("doctor", "is this computer fit for work?", "doctor"), doctor);

  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp& e) {
    return app.exit(e);
  } catch (const CLI::CallForAllHelp& e) {
    return app.exit(e);
  } catch (const CLI::CallForVersion& e) {
    return app.exit(e);
  } catch (const CLI::ParseError& e) {
    throw InputError(std::string(e.what()) + "; see lightmill --help");
  }
  if (common.threads > 0) set_thread_count(common.threads);
  code = action();
  return code;
}

}  // namespace lightmill

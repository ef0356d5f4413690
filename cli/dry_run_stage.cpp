#include <algorithm>
#include <chrono>
#include <map>

#include "cli/cut_out_report.h"
#include "cli/digest.h"
#include "cli/fault_files.h"
#include "cli/machined_light.h"
#include "cli/pictures.h"
#include "cli/posted_programs.h"
#include "cli/simulation.h"
#include "cli/spline_file.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/diffraction.h"
#include "machine/dry_run.h"
#include "machine/program_trace.h"
#include "postproc/data_rate.h"
#include "postproc/kinematics.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

std::vector<fs::path> programs_of(const RunFolder& folder) {
  const std::vector<fs::path> programs = folder.programs();
  if (programs.empty()) throw InputError("no program in " + folder.file("program").string() + "; make them with: lightmill post " + folder.root().string());
  return programs;
}

/// The first line that is another one in the two texts, from 1, and what either has there.
struct Difference {
  long line = 1;
  std::string_view here, there;
};
Difference first_difference(std::string_view here, std::string_view there) {
  Difference found;
  for (;;) {
    const std::size_t end = here.find('\n'), other_end = there.find('\n');
    found.here = here.substr(0, end);
    found.there = there.substr(0, other_end);
    if (found.here != found.there || end == std::string_view::npos || other_end == std::string_view::npos) return found;
    here.remove_prefix(end + 1);
    there.remove_prefix(other_end + 1);
    ++found.line;
  }
}

/// A line of a program for a message: short, and nothing in it that no page can show.
std::string quoted(std::string_view line) {
  if (line.empty()) return "nothing";
  constexpr std::size_t kMost = 60;
  std::string text(line.substr(0, kMost));
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) > 0x7e) c = '?';
  }
  return "'" + text + "'";
}

/// Where a program departs from what the post wrote, which is written once more to be compared. The post's inputs may have changed
/// since; then it is only known that it does.
void find_change(Fault& fault, const std::string& text, const Job& job, const RunFolder& folder, const std::string& posted_digest,
                 const MachineModel& machine, const OperatorSetup& setup) {
  std::vector<Program> posted;
  try {
    posted = posted_programs(job, folder);
  } catch (const std::runtime_error&) {
    return;
  }
  const auto same = std::find_if(posted.begin(), posted.end(), [&](const Program& p) { return sha256_of_text(p.text) == posted_digest; });
  if (same == posted.end()) return;
  const Difference change = first_difference(text, same->text);
  fault.line = change.line;
  fault.message = "not what the post wrote, first in this line: " + quoted(change.here) + " for " + quoted(change.there) +
                  "; write it again with: lightmill post";
  if (const auto place = place_of_line(machine, setup, job.controller.dialect, text, fault.line)) fault.place_mm = *place;
}

/// A fault for each program that is not what the post wrote.
std::vector<Fault> change_faults(const Job& job, const RunFolder& folder, const MachineModel& machine, const OperatorSetup& setup) {
  std::vector<Fault> faults;
  const json record = folder.record(Stage::kPost);
  if (record.is_null()) return faults;
  std::error_code error;
  for (const auto& [name, what] : record["files"].items()) {
    const fs::path path = folder.file(name);
    const bool there = fs::exists(path, error);
    if (there && sha256_of_file(path) == what["sha256"]) continue;
    Fault fault;
    fault.kind = "program_changed";
    fault.program = path.filename().string();
    fault.message = there ? name + " is not what the post wrote (lines lost or edited); write it again with: lightmill post"
                          : name + " is missing; write it again with: lightmill post";
    if (there) find_change(fault, read_whole(path), job, folder, what["sha256"], machine, setup);
    faults.push_back(fault);
  }
  return faults;
}

json to_json(const CuspDiffraction& diffraction) {
  json orders = json::array();
  for (const DiffractionOrder& order : diffraction.orders) {
    orders.push_back({{"order", order.order}, {"offset_mm", order.offset_mm}, {"share", order.share}});
  }
  return {{"phase_rad", diffraction.phase_rad}, {"order_spacing_mm", diffraction.order_spacing_mm}, {"rms_mm", diffraction.rms_mm}, {"orders", orders}};
}

/// The profile is cut with the roughing mill.
std::map<std::string, Cutter> planned_cutters(const Job& job) {
  std::map<std::string, Cutter> cutters = {{"rough", job.rough.cutter}, {"semi_finish", job.semi_finish.cutter}, {"finish", job.finish.cutter}, {"profile", job.rough.cutter}};
  if (job.rest) cutters["rest"] = job.rest->cutter;
  return cutters;
}

/// Left out along the outline: a polish rounds the rim anyway.
constexpr double kPolishRim_mm = 1;

std::string place(const Vec2& p) { return "x " + fixed(p.x(), 2) + ", y " + fixed(p.y(), 2) + " mm"; }

/// A fault of the surface, with the motion that made it.
Fault surface_fault(const std::string& kind, const std::string& message, double amount_um, const std::optional<Maker>& maker, const Vec2& where) {
  Fault fault;
  fault.kind = kind;
  fault.message = message;
  fault.amount_mm = amount_um / 1000;
  if (maker) {
    fault.program = maker->program;
    fault.line = maker->line;
    fault.place_mm = maker->place_mm;
    fault.picture = maker->picture;
  } else {
    fault.place_mm = Vec3(where.x(), where.y(), 0);
    fault.picture = "dry_run/deviation.png";
  }
  return fault;
}

/// What feeds every pass in time; `postproc` as in report.json.
std::string feeding_remedy(const json& postproc, int baud) {
  int enough = 0;
  for (const char* pass : kPassNames) {
    const json rate = postproc.value(pass, json::object()).value("data_rate", json::object());
    if (rate.empty()) continue;
    const int least = least_baud(rate.value("peak_blocks_per_s", 0.0), rate.value("bytes_per_block", 0.0));
    if (least == 0) return "no usual line feeds it in time: lower the feed (max_feed_mm_per_min)";
    enough = std::max(enough, least);
  }
  if (enough <= baud) return "lower the feed (max_feed_mm_per_min) or use a faster line than " + std::to_string(baud) + " baud (stream.baud)";
  return "a line of " + std::to_string(enough) + " baud (stream.baud) feeds it in time, or lower the feed (max_feed_mm_per_min)";
}

}  // namespace

StageResult run_dry_run(const Job& job, const RunFolder& folder, const Monitor& monitor, const ShopOverrides& overrides) {
  const auto started = std::chrono::steady_clock::now();
  const SplineSurface design = read_spline(folder.needed("cam/spline.bin", "cam"));
  const std::vector<fs::path> programs = programs_of(folder);

  const json cam = folder.report().value("cam", json::object());
  const SimulatedShop shop = shop_of(job, folder, overrides);
  const MachineModel machine = read_machine(shop.machine_file);
  const OperatorSetup setup = setup_of(shop, machine);
  std::vector<Fault> faults = change_faults(job, folder, machine, setup);
  // grblHAL is fed over a wire; the other controls run files.
  const SimulationOutcome outcome =
      job.controller.dialect == "grblhal"
          ? simulate_programs(shop, programs, folder.file("dry_run"), monitor.part(0, 0.8))
          : run_program_files(shop, job.controller.dialect, programs, folder.file("dry_run"), monitor.part(0, 0.8));
  faults.insert(faults.end(), outcome.faults.begin(), outcome.faults.end());
  const json postproc = folder.report().value("postproc", json::object());
  for (Fault& fault : faults) {
    if (fault.kind == "starved") fault.message += "; " + feeding_remedy(postproc, shop.baud);
  }

  // What is left of the blank, against the very surface that was to be cut.
  monitor.report("measuring the machined surface", 0.8);
  const MachinedSurface machined = read_machined(folder.file("dry_run/machined.tif"));
  DeviationOptions deviation_options;
  deviation_options.finishing_ball_radius_mm = job.finish.cutter.radius_mm();
  deviation_options.rest_pass = cam.contains("rest");
  deviation_options.gouge_tolerance_um = job.dry_run.gouge_tolerance_um;
  const MachinedLight light(job, design, shop.blank);
  deviation_options.outline = light.outline_if_beside();
  const Deviation deviation = measure_deviation(machined, design, deviation_options, monitor.part(0.8, 0.88));
  const auto maker_at = [&](const Vec2& place_mm) {
    std::vector<ProgramFile> files;
    for (const fs::path& program : programs) files.push_back({program.filename().string(), read_whole(program)});
    return maker_of(machine, setup, job.controller.dialect, files, machined, place_mm);
  };
  if (deviation.max_gouge_um > job.dry_run.gouge_tolerance_um) {
    faults.push_back(surface_fault("gouge", "cut " + fixed(deviation.max_gouge_um, 2) + " um below the reachable surface at " +
                                   place(deviation.gouge_place_mm) + "; " + compact(job.dry_run.gouge_tolerance_um, 3) + " um are allowed",
                                   deviation.max_gouge_um, maker_at(deviation.gouge_place_mm), deviation.gouge_place_mm));
  }
  if (deviation.max_cusp_um > job.dry_run.cusp_limit_um) {
    faults.push_back(surface_fault("cusp", "material stands " + fixed(deviation.max_cusp_um, 2) + " um above the design, along its normal, at " +
                                   place(deviation.cusp_place_mm) + " where the ball can reach; " + compact(job.dry_run.cusp_limit_um, 3) +
                                   " um are promised", deviation.max_cusp_um, maker_at(deviation.cusp_place_mm), deviation.cusp_place_mm));
  }
  const double range = std::clamp(3 * std::max(deviation.p99_cusp_um, 0.5), 1.0, 1000.0);
  write_deviation_picture(folder.file("dry_run/deviation.png"), deviation.deviation_um, range);

  StageResult result;
  json& report = result.report["dry_run"];
  if (const fs::path file = folder.file("dry_run/solid.bin"); is_cut_out(job) && fs::exists(file)) {
    const SolidStock solid = SolidStock::read(file);
    report["cut_out"] = cut_out_report(job, design, solid, faults);
    write_height_picture(folder.file("dry_run/tabs.png"), tabs_from_above(job, solid), solid.pitch_mm().x());
    result.files.insert(result.files.end(), {"dry_run/solid.bin", "dry_run/tabs.png"});
  }

  // Light through the machined surface, raw and polished.
  const double white = display_white(light.target());
  const auto cast = [&](const Grid<float>& heights, const char* picture, const Monitor& part) {
    const Caustic caustic = light.cast(heights, machined.extent, part);
    write_png8(folder.file(picture), display_picture(caustic.flux, job.receiver.viewed_from, white));
    return to_json(measure_caustic(caustic, light.target()));
  };
  report["caustic"]["raw"] = cast(machined.heights_mm, "dry_run/caustic_machined_raw.png", monitor.part(0.88, 0.93));
  const Grid<float> polished = light.polished(machined, job.dry_run.polish_sigma_um);
  report["caustic"]["polished"] = cast(polished, "dry_run/caustic_machined.png", monitor.part(0.93, 1));
  report["polish_removal_um"] = polish_removal_um(machined, polished, light.outline(), kPolishRim_mm);
  if (const double period = cam.value("/finish/stepover_mm"_json_pointer, 0.0); job.dry_run.wavelength_um > 0 && period > 0) {
    CuspGrating grating{period, deviation.p99_cusp_um, 0, job.lens.refractive_index, job.receiver.distance_mm, job.dry_run.wavelength_um};
    report["diffraction"]["raw"] = to_json(cusp_diffraction(grating));
    grating.polish_sigma_um = job.dry_run.polish_sigma_um;
    report["diffraction"]["polished"] = to_json(cusp_diffraction(grating));
    report["diffraction"]["period_mm"] = period;
    report["diffraction"]["wavelength_um"] = job.dry_run.wavelength_um;
  }

  const json timings = pass_timings(outcome.timing, postproc, machine);
  // They are where the tool they speak of cuts first.
  const auto add_at_first_feed = [&](std::vector<Fault> found) {
    for (Fault& fault : found) {
      bool is_there = false;
      trace_program(machine, setup, job.controller.dialect, read_whole(folder.file("program/" + fault.program)),
                    [&](const Motion& motion, const std::vector<SweptMove>& pieces) {
                      if (is_there || motion.rapid || motion.line < fault.line) return;
                      is_there = true;
                      fault.line = motion.line;
                      fault.place_mm = pieces.back().to.tip_mm;
                    });
      faults.push_back(fault);
    }
  };
  add_at_first_feed(tool_faults(outcome.timing, planned_cutters(job), postproc));
  // A run that stopped early says so by itself.
  if (outcome.faults.empty()) add_at_first_feed(feed_faults(timings, cam, postproc));

  std::map<std::string, long> kinds;
  for (const Fault& fault : faults) ++kinds[fault.kind];
  const FaultFiles files = write_fault_pictures(folder.root(), "dry_run/", faults, [&](const std::string& program) {
    const fs::path path = folder.file("program/" + program);
    std::error_code error;
    return fs::exists(path, error) ? read_whole(path) : std::string();
  });
  result.files.insert(result.files.end(), files.pictures.begin(), files.pictures.end());
  json streams = json::array();
  long stream_lines = 0;
  for (std::size_t i = 0; i < outcome.streams.size(); ++i) {
    const StreamResult& s = outcome.streams[i];
    streams.push_back({{"program", programs[i].filename().string()}, {"end", stream_end_name(s.end)}, {"message", s.message},
                       {"lines", s.lines_total}, {"acknowledged", s.lines_acknowledged}, {"bytes", s.bytes_sent},
                       {"seconds", s.seconds}, {"highest_buffer_fill", s.highest_buffer_fill}});
    stream_lines += s.lines_acknowledged;
  }
  write_whole(folder.file("dry_run/faults.json"), json({{"faults", files.list}, {"pictures", files.picture_count()}, {"streams", streams}}).dump(2) + "\n");

  report["faults"] = faults.size();
  report["fault_kinds"] = kinds;
  report["max_gouge_um"] = deviation.max_gouge_um;
  report["max_cusp_um"] = deviation.max_cusp_um;
  report["p99_cusp_um"] = deviation.p99_cusp_um;
  report["residue_um"] = deviation.residue_um;
  report["unreachable_area_mm2"] = deviation.unreachable_area_mm2;
  report["gouged_area_mm2"] = deviation.gouged_area_mm2;
  const DeviationHistogram& histogram = deviation.histogram;
  report["deviation_histogram"] = {{"first_um", histogram.first_um}, {"bin_um", histogram.bin_um}, {"area_mm2", histogram.area_mm2},
                                   {"below_mm2", histogram.below_mm2}, {"above_mm2", histogram.above_mm2}};
  report["gouge_place_mm"] = {deviation.gouge_place_mm.x(), deviation.gouge_place_mm.y()};
  report["cusp_place_mm"] = {deviation.cusp_place_mm.x(), deviation.cusp_place_mm.y()};
  report["deviation_picture_range_um"] = range;
  report["gouge_tolerance_um"] = job.dry_run.gouge_tolerance_um;
  report["cusp_limit_um"] = job.dry_run.cusp_limit_um;
  report["polish_sigma_um"] = job.dry_run.polish_sigma_um;
  report["cusp_blur_mm"] = blur_on_screen_mm(job.finish.cutter.radius_mm(), job.finish.options.cusp_um, job.receiver.distance_mm,
                                             job.lens.refractive_index, job.dry_run.polish_sigma_um / 1000);
  report["limit_violations"] = kinds["limit"];
  report["collisions"] = kinds["collision"] + kinds["rapid_in_stock"];
  report["minutes"] = total_minutes(outcome.timing);
  report.update(timings);
  report["removed_mm3"] = outcome.removed_mm3;
  report["link"] = {{"lines", outcome.lines},
                    {"lines_per_second", outcome.stream_seconds > 0 ? static_cast<double>(stream_lines) / outcome.stream_seconds : 0},
                    {"seconds", outcome.stream_seconds},
                    {"bytes", outcome.bytes_received},
                    {"bytes_lost", outcome.bytes_lost},
                    {"highest_buffer_fill", outcome.highest_buffer_fill},
                    {"baud", shop.baud},
                    {"starvations", outcome.starvations},
                    {"starved_seconds", outcome.starved_seconds},
                    {"digest_matches", outcome.digest_matches}};
  report["streams"] = streams;
  report["seconds"] = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  result.files.insert(result.files.end(), {"dry_run/machined.tif", "dry_run/machined_peaks.tif", "dry_run/machined_peak_offsets.tif", "dry_run/result.json", "dry_run/faults.json",
                                           "dry_run/deviation.png", "dry_run/caustic_machined.png", "dry_run/caustic_machined_raw.png"});
  if (fs::exists(folder.file("dry_run/line_times.csv"))) result.files.emplace_back("dry_run/line_times.csv");
  return result;
}

}  // namespace lightmill

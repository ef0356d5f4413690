#include "cli/study.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "cli/errors_file.h"
#include "cli/html_page.h"
#include "cli/machined_light.h"
#include "cli/plot.h"
#include "cli/simulation.h"
#include "cli/spline_file.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/markup.h"
#include "design/core/text.h"
#include "machine/dry_run.h"
#include "machine/kinematics.h"
#include "machine/program_run.h"
#include "machine/simulated_machine.h"

namespace lightmill {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Finishing starts from the design and this: more than any error that is studied.
constexpr double kSemiFinished_mm = 0.05;
/// A coarser stock does not see the slopes of cusps, only their beat with its nodes.
constexpr double kNodesPerCusp = 8;
/// Of the light's brightness, that polished cusps may leave to see.
constexpr double kRipple = 0.05;
constexpr double kFinestPitch_um = 10;

/// What all cases of a study share.
class Shop {
 public:
  Shop(const Job& job, const RunFolder& folder)
      : design_(read_spline(folder.needed("cam/spline.bin", "cam"))), blank_(shop_of(job, folder).blank), light_(job, design_, blank_) {}
  [[nodiscard]] const SplineSurface& design() const { return design_; }
  [[nodiscard]] const Blank& blank() const { return blank_; }
  [[nodiscard]] const MachinedLight& light() const { return light_; }

  /// The semi-finished blank, `feed(stock)` milled with the cutter.
  template <typename Feed>
  MachinedSurface mill(const Cutter& cutter, double pitch_um, Feed&& feed) const {
    StockOptions options;
    options.pitch_mm = pitch_um / 1000;
    StockModel stock(blank_, options);
    stock.lower_to([&](const Vec2& p) { return design_.height(p.x(), p.y()) + kSemiFinished_mm; });
    stock.set_cutter(cutter);
    feed(stock);
    stock.flush();
    return stock.surface();
  }

 private:
  SplineSurface design_;
  Blank blank_;
  MachinedLight light_;
};

std::string table_of(const std::vector<std::string>& heads, const std::vector<std::vector<std::string>>& rows) {
  std::string html = "<table><tr>";
  for (const auto& head : heads) html += "<th>" + escaped(head) + "</th>";
  html += "</tr>\n";
  for (const auto& row : rows) {
    html += "<tr>";
    for (const auto& cell : row) html += "<td>" + escaped(cell) + "</td>";
    html += "</tr>\n";
  }
  return html + "</table>\n";
}

std::string page(const std::string& title, const std::string& body) { return html_page(title, "<h1>" + escaped(title) + "</h1>\n" + body); }

void write_study(const RunFolder& folder, const std::string& name, const json& record, const std::string& html) {
  std::error_code error;
  fs::create_directories(folder.file("study"), error);
  if (error) throw IoError("cannot create folder " + folder.file("study").string() + ": " + error.message());
  write_whole(folder.file("study/" + name + ".json"), record.dump(2) + "\n");
  write_whole(folder.file("study/" + name + ".html"), html);
}

// --- Errors ---

struct ErrorCase {
  std::string name, size;
  MachineErrors errors;
};

std::vector<ErrorCase> fair_machine() {
  std::vector<ErrorCase> cases;
  const auto add = [&](const char* name, const char* size, auto&& set) {
    cases.push_back({name, size, {}});
    set(cases.back().errors);
  };
  constexpr double um = 1e-3, um_per_m = 1e-6, arcsec = kPi / 180 / 3600;
  add("backlash of X", "5 um", [&](auto& e) { e.backlash_mm.x() = 5 * um; });
  add("backlash of Y", "5 um", [&](auto& e) { e.backlash_mm.y() = 5 * um; });
  add("backlash of Z", "5 um", [&](auto& e) { e.backlash_mm.z() = 5 * um; });
  add("backlash of the rotary axes", "10 arcsec", [&](auto& e) { e.outer_backlash_rad = e.inner_backlash_rad = 10 * arcsec; });
  add("scale of X, Y, Z", "50 um/m", [&](auto& e) { e.scale = Vec3::Constant(50 * um_per_m); });
  add("squareness", "50 um/m", [&](auto& e) { e.squareness_rad = Vec3::Constant(50 * um_per_m); });
  add("pivot of the outer axis", "10 um", [&](auto& e) { e.outer_pivot_mm = Vec3::Constant(10 * um); });
  add("pivot of the inner axis", "10 um", [&](auto& e) { e.inner_pivot_mm = Vec3::Constant(10 * um); });
  add("thermal drift of X and Y", "10 um, 1 h", [&](auto& e) { e.drift_mm = {10 * um, 10 * um, 0}; });
  add("thermal drift of Z", "10 um, 1 h", [&](auto& e) { e.drift_mm.z() = 10 * um; });
  add("radius of the cutter", "5 um", [&](auto& e) { e.tool_radius_mm = 5 * um; });
  add("runout", "3 um", [&](auto& e) { e.runout_mm = 3 * um; });
  for (const double hz : {10.0, 50.0, 150.0}) {
    cases.push_back({"vibration along Z at " + compact(hz, 0) + " Hz", "0.5 um", {}});
    cases.back().errors.vibration_mm.z() = 0.5 * um;
    cases.back().errors.vibration_hz = hz;
  }
  return cases;
}

/// The job's own errors, one key at a time.
std::vector<ErrorCase> own_errors(const MachineErrors& own) {
  std::vector<ErrorCase> cases;
  const std::string all = machine_errors_text(own, ""), none = machine_errors_text({}, "");
  const auto lines = [](const std::string& text) {
    std::vector<std::string> result;
    for (std::size_t at = 0; at < text.size();) {
      const std::size_t end = text.find('\n', at);
      result.push_back(text.substr(at, end - at));
      at = end + 1;
    }
    return result;
  };
  const std::vector<std::string> given = lines(all), absent = lines(none);
  for (std::size_t k = 0; k < given.size(); ++k) {
    const std::string key = given[k].substr(0, given[k].find(" ="));
    if (given[k] == absent[k] || key == "seed" || key == "drift_hours" || key == "vibration_hz") continue;
    std::string text = given[k] + "\nseed = " + std::to_string(own.seed) + "\ndrift_hours = " + compact(own.drift_hours, 6) +
                       "\nvibration_hz = " + compact(own.vibration_hz, 6) + "\n";
    TomlTable table = TomlTable::from_text(text, "dry_run.errors");
    cases.push_back({key, given[k].substr(given[k].find("= ") + 2), read_machine_errors(table)});
  }
  return cases;
}

/// The motions that the finishing cutter makes in feed, as the simulated machine hears them from the programs.
std::vector<Motion> finishing_motions(const Job& job, const RunFolder& folder, const MachineModel& machine, const OperatorSetup& setup,
                                      const Monitor& monitor) {
  std::vector<Motion> motions;
  const json files = folder.report().at("postproc").at("finish").at("files");
  const auto keep = [&](const Motion& motion) {
    if (motion.tool == job.finish.cutter.number) motions.push_back(motion);
  };
  std::vector<ProgramFile> programs;
  for (const json& file : files) {
    const std::string name = file.at("file");
    programs.push_back({name, read_whole(folder.file(name))});
  }
  if (job.controller.dialect != "grblhal") {
    StockOptions coarse;
    coarse.pitch_mm = 5;  // only the motions are asked for
    run_programs(machine, reader_dialect(job.controller.dialect), setup, programs, coarse, monitor, keep);
    return motions;
  }
  SimulationOptions options;
  options.remove_stock = false;
  SimulatedMachine simulated(machine, setup, options);
  simulated.on_motion = [&](const Motion& motion, const std::vector<SweptMove>&) { keep(motion); };
  simulated.start();
  for (const ProgramFile& program : programs) {
    for (std::size_t at = 0; at < program.text.size();) {
      monitor.report("reading the program", static_cast<double>(at) / program.text.size());
      for (int line = 0; line < 1000 && at < program.text.size(); ++line) {
        const std::size_t end = std::min(program.text.find('\n', at), program.text.size() - 1);
        simulated.receive(std::string_view(program.text).substr(at, end + 1 - at));
        simulated.work(1);
        simulated.receive("~");  // the operator is always there for M6 and M0
        simulated.take_replies();
        at = end + 1;
      }
    }
  }
  return motions;
}

/// A second pitch, as a share of the asked one: what an error adds on one grid alone is the grid's doing.
constexpr double kOtherGrid = 0.9;

/// A leaning ball that runs out sweeps a body with a flat end. Where it touches, at about the lean from its axis, that is a
/// ball again to second order in the angle: larger by e / sin, its centre farther up the axis by e / tan; quick to mill.
struct RunOut {
  Cutter cutter;
  double tip_shift_mm = 0;  ///< along the axis
};
RunOut as_a_ball(const Cutter& cutter, MachineErrors errors, double lean_rad) {
  constexpr double kUpright_rad = 0.2;
  const double e = errors.runout_mm;
  if (e == 0 || !cutter.is_ball() || lean_rad < kUpright_rad) return {as_it_turns(cutter, errors), 0};
  errors.runout_mm = 0;
  RunOut result{as_it_turns(cutter, errors), e * (std::cos(lean_rad) - 1) / std::sin(lean_rad)};
  result.cutter.diameter_mm += 2 * e / std::sin(lean_rad);
  result.cutter.corner_radius_mm = result.cutter.radius_mm();
  return result;
}

struct Milled {
  double raw = 0, polished = 0, form_um = 0;
};

Milled measure(const Job& job, const Shop& shop, const MachinedSurface& surface) {
  Milled result;
  result.raw = shop.light().measure(surface.heights_mm, surface.extent).l1_error;
  const Grid<float> polished = shop.light().polished(surface, job.dry_run.polish_sigma_um);
  result.polished = shop.light().measure(polished, surface.extent).l1_error;
  // Form: what the polish leaves of the deviation, the mean taken off (it is thickness, not form).
  const double rim = 1;
  double sum = 0, squares = 0;
  long count = 0;
  for (int j = 0; j < polished.height; j += 4) {
    for (int i = 0; i < polished.width; i += 4) {
      const Vec2 p = surface.extent.min + surface.pitch_mm * Vec2(i, j);
      if ((p.cwiseAbs() - shop.design().extent().size() / 2).maxCoeff() > -rim) continue;
      const double off = (polished.at(i, j) - shop.design().height(p.x(), p.y())) * 1000;
      sum += off;
      squares += off * off;
      ++count;
    }
  }
  if (count > 0) result.form_um = std::sqrt(std::max(0.0, squares / count - sum / count * (sum / count)));
  return result;
}

}  // namespace

void study_cusp(const Job& job, const RunFolder& folder, const StudyOptions& options, const Monitor& monitor) {
  const Shop shop(job, folder);
  const double rapid = read_machine(job.machine.file).x.max_speed_mm_per_s;
  FinishOptions finish = job.finish.options;
  finish.outline = shop.light().outline_if_beside();
  json rows = json::array();
  std::vector<std::vector<std::string>> table;
  std::vector<PlotLine> errors;
  PlotLine minutes{"minutes", {}};
  for (const double sigma : options.polish_sigmas_um) errors.push_back({sigma == 0 ? "as milled" : "polish " + compact(sigma, 1) + " um", {}});

  const double count = static_cast<double>(options.cusps_um.size());
  for (std::size_t k = 0; k < options.cusps_um.size(); ++k) {
    const Monitor part = monitor.part(k / count, (k + 1) / count);
    finish.cusp_um = options.cusps_um[k];
    const ToolPath path = plan_finishing(shop.design(), shop.blank(), job.finish.cutter, finish, part.part(0, 0.3));
    part.report("milling", 0.3);
    const double pitch_um = std::min(options.pitch_um, std::max(kFinestPitch_um, 1000 * path.stepover_mm / kNodesPerCusp));
    const MachinedSurface surface = shop.mill(path.cutter, pitch_um, [&](StockModel& stock) {
      for (std::size_t i = 1; i < path.moves.size(); ++i) {
        const Move& move = path.moves[i];
        if (move.kind != MoveKind::kCut && move.kind != MoveKind::kPlunge) continue;
        SweptMove swept;
        swept.line = static_cast<long>(i);
        swept.from = path.moves[i - 1].pose;
        swept.to = move.pose;
        swept.spindle_on = true;
        stock.move(swept);
      }
    });
    json row = {{"cusp_um", finish.cusp_um}, {"stepover_mm", path.stepover_mm}, {"pitch_um", pitch_um}, {"minutes", path.minutes(rapid)}, {"l1_error", json::array()}};
    const double hiding_um = 1000 * polish_that_hides_mm(job.finish.cutter.radius_mm(), path.stepover_mm, job.receiver.distance_mm, job.lens.refractive_index, kRipple);
    row["hiding_polish_um"] = hiding_um;
    std::vector<std::string> cells = {compact(finish.cusp_um, 3), fixed(path.stepover_mm, 3), fixed(path.minutes(rapid), path.minutes(rapid) < 10 ? 1 : 0), fixed(hiding_um, 0)};
    for (std::size_t s = 0; s < options.polish_sigmas_um.size(); ++s) {
      part.report("tracing light", 0.5 + 0.5 * static_cast<double>(s) / options.polish_sigmas_um.size());
      const double sigma = options.polish_sigmas_um[s];
      const CausticMeasures measures = shop.light().measure(shop.light().polished(surface, sigma), surface.extent);
      row["l1_error"].push_back({{"polish_sigma_um", sigma}, {"l1_error", measures.l1_error}, {"psnr_db", measures.psnr_db},
                                 {"flux_outside_support", measures.flux_outside_support}});
      errors[s].points.emplace_back(finish.cusp_um, measures.l1_error);
      cells.push_back(fixed(measures.l1_error, 3));
    }
    minutes.points.emplace_back(finish.cusp_um, path.minutes(rapid));
    rows.push_back(row);
    table.push_back(cells);
  }

  std::vector<std::string> heads = {"cusp, um", "stepover, mm", "minutes", "polish that hides it, um"};
  for (const PlotLine& line : errors) heads.push_back(line.name);
  PlotAxes axes{"planned cusp height, um", "picture error (l1)", true, false};
  const std::string body =
      "<p>Picture error through the finished lens for cusps of every height, as milled and after a polish that smooths the heights by a "
      "Gaussian of the given sigma (a model). The finest stepover costs the most time; the curves say where it stops to pay. A polish of "
      "half of what hides the cusps is worse than none: it rounds them into little lenses, and each draws a line of light.</p>\n" +
      line_plot(errors, axes) + "\n" + line_plot({minutes}, {"planned cusp height, um", "minutes of finishing", true, true}) + "\n" + table_of(heads, table) +
      "<p class=soft>" + escaped("Stock with " + compact(kNodesPerCusp, 2) + " nodes from cusp to cusp, but no finer than " + compact(kFinestPitch_um, 2) + " and no coarser than " +
              compact(options.pitch_um, 2) + " um: light as milled is right to about a tenth; minutes at the planned feeds; designed surface alone: " + fixed(folder.report().value("/design/caustic/l1_error"_json_pointer, 0.0), 3) + ".") + "</p>\n";
  write_study(folder, "study_cusp", {{"rows", rows}}, page(job.name + ": what cusp is good enough?", body));
}

void study_errors(const Job& job, const RunFolder& folder, const StudyOptions& options, const Monitor& monitor) {
  const Shop shop(job, folder);
  MachineModel machine = read_machine(job.machine.file);
  machine.controller = job.controller.dialect;
  SimulatedShop floor = shop_of(job, folder);
  floor.errors = {};
  const OperatorSetup setup = setup_of(floor, machine);
  const std::vector<Motion> motions = finishing_motions(job, folder, machine, setup, monitor.part(0, 0.05));
  if (motions.empty()) throw InputError("the finishing program in " + folder.root().string() + " moves nothing; write it again with: lightmill post");

  const JointPosition& middle = motions[motions.size() / 2].to;
  const ToolPose leaning = WorkpieceView(machine, setup.workpiece_origin_mm).cutter(middle, job.finish.cutter.length_mm);
  const double lean_rad = std::atan2(std::hypot(leaning.axis.x(), leaning.axis.y()), leaning.axis.z());

  std::vector<ErrorCase> cases = machine_errors_text(job.dry_run.errors, "") == machine_errors_text({}, "") ? fair_machine() : own_errors(job.dry_run.errors);
  cases.insert(cases.begin(), {"none", "", {}});
  const auto milled_with = [&](const MachineErrors& errors, double pitch_um) {
    WorkpieceView view(machine, setup.workpiece_origin_mm, errors);
    std::vector<SweptMove> pieces;
    const RunOut turning = as_a_ball(job.finish.cutter, errors, lean_rad);
    return measure(job, shop, shop.mill(turning.cutter, pitch_um, [&](StockModel& stock) {
      for (const Motion& motion : motions) {
        pieces.clear();
        view.sweep(motion, job.finish.cutter.length_mm, {}, pieces);
        if (motion.rapid) continue;
        for (SweptMove& piece : pieces) {
          piece.from.tip_mm += turning.tip_shift_mm * piece.from.axis;
          piece.to.tip_mm += turning.tip_shift_mm * piece.to.axis;
          stock.move(piece);
        }
      }
    }));
  };
  struct Result {
    const ErrorCase* what;
    Milled milled;
    double elsewhere = 0;  ///< picture's error, polished, on the other grid
  };
  std::vector<Result> results;
  for (std::size_t k = 0; k < cases.size(); ++k) {
    Milled worst;
    MachineErrors worst_errors;
    const int seeds = k == 0 ? 1 : options.seeds;
    for (int s = 0; s < seeds; ++s) {
      monitor.report("milling with " + cases[k].name, 0.05 + 0.95 * (static_cast<double>(k) + static_cast<double>(s) / seeds) / cases.size());
      MachineErrors errors = cases[k].errors;
      if (options.seeds > 1) errors.seed = static_cast<unsigned>(s + 1);
      const Milled milled = milled_with(errors, options.pitch_um);
      if (s > 0 && milled.polished <= worst.polished) continue;
      worst = milled;
      worst_errors = errors;
    }
    results.push_back({&cases[k], worst, milled_with(worst_errors, kOtherGrid * options.pitch_um).polished});
  }
  const Result none = results.front();
  std::stable_sort(results.begin() + 1, results.end(),
                   [](const Result& a, const Result& b) { return a.milled.polished > b.milled.polished; });

  json rows = json::array();
  std::vector<std::vector<std::string>> table;
  std::vector<PlotBar> bars;
  for (const Result& r : results) {
    const double harm = r.milled.polished - none.milled.polished;
    const double noise = std::abs(r.elsewhere - none.elsewhere - harm);
    rows.push_back({{"error", r.what->name}, {"size", r.what->size}, {"l1_error_polished", r.milled.polished}, {"l1_error_raw", r.milled.raw},
                    {"harm", harm}, {"noise", noise}, {"form_um", r.milled.form_um}});
    table.push_back({r.what->name, r.what->size, fixed(r.milled.polished, 4), fixed(harm, 4), fixed(noise, 4), fixed(r.milled.raw, 3), fixed(r.milled.form_um, 3)});
    if (r.what != &cases.front()) bars.push_back({r.what->name + " (" + r.what->size + ")", harm});
  }
  const std::string body =
      "<p>The finishing program milled with one error of the machine at a time. What stands on top hurts the picture most: calibrate it "
      "first.</p>\n" + bar_plot(bars, "picture error (l1) added, after the polish") + "\n" +
      table_of({"error", "size", "picture error, polished", "added", "noise", "as milled", "form left, um rms"}, table) + "<p class=soft>" +
      escaped("Stock at " + compact(options.pitch_um, 1) + " um pitch, polish sigma " + compact(job.dry_run.polish_sigma_um, 1) + " um (a model); " +
              (options.seeds > 1 ? "the worst of " + std::to_string(options.seeds) + " draws of the signs. " : std::string("signs as given: what one sign gains another may lose, --seeds 4 takes the worst of four draws. ")) +
              "Noise: what is added on a stock of " + compact(kOtherGrid, 2) + " times the pitch differs by so much; less than it, added or gained, means nothing, and a finer "
              "--pitch-um tells more apart. Form: machined and polished minus designed, the mean taken off.") + "</p>\n";
  write_study(folder, "study_errors", {{"pitch_um", options.pitch_um}, {"seeds", options.seeds}, {"rows", rows}},
              page(job.name + ": which error hurts the picture most?", body));
}

}  // namespace lightmill

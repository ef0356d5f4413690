#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>

#include "cam/finishing.h"
#include "cli/fault_files.h"
#include "cli/html_page.h"
#include "cli/machinability_report.h"
#include "cli/pages.h"
#include "cli/plot.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/files.h"
#include "design/core/markup.h"
#include "design/core/text.h"
#include "machine/fault_words.h"

namespace lightmill {

using nlohmann::json;

namespace {

constexpr double kLeastContactDeg = kLeastContactAngle * 180 / kPi;
constexpr double kMostContactDeg = kMostContactAngle * 180 / kPi;

/// Rows of the table of figures; a figure that is not there yet leaves no row.
class Figures {
 public:
  explicit Figures(const json& report) : report_(report) {}

  void group(const std::string& title) { pending_ = "<tr class=group><td colspan=4>" + escaped(title) + "</td></tr>\n"; }

  /// `unit_factor` turns the report's unit into the shown one. `limit`: at most this is good.
  void row(const char* pointer, const std::string& what, const std::string& unit, int decimals, std::optional<double> limit = {},
           double unit_factor = 1) {
    const json::json_pointer p(pointer);
    if (!report_.contains(p) || !report_.at(p).is_number()) return;
    const double value = report_.at(p).get<double>() * unit_factor;
    std::string verdict;
    std::string limit_text;
    if (limit) {
      // A figure at its limit is good whatever the last bit says.
      const bool good = value <= *limit * (1 + 1e-12);
      limit_text = *limit == 0 ? "none" : "at most " + compact(*limit, 6);
      verdict = good ? "<span class=ok>ok</span>" : "<span class=no>too high</span>";
    }
    line(what, fixed(value, decimals) + (unit.empty() ? "" : " " + unit), limit_text, verdict);
  }
  void row_at_least(const json::json_pointer& at, const std::string& what, const std::string& unit, int decimals, double limit) {
    if (!report_.contains(at)) return;
    const double value = report_.at(at).get<double>();
    line(what, fixed(value, decimals) + " " + unit, "at least " + compact(limit, 6),
         value >= limit - 0.5 * std::pow(10.0, -decimals) ? "<span class=ok>ok</span>" : "<span class=no>too low</span>");
  }
  void flag(const char* pointer, const std::string& what, const std::string& yes, const std::string& no) {
    const json::json_pointer p(pointer);
    if (!report_.contains(p) || !report_.at(p).is_boolean()) return;
    const bool good = report_.at(p).get<bool>();
    line(what, good ? yes : no, yes, good ? "<span class=ok>ok</span>" : "<span class=no>no</span>");
  }
  [[nodiscard]] std::string table() const {
    return "<table><tr><th>figure</th><th style=\"text-align:right\">value</th><th>limit</th><th></th></tr>\n" + rows_ + "</table>\n";
  }

 private:
  void line(const std::string& what, const std::string& value, const std::string& limit, const std::string& verdict) {
    rows_ += pending_ + "<tr><td>" + escaped(what) + "</td><td class=number>" + escaped(value) + "</td><td class=soft>" +
             escaped(limit) + "</td><td>" + verdict + "</td></tr>\n";
    pending_.clear();
  }
  const json& report_;
  std::string rows_, pending_;
};

/// A figure element, or nothing while the picture is not there.
std::string picture(const RunFolder& folder, const std::string& relative, const std::string& title, const std::string& caption,
                    bool light = false) {
  std::error_code error;
  if (!std::filesystem::exists(folder.file(relative), error)) return "";
  return "<figure" + std::string(light ? " class=light" : "") + "><a href=\"" + relative + "\"><img src=\"" + relative + "\" alt=\"" +
         escaped(title) + "\"></a><figcaption><b>" + escaped(title) + "</b>" + escaped(caption) + "</figcaption></figure>\n";
}

std::string deviation_histogram(const json& report) {
  const json histogram = report.value("/dry_run/deviation_histogram"_json_pointer, json::object());
  const std::vector<double> areas = histogram.value("area_mm2", std::vector<double>());
  if (areas.empty()) return "";
  return "<figure>" + histogram_plot(histogram.at("first_um"), histogram.at("bin_um"), areas, {"milled minus reachable, µm", "mm² in " + compact(histogram.at("bin_um"), 2) + " µm"}) +
         "<figcaption><b>Milled minus reachable, by area</b>beyond the picture: " + fixed(histogram.at("below_mm2").get<double>(), 3) + " mm² below, " +
         fixed(histogram.at("above_mm2").get<double>(), 3) + " mm² above</figcaption></figure>\n";
}

std::string number_at(const json& report, const char* pointer, int decimals) {
  const json::json_pointer p(pointer);
  return report.contains(p) && report.at(p).is_number() ? fixed(report.at(p).get<double>(), decimals) : "?";
}

std::string caustic_caption(const json& report, const std::string& where) {
  return "error " + number_at(report, (where + "/l1_error").c_str(), 3) + ", " + number_at(report, (where + "/psnr_db").c_str(), 1) +
         " dB, beside the motif " + fixed(100 * std::strtod(number_at(report, (where + "/flux_outside_support").c_str(), 6).c_str(), nullptr), 1) + " %";
}

std::string verdict_box(const json& report, const RunFolder& folder) {
  if (!report.contains("/dry_run/faults"_json_pointer)) {
    return "<div class=verdict><b>Not dry-run yet.</b> Run <code>lightmill make</code> to the end before anything is milled.</div>\n";
  }
  const int faults = report.at("/dry_run/faults"_json_pointer).get<int>();
  if (faults == 0) {
    return "<div class=\"verdict good\"><b>The dry run found no fault.</b> The simulated machine milled the part from the programs' text alone: "
           "deepest gouge " + number_at(report, "/dry_run/max_gouge_um", 2) + " &micro;m, highest cusp " + number_at(report, "/dry_run/max_cusp_um", 2) +
           " &micro;m. <a href=\"setup_sheet.html\">Setup sheet</a></div>\n";
  }
  (void)folder;
  return "<div class=\"verdict bad\"><b>Do not mill: the dry run found " + std::to_string(faults) + (faults == 1 ? " fault" : " faults") +
         ".</b> They are <a href=\"#faults\">listed below</a>.</div>\n";
}

std::string faults_table(const RunFolder& folder) {
  std::error_code error;
  if (!std::filesystem::exists(folder.file("dry_run/faults.json"), error)) return "";
  const json list = json::parse(read_whole(folder.file("dry_run/faults.json")), nullptr, false);
  if (!list.is_object() || !list.contains("faults")) return "";
  std::string html = "<h2 id=faults>Faults</h2>\n";
  const json& faults = list["faults"];
  if (faults.empty()) return html + "<p>None.</p>\n";
  html += "<table><tr><th>kind</th><th>program</th><th>lines</th><th>what</th><th>where (part, mm)</th></tr>\n";
  constexpr std::size_t kMostRows = 60;
  for (std::size_t i = 0; i < std::min(faults.size(), kMostRows); ++i) {
    const Fault fault = fault_from(faults[i]);
    const Vec3& at = fault.place_mm;
    html += "<tr><td><span class=no>" + escaped(fault.kind) + "</span></td><td>" + escaped(fault.program) + "</td><td>" + lines_in_words(fault) +
            "</td><td>" + escaped(fault.message) + "</td><td class=number>" + fixed(at.x(), 2) + ", " + fixed(at.y(), 2) + ", " + fixed(at.z(), 2) +
            "</td></tr>\n";
  }
  html += "</table>\n<div class=pictures style=\"margin-top:14px\">\n";
  for (const json& f : faults) {
    const Fault fault = fault_from(f);
    if (!fault.picture.empty()) html += picture(folder, fault.picture, heading(fault), fault.message);
  }
  html += "</div>\n";
  if (const int left_out = list.value("/pictures/left_out"_json_pointer, 0); left_out > 0) {
    html += "<p class=soft>" + std::to_string(left_out) + " more faults have no picture: drawn are the first of every kind and then the first in order, " +
            std::to_string(kMostFaultPictures) + " in all.</p>\n";
  }
  if (faults.size() > kMostRows) {
    html += "<p class=soft>" + std::to_string(faults.size() - kMostRows) + " more in <a href=\"dry_run/faults.json\">faults.json</a>.</p>\n";
  }
  return html;
}

/// Where a pass's program is slower than planned, or cannot be kept fed.
void program_warnings(const json& program, const std::string& pass, const std::function<void(const std::string&)>& item) {
  const double slowing = program.value("worst_slowing", 1.0);
  if (program.value("slowed_moves", 0) > 0) {
    const json& at = program.at("worst_slowing_at_mm");
    item(pass + ": feeds are lowered in " + std::to_string(program.at("slowed_moves").get<long>()) +
         " moves, for an axis at its limit or the control's block time; most, by a factor of " + fixed(slowing, 2) + ", at (" +
         fixed(at.at(0), 2) + ", " + fixed(at.at(1), 2) + ", " + fixed(at.at(2), 2) + ") mm.");
  }
  if (const long rewinds = program.value("rewinds", 0L); rewinds > 0) {
    item(pass + ": the tool leaves the cut " + std::to_string(rewinds) + " times because a rotary axis is at its limit.");
  }
  if (program.value("worst_rounding", 1.0) > 1.01) {
    item(pass + ": the control's whole milliseconds make blocks up to " + fixed(program.at("worst_rounding"), 2) +
         " times as long, " + fixed(program.at("rounding_s"), 1) + " s in all; tool-centre-point control has no such loss.");
  }
  const std::string remedy = program.value("/data_rate/remedy"_json_pointer, "");
  if (!remedy.empty()) item(pass + ": " + remedy + ".");
}

std::string warnings_box(const Job& job, const json& report) {
  std::string items;
  const auto item = [&](const std::string& text) { items += "<li>" + escaped(text) + "</li>\n"; };
  if (report.contains("/postproc/setup/machine_notes"_json_pointer)) {
    const std::string notes = report.at("/postproc/setup/machine_notes"_json_pointer);
    if (!notes.empty()) item("Machine \"" + report.at("/postproc/setup/machine"_json_pointer).get<std::string>() + "\": " + notes);
  }
  if (report.contains("/design/target/warnings"_json_pointer)) {
    for (const auto& w : report.at("/design/target/warnings"_json_pointer)) item("Drawing: " + w.get<std::string>());
  }
  if (report.contains("/design/source/warnings"_json_pointer)) {
    for (const auto& w : report.at("/design/source/warnings"_json_pointer)) item("Source light: " + w.get<std::string>() + ".");
  }
  if (report.contains("/design/caustic/warnings"_json_pointer)) {
    for (const auto& w : report.at("/design/caustic/warnings"_json_pointer)) item("Light: " + w.get<std::string>() + ".");
  }
  if (report.contains("/design/transport/converged"_json_pointer) && !report.at("/design/transport/converged"_json_pointer).get<bool>()) {
    item("The light transport did not reach its tolerance: " + report.at("/design/transport"_json_pointer).value("reason", ""));
  }
  if (report.contains("/cam/blank/roughed"_json_pointer) && !report.at("/cam/blank/roughed"_json_pointer).get<bool>()) {
    item("Nothing to rough: the blank stands no higher over the lens than roughing would leave it. That pass is left out.");
  }
  if (report.contains("/cam/reachable/unreachable_area_mm2"_json_pointer) &&
      report.at("/cam/reachable/unreachable_area_mm2"_json_pointer).get<double>() > 0) {
    item("The finishing ball cannot reach " + number_at(report, "/cam/reachable/unreachable_area_mm2", 1) + " mm² (" +
         fixed(100 * report.at("/cam/reachable/unreachable_share"_json_pointer).get<double>(), 2) + " % of the lens; creases that are hollower than the ball); up to " +
         number_at(report, "/cam/reachable/max_residue_um", 1) + " µm of material stay there; the picture \"Out of the ball's reach\" shows where.");
  }
  for (const char* pass : kPassNames) {
    const json::json_pointer contact(std::string("/cam/") + pass + "/contact");
    if (report.contains(contact) && report.at(contact).at("least_angle_deg") < kLeastContactDeg - 0.05) {
      item(std::string(pass) + ": the ball touches down to " + fixed(report.at(contact).at("least_angle_deg"), 1) + " degrees from its axis, where the edge hardly moves (" +
           fixed(report.at(contact).at("slowest_m_per_min"), 0) + " m/min) and rubs; axis = \"fixed\" or \"lead_tilt\" keep " + compact(kLeastContactDeg, 3) + " degrees.");
    }
    const json::json_pointer at(std::string("/postproc/") + pass);
    if (report.contains(at)) program_warnings(report.at(at), pass, item);
    const std::string slow = report.value(json::json_pointer(std::string("/dry_run/") + pass + "/note"), "");
    if (!slow.empty()) item(std::string(pass) + ": " + slow + ".");
  }
  if (const std::string by_hand = mount_words(job.mount); !by_hand.empty()) item("Not milled by the programs, to be made beside them: " + by_hand + ".");
  item("Cutting data comes from tables and arithmetic and is untested on the machine.");
  return "<h2>Before you mill</h2>\n<div class=warn><ul>\n" + items + "</ul></div>\n";
}

}  // namespace

std::string report_page(const Job& job, const RunFolder& folder) {
  const json report = folder.report();
  const double polish_um = job.dry_run.polish_sigma_um;

  std::string html = "<h1>" + escaped(job.name) + "</h1>\n<p class=soft>Lens " + compact(job.lens.size_mm.x(), 2) + " &times; " +
          compact(job.lens.size_mm.y(), 2) + " mm, index " + compact(job.lens.refractive_index, 4) + ", picture " +
          compact(job.target.size_mm.x(), 2) + " &times; " + compact(job.target.size_mm.y(), 2) + " mm on a wall at " +
          compact(job.receiver.distance_mm, 2) + " mm, read from " + (job.receiver.viewed_from == ViewedFrom::kLens ? "the lens's side" : "behind the screen") +
          ". Lightmill " LIGHTMILL_VERSION ". Job: <a href=\"job.toml\">job.toml</a>, all figures: <a href=\"report.json\">report.json</a>.</p>\n";
  html += verdict_box(report, folder);

  html += "<h2>Light on the wall</h2>\n<div class=pictures>\n";
  html += picture(folder, "design/target_view.png", "Target", "what was asked for", true);
  html += picture(folder, "design/caustic.png", "Designed surface", caustic_caption(report, "/design/caustic"), true);
  html += picture(folder, "dry_run/caustic_machined.png", "Milled and polished", caustic_caption(report, "/dry_run/caustic/polished"), true);
  html += picture(folder, "dry_run/caustic_machined_raw.png", "Raw from the mill", caustic_caption(report, "/dry_run/caustic/raw"), true);
  html += "</div>\n<p class=soft>All four pictures share one brightness scale. The two on the right come from the surface that the simulated machine "
          "milled, rebuilt from nothing but the programs' text. Polish is a model, not a measurement: a Gaussian low-pass of the milled heights with a "
          "standard deviation of " + compact(polish_um, 1) + " &micro;m. Raw cusps scatter light by several millimetres, so polishing is part of the optics.</p>\n";

  if (const std::string pair = picture(folder, "design/exposures.png", "Half a second and two seconds",
                                       "designed surface, one irradiance with gains 1 and 4, clipped at white", true);
      !pair.empty()) {
    html += "<div class=pictures style=\"margin-top:14px\">\n" + pair +
            picture(folder, "design/caustic_colour.png", "Through the colour mask", "designed surface, the mask printed and on the flat back", true) + "</div>\n";
  }

  html += "<h2>How the light is sorted</h2>\n<div class=pictures>\n";
  html += picture(folder, "design/checkerboard.png", "Checkerboard through the lens",
                  "a board of 20 squares on the wall, seen through the lens; blue: beside the picture");
  html += picture(folder, "design/cells.png", "Power diagram",
                  "each cell receives the same light; the solver's finest level of at most 20,000 samples, so that cells can be seen");
  html += "</div>\n<div class=pictures style=\"margin-top:14px\">\n";
  html += picture(folder, "design/samples.png", "Samples on their way", "regularly placed on the lens (left), a third and two thirds of the way, and in the picture (right)");
  html += "</div>\n";

  html += "<h2>The part</h2>\n<div class=pictures>\n";
  html += picture(folder, "design/heights.png", "Height", "lens seen from above, mm over the flat back");
  html += picture(folder, "design/curvature.png", "Curvature", "mean curvature, red: bulges, blue: hollow; lines are creases");
  html += picture(folder, "design/color_mask.png", "Colour mask", "film for the flat back, 300 dots per inch; design/color_mask.svg is the page in mm");
  const std::string range = number_at(report, "/dry_run/deviation_picture_range_um", 1);
  html += picture(folder, "dry_run/deviation.png", "Milled minus designed",
                  "red: material left, blue: material missing; full colour at " + range + " µm; strongest value per pixel");
  html += deviation_histogram(report);
  html += picture(folder, "cam/fit_height.png", "Spline minus mesh", "height at the vertices; the lines are creases, which a smooth surface rounds");
  html += picture(folder, "cam/fit_normal.png", "Spline against mesh, normals", "angle at the vertices, which the light sees");
  html += picture(folder, "cam/caustic_reachable.png", "Light through what the ball reaches", caustic_caption(report, "/cam/reachable/caustic"), true);
  html += picture(folder, "cam/unreachable.png", "Out of the ball's reach", "what an ideal finishing ball leaves standing");
  html += picture(folder, "cam/unreachable_normals.png", "Normals out of the ball's reach", "by how much they are off there, which the light sees");
  html += picture(folder, "cam/hollows.png", "Hollows against the ball", "curvature across the hollows: full red is the ball's own radius or a smaller one, blue bulges every way");
  html += "</div>\n";
  if (report.contains("/cam/machinability"_json_pointer)) {
    const json& cam = report.at("cam");
    html += "<h2>Machinability</h2>\n<p class=soft>Slopes against the axis, the blank, hollows against the finishing ball and what it leaves there; the longest ten hollow "
            "creases: where they run on the lens, and where the light of their fillets lands on the wall (mm). The same as <code>lightmill check</code>.</p>\n<pre>" +
            escaped(machinability_text(cam.at("machinability"), cam.at("creases"), cam)) + "</pre>\n";
  }
  html += "<h2>Tool paths</h2>\n<div class=pictures>\n";
  for (const char* pass : kPassNames) {
    const std::string at = std::string("/cam/") + pass;
    html += picture(folder, std::string("cam/toolpaths_") + pass + ".png",
                    pass == std::string("rough") ? "Rough" : pass == std::string("semi_finish") ? "Semi-finish" : pass == std::string("finish") ? "Finish" : pass == std::string("rest") ? "Rest along creases" : "Cut out",
                    number_at(report, (at + "/minutes").c_str(), 1) + " min, " + fixed(std::strtod(number_at(report, (at + "/length_mm").c_str(), 1).c_str(), nullptr) / 1000, 1) +
                        " m, stepover " + number_at(report, (at + "/stepover_mm").c_str(), 3) + " mm; where passes lie close only some are drawn");
  }
  html += "</div>\n";

  Figures figures(report);
  figures.group("Design");
  figures.row("/design/transport/l1_mass_error", "light that lands in a wrong cell", "", 6, job.transport.l1_tolerance);
  figures.row("/design/transport/max_mass_error", "worst cell", "", 4, job.transport.max_tolerance);
  figures.row("/design/transport/empty_cells", "cells without light", "", 0, 0.0);
  figures.row("/design/surface/inverted_triangles", "folded triangles", "", 0, 0.0);
  figures.row("/design/surface/height_range_mm", "relief", "mm", 3);
  figures.row("/design/surface/min_concave_radius_mm", "tightest hollow", "mm", 2);
  figures.row("/design/caustic/l1_error", "picture error of the designed surface", "", 3);
  figures.row("/design/caustic/flux_outside_support", "light beside the motif", "%", 2, {}, 100);
  figures.row("/design/caustic/flux_totally_reflected", "light that never leaves the lens", "%", 3, {}, 100);
  figures.group("Solid and tool paths");
  figures.flag("/cam/solid/valid", "STEP solid", "valid and closed", "not valid");
  figures.row("/cam/solid/rms_deviation_um", "spline from mesh, off creases (rms)", "µm", 3, 0.5);
  figures.row("/cam/solid/max_deviation_um", "spline from mesh, anywhere", "µm", 2);
  figures.row("/cam/solid/crease_width_mm", "width of its creases", "mm", 2);
  figures.row("/cam/solid/volume_mm3", "volume", "mm³", 1);
  figures.row("/cam/blank/height_mm", "blank height", "mm", 1);
  figures.row("/cam/finish/predicted_cusp_um", "cusp that finishing plans", "µm", 2, job.dry_run.cusp_limit_um);
  for (const auto& [pass, name] : {std::pair("semi_finish", "semi-finishing"), std::pair("finish", "finishing")}) {
    const std::string contact = std::string("/cam/") + pass + "/contact/";
    figures.row_at_least(json::json_pointer(contact + "least_angle_deg"), std::string(name) + ": contact from the axis, least", "°", 1, kLeastContactDeg);
    figures.row((contact + "most_angle_deg").c_str(), std::string(name) + ": contact from the axis, most", "°", 1, kMostContactDeg);
  }
  figures.row("/cam/finish/contact/slowest_m_per_min", "finishing: slowest cutting speed", "m/min", 0);
  figures.row("/cam/reachable/unreachable_area_mm2", "out of the ball's reach", "mm²", 2);
  figures.row("/cam/creases/length_mm", "concave creases sharper than the ball", "mm", 0);
  figures.row("/cam/creases/light_lost_share", "light through their fillets", "%", 2, {}, 100);
  figures.row("/cam/creases/rest/highest_before_um", "left in creases by the finishing ball", "µm", 1);
  figures.row("/cam/creases/rest/highest_after_um", "left in creases after the rest pass", "µm", 1);
  figures.row("/cam/rough/conventional_share", "roughing with material on the left alone (not climb milling)", "%", 2, {}, 100);
  figures.row("/cam/rough/both_sides_share", "roughing with material on both sides (slots)", "%", 1, {}, 100);
  figures.row("/cam/finish/contact/climb_share", "finishing with climb milling", "%", 0, {}, 100);
  figures.row("/cam/rough/levels_minutes", "roughing by levels", "min", 1);
  figures.row("/cam/rough/layers_minutes", "roughing by layers over the surface", "min", 1);
  figures.group("Programs");
  for (const char* pass : kPassNames) {
    const std::string at = std::string("/postproc/") + pass;
    figures.row((at + "/blocks").c_str(), std::string(pass) + ": blocks", "", 0);
    figures.row((at + "/max_tip_error_um").c_str(), std::string(pass) + ": tip off its line", "µm", 3, job.controller.tip_tolerance_um);
    figures.row((at + "/max_axis_speed_ratio").c_str(), std::string(pass) + ": fastest axis over its limit", "", 3, 1.0);
  }
  figures.group("Dry run");
  figures.row("/dry_run/max_gouge_um", "deepest gouge", "µm", 2, job.dry_run.gouge_tolerance_um);
  figures.row("/dry_run/gouged_area_mm2", "area gouged deeper than that limit", "mm²", 3, 0.0);
  figures.row("/dry_run/max_cusp_um", "highest cusp where the ball reaches, along the normal", "µm", 2, job.dry_run.cusp_limit_um);
  figures.row("/dry_run/p99_cusp_um", "99 % of cusps are below", "µm", 2);
  figures.row("/dry_run/cusp_blur_mm", "blur that the planned cusps leave after the polish (model)", "mm", 3);
  figures.row("/dry_run/residue_um", "material left where it does not reach", "µm", 1);
  figures.row("/dry_run/limit_violations", "axis limits passed", "", 0, 0.0);
  figures.row("/dry_run/collisions", "collisions and rapids through stock", "", 0, 0.0);
  figures.row("/dry_run/link/bytes_lost", "bytes lost on the line", "", 0, 0.0);
  figures.row("/dry_run/link/starvations", "standstills in the cut because no line came", "", 0, 0.0);
  figures.flag("/dry_run/link/digest_matches", "the machine executed every line, once, in order", "yes", "no");
  const double wall_limit = job.dry_run.wall_tolerance_um;
  figures.row("/dry_run/cut_out/walls/max_gouge_um", "part's wall: deepest inside its outline", "µm", 1, wall_limit);
  figures.row("/dry_run/cut_out/walls/max_left_um", "part's wall: most left outside it", "µm", 1, wall_limit);
  figures.row("/dry_run/cut_out/land_walls/max_gouge_um", "wall over the land: deepest inside its outline", "µm", 1, wall_limit);
  figures.row("/dry_run/cut_out/land_walls/max_left_um", "wall over the land: most left outside it", "µm", 1, wall_limit);
  figures.flag("/dry_run/cut_out/held", "tabs or skin hold the part in its blank", "yes", "no");
  figures.row("/dry_run/minutes", "time on the machine, accelerations and dwells included", "min", 1);
  for (const char* pass : kPassNames) {
    const std::string at = std::string("/dry_run/") + pass;
    figures.row((at + "/minutes").c_str(), std::string(pass) + ": time on the machine", "min", 1);
    figures.row((at + "/mean_feed_mm_per_min").c_str(), std::string(pass) + ": mean feed reached at the tip", "mm/min", 0);
  }
  figures.row("/dry_run/caustic/polished/l1_error", "picture error, polished (model)", "", 3);
  figures.row("/dry_run/caustic/raw/l1_error", "picture error, raw", "", 3);
  figures.row("/dry_run/polish_removal_um", "depth that the polish takes away, at least (model)", "µm", 2);
  figures.row("/dry_run/diffraction/raw/order_spacing_mm", "the cusps' diffraction orders stand apart on the wall by", "mm", 2);
  figures.row("/dry_run/diffraction/raw/orders/0/share", "light that the raw cusps leave in place (order 0)", "%", 1, {}, 100);
  figures.row("/dry_run/diffraction/polished/orders/0/share", "the same after the polish (model)", "%", 1, {}, 100);
  html += "<h2>Figures</h2>\n" + figures.table();
  html += warnings_box(job, report);
  html += faults_table(folder);
  html += "<h2>How far to trust this</h2>\n<ul>\n"
          "<li>Gouge and cusp are measured against what an ideal ball can reach; the rest is listed as out of reach.</li>\n"
          "<li>Polish: Gaussian low-pass of the heights, " + compact(polish_um, 1) + " &micro;m. A hand polish is not that even; the picture is a hope with a number.</li>\n"
          "<li>The simulated machine is rigid and exact: no run-out, wear, heat, backlash or chatter.</li>\n"
          "<li>Light is traced as rays through back and surface" +
          std::string(job.light.fresnel ? ", less what both faces reflect (design only)" : "") +
          (job.light.angular_diameter_rad > 0 ? ", the lamp as a disk of " + compact(job.light.angular_diameter_rad * 180 / kPi, 3) + " degrees" : std::string(", the lamp as a point at infinity")) +
          "; no diffraction, no reflections inside the lens.</li>\n</ul>\n";
  return html_page(job.name + " - Lightmill report", html);
}

std::string gallery_page(const std::vector<std::filesystem::path>& folders, const std::filesystem::path& page) {
  namespace fs = std::filesystem;
  struct Wanted {
    const char* file;
    const char* title;
    bool light;
  };
  static constexpr Wanted kWanted[] = {{"design/target_view.png", "Target", true},
                                       {"design/caustic.png", "Light through the surface", true},
                                       {"cam/caustic_reachable.png", "Light through what the finishing ball reaches", true},
                                       {"design/exposures.png", "Half a second, two seconds", true},
                                       {"design/caustic_colour.png", "Through the colour mask", true},
                                       {"design/curvature.png", "Curvature", false},
                                       {"design/checkerboard.png", "Checkerboard through the lens", false},
                                       {"design/color_mask.png", "Colour mask", false},
                                       {"design/cells.png", "Power diagram, at most 20,000 samples", false},
                                       {"design/samples.png", "Samples on their way", false},
                                       {"design/heights.png", "Height", false}};
  std::string html = "<h1>Gallery</h1>\n";
  const fs::path here = fs::absolute(page).parent_path();
  for (const fs::path& root : folders) {
    const RunFolder folder(root, false);
    const json report = folder.report();
    if (!report.contains("/design/caustic"_json_pointer)) {
      throw InputError(root.string() + " has no design yet; run: lightmill make JOB -o " + root.string() + " --until design");
    }
    const Job job = read_job(folder.needed("job.toml", "make"));
    const std::string link = fs::relative(fs::absolute(root), here).generic_string();
    html += "<h2><a href=\"" + escaped(link) + "/report.html\">" + escaped(job.name) + "</a></h2>\n<p class=soft>" +
            number_at(report, "/design/transport/samples", 0) + " samples in " + number_at(report, "/design/transport/seconds", 0) + " s, " +
            number_at(report, "/design/surface/vertices", 0) + " vertices in " + number_at(report, "/design/surface/seconds", 0) + " s; " +
            compact(job.lens.size_mm.x(), 1) + " x " + compact(job.lens.size_mm.y(), 1) + " mm at " + compact(job.receiver.distance_mm, 1) + " mm; " +
            caustic_caption(report, "/design/caustic") + "</p>\n<div class=pictures>\n";
    for (const Wanted& wanted : kWanted) {
      const std::string file = wanted.file;
      std::error_code error;
      if (!fs::exists(folder.file(file), error)) continue;
      html += "<figure" + std::string(wanted.light ? " class=light" : "") + "><a href=\"" + escaped(link + "/" + file) + "\"><img src=\"" +
              escaped(link + "/" + file) + "\" alt=\"\"></a><figcaption>" + wanted.title + "</figcaption></figure>\n";
    }
    html += "</div>\n";
  }
  return html_page("Lightmill gallery", html);
}

}  // namespace lightmill

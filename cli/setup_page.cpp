#include <algorithm>
#include <nlohmann/json.hpp>

#include "cli/pages.h"
#include "cli/stage_runs.h"
#include "design/core/markup.h"
#include "design/core/text.h"
#include "postproc/kinematics.h"

namespace lightmill {

using nlohmann::json;

namespace {

constexpr const char* kStyle = R"(
@page { size: A4; margin: 14mm; }
* { box-sizing: border-box; }
body { font: 13.5px/1.45 "Segoe UI", "Helvetica Neue", "DejaVu Sans", Arial, sans-serif; color: #111; background: #fff; max-width: 190mm; margin: 0 auto; padding: 16px; }
header { display: flex; justify-content: space-between; align-items: flex-end; border-bottom: 3px solid #111; padding-bottom: 8px; }
h1 { font-size: 24px; margin: 0; } h2 { font-size: 16px; margin: 20px 0 6px; border-bottom: 1px solid #999; }
table { border-collapse: collapse; width: 100%; } th, td { border: 1px solid #999; padding: 5px 8px; text-align: left; vertical-align: top; }
th { background: #eee; font-weight: 600; } td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.big { font-size: 19px; font-weight: 700; } .note { color: #444; font-size: 12.5px; }
.warn { border: 2px solid #b3261e; padding: 8px 12px; margin: 14px 0 0; font-weight: 600; }
.fine { border: 2px solid #1d7a46; padding: 8px 12px; margin: 14px 0 0; }
ol.check { list-style: none; padding: 0; margin: 6px 0; } ol.check li { padding: 5px 0 5px 30px; position: relative; border-bottom: 1px dotted #bbb; }
ol.check li::before { content: ""; position: absolute; left: 4px; top: 7px; width: 14px; height: 14px; border: 1.5px solid #111; }
code { font: 12px "DejaVu Sans Mono", Consolas, monospace; }
.two { display: grid; grid-template-columns: 1fr 1fr; gap: 14px; }
tr, li { break-inside: avoid; }
)";

std::string row(const std::string& what, const std::string& value) { return "<tr><th>" + what + "</th><td>" + value + "</td></tr>\n"; }

std::string holding_text(const std::string& kind) {
  if (kind == "vise") return "vise, its jaws along the sides at -Y and +Y; nothing higher than stated below";
  if (kind == "clamps") return "clamps where stated below";
  return "flat back on a vacuum plate or double-sided tape; all four sides and the top free";
}

}  // namespace

std::string setup_page(const Job& job, const RunFolder& folder) {
  const json report = folder.report();
  const MachineModel machine = read_machine(job.machine.file);
  const WorkSetup setup = work_on_table(machine, job.machine.workpiece_origin_mm, job.machine.work_offset);
  const std::string offset = "G" + std::to_string(setup.work_offset);
  const double height = report.contains("/cam/blank/height_mm"_json_pointer) ? report.at("/cam/blank/height_mm"_json_pointer).get<double>() : 0;
  const Vec2 blank = blank_size_mm(job);
  const std::string size = compact(blank.x(), 3) + " &times; " + compact(blank.y(), 3) + " &times; " + fixed(height, 1) + " mm";

  std::string html = "<!doctype html>\n<html lang=en><head><meta charset=utf-8><title>" + escaped(job.name) +
                     " - setup sheet</title>\n<style>" + kStyle + "</style></head><body>\n<header><div><h1>Setup sheet: " + escaped(job.name) +
                     "</h1>" + escaped(machine.name) + "</div><div class=note>job " + making_digest(job).substr(0, 16) + "<br>Lightmill " LIGHTMILL_VERSION "</div></header>\n";
  const bool dry = report.contains("/dry_run/faults"_json_pointer);
  const int faults = dry ? report.at("/dry_run/faults"_json_pointer).get<int>() : 0;
  if (!dry) {
    html += "<p class=warn>These programs have not been dry-run. Do not mill.</p>\n";
  } else if (faults > 0) {
    html += "<p class=warn>The dry run found " + std::to_string(faults) + " fault(s). Do not mill. See report.html.</p>\n";
  } else {
    html += "<p class=fine>The dry run of exactly these programs found no fault.</p>\n";
  }
  if (!machine.notes.empty()) html += "<p class=warn>Machine data: " + escaped(machine.notes) + "</p>\n";

  std::string clamps;
  for (const KeepOut& box : keep_outs_of(job)) {
    const auto range = [&](int axis, const char* letter) { return std::string(letter) + " " + compact(box.min_mm[axis], 2) + " to " + compact(box.max_mm[axis], 2); };
    clamps += (clamps.empty() ? "" : "<br>") + range(0, "X") + ", " + range(1, "Y") + ", " + range(2, "Z");
  }
  html += "<div class=two><div><h2>Blank</h2>\n<table>\n" + row("size", "<span class=big>" + size + "</span>") + row("material", escaped(job.stock.material)) +
          row("work holding", holding_text(job.stock.work_holding)) +
          (clamps.empty() ? std::string() : row("clamps and jaws within (mm from the zero point)", clamps)) +
          row("stands", "flat back down; X along the " + compact(blank.x(), 3) + " mm side") + "</table></div>\n";
  html += "<div><h2>Zero point " + offset + "</h2>\n<table>\n" + row("where", "centre of the blank's <b>underside</b>") +
          row("X", "<span class=big>" + fixed(setup.origin_mm.x(), 3) + "</span> mm machine") +
          row("Y", "<span class=big>" + fixed(setup.origin_mm.y(), 3) + "</span> mm machine") +
          row("Z", "<span class=big>" + fixed(setup.origin_mm.z(), 3) + "</span> mm machine (spindle nose without tool)") +
          row(std::string(1, machine.outer.letter) + ", " + std::string(1, machine.inner.letter), "0 deg, 0 deg") +
          row("from table centre", compact(job.machine.workpiece_origin_mm.x(), 3) + ", " + compact(job.machine.workpiece_origin_mm.y(), 3) + ", " +
                                       compact(job.machine.workpiece_origin_mm.z(), 3) + " mm") + "</table></div></div>\n";
  html += "<p class=note>The programs hold the kinematics of this very place (the controller has no tool-centre control): with the blank anywhere else they "
          "must be posted again with <code>[machine] workpiece_origin_mm</code>. Probe the blank, enter the numbers above into " + offset +
          ", and compare them with what you measured; more than 0.02 mm off: post again.</p>\n";

  html += "<h2>Tools</h2>\n<table><tr><th>T</th><th>cutter</th><th>pass</th><th>gauge length</th><th>sticks out</th><th>holder up to</th><th>spindle</th><th>feed</th><th>air</th></tr>\n";
  const auto tool = [&](const Cutter& cutter, const char* pass) {
    double widest = 0;
    for (const auto& piece : cutter.holder) widest = std::max({widest, piece.from_radius_mm, piece.to_radius_mm});
    html += "<tr><td class=n><b>" + std::to_string(cutter.number) + "</b></td><td>" + escaped(cutter.name) + "</td><td>" + pass + "</td><td class=n><b>" +
            fixed(cutter.length_mm, 2) + "</b> mm</td><td class=n>" + fixed(cutter.reach_mm(), 1) + " mm</td><td class=n>" +
            (widest > 0 ? "&empty; " + compact(2 * widest, 1) + " mm" : std::string("-")) + "</td><td class=n>" + compact(cutter.spindle_rpm, 0) +
            " rpm</td><td class=n>" + fixed(cutter.feed_mm_per_s() * 60, 0) + " mm/min</td><td>" + escaped(cutter.coolant) + "</td></tr>\n";
  };
  if (report.contains("/cam/rough/minutes"_json_pointer)) tool(job.rough.cutter, "rough");
  tool(job.semi_finish.cutter, "semi-finish");
  tool(job.finish.cutter, "finish");
  if (job.rest) tool(job.rest->cutter, "rest along creases");
  if (is_cut_out(job)) tool(job.rough.cutter, "cut out (profile)");
  html += "</table>\n<p class=note>Gauge length: spindle nose to tip, as entered in the tool table. Cutting data is untested on the machine; start with the feed override low.</p>\n";

  html += "<h2>Programs</h2>\n<table><tr><th>file</th><th>blocks</th><th>planned time</th><th>SHA-256</th></tr>\n";
  double minutes = 0;
  for (const char* pass : kPassNames) {
    const json::json_pointer post(std::string("/postproc/") + pass);
    if (!report.contains(post)) continue;
    const json& p = report.at(post);
    const json::json_pointer time(std::string("/cam/") + pass + "/minutes");
    const double m = report.contains(time) && report.at(time).is_number() ? report.at(time).get<double>() : 0;
    minutes += m;
    const std::string sum = p.value("sha256", "");
    html += "<tr><td><b>" + escaped(p.value("file", "")) + "</b></td><td class=n>" + std::to_string(p.value("blocks", 0L)) + "</td><td class=n>" +
            fixed(m, 1) + " min</td><td><code>" + sum.substr(0, 32) + "<br>" + (sum.size() > 32 ? sum.substr(32) : "") + "</code></td></tr>\n";
  }
  html += "<tr><th colspan=2>all</th><td class=n><b>" + fixed(minutes, 1) + " min</b></td><td class=note>" +
          (dry ? "the simulated machine took " + fixed(report.at("/dry_run"_json_pointer).value("minutes", 0.0), 1) + " min" : std::string()) + "</td></tr></table>\n";

  html += "<h2>Checklist</h2>\n<ol class=check>\n";
  for (const std::string& item :
       {"Blank measured: " + size + ", sides and height 0 to +0.3 mm; underside flat and clean",
        std::string(clamps.empty() ? "Work holding leaves all four sides free down to the table: cutters enter beside the part"
                                   : "Nothing of the work holding stands out of the places above: the paths keep 0.5 mm from them"),
        std::string("Tools in their places of the table above, lengths measured and equal to 0.02 mm; finishing "
                    "run-out below 5 &micro;m"),
        offset + " entered as above; " + std::string(1, machine.outer.letter) + " and " +
            std::string(1, machine.inner.letter) + " homed",
        std::string("Air on; no alcohol-based cleaner near PMMA"),
        std::string("Digest of the files on the controller or sender equals the one above (sha256sum)"),
        std::string("First program above the part in single block, feed override low"),
        std::string("Programs in the order of their numbers") + "; stream with: <code>lightmill stream " + escaped(folder.root().string()) +
            " --port /dev/ttyUSB0</code>",
        std::string("After finishing: polish by hand along the passes, stop as soon as the picture is sharp")}) {
    html += "<li>" + item + "</li>\n";
  }
  if (const std::string by_hand = mount_words(job.mount); !by_hand.empty()) {
    html += "<li>In the solid and the STEP file, but not milled by these programs (and not in the simulated part): " + escaped(by_hand) +
            ". Drill from <code>cam/lens.step</code> before the optical surface is finished, or by hand with the surface covered</li>\n";
  }
  html += "</ol>\n</body></html>\n";
  return html;
}

}  // namespace lightmill

#include "cli/machinability_report.h"

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "cam/machinability.h"
#include "cli/cam_inputs.h"
#include "cli/crease_report.h"
#include "cli/stage_runs.h"
#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

using nlohmann::json;

namespace {

double degrees(double rad) { return rad * 180 / kPi; }

json place_json(const Vec2& p) { return {p.x(), p.y()}; }

json window_json(const ContactWindow& window, const FinishOptions& options, double lens_mm2) {
  json result = {{"axis", axis_name(options.axis)},
                 {"window_deg", {degrees(kLeastContactAngle), degrees(kMostContactAngle)}},
                 {"asked_tilt_deg", degrees(options.tilt_rad)},
                 {"asked_direction_deg", degrees(options.tilt_direction_rad)},
                 {"contact_deg", {degrees(window.least_rad), degrees(window.most_rad)}},
                 {"outside_mm2", window.outside_share * lens_mm2},
                 {"outside_share", window.outside_share},
                 {"worst_deg", degrees(window.worst_rad)},
                 {"worst_at_mm", place_json(window.worst_mm)},
                 {"refused", !window.refusal.empty()}};
  if (window.tilt_rad) result["planned_tilt_deg"] = degrees(*window.tilt_rad);
  if (window.direction_rad) result["planned_direction_deg"] = degrees(*window.direction_rad);
  return result;
}

json leftover_json(const Leftover& left) {
  return {{"area_mm2", left.area_mm2}, {"highest_um", left.highest_um}, {"rms_um", left.rms_um}, {"most_mrad", left.most_mrad}, {"rms_mrad", left.rms_mrad}};
}

/// What smaller balls would change: along creases only (a rest pass), or everywhere at the price of a closer stepover.
json smaller_balls_json(const SplineSurface& surface, const Outline& outline, double ball_mm, double pitch_mm) {
  json list = json::array();
  for (const double share : {0.5, 0.25}) {
    const ReachableSurface rest = within(reachable_surface(surface, share * ball_mm, pitch_mm), outline);
    double in_fillets_mm2 = 0;
    for (const Crease& crease : concave_creases(surface, rest)) in_fillets_mm2 += crease.area_mm2;
    list.push_back({{"ball_radius_mm", share * ball_mm},
                    {"area_mm2", rest.unreachable_area_mm2},
                    {"share", rest.unreachable_area_mm2 / outline.area_mm2()},
                    {"highest_um", rest.max_residue_um},
                    {"light_lost_share", in_fillets_mm2 / outline.area_mm2()},
                    {"times_the_path", 1 / std::sqrt(share)}});
  }
  return list;
}

std::string place(const json& p) { return "x " + fixed(p.at(0), 1) + " y " + fixed(p.at(1), 1); }

std::string percent(const json& share) { return fixed(100 * share.get<double>(), 2) + " %"; }

/// A line of its own, the name in a column of 18.
std::string line(std::string name, const std::string& what) {
  name.resize(std::max<std::size_t>(name.size() + 1, 18), ' ');
  return name + what + "\n";
}

/// Of the axis, "asked" or "planned".
std::string lean_text(const json& window, const std::string& which) {
  return fixed(window.at(which + "_tilt_deg"), 1) + (window.at("axis") == "fixed" ? " deg towards " : " deg off the normal towards ") +
         fixed(window.at(which + "_direction_deg"), 0) + " deg";
}

bool gives_way(const json& window) {
  if (window.at("refused") || !window.contains("planned_tilt_deg") || !window.contains("planned_direction_deg")) return false;
  return window.at("planned_tilt_deg") != window.at("asked_tilt_deg") || window.at("planned_direction_deg") != window.at("asked_direction_deg");
}

std::string window_text(const json& w) {
  const std::string axis = w.at("axis");
  const std::string window = fixed(w.at("window_deg")[0], 0) + " to " + fixed(w.at("window_deg")[1], 0) + " deg";
  const bool all_within = w.at("outside_mm2") == 0;
  std::string text = (axis == "vertical" ? "upright" : lean_text(w, "asked")) + ": contact " + fixed(w.at("contact_deg")[0], 1) + " to " + fixed(w.at("contact_deg")[1], 1) +
                     " deg from the axis, ";
  text += all_within ? "all within " + window
                     : fixed(w.at("outside_mm2"), 1) + " mm2 (" + percent(w.at("outside_share")) + ") outside " + window + ", worst " + fixed(w.at("worst_deg"), 1) +
                           " deg at " + place(w.at("worst_at_mm"));
  if (w.at("refused")) return text + "; no axis of this kind will do";
  if (axis == "vertical") return text + (all_within ? "" : "; milled so as asked, the ball's centre rubs where it is level");
  return text + (gives_way(w) ? "; " + lean_text(w, "planned") + " will do" : "");
}

std::string leftover_text(const json& left) {
  if (left.at("area_mm2") == 0) return "nothing";
  return fixed(left.at("area_mm2"), 2) + " mm2, heights up to " + fixed(left.at("highest_um"), 1) + " um (rms " + fixed(left.at("rms_um"), 1) +
         "), normals up to " + fixed(left.at("most_mrad"), 0) + " mrad off (rms " + fixed(left.at("rms_mrad"), 0) + ")";
}

std::string pass_text(const json& p) {
  std::string text = fixed(p.at("minutes"), 1) + " min, " + fixed(p.at("length_mm").get<double>() / 1000, 1) + " m of path, " +
                     fixed(p.at("cutting_length_mm").get<double>() / 1000, 1) + " m of it cutting (what wears the edge)";
  if (!p.contains("contact")) return text;
  const json& c = p.at("contact");
  return text + "; contact " + fixed(c.at("least_angle_deg"), 1) + " to " + fixed(c.at("most_angle_deg"), 1) + " deg from the axis, " +
         fixed(c.at("slowest_m_per_min"), 0) + " to " + fixed(c.at("fastest_m_per_min"), 0) + " m/min";
}

}  // namespace

json machinability_json(const Job& job, const SplineSurface& surface, const Outline& outline, const ReachableSurface& reachable) {
  const OutlineRegion lens(outline, 0);
  const double pitch = reachable.pitch_mm;
  const double ball = job.finish.cutter.radius_mm();
  const double lens_mm2 = outline.area_mm2();
  const SurfaceScan scan = scan_surface(surface, lens, ball, pitch);
  json result = {{"lowest_mm", surface.lowest()},
                 {"highest_mm", surface.highest()},
                 {"steepest_deg", degrees(scan.steepest_rad)},
                 {"steepest_at_mm", place_json(scan.steepest_mm)},
                 {"ball_radius_mm", ball},
                 {"sharper_hollows_mm2", scan.sharper_mm2},
                 {"sharper_hollows_share", scan.sharper_mm2 / lens_mm2}};
  if (scan.most_concave_per_mm > 0) result.update({{"tightest_hollow_mm", 1 / scan.most_concave_per_mm}, {"tightest_hollow_at_mm", place_json(scan.concave_mm)}});

  json refusals = json::array();
  const auto unless_refused = [&](const std::function<void()>& planned) {
    try {
      planned();
    } catch (const InputError& e) {
      refusals.push_back(e.what());
    }
  };
  result["stock"] = {{"least_mm", least_blank_mm(surface)}, {"enough", false}};
  if (job.stock.height_mm) result["stock"]["height_mm"] = *job.stock.height_mm;
  unless_refused([&] {
    const Blank blank = blank_of(job, surface);
    result["stock"]["height_mm"] = blank.height_mm;
    result["stock"]["enough"] = true;
    if (is_cut_out(job)) plan_profile(surface, blank, outline, job.rough.cutter, profile_options(job, surface, outline));
  });

  std::vector<const BallPass*> passes = {&job.semi_finish, &job.finish};
  if (job.rest) passes.push_back(&*job.rest);
  for (const BallPass* pass : passes) {
    FinishOptions options = pass->options;
    options.outline = finishing_border(job, outline);
    const ContactWindow window = contact_window(surface, options, lens, pitch);
    result["axes"][options.pass] = window_json(window, options, lens_mm2);
    if (!window.refusal.empty()) refusals.push_back(window.refusal);
  }

  const Leftovers left = leftovers(reachable, concave_creases(surface, reachable));
  result["out_of_reach"] = {{"area_mm2", reachable.unreachable_area_mm2},
                            {"share", reachable.unreachable_area_mm2 / lens_mm2},
                            {"highest_um", reachable.max_residue_um},
                            {"in_creases", leftover_json(left.in_creases)},
                            {"elsewhere", leftover_json(left.elsewhere)}};
  result["smaller_balls"] = reachable.unreachable_area_mm2 > 0 ? smaller_balls_json(surface, outline, ball, pitch) : json::array();
  result["refusals"] = refusals;
  return result;
}

std::vector<std::string> changed_axes(const json& m) {
  std::vector<std::string> changes;
  for (const char* pass : kPassNames) {
    if (!m.at("axes").contains(pass)) continue;
    const json& window = m.at("axes").at(pass);
    if (!gives_way(window)) continue;
    changes.push_back(std::string(pass) + " leans " + lean_text(window, "planned") + ", not " + lean_text(window, "asked") +
                      " as asked: the ball would cut outside " + fixed(window.at("window_deg")[0], 0) + " to " + fixed(window.at("window_deg")[1], 0) +
                      " deg from its axis");
  }
  return changes;
}

std::string machinability_text(const json& m, const json& creases, const json& cam) {
  std::string text = line("height", fixed(m.at("lowest_mm"), 3) + " to " + fixed(m.at("highest_mm"), 3) + " mm");
  const json& stock = m.at("stock");
  text += line("blank", fixed(stock.at("height_mm"), 2) + " mm high, the lens needs " + fixed(stock.at("least_mm"), 1) +
                            " mm: " + (stock.at("enough") ? "enough" : "too low"));
  text += line("steepest slope", fixed(m.at("steepest_deg"), 1) + " deg at " + place(m.at("steepest_at_mm")));
  for (const char* pass : kPassNames) {
    if (m.at("axes").contains(pass)) text += line("axis, " + std::string(pass), window_text(m.at("axes").at(pass)));
  }
  if (!m.contains("tightest_hollow_mm")) {
    text += line("tightest hollow", "none, the surface is convex");
  } else {
    text += line("tightest hollow", "radius " + fixed(m.at("tightest_hollow_mm"), 2) + " mm at " + place(m.at("tightest_hollow_at_mm")) + " (finishing ball: " +
                                        compact(m.at("ball_radius_mm").get<double>(), 3) + " mm)");
    text += line("sharper hollows", fixed(m.at("sharper_hollows_mm2"), 1) + " mm2 (" + percent(m.at("sharper_hollows_share")) + ") with a radius below the ball's");
  }
  const json& left = m.at("out_of_reach");
  text += line("out of reach", fixed(left.at("area_mm2"), 1) + " mm2 (" + percent(left.at("share")) + "), at most " + fixed(left.at("highest_um"), 1) + " um left there");
  text += line("  in creases", leftover_text(left.at("in_creases")));
  text += line("  elsewhere", leftover_text(left.at("elsewhere")));
  text += creases_text(creases);
  for (const json& small : m.at("smaller_balls")) {
    text += line("a ball of " + compact(small.at("ball_radius_mm").get<double>(), 3) + " mm",
                 "would leave " + fixed(small.at("area_mm2"), 1) + " mm2 (" + percent(small.at("share")) + ") out of reach, at most " + fixed(small.at("highest_um"), 1) +
                     " um, and " + percent(small.at("light_lost_share")) + " of the light in fillets; finishing all with it: " + fixed(small.at("times_the_path"), 1) +
                     " times the path");
  }
  for (const char* pass : kPassNames) {
    if (cam.contains(pass) && cam.at(pass).contains("minutes")) text += line(pass, pass_text(cam.at(pass)));
  }
  for (const json& refusal : m.at("refusals")) text += line("cannot be milled", refusal.get<std::string>());
  return text;
}

}  // namespace lightmill

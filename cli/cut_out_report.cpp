#include "cli/cut_out_report.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>

#include "cli/cam_inputs.h"
#include "cli/job_light.h"
#include "design/core/text.h"
#include "machine/cut_out.h"

namespace lightmill {

using nlohmann::json;

namespace {

/// Material that is thinner holds nothing.
constexpr double kHolds_mm = 0.01;
/// Of its height a tab may lack this share.
constexpr double kTabLacks = 0.1;
/// Smaller pieces are chips.
constexpr double kPiece_mm3 = 1;

json to_json(const WallDeviation& walls) {
  return {{"max_left_um", walls.max_left_um}, {"max_gouge_um", walls.max_gouge_um}, {"rms_um", walls.rms_um}, {"places", walls.places}};
}

Fault fault_at(const std::string& kind, const std::string& message, const Vec3& place, double amount_mm) {
  Fault fault;
  fault.kind = kind;
  fault.message = message;
  fault.place_mm = place;
  fault.amount_mm = amount_mm;
  fault.picture = "dry_run/tabs.png";
  return fault;
}

void judge(const WallDeviation& walls, const std::string& which, double tolerance_um, std::vector<Fault>& faults) {
  const auto judge_side = [&](double um, const Vec3& place, const char* how) {
    if (um <= tolerance_um) return;
    faults.push_back(fault_at("wall", which + " is " + fixed(um, 1) + " um " + how + " at x " + fixed(place.x(), 2) + ", y " + fixed(place.y(), 2) +
                                          ", z " + fixed(place.z(), 2) + " mm; " + compact(tolerance_um, 3) + " um are allowed (dry_run.wall_tolerance_um)",
                              place, um / 1000));
  };
  judge_side(walls.max_gouge_um, walls.gouge_place_mm, "inside its outline");
  judge_side(walls.max_left_um, walls.left_place_mm, "outside its outline");
}

}  // namespace

json cut_out_report(const Job& job, const SplineSurface& surface, const SolidStock& solid, std::vector<Fault>& faults) {
  const Outline optical = outline_of(scene_of(job).lens);
  const Outline part = with_land(optical, job.land.width_mm);
  const ProfileOptions profile = profile_options(job, surface, optical);
  const Cutter& mill = job.rough.cutter;
  const double rim = border_heights(surface, optical).lowest_mm;
  const double land = rim - job.land.drop_mm;
  const double pitch = solid.pitch_mm().maxCoeff();

  // Above the mill's corner where it runs over the tabs.
  const double foot = std::max(profile.skin_mm, profile.tabs > 0 ? profile.tab_height_mm : 0.0) + mill.corner_radius_mm + pitch;
  const WallDeviation walls = measure_walls(solid, part, foot, (job.land.width_mm > 0 ? land : rim) - pitch);
  judge(walls, "the part's wall", job.dry_run.wall_tolerance_um, faults);
  json report = {{"pitch_um", pitch * 1000},
                 {"megabytes", static_cast<double>(solid.bytes()) / 1e6},
                 {"volume_mm3", solid.volume_mm3()}};
  // A wall that is lower than the mill's corner has no upright part to look at.
  if (walls.places > 0) report["walls"] = to_json(walls);
  if (job.land.width_mm > 0) {
    const WallDeviation inner = measure_walls(solid, optical, land + mill.corner_radius_mm + pitch, rim - pitch);
    judge(inner, "the wall between land and optical surface", job.dry_run.wall_tolerance_um, faults);
    if (inner.places > 0) report["land_walls"] = to_json(inner);
  }

  const bool held = !find_tabs(solid, part, mill.diameter_mm, kHolds_mm).empty();
  report["held"] = held;
  report["tabs_planned"] = profile.tabs;
  report["tabs"] = json::array();
  if (!held && (profile.tabs > 0 || profile.skin_mm > kHolds_mm)) {
    faults.push_back(fault_at("cut_free", "nothing holds the part in its blank any more: tabs and skin are cut through all around", Vec3::Zero(), 0));
  }
  if (profile.tabs > 0) {
    const std::vector<Tab> tabs = find_tabs(solid, part, mill.diameter_mm, (profile.skin_mm + profile.tab_height_mm) / 2);
    for (const Tab& tab : tabs) {
      report["tabs"].push_back({{"place_mm", {tab.place_mm.x(), tab.place_mm.y()}}, {"height_mm", tab.height_mm}, {"width_mm", tab.width_mm}});
      if (tab.height_mm >= (1 - kTabLacks) * profile.tab_height_mm) continue;
      faults.push_back(fault_at("tabs", "a tab at x " + fixed(tab.place_mm.x(), 1) + ", y " + fixed(tab.place_mm.y(), 1) + " mm is " + fixed(tab.height_mm, 2) +
                                            " mm high, " + compact(profile.tab_height_mm, 2) + " are planned",
                                Vec3(tab.place_mm.x(), tab.place_mm.y(), tab.height_mm), profile.tab_height_mm - tab.height_mm));
    }
    if (static_cast<int>(tabs.size()) < profile.tabs) {
      faults.push_back(fault_at("tabs", std::to_string(tabs.size()) + " tabs hold the part, " + std::to_string(profile.tabs) +
                                            " are planned: the others are cut through", Vec3::Zero(), 0));
    }
  }
  const std::vector<SolidStock::Piece> pieces = solid.pieces();
  report["pieces"] = std::count_if(pieces.begin(), pieces.end(), [](const auto& piece) { return piece.volume_mm3 > kPiece_mm3; });
  return report;
}

Grid<float> tabs_from_above(const Job& job, const SolidStock& solid) {
  const RayBundle& rays = solid.rays(2);
  const auto most = static_cast<float>(1.5 * std::max(job.profile.options.tab_height_mm, 2 * job.profile.options.skin_mm));
  Grid<float> heights(rays.columns(), rays.rows());
  for (int j = 0; j < rays.rows(); ++j) {
    for (int i = 0; i < rays.columns(); ++i) {
      const auto spans = rays.at(i, j);
      heights.at(i, j) = spans.empty() || spans.front().from > 0 ? 0.0F : std::min(spans.front().to, most);
    }
  }
  return heights;
}

}  // namespace lightmill

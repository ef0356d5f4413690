#include "cli/crease_report.h"

#include <nlohmann/json.hpp>

#include "cam/outline.h"
#include "cli/job_light.h"
#include "design/core/text.h"
#include "design/optics.h"

namespace lightmill {

using nlohmann::json;

namespace {

/// Where upright light that leaves the lens at `place` through a surface of this normal meets the receiver; null if it does not.
json landing(const Vec2& place, double height_mm, const Vec3& normal, const Job& job, const ReceiverFrame& receiver) {
  Vec3 after;
  Vec2 landed;
  if (!refract(Vec3::UnitZ(), normal, {job.lens.refractive_index, 1}, after)) return nullptr;
  if (!receiver.meet({place.x(), place.y(), height_mm}, after, landed)) return nullptr;
  return {landed.x(), landed.y()};
}

}  // namespace

json creases_json(const SplineSurface& surface, const ReachableSurface& reachable, const Job& job) {
  constexpr std::size_t kMostListed = 200;
  const std::vector<Crease> creases = concave_creases(surface, reachable);
  const ReceiverFrame receiver = receiver_frame(job.lens, job.receiver);
  const double lens_area = outline_of(scene_of(job).lens).area_mm2();
  double length = 0, area = 0;
  json list = json::array();
  for (const Crease& crease : creases) {
    length += crease.length_mm;
    area += crease.area_mm2;
    if (list.size() == kMostListed) continue;
    const Vec2& middle = crease.line_mm[crease.line_mm.size() / 2];
    const double height = surface.height(middle.x(), middle.y());
    json line = json::array();
    for (const Vec2& p : crease.line_mm) line.push_back({p.x(), p.y()});
    list.push_back({{"length_mm", crease.length_mm},
                    {"angle_deg", crease.angle_rad * 180 / kPi},
                    {"most_angle_deg", crease.most_angle_rad * 180 / kPi},
                    {"fillet_mm", crease.fillet_mm},
                    {"leftover_um", crease.leftover_um},
                    {"leftover_deg", crease.most_angle_rad / 2 * 180 / kPi},  // half way between the flanks, which a fillet's middle is
                    {"light_lost_share", crease.area_mm2 / lens_area},
                    {"lands_between_mm",
                     {landing(middle, height, crease.one_normal, job, receiver), landing(middle, height, crease.other_normal, job, receiver)}},
                    {"line_mm", line}});
  }
  return {{"count", creases.size()},
          {"length_mm", length},
          {"light_lost_share", area / lens_area},
          {"list", list}};
}

std::string creases_text(const json& creases) {
  if (creases.at("count") == 0) return "concave creases   none longer than 1 mm that the ball does not reach into\n";
  std::string text = "concave creases   " + std::to_string(creases.at("count").get<int>()) + ", " + fixed(creases.at("length_mm").get<double>(), 0) + " mm in all, " +
                     fixed(100 * creases.at("light_lost_share").get<double>(), 2) + " % of the light through their fillets\n";
  const auto place = [](const json& p) { return p.is_null() ? std::string("beside the wall") : "x " + fixed(p[0], 0) + " y " + fixed(p[1], 0); };
  constexpr std::size_t kMostTold = 10;
  for (std::size_t k = 0; k < std::min(kMostTold, creases.at("list").size()); ++k) {
    const json& c = creases.at("list")[k];
    const json& line = c.at("line_mm");
    text += "  " + fixed(c.at("length_mm"), 1) + " mm from " + place(line.front()) + " to " + place(line.back()) + ": " + fixed(c.at("angle_deg"), 1) +
            " deg, fillet " + fixed(c.at("fillet_mm"), 2) + " mm, " + fixed(c.at("leftover_um"), 1) + " um left and normals up to " +
            fixed(c.at("leftover_deg"), 1) + " deg off, " +
            fixed(100 * c.at("light_lost_share").get<double>(), 2) + " % of the light spread on the wall from " + place(c.at("lands_between_mm")[0]) + " to " +
            place(c.at("lands_between_mm")[1]) + "\n";
  }
  return text;
}

}  // namespace lightmill

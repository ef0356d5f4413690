#include "cam/work_holding.h"

#include <algorithm>
#include <cmath>

#include "cam/detail/tool_clearance.h"
#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

/// Of the cutter at a pose, along Z.
double lowest_z(const Cutter& cutter, const ToolPose& pose) {
  const double corner = cutter.corner_radius_mm;
  const double flat = std::max(0.0, cutter.radius_mm() - corner);
  const double sine = std::sqrt(std::max(0.0, 1 - pose.axis.z() * pose.axis.z()));
  return pose.tip_mm.z() - corner * (1 - pose.axis.z()) - flat * sine;
}

void refuse_below_back(const ToolPath& path) {
  constexpr double kRoundedMm = 1e-6;
  for (const Move& move : path.moves) {
    const double z = lowest_z(path.cutter, move.pose);
    if (z >= -kRoundedMm) continue;
    const Vec3& p = move.pose.tip_mm;
    throw InputError(path.pass + ": the cutter '" + path.cutter.name + "' would go " + fixed(-z, 2) + " mm below the back of the blank near x " +
                     fixed(p.x(), 1) + ", y " + fixed(p.y(), 1) + " mm; make the lens thicker (lens.thickness_mm), or less steep at its border");
  }
}

}  // namespace

void refuse_contact(const ToolPath& path, const std::vector<KeepOut>& keep_outs) {
  refuse_below_back(path);
  if (keep_outs.empty()) return;
  constexpr double kNearMm = 0.5, kEveryMm = 0.5;
  std::vector<KeepOut> grown = keep_outs;
  for (KeepOut& k : grown) {
    k.min_mm -= Vec3::Constant(kNearMm);
    k.max_mm += Vec3::Constant(kNearMm);
  }
  const detail::ToolClearance clearance(grown);
  const auto look = [&](const ToolPose& pose, const char* when) {
    const auto contact = clearance.touches(path.cutter, pose, 0, true);
    if (!contact) return;
    const Vec3& p = contact->place_mm;
    throw InputError(path.pass + ": the " + (contact->holder ? "holder" : "cutter or shank") + " of '" + path.cutter.name + "' would touch what holds the work near x " +
                     fixed(p.x(), 1) + ", y " + fixed(p.y(), 1) + ", z " + fixed(p.z(), 1) + " mm " + when + " with its tip at x " + fixed(pose.tip_mm.x(), 1) +
                     ", y " + fixed(pose.tip_mm.y(), 1) + ", z " + fixed(pose.tip_mm.z(), 1) +
                     "; hold the blank lower or farther out (stock.keep_outs, stock.jaw_mm), or on a vacuum plate");
  };
  Vec3 last = Vec3::Constant(std::numeric_limits<double>::infinity());
  for (std::size_t k = 0; k < path.moves.size(); ++k) {
    const ToolPose& to = path.moves[k].pose;
    const char* const when = path.moves[k].kind == MoveKind::kRapid || path.moves[k].kind == MoveKind::kLink ? "on the way" : "while it cuts";
    if (k > 0) {
      const ToolPose& from = path.moves[k - 1].pose;
      const int pieces = static_cast<int>(std::ceil((to.tip_mm - from.tip_mm).norm() / kEveryMm));
      for (int m = 1; m < pieces; ++m) {
        const double t = static_cast<double>(m) / pieces;
        look({from.tip_mm + t * (to.tip_mm - from.tip_mm), (from.axis + t * (to.axis - from.axis)).normalized()}, when);
      }
    }
    // Short moves one by one would be looked at too often.
    if ((to.tip_mm - last).norm() < kEveryMm / 2 && k + 1 < path.moves.size()) continue;
    last = to.tip_mm;
    look(to, when);
  }
}

double highest_obstacle_mm(const Blank& blank) {
  double highest = blank.height_mm;
  for (const KeepOut& k : blank.keep_outs) highest = std::max(highest, k.max_mm.z());
  return highest;
}

std::vector<KeepOut> vise_jaws(const Vec2& blank_size_mm, const Vec3& jaw_mm) {
  const double x = jaw_mm.x() / 2, y = blank_size_mm.y() / 2;
  return {{{-x, -y - jaw_mm.y(), 0}, {x, -y, jaw_mm.z()}}, {{-x, y, 0}, {x, y + jaw_mm.y(), jaw_mm.z()}}};
}

}  // namespace lightmill

#include "machine/detail/restart_parts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill::detail {

std::size_t index_of_line(const std::vector<ProgramLine>& lines, long number) {
  const auto found =
      std::lower_bound(lines.begin(), lines.end(), number, [](const ProgramLine& line, long n) { return line.number < n; });
  return static_cast<std::size_t>(found - lines.begin());
}

std::size_t index_to_go_on_at(const std::vector<ProgramLine>& lines, long number) {
  const std::size_t index = index_of_line(lines, number);
  if (number < 1 || index >= lines.size()) {
    throw InputError("line " + std::to_string(number) + " is not in the program, which has lines 1 to " +
                     std::to_string(lines.empty() ? 0 : lines.back().number));
  }
  return index;
}

std::size_t restart_index(const std::vector<LineFacts>& lines, bool low_without_spindle, double& overlap_mm) {
  struct Candidate {
    std::size_t index;
    double way_mm;
  };
  const double wanted_mm = overlap_mm;
  overlap_mm = 0;
  const std::size_t uncut = lines.size() - 1;
  std::deque<Candidate> candidates;
  double way_mm = 0;
  bool cut = false;
  std::size_t last_good = 0, spindle_off = 0;
  for (std::size_t index = 0; index < uncut; ++index) {
    const LineFacts& line = lines[index];
    if (line.good) last_good = index;
    if (line.stops_spindle) spindle_off = index;
    const double start_mm = way_mm;
    way_mm += line.cut_mm;
    cut = cut || line.feeds;
    if (!line.plain) {
      candidates.clear();
      continue;
    }
    if (line.good) candidates.push_back({index, start_mm});
    while (candidates.size() > 1 && candidates[1].way_mm <= way_mm - wanted_mm) candidates.pop_front();
  }
  if (!cut) return 0;
  if (low_without_spindle) return spindle_off;
  const bool good = lines[uncut].good;
  if (wanted_mm <= 0 && good) return uncut;
  if (!candidates.empty()) {
    overlap_mm = way_mm - candidates.front().way_mm;
    return candidates.front().index;
  }
  return good ? uncut : last_good;
}

double way_out_mm(const OperatorSetup& setup, const ToolPose& pose, int tool, double clearance_mm) {
  Vec3 low(-setup.blank.size_mm.x() / 2, -setup.blank.size_mm.y() / 2, 0);
  Vec3 high(setup.blank.size_mm.x() / 2, setup.blank.size_mm.y() / 2, setup.blank.height_mm);
  for (const KeepOut& box : setup.blank.keep_outs) {
    low = low.cwiseMin(box.min_mm);
    high = high.cwiseMax(box.max_mm);
  }
  double margin = clearance_mm;
  for (const Cutter& cutter : setup.cutters) {
    if (cutter.number == tool) margin += cutter.radius_mm();
  }
  low.array() -= margin;
  high.array() += margin;
  double way = std::numeric_limits<double>::infinity();
  for (int i = 0; i < 3; ++i) {
    if (std::abs(pose.axis[i]) < 1e-9) continue;
    way = std::min(way, ((pose.axis[i] > 0 ? high : low)[i] - pose.tip_mm[i]) / pose.axis[i]);
  }
  return std::max(way, 0.0);
}

Vec3 outwards(WorkpieceView& view, const JointPosition& at) {
  const JointPosition out = backed_out(view, at, 1);
  return {out.x_mm - at.x_mm, out.y_mm - at.y_mm, out.z_mm - at.z_mm};
}

double back_out_mm(const MachineModel& machine, const Vec3& outwards, double z_mm, double wanted_mm) {
  constexpr double kUpright = 1e-6;
  if (outwards.head<2>().norm() < kUpright || outwards.z() <= 0) return 0;
  return std::clamp((machine.retract_z_mm - z_mm) / outwards.z(), 0.0, wanted_mm);
}

JointPosition backed_out(WorkpieceView& view, const JointPosition& at, double mm) {
  const ToolPose pose = view.cutter(at, 0);
  return view.joints(pose.tip_mm + mm * pose.axis, at.outer_rad, at.inner_rad, 0);
}

void add_piece_near(const Vec3& place, double radius_mm, const PathPiece& piece, std::vector<PathPiece>& pieces) {
  const Vec3 way = piece.to - piece.from;
  const double square = way.squaredNorm();
  const double t = square > 0 ? std::clamp((place - piece.from).dot(way) / square, 0.0, 1.0) : 0;
  if ((piece.from + t * way - place).norm() <= radius_mm) pieces.push_back(piece);
}

void within_travels(const MachineModel& machine, const std::array<double, 5>& q, std::string_view text) {
  constexpr double kSlack = 1e-3;
  const auto check = [&](char letter, double value, double least, double most) {
    if (value >= least - kSlack && value <= most + kSlack) return;
    throw InputError("the way to the restart place would pass the limit of " + std::string(1, letter) + " in '" +
                     std::string(text) + "'; restart at another line (--from)");
  };
  check('X', q[0], machine.x.min_mm, machine.x.max_mm);
  check('Y', q[1], machine.y.min_mm, machine.y.max_mm);
  check('Z', q[2], machine.z.min_mm, machine.z.max_mm);
  if (!machine.has_rotary()) return;
  check(machine.outer.letter, q[3], machine.outer.min_rad, machine.outer.max_rad);
  check(machine.inner.letter, q[4], machine.inner.min_rad, machine.inner.max_rad);
}

std::string plain_comment(std::string_view text) {
  std::string result(text);
  for (char& c : result) {
    if (c < ' ' || c >= 0x7F || std::string_view("()!?~%$;").find(c) != std::string_view::npos) c = '_';
  }
  return result;
}

}  // namespace lightmill::detail

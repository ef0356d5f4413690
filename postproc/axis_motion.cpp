#include "postproc/axis_motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "postproc/detail/dialect.h"
#include "postproc/detail/trunnion.h"

namespace lightmill {
namespace {

using detail::Tilt;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Tool axes this close are one axis: the rotary joints stay exactly where they are (2e-8 mm at 20 mm).
constexpr double kSameAxis = 1e-9;
// Tool axes this close to the inner rotary axis are taken as parallel to it, so that C is free there; it puts a 2 mm
// ball's centre at most 20 nm aside, and the tip not at all.
constexpr double kPoleTolerance = 1e-5;
constexpr double kUnitTolerance = 1e-6;
constexpr double kJointSlack = 1e-9;  // rounding at a limit is not overtravel
// Reorienting at the machine's top, or turning C while the tip rubs at one spot, must not look cheap.
constexpr double kReorientPenalty_s = 1;
constexpr double kDwellInCutFactor = 10;
// Leaving the part leaves a mark where the tool comes back: as seldom as can be, and rather in the air.
constexpr double kRewindInAir_s = 1e5;
constexpr double kRewindInCut_s = 1e6;
constexpr double kFlattestRetract = 0.2;  // of the tool axis' z: 78 degrees
constexpr double kRetractMargin_mm = 1;
constexpr int kMostPieces = 64;
constexpr int kDeepestSplit = 16;
constexpr std::size_t kReportEvery = 16384;

double wrapped(double angle_rad) {  // into [-pi, pi]
  return std::remainder(angle_rad, 2 * kPi);
}

bool is_endless(const RotaryAxis& axis) {
  return std::isinf(axis.min_rad) && std::isinf(axis.max_rad);
}

std::string pose_text(const ToolPose& pose) {
  const auto triple = [](const Vec3& v, int decimals) {
    return "(" + compact(v.x(), decimals) + ", " + compact(v.y(), decimals) + ", " + compact(v.z(), decimals) + ")";
  };
  return "tip " + triple(pose.tip_mm, 4) + " mm, axis " + triple(pose.axis, 6);
}

std::string place_text(const ToolPath& path, std::size_t move, const ToolPose& pose) {
  return path.pass + ", move " + std::to_string(move + 1) + " of " + std::to_string(path.moves.size()) + ", " +
         pose_text(pose);
}

// How far a position lies outside an axis' travel; 0 inside.
struct Overtravel {
  char letter = 0;
  double value = 0;
  double limit = 0;
  bool rotary = false;
  double amount = 0;  // mm or rad, positive
};

Overtravel overtravel(char letter, double value, double least, double most, bool rotary) {
  if (value < least - kJointSlack) return {letter, value, least, rotary, least - value};
  if (value > most + kJointSlack) return {letter, value, most, rotary, value - most};
  return {};
}

Overtravel worst_linear(const MachineModel& machine, const JointPosition& joints) {
  const std::array<Overtravel, 3> all{overtravel('X', joints.x_mm, machine.x.min_mm, machine.x.max_mm, false),
                                      overtravel('Y', joints.y_mm, machine.y.min_mm, machine.y.max_mm, false),
                                      overtravel('Z', joints.z_mm, machine.z.min_mm, machine.z.max_mm, false)};
  return *std::max_element(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.amount < b.amount; });
}

Overtravel worst_rotary(const MachineModel& machine, const Tilt& tilt) {
  const RotaryAxis& o = machine.outer;
  const RotaryAxis& i = machine.inner;
  const Overtravel outer = overtravel(o.letter, tilt.outer_rad, o.min_rad, o.max_rad, true);
  const Overtravel inner = overtravel(i.letter, tilt.inner_rad, i.min_rad, i.max_rad, true);
  return outer.amount >= inner.amount ? outer : inner;
}

// Everything the stages below share.
struct Job {
  const MachineModel& machine;
  const WorkSetup& setup;
  const ToolPath& path;
  const MotionOptions& options;

  [[nodiscard]] double length() const { return path.cutter.length_mm; }
  [[nodiscard]] JointPosition joints(const Vec3& tip_mm, const Tilt& tilt) const {
    return detail::joints_at(machine, setup, length(), tip_mm, tilt);
  }
  [[nodiscard]] double rotary_seconds(double outer_rad, double inner_rad) const {
    if (!machine.has_rotary()) return 0;
    return std::max(std::abs(outer_rad) / machine.outer.max_speed_rad_per_s,
                    std::abs(inner_rad) / machine.inner.max_speed_rad_per_s);
  }

  /// The least time for an even motion of all axes.
  [[nodiscard]] double axes_seconds(const JointPosition& a, const JointPosition& b) const {
    return std::max({std::abs(b.x_mm - a.x_mm) / machine.x.max_speed_mm_per_s,
                     std::abs(b.y_mm - a.y_mm) / machine.y.max_speed_mm_per_s,
                     std::abs(b.z_mm - a.z_mm) / machine.z.max_speed_mm_per_s,
                     rotary_seconds(b.outer_rad - a.outer_rad, b.inner_rad - a.inner_rad)});
  }

  [[noreturn]] void refuse(std::size_t move, const ToolPose& pose, const Tilt& tilt, const Overtravel& over) const {
    std::string text = place_text(path, move, pose) + ": " + over.letter + " would stand at ";
    if (over.rotary) {
      const double deg = 180 / kPi;
      throw InputError(text + compact(over.value * deg, 4) + " degrees, its limit is " + compact(over.limit * deg, 4) +
                       "; tilt the tool less or in another direction");
    }
    // A shift of the work that brings the axis back: it turns with the table before the axis sees it.
    const Vec3 out = over.letter == 'X' ? Vec3::UnitX() : over.letter == 'Y' ? Vec3::UnitY() : Vec3::UnitZ();
    const Vec3 back = detail::place_work(machine, setup, tilt).rotation.transpose() *
                      (out * (over.value > over.limit ? -over.amount : over.amount));
    text += compact(over.value, 4) + " mm, its limit is " + compact(over.limit, 4) + " mm; shift the workpiece by (" +
            compact(back.x(), 3) + ", " + compact(back.y(), 3) + ", " + compact(back.z(), 3) +
            ") mm ([machine] workpiece_origin_mm)";
    if (over.letter == 'Z') {
      text += std::string(" or use a ") + (over.value > over.limit ? "shorter" : "longer") + " tool";
    }
    throw InputError(text);
  }
};

void check_path(const Job& job) {
  const ToolPath& path = job.path;
  const Cutter& cutter = path.cutter;
  if (path.moves.empty()) throw InputError(path.pass + ": the tool path has no moves");
  if (!(cutter.length_mm > 0)) throw InputError(path.pass + ": cutter '" + cutter.name + "' has no length_mm");
  if (cutter.length_mm > job.machine.max_tool_length_mm) {
    throw InputError(path.pass + ": cutter longer than the machine's reach: '" + cutter.name + "' is " +
                     compact(cutter.length_mm, 3) + " mm from the spindle nose to its tip, " + job.machine.name +
                     " takes at most " + compact(job.machine.max_tool_length_mm, 3) +
                     " mm; use a shorter tool or holder");
  }
  if (!(job.options.tip_tolerance_mm > 0)) throw InputError("tip_tolerance_mm must be greater than 0");
  if (path.moves.front().kind != MoveKind::kRapid) {
    throw InputError(path.pass + ": a tool path must begin with a rapid move to a safe place");
  }
  for (std::size_t i = 0; i < path.moves.size(); ++i) {
    const Move& move = path.moves[i];
    if (!move.pose.tip_mm.allFinite() || !(std::abs(move.pose.axis.norm() - 1) < kUnitTolerance)) {
      throw InputError(place_text(path, i, move.pose) + ": the pose must be finite and its axis a unit vector");
    }
    if (move.kind == MoveKind::kRapid) {
      if (i > 0 && (move.pose.axis - path.moves[i - 1].pose.axis).norm() > kSameAxis) {
        throw InputError(place_text(path, i, move.pose) + ": a rapid must keep the tool axis; turn it in a link move");
      }
    } else if (!(move.feed_mm_per_s > 0 && std::isfinite(move.feed_mm_per_s))) {
      throw InputError(place_text(path, i, move.pose) + ": a feed move needs a feed greater than 0");
    }
  }
}

// Appends moves and keeps the books: times within axis limits, greatest speeds.
class Writer {
 public:
  Writer(const Job& job, AxisMotion& motion) : job_(job), motion_(motion) {}

  [[nodiscard]] const JointPosition& at() const { return at_; }

  // From wherever the machine stands to `joints`, over the machine's top.
  void approach(const JointPosition& joints) {
    JointPosition above = below_top(joints);
    above.z_mm = job_.machine.retract_z_mm;
    motion_.moves.push_back({above, MoveKind::kRapid, 0, true});
    at_ = above;
    rapid(joints);
  }

  void rapid(const JointPosition& joints) {
    if (!job_.machine.has_straight_rapids()) over_the_corners(joints);
    motion_.moves.push_back({joints, MoveKind::kRapid, 0, false});
    at_ = joints;
  }

  // Up along the tool, turn the table at the machine's top, across, down along the tool.
  void reorient(const JointPosition& joints) {
    below_top(joints);
    JointPosition above = at_;
    above.z_mm = job_.machine.retract_z_mm;
    rapid(above);
    above.outer_rad = joints.outer_rad;
    above.inner_rad = joints.inner_rad;
    motion_.moves.push_back({above, MoveKind::kRapid, 0, true});
    above.x_mm = joints.x_mm;
    above.y_mm = joints.y_mm;
    rapid(above);
    rapid(joints);
  }

  /// `axes_s`: the least time the axes need, if more than for an even motion to `joints`.
  void feed(const JointPosition& joints, MoveKind kind, double tip_length_mm, double feed_mm_per_s, double axes_s = 0) {
    const MachineModel& m = job_.machine;
    const double turn_outer = std::abs(joints.outer_rad - at_.outer_rad);
    const double turn_inner = std::abs(joints.inner_rad - at_.inner_rad);
    axes_s = std::max(axes_s, job_.axes_seconds(at_, joints));
    const double wanted_s = tip_length_mm / feed_mm_per_s;
    const double seconds = std::max({wanted_s, axes_s, m.min_block_s});
    if (wanted_s > 0 && seconds > wanted_s * (1 + 1e-9)) {
      ++motion_.slowed_moves;
      if (seconds / wanted_s > motion_.worst_slowing) {
        motion_.worst_slowing = seconds / wanted_s;
        motion_.worst_slowing_at_mm = detail::tip_at(m, job_.setup, job_.length(), joints);
      }
    }
    if (seconds > 0) motion_.max_axis_speed_ratio = std::max(motion_.max_axis_speed_ratio, axes_s / seconds);
    motion_.moves.push_back({joints, kind, seconds, turn_outer > 0 || turn_inner > 0});
    at_ = joints;
  }

  void rewound() { ++motion_.rewinds; }
  void tip_error(double error_mm) { motion_.max_tip_error_um = std::max(motion_.max_tip_error_um, error_mm * 1e3); }

 private:
  // Where axes arrive one by one, the tip may pass any corner of the box between both ends. If one lies below the safe
  // plane: up, across, and the caller goes down.
  void over_the_corners(const JointPosition& to) {
    const int moving = (to.x_mm != at_.x_mm) + (to.y_mm != at_.y_mm) + (to.z_mm != at_.z_mm);
    const double top = job_.machine.retract_z_mm;
    if (moving < 2 || (at_.z_mm == top && to.z_mm == top)) return;
    const double plane = motion_.clearance_z_mm;
    const double low = std::min(at_.z_mm, to.z_mm);
    double high = std::max(at_.z_mm, to.z_mm);
    if (detail::lowest_corner(job_.machine, job_.setup, job_.length(), at_, to, low) >= plane) return;
    const double lack = plane - detail::lowest_corner(job_.machine, job_.setup, job_.length(), at_, to, high);
    const double rise = detail::spindle_in_work(job_.machine, job_.setup, {to.outer_rad, to.inner_rad}).z();
    if (lack > 0) high = rise > kFlattestRetract ? high + lack / rise : top;
    high = std::min(high, top);
    JointPosition corner = at_;
    corner.z_mm = high;
    for (const JointPosition& next : {corner, JointPosition{to.x_mm, to.y_mm, high, to.outer_rad, to.inner_rad}}) {
      if (next.x_mm == at_.x_mm && next.y_mm == at_.y_mm && next.z_mm == at_.z_mm) continue;
      motion_.moves.push_back({next, MoveKind::kRapid, 0, false});
      at_ = next;
    }
  }

  // A place that the machine's top clears.
  const JointPosition& below_top(const JointPosition& joints) const {
    if (joints.z_mm > job_.machine.retract_z_mm + kJointSlack) {
      throw InputError(motion_.pass + ": the tool path's safe place stands " +
                       compact(joints.z_mm - job_.machine.retract_z_mm, 3) +
                       " mm above the machine's top (retract_z_mm = " + compact(job_.machine.retract_z_mm, 3) +
                       "); lower the workpiece or use a shorter tool");
    }
    return joints;
  }

  const Job& job_;
  AxisMotion& motion_;
  JointPosition at_;
};

// The turns of both branches that lie within the rotary limits; an endless inner axis has one turn here, because it
// goes on from where it is.
struct Candidate {
  Tilt tilt;
  int branch = 0;
};

void add_turns(const MachineModel& machine, const Tilt& tilt, int branch, double farthest_rad,
               std::vector<Candidate>& out) {
  const auto add = [&](double inner) {
    const Tilt turned{tilt.outer_rad, inner};
    if (worst_rotary(machine, turned).amount == 0) out.push_back({turned, branch});
  };
  if (is_endless(machine.inner)) {
    add(tilt.inner_rad);
    return;
  }
  const double turn = 2 * kPi;
  const double least = std::max(machine.inner.min_rad, -farthest_rad),
               most = std::min(machine.inner.max_rad, farthest_rad);
  const double first = std::ceil((least - kJointSlack - tilt.inner_rad) / turn);
  for (double k = first; tilt.inner_rad + k * turn <= most + kJointSlack; ++k) add(tilt.inner_rad + k * turn);
}

std::array<Tilt, 2> tilts_for(const Job& job, std::size_t move, const ToolPose& pose, double inner_at_pole_rad) {
  const auto tilts = detail::solve_tilt(job.machine, pose.axis, inner_at_pole_rad, kPoleTolerance);
  if (!tilts) {
    throw InputError(place_text(job.path, move, pose) +
                     ": no position of the rotary axes brings the tool axis upright; "
                     "tilt the tool less or in another direction");
  }
  return *tilts;
}

// Candidates within the rotary limits and `farthest_rad` of the inner axis, cheapest from zero first.
std::vector<Candidate> candidates_for(const Job& job, std::size_t move, const ToolPose& pose,
                                      double farthest_rad = kInfinity) {
  const auto tilts = tilts_for(job, move, pose, 0);
  if (!job.machine.has_rotary()) return {{tilts[0], 0}};
  std::vector<Candidate> candidates;
  for (int branch = 0; branch < 2; ++branch) add_turns(job.machine, tilts[branch], branch, farthest_rad, candidates);
  if (candidates.empty()) {
    const auto over0 = worst_rotary(job.machine, tilts[0]);
    const auto over1 = worst_rotary(job.machine, tilts[1]);
    const int less = over0.amount <= over1.amount ? 0 : 1;
    job.refuse(move, pose, tilts[less], less == 0 ? over0 : over1);
  }
  std::stable_sort(candidates.begin(), candidates.end(), [&](const Candidate& a, const Candidate& b) {
    return job.rotary_seconds(a.tilt.outer_rad, a.tilt.inner_rad) <
           job.rotary_seconds(b.tilt.outer_rad, b.tilt.inner_rad);
  });
  return candidates;
}

// Tips in the workpiece to the gauge point's X, Y, Z.
detail::Placement place_tool(const Job& job, const Tilt& tilt) {
  detail::Placement place = detail::place_work(job.machine, job.setup, tilt);
  place.translation -= detail::tip_from_gauge_point(job.machine, job.length(), tilt);
  return place;
}

// 3+2: one tilt for all, moves one to one.
void plan_fixed(const Job& job, Writer& writer, const Monitor& monitor) {
  const std::vector<Move>& moves = job.path.moves;
  const Vec3 axis = moves.front().pose.axis.normalized();
  const std::vector<Candidate> candidates = candidates_for(job, 0, {moves.front().pose.tip_mm, axis});

  struct Worst {
    std::size_t move = 0;
    Overtravel over;
  };
  std::optional<Tilt> chosen;
  Worst least;
  Tilt least_tilt;
  for (const Candidate& candidate : candidates) {
    const detail::Placement place = place_tool(job, candidate.tilt);
    Worst worst;
    for (std::size_t i = 0; i < moves.size(); ++i) {
      const Vec3 tip = place.rotation * moves[i].pose.tip_mm + place.translation;
      const Overtravel over = worst_linear(job.machine, {tip.x(), tip.y(), tip.z(), 0, 0});
      if (over.amount > worst.over.amount) worst = {i, over};
    }
    if (worst.over.amount == 0) {
      chosen = candidate.tilt;
      break;
    }
    if (least.over.amount == 0 || worst.over.amount < least.over.amount) {
      least = worst;
      least_tilt = candidate.tilt;
    }
  }
  if (!chosen) job.refuse(least.move, moves[least.move].pose, least_tilt, least.over);

  const detail::Placement place = place_tool(job, *chosen);
  for (std::size_t i = 0; i < moves.size(); ++i) {
    if (i % kReportEvery == 0) monitor.report("axis motion", static_cast<double>(i) / moves.size());
    const Move& move = moves[i];
    const Vec3 tip = place.rotation * move.pose.tip_mm + place.translation;
    const JointPosition joints{tip.x(), tip.y(), tip.z(), chosen->outer_rad, chosen->inner_rad};
    if (i == 0) {
      writer.approach(joints);
    } else if (move.kind == MoveKind::kRapid) {
      writer.rapid(joints);
    } else {
      writer.feed(joints, move.kind, (move.pose.tip_mm - moves[i - 1].pose.tip_mm).norm(), move.feed_mm_per_s);
    }
  }
}

// A pose the motion passes through: the end of a move, or the place where a move crosses the pole.
struct Layer {
  ToolPose pose;
  std::size_t move = 0;
  MoveKind kind = MoveKind::kRapid;
  double feed_mm_per_s = 0;
  bool pole = false;
  bool same_axis = false;  // as the layer before
  std::vector<Candidate> candidates;
};

// Where a turn from `from` to `to` crosses the inner axis' direction (or its opposite) strictly in between: the
// fraction of the turn done there, and the direction.
std::optional<std::pair<double, Vec3>> pole_crossing(const MachineModel& machine, const Vec3& from, const Vec3& to) {
  const Vec3 cross = from.cross(to);
  const double sine = cross.norm();
  if (sine < kPoleTolerance) return std::nullopt;
  const Vec3 n = cross / sine;
  if (std::abs(n.dot(machine.inner.axis)) > kPoleTolerance) return std::nullopt;
  for (const double sign : {1.0, -1.0}) {
    const Vec3 pole = sign * machine.inner.axis;
    const double before = std::atan2(n.dot(from.cross(pole)), from.dot(pole));
    const double after = std::atan2(n.dot(pole.cross(to)), pole.dot(to));
    if (before > kPoleTolerance && after > kPoleTolerance && before + after < kPi) {
      return std::pair{before / (before + after), pole};
    }
  }
  return std::nullopt;
}

std::vector<Layer> make_layers(const Job& job) {
  const Vec3& c = job.machine.inner.axis;
  const auto is_pole = [&](const Vec3& axis) { return detail::pole_sine(job.machine, axis) <= kPoleTolerance; };
  std::vector<Layer> layers;
  layers.reserve(job.path.moves.size() + 16);
  for (std::size_t i = 0; i < job.path.moves.size(); ++i) {
    const Move& move = job.path.moves[i];
    Layer layer{move.pose, i, move.kind, move.feed_mm_per_s, false, false, {}};
    layer.pose.axis.normalize();
    layer.pole = is_pole(layer.pose.axis);
    if (layer.pole) layer.pose.axis = c.dot(layer.pose.axis) < 0 ? Vec3(-c) : c;
    if (i > 0) {
      const ToolPose before = layers.back().pose;
      if (before.axis.dot(layer.pose.axis) < -1 + 1e-12) {
        throw InputError(place_text(job.path, i, move.pose) +
                         ": the tool axis turns by 180 degrees in one move; split it");
      }
      layer.same_axis = (before.axis - layer.pose.axis).norm() <= kSameAxis;
      if (layer.same_axis) {
        layer.pose.axis = before.axis;
      } else if (const auto crossing = pole_crossing(job.machine, before.axis, layer.pose.axis)) {
        const auto& [fraction, pole] = *crossing;
        Layer between{{before.tip_mm + fraction * (layer.pose.tip_mm - before.tip_mm), pole},
                      i,
                      move.kind,
                      move.feed_mm_per_s,
                      true,
                      false,
                      {}};
        layers.push_back(std::move(between));
      }
    }
    layers.push_back(std::move(layer));
  }
  return layers;
}

// Keeps what the linear axes can reach; an InputError about the one that misses by least if there is none.
void keep_reachable(const Job& job, Layer& layer) {
  std::vector<Candidate> kept;
  Overtravel least;
  Tilt least_tilt;
  for (const Candidate& candidate : layer.candidates) {
    const Overtravel over = worst_linear(job.machine, job.joints(layer.pose.tip_mm, candidate.tilt));
    if (over.amount == 0) {
      kept.push_back(candidate);
    } else if (least.amount == 0 || over.amount < least.amount) {
      least = over;
      least_tilt = candidate.tilt;
    }
  }
  if (kept.empty()) job.refuse(layer.move, layer.pose, least_tilt, least);
  layer.candidates = std::move(kept);
}

// How far from zero the inner axis has reason to be: the whole of its winding along the path and two turns. An axis
// that may turn a hundred times would otherwise have a hundred places for every pose.
double farthest_inner(const Job& job, const std::vector<Layer>& layers) {
  double angle = 0, least = 0, most = 0, before = 0;
  for (const Layer& layer : layers) {
    if (layer.pole) continue;
    const double inner = tilts_for(job, layer.move, layer.pose, 0).front().inner_rad;
    angle += wrapped(inner - before);
    before = inner;
    least = std::min(least, angle);
    most = std::max(most, angle);
  }
  return most - least + 4 * kPi;
}

// At the pole C is free: offer what the neighbours on either side of a run of pole poses have.
void fill_candidates(const Job& job, std::vector<Layer>& layers, double farthest_rad) {
  for (Layer& layer : layers) {
    layer.candidates.clear();
    if (!layer.pole) layer.candidates = candidates_for(job, layer.move, layer.pose, farthest_rad);
  }
  for (std::size_t begin = 0; begin < layers.size();) {
    if (!layers[begin].pole) {
      ++begin;
      continue;
    }
    std::size_t end = begin;
    while (end < layers.size() && layers[end].pole) ++end;
    std::vector<double> inner;
    const auto offer = [&](const std::vector<Candidate>& from) {
      for (const Candidate& candidate : from) {
        if (std::find(inner.begin(), inner.end(), candidate.tilt.inner_rad) == inner.end()) {
          inner.push_back(candidate.tilt.inner_rad);
        }
      }
    };
    if (begin > 0) offer(layers[begin - 1].candidates);
    if (end < layers.size()) offer(layers[end].candidates);
    if (inner.empty()) inner.push_back(0);
    for (std::size_t i = begin; i < end; ++i) {
      Tilt tilt = tilts_for(job, layers[i].move, layers[i].pose, 0).front();
      for (const double angle : inner) {
        tilt.inner_rad = angle;
        const Overtravel over = worst_rotary(job.machine, tilt);
        if (over.amount > 0) job.refuse(layers[i].move, layers[i].pose, tilt, over);
        layers[i].candidates.push_back({tilt, 0});
      }
    }
    begin = end;
  }
  for (Layer& layer : layers) keep_reachable(job, layer);
}

// The way from one candidate to the next: how far the inner axis turns, or that it must not.
double inner_turn(const Job& job, double from_rad, double to_rad) {
  return is_endless(job.machine.inner) ? wrapped(to_rad - from_rad) : to_rad - from_rad;
}

double edge_seconds(const Job& job, const Layer& before, const Candidate& u, const Layer& after, const Candidate& v) {
  const double outer = v.tilt.outer_rad - u.tilt.outer_rad;
  const double inner = inner_turn(job, u.tilt.inner_rad, v.tilt.inner_rad);
  const bool still = std::abs(outer) < kJointSlack && std::abs(inner) < kJointSlack;
  if (after.kind == MoveKind::kRapid) {
    if (still) return 0;
    const double z0 = job.joints(before.pose.tip_mm, u.tilt).z_mm;
    const double z1 = job.joints(after.pose.tip_mm, v.tilt).z_mm;
    return kReorientPenalty_s + job.rotary_seconds(outer, inner) +
           (2 * job.machine.retract_z_mm - z0 - z1) / job.machine.z.max_speed_mm_per_s;
  }
  if (after.same_axis) return still ? 0 : kInfinity;
  if (before.pole || after.pole) {
    // Into or out of the pole straight along a meridian: C stands still.
    return std::abs(inner) < 1e-6 ? job.rotary_seconds(outer, 0) : kInfinity;
  }
  // The axis must follow its great circle: on one branch, and C never half a turn or more.
  if (u.branch != v.branch || std::abs(inner) > kPi) return kInfinity;
  return job.rotary_seconds(outer, inner);
}

// What was chosen for a layer: how it is arrived at, and how it is left after a turn of C at the pole.
struct Choice {
  Tilt arrive;
  Tilt leave;
  int arrive_branch = 0;
  int branch = 0;       // left on
  bool rewind = false;  // the tool leaves the part between arriving and leaving
};

// Above the part along the tool's axis, clear of the safe plane; nothing if the tool lies too flat for that.
std::optional<Vec3> above_part(const Job& job, const ToolPose& pose) {
  if (pose.axis.z() < kFlattestRetract) return std::nullopt;
  const double rise = std::max(job.path.clearance_z_mm - pose.tip_mm.z(), 0.0) + kRetractMargin_mm;
  return Vec3(pose.tip_mm + rise / pose.axis.z() * pose.axis);
}

bool can_retract(const Job& job, const ToolPose& pose, const Tilt& tilt) {
  const auto above = above_part(job, pose);
  if (!above) return false;
  const JointPosition joints = job.joints(*above, tilt);
  return worst_linear(job.machine, joints).amount == 0 && joints.z_mm <= job.machine.retract_z_mm;
}

// The cheapest way through all layers [Viterbi 1967]. Without `rewinds` the tool stays in the cut, and the result is empty if
// that leads nowhere; with them it may leave the part, turn at the machine's top and come back.
std::vector<Choice> choose(const Job& job, const std::vector<Layer>& layers, bool rewinds, const Monitor& monitor) {
  struct Node {
    int from = -1;        // candidate of the layer before
    int dwell = -1;       // candidate at which this layer was reached before it turned on the spot, or above it
    bool rewind = false;  // above it
  };
  std::vector<std::vector<Node>> nodes(layers.size());
  std::vector<double> cost;
  for (std::size_t i = 0; i < layers.size(); ++i) {
    if (i % kReportEvery == 0) monitor.report("branches", static_cast<double>(i) / layers.size());
    const Layer& layer = layers[i];
    const std::size_t count = layer.candidates.size();
    std::vector<double> now(count, kInfinity);
    nodes[i].resize(count);
    for (std::size_t v = 0; v < count; ++v) {
      if (i == 0) {
        now[v] = job.rotary_seconds(layer.candidates[v].tilt.outer_rad, layer.candidates[v].tilt.inner_rad);
        continue;
      }
      for (std::size_t u = 0; u < cost.size(); ++u) {
        if (cost[u] == kInfinity) continue;
        const double total =
            cost[u] + edge_seconds(job, layers[i - 1], layers[i - 1].candidates[u], layer, layer.candidates[v]);
        if (total < now[v]) {
          now[v] = total;
          nodes[i][v].from = static_cast<int>(u);
        }
      }
    }
    if (std::all_of(now.begin(), now.end(), [](double c) { return c == kInfinity; })) {
      if (!rewinds) return {};
      throw InputError(place_text(job.path, layer.move, layer.pose) + ": " + job.machine.inner.letter + " or " +
                       job.machine.outer.letter +
                       " would pass a limit on the way here, and the tool cannot be lifted to turn back; "
                       "split the pass with a rapid above the part, or turn the workpiece on the table");
    }
    if (layer.pole && layer.kind != MoveKind::kRapid) {
      const auto in_air = [](MoveKind kind) { return kind == MoveKind::kLink || kind == MoveKind::kRapid; };
      const bool air = in_air(layer.kind) && (i + 1 == layers.size() || in_air(layers[i + 1].kind));
      const std::vector<double> arrived = now;
      for (std::size_t v = 0; v < count; ++v) {
        for (std::size_t u = 0; u < count; ++u) {
          const double turn = inner_turn(job, layer.candidates[u].tilt.inner_rad, layer.candidates[v].tilt.inner_rad);
          const double total = arrived[u] + job.rotary_seconds(0, turn) * (air ? 1 : kDwellInCutFactor);
          if (total < now[v]) {
            now[v] = total;
            nodes[i][v].dwell = static_cast<int>(u);
          }
        }
      }
    }
    if (rewinds && i > 0 && layer.kind != MoveKind::kRapid) {
      const double penalty = layer.kind == MoveKind::kLink ? kRewindInAir_s : kRewindInCut_s;
      const std::vector<double> arrived = now;
      for (std::size_t u = 0; u < count; ++u) {
        if (arrived[u] == kInfinity || !can_retract(job, layer.pose, layer.candidates[u].tilt)) continue;
        for (std::size_t v = 0; v < count; ++v) {
          if (u == v || arrived[u] + penalty >= now[v] || nodes[i][u].dwell >= 0) continue;
          if (!can_retract(job, layer.pose, layer.candidates[v].tilt)) continue;
          now[v] = arrived[u] + penalty;
          nodes[i][v].dwell = static_cast<int>(u);
          nodes[i][v].rewind = true;
        }
      }
    }
    cost = std::move(now);
  }

  std::vector<Choice> choices(layers.size());
  int v = static_cast<int>(std::min_element(cost.begin(), cost.end()) - cost.begin());
  for (std::size_t i = layers.size(); i-- > 0;) {
    const Candidate& left = layers[i].candidates[v];
    choices[i].leave = left.tilt;
    choices[i].branch = left.branch;
    choices[i].rewind = nodes[i][v].rewind;
    if (nodes[i][v].dwell >= 0) v = nodes[i][v].dwell;
    choices[i].arrive = layers[i].candidates[v].tilt;
    choices[i].arrive_branch = layers[i].candidates[v].branch;
    v = nodes[i][v].from;
  }
  return choices;
}

JointPosition between(const JointPosition& a, const JointPosition& b, double s) {
  const auto mix = [s](double p, double q) { return p + s * (q - p); };
  return {mix(a.x_mm, b.x_mm), mix(a.y_mm, b.y_mm), mix(a.z_mm, b.z_mm), mix(a.outer_rad, b.outer_rad),
          mix(a.inner_rad, b.inner_rad)};
}

// A move in the workpiece frame: the tip on a straight line, the axis evenly along its great circle.
struct Course {
  ToolPose from, to;
  double angle_rad = 0;

  Course(const ToolPose& start, const ToolPose& end)
      : from(start), to(end), angle_rad(std::atan2(start.axis.cross(end.axis).norm(), start.axis.dot(end.axis))) {}

  [[nodiscard]] double length_mm() const { return (to.tip_mm - from.tip_mm).norm(); }
  [[nodiscard]] Vec3 tip(double s) const { return from.tip_mm + s * (to.tip_mm - from.tip_mm); }
  [[nodiscard]] Vec3 axis(double s) const {
    if (angle_rad < kSameAxis) return to.axis;
    return (std::sin((1 - s) * angle_rad) * from.axis + std::sin(s * angle_rad) * to.axis).normalized();
  }
};

// Cuts a move with turning rotary axes into pieces short enough that straight joint motion keeps the tip on its course.
// `tilt_at(s)` gives the rotary joints at fraction s of the move.
template <typename TiltAt>
class Subdivision {
 public:
  Subdivision(const Job& job, Writer& writer, const Course& course, const Layer& layer, TiltAt tilt_at)
      : job_(job),
        writer_(writer),
        course_(course),
        layer_(layer),
        tilt_at_(std::move(tilt_at)),
        length_mm_(course.length_mm()),
        guides_centre_(detail::dialect_of(job.machine.controller).tcp_ball_centre) {}

  void run(double s0, const JointPosition& j0, double s1, const JointPosition& j1, int depth = 0) {
    const auto [tip_error, error, axes_s] = job_.options.tcp ? guided_error(s0, j0, s1, j1) : free_error(s0, j0, s1, j1);
    if (error <= job_.options.tip_tolerance_mm) {
      writer_.tip_error(tip_error);
      writer_.feed(j1, layer_.kind, (s1 - s0) * length_mm_, layer_.feed_mm_per_s, axes_s);
      return;
    }
    if (depth == kDeepestSplit) {
      throw NumericalError(place_text(job_.path, layer_.move, layer_.pose) +
                           ": the move cannot be cut short enough for the tip tolerance");
    }
    const int pieces =
        std::clamp(static_cast<int>(std::ceil(std::sqrt(error / job_.options.tip_tolerance_mm))), 2, kMostPieces);
    JointPosition before = j0;
    double s_before = s0;
    for (int k = 1; k <= pieces; ++k) {
      const double s = k == pieces ? s1 : s0 + (s1 - s0) * k / pieces;
      const JointPosition joints = k == pieces ? j1 : checked(s);
      run(s_before, before, s, joints, depth + 1);
      before = joints;
      s_before = s;
    }
  }

 private:
  struct PieceError {
    double tip_mm = 0;
    double worst_mm = 0;  // of the tip and of the point one radius up the tool
    double axes_s = 0;    // least time that the piece needs, where its axes do not move evenly
  };

  // All joints move evenly. The error is a parabola in s for short moves, with its top at mid-chord; the quarters see moves
  // that turn so far that it is not.
  [[nodiscard]] PieceError free_error(double s0, const JointPosition& j0, double s1, const JointPosition& j1) const {
    PieceError error;
    const double reach = job_.path.cutter.radius_mm();
    for (const double f : {0.25, 0.5, 0.75}) {
      const ToolPose actual = forward(job_.machine, job_.setup, job_.length(), between(j0, j1, f));
      const double s = s0 + f * (s1 - s0);
      const Vec3 off = actual.tip_mm - course_.tip(s);
      error.tip_mm = std::max(error.tip_mm, off.norm());
      // One radius up the tool (a ball's centre), so that the axis keeps its course too.
      error.worst_mm = std::max({error.worst_mm, off.norm(), (off + reach * (actual.axis - course_.axis(s))).norm()});
    }
    return error;
  }

  // The control moves the guided point straight and the rotary axes evenly; X, Y, Z follow as they must.
  [[nodiscard]] PieceError guided_error(double s0, const JointPosition& j0, double s1, const JointPosition& j1) const {
    PieceError error;
    const double reach = job_.path.cutter.radius_mm();
    const double guided = guides_centre_ ? reach : 0;  // up the tool from the tip
    const Vec3 from = course_.tip(s0) + guided * course_.axis(s0), to = course_.tip(s1) + guided * course_.axis(s1);
    JointPosition before = j0;
    for (const double f : {0.25, 0.5, 0.75, 1.0}) {
      const double s = s0 + f * (s1 - s0);
      const JointPosition even = between(j0, j1, f);
      const Tilt tilt{even.outer_rad, even.inner_rad};
      const Vec3 axis = detail::axis_at(job_.machine, tilt);
      const Vec3 tip = from + f * (to - from) - guided * axis;
      const Vec3 off = tip - course_.tip(s);
      error.tip_mm = std::max(error.tip_mm, off.norm());
      error.worst_mm = std::max({error.worst_mm, off.norm(), (off + reach * (axis - course_.axis(s))).norm()});
      const JointPosition joints = job_.joints(tip, tilt);
      const Overtravel linear = worst_linear(job_.machine, joints);
      if (linear.amount > 0) job_.refuse(layer_.move, {tip, axis}, tilt, linear);
      error.axes_s = std::max(error.axes_s, 4 * job_.axes_seconds(before, joints));
      before = joints;
    }
    return error;
  }

  [[nodiscard]] JointPosition checked(double s) const {
    const Tilt tilt = tilt_at_(s);
    const JointPosition joints = job_.joints(course_.tip(s), tilt);
    const ToolPose pose{course_.tip(s), course_.axis(s)};
    const Overtravel linear = worst_linear(job_.machine, joints);
    if (linear.amount > 0) job_.refuse(layer_.move, pose, tilt, linear);
    const Overtravel rotary = worst_rotary(job_.machine, tilt);
    if (rotary.amount > 0) job_.refuse(layer_.move, pose, tilt, rotary);
    return joints;
  }

  const Job& job_;
  Writer& writer_;
  const Course& course_;
  const Layer& layer_;
  TiltAt tilt_at_;
  double length_mm_;
  bool guides_centre_;
};

// C turns about a tip that stands still.
void turn_at_pole(const Job& job, Writer& writer, const Layer& layer, const Tilt& from, const Tilt& to) {
  const Course course(layer.pose, layer.pose);
  Subdivision turn(job, writer, course, layer, [&](double s) {
    return Tilt{to.outer_rad, from.inner_rad + s * (to.inner_rad - from.inner_rad)};
  });
  turn.run(0, writer.at(), 1, job.joints(layer.pose.tip_mm, to));
}

// The table and the tool turn together from where the machine stands to the layer's pose.
void turn_along(const Job& job, Writer& writer, const Layer& before, const Layer& layer, int branch, const Tilt& to) {
  const Course course(before.pose, layer.pose);
  const Tilt at{writer.at().outer_rad, writer.at().inner_rad};
  const bool meridian = before.pole || layer.pole;  // on which C stands still
  Subdivision turn(job, writer, course, layer, [&](double s) {
    const double inner = at.inner_rad + s * (to.inner_rad - at.inner_rad);
    const auto tilts = detail::solve_tilt(job.machine, course.axis(s), inner);
    if (!tilts) {
      throw InputError(
          place_text(job.path, layer.move, layer.pose) +
          ": no position of the rotary axes brings the tool axis upright on the way here; tilt the tool less");
    }
    const Tilt& tilt = (*tilts)[branch];
    return meridian ? Tilt{tilt.outer_rad, inner} : Tilt{tilt.outer_rad, inner + wrapped(tilt.inner_rad - inner)};
  });
  turn.run(0, writer.at(), 1, job.joints(layer.pose.tip_mm, to));
}

// The feed of the path's moves of a kind: the greatest for links, the least for plunges; `otherwise` if it has none.
double feed_of(const ToolPath& path, MoveKind kind, double otherwise) {
  double feed = 0;
  for (const Move& move : path.moves) {
    if (move.kind != kind) continue;
    feed = feed == 0 ? move.feed_mm_per_s
                     : (kind == MoveKind::kLink ? std::max(feed, move.feed_mm_per_s) : std::min(feed, move.feed_mm_per_s));
  }
  return feed > 0 ? feed : otherwise;
}

// Up along the tool, over the machine's top to the other position of the rotary axes, and down to the same place.
void rewind_above(const Job& job, Writer& writer, const Layer& layer, const Tilt& from, const Tilt& to) {
  const Vec3 above = *above_part(job, layer.pose);
  const double way = (above - layer.pose.tip_mm).norm();
  writer.feed(job.joints(above, from), MoveKind::kLink, way, feed_of(job.path, MoveKind::kLink, layer.feed_mm_per_s));
  writer.reorient(job.joints(above, to));
  writer.feed(job.joints(layer.pose.tip_mm, to), MoveKind::kPlunge, way,
              feed_of(job.path, MoveKind::kPlunge, layer.feed_mm_per_s));
  writer.rewound();
}

void plan_turning(const Job& job, Writer& writer, const Monitor& monitor) {
  std::vector<Layer> layers = make_layers(job);
  fill_candidates(job, layers, farthest_inner(job, layers));
  std::vector<Choice> choices = choose(job, layers, false, monitor.part(0, 0.3));
  if (choices.empty()) {
    fill_candidates(job, layers, kInfinity);
    choices = choose(job, layers, false, monitor.part(0, 0.3));
  }
  if (choices.empty()) choices = choose(job, layers, true, monitor.part(0.3, 0.5));
  const Monitor emission = monitor.part(0.5, 1);

  for (std::size_t i = 0; i < layers.size(); ++i) {
    if (i % kReportEvery == 0) emission.report("axis motion", static_cast<double>(i) / layers.size());
    const Layer& layer = layers[i];
    const Tilt at{writer.at().outer_rad, writer.at().inner_rad};
    // An endless C goes on from where it is, the short way.
    const auto onwards = [&](const Tilt& tilt, double inner_now) {
      return Tilt{tilt.outer_rad, inner_now + inner_turn(job, inner_now, tilt.inner_rad)};
    };
    Tilt to = i == 0 ? choices[i].arrive : onwards(choices[i].arrive, at.inner_rad);
    const bool still = i > 0 && std::abs(to.outer_rad - at.outer_rad) < kJointSlack &&
                       std::abs(to.inner_rad - at.inner_rad) < kJointSlack;
    if (still) to = at;  // to the last bit: rotary joints that stand must not creep
    const JointPosition joints = job.joints(layer.pose.tip_mm, to);
    if (i == 0) {
      writer.approach(joints);
    } else if (layer.kind == MoveKind::kRapid) {
      if (still) {
        writer.rapid(joints);
      } else {
        writer.reorient(joints);
      }
    } else if (still) {
      writer.feed(joints, layer.kind, (layer.pose.tip_mm - layers[i - 1].pose.tip_mm).norm(), layer.feed_mm_per_s);
    } else {
      turn_along(job, writer, layers[i - 1], layer, layer.pole ? choices[i - 1].branch : choices[i].arrive_branch, to);
    }
    const Tilt leave = onwards(choices[i].leave, to.inner_rad);
    if (choices[i].rewind) {
      rewind_above(job, writer, layer, to, leave);
    } else if (std::abs(leave.inner_rad - to.inner_rad) >= kJointSlack) {
      turn_at_pole(job, writer, layer, to, leave);
    }
  }
}

}  // namespace

AxisMotion plan_motion(const MachineModel& machine, const WorkSetup& setup, const ToolPath& path,
                       const MotionOptions& options, const Monitor& monitor) {
  const Job job{machine, setup, path, options};
  check_path(job);
  AxisMotion motion;
  motion.pass = path.pass;
  motion.cutter = path.cutter;
  motion.spindle_rpm = path.spindle_rpm;
  motion.clearance_z_mm = path.clearance_z_mm;
  motion.tcp = options.tcp;
  motion.moves.reserve(path.moves.size() + 1);
  Writer writer(job, motion);
  const Vec3& axis = path.moves.front().pose.axis;
  const bool fixed_axis = std::all_of(path.moves.begin(), path.moves.end(),
                                      [&](const Move& move) { return (move.pose.axis - axis).norm() <= kSameAxis; });
  if (fixed_axis) {
    plan_fixed(job, writer, monitor);
  } else if (!machine.has_rotary() || !machine.simultaneous) {
    const auto turned = std::find_if(path.moves.begin(), path.moves.end(),
                                     [&](const Move& move) { return (move.pose.axis - axis).norm() > kSameAxis; });
    throw InputError(place_text(path, static_cast<std::size_t>(turned - path.moves.begin()), turned->pose) +
                     ": the tool axis turns in the cut, which " + machine.name +
                     " cannot do; use axis = \"fixed\" or \"vertical\" for this pass");
  } else {
    plan_turning(job, writer, monitor);
  }
  monitor.report("axis motion", 1);
  return motion;
}

}  // namespace lightmill

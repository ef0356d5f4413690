// Siemens 840D: frames, swivelled planes, moves and arcs.
#include "machine/detail/siemens_reader.h"

namespace lightmill::detail {

/// TRANS, ATRANS, ROT, AROT; false if the block is no frame's.
bool SiemensReader::read_frame() {
  const std::string_view word = name();
  for (const std::string_view refused : {"SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS", "CROTS", "TOFRAME"}) {
    if (word == refused) reject(column(), std::string(word) + " is not followed: frames shift and turn only");
  }
  const bool turns = word == "ROT" || word == "AROT";
  if (!turns && word != "TRANS" && word != "ATRANS") return false;
  if (path_.on()) reject(column(), "a frame while cutter compensation is on");
  const bool adds = word[0] == 'A';
  p_ += word.size();
  std::array<std::optional<double>, 3> words;
  for (skip_blanks(); p_ != end_ && *p_ != ';'; skip_blanks()) {
    const int where = column();
    if (turns && take("RPL")) {
      if (std::any_of(words.begin(), words.end(), [](const auto& w) { return w.has_value(); }))
        reject(where, "RPL stands alone");
      words[static_cast<std::size_t>(kPlanes[plane_][2])] = address_value();
      expect_word_end();
      continue;
    }
    const auto axis = static_cast<std::size_t>(*p_ - 'X');
    if (*p_ < 'X' || *p_ > 'Z') reject(where, "a frame takes X, Y and Z");
    ++p_;
    if (words[axis]) reject(where, "axis named twice");
    words[axis] = address_value();
    expect_word_end();
  }
  WorkFrame step;
  const auto of = [&](std::size_t i) { return words[i].value_or(0); };
  if (turns)
    step.turn = turn_xyz(of(0) * kRadPerDegree, of(1) * kRadPerDegree, of(2) * kRadPerDegree);
  else
    step.origin_mm = Vec3(of(0), of(1), of(2)) * unit_;
  programmed_ = adds ? programmed_ * step : step;
  renew_frame();
  return true;
}

void SiemensReader::renew_frame() {
  refuse_inside_contour();
  core_.set_frame(swivelled_ * programmed_, swivels_);
}

/// CYCLE800(FR, TC, ST, MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, DIR, ...): a plane by turns about axes one after the
/// other, to which the rotary axes turn the tool; CYCLE800() ends it. MODE: bits 7 and 6 are 00 for axis by axis; bits
/// 1 and 0, 3 and 2, 5 and 4 name the axes about which A, B and C turn, 1 to 3 for X to Z; so 57 turns about X, Y, Z,
/// 27 about Z, Y, X [HiAPI, NcArgCycle800]. The lower or higher angle of DIR: [SINUMERIK 828D operating manual
/// 08/2018, 10.6].
void SiemensReader::swivel() {
  const int where = column();
  if (path_.on()) reject(where, "a swivelled plane while cutter compensation is on");
  if (core_.tcp()) reject(where, "CYCLE800 needs TRAFOOF");
  if (!take("(")) reject(column(), "'(' is missing");
  std::array<double, 16> given{};
  std::size_t count = 0;
  for (skip_blanks(); !take(")"); skip_blanks()) {
    if (p_ == end_) reject(column(), "')' is missing");
    if (count == given.size()) reject(column(), "too many values");
    if (*p_ == '"') {  // the name of the swivel data
      const char* const close = std::find(p_ + 1, end_, '"');
      if (count != 1 || close == end_) reject(column(), "only the second value is a name in quotes");
      p_ = close + 1;
    } else if (*p_ != ',') {
      given[count] = expression();
    }
    ++count;
    skip_blanks();
    if (p_ != end_ && *p_ == ',')
      ++p_;
    else if (p_ != end_ && *p_ != ')')
      reject(column(), "',' or ')' expected");
  }
  if (count == 0) {
    swivelled_ = {};
    swivels_ = false;
    return renew_frame();
  }
  const auto [retract, data, state, mode] = std::array{given[0], given[1], given[2], given[3]};
  static_cast<void>(data);
  if (retract != 0 && retract != 1) reject(where, "CYCLE800 retracts with FR 0 (not) or 1 (Z)");
  const bool adds = state == 1 || state == 100001 || state == 200001;
  if (!adds && state != 0 && state != 100000 && state != 200000)
    reject(where, "CYCLE800 is understood with ST 0 (new) or 1 (additive), without correction of the tool");
  const int order = mode == std::floor(mode) && mode >= 0 && mode < 64 ? static_cast<int>(mode) : -1;
  const double direction = given[13];
  if (direction != -1 && direction != 0 && direction != 1) reject(where, "CYCLE800 takes DIR -1, 0 or 1");
  WorkFrame plane;
  plane.origin_mm = Vec3(given[4], given[5], given[6]) * unit_;
  for (int i = 0; i < 3; ++i) {
    const int axis = (order >> (2 * i) & 3) - 1;
    if (order < 0 || axis < 0) reject(where, "CYCLE800 is understood with MODE axis by axis, such as 57 or 27");
    plane.turn = plane.turn * turn_about(axis, given[static_cast<std::size_t>(7 + i)] * kRadPerDegree);
  }
  plane = plane * WorkFrame{Eigen::Matrix3d::Identity(), Vec3(given[10], given[11], given[12]) * unit_};
  swivelled_ = adds ? swivelled_ * programmed_ * plane : plane;
  programmed_ = {};
  swivels_ = true;
  if (retract == 1) {
    AxisValues up = core_.joints();
    up[2] = core_.machine.retract_z_mm;
    core_.move_joints(up, true, 0);
  }
  renew_frame();
  if (direction == 0) return;
  // DIR wants the lower or the higher of both angles of the first rotary axis.
  const auto both = core_.angles_for(Vec3::UnitZ());
  if (both.empty()) reject(where, "the rotary axes cannot turn the tool into this direction");
  const RotaryAngles& angles =
      *std::min_element(both.begin(), both.end(), [&](const RotaryAngles& a, const RotaryAngles& b) {
        return direction < 0 ? a.outer_rad < b.outer_rad : a.outer_rad > b.outer_rad;
      });
  AxisValues to = core_.here();
  to[3] = angles.outer_rad;
  to[4] = angles.inner_rad;
  core_.move(to, true, 0);
}

void SiemensReader::set_compensation(int code) {
  if (code == 40) return path_.leave();
  if (path_.on()) reject(1, "cutter compensation is on already");
  const auto found = core_.setup.tool_diameter_mm.find(tool_);
  if (found == core_.setup.tool_diameter_mm.end())
    reject(1, "tool " + std::to_string(tool_) + " has no diameter in the tool table");
  const int side = (code == 41) == (found->second >= 0) ? 1 : -1;
  path_.start(side, std::abs(found->second) / 2, kPlanes[plane_][0], kPlanes[plane_][1], path_.place());
}

/// A3, B3, C3: the tool's direction at the block's end.
void SiemensReader::set_direction(const Words& w, AxisValues& to, std::optional<Vec3>& great_circle_to) {
  if (!core_.tcp()) reject(1, "A3, B3 and C3 need TRAORI");
  if (machine_directions_) reject(1, "A3, B3 and C3 are understood with ORIWKS");
  if (turning_ == Turning::kUnsaid) reject(1, "A3, B3 and C3 need ORIAXES or ORIVECT");
  if (w.axes[3].named || w.axes[4].named) reject(1, "a tool direction beside a rotary axis");
  const Vec3 direction(w.direction[0].value_or(0), w.direction[1].value_or(0), w.direction[2].value_or(0));
  const RotaryAngles angles = core_.angles_for(direction, 1, [](const RotaryAngles&) { return true; });
  if (turning_ == Turning::kGreatCircle) {
    great_circle_to = direction;
    return;
  }
  to[3] = angles.outer_rad;
  to[4] = angles.inner_rad;
}

void SiemensReader::move(const Words& w, bool feed_here) {
  if (path_.on() && w.suppress) reject(1, "SUPA while cutter compensation is on");
  AxisValues from = w.suppress ? core_.joints() : place();
  AxisValues to = from;
  for (std::size_t i = 0; i < 5; ++i) {
    const AxisWord& word = w.axes[i];
    if (!word.named) continue;
    if (i >= 3 && core_.tcp() && turning_ != Turning::kAxes) reject(1, "rotary axes under TRAORI need ORIAXES");
    const double v = word.value * (i < 3 ? unit_ : kRadPerDegree);
    const bool incremental = word.how == How::kIncremental || (word.how == How::kModal && incremental_);
    to[i] = incremental ? from[i] + v : v;
    if (word.how == How::kShortest) to[i] = from[i] + std::remainder(v - from[i], 2 * kPi);
    if (word.how == How::kUpwards) to[i] = v + 2 * kPi * std::ceil((from[i] - v) / (2 * kPi) - kSameAngle_rad);
    if (word.how == How::kDownwards) to[i] = v + 2 * kPi * std::floor((from[i] - v) / (2 * kPi) + kSameAngle_rad);
  }
  const Feed given = motion_ == 0 ? Feed{} : feed(feed_here);
  std::optional<Vec3> great_circle_to;
  if (w.direction[0] || w.direction[1] || w.direction[2]) {
    if (motion_ > 1 || w.suppress || path_.on()) reject(1, "A3, B3 and C3 need G0 or G1, without SUPA, G41 or G42");
    set_direction(w, to, great_circle_to);
  }
  const auto seconds = [&] {
    return motion_ == 0 ? 0 : given.inverse_time ? 60 / given.value : core_.seconds_at(to, given.value);
  };
  if (w.suppress || great_circle_to) refuse_inside_contour();
  if (w.suppress) {
    if (core_.tcp()) reject(1, "SUPA before TRAFOOF");
    if (motion_ > 1) reject(1, "SUPA needs G0 or G1");
    if (w.axes[2].named) to[2] += core_.length_mm();  // frames are suppressed, the tool's length is not
    path_.forget_lead();
    return core_.move_joints(to, motion_ == 0, seconds());
  }
  if (great_circle_to) {
    path_.forget_lead();
    return core_.move_on_great_circle(to, *great_circle_to, motion_ == 0, seconds());
  }
  if (motion_ <= 1) return follow(w, {to, motion_ == 0, given.value, {}}, given);
  arc(w, to);
}

/// By its centre (from the start, or absolute with AC) or its radius, in any plane, with TURN more circles.
void SiemensReader::arc(const Words& w, const AxisValues& to) {
  const AxisValues from = place();
  const int u = kPlanes[plane_][0], v = kPlanes[plane_][1], across = kPlanes[plane_][2];
  const bool clockwise = motion_ == 2;
  const auto centre = [&](int axis) {
    const AxisWord& word = w.centre[static_cast<std::size_t>(axis)];
    return word.value * unit_ + (word.how == How::kAbsolute ? 0 : from[static_cast<std::size_t>(axis)]);
  };
  double cu = centre(u), cv = centre(v);
  const bool has_centre = w.centre[static_cast<std::size_t>(u)].named || w.centre[static_cast<std::size_t>(v)].named;
  if (w.centre[static_cast<std::size_t>(across)].named) reject(1, "a centre across the arc's plane");
  if (w.radius) {
    if (has_centre) reject(1, "an arc takes its centre or CR=");
    centre_by_radius(from[u], from[v], to[u], to[v], *w.radius * unit_, clockwise, 1, cu, cv);
  } else if (!has_centre) {
    reject(1, "an arc needs its centre in the plane (I, J, K) or CR=");
  }
  const double r0 = std::hypot(from[u] - cu, from[v] - cv), r1 = std::hypot(to[u] - cu, to[v] - cv);
  if (r0 == 0 || std::abs(r1 - r0) > 0.01) reject(1, "the arc's ends do not fit its centre");
  const double more = w.turns.value_or(0);
  if (!(more >= 0 && more <= 999) || more != std::floor(more)) reject(1, "TURN counts from 0 to 999");
  double turn = turn_between(std::atan2(from[v] - cv, from[u] - cu), std::atan2(to[v] - cv, to[u] - cu), clockwise);
  turn += (clockwise ? -2 : 2) * kPi * more;
  follow(w, {to, false, feed().value, ContourMove::Arc{cu, cv, turn}}, feed());
}

/// A path, behind the corner before it; held back if one stands at its end. RND=2 rounds, CHR=2 takes 2 mm from either
/// side, CHF=2 is as long from side to side.
void SiemensReader::follow(const Words& w, ContourMove next, const Feed& feed) {
  const int u = kPlanes[plane_][0], v = kPlanes[plane_][1];
  const bool corner = w.rounding || w.chamfer || w.side;
  if ((corner || held_) && (next.rapid || feed.inverse_time))
    reject(1, "RND, CHF and CHR stand between paths with a feed per minute");
  if (held_) {
    HeldPath held = *held_;
    held_.reset();
    if (held.chamfer_length_mm > 0) {
      const Vec2 along = last_direction(held.from, held.move, u, v), ahead = first_direction(held.move.to, next, u, v);
      held.corner.size_mm = held.chamfer_length_mm / (along + ahead).norm();
    }
    const CutCorner cut = cut_corner(held.from, held.move, next, u, v, held.corner, 1);
    const long line = core_.line;
    core_.line = held.line;
    if (cut.before) path_.follow(*cut.before, u, v);
    if (cut.cut) path_.follow(*cut.cut, u, v);
    core_.line = line;
    if (!cut.next && !corner) return;  // all cut off
    if (cut.next)
      next = *cut.next;
    else
      next.arc.reset();  // of no length, before which no corner can stand
  }
  if (corner) {
    if (int(w.rounding.has_value()) + int(w.chamfer.has_value()) + int(w.side.has_value()) > 1)
      reject(1, "one of RND, CHF and CHR");
    const double size = w.rounding.value_or(w.chamfer.value_or(w.side.value_or(0))) * unit_;
    if (!(size > 0)) reject(1, "RND, CHF and CHR must be above 0");
    held_ = HeldPath{path_.place(), next, {size, !w.rounding}, w.chamfer ? size : 0, core_.line};
  } else if (next.arc) {
    path_.arc(next.to, u, v, next.arc->u, next.arc->v, next.arc->turn_rad, feed);
  } else {
    path_.straight(next.to, next.rapid, feed);
  }
}

}  // namespace lightmill::detail

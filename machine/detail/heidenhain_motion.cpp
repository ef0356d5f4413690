// Heidenhain conversational: lines and arcs, Cartesian and polar, with and without radius compensation.
#include "machine/detail/heidenhain_reader.h"

namespace lightmill::detail {

/// X+1.5, IB-3, Y+Q5: writes into `to`; false if the word names no axis.
bool HeidenhainReader::axis_word(const Token& token, AxisValues& to, const AxisValues& from, bool* absolute_rotary) {
  std::string_view text = token.text;
  const bool incremental = text.size() > 1 && text[0] == 'I' && core_.axis_of(text[1]) >= 0;
  if (incremental) text.remove_prefix(1);
  const int axis = text.empty() ? -1 : core_.axis_of(text[0]);
  if (axis < 0) return false;
  const auto i = static_cast<std::size_t>(axis);
  const double v = number(text.substr(1), token.column) * (axis < 3 ? unit_ : kRadPerDegree);
  to[i] = incremental ? from[i] + v : v;
  if (axis >= 3 && absolute_rotary != nullptr) absolute_rotary[axis - 3] = !incremental;
  return true;
}

void HeidenhainReader::circle_centre() {
  for (std::size_t i = 1; i < tokens_.size(); ++i) {
    if (!axis_word(tokens_[i], centre_, place())) expect_end(i);
  }
  if (tokens_.size() < 3) incomplete();
  has_centre_ = true;
}

/// The words of a path up to its modes, which begin at the index returned.
std::size_t HeidenhainReader::read_path(Path& path, std::string_view kind, const AxisValues& from, std::size_t first) {
  const bool polar = kind == "LP" || kind == "CP" || kind == "CTP";
  std::size_t i = first;
  for (; i < tokens_.size(); ++i) {
    const Token& token = tokens_[i];
    std::string_view text = token.text;
    if (text.starts_with("CCA")) break;
    const bool adds = text.starts_with("IP");
    if (adds) text.remove_prefix(1);
    if (polar && (text.starts_with("PR") || text.starts_with("PA"))) {
      std::optional<double>& word = text[1] == 'R' ? path.polar_radius : path.polar_angle;
      if (word) reject(token.column, "word named twice");
      word = number(text.substr(2), token.column) * (text[1] == 'R' ? unit_ : kRadPerDegree);
      (text[1] == 'R' ? path.radius_adds : path.angle_adds) = adds;
      path.axes = true;
      continue;
    }
    AxisValues probe = from;
    if (!axis_word(token, probe, from, path.rotary_absolute)) break;
    const auto axis = static_cast<std::size_t>(core_.axis_of(token.text[0] == 'I' ? token.text[1] : token.text[0]));
    if (path.named[axis]) reject(token.column, "axis named twice");
    if (polar && axis < 2) reject(token.column, "X and Y beside polar words");
    path.named[axis] = true;
    path.words[axis] = probe[axis];
    path.axes = true;
  }
  for (; i < tokens_.size() && kind[0] == 'C'; ++i) {
    const std::string_view text = tokens_[i].text;
    if (text == "DR+" || text == "DR-")
      path.sense = text[2] == '+' ? 1 : -1;
    else if (kind == "CR" && text[0] == 'R' && text != "R0" && text.size() > 1 && text[1] != 'L' && text[1] != 'R')
      path.radius = number(text.substr(1), tokens_[i].column) * unit_;
    else
      break;
  }
  const bool tangent = kind == "CT" || kind == "CTP";
  if (kind[0] == 'C' && !tangent && (path.sense == 0 || (kind == "CR" && !(path.radius && *path.radius != 0))))
    reject(tokens_[0].column, "an arc needs DR+ or DR-, and CR its R");
  return i;
}

void HeidenhainReader::move(std::string_view kind) {
  Path path;
  const AxisValues from = place();
  modes(read_path(path, kind, from));
  AxisValues to = machine_coordinates_ ? core_.joints() : from;
  const AxisValues before = to;
  for (std::size_t k = 0; k < 5; ++k) {
    if (path.named[k]) to[k] = path.words[k];
  }
  for (std::size_t k = 3; k < 5 && shortest_; ++k) {
    if (path.named[k] && path.rotary_absolute[k - 3]) to[k] = before[k] + std::remainder(to[k] - before[k], 2 * kPi);
  }
  const bool line = kind == "L" || kind == "LP";
  if (!fmax_ && block_seconds_ == 0 && path.axes && feed_ == 0) reject(tokens_[0].column, "feed not given");
  if (line) {
    if (kind == "LP") polar_end(path, from, to);
    set_compensation();
    straight(to, path.axes);
  } else {
    arc(kind, path, from, to);
  }
  finish();
}

/// RL, RR and R0, which change on straight lines.
void HeidenhainReader::set_compensation() {
  const int active = active_side();
  if (side_ == active) return;
  if (approach_ || held_) reject(tokens_[0].column, "RL, RR and R0 do not change behind APPR, RND and CHF");
  if (side_ == 0) return path_.leave();
  if (active != 0) reject(tokens_[0].column, "R0 must stand between RL and RR");
  const double radius = cutter_radius();
  active_side_ = side_;
  path_.start(radius >= 0 ? side_ : -side_, std::abs(radius), 0, 1, path_.place());
}

/// Of the tool in the spindle, below 0 if the table says so.
double HeidenhainReader::cutter_radius() const {
  if (const auto defined = defined_tools_.find(tool_); defined != defined_tools_.end())
    return defined->second.radius_mm + radius_delta_mm_;
  const auto found = core_.setup.tool_diameter_mm.find(tool_);
  if (found == core_.setup.tool_diameter_mm.end())
    reject(tokens_[0].column, "tool " + std::to_string(tool_) + " has no diameter in the tool table");
  return found->second / 2 + radius_delta_mm_;
}

void HeidenhainReader::straight(const AxisValues& to, bool axes) {
  if (!axes) return;
  fmax_before_ = fmax_;
  if (machine_coordinates_) {
    refuse_inside_contour();
    refuse_beside_compensation("M91");
    path_.forget_lead();
    has_heading_ = false;
    const double seconds = fmax_ ? 0 : block_seconds_ > 0 ? block_seconds_ : core_.seconds_at(to, feed_);
    return core_.move_joints(to, fmax_, seconds);
  }
  const AxisValues from = place();
  const double du = to[0] - from[0], dv = to[1] - from[1];
  if (du != 0 || dv != 0) {
    heading_ = std::atan2(dv, du);
    has_heading_ = true;
  }
  follow({to, fmax_, feed_, {}}, block_seconds_ > 0 ? Feed{60 / block_seconds_, true} : Feed{feed_, false});
}

/// The end in X and Y about the pole CC; what is not named stays.
void HeidenhainReader::polar_end(const Path& path, const AxisValues& from, AxisValues& to) {
  if (!has_centre_) reject(tokens_[0].column, "polar words need a CC before them");
  const double u = from[0] - centre_[0], v = from[1] - centre_[1];
  double radius = std::hypot(u, v), angle = std::atan2(v, u);
  if (radius == 0 && (!path.polar_radius || !path.polar_angle || path.angle_adds))
    reject(tokens_[0].column, "at the pole PR and PA must both be named");
  if (path.polar_radius) radius = *path.polar_radius + (path.radius_adds ? radius : 0);
  if (path.polar_angle) angle = *path.polar_angle + (path.angle_adds ? angle : 0);
  to[0] = centre_[0] + radius * std::cos(angle);
  to[1] = centre_[1] + radius * std::sin(angle);
}

/// C and CP about CC, CR by its radius, CT and CTP on from the path before.
void HeidenhainReader::arc(std::string_view kind, const Path& path, const AxisValues& from, AxisValues to) {
  const int column = tokens_[0].column;
  if (block_seconds_ > 0) reject(column, "FT is understood on straight lines only");
  if (fmax_ || machine_coordinates_) reject(column, "an arc takes neither FMAX nor M91");
  if (side_ != active_side()) reject(column, "RL, RR and R0 change on straight lines");
  bool clockwise = path.sense < 0;
  double cu = centre_[0], cv = centre_[1];
  if (kind == "CP") {
    if (path.polar_radius) reject(column, "CP takes its radius from the pole");
    if (!path.polar_angle) reject(column, "CP needs PA or IPA");
  }
  if (kind == "CP" || kind == "CTP") polar_end(path, from, to);
  if (kind == "CR") {
    centre_by_radius(from[0], from[1], to[0], to[1], *path.radius, clockwise, column, cu, cv);
  } else if (kind == "CT" || kind == "CTP") {
    if (!has_heading_) reject(column, kind == "CT" ? "CT needs a path before it" : "CTP needs a path before it");
    const double du = to[0] - from[0], dv = to[1] - from[1], across = std::cos(heading_) * dv - std::sin(heading_) * du;
    if (!(std::abs(across) > 1e-9 * std::hypot(du, dv))) reject(column, "a tangent arc to a place straight ahead");
    const double r = (du * du + dv * dv) / (2 * across);  // to the left if above 0
    cu = from[0] - r * std::sin(heading_);
    cv = from[1] + r * std::cos(heading_);
    clockwise = r < 0;
  } else if (!has_centre_) {
    reject(column, "C needs a CC before it");
  }
  const double r0 = std::hypot(from[0] - cu, from[1] - cv), r1 = std::hypot(to[0] - cu, to[1] - cv);
  if (r0 == 0 || std::abs(r1 - r0) > 0.016) reject(column, "the arc's ends do not fit its centre");
  double turn = turn_between(std::atan2(from[1] - cv, from[0] - cu), std::atan2(to[1] - cv, to[0] - cu), clockwise);
  if (kind == "CP" && path.angle_adds) {  // a helix: the whole angle is named
    turn = *path.polar_angle;
    if (turn == 0 || (turn < 0) != clockwise) reject(column, "IPA and DR must have the same sign");
  }
  heading_ = std::atan2(to[1] - cv, to[0] - cu) + (clockwise ? -kPi / 2 : kPi / 2);
  has_heading_ = true;
  fmax_before_ = false;
  follow({to, false, feed_, ContourMove::Arc{cu, cv, turn}}, {feed_, false});
}

/// LN X Y Z NX NY NZ TX TY TZ under M128: T is the tool's direction. N matters to 3-D compensation, which is not on.
void HeidenhainReader::vector_move() {
  refuse_beside_compensation("LN");
  AxisValues to = path_.place();
  std::array<std::optional<double>, 3> normal, direction;
  std::size_t i = 1;
  for (; i < tokens_.size(); ++i) {
    const Token& token = tokens_[i];
    const std::string_view text = token.text;
    const bool vector = text.size() > 2 && (text[0] == 'N' || text[0] == 'T') && text[1] >= 'X' && text[1] <= 'Z';
    if (vector) {
      std::optional<double>& part = (text[0] == 'N' ? normal : direction)[static_cast<std::size_t>(text[1] - 'X')];
      if (part) reject(token.column, "word named twice");
      part = number(text.substr(2), token.column);
    } else if (!axis_word(token, to, path_.place())) {
      break;
    } else if (core_.axis_of(text[0] == 'I' ? text[1] : text[0]) > 2) {
      reject(token.column, "a rotary axis beside vectors");
    }
  }
  modes(i);
  if (side_ != 0 || machine_coordinates_) reject(tokens_[0].column, "LN takes neither RL, RR nor M91");
  if (direction[0] || direction[1] || direction[2]) {
    if (!core_.tcp()) reject(tokens_[0].column, "TX, TY and TZ need M128");
    const Vec3 axis(direction[0].value_or(0), direction[1].value_or(0), direction[2].value_or(0));
    const RotaryAngles angles = core_.angles_for(axis, tokens_[0].column, [](const RotaryAngles&) { return true; });
    to[3] = angles.outer_rad;
    to[4] = angles.inner_rad;
  }
  if (!fmax_ && block_seconds_ == 0 && feed_ == 0) reject(tokens_[0].column, "feed not given");
  straight(to, true);
  finish();
}

}  // namespace lightmill::detail

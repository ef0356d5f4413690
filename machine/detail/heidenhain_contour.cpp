// Heidenhain conversational: what a contour has besides its paths. RND and CHF cut corners off, APPR leads the cutter
// to the first path and DEP away from the last. [TNC7, Klartext, chapter 11; iTNC 530, chapter 6]
#include "machine/detail/heidenhain_reader.h"
#include "machine/detail/plane_paths.h"

namespace lightmill::detail {

namespace {

Vec2 in_plane(const AxisValues& p) {
  return {p[0], p[1]};
}
Vec2 heading(double angle_rad) {
  return {std::cos(angle_rad), std::sin(angle_rad)};
}
AxisValues moved_to(AxisValues p, const Vec2& place) {
  p[0] = place.x();
  p[1] = place.y();
  return p;
}

}  // namespace

AxisValues HeidenhainReader::place() const {
  return approach_ ? approach_->to : held_ ? held_->move.to : path_.place();
}

int HeidenhainReader::active_side() const {
  return approach_ ? approach_->side : path_.on() ? active_side_ : 0;
}

/// Whether the block behind this one, as they stand in the program, is a corner.
bool HeidenhainReader::corner_follows() const {
  for (std::size_t i = at_ + 1; i < lines_.size(); ++i) {
    const std::size_t word = lines_[i].find_first_not_of(iso_ ? "N0123456789 \t" : "0123456789 \t");
    if (word == std::string_view::npos) continue;
    const std::string_view rest = lines_[i].substr(word);
    return rest.starts_with(iso_ ? "G25" : "RND") || rest.starts_with(iso_ ? "G24" : "CHF");
  }
  return false;
}

/// RND R5 F100, CHF 2 F100: their feed is theirs alone.
void HeidenhainReader::corner() {
  const int column = tokens_[0].column;
  const bool chamfer = is(0, "CHF");
  if (!held_) reject(column, "RND and CHF stand behind a path of the contour");
  if (held_->corner.size_mm > 0) reject(column, "a second corner where there is one");
  if (tokens_.size() < 2) incomplete();
  std::string_view text = tokens_[1].text;
  if (text[0] == 'R') text.remove_prefix(1);
  if (!chamfer && text.size() == tokens_[1].text.size()) reject(tokens_[1].column, "RND needs its R");
  held_->corner = {number(text, tokens_[1].column) * unit_, chamfer};
  if (!(held_->corner.size_mm > 0)) reject(tokens_[1].column, "a corner's size must be above 0");
  held_->corner_line = core_.line;
  held_->corner_feed = held_->move.feed_per_min;
  if (tokens_.size() > 2 && tokens_[2].text[0] == 'F') {
    held_->corner_feed = number(tokens_[2].text.substr(1), tokens_[2].column) * unit_;
    if (!(held_->corner_feed > 0)) reject(tokens_[2].column, "the feed must be above 0");
    expect_end(3);
  } else {
    expect_end(2);
  }
}

/// A path as programmed: behind what waits for it, and held back if a corner is to follow.
void HeidenhainReader::follow(ContourMove next, const Feed& feed) {
  const bool corner = corner_follows();
  if ((corner || held_) && (feed.inverse_time || next.rapid))
    reject(tokens_[0].column, "RND and CHF stand between paths without FMAX and FT");
  if (approach_) approach(next);
  if (held_) {
    const std::optional<ContourMove> rest = turn_corner(next);
    if (!rest && !corner) return;  // all cut off
    if (rest)
      next = *rest;
    else
      next.arc.reset();  // of no length, before which no corner can stand
  }
  if (corner) {
    held_ = HeldPath{path_.place(), next, {}, 0, core_.line, 0};
  } else if (next.arc) {
    path_.arc(next.to, 0, 1, next.arc->u, next.arc->v, next.arc->turn_rad, feed);
  } else {
    path_.straight(next.to, next.rapid, feed);
  }
}

/// Lets the path before a corner go and what cuts it off; what is left of the next.
std::optional<ContourMove> HeidenhainReader::turn_corner(const ContourMove& next) {
  const HeldPath held = *held_;
  held_.reset();
  const long line = core_.line;
  core_.line = held.corner_line;
  CutCorner corner = cut_corner(held.from, held.move, next, 0, 1, held.corner, tokens_[0].column);
  core_.line = held.line;
  if (corner.before) path_.follow(*corner.before, 0, 1);
  say_waiting();
  core_.line = held.corner_line;
  if (corner.cut) {
    corner.cut->feed_per_min = held.corner_feed;
    path_.follow(*corner.cut, 0, 1);
  }
  core_.line = line;
  return corner.next;
}

/// APPR LT X Y Z LEN RL F, and LN, CT (CCA R), LCT (R), with P before their names in polar words. The cutter moves with
/// the next path, which gives the direction.
void HeidenhainReader::begin_approach() {
  const int column = tokens_[0].column;
  refuse_beside_compensation("APPR");
  Approach a;
  a.rapid_before = fmax_before_;
  a.feed_before = feed_;
  a.line = core_.line;
  Path path;
  const AxisValues from = path_.place();
  a.to = from;
  modes(read_transition(path, a.way, from));
  for (std::size_t k = 0; k < 3; ++k) {
    if (path.named[k]) a.to[k] = path.words[k];
  }
  if (path.polar_radius || path.polar_angle) polar_end(path, from, a.to);
  if (side_ == 0) reject(column, "APPR needs RL or RR");
  if (fmax_ || machine_coordinates_ || block_seconds_ > 0) reject(column, "APPR takes neither FMAX, FT nor M91");
  if (feed_ == 0 || (!a.rapid_before && a.feed_before == 0)) reject(column, "feed not given");
  if (!ends_.empty()) reject(column, "APPR and an M code that waits for its end");
  a.side = side_;
  a.feed = feed_;
  approach_ = a;
}

/// The words of APPR and DEP up to their modes.
std::size_t HeidenhainReader::read_transition(Path& path, Transition& way, const AxisValues& from) {
  if (tokens_.size() < 2) incomplete();
  const Token& kind = tokens_[1];
  way.kind = kind.text;
  const bool polar = way.kind.starts_with("P");
  if (polar) way.kind.remove_prefix(1);
  if (way.kind != "LT" && way.kind != "LN" && way.kind != "CT" && way.kind != "LCT")
    reject(kind.column, "LT, LN, CT or LCT expected");
  std::size_t i = read_path(path, polar ? "LP" : "L", from, 2);
  if (path.named[3] || path.named[4]) reject(kind.column, "APPR and DEP move X, Y and Z");
  const auto word = [&](std::string_view name, double& value) {
    if (i >= tokens_.size() || !tokens_[i].text.starts_with(name)) return;
    const std::string_view rest = tokens_[i].text.substr(name.size());
    if (!rest.empty() && std::string_view("+-.0123456789Q").find(rest[0]) == std::string_view::npos) return;
    if (rest == "0" && name == "R") return;
    if (rest.empty() && ++i >= tokens_.size()) incomplete();
    value = number(rest.empty() ? tokens_[i].text : rest, tokens_[i].column);
    if (value == 0) reject(tokens_[i].column, "this must not be 0");
    ++i;
  };
  const bool line = way.kind[1] != 'C' && way.kind[0] == 'L';
  if (line) word("LEN", way.length_mm);
  if (way.kind == "CT") word("CCA", way.angle_rad);
  if (!line) word("R", way.length_mm);
  way.length_mm *= unit_;
  way.angle_rad *= kRadPerDegree;
  if (way.length_mm == 0) reject(kind.column, line ? "LEN is missing" : "R is missing");
  if (way.kind != "CT" && way.length_mm < 0) reject(kind.column, "LEN and the R of LCT must be above 0");
  if (way.kind == "CT" && !(way.angle_rad > 0 && way.angle_rad <= 2 * kPi + kSameAngle_rad))
    reject(kind.column, "CCA takes an angle above 0 and up to 360");
  return i;
}

/// The circle of CT and LCT, which touches the contour at `at`: beside the contour the cutter's centre runs as for any
/// arc.
HeidenhainReader::TouchingArc HeidenhainReader::touching_arc(const Transition& way, const Vec2& at, const Vec2& along,
                                                             int side, double cutter_mm) const {
  TouchingArc arc;
  arc.sense = way.length_mm > 0 ? side : -side;
  arc.centre = at + side * way.length_mm * left_of(along);
  arc.radius_mm = std::abs(way.length_mm);
  arc.centre_radius_mm = arc.radius_mm - arc.sense * side * cutter_mm;
  if (!(arc.centre_radius_mm > 0)) reject(tokens_[0].column, "the cutter does not fit into the arc of APPR or DEP");
  return arc;
}

/// The straight line that touches the circle of the cutter's centre ends (or begins, `ahead`) at `outside`: where, as
/// an angle.
double HeidenhainReader::touched_at(const TouchingArc& arc, const Vec2& outside, bool ahead) const {
  const Vec2 d = outside - arc.centre;
  if (!(d.norm() > arc.centre_radius_mm))
    reject(tokens_[0].column, "the arc of LCT is too large for its straight line");
  const double angle = std::acos(arc.centre_radius_mm / d.norm()) * arc.sense;
  return std::atan2(d.y(), d.x()) + (ahead ? -angle : angle);
}

void HeidenhainReader::approach(const ContourMove& first) {
  const Approach a = *approach_;
  approach_.reset();
  const int column = tokens_[0].column;
  const Vec2 at = in_plane(a.to);
  if (!first.arc && at == in_plane(first.to)) reject(column, "behind APPR a path in X and Y must follow");
  const Vec2 along = first_direction(a.to, first, 0, 1);
  const double cutter_mm = a.side * cutter_radius();  // signed: to the left
  const Feed feed{a.feed, false};
  const long line = core_.line;
  core_.line = a.line;
  // To the auxiliary point: in the plane, then along the tool.
  const auto lead_to = [&](const Vec2& place) {
    const bool rapid = a.rapid_before && a.way.kind != "LCT";
    const Feed before{a.way.kind == "LCT" ? a.feed : a.feed_before, false};
    AxisValues to = path_.place();
    if (to != moved_to(to, place)) path_.straight(to = moved_to(to, place), rapid, before);
    if (to[2] != a.to[2]) {
      to[2] = a.to[2];
      path_.straight(to, rapid, before);
    }
  };
  const auto beside = [&](const AxisValues& contour) {
    path_.start_beside(cutter_mm < 0 ? -1 : 1, std::abs(cutter_mm), contour);
    active_side_ = a.side;
  };
  if (a.way.kind == "LT") {
    const Vec2 start = at - a.way.length_mm * along;
    lead_to(start + cutter_mm * left_of(along));
    beside(moved_to(a.to, start));
    path_.straight(a.to, false, feed);
  } else if (a.way.kind == "LN") {
    const Vec2 end = at + cutter_mm * left_of(along);
    lead_to(end + a.side * a.way.length_mm * left_of(along));
    path_.straight(moved_to(a.to, end), false, feed);
    beside(a.to);
  } else {
    const TouchingArc arc = touching_arc(a.way, at, along, a.side, cutter_radius());
    const Vec2 last = (at - arc.centre) / arc.radius_mm;
    const double end = std::atan2(last.y(), last.x());
    double turn = arc.sense * a.way.angle_rad;
    if (a.way.kind == "LCT") {
      turn = turn_between(touched_at(arc, in_plane(path_.place()), false), end, arc.sense < 0);
      if (std::abs(turn) > 2 * kPi - kSameAngle_rad) turn = 0;
    }
    const Vec2 start = heading(end - turn);
    lead_to(arc.centre + arc.centre_radius_mm * start);
    beside(moved_to(a.to, arc.centre + arc.radius_mm * start));
    if (turn != 0) path_.arc(a.to, 0, 1, arc.centre.x(), arc.centre.y(), turn, feed);
  }
  core_.line = line;
  say_waiting();
}

/// DEP LT LEN, LN LEN, CT CCA R, LCT X Y R: away from the last path, where compensation ends.
void HeidenhainReader::depart() {
  const int column = tokens_[0].column;
  if (!path_.entered() || !has_heading_) reject(column, "DEP needs a path under RL or RR before it");
  const Vec2 at = in_plane(path_.place()), along = heading(heading_);
  const int side = active_side_;
  Transition way;
  Path path;
  AxisValues to = path_.place();
  modes(read_transition(path, way, to));
  if (way.kind == "LCT" && !(path.named[0] || path.named[1] || path.polar_radius || path.polar_angle))
    reject(column, "DEP LCT needs its end");
  if (way.kind != "LCT" && (path.named[0] || path.named[1] || path.polar_radius || path.polar_angle))
    reject(column, "of these only DEP LCT takes an end");
  if (fmax_ || machine_coordinates_ || block_seconds_ > 0) reject(column, "DEP takes neither FMAX, FT nor M91");
  const Feed feed{feed_, false};
  const AxisValues contour = to;
  for (std::size_t k = 0; k < 2; ++k) {
    if (path.named[k]) to[k] = path.words[k];
  }
  if (path.polar_radius || path.polar_angle) polar_end(path, contour, to);
  if (way.kind == "LT") {
    path_.straight(moved_to(to, at + way.length_mm * along), false, feed);
    path_.stop();
  } else if (way.kind == "LN") {
    path_.stop();
    path_.straight(moved_to(to, in_plane(core_.here()) + side * way.length_mm * left_of(along)), false, feed);
  } else {
    const TouchingArc arc = touching_arc(way, at, along, side, cutter_radius());
    const Vec2 first = (at - arc.centre) / arc.radius_mm;
    const double start = std::atan2(first.y(), first.x());
    double turn = arc.sense * way.angle_rad;
    if (way.kind == "LCT") {
      turn = turn_between(start, touched_at(arc, in_plane(to), true), arc.sense < 0);
      if (std::abs(turn) > 2 * kPi - kSameAngle_rad) turn = 0;
    }
    if (turn != 0)
      path_.arc(moved_to(contour, arc.centre + arc.radius_mm * heading(start + turn)), 0, 1, arc.centre.x(),
                arc.centre.y(), turn, feed);
    path_.stop();
    if (way.kind == "LCT") path_.straight(to, false, feed);
  }
  if (path.named[2]) {
    AxisValues up = path_.place();
    up[2] = path.words[2];
    path_.straight(up, false, feed);
  }
  side_ = 0;
  has_heading_ = false;
  finish();
}

/// Behind the path that is held back.
void HeidenhainReader::say(ProgramStep::Kind kind, int number, double value) {
  if (held_ || approach_) return said_.push_back({kind, number, value});
  path_.say(kind, number, value);
}

void HeidenhainReader::say_waiting() {
  for (const Said& said : said_) path_.say(said.kind, said.number, said.value);
  said_.clear();
}

/// What has no place between a path and what waits for it.
void HeidenhainReader::refuse_inside_contour() const {
  if (held_) reject(tokens_[0].column, "behind RND and CHF another path must follow");
  if (approach_) reject(tokens_[0].column, "behind APPR a path must follow");
}

}  // namespace lightmill::detail

#include "machine/detail/cutter_compensation.h"

#include "machine/detail/plane_paths.h"

namespace lightmill::detail {

namespace {

// Corners that turn by less are tangent; LinuxCNC's figure.
constexpr double kSmallCorner_rad = 0.05;
constexpr double kGouge_rad = 1e-3;

}  // namespace

void CutterCompensation::start(int side, double radius_mm, int u, int v, const AxisValues& from) {
  side_ = side;
  radius_ = radius_mm;
  u_ = static_cast<std::size_t>(u);
  v_ = static_cast<std::size_t>(v);
  entering_ = true;
  programmed_ = centre_ = from;
}

void CutterCompensation::start_beside(int side, double radius_mm, const AxisValues& contour) {
  start(side, radius_mm, 0, 1, contour);
  centre_ = core_.here();
  entering_ = false;
}

void CutterCompensation::stop() {
  if (entered()) end_at(in_plane(centre_));
  flush();
  side_ = 0;
}

void CutterCompensation::leave() {
  if (!on()) return;
  const bool had_entered = entered();
  stop();
  if (!had_entered) return;
  for (std::size_t i = 0; i < 3; ++i) lead_[i] = programmed_[i] - core_.here()[i];
  arc_refused_ = true;
}

AxisValues CutterCompensation::place() const {
  if (on()) return programmed_;
  AxisValues p = core_.here();
  for (std::size_t i = 0; i < 3; ++i) p[i] += lead_[i];
  return p;
}

void CutterCompensation::straight(const AxisValues& to, bool rapid, const Feed& feed) {
  const bool across = in_plane_only_ && stays_in_plane(to);
  if (!across) arc_refused_ = false;
  if (on()) {
    double way = std::hypot(to[0] - programmed_[0], to[1] - programmed_[1], to[2] - programmed_[2]);
    if (way == 0) way = std::hypot(to[3] - programmed_[3], to[4] - programmed_[4]) / kRadPerDegree;
    return move({to, rapid, feed.inverse_time ? way * feed.value : feed.value, {}});
  }
  AxisValues end = to;
  for (std::size_t i = 0; i < 3 && across; ++i) end[i] -= lead_[i];
  if (!across) lead_ = {};
  core_.move(end, rapid, rapid ? 0 : feed.inverse_time ? 60 / feed.value : core_.seconds_at(end, feed.value));
}

void CutterCompensation::arc(const AxisValues& to, int u, int v, double cu, double cv, double turn, const Feed& feed) {
  if (arc_refused_) reject(1, "the first move after cutter compensation must be straight");
  const AxisValues from = place();
  const auto w = static_cast<std::size_t>(3 - u - v);
  const double length = std::hypot(std::hypot(from[u] - cu, from[v] - cv) * turn, to[w] - from[w]);
  if (on())
    return move({to, false, feed.inverse_time ? length * feed.value : feed.value, ContourMove::Arc{cu, cv, turn}});
  core_.arc(to, u, v, cu, cv, turn, feed.inverse_time ? 60 / feed.value : length * 60 / feed.value);
}

void CutterCompensation::follow(const ContourMove& move, int u, int v) {
  const Feed feed{move.feed_per_min, false};
  if (move.arc) return arc(move.to, u, v, move.arc->u, move.arc->v, move.arc->turn_rad, feed);
  straight(move.to, move.rapid, feed);
}

void CutterCompensation::flush() {
  from_.reset();
  const long line = core_.line;
  for (const Held& held : held_) {
    core_.line = held.line;
    if (!held.moves) {
      core_.say(held.kind, held.number, held.value);
      continue;
    }
    const ContourMove& m = held.move;
    const AxisValues from = core_.here();
    if (m.arc) {
      const double du = from[u_] - m.arc->u, dv = from[v_] - m.arc->v;
      double turn =
          turn_between(std::atan2(dv, du), std::atan2(m.to[v_] - m.arc->v, m.to[u_] - m.arc->u), m.arc->turn_rad < 0);
      turn += std::copysign(2 * kPi * held.extra_turns, turn);
      double across = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        if (i != u_ && i != v_) across = m.to[i] - from[i];
      }
      const double radius = (std::hypot(du, dv) + std::hypot(m.to[u_] - m.arc->u, m.to[v_] - m.arc->v)) / 2;
      const double length = std::hypot(radius * turn, across);
      core_.arc(m.to, static_cast<int>(u_), static_cast<int>(v_), m.arc->u, m.arc->v, turn,
                length * 60 / m.feed_per_min);
    } else {
      core_.move(m.to, m.rapid, m.rapid || m.feed_per_min == 0 ? 0 : core_.seconds_at(m.to, m.feed_per_min));
    }
  }
  core_.line = line;
  held_.clear();
}

void CutterCompensation::say(ProgramStep::Kind kind, int number, double value) {
  if (!on()) return core_.say(kind, number, value);
  Held held;
  held.moves = false;
  held.kind = kind;
  held.number = number;
  held.value = value;
  hold(held);
}

void CutterCompensation::hold(Held next) {
  next.line = core_.line;
  held_.push_back(next);
  if (!next.moves && held_.size() == 1) flush();
}

void CutterCompensation::move(const ContourMove& move) {
  const Point from = in_plane(programmed_), to = in_plane(move.to);
  Held next;
  next.move = move;
  if (radius_ == 0) {
    hold(next);
    flush();
  } else if (!move.arc && to.u == from.u && to.v == from.v &&
             (!entering_ || in_plane_only_)) {  // along the cutter, or of the rotary axes only
    next.move.to[u_] = centre_[u_];
    next.move.to[v_] = centre_[v_];
    hold(next);
    if (entering_) flush();
  } else {
    // The normal at the move's end: to the side of its direction there.
    Point normal{};
    if (move.arc) {
      const double r = std::hypot(to.u - move.arc->u, to.v - move.arc->v),
                   sense = std::copysign(side_, side_ * move.arc->turn_rad);
      if (!(r > 0)) reject(1, "an arc without a radius");
      normal = {-sense * (to.u - move.arc->u) / r, -sense * (to.v - move.arc->v) / r};
      next.sweep_rad = std::abs(move.arc->turn_rad);
      next.extra_turns = static_cast<int>((next.sweep_rad - 1e-9) / (2 * kPi));
      if (sense > 0 && r <= radius_) reject(1, "the cutter does not fit into the arc");
    } else {
      const double length = std::hypot(to.u - from.u, to.v - from.v);
      if (length > 0) {
        next.direction = {(to.u - from.u) / length, (to.v - from.v) / length};
        normal = {-side_ * next.direction.v, side_ * next.direction.u};
      }
    }
    next.move.to[u_] += radius_ * normal.u;
    next.move.to[v_] += radius_ * normal.v;
    if (entering_)
      enter(move, next);
    else
      turn_corner(move, next);
  }
  centre_ = next.move.to;
  programmed_ = move.to;
}

void CutterCompensation::enter(const ContourMove& move, Held next) {
  const Point from = in_plane(centre_), to = in_plane(move.to);
  if (std::hypot(to.u - from.u, to.v - from.v) <= radius_)
    reject(1, "the first move of cutter compensation is not longer than the cutter's radius");
  if (move.arc) {
    // The centre, seen from the new end, moves along its line until start and end are equally far.
    const Point end = in_plane(next.move.to);
    const double au = move.arc->u - end.u, av = move.arc->v - end.v, a = std::hypot(au, av), du = from.u - end.u,
                 dv = from.v - end.v, along = (du * au + dv * av) / a;
    if (!(a > 0) || std::abs(along) < 1e-4 * std::hypot(du, dv)) reject(1, "the cutter does not fit into the arc");
    const double r = (du * du + dv * dv) / (2 * along);
    next.move.arc->u = end.u + r * au / a;
    next.move.arc->v = end.v + r * av / a;
  }
  // LinuxCNC does not ask whether what corners leave of the entry runs backwards.
  next.entry = true;
  if (!move.arc) from_ = from;
  entering_ = false;
  hold(next);
}

void CutterCompensation::turn_corner(const ContourMove& move, const Held& next) {
  const Point corner = in_plane(programmed_), before = in_plane(centre_);
  // Directions before and behind the corner.
  const double bu = side_ * (before.v - corner.v), bv = -side_ * (before.u - corner.u);
  Point ahead = next.direction;
  if (move.arc) {
    const double sense = std::copysign(1.0, move.arc->turn_rad);
    ahead = {-sense * (corner.v - move.arc->v), sense * (corner.u - move.arc->u)};
  }
  // How far it turns away from the cutter's side: -90 to 270 degrees, up to 180 convex.
  double away = -side_ * std::atan2(cross({bu, bv}, {ahead.u, ahead.v}), bu * ahead.u + bv * ahead.v);
  if (away < -kPi / 2) away += 2 * kPi;
  bool concave = away < -kSmallCorner_rad || away > kPi + kSmallCorner_rad;
  // A path that turns back on a convex arc can pass on either side: it stays outside.
  const bool back = std::abs(away - kPi) < kSmallCorner_rad;
  const auto outside = [&](const ContourMove& m) { return m.arc && side_ * m.arc->turn_rad < 0; };
  const Held* const last = held_.empty() ? nullptr : &held_.front();
  if (move.arc)
    concave = concave || (back && outside(move));
  else
    concave = concave || (away > kPi - kSmallCorner_rad && last != nullptr && outside(last->move));

  if (concave) {
    if (last == nullptr) {
      if (move.arc) reject(1, "an arc in a concave corner behind a stop");
    } else {
      const Point p = trimmed(*last, next, corner, ahead);
      end_at(p);
      flush();
      from_ = p;
      return hold(next);
    }
  } else if (away > kSmallCorner_rad) {
    const double a = std::hypot(ahead.u, ahead.v);
    const Point start{corner.u - side_ * radius_ * ahead.v / a, corner.v + side_ * radius_ * ahead.u / a};
    if (!move.arc) end_at(before);  // only here LinuxCNC looks whether the move held back still has a length
    flush();
    Held round;
    round.move = next.move;
    round.move.to = centre_;
    for (std::size_t i = 3; i < 5; ++i) round.move.to[i] = next.move.to[i];
    round.move.to[u_] = start.u;
    round.move.to[v_] = start.v;
    round.move.arc.reset();
    if (!move.rapid) round.move.arc = ContourMove::Arc{corner.u, corner.v, -1.0 * side_};
    hold(round);
    flush();
    from_ = start;
    return hold(next);
  }
  flush();
  if (!move.arc) from_ = before;  // a tangent arc may sweep a little more than programmed
  hold(next);
}

/// Where the centre's paths before and behind a concave corner cross: of two places that where the path turns to the
/// cutter's side.
CutterCompensation::Point CutterCompensation::trimmed(const Held& before, const Held& next, Point corner,
                                                      Point ahead) const {
  const auto path = [](const Held& held, Point on, const Vec2& direction) {
    if (!held.move.arc) return PlanePath::line({on.u, on.v}, direction);
    const ContourMove::Arc& arc = *held.move.arc;
    return PlanePath::circle({arc.u, arc.v}, std::hypot(on.u - arc.u, on.v - arc.v), arc.turn_rad < 0 ? -1 : 1);
  };
  const Point here = in_plane(centre_), end = in_plane(next.move.to);
  const PlanePath a =
      path(before, here, {side_ * (here.v - corner.v) / radius_, -side_ * (here.u - corner.u) / radius_});
  const PlanePath b = path(next, end, {ahead.u, ahead.v});
  const auto places = crossings(a, b);
  if (!places) reject(1, "the cutter does not fit into the concave corner");
  const auto turns = [&](const Vec2& p) { return side_ * cross(a.direction_at(p), b.direction_at(p)); };
  const Vec2& p = (*places)[turns((*places)[0]) >= turns((*places)[1]) ? 0 : 1];
  return {p.x(), p.y()};
}

/// Ends what is held back at p instead; it must not run backwards for that.
void CutterCompensation::end_at(Point p) {
  for (Held& held : held_) {
    if (!held.moves) continue;
    ContourMove& m = held.move;
    if (from_ && m.arc) {
      const double turn = turn_between(std::atan2(from_->v - m.arc->v, from_->u - m.arc->u),
                                       std::atan2(p.v - m.arc->v, p.u - m.arc->u), m.arc->turn_rad < 0) +
                          std::copysign(2 * kPi * held.extra_turns, m.arc->turn_rad);
      if (std::abs(turn) > held.sweep_rad + kGouge_rad)
        reject(1, "the cutter does not reach the concave corner: the arc before it is too short");
    } else if (from_ && !held.entry && held.direction.u * (p.u - from_->u) + held.direction.v * (p.v - from_->v) < 0) {
      reject(1, "the cutter does not reach the concave corner: the move before it is too short");
    }
    m.to[u_] = p.u;
    m.to[v_] = p.v;
  }
}

}  // namespace lightmill::detail

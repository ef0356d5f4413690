#include "machine/detail/contour_corner.h"

#include "machine/detail/plane_paths.h"

namespace lightmill::detail {

namespace {

constexpr double kSameDirection = 1e-9;  // of two unit vectors

/// A move of a contour in its plane.
struct Piece {
  Vec2 from, to;
  std::optional<ContourMove::Arc> arc;

  [[nodiscard]] int sense() const { return !arc ? 0 : arc->turn_rad < 0 ? -1 : 1; }
  [[nodiscard]] PlanePath path() const {
    if (!arc) return PlanePath::line(from, (to - from).normalized());
    const Vec2 centre(arc->u, arc->v);
    return PlanePath::circle(centre, (from - centre).norm(), sense());
  }
  /// The path that runs at a distance to its left; none inside a circle that is too small.
  [[nodiscard]] std::optional<PlanePath> beside(double left_mm) const {
    PlanePath p = path();
    if (!arc)
      p.at += left_mm * left_of(p.direction);
    else if (!((p.radius -= sense() * left_mm) > 0))
      return std::nullopt;
    return p;
  }
  /// The place of the piece's path that is nearest to one beside it.
  [[nodiscard]] Vec2 nearest(const Vec2& p) const {
    const PlanePath on = path();
    if (arc) return on.at + on.radius * (p - on.at).normalized();
    return on.at + (p - on.at).dot(on.direction) * on.direction;
  }
  /// The share of the piece between a place of its path and its beginning, or its end.
  [[nodiscard]] double share(const Vec2& p, bool to_end) const {
    if (!arc) return (to_end ? to - p : p - from).dot(to - from) / (to - from).squaredNorm();
    const Vec2 centre(arc->u, arc->v), a = (to_end ? p : from) - centre, b = (to_end ? to : p) - centre;
    double turn = sense() * std::atan2(cross(a, b), a.dot(b));
    if (turn < -kSameDirection) turn += 2 * kPi;
    return turn / std::abs(arc->turn_rad);
  }
};

}  // namespace

Vec2 first_direction(const AxisValues& from, const ContourMove& move, int u, int v) {
  const Piece piece{{from[u], from[v]}, {move.to[u], move.to[v]}, move.arc};
  return piece.path().direction_at(piece.from);
}

Vec2 last_direction(const AxisValues& from, const ContourMove& move, int u, int v) {
  const Piece piece{{from[u], from[v]}, {move.to[u], move.to[v]}, move.arc};
  return piece.path().direction_at(piece.to);
}

CutCorner cut_corner(const AxisValues& from, const ContourMove& before, const ContourMove& next, int u, int v,
                     const Corner& corner, int column) {
  for (int k = 0; k < 5; ++k) {
    if (k != u && k != v && (before.to[k] != from[k] || next.to[k] != from[k]))
      reject(column, "a rounding or chamfer stands between paths of the plane");
  }
  const Vec2 at(before.to[u], before.to[v]);
  const Piece a{{from[u], from[v]}, at, before.arc}, b{at, {next.to[u], next.to[v]}, next.arc};
  if ((!a.arc && a.from == a.to) || (!b.arc && b.from == b.to))
    reject(column, "a rounding or chamfer stands between paths of the plane");
  const Vec2 ahead = b.path().direction_at(at), along = a.path().direction_at(at);
  const double turn = cross(along, ahead);
  if (std::abs(turn) < kSameDirection && along.dot(ahead) < 0)
    reject(column, "a rounding or chamfer where the path turns back");
  if (!corner.chamfer && std::abs(turn) < kSameDirection) return {before, std::nullopt, next};
  CutCorner result{before, next, next};
  Vec2 begin = at, end = at;
  result.cut->arc.reset();
  if (corner.chamfer) {
    if (a.arc || b.arc) reject(column, "a chamfer stands between straight lines");
    begin -= corner.size_mm * along;
    end += corner.size_mm * ahead;
  } else {
    // The rounding's centre has the same distance to both, on the side to which the path turns.
    const double left_mm = std::copysign(corner.size_mm, turn);
    const auto beside_a = a.beside(left_mm), beside_b = b.beside(left_mm);
    const auto places = beside_a && beside_b ? crossings(*beside_a, *beside_b) : std::nullopt;
    if (!places) reject(column, "the rounding is larger than the paths beside it");
    const Vec2& centre = (*places)[((*places)[0] - at).norm() <= ((*places)[1] - at).norm() ? 0 : 1];
    begin = a.nearest(centre);
    end = b.nearest(centre);
    const Vec2 p = begin - centre, q = end - centre;
    result.cut->arc = ContourMove::Arc{centre.x(), centre.y(),
                                       turn_between(std::atan2(p.y(), p.x()), std::atan2(q.y(), q.x()), turn < 0)};
  }
  const double cut_before = a.share(begin, true), cut_behind = b.share(end, false);
  if (!(std::max(cut_before, cut_behind) < 1 + kSameDirection && std::min(cut_before, cut_behind) > -kSameDirection))
    reject(column,
           std::string(corner.chamfer ? "the chamfer" : "the rounding") + " is larger than the paths beside it");
  if (cut_before > 1 - kSameDirection) {
    begin = a.from;
    result.before.reset();
  } else {
    result.before->to[u] = begin.x();
    result.before->to[v] = begin.y();
    if (before.arc) result.before->arc->turn_rad *= 1 - cut_before;
  }
  if (cut_behind > 1 - kSameDirection) {
    end = b.to;
    result.next.reset();
  } else if (next.arc) {
    result.next->arc->turn_rad *= 1 - cut_behind;
  }
  result.cut->to[u] = end.x();
  result.cut->to[v] = end.y();
  return result;
}

}  // namespace lightmill::detail

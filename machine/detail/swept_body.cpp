#include "machine/detail/swept_body.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

namespace lightmill {

namespace {

/// A mill that leans by less is upright: 0.5 um at 5 mm.
constexpr double kVertical_rad = 1e-4;
/// A line that is parallel to a cylinder or a plane within this (square of a sine, sine) enters at its ends only.
constexpr double kParallel = 1e-12;

/// Of a line along p at q with disks of one radius that move straight in the plane of p and q.
Chord moving_disk_chord(double p, double q, double dp, double dq, double radius, double at) {
  Chord chord;
  for (const double end : {0.0, 1.0}) {
    const double across = at - (q + end * dq);
    const double half2 = radius * radius - across * across;
    if (half2 < 0) continue;
    const double centre = p + end * dp, half = std::sqrt(half2);
    chord.include({centre - half, centre + half});
  }
  // The two straight sides, where they meet the line.
  const double length = std::hypot(dp, dq);
  if (std::abs(dq) > 1e-12 * length && length > 0) {
    for (const double side : {-radius, radius}) {
      const double side_p = p - side * dq / length, side_q = q + side * dp / length;
      const double share = (at - side_q) / dq;
      if (share < 0 || share > 1) continue;
      const double place = side_p + share * dp;
      chord.include({place, place});
    }
  }
  return chord;
}

}  // namespace

SweptBody::SweptBody(const Tool& tool, const ToolPose& from, const ToolPose& to, double margin_mm)
    : radius_(std::max(0.0, tool.radius_mm + margin_mm)),
      top_(tool.flute_length_mm + 2 * margin_mm),
      motion_(to.tip_mm - from.tip_mm),
      axis_((from.axis + to.axis).normalized()) {
  tip_ = from.tip_mm - margin_mm * axis_;
  const double corner = std::clamp(tool.corner_mm + margin_mm, 0.0, radius_);
  body_ = {radius_ - corner, corner, std::max(corner, top_ - corner), tool.spread};
  const auto leans = [](const ToolPose& pose) { return std::hypot(pose.axis.x(), pose.axis.y()) > kVertical_rad; };
  if (tool.ball && tool.spread <= 0) {
    kind_ = Kind::kBall;
    const Vec3 centre = tip_ + radius_ * axis_;
    const double core = body_.top_mm - body_.corner_mm;
    const Vec3 side = core * axis_;
    const Vec3 normal = motion_.cross(side);
    const auto rim = [&](const Vec3& start, const Vec3& way) { rims_[rim_count_++] = {start, way, way.squaredNorm()}; };
    flat_ = normal.norm() > 1e-9;
    if (flat_) {
      normal_ = normal.normalized();
      const Vec3 m = side.cross(normal_), a = normal_.cross(motion_);
      along_motion_ = m / m.dot(motion_);
      along_axis_ = a / a.dot(side);
      rim(centre, motion_);
      rim(centre + side, motion_);
      rim(centre, side);
      rim(centre + motion_, side);
    } else if (core <= 0) {
      rim(centre, motion_);
    } else {
      const double way = motion_.dot(axis_);
      const double first = std::min(0.0, way);
      rim(centre + first * axis_, (core + std::abs(way)) * axis_);
    }
  } else if (!tool.ball && !leans(from) && !leans(to)) {
    kind_ = Kind::kUpright;
    axis_ = Vec3::UnitZ();
    upright_.shape = Sweep::Shape::kMill;
    upright_.radius_mm = radius_;
    upright_.corner_mm = body_.corner_mm;
    upright_.flat_mm = body_.flat_mm;
    upright_.from = tip_;
    upright_.to = tip_ + motion_;
    upright_.prepare();
  }
  low_ = Vec3::Constant(kNothing);
  high_ = -low_;
  for (const Vec3& tip : {tip_, Vec3(tip_ + motion_)}) {
    for (const double height : {body_.corner_mm, std::max(body_.top_mm, body_.corner_mm)}) {
      const Vec3 centre = tip + height * axis_;
      const Vec3 half = body_.core_radius_mm(height) * (Vec3::Ones() - axis_.cwiseProduct(axis_)).cwiseMax(0).cwiseSqrt() +
                        Vec3::Constant(body_.corner_mm);
      low_ = low_.cwiseMin(centre - half);
      high_ = high_.cwiseMax(centre + half);
    }
  }
}

Box2 SweptBody::below(double z_mm) const {
  if (z_mm < low_.z()) return {};
  if (kind_ != Kind::kBall || z_mm >= high_.z()) return {low_.head<2>(), high_.head<2>()};
  // Of the parallelogram what is at most a radius higher: its corners lie on the rims.
  Box2 box;
  double lowest = kNothing;
  for (int k = 0; k < rim_count_; ++k) {
    const Capsule& rim = rims_[k];
    const double over = rim.from.z() - z_mm, rise = rim.way.z();
    double first = 0, last = 1;
    if (rise > 0) {
      last = std::min(last, (radius_ - over) / rise);
    } else if (rise < 0) {
      first = std::max(first, (radius_ - over) / rise);
    } else if (over > radius_) {
      continue;
    }
    if (first > last) continue;
    for (const double share : {first, last}) {
      box.include((rim.from + share * rim.way).head<2>());
      lowest = std::min(lowest, over + share * rise);
    }
  }
  if (box.empty()) return box;
  const double beside = lowest > 0 ? std::sqrt(std::max(0.0, radius_ * radius_ - lowest * lowest)) : radius_;
  return {box.min - Vec2::Constant(beside), box.max + Vec2::Constant(beside)};
}

Chord SweptBody::chord(int along, const Vec3& place) const {
  for (int axis = 0; axis < 3; ++axis) {
    if (axis != along && (place[axis] < low_[axis] || place[axis] > high_[axis])) return {};
  }
  switch (kind_) {
    case Kind::kUpright:
      return upright_chord(along, place);
    case Kind::kBall:
      return ball_chord(along, place);
    case Kind::kOther:
      break;
  }
  return other_chord(along, place);
}

Chord SweptBody::other_chord(int along, const Vec3& place) const {
  Vec3 start = place;
  start[along] = low_[along] - 1;
  const auto up = entry(body_, tip_, motion_, axis_, start, Vec3::Unit(along));
  if (!up) return {};
  const double from = start[along] + *up;
  start[along] = high_[along] + 1;
  const auto down = entry(body_, tip_, motion_, axis_, start, -Vec3::Unit(along));
  return down ? Chord{from, start[along] - *down} : Chord{};
}

Chord SweptBody::upright_chord(int along, const Vec3& place) const {
  // When its tip is at most as high and its flutes' end is at least as high as the line; over a vertical line, while it is there.
  if (along == 2) {
    const double bottom = upright_.height(place.x(), place.y());
    if (bottom == kNothing) return {};
    const double length2 = motion_.head<2>().squaredNorm();
    double last = 1, first = 0;
    if (length2 > 0) {
      const Vec2 off = place.head<2>() - tip_.head<2>();
      const double nearest = off.dot(motion_.head<2>()) / length2;
      const double beside2 = off.squaredNorm() - nearest * nearest * length2;
      const double half = std::sqrt(std::max(0.0, radius_ * radius_ - beside2) / length2);
      first = std::max(0.0, nearest - half);
      last = std::min(1.0, nearest + half);
    }
    return {bottom, tip_.z() + std::max(first * motion_.z(), last * motion_.z()) + top_};
  }
  const double above = place.z() - tip_.z();  // of the line over the first tip
  const double rise = motion_.z();
  const int across = 1 - along;
  double radius = radius_, first = 0, last = 1;
  if (rise == 0) {
    if (above < 0 || above > top_) return {};
    const double in = body_.corner_mm - above;
    if (in > 0) radius = body_.flat_mm + std::sqrt(std::max(0.0, body_.corner_mm * body_.corner_mm - in * in));
  } else {
    const auto while_within = [&](double least, double most) {
      double a = (above - most) / rise, b = (above - least) / rise;
      if (a > b) std::swap(a, b);
      return std::pair(std::max(0.0, a), std::min(1.0, b));
    };
    if (body_.corner_mm > 0) {
      const auto [a, b] = while_within(0, body_.corner_mm);
      if (a < b) return other_chord(along, place);
    }
    std::tie(first, last) = while_within(0, top_);
    if (first > last) return {};
  }
  return moving_disk_chord(tip_[along] + first * motion_[along], tip_[across] + first * motion_[across], (last - first) * motion_[along],
                           (last - first) * motion_[across], radius, place[across]);
}

/// A cylinder and a sphere at both of its ends.
Chord SweptBody::capsule_chord(const Capsule& capsule, int along, const Vec3& place) const {
  Vec3 off = place - capsule.from;
  off[along] = 0;  // places along the line count from the capsule's beginning
  const double r2 = radius_ * radius_;
  const auto ball = [&](const Vec3& to_line, double centre) {
    double beside2 = to_line.squaredNorm() - to_line[along] * to_line[along];
    const double half2 = r2 - beside2;
    if (half2 < 0) return Chord{};
    const double half = std::sqrt(half2);
    return Chord{centre - half, centre + half};
  };
  const double w = capsule.way[along];
  const Chord first = ball(off, 0), last = ball(off - capsule.way, w);
  Chord chord;
  const double parallel = capsule.length2 > 0 ? w * w / capsule.length2 : 1;
  if (1 - parallel < kParallel) {
    chord.include(first);
    chord.include(last);
  } else {
    const double oe = off.dot(capsule.way);
    const double a = 1 - parallel;
    const double b = -oe * w / capsule.length2;
    const double c = off.squaredNorm() - oe * oe / capsule.length2 - r2;
    const double disc = b * b - a * c;
    if (disc < 0) return chord;
    const double root = std::sqrt(disc);
    const auto end = [&](double u) {
      const double share = (oe + u * w) / capsule.length2;
      if (share < 0) return first;
      if (share > 1) return last;
      return Chord{u, u};
    };
    const Chord in = end((-b - root) / a), out = end((-b + root) / a);
    // Where the line enters beyond an end it enters that end's sphere, or nothing.
    if (in.from > in.to || out.from > out.to) return chord;
    chord = {in.from, out.to};
  }
  chord.from += capsule.from[along];
  chord.to += capsule.from[along];
  return chord;
}

Chord SweptBody::ball_chord(int along, const Vec3& place) const {
  Chord chord;
  for (int k = 0; k < rim_count_; ++k) chord.include(capsule_chord(rims_[k], along, place));
  if (flat_ && std::abs(normal_[along]) > kParallel) {
    const Vec3& corner = rims_[0].from;
    Vec3 off = place - corner;
    off[along] = 0;
    for (const double side : {-radius_, radius_}) {
      const double u = (side - normal_.dot(off)) / normal_[along];
      const Vec3 p = off + u * Vec3::Unit(along);
      const double m = along_motion_.dot(p), a = along_axis_.dot(p);
      if (m < 0 || m > 1 || a < 0 || a > 1) continue;
      chord.include({corner[along] + u, corner[along] + u});
    }
  }
  return chord;
}

StockField::Probe touch(const SolidStock& solid, const SweptBody& body) {
  StockField::Probe deepest;
  for (const int along : {2, 0, 1}) {
    const int column_axis = SolidStock::kColumnAxis[along], row_axis = SolidStock::kRowAxis[along];
    const auto columns = solid.cells(column_axis, body.low()[column_axis], body.high()[column_axis]);
    const auto rows = solid.cells(row_axis, body.low()[row_axis], body.high()[row_axis]);
    Vec3 place = Vec3::Zero();
    for (int row = rows.from; row <= rows.to; ++row) {
      place[row_axis] = solid.place_mm(row_axis, row);
      for (int column = columns.from; column <= columns.to; ++column) {
        const auto spans = solid.rays(along).at(column, row);
        if (spans.empty() || spans.back().to <= body.low()[along] || spans.front().from >= body.high()[along]) continue;
        place[column_axis] = solid.place_mm(column_axis, column);
        const Chord chord = body.chord(along, place);
        for (const Span& span : spans) {
          const double from = std::max<double>(span.from, chord.from);
          const double depth = std::min<double>(span.to, chord.to) - from;
          if (depth <= deepest.depth_mm) continue;
          deepest = {depth, place};
          deepest.place_mm[along] = from;
        }
      }
    }
    if (deepest.depth_mm > 0) break;
  }
  return deepest;
}

}  // namespace lightmill

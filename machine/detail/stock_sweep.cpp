#include "machine/detail/stock_sweep.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace lightmill {

namespace {
/// Motions shorter than this seen from above are plunges or lifts: their envelope is that of their lower end.
constexpr double kVerticalMotion_mm = 1e-9;
/// Slack of the tests that leave out rectangles of nodes, over all rounding in them.
constexpr double kSlack_mm = 1e-7;
}  // namespace

Frustum Frustum::grown(double distance_mm) const {
  const double height = to_mm - from_mm;
  const double spread = height > 0 ? (to_radius_mm - from_radius_mm) / height : 0;
  const double outwards = distance_mm * std::sqrt(1 + spread * spread);
  return {from_mm - distance_mm, to_mm + distance_mm, std::max(0.0, from_radius_mm - spread * distance_mm + outwards),
          std::max(0.0, to_radius_mm + spread * distance_mm + outwards)};
}

double underside(const Frustum& frustum, const Vec3& tip, const Vec3& axis, double x, double y) {
  if (frustum.empty()) return kNothing;
  // Seen from above, the axis leans by `lean` along a unit direction; s runs along it, u across.
  const double lean = std::hypot(axis.x(), axis.y());
  const double ex = lean > 0 ? axis.x() / lean : 1;
  const double ey = lean > 0 ? axis.y() / lean : 0;
  const double dx = x - tip.x();
  const double dy = y - tip.y();
  const double s = dx * ex + dy * ey;
  const double u = dy * ex - dx * ey;
  const double up = axis.z();
  const double spread = (frustum.to_radius_mm - frustum.from_radius_mm) / (frustum.to_mm - frustum.from_mm);
  // Along the vertical line, with z above the tip: height on the axis s lean + z up, distance^2 from the axis
  // u^2 + (s up - z lean)^2, radius r + spread (height - from).
  const double base = frustum.from_radius_mm + spread * (s * lean - frustum.from_mm);
  const double a = lean * lean - spread * spread * up * up;
  const double b = -(s * up * lean + base * spread * up);  // half of the linear term
  const double c = u * u + s * s * up * up - base * base;
  // Candidates between which inside and outside cannot change: the two ends of the frustum and the roots.
  std::array<double, 4> z{};
  int count = 0;
  if (std::abs(up) > 1e-12) {
    z[count++] = (frustum.from_mm - s * lean) / up;
    z[count++] = (frustum.to_mm - s * lean) / up;
  } else if (s * lean < frustum.from_mm || s * lean > frustum.to_mm) {
    return kNothing;
  }
  if (std::abs(a) > 1e-14) {
    const double discriminant = b * b - a * c;
    if (discriminant >= 0) {
      const double root = std::sqrt(discriminant);
      z[count++] = (-b - root) / a;
      z[count++] = (-b + root) / a;
    }
  } else if (std::abs(b) > 1e-14) {
    z[count++] = -c / (2 * b);
  }
  std::sort(z.begin(), z.begin() + count);
  const double low_end = frustum.from_mm;
  const double high_end = frustum.to_mm;
  for (int k = 0; k + 1 < count; ++k) {
    const double middle = (z[k] + z[k + 1]) / 2;
    const double height = s * lean + middle * up;
    if (height < low_end || height > high_end) continue;
    if (a * middle * middle + 2 * b * middle + c > 0) continue;
    return tip.z() + z[k];
  }
  return kNothing;
}

namespace {

/// Signed distance to a rounded cylinder whose tip is in the origin (only outside its core), and its gradient.
struct Distance {
  double value = 0;
  Vec3 gradient = Vec3::Zero();
};

Distance distance_to(const RoundedCylinder& body, const Vec3& axis, const Vec3& p) {
  const double height = p.dot(axis);
  const Vec3 radial = p - height * axis;
  const double rho = radial.norm();
  const double top = std::max(body.top_mm, body.corner_mm);
  // From the core's nearest place: outwards and along the axis.
  double out = std::max(rho - body.flat_mm, 0.0);
  double axial = std::max(height - top, 0.0) - std::max(body.corner_mm - height, 0.0);
  if (body.spread > 0) {
    const double slant = std::sqrt(1 + body.spread * body.spread);
    const double q = rho - body.flat_mm;
    const double h = height - body.corner_mm;
    const double outside = (q - body.spread * h) / slant;  // of the cone's side
    const double along = (body.spread * q + h) / slant;
    if (outside <= 0 && h >= 0) {
      out = 0;
    } else if (along > (top - body.corner_mm) * slant) {
      out = std::max(rho - body.core_radius_mm(top), 0.0);
      axial = height - top;
    } else if (along > 0) {
      out = outside / slant;
      axial = -outside * body.spread / slant;
    }
  }
  const double core = std::hypot(out, axial);
  Distance distance{core - body.corner_mm, Vec3::Zero()};
  if (core > 0)
    distance.gradient = (rho > 0 ? Vec3(out / rho * radial) : Vec3(Vec3::Zero())) / core + axial / core * axis;
  return distance;
}

/// A moment that is off by this much moves the nearest distance by its square over the corner's radius; at a sharp edge it
/// turns the gradient by its share of the distance.
double moment_tolerance(const RoundedCylinder& body) {
  constexpr double kSharp_mm = 1e-3, kRound_mm = 1e-6, kEdge_mm = 1e-7;
  return body.corner_mm > kSharp_mm ? kRound_mm : kEdge_mm;
}

/// The least distance over the motion: its derivative along the motion grows.
Distance distance_to_swept(const RoundedCylinder& body, const Vec3& axis, const Vec3& motion, const Vec3& p) {
  if (motion.squaredNorm() == 0) return distance_to(body, axis, p);
  double low = 0;
  double high = 1;
  Distance nearest = distance_to(body, axis, p);
  if (nearest.gradient.dot(motion) <= 0) return nearest;
  nearest = distance_to(body, axis, p - motion);
  if (nearest.gradient.dot(motion) >= 0) return nearest;
  const double length = motion.norm();
  while ((high - low) * length > moment_tolerance(body)) {
    const double middle = (low + high) / 2;
    nearest = distance_to(body, axis, p - middle * motion);
    (nearest.gradient.dot(motion) > 0 ? low : high) = middle;
    if (nearest.value < -body.corner_mm / 2) break;  // inside anyway
  }
  return nearest;
}

}  // namespace

std::optional<double> entry(const RoundedCylinder& body, const Vec3& tip, const Vec3& motion, const Vec3& axis, const Vec3& start,
                            const Vec3& direction) {
  // Near a sharp edge gradients are not to be trusted: ten times the moment's tolerance is there, and who comes by at a
  // hundred times has touched it.
  const double sharp = body.corner_mm > 0 ? 0.0 : moment_tolerance(body);
  const double reached = std::max(1e-10, 10 * sharp);
  const Vec3 place = start - tip;
  double along = 0;
  for (int iteration = 0; iteration < 200; ++iteration) {
    const Distance distance = distance_to_swept(body, axis, motion, place + along * direction);
    if (distance.value <= reached) return along;
    const double falls = -distance.gradient.dot(direction);
    if (falls <= 1e-12) return distance.value <= 100 * sharp ? std::optional(along) : std::nullopt;
    along += distance.value / falls;
  }
  return along;  // tangent to the body: Newton halves the rest each time, which by now is below 1e-9 mm
}

double underside(const RoundedCylinder& body, const Vec3& tip, const Vec3& motion, const Vec3& axis, double x,
                 double y) {
  const double top = std::max(body.top_mm, body.corner_mm);
  const double reach = body.core_radius_mm(top) + 2 * body.corner_mm;
  const double z = tip.z() + std::min(0.0, motion.z()) + std::min(0.0, top * axis.z()) - reach - 1;
  const auto up = entry(body, tip, motion, axis, {x, y, z}, Vec3::UnitZ());
  return up ? z + *up : kNothing;
}

void Sweep::prepare() {
  const double dx = to.x() - from.x();
  const double dy = to.y() - from.y();
  length_mm = std::hypot(dx, dy);
  reach = {};
  if (shape == Shape::kTilted) {
    whole = true;
    const double top = std::max(body.top_mm, body.corner_mm);
    lowest_mm = kNothing;
    // Discs across the axis at both ends of the core, at both ends of the motion, rounded by the corner.
    for (const Vec3& tip : {from, to}) {
      for (const double height : {body.corner_mm, top}) {
        const Vec3 centre = tip + height * axis;
        const Vec3 half = body.core_radius_mm(height) * (Vec3::Ones() - axis.cwiseProduct(axis)).cwiseMax(0).cwiseSqrt() +
                          Vec3::Constant(body.corner_mm);
        reach.include((centre - half).head<2>());
        reach.include((centre + half).head<2>());
        lowest_mm = std::min(lowest_mm, centre.z() - half.z());
      }
    }
    return;
  }
  if (length_mm < kVerticalMotion_mm) {
    if (to.z() < from.z()) from = to;
    to = from;
    length_mm = 0;
    whole = true;
  } else {
    along_x = dx / length_mm;
    along_y = dy / length_mm;
    inverse_length = 1 / length_mm;
    rise_mm = to.z() - from.z();
    const double slant = std::hypot(length_mm, rise_mm);
    sine = rise_mm / slant;
    cosine = length_mm / slant;
  }
  const Vec2 around(radius_mm, radius_mm);
  for (const Vec3& end : {from, to}) {
    reach.include(end.head<2>() - around);
    reach.include(end.head<2>() + around);
  }
  lowest_mm = std::min(from.z(), to.z()) - (shape == Shape::kBall ? radius_mm : 0.0);
}

Frustum Sweep::around(double slack_mm) const {
  // The flank's radius, and nowhere less than the ball's.
  const double rounding = body.corner_mm * std::sqrt(1 + body.spread * body.spread);
  const double top = std::max(body.top_mm, body.corner_mm) + body.corner_mm;
  const Frustum still{from_height_mm, top, body.core_radius_mm(from_height_mm) + rounding, body.core_radius_mm(top) + rounding};
  return still.grown(slack_mm + (to - from).norm() / 2);
}

double Sweep::least_height(double distance_mm) const {
  if (distance_mm >= radius_mm) return kNothing;
  switch (shape) {
    case Shape::kBall:
      return lowest_mm + radius_mm - std::sqrt(radius_mm * radius_mm - distance_mm * distance_mm);
    case Shape::kMill: {
      const double out = distance_mm - flat_mm;
      return out <= 0 ? lowest_mm : lowest_mm + corner_mm - std::sqrt(std::max(0.0, corner_mm * corner_mm - out * out));
    }
    case Shape::kTilted:
      break;
  }
  return lowest_mm;
}

std::optional<Sweep::Slab> Sweep::slab_over(const Vec2& centre, const Vec2& half, double below, double beside_mm) const {
  const double dx = centre.x() - from.x();
  const double dy = centre.y() - from.y();
  const double s = dx * along_x + dy * along_y;
  const double u = std::abs(dy * along_x - dx * along_y);
  const double s_spread = half.x() * std::abs(along_x) + half.y() * std::abs(along_y) + kSlack_mm;
  const double u_spread = half.x() * std::abs(along_y) + half.y() * std::abs(along_x) + kSlack_mm;
  const double nearest = std::max(0.0, u - u_spread);
  if (nearest >= radius_mm) return std::nullopt;

  Slab slab;
  if (!whole) {
    slab = {-back_mm, length_mm};
    if (shape == Shape::kBall) {
      // Shifted to where a climbing ball touches.
      const double r_most = std::sqrt(radius_mm * radius_mm - nearest * nearest);
      const double farthest = u + u_spread;
      const double r_least = farthest < radius_mm ? std::sqrt(radius_mm * radius_mm - farthest * farthest) : 0.0;
      slab.first += std::min(r_most * sine, r_least * sine);
      slab.last += std::max(r_most * sine, r_least * sine);
    }
    slab.first -= beside_mm + kSlack_mm;
    slab.last += beside_mm + kSlack_mm;
    if (s + s_spread < slab.first || s - s_spread > slab.last) return std::nullopt;
  }
  const double behind = std::max({0.0, -(s + s_spread), s - s_spread - length_mm});
  const double distance2 = nearest * nearest + behind * behind;
  // Heights are stored as float: what would be stored is what must be lower (a floor that is already milled is not).
  if (distance2 >= radius_mm * radius_mm || static_cast<float>(least_height(std::sqrt(distance2))) >= below) return std::nullopt;
  return slab;
}

namespace {

/// A mill with its tip on the line: the rise of its bottom at distance rho from the axis (0 on the flat), rho <=
/// radius.
double bottom_rise(double rho, double flat_mm, double corner_mm) {
  const double out = rho - flat_mm;
  return out <= 0 ? 0.0 : corner_mm - std::sqrt(std::max(0.0, corner_mm * corner_mm - out * out));
}

/// Sloped motion of a mill: the bottom's rise is convex and grows with the distance, the distance is convex along the
/// motion, so the height over a node is convex along the motion: its minimum is where the derivative changes sign.
double sloped_mill(const Sweep& sweep, double s, double u, double below) {
  const double climb = sweep.rise_mm * sweep.inverse_length;
  const double flat2 = sweep.flat_mm * sweep.flat_mm;
  // Most nodes are under the flat at the lower end of the motion: nothing can be lower.
  const double w_low = (climb > 0 ? 0.0 : sweep.length_mm) - s;
  if (u * u + w_low * w_low <= flat2) return sweep.lowest_mm;
  const double reach2 = sweep.radius_mm * sweep.radius_mm - u * u;
  if (reach2 < 0) return kNothing;
  const double half = std::sqrt(reach2);
  double low = std::max(0.0, s - half);  // centre's place along the motion
  double high = std::min(sweep.length_mm, s + half);
  if (low > high) return kNothing;
  if (sweep.corner_mm <= 0) return sweep.from.z() + climb * (climb > 0 ? low : high);
  const double w_near = std::clamp(s, 0.0, sweep.length_mm) - s;
  if (sweep.lowest_mm + bottom_rise(std::sqrt(u * u + w_near * w_near), sweep.flat_mm, sweep.corner_mm) >= below) {
    return kNothing;
  }
  const auto derivative = [&](double place) {
    const double w = place - s;
    const double rho = std::sqrt(u * u + w * w);
    const double out = rho - sweep.flat_mm;
    if (out <= 0 || rho == 0) return climb;
    const double depth2 = sweep.corner_mm * sweep.corner_mm - out * out;
    if (depth2 <= 0) return w > 0 ? kNothing : -kNothing;
    return climb + out / std::sqrt(depth2) * w / rho;
  };
  double place = low;
  if (derivative(low) < 0) {
    place = high;
    if (derivative(high) > 0) {
      // Off by this much from the minimum, the height is off by its square over the corner's radius.
      constexpr double kPlace_mm = 1e-5;
      while (high - low > kPlace_mm) {
        const double middle = (low + high) / 2;
        (derivative(middle) > 0 ? high : low) = middle;
      }
      place = (low + high) / 2;
    }
  }
  const double w = place - s;
  return sweep.from.z() + climb * place + bottom_rise(std::sqrt(u * u + w * w), sweep.flat_mm, sweep.corner_mm);
}

}  // namespace

double Sweep::height(double x, double y, double below) const {
  const double dx = x - from.x();
  const double dy = y - from.y();
  const double s = dx * along_x + dy * along_y;
  const double u = dy * along_x - dx * along_y;
  switch (shape) {
    case Shape::kBall: {
      // The height over the node, seen as a function of where the ball is on its way, is convex; its minimum lies where
      // the contact is across the motion: s - r sine behind the node. Beyond an end the end's sphere is what counts.
      const double r2 = radius_mm * radius_mm - u * u;
      if (r2 < 0) return kNothing;
      const double r = std::sqrt(r2);
      const double place = s - r * sine;
      if (place > 0 && place < length_mm) return from.z() + place * inverse_length * rise_mm - r * cosine;
      const double w = place <= 0 ? s : s - length_mm;
      const double depth2 = r2 - w * w;
      if (depth2 < 0) return kNothing;
      return (place <= 0 ? from.z() : to.z()) - std::sqrt(depth2);
    }
    case Shape::kMill: {
      if (rise_mm != 0) return sloped_mill(*this, s, u, below);
      const double w = s < 0 ? s : std::max(0.0, s - length_mm);
      const double rho2 = u * u + w * w;
      if (rho2 > radius_mm * radius_mm) return kNothing;
      if (rho2 <= flat_mm * flat_mm) return from.z();
      return from.z() + bottom_rise(std::sqrt(rho2), flat_mm, corner_mm);
    }
    case Shape::kTilted:
      break;
  }
  return underside(body, from, to - from, axis, x, y);
}

// A path's envelope is the least of the heights of all its motions, and at every node that least height is a local
// minimum along the path: either inside a motion, which nodes of its slab have (the contact across the motion), or at a
// vertex where the height falls towards the vertex from both sides. For a ball at vertex v with contact direction q
// (from the centre), the latter reads q . before >= 0 and q . direction <= 0, so that -q . direction <= q . (before -
// direction) <= R |before - direction|. In the vertical plane through the motion, the contact of a node at distance u
// beside it is at q = r (sin phi, -cos phi), r^2 = R^2 - u^2, and q . direction = r sin(phi - beta), beta the climbing
// angle. The nodes of the wedge thus lie at s = r sin phi >= r sin beta - (1 + |sin beta|) R |before - direction|: this
// is back_mm.
double ball_wedge(const Vec3& before, const Vec3& direction, double radius_mm) {
  return 2 * radius_mm * std::min(1.0, (before - direction).norm());
}

SweptPoint swept_ball(const Vec3& from, const Vec3& to, double radius_mm, double x, double y) {
  const Vec3 d = to - from;
  const double length2 = d.x() * d.x() + d.y() * d.y();
  Vec3 centre = from;
  if (length2 > kVerticalMotion_mm * kVerticalMotion_mm) {
    const double length = std::sqrt(length2);
    const double s = ((x - from.x()) * d.x() + (y - from.y()) * d.y()) / length;
    const double u = ((y - from.y()) * d.x() - (x - from.x()) * d.y()) / length;
    const double r2 = radius_mm * radius_mm - u * u;
    if (r2 < 0) return {};
    const double place = (s - std::sqrt(r2) * d.z() / std::sqrt(length2 + d.z() * d.z())) / length;
    centre = from + std::clamp(place, 0.0, 1.0) * d;
  } else if (to.z() < from.z()) {
    centre = to;
  }
  const double qx = x - centre.x();
  const double qy = y - centre.y();
  const double depth2 = radius_mm * radius_mm - qx * qx - qy * qy;
  if (depth2 <= 0) return {};
  const double depth = std::sqrt(depth2);
  return {centre.z() - depth, qx / depth, qy / depth};
}

}  // namespace lightmill

#include "cam/outline.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "cam/outline_region.h"
#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kOffsetPitchMm = 0.05;  ///< of the places that a way around is made of
constexpr double kChordMm = 0.002;
constexpr double kStandOffMm = 0.003;  ///< beyond the radius: what chords cut off, those between the places, too
constexpr double kKeptMm = 6;  ///< outside the outline the surface is as fitted so far,
constexpr double kFadeMm = 8;  ///< and goes over into level ground within this, or more where it would fall steeper than this:
constexpr double kSteepest = 1;

double cross(const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); }

double signed_area(const std::vector<Vec2>& loop) {
  double twice = 0;
  for (std::size_t k = 0; k < loop.size(); ++k) twice += cross(loop[k], loop[(k + 1) % loop.size()]);
  return twice / 2;
}

bool cross_each_other(const Vec2& a, const Vec2& b, const Vec2& c, const Vec2& d) {
  const auto side = [](const Vec2& p, const Vec2& q, const Vec2& r) { return cross(q - p, r - p); };
  return side(a, b, c) * side(a, b, d) < 0 && side(c, d, a) * side(c, d, b) < 0;
}

std::vector<Vec2> corners(const Outline& outline) {
  const Vec2 h = outline.size_mm / 2;
  return {{-h.x(), -h.y()}, {h.x(), -h.y()}, {h.x(), h.y()}, {-h.x(), h.y()}};
}

/// From the outline; 0 inside it.
double distance_outside(const Outline& outline, const Vec2& place) {
  if (outline.shape == Outline::Shape::kRectangle) return (place.cwiseAbs() - outline.size_mm / 2).cwiseMax(0).norm();
  if (outline.contains(place)) return 0;
  return outline.shape == Outline::Shape::kDisk ? place.norm() - outline.size_mm.x() / 2 : distance_to_loop(outline.loop_mm, place);
}

/// As few of the places as leave the others within kChordMm of the polygon.
std::vector<Vec2> thinned_loop(const std::vector<Vec2>& places) {
  std::vector<Vec2> kept = {places.front()};
  std::size_t at = 0;
  while (at + 1 < places.size()) {
    std::size_t end = at + 1;
    for (std::size_t k = at + 2; k <= places.size() && k < at + 400; ++k) {
      const Vec2& target = places[k % places.size()];
      const Vec2 along = target - places[at];
      const double length = along.norm();
      bool near = length > 0;
      for (std::size_t m = at + 1; m < k && near; ++m) near = std::abs(cross(along, places[m] - places[at])) <= kChordMm * length;
      if (!near) break;
      end = k;
    }
    if (end >= places.size()) break;
    kept.push_back(places[end]);
    at = end;
  }
  return kept;
}

}  // namespace

bool Outline::contains(const Vec2& p) const {
  if (shape == Shape::kRectangle) return Box2::centred(size_mm).contains(p);
  if (shape == Shape::kDisk) return p.norm() <= size_mm.x() / 2;
  bool inside = false;
  for (std::size_t k = 0; k < loop_mm.size(); ++k) {
    const Vec2& a = loop_mm[k];
    const Vec2& b = loop_mm[(k + 1) % loop_mm.size()];
    if ((a.y() > p.y()) != (b.y() > p.y()) && p.x() < a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x())) inside = !inside;
  }
  return inside;
}

double Outline::area_mm2() const {
  if (shape == Shape::kRectangle) return size_mm.x() * size_mm.y();
  if (shape == Shape::kDisk) return kPi * size_mm.x() * size_mm.x() / 4;
  return signed_area(loop_mm);
}

Outline outline_of(const Lens& lens) {
  Outline outline;
  outline.size_mm = lens.size_mm;
  if (lens.shape == Lens::Shape::kRectangle) return outline;
  if (lens.shape == Lens::Shape::kDisk) {
    outline.shape = Outline::Shape::kDisk;
    return outline;
  }
  const auto refuse = [](const std::string& what) { throw InputError("lens.outline: " + what); };
  if (lens.outline_mm.size() != 1) {
    refuse("has " + std::to_string(lens.outline_mm.size()) +
           " loops; what is milled is one piece without holes (the design alone takes any: --until design)");
  }
  outline.shape = Outline::Shape::kLoop;
  for (const Vec2& p : lens.outline_mm.front()) {
    if (outline.loop_mm.empty() || (p - outline.loop_mm.back()).norm() > 1e-6) outline.loop_mm.push_back(p);
  }
  while (outline.loop_mm.size() > 1 && (outline.loop_mm.front() - outline.loop_mm.back()).norm() <= 1e-6) outline.loop_mm.pop_back();
  const std::vector<Vec2>& loop = outline.loop_mm;
  const std::size_t n = loop.size();
  if (n < 3 || signed_area(loop) == 0) refuse("encloses no area");
  for (std::size_t a = 0; a < n; ++a) {
    for (std::size_t b = a + 2; b < n; ++b) {
      if (cross_each_other(loop[a], loop[(a + 1) % n], loop[b], loop[(b + 1) % n])) {
        refuse("crosses itself near x " + fixed(loop[a].x(), 1) + ", y " + fixed(loop[a].y(), 1) + " mm; draw a shape that can be cut out");
      }
    }
  }
  if (signed_area(loop) < 0) std::reverse(outline.loop_mm.begin(), outline.loop_mm.end());
  return outline;
}

std::vector<Vec2> outline_places(const Outline& outline, double pitch_mm) {
  std::vector<Vec2> places;
  if (outline.shape == Outline::Shape::kDisk) {
    const double radius = outline.size_mm.x() / 2;
    const int count = std::max(16, static_cast<int>(std::ceil(2 * kPi * radius / pitch_mm)));
    for (int k = 0; k < count; ++k) places.emplace_back(radius * std::cos(2 * kPi * k / count), radius * std::sin(2 * kPi * k / count));
    return places;
  }
  const std::vector<Vec2> loop = outline.shape == Outline::Shape::kRectangle ? corners(outline) : outline.loop_mm;
  for (std::size_t k = 0; k < loop.size(); ++k) {
    const Vec2& a = loop[k];
    const Vec2& b = loop[(k + 1) % loop.size()];
    const int steps = std::max(1, static_cast<int>(std::ceil((b - a).norm() / pitch_mm)));
    for (int m = 0; m < steps; ++m) places.push_back(a + (b - a) * m / steps);
  }
  return places;
}

Outline with_land(const Outline& outline, double width_mm) {
  if (width_mm <= 0) return outline;
  Outline larger = outline;
  if (outline.shape == Outline::Shape::kLoop) {
    larger.loop_mm = way_around(outline, width_mm);
  } else {
    larger.size_mm += Vec2::Constant(2 * width_mm);
  }
  return larger;
}

std::vector<Vec2> way_around(const Outline& outline, double radius_mm) {
  if (outline.shape == Outline::Shape::kDisk) {
    Outline larger = outline;
    // Chords of the polygon stay outside.
    larger.size_mm += Vec2::Constant(2 * (radius_mm + kStandOffMm));
    return outline_places(larger, std::sqrt(8 * kChordMm * (outline.size_mm.x() / 2 + radius_mm)) * 0.99);
  }
  const std::vector<Vec2> loop = outline.shape == Outline::Shape::kRectangle ? corners(outline) : outline.loop_mm;
  const double radius = radius_mm + kStandOffMm;
  struct Candidate {
    Vec2 place;
    bool free = false;
  };
  std::vector<Candidate> candidates;
  for (std::size_t k = 0; k < loop.size(); ++k) {
    const Vec2& a = loop[k];
    const Vec2& b = loop[(k + 1) % loop.size()];
    const Vec2& c = loop[(k + 2) % loop.size()];
    const Vec2 along = (b - a).normalized();
    const Vec2 next = (c - b).normalized();
    const Vec2 out(along.y(), -along.x());
    const int steps = std::max(1, static_cast<int>(std::ceil((b - a).norm() / kOffsetPitchMm)));
    for (int m = 0; m <= steps; ++m) candidates.push_back({a + (b - a) * m / steps + radius * out});
    // Around a corner that stands out.
    const double turn = std::atan2(cross(along, next), along.dot(next));
    const int arc = static_cast<int>(turn > 0 ? std::ceil(turn * radius / kOffsetPitchMm) : 0);
    for (int m = 1; m < arc; ++m) {
      const double angle = turn * m / arc;
      candidates.push_back({b + radius * Vec2(std::cos(angle) * out.x() - std::sin(angle) * out.y(), std::sin(angle) * out.x() + std::cos(angle) * out.y())});
    }
  }
  const auto is_free = [&](const Vec2& p, double distance) { return !outline.contains(p) && distance_to_loop(loop, p) >= distance; };
  parallel_blocks(candidates.size(), 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) candidates[k].free = is_free(candidates[k].place, radius - 1e-6);
  });
  std::vector<Vec2> way;
  std::vector<std::size_t> origin;
  for (std::size_t k = 0; k < candidates.size(); ++k) {
    if (!candidates[k].free) continue;
    way.push_back(candidates[k].place);
    origin.push_back(k);
  }
  const auto refuse = [&](const Vec2& at) {
    throw InputError("lens.outline: a mill of radius " + compact(radius_mm, 3) + " mm does not get around it near x " + fixed(at.x(), 1) + ", y " +
                     fixed(at.y(), 1) + " mm; widen the neck there, or use a thinner mill");
  };
  if (way.size() < 3) refuse(loop.front());
  for (std::size_t k = 0; k < way.size(); ++k) {
    const std::size_t next = (k + 1) % way.size();
    if (origin[next] == origin[k] + 1) continue;
    const Vec2 middle = (way[k] + way[next]) / 2;
    if (!is_free(middle, radius - kChordMm)) refuse(middle);
  }
  return thinned_loop(way);
}

BorderHeights border_heights(const SplineSurface& surface, const Outline& outline) {
  BorderHeights heights{std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()};
  for (const Vec2& p : outline_places(outline, 0.1)) {
    const double h = surface.height(p.x(), p.y());
    heights.lowest_mm = std::min(heights.lowest_mm, h);
    heights.highest_mm = std::max(heights.highest_mm, h);
  }
  return heights;
}

SplineSurface faded_outside(const SplineSurface& surface, const Outline& outline, double drop_mm) {
  const BorderHeights border = border_heights(surface, outline);
  const double ground = border.lowest_mm, top = border.highest_mm;
  // What falls outwards from the border comes to rest on a floor, C2: from half of the drop on it bends.
  const double half_drop = std::min(drop_mm, std::max(ground, 0.0) / 2) / 2;
  const auto held = [&](double h) {
    if (h >= ground - half_drop) return h;
    const double u = half_drop > 0 ? std::max(0.0, (h - ground) / (2 * half_drop) + 1.5) : 0;
    return ground - 2 * half_drop + half_drop * u * u * u * (2 - u);
  };
  constexpr double kSteepestShare = 1.875;  // of the share's slope over the mean one
  const double fade_mm = std::max(kFadeMm, kSteepestShare * (top - ground) / kSteepest);
  const Vec2 span = surface.span_mm();
  const int padding = static_cast<int>(std::ceil((kKeptMm + fade_mm) / span.minCoeff())) + 3;
  Grid<double> padded = SplineSurface(surface.extent(), surface.spans_x(), surface.spans_y(), surface.coefficients(), padding).padded_coefficients();
  parallel_blocks(padded.height, 4, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int i = 0; i < padded.width; ++i) {
        const Vec2 place = surface.extent().min + span.cwiseProduct(Vec2(i - padding - 1, j - padding - 1));
        // Coefficients within two spans of the lens shape it.
        const double distance = distance_outside(outline, place);
        if (distance <= 2 * span.maxCoeff()) continue;
        double& c = padded.at(i, j);
        const double t = std::clamp((distance - kKeptMm) / fade_mm, 0.0, 1.0);
        const double share = t * t * t * (10 - t * (15 - 6 * t));  // C2 at both ends
        c = held(c) + share * (ground - held(c));
      }
    }
  });
  return SplineSurface::with_padded(surface.extent(), surface.spans_x(), surface.spans_y(), padding, std::move(padded));
}

}  // namespace lightmill

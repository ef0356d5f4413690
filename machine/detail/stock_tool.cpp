#include "machine/detail/stock_tool.h"

#include <algorithm>
#include <cmath>

namespace lightmill {

namespace {

/// Motions are halved until no point of the body moves farther than this, for the test that leaves out tiles.
constexpr double kLongestChunk_mm = 0.5;
/// After a hit the next pose looked at is this far on: what counts is that, where and about how deep.
constexpr double kAfterHit_mm = 1.0;
/// With more suspicious tiles than this under one pose only every fourth node is looked at.
constexpr int kManyTiles = 1000;

ToolPose between(const ToolPose& a, const ToolPose& b, double t) {
  return {a.tip_mm + t * (b.tip_mm - a.tip_mm), (a.axis + t * (b.axis - a.axis)).normalized()};
}

/// The farthest that any point of the body moves.
double travel(const Frustum& body, const ToolPose& a, const ToolPose& b) {
  const Vec3 turn = b.axis - a.axis;
  const Vec3 tip = b.tip_mm - a.tip_mm;
  return std::max((tip + body.from_mm * turn).norm(), (tip + body.to_mm * turn).norm()) +
         std::max(body.from_radius_mm, body.to_radius_mm) * turn.norm();
}

struct Bounds {
  Box2 above;
  double lowest = kNothing;
};

Bounds bounds(const Frustum& body, const ToolPose& pose, double margin_mm) {
  Bounds result;
  const Vec3 across = (Vec3::Ones() - pose.axis.cwiseProduct(pose.axis)).cwiseMax(0).cwiseSqrt();
  for (const auto& [height, radius] :
       {std::pair(body.from_mm, body.from_radius_mm), std::pair(body.to_mm, body.to_radius_mm)}) {
    const Vec3 centre = pose.tip_mm + height * pose.axis;
    const Vec3 half = radius * across + Vec3::Constant(margin_mm);
    result.above.include((centre - half).head<2>());
    result.above.include((centre + half).head<2>());
    result.lowest = std::min(result.lowest, centre.z() - half.z());
  }
  return result;
}

}  // namespace

Tool::Tool(const Cutter& cutter)
    : radius_mm(cutter.radius_mm()),
      corner_mm(std::min(cutter.corner_radius_mm, cutter.radius_mm())),
      flute_length_mm(std::max(cutter.flute_length_mm, corner_mm)),
      spread(std::tan(cutter.taper_rad)),
      side_from_mm(corner_mm * (1 - std::sin(cutter.taper_rad))),
      ball(cutter.is_ball()) {
  const auto add = [this](Part part, Frustum body) {
    const double height = body.to_mm - body.from_mm;
    if (height <= 0) return;
    const int pieces = std::clamp(static_cast<int>(std::ceil(height / std::max(radius_mm, 0.5))), 1, 64);
    for (int k = 0; k < pieces; ++k) {
      const auto at = [&](double t) { return body.from_radius_mm + t * (body.to_radius_mm - body.from_radius_mm); };
      const double a = static_cast<double>(k) / pieces;
      const double b = static_cast<double>(k + 1) / pieces;
      const Frustum piece{body.from_mm + a * height, body.from_mm + b * height, at(a), at(b)};
      if (!piece.empty()) slices.push_back({part, piece});
    }
  };
  const double from_radius = radius_mm - corner_mm + corner_mm * std::cos(cutter.taper_rad);
  add(Part::kFlutes, {side_from_mm, flute_length_mm, from_radius, from_radius + (flute_length_mm - side_from_mm) * spread});
  double shank_end = cutter.length_mm;
  for (const ToolPiece& piece : cutter.holder) shank_end = std::min(shank_end, piece.from_mm);
  const double shank = cutter.shank_diameter_mm / 2;
  double reached = flute_length_mm;
  for (const ToolPiece& piece : cutter.shank) {
    add(Part::kShank, {piece.from_mm, piece.to_mm, piece.from_radius_mm, piece.to_radius_mm});
    reached = std::max(reached, piece.to_mm);
  }
  add(Part::kShank, {reached, shank_end, shank, shank});
  for (const ToolPiece& piece : cutter.holder) {
    add(piece.from_mm >= cutter.length_mm ? Part::kNose : Part::kHolder, {piece.from_mm, piece.to_mm, piece.from_radius_mm, piece.to_radius_mm});
  }
}

namespace {

/// Calls visit(i, j, top, centre) for the tiles over a rectangle that stand higher than `lowest`, until it says true.
template <typename Visit>
bool any_tile(const StockField& field, const Box2& above, double lowest, Visit&& visit) {
  const StockField::TileRange tiles = field.tiles(above);
  for (int j = tiles.j0; j <= tiles.j1; ++j) {
    for (int i = tiles.i0; i <= tiles.i1; ++i) {
      const double top = field.tile_highest(i, j);
      if (top > lowest && visit(i, j, top, field.tile_centre(i, j))) return true;
    }
  }
  return false;
}

template <typename Visit>
bool any_tile(const SolidStock& solid, const Box2& above, double lowest, Visit&& visit) {
  constexpr int kTile = SolidStock::kTile;
  const auto columns = solid.cells(0, above.min.x(), above.max.x()), rows = solid.cells(1, above.min.y(), above.max.y());
  if (columns.empty() || rows.empty()) return false;
  const Vec2 to_middle = (kTile - 1) / 2.0 * solid.pitch_mm().head<2>();
  for (int j = rows.from / kTile; j <= rows.to / kTile; ++j) {
    for (int i = columns.from / kTile; i <= columns.to / kTile; ++i) {
      const double top = solid.tile_highest(i, j);
      const Vec2 centre = Vec2(solid.place_mm(0, i * kTile), solid.place_mm(1, j * kTile)) + to_middle;
      if (top > lowest && visit(i, j, top, centre)) return true;
    }
  }
  return false;
}

/// From a tile's centre to its farthest nodes.
double half_diagonal(const StockField& field) { return field.tile_half_mm() * std::sqrt(2.0); }
double half_diagonal(const SolidStock& solid) { return (SolidStock::kTile - 1) / 2.0 * solid.pitch_mm().head<2>().norm(); }

template <typename Stock>
bool may_touch_tiles(const Stock& stock, const Frustum& body, const ToolPose& from, const ToolPose& to, double margin_mm) {
  const double way = travel(body, from, to) / 2;
  const ToolPose middle = between(from, to, 0.5);
  const Bounds box = bounds(body, middle, std::max(0.0, margin_mm) + way);
  if (box.lowest >= stock.highest(box.above)) return false;
  if (2 * way > kLongestChunk_mm) {
    return may_touch_tiles(stock, body, from, middle, margin_mm) || may_touch_tiles(stock, body, middle, to, margin_mm);
  }
  // Tile by tile: a body that reaches a tile's nodes reaches, grown by the tile's half diagonal, its centre.
  const Frustum grown = body.grown(std::max(0.0, margin_mm) + way + half_diagonal(stock));
  return any_tile(stock, box.above, box.lowest, [&](int, int, double top, const Vec2& centre) {
    return underside(grown, middle.tip_mm, middle.axis, centre.x(), centre.y()) < top;
  });
}

/// The tiles whose material the body may meet where it stands.
template <typename Stock>
std::vector<std::pair<int, int>> tiles_met(const Stock& stock, const Frustum& body, const ToolPose& pose, const Bounds& box, double margin_mm) {
  std::vector<std::pair<int, int>> met;
  const Frustum around_tile = body.grown(std::max(0.0, margin_mm) + half_diagonal(stock));
  any_tile(stock, box.above, box.lowest, [&](int i, int j, double top, const Vec2& centre) {
    if (underside(around_tile, pose.tip_mm, pose.axis, centre.x(), centre.y()) < top) met.emplace_back(i, j);
    return false;
  });
  return met;
}

}  // namespace

bool may_touch(const StockField& field, const Frustum& body, const ToolPose& from, const ToolPose& to, double margin_mm) {
  return may_touch_tiles(field, body, from, to, margin_mm);
}

bool may_touch(const SolidStock& solid, const Frustum& body, const ToolPose& from, const ToolPose& to, double margin_mm) {
  return may_touch_tiles(solid, body, from, to, margin_mm);
}

StockField::Probe touch(const StockField& field, const Frustum& body, const ToolPose& from, const ToolPose& to,
                        double margin_mm) {
  StockField::Probe deepest;
  const double way = travel(body, from, to);
  const int steps = static_cast<int>(std::ceil(way / kCheckSpacing_mm));
  const int skip = steps > 0 ? std::max(1, static_cast<int>(kAfterHit_mm / (way / steps))) : 1;
  const Frustum exact = body.grown(margin_mm);
  if (exact.empty()) return deepest;
  for (int k = 0; k <= steps; ++k) {
    const ToolPose pose = between(from, to, steps > 0 ? static_cast<double>(k) / steps : 0.0);
    const Bounds box = bounds(body, pose, std::max(0.0, margin_mm));
    if (box.lowest >= field.highest(box.above)) continue;
    const std::vector<std::pair<int, int>> suspicious = tiles_met(field, body, pose, box, margin_mm);
    const int stride = static_cast<int>(suspicious.size()) > kManyTiles ? 4 : 1;
    bool hit = false;
    for (const auto& [ti, tj] : suspicious) {
      for (int j = tj * kTileNodes; j < std::min((tj + 1) * kTileNodes, field.heights().height); j += stride) {
        for (int i = ti * kTileNodes; i < std::min((ti + 1) * kTileNodes, field.heights().width); i += stride) {
          const double low = underside(exact, pose.tip_mm, pose.axis, field.x(i), field.y(j));
          const double depth = field.heights().at(i, j) - low;
          if (depth <= 0) continue;
          hit = true;
          if (depth > deepest.depth_mm) deepest = {depth, {field.x(i), field.y(j), std::max(low, 0.0)}};
        }
      }
    }
    if (hit && k < steps) k = std::min(k + skip, steps) - 1;
  }
  return deepest;
}

StockField::Probe touch(const SolidStock& solid, const Frustum& body, const ToolPose& from, const ToolPose& to,
                        double margin_mm) {
  StockField::Probe deepest;
  const Frustum exact = body.grown(margin_mm);
  if (exact.empty()) return deepest;
  const int steps = static_cast<int>(std::ceil(travel(body, from, to) / kCheckSpacing_mm));
  for (int k = 0; k <= steps; ++k) {
    const ToolPose pose = between(from, to, steps > 0 ? static_cast<double>(k) / steps : 0.0);
    const Bounds box = bounds(exact, pose, 0);
    if (box.lowest >= solid.highest(box.above)) continue;
    // In a mirror the upper side is an underside.
    const Vec3 mirror(1, 1, -1);
    const Vec3 mirrored_tip = pose.tip_mm.cwiseProduct(mirror), mirrored_axis = pose.axis.cwiseProduct(mirror);
    const RayBundle& rays = solid.rays(2);
    for (const auto& [ti, tj] : tiles_met(solid, body, pose, box, margin_mm)) {
      for (int j = tj * SolidStock::kTile; j < std::min((tj + 1) * SolidStock::kTile, rays.rows()); ++j) {
        for (int i = ti * SolidStock::kTile; i < std::min((ti + 1) * SolidStock::kTile, rays.columns()); ++i) {
          const auto spans = rays.at(i, j);
          if (spans.empty() || spans.back().to <= box.lowest) continue;
          const double x = solid.place_mm(0, i), y = solid.place_mm(1, j);
          const double bottom = underside(exact, pose.tip_mm, pose.axis, x, y);
          if (bottom >= spans.back().to) continue;
          const double top = -underside(exact, mirrored_tip, mirrored_axis, x, y);
          for (const Span& span : spans) {
            const double low = std::max<double>(span.from, bottom);
            const double depth = std::min<double>(span.to, top) - low;
            if (depth > deepest.depth_mm) deepest = {depth, {x, y, low}};
          }
        }
      }
    }
  }
  return deepest;
}

}  // namespace lightmill

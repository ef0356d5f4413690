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

bool may_touch(const StockField& field, const Frustum& body, const ToolPose& from, const ToolPose& to,
               double margin_mm) {
  const double way = travel(body, from, to) / 2;
  const ToolPose middle = between(from, to, 0.5);
  const Bounds box = bounds(body, middle, std::max(0.0, margin_mm) + way);
  if (box.lowest >= field.highest() || box.lowest >= field.highest(box.above)) return false;
  if (2 * way > kLongestChunk_mm) {
    return may_touch(field, body, from, middle, margin_mm) || may_touch(field, body, middle, to, margin_mm);
  }
  // Tile by tile: a body that reaches a tile's nodes reaches, grown by the tile's half diagonal, its centre.
  const Frustum grown = body.grown(std::max(0.0, margin_mm) + way + field.tile_half_mm() * std::sqrt(2.0));
  const StockField::TileRange tiles = field.tiles(box.above);
  for (int j = tiles.j0; j <= tiles.j1; ++j) {
    for (int i = tiles.i0; i <= tiles.i1; ++i) {
      const double top = field.tile_highest(i, j);
      if (top <= box.lowest) continue;
      const Vec2 centre = field.tile_centre(i, j);
      if (underside(grown, middle.tip_mm, middle.axis, centre.x(), centre.y()) < top) return true;
    }
  }
  return false;
}

StockField::Probe touch(const StockField& field, const Frustum& body, const ToolPose& from, const ToolPose& to,
                        double margin_mm) {
  StockField::Probe deepest;
  const double way = travel(body, from, to);
  const int steps = static_cast<int>(std::ceil(way / kCheckSpacing_mm));
  const int skip = steps > 0 ? std::max(1, static_cast<int>(kAfterHit_mm / (way / steps))) : 1;
  const Frustum exact = body.grown(margin_mm);
  if (exact.empty()) return deepest;
  const Frustum around_tile = body.grown(std::max(0.0, margin_mm) + field.tile_half_mm() * std::sqrt(2.0));
  std::vector<std::pair<int, int>> suspicious;
  for (int k = 0; k <= steps; ++k) {
    const ToolPose pose = between(from, to, steps > 0 ? static_cast<double>(k) / steps : 0.0);
    const Bounds box = bounds(body, pose, std::max(0.0, margin_mm));
    if (box.lowest >= field.highest(box.above)) continue;
    suspicious.clear();
    const StockField::TileRange tiles = field.tiles(box.above);
    for (int j = tiles.j0; j <= tiles.j1; ++j) {
      for (int i = tiles.i0; i <= tiles.i1; ++i) {
        const double top = field.tile_highest(i, j);
        if (top <= box.lowest) continue;
        const Vec2 centre = field.tile_centre(i, j);
        if (underside(around_tile, pose.tip_mm, pose.axis, centre.x(), centre.y()) < top) suspicious.emplace_back(i, j);
      }
    }
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

}  // namespace lightmill

#include "cam/detail/tool_clearance.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace lightmill::detail {

namespace {

/// In a cell, each way: where the flank is held against the surface itself.
constexpr int kFlankPlaces = 5;
/// The flank keeps this far above the surface: more than it can miss between those places on radii down to its own.
constexpr double kFlankClearMm = 0.002;

enum class Part { kFlutes, kFlank, kShank, kHolder };

/// A cone about the tool's axis with its bounding box.
struct Body {
  ToolPiece piece;
  Part part = Part::kShank;
  Vec3 low, high;
};

Body body(const ToolPose& pose, const ToolPiece& piece, Part part) {
  Body b{piece, part, {}, {}};
  const Vec3 from = pose.tip_mm + piece.from_mm * pose.axis;
  const Vec3 to = pose.tip_mm + piece.to_mm * pose.axis;
  for (int k = 0; k < 3; ++k) {
    const double share = std::sqrt(std::max(0.0, 1 - pose.axis[k] * pose.axis[k]));
    b.low[k] = std::min(from[k] - share * piece.from_radius_mm, to[k] - share * piece.to_radius_mm);
    b.high[k] = std::max(from[k] + share * piece.from_radius_mm, to[k] + share * piece.to_radius_mm);
  }
  return b;
}

/// Lowest point of a cone over (x, y): infinity beside it. A vertical line meets a convex body in one interval.
double underside(const ToolPiece& cone, const ToolPose& pose, double x, double y) {
  constexpr double kBeside = std::numeric_limits<double>::infinity();
  const Vec3& a = pose.axis;
  const Vec3 w = Vec3(x, y, 0) - pose.tip_mm;
  const double spread = (cone.to_radius_mm - cone.from_radius_mm) / (cone.to_mm - cone.from_mm);
  // Along w + z e: height above the tip along the axis wa + z a_z, which the cone's ends bound; the axis points upwards.
  const double wa = w.dot(a);
  double low = -kBeside;
  double high = kBeside;
  if (a.z() > 1e-9) {
    low = (cone.from_mm - wa) / a.z();
    high = (cone.to_mm - wa) / a.z();
  } else if (wa < cone.from_mm || wa > cone.to_mm) {
    return kBeside;
  }
  // |w + z e|^2 - (wa + z a_z)^2 <= (r + spread (wa + z a_z - from))^2: q(z) = qa z^2 + 2 qb z + qc <= 0.
  const double r = cone.from_radius_mm + spread * (wa - cone.from_mm);
  const double qa = 1 - a.z() * a.z() - spread * spread * a.z() * a.z();
  const double qb = w.z() - wa * a.z() - spread * a.z() * r;
  const double qc = w.squaredNorm() - wa * wa - r * r;
  if (std::isfinite(low) && (qa * low + 2 * qb) * low + qc <= 0) return low;
  // Else the interval begins at a root, the first one within the ends.
  std::array<double, 2> roots{};
  if (std::abs(qa) < 1e-12) {
    if (std::abs(qb) < 1e-12) return kBeside;
    roots.fill(-qc / (2 * qb));
  } else {
    const double square = qb * qb - qa * qc;
    if (square < 0) return kBeside;
    roots = {(-qb - std::sqrt(square)) / qa, (-qb + std::sqrt(square)) / qa};
    if (roots[0] > roots[1]) std::swap(roots[0], roots[1]);
  }
  for (const double z : roots) {
    if (z >= low && z <= high) return z;
  }
  return kBeside;
}

}  // namespace

ToolClearance::ToolClearance(const SplineSurface& surface, const Blank& blank, double above_surface_mm, double cell_mm,
                             const RestMaterial* standing)
    : surface_(&surface), above_mm_(above_surface_mm), cell_mm_(cell_mm) {
  Box2 material = Box2::centred(blank.size_mm);
  material.include(surface.extent().min);
  material.include(surface.extent().max);
  Box2 box = material;
  for (const KeepOut& k : blank.keep_outs) {
    box.include(k.min_mm.head<2>());
    box.include(k.max_mm.head<2>());
  }
  first_ = box.min;
  const int nx = std::max(1, static_cast<int>(std::ceil(box.size().x() / cell_mm_)));
  const int ny = std::max(1, static_cast<int>(std::ceil(box.size().y() / cell_mm_)));
  Level level{cell_mm_, Grid<float>(nx, ny)};
  std::vector<double> row_below(nx + 1), row_above(nx + 1);
  const auto fill = [&](std::vector<double>& row, int j) {
    for (int i = 0; i <= nx; ++i) row[i] = surface.height(first_.x() + i * cell_mm_, first_.y() + j * cell_mm_);
  };
  fill(row_below, 0);
  for (int j = 0; j < ny; ++j) {
    fill(row_above, j + 1);
    for (int i = 0; i < nx; ++i) {
      const double highest = std::max({row_below[i], row_below[i + 1], row_above[i], row_above[i + 1]});
      const bool in_blank = material.contains(first_ + cell_mm_ * Vec2(i + 0.5, j + 0.5));
      level.highest.at(i, j) = in_blank ? static_cast<float>(highest + above_surface_mm) : -std::numeric_limits<float>::infinity();
    }
    row_below.swap(row_above);
  }
  stand_up(blank.keep_outs, level.highest);
  if (standing) {
    Level higher = level;
    const Grid<float>& h = standing->heights_mm;
    const Vec2 pitch = standing->extent.size().cwiseQuotient(Vec2(h.width - 1, h.height - 1));
    for (int j = 0; j < ny; ++j) {
      for (int i = 0; i < nx; ++i) {
        // Every node over the cell, and those around it.
        const Vec2 low = (first_ + cell_mm_ * Vec2(i, j) - standing->extent.min).cwiseQuotient(pitch).array().floor();
        const Vec2 high = (first_ + cell_mm_ * Vec2(i + 1, j + 1) - standing->extent.min).cwiseQuotient(pitch).array().ceil();
        for (int b = static_cast<int>(std::max(0.0, low.y())); b <= std::min(h.height - 1.0, high.y()); ++b) {
          for (int a = static_cast<int>(std::max(0.0, low.x())); a <= std::min(h.width - 1.0, high.x()); ++a) {
            higher.highest.at(i, j) = std::max(higher.highest.at(i, j), h.at(a, b));
          }
        }
      }
    }
    standing_ = pyramid(std::move(higher));
  }
  levels_ = pyramid(std::move(level));
}

ToolClearance::ToolClearance(const std::vector<KeepOut>& keep_outs) {
  Box2 box;
  for (const KeepOut& k : keep_outs) {
    box.include(k.min_mm.head<2>());
    box.include(k.max_mm.head<2>());
  }
  first_ = box.min;
  const Vec2 cells = (box.size() / cell_mm_).array().ceil().cwiseMax(1);
  Level level{cell_mm_, Grid<float>(static_cast<int>(cells.x()), static_cast<int>(cells.y()), -std::numeric_limits<float>::infinity())};
  stand_up(keep_outs, level.highest);
  levels_ = pyramid(std::move(level));
}

void ToolClearance::stand_up(const std::vector<KeepOut>& keep_outs, Grid<float>& highest) const {
  for (const KeepOut& k : keep_outs) {
    const Vec2 from = (k.min_mm.head<2>() - first_) / cell_mm_;
    const Vec2 to = (k.max_mm.head<2>() - first_) / cell_mm_;
    for (int j = std::max(0, static_cast<int>(std::floor(from.y()))); j < std::min<double>(highest.height, std::ceil(to.y() - 1e-9)); ++j) {
      for (int i = std::max(0, static_cast<int>(std::floor(from.x()))); i < std::min<double>(highest.width, std::ceil(to.x() - 1e-9)); ++i) {
        highest.at(i, j) = std::max(highest.at(i, j), static_cast<float>(k.max_mm.z()));
      }
    }
  }
}

std::vector<ToolClearance::Level> ToolClearance::pyramid(Level finest) {
  std::vector<Level> levels;
  levels.push_back(std::move(finest));
  while (levels.back().highest.width > 1 || levels.back().highest.height > 1) {
    const Level& fine = levels.back();
    Level coarse{2 * fine.cell_mm, Grid<float>((fine.highest.width + 1) / 2, (fine.highest.height + 1) / 2,
                                               -std::numeric_limits<float>::infinity())};
    for (int j = 0; j < fine.highest.height; ++j) {
      for (int i = 0; i < fine.highest.width; ++i) {
        float& cell = coarse.highest.at(i / 2, j / 2);
        cell = std::max(cell, fine.highest.at(i, j));
      }
    }
    levels.push_back(std::move(coarse));
  }
  return levels;
}

std::optional<ToolContact> ToolClearance::touches(const Cutter& cutter, const ToolPose& pose, double holder_mm, bool with_tip) const {
  // Short pieces have tight boxes.
  constexpr double kSliceMm = 4;
  std::vector<Body> bodies;
  const auto add = [&](const ToolPiece& whole, Part part) {
    const double length = whole.to_mm - whole.from_mm;
    const int slices = static_cast<int>(std::ceil(length / kSliceMm));
    const auto at = [&](double t) { return whole.from_radius_mm + (whole.to_radius_mm - whole.from_radius_mm) * t; };
    for (int k = 0; k < slices; ++k) {
      const double t0 = static_cast<double>(k) / slices;
      const double t1 = static_cast<double>(k + 1) / slices;
      bodies.push_back(body(pose, {whole.from_mm + length * t0, whole.from_mm + length * t1, at(t0), at(t1)}, part));
    }
  };
  const double shank_end = cutter.reach_mm();
  double reached = std::clamp(cutter.flute_length_mm, cutter.side_from_mm(), shank_end);
  if (with_tip) add({0, cutter.side_from_mm(), cutter.radius_mm(), cutter.radius_mm()}, Part::kShank);
  add({cutter.side_from_mm(), reached, cutter.flute_radius_mm(cutter.side_from_mm()), cutter.flute_radius_mm(reached)},
      surface_ && cutter.taper_rad > 0 ? Part::kFlank : Part::kFlutes);
  for (const ToolPiece& piece : cutter.shank) {
    add(piece, Part::kShank);
    reached = piece.to_mm;
  }
  add({reached, shank_end, cutter.shank_diameter_mm / 2, cutter.shank_diameter_mm / 2}, Part::kShank);
  for (const ToolPiece& piece : cutter.holder) {
    add({piece.from_mm - holder_mm, piece.to_mm, piece.from_radius_mm + holder_mm, piece.to_radius_mm + holder_mm}, Part::kHolder);
  }

  // The highest place of a cell counts as all of it; a flank, which passes close to what the ball rests on, is held against
  // the surface itself.
  const auto contact = [&](const Body& b, double x0, double y0, double top) -> std::optional<ToolContact> {
    if (b.part != Part::kFlank) {
      const double x = x0 + cell_mm_ / 2;
      const double y = y0 + cell_mm_ / 2;
      if (underside(b.piece, pose, x, y) < top) return ToolContact{{x, y, top}, b.part == Part::kHolder};
      return std::nullopt;
    }
    const double flank_mm = cell_mm_ / kFlankPlaces;
    for (double y = y0 + flank_mm / 2; y < y0 + cell_mm_; y += flank_mm) {
      for (double x = x0 + flank_mm / 2; x < x0 + cell_mm_; x += flank_mm) {
        const double low = underside(b.piece, pose, x, y);
        if (low >= top + kFlankClearMm) continue;
        const double z = surface_->height(x, y) + above_mm_;
        if (low < z + kFlankClearMm) return ToolContact{{x, y, z}, false};
      }
    }
    return std::nullopt;
  };

  struct Node {
    int level, i, j;
  };
  std::vector<Node> open;
  for (const Body& piece : bodies) {
    const bool rubs = piece.part == Part::kShank || piece.part == Part::kHolder;
    const std::vector<Level>& levels = rubs && !standing_.empty() ? standing_ : levels_;
    open.assign(1, {static_cast<int>(levels.size()) - 1, 0, 0});
    while (!open.empty()) {
      const Node node = open.back();
      open.pop_back();
      const Level& level = levels[node.level];
      const double top = level.highest.at(node.i, node.j);
      if (piece.low.z() >= top + kFlankClearMm) continue;
      const double x0 = first_.x() + node.i * level.cell_mm;
      const double y0 = first_.y() + node.j * level.cell_mm;
      if (piece.high.x() < x0 || piece.low.x() > x0 + level.cell_mm || piece.high.y() < y0 ||
          piece.low.y() > y0 + level.cell_mm) {
        continue;
      }
      if (node.level == 0) {
        if (auto found = contact(piece, x0, y0, top)) return found;
        continue;
      }
      const Level& fine = levels[node.level - 1];
      for (int dj = 0; dj < 2; ++dj) {
        for (int di = 0; di < 2; ++di) {
          const int i = 2 * node.i + di;
          const int j = 2 * node.j + dj;
          if (i < fine.highest.width && j < fine.highest.height) open.push_back({node.level - 1, i, j});
        }
      }
    }
  }
  return std::nullopt;
}

}  // namespace lightmill::detail

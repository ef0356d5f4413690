#include "cam/detail/tool_clearance.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace lightmill::detail {

namespace {

/// A piece of the tool: all points at [from, to] along the axis from the tip and within `radius` of it.
struct Cylinder {
  double from = 0, to = 0, radius = 0;
  bool holder = false;
  Vec3 low, high;  // bounding box
};

Cylinder cylinder(const ToolPose& pose, double from, double to, double radius, bool holder) {
  Cylinder c{from, to, radius, holder, {}, {}};
  const Vec3 a = pose.tip_mm + from * pose.axis;
  const Vec3 b = pose.tip_mm + to * pose.axis;
  for (int k = 0; k < 3; ++k) {
    const double rim = radius * std::sqrt(std::max(0.0, 1 - pose.axis[k] * pose.axis[k]));
    c.low[k] = std::min(a[k], b[k]) - rim;
    c.high[k] = std::max(a[k], b[k]) + rim;
  }
  return c;
}

/// Whether the column below (x, y, top) meets the cylinder.
bool meets(const Cylinder& c, const ToolPose& pose, double x, double y, double top) {
  const Vec3& a = pose.axis;
  const Vec3 w = Vec3(x, y, 0) - pose.tip_mm;
  double low = -std::numeric_limits<double>::infinity();
  double high = -low;
  // |w + z e - ((w + z e) . a) a|^2 <= r^2, a quadratic in z.
  const double wa = w.dot(a);
  const double qa = 1 - a.z() * a.z();
  const double qb = w.z() - wa * a.z();
  const double qc = w.squaredNorm() - wa * wa - c.radius * c.radius;
  if (qa < 1e-12) {
    if (qc > 0) return false;
  } else {
    const double root = qb * qb - qa * qc;
    if (root < 0) return false;
    low = (-qb - std::sqrt(root)) / qa;
    high = (-qb + std::sqrt(root)) / qa;
  }
  // from <= wa + z a_z <= to; the axis points upwards.
  if (a.z() > 1e-9) {
    low = std::max(low, (c.from - wa) / a.z());
    high = std::min(high, (c.to - wa) / a.z());
  } else if (wa < c.from || wa > c.to) {
    return false;
  }
  return low <= high && low < top;
}

}  // namespace

ToolClearance::ToolClearance(const SplineSurface& surface, const Blank& blank, double above_surface_mm, double cell_mm) : cell_mm_(cell_mm) {
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
  add_pyramid(std::move(level));
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
  add_pyramid(std::move(level));
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

void ToolClearance::add_pyramid(Level level) {
  levels_.push_back(std::move(level));
  while (levels_.back().highest.width > 1 || levels_.back().highest.height > 1) {
    const Level& fine = levels_.back();
    Level coarse{2 * fine.cell_mm, Grid<float>((fine.highest.width + 1) / 2, (fine.highest.height + 1) / 2,
                                               -std::numeric_limits<float>::infinity())};
    for (int j = 0; j < fine.highest.height; ++j) {
      for (int i = 0; i < fine.highest.width; ++i) {
        float& cell = coarse.highest.at(i / 2, j / 2);
        cell = std::max(cell, fine.highest.at(i, j));
      }
    }
    levels_.push_back(std::move(coarse));
  }
}

std::optional<ToolContact> ToolClearance::touches(const Cutter& cutter, const ToolPose& pose, double holder_mm, bool with_tip) const {
  // Short pieces have tight boxes.
  constexpr double kSliceMm = 4;
  std::vector<Cylinder> pieces;
  const auto add = [&](double from, double to, double r_from, double r_to, bool holder) {
    // A slice is as wide as its wider end; near the part that must not matter.
    const double steps = std::max((to - from) / kSliceMm, holder ? 0 : std::abs(r_to - r_from) / 0.02);
    const int slices = std::max(1, static_cast<int>(std::ceil(steps)));
    for (int k = 0; k < slices; ++k) {
      const double t0 = static_cast<double>(k) / slices;
      const double t1 = static_cast<double>(k + 1) / slices;
      const double radius = std::max(r_from + (r_to - r_from) * t0, r_from + (r_to - r_from) * t1);
      pieces.push_back(cylinder(pose, from + (to - from) * t0, from + (to - from) * t1, radius, holder));
    }
  };
  const double shank_end = cutter.holder.empty() ? cutter.length_mm : cutter.holder.front().from_mm;
  const double flute_end = std::clamp(cutter.flute_length_mm, cutter.corner_radius_mm, shank_end);
  if (with_tip) add(0, cutter.corner_radius_mm, cutter.radius_mm(), cutter.radius_mm(), false);
  add(cutter.corner_radius_mm, flute_end, cutter.flute_radius_mm(cutter.corner_radius_mm), cutter.flute_radius_mm(flute_end), false);
  add(flute_end, shank_end, cutter.shank_diameter_mm / 2, cutter.shank_diameter_mm / 2, false);
  for (const HolderPiece& piece : cutter.holder) {
    add(piece.from_mm - holder_mm, piece.to_mm, piece.from_radius_mm + holder_mm, piece.to_radius_mm + holder_mm, true);
  }

  struct Node {
    int level, i, j;
  };
  std::vector<Node> open;
  for (const Cylinder& piece : pieces) {
    open.assign(1, {static_cast<int>(levels_.size()) - 1, 0, 0});
    while (!open.empty()) {
      const Node node = open.back();
      open.pop_back();
      const Level& level = levels_[node.level];
      const double top = level.highest.at(node.i, node.j);
      if (piece.low.z() >= top) continue;
      const double x0 = first_.x() + node.i * level.cell_mm;
      const double y0 = first_.y() + node.j * level.cell_mm;
      if (piece.high.x() < x0 || piece.low.x() > x0 + level.cell_mm || piece.high.y() < y0 ||
          piece.low.y() > y0 + level.cell_mm) {
        continue;
      }
      if (node.level == 0) {
        const double x = x0 + level.cell_mm / 2;
        const double y = y0 + level.cell_mm / 2;
        if (meets(piece, pose, x, y, top)) return ToolContact{{x, y, top}, piece.holder};
        continue;
      }
      const Level& fine = levels_[node.level - 1];
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

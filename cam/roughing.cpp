#include "cam/roughing.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "cam/detail/feeds.h"
#include "cam/work_holding.h"
#include "design/core/errors.h"
#include "design/core/grid.h"
#include "design/core/parallel.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

constexpr double kPitchMm = 0.25;         ///< of the height grid, at most
constexpr double kTouchMm = 0.02;         ///< less material than this above the cutter's surface is none
constexpr double kRampSlope = 0.0524;     ///< 3 degrees: the steepest way down with the centre in material
constexpr double kCoreShare = 0.5;        ///< of the radius that must not be pushed down into material
constexpr double kGapMm = 10;             ///< stretches nearer than this are milled as one
constexpr double kOtherWayMm = 2;         ///< milled as one, too, where what is between asks for the other way
constexpr double kAboveMm = 1;            ///< of links above material
constexpr double kBesideMm = 1;           ///< of entries beside the block, over contact
constexpr double kShortLinkMm = 30;       ///< a longer way back is a rapid at full clearance
constexpr double kFinalScallopMm = 0.25;  ///< aim for what the last raster leaves between its lines
constexpr double kLeastFinalMm = 0.5;     ///< between them
constexpr int kMostRasters = 400;         ///< of a level, each 3 degrees or a slot's depth deeper in a pit
constexpr double kLiftMm = 0.1;           ///< a higher step is climbed before the cut
constexpr double kDeepestShare = 1.3;     ///< of the stepdown: what a cut may reach where lines left steps
constexpr double kShankAirMm = 0.2;       ///< between a shank wider than the mill and what stands
constexpr double kSideMm = 0.75;          ///< of the cut's width on one side of the axis: less is none ...
constexpr double kSideDepthMm = 0.05;     ///< ... and shallower than this
constexpr float kNothing = -1e6f;

/// Height of the cutter's surface above its tip at distance r from the axis.
double profile(const Cutter& mill, double r) {
  const double flat = mill.radius_mm() - mill.corner_radius_mm;
  if (r <= flat) return 0;
  const double c = mill.corner_radius_mm;
  const double d = std::min(r - flat, c);
  return c - std::sqrt(std::max(0.0, c * c - d * d));
}

/// What of the cutter is above its flutes, the holder apart.
std::vector<ToolPiece> shank_pieces(const Cutter& mill) {
  std::vector<ToolPiece> pieces = mill.shank;
  const double from = pieces.empty() ? mill.flute_length_mm : pieces.back().to_mm;
  pieces.push_back({from, std::max(from, mill.reach_mm()), mill.shank_diameter_mm / 2, mill.shank_diameter_mm / 2});
  return pieces;
}

double widest_radius(const std::vector<ToolPiece>& pieces) {
  double widest = 0;
  for (const ToolPiece& piece : pieces) widest = std::max({widest, piece.from_radius_mm, piece.to_radius_mm});
  return widest;
}

/// Height above the tip of the lowest of the pieces that reaches out to r.
double underside(const std::vector<ToolPiece>& pieces, double r) {
  double low = std::numeric_limits<double>::infinity();
  for (const ToolPiece& piece : pieces) {
    if (r <= std::max(piece.from_radius_mm, piece.to_radius_mm)) low = std::min(low, piece.from_mm);
  }
  return low;
}

bool wider_shank(const Cutter& mill) { return widest_radius(shank_pieces(mill)) > mill.radius_mm() + 1e-9; }

/// A node's offset under the cutter.
struct Offset {
  int i, j;
  float up;  ///< the cutter's surface above its tip there
  bool core;
};

/// The offsets of one row.
struct Row {
  int j, first, end;
};

class Rougher {
 public:
  Rougher(const SplineSurface& surface, const Blank& blank, const Cutter& mill, const RoughOptions& options)
      : surface_(surface), blank_(blank), mill_(mill), options_(options), radius_(mill.radius_mm()), cut_feed_(std::min(mill.feed_mm_per_s(), options.max_feed_mm_per_s)),
        slot_depth_(mill.slot_depth_mm > 0 ? mill.slot_depth_mm : std::numeric_limits<double>::infinity()) {
    box_ = Box2::centred(blank.size_mm);
    block_nx_ = static_cast<int>(std::ceil(blank.size_mm.x() / kPitchMm));
    block_ny_ = static_cast<int>(std::ceil(blank.size_mm.y() / kPitchMm));
    dx_ = blank.size_mm.x() / block_nx_;
    dy_ = blank.size_mm.y() / block_ny_;
    // The tip's grid reaches so far out that the cutter stands beside the block at its rim, with air between.
    rim_x_ = static_cast<int>(std::ceil((radius_ + kBesideMm) / dx_));
    rim_y_ = static_cast<int>(std::ceil((radius_ + kBesideMm) / dy_));
    // What nearly touches counts in the dilation, so that the way to a node beside the block's rim does not fall below it.
    const double nearly = radius_ + dx_;
    for (int j = -static_cast<int>(nearly / dy_); j <= static_cast<int>(nearly / dy_); ++j) {
      rows_.push_back({j, static_cast<int>(offsets_.size()), 0});
      for (int i = -static_cast<int>(nearly / dx_); i <= static_cast<int>(nearly / dx_); ++i) {
        const double r = std::hypot(i * dx_, j * dy_);
        const Offset offset{i, j, static_cast<float>(profile(mill, r)), r <= kCoreShare * radius_};
        if (r <= radius_) offsets_.push_back(offset);
        if (r <= nearly) around_.push_back(offset);
      }
      rows_.back().end = static_cast<int>(offsets_.size());
    }
    if (!wider_shank(mill)) return;
    const std::vector<ToolPiece> pieces = shank_pieces(mill);
    shank_radius_ = widest_radius(pieces) + kShankAirMm;
    for (int j = -static_cast<int>(shank_radius_ / dy_); j <= static_cast<int>(shank_radius_ / dy_); ++j) {
      for (int i = -static_cast<int>(shank_radius_ / dx_); i <= static_cast<int>(shank_radius_ / dx_); ++i) {
        const double r = std::hypot(i * dx_, j * dy_);
        const double up = underside(pieces, std::max(0.0, r - kShankAirMm)) - kShankAirMm;
        if (r > radius_ && std::isfinite(up)) under_shank_.push_back({i, j, static_cast<float>(up), false});
      }
    }
  }

  ToolPath plan(const Monitor& monitor) {
    monitor.report("offset surface for roughing", 0);
    sample_target();
    dilate(monitor);
    stock_ = Grid<float>(block_nx_ + 1, block_ny_ + 1, static_cast<float>(blank_.height_mm));
    stay_over_keep_outs();
    clearance_z_ = highest_obstacle_mm(blank_) + options_.clearance_mm;

    // Levels of even depth down to the lowest tip.
    const double depth = blank_.height_mm - lowest_tip_;
    if (!mill_.holder.empty() && depth + 1 > mill_.reach_mm()) {
      throw InputError("rough: the cutter '" + mill_.name + "' reaches " + compact(mill_.reach_mm(), 3) +
                       " mm out of its holder, the relief asks for " + compact(depth + 1, 3) +
                       " mm; use a longer cutter or a lower blank");
    }
    const int levels = std::max(0, static_cast<int>(std::ceil(depth / options_.stepdown_mm - 1e-9)));
    const int stride = std::max(1, static_cast<int>(options_.stepover_mm / dy_ + 1e-9));
    const std::vector<Line> lines = even_lines(stride);
    const std::vector<Line> fine = fine_lines(stride);
    constexpr double kNoLevel = -std::numeric_limits<double>::infinity();
    if (options_.way == RoughWay::kLevels) {
      for (int k = 1; k <= levels; ++k) {
        monitor.report("roughing", 0.2 + 0.6 * (k - 1) / levels);
        raster(blank_.height_mm - depth * k / levels, 0, lines, monitor);
      }
    } else {
      for (int k = levels - 1; k >= 1; --k) {
        monitor.report("roughing", 0.2 + 0.6 * (levels - k) / levels);
        raster(kNoLevel, depth * k / levels, fine, monitor);
      }
    }
    monitor.report("following the offset surface", 0.8);
    raster(kNoLevel, 0, fine, monitor);

    ToolPath path;
    path.pass = "rough";
    path.cutter = mill_;
    path.spindle_rpm = mill_.spindle_rpm;
    path.stepover_mm = stride * dy_;
    path.predicted_cusp_um = most_left_mm() * 1e3;
    path.clearance_z_mm = clearance_z_;
    if (moves_.empty()) return path;
    // The last move ends in a rapid at a safe height.
    lift_to(clearance_z_);
    push(moves_.back().pose.tip_mm + Vec3(0, 0, options_.clearance_mm), MoveKind::kRapid, 0);
    path.moves = std::move(moves_);
    detail::limit_acceleration(path.moves, options_.acceleration_mm_per_s2);
    refuse_contact(path, blank_.keep_outs);
    monitor.report("roughing planned", 1);
    return path;
  }

  [[nodiscard]] RestMaterial rest() const { return {box_, stock_}; }
  [[nodiscard]] const RoughCutting& cutting() const { return cutting_; }

 private:
  // Tip grid: node (i, j) stands over block node (i - rim_x_, j - rim_y_).
  [[nodiscard]] int tip_columns() const { return block_nx_ + 1 + 2 * rim_x_; }
  [[nodiscard]] int tip_rows() const { return block_ny_ + 1 + 2 * rim_y_; }
  [[nodiscard]] double x_of(int i) const { return box_.min.x() + (i - rim_x_) * dx_; }
  [[nodiscard]] double y_of(int j) const { return box_.min.y() + (j - rim_y_) * dy_; }

  /// Surface plus allowance at the block's nodes, raised by what a node can miss of its surroundings.
  void sample_target() {
    target_ = Grid<float>(block_nx_ + 1, block_ny_ + 1);
    double steepest2 = 0;
    for (int j = 0; j <= block_ny_; ++j) {
      for (int i = 0; i <= block_nx_; ++i) {
        const auto s = surface_.sample(box_.min.x() + i * dx_, box_.min.y() + j * dy_);
        target_.at(i, j) = static_cast<float>(s.h + options_.allowance_mm);
        steepest2 = std::max(steepest2, s.hx * s.hx + s.hy * s.hy);
      }
    }
    // Near its contact, the gap below the cutter opens with the curvature of the corner's flank, (1 + s^2)^1.5 / r at
    // slope s, and at most 1 / mm of the surface's; a node is within half a cell's diagonal of the contact, and a chord
    // of the tip's way one cell long sags by an eighth of its square.
    const double s2 = std::min(steepest2, 1.0);
    const double corner = mill_.corner_radius_mm > 0 ? std::pow(1 + s2, 1.5) / mill_.corner_radius_mm : 4;
    const double bend = (s2 > 1e-6 ? corner : 0) + 1;
    const double cell2 = dx_ * dx_ + dy_ * dy_;
    margin_mm_ = bend * (cell2 / 8 + dx_ * dx_ / 8) + 0.02;
    for (float& h : target_.values) h += static_cast<float>(margin_mm_);
  }

  /// Lowest tip heights that leave the target alone everywhere: its dilation by the cutter's shape, shank and all.
  void dilate(const Monitor& monitor) {
    tip_ = Grid<float>(tip_columns(), tip_rows(), kNothing);
    raise_tips(around_);
    monitor.check();
    lowest_tip_ = std::numeric_limits<double>::infinity();
    for (const float z : tip_.values) {
      if (z > kNothing / 2) lowest_tip_ = std::min(lowest_tip_, static_cast<double>(z));
    }
    // Beside the block nothing holds the tip up but the lowest place it is needed.
    for (float& z : tip_.values) z = std::max(z, static_cast<float>(lowest_tip_));
    raise_tips(under_shank_);
  }

  /// To where these parts of the cutter clear the target.
  void raise_tips(const std::vector<Offset>& parts) {
    parallel_blocks(tip_rows(), 8, [&](std::size_t begin, std::size_t end) {
      for (int row = static_cast<int>(begin); row < static_cast<int>(end); ++row) {
        float* tip = &tip_.at(0, row);
        for (const Offset& o : parts) {
          const int j = row - rim_y_ + o.j;
          if (j < 0 || j > block_ny_) continue;
          const float* h = &target_.at(0, j);
          const int first = std::max(0, rim_x_ - o.i);
          const int last = std::min(tip_columns() - 1, block_nx_ + rim_x_ - o.i);
          const int shift = o.i - rim_x_;
          for (int i = first; i <= last; ++i) {
            const float z = h[i + shift] - o.up;
            tip[i] = z > tip[i] ? z : tip[i];
          }
        }
      }
    });
  }

  /// Tips that carry cutter, shank and holder over clamps and jaws, wherever the lens does not need them lower.
  void stay_over_keep_outs() {
    std::vector<ToolPiece> above = shank_pieces(mill_);
    above.insert(above.end(), mill_.holder.begin(), mill_.holder.end());
    for (const KeepOut& k : blank_.keep_outs) {
      for (int j = 0; j < tip_rows(); ++j) {
        for (int i = 0; i < tip_columns(); ++i) {
          if (over_lens(i, j)) continue;
          const double x = std::max({k.min_mm.x() - x_of(i), x_of(i) - k.max_mm.x(), 0.0});
          const double y = std::max({k.min_mm.y() - y_of(j), y_of(j) - k.max_mm.y(), 0.0});
          const double r = std::max(0.0, std::hypot(x, y) - kBesideMm);
          const double low = r <= radius_ ? profile(mill_, r) : underside(above, r);
          tip_.at(i, j) = std::max(tip_.at(i, j), static_cast<float>(k.max_mm.z() + kAboveMm - low));
        }
      }
    }
  }

  /// Of a node of the block.
  [[nodiscard]] bool on_lens(int i, int j) const { return surface_.extent().contains({box_.min.x() + i * dx_, box_.min.y() + j * dy_}); }

  [[nodiscard]] bool over_lens(int i, int j) const {
    const Box2& lens = surface_.extent();
    const double x = std::max({lens.min.x() - x_of(i), x_of(i) - lens.max.x(), 0.0});
    const double y = std::max({lens.min.y() - y_of(j), y_of(j) - lens.max.y(), 0.0});
    return std::hypot(x, y) < radius_;
  }

  /// A line of a raster along x.
  struct Line {
    int j = 0;
    std::vector<char> due;  ///< columns of the tip's grid that this line has to mill; the next line is in time for the others
  };

  /// The row from which a mill beside the block at +y would touch it.
  [[nodiscard]] int beside_row() const { return static_cast<int>(std::floor((box_.size().y() + radius_) / dy_ + 1e-9)) + rim_y_; }

  /// From +y to -y, each due everywhere. The first line stands outside, so that it takes no more than its stride; the last one so far
  /// out that the cutter's flat just passes the border (where the surface falls towards the border, its uphill rim does the cutting).
  template <class Stride>
  [[nodiscard]] std::vector<Line> lines_apart(const Stride& stride_after) const {
    const double reach = radius_ - mill_.corner_radius_mm;
    const int last = rim_y_ - static_cast<int>(std::ceil(reach / dy_ - 1e-9));
    std::vector<Line> lines;
    int j = beside_row();
    const int least_first = static_cast<int>(std::ceil(kBesideMm / dy_));  // what only just touches could not be entered from beside
    do {
      j = std::max(last, j - (lines.empty() ? std::max(stride_after(j), least_first) : stride_after(j)));
      lines.push_back({j, std::vector<char>(tip_columns(), 1)});
    } while (j > last);
    return lines;
  }

  /// Of the target across the lines, at the block's nodes; none beside the lens.
  [[nodiscard]] Grid<float> lens_slopes() const {
    Grid<float> slopes(block_nx_ + 1, block_ny_ + 1, 0.0F);
    for (int j = 0; j < block_ny_; ++j) {
      for (int i = 0; i <= block_nx_; ++i) {
        if (on_lens(i, j)) slopes.at(i, j) = std::abs(target_.at(i, j + 1) - target_.at(i, j)) / static_cast<float>(dy_);
      }
    }
    return slopes;
  }

  /// What 99 of 100 nodes on the lens are below.
  [[nodiscard]] double steep(const Grid<float>& slopes) const {
    std::vector<float> sorted;
    for (int j = 0; j < block_ny_; ++j) {
      for (int i = 0; i <= block_nx_; ++i) {
        if (on_lens(i, j)) sorted.push_back(slopes.at(i, j));
      }
    }
    if (sorted.empty()) return 0;
    const auto rank = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() * 99 / 100);
    std::nth_element(sorted.begin(), rank, sorted.end());
    return *rank;
  }

  /// The highest value at the block's nodes in a square around a mill over each node of the tip's grid.
  [[nodiscard]] Grid<float> highest_under_mill(const Grid<float>& values) const {
    Grid<float> rows(tip_columns(), values.height, 0.0F);
    for (int j = 0; j < values.height; ++j) {
      for (int i = 0; i < rows.width; ++i) {
        for (int a = std::max(0, i - 2 * rim_x_); a <= std::min(values.width - 1, i); ++a) rows.at(i, j) = std::max(rows.at(i, j), values.at(a, j));
      }
    }
    Grid<float> highest(tip_columns(), tip_rows(), 0.0F);
    for (int j = 0; j < highest.height; ++j) {
      for (int b = std::max(0, j - 2 * rim_y_); b <= std::min(values.height - 1, j); ++b) {
        for (int i = 0; i < highest.width; ++i) highest.at(i, j) = std::max(highest.at(i, j), rows.at(i, b));
      }
    }
    return highest;
  }

  [[nodiscard]] std::vector<Line> even_lines(int stride) const {
    std::vector<Line> lines = lines_apart([stride](int) { return stride; });
    // What a nearer last line would take, the last raster takes.
    if (lines.size() > 1 && lines[lines.size() - 2].j - lines.back().j < stride) lines.pop_back();
    return lines;
  }

  /// Lines as near to each other as the lens asks for, each only where the lens under the mill asks for it: a flat cutter leaves steps of
  /// about stepover times slope across the lines. Beside the lens, and for its steepest hundredth (creases), nothing comes nearer.
  [[nodiscard]] std::vector<Line> fine_lines(int widest) const {
    const Grid<float> slopes = lens_slopes();
    const auto rows = [&](double slope) {
      const double stepover = std::max(kFinalScallopMm / std::max(0.01, slope), kLeastFinalMm);
      return std::clamp(static_cast<int>(stepover / dy_ + 1e-9), 1, widest);
    };
    const int finest = rows(steep(slopes));
    Grid<int> strides(tip_columns(), tip_rows());
    const Grid<float> under = highest_under_mill(slopes);
    std::transform(under.values.begin(), under.values.end(), strides.values.begin(), [&](float slope) { return std::max(finest, rows(slope)); });
    // From a line to the next the nearest that any row on the way asks for holds.
    const auto least = [&](int j) { return *std::min_element(&strides.at(0, j), &strides.at(0, j) + strides.width); };
    const auto stride_after = [&](int j) {
      int stride = 1;
      while (stride < widest && j - stride > 0 && least(j - stride) > stride) ++stride;
      return stride;
    };
    std::vector<Line> lines = lines_apart(stride_after);
    std::vector<int> last(tip_columns(), beside_row());
    for (std::size_t k = 0; k + 1 < lines.size(); ++k) {
      for (int i = 0; i < tip_columns(); ++i) {
        int allowed = widest;
        for (int j = last[i]; j >= lines[k + 1].j; --j) allowed = std::min(allowed, strides.at(i, j));
        lines[k].due[i] = last[i] - lines[k + 1].j > allowed;
        if (lines[k].due[i]) last[i] = lines[k].j;
      }
    }
    return lines;
  }

  /// Rows of the grid.
  struct Sides {
    int left = 0, right = 0;
  };

  /// What the cutter with its axis over node (i, j) meets.
  struct Meeting {
    struct Top {
      float z;
      int row;  ///< towards +y from the axis
    };
    std::vector<Top> tops;      ///< lowest tips that clear each grid row, the highest first
    float core_top = kNothing;  ///< highest material under the cutter's core

    [[nodiscard]] bool touches(double z) const { return !tops.empty() && tops.front().z > z + kTouchMm; }
    /// Count of grid rows in which the cutter is deeper than `depth` with its tip at z: the engaged width.
    [[nodiscard]] int rows(double z, double depth) const {
      return static_cast<int>(std::count_if(tops.begin(), tops.end(), [&](const Top& top) { return top.z > z + depth; }));
    }
    /// In how many rows to the left and to the right of its way the cutter is deeper than `depth`.
    [[nodiscard]] Sides sides(double z, double depth, bool forward) const {
      Sides sides;
      for (const Top& top : tops) {
        if (top.z > z + depth && top.row != 0) ++((top.row > 0) == forward ? sides.left : sides.right);
      }
      return sides;
    }
  };
  [[nodiscard]] Meeting meet(int i, int j) const {
    Meeting m;
    const int ci = i - rim_x_;
    const int cj = j - rim_y_;
    for (const Row& row : rows_) {
      const int b = cj + row.j;
      if (b < 0 || b > block_ny_) continue;
      const float* stock = &stock_.at(0, b);
      float top = kNothing;
      for (int k = row.first; k < row.end; ++k) {
        const Offset& o = offsets_[k];
        const int a = ci + o.i;
        if (a < 0 || a > block_nx_) continue;
        top = std::max(top, stock[a] - o.up);
        if (o.core) m.core_top = std::max(m.core_top, stock[a]);
      }
      if (top > kNothing / 2) m.tops.push_back({top, row.j});
    }
    std::sort(m.tops.begin(), m.tops.end(), [](const Meeting::Top& a, const Meeting::Top& b) { return a.z > b.z; });
    return m;
  }

  /// The lowest tip that keeps to the cutter's data: deeper than in a slot only as wide as the stepover, and never too deep.
  [[nodiscard]] double held(const Meeting& m) const {
    if (m.tops.empty()) return kNothing;
    const std::size_t widest = static_cast<std::size_t>(options_.stepover_mm / dy_ + 1e-9) + 1;
    double z = m.tops.front().z - kDeepestShare * options_.stepdown_mm;
    if (m.tops.size() > widest) z = std::max(z, m.tops[widest].z - slot_depth_);
    return z;
  }

  /// The lowest tip whose shank, where that is wider than the mill, is clear of what stands.
  [[nodiscard]] double shank_held(int i, int j) const {
    float z = kNothing;
    for (const Offset& o : under_shank_) {
      const int a = i - rim_x_ + o.i;
      const int b = j - rim_y_ + o.j;
      if (a >= 0 && b >= 0 && a <= block_nx_ && b <= block_ny_) z = std::max(z, stock_.at(a, b) - o.up);
    }
    return z;
  }

  void remove(int i, int j, double z) {
    const int ci = i - rim_x_;
    const int cj = j - rim_y_;
    for (const Offset& o : offsets_) {
      const int a = ci + o.i;
      const int b = cj + o.j;
      if (a < 0 || b < 0 || a > block_nx_ || b > block_ny_) continue;
      float& s = stock_.at(a, b);
      s = std::min(s, static_cast<float>(z) + o.up);
    }
  }

  /// All lines of one level, or of one layer `over` the offset surface. From +y to -y along +X the material is then on the right:
  /// climb milling. What ramps, slots and flanks that rise to +y leave is taken turned by half a turn, from -y to +y along -X, which is
  /// climb milling again; and so on until nothing is left.
  void raster(double level, double over, std::vector<Line> lines, const Monitor& monitor) {
    bool left = true;
    for (int turn = 0; left && turn < kMostRasters; ++turn) {
      left = false;
      for (const Line& line : lines) {
        monitor.check();
        left |= mill_line(level, over, line, turn % 2 == 0);
      }
      std::reverse(lines.begin(), lines.end());
    }
  }

  /// Along +X or back, what has not clearly more material on the left than on the right: that is milled the other way. Whether there was
  /// anything to mill, either way.
  bool mill_line(double level, double over, const Line& line, bool forward) {
    const int j = line.j;
    std::vector<double> wish(tip_columns());
    for (int i = 0; i < tip_columns(); ++i) wish[i] = std::max({level, tip_.at(i, j) + over, shank_held(i, j)});
    enum Way : char { kClear, kThisWay, kOtherWay };
    std::vector<Way> ways(tip_columns(), kClear);
    for (int i = 0; i < tip_columns(); ++i) {
      const Meeting m = meet(i, j);
      if (!m.touches(wish[i])) continue;
      const Sides sides = m.sides(wish[i], kSideDepthMm, forward);
      ways[i] = conventional(sides) || (sides.left - sides.right) * dy_ > kSideMm ? kOtherWay : kThisWay;
    }
    const int gap = static_cast<int>(kGapMm / dx_);
    const int short_gap = static_cast<int>(kOtherWayMm / dx_);
    std::vector<std::pair<int, int>> stretches;
    bool any = false, other_way = false;
    for (int i = 0; i < tip_columns(); ++i) {
      if (!line.due[i] || ways[i] == kClear) continue;
      any = true;
      if (ways[i] == kOtherWay) {
        other_way = true;
        continue;
      }
      if (!stretches.empty() && i - stretches.back().second <= (other_way ? short_gap : gap))
        stretches.back().second = i;
      else
        stretches.emplace_back(i, i);
      other_way = false;
    }
    // In from where it is clear, or from so far away that a ramp is down in time; out where it is clear, if that is beside it.
    const auto entry = [&](int i, int back) {
      const int most = i + back * gap;
      while (i != most && ways[i] == kThisWay && ways[i + back] != kOtherWay) i += back;
      return i;
    };
    const auto exit = [&](int i, int on) { return ways[i + on] == kOtherWay ? i : i + on; };
    if (!forward) std::reverse(stretches.begin(), stretches.end());
    for (const auto& [first, last] : stretches) {
      if (forward)
        mill_stretch(wish, j, entry(first, -1), exit(last, 1));
      else
        mill_stretch(wish, j, entry(last, 1), exit(first, -1));
    }
    return any;
  }

  /// From column `from` to `to`.
  void mill_stretch(const std::vector<double>& wish, int j, int from, int to) {
    const int step = to >= from ? 1 : -1;
    const double cut_feed = cut_feed_;
    const double plunge_feed = std::min(cut_feed, mill_.plunge_feed_mm_per_s);
    // In the midst of material the way begins on top of it, and ramps down.
    const Meeting start = meet(from, j);
    double z = start.touches(wish[from]) ? start.tops.front().z : wish[from];
    approach(Vec3(x_of(from), y_of(j), z), from, j);
    struct Point {
      double x, z;
      MoveKind kind;
      double feed;
    };
    std::vector<Point> points{{x_of(from), z, MoveKind::kCut, 0}};
    remove(from, j, z);
    const int widest = static_cast<int>(std::ceil(options_.stepover_mm / dy_)) + 2;
    for (int i = from + step; i != to + step; i += step) {
      const Meeting m = meet(i, j);
      const double down = dx_ * kRampSlope;
      double ramp = std::min(z - down, static_cast<double>(m.core_top));
      if (m.touches(wish[i]) && !m.touches(ramp)) ramp -= down;  // from the top of material that is shorter than the core
      const double next = std::max({wish[i], held(m), ramp});
      Point p{x_of(i), next, MoveKind::kCut, cut_feed};
      if (m.touches(next)) count(m.sides(next, kSideDepthMm, step > 0));
      if (m.touches(next) && z - next > 0.8 * down) {
        p.kind = MoveKind::kPlunge;
        p.feed = plunge_feed;
      } else if (m.rows(next, kTouchMm) > widest) {
        p.feed = cut_feed / 2;  // a slot
      }
      // Up where it is clear, before meeting what is higher.
      if (next > z + kLiftMm) points.push_back({points.back().x, next, MoveKind::kCut, p.feed});
      points.push_back(p);
      z = next;
      remove(i, j, z);
    }
    // Chords that stay above the way and near it.
    constexpr double kChordMm = 0.01;
    std::size_t at = 0;
    while (at + 1 < points.size()) {
      std::size_t end = at + 1;
      for (std::size_t k = at + 2; k < points.size() && k < at + 400; ++k) {
        if (points[k].kind != points[at + 1].kind || points[k].feed != points[at + 1].feed) break;
        bool fits = true;
        for (std::size_t m = at + 1; m < k && fits; ++m) {
          const double t = (points[m].x - points[at].x) / (points[k].x - points[at].x);
          const double above = points[at].z + t * (points[k].z - points[at].z) - points[m].z;
          fits = above > -1e-9 && above < kChordMm;
        }
        if (!fits) break;
        end = k;
      }
      push({points[end].x, y_of(j), points[end].z}, points[end].kind, points[end].feed);
      at = end;
    }
  }

  /// A cell of the way in material.
  void count(const Sides& rows) {
    cutting_.in_material_mm += dx_;
    if (conventional(rows)) cutting_.conventional_mm += dx_;
    if (std::min(rows.left, rows.right) * dy_ > kSideMm) cutting_.both_sides_mm += dx_;
  }
  [[nodiscard]] bool conventional(const Sides& rows) const { return rows.left * dy_ > kSideMm && rows.right * dy_ <= kSideMm; }

  /// To a start that is clear of material, through air.
  void approach(const Vec3& start, int i, int j) {
    // Beside the block the cutter goes down fast. It stands off there by more than contact, since blanks are sawn and
    // stand a few tenths over, and comes in at the feed of a cut; the farther out, the less of it is above the block.
    const auto beside_by = [&](int column) {
      const double x = std::max(0.0, std::abs(x_of(column) - box_.centre().x()) - box_.size().x() / 2);
      const double y = std::max(0.0, std::abs(y_of(j) - box_.centre().y()) - box_.size().y() / 2);
      return std::hypot(x, y) - radius_;
    };
    int out = i;
    if (beside_by(i) > -mill_.corner_radius_mm - dx_) {
      const int side = start.x() < box_.centre().x() ? -1 : 1;
      while (beside_by(out) < kBesideMm && out + side >= 0 && out + side < tip_columns() &&
             tip_.at(out + side, j) <= static_cast<float>(start.z()) + 1e-4F && !meet(out + side, j).touches(start.z())) {
        out += side;
      }
    }
    const bool arrived = !moves_.empty() && (moves_.back().pose.tip_mm - start).norm() < 1e-9;
    if (out != i && !arrived) {
      approach_straight(Vec3(x_of(out), start.y(), start.z()), out, j);
      push(start, MoveKind::kCut, cut_feed_);
    } else {
      approach_straight(start, i, j);
    }
  }

  void approach_straight(const Vec3& start, int i, int j) {
    if (moves_.empty()) {
      push({start.x(), start.y(), clearance_z_}, MoveKind::kRapid, 0);
    } else {
      const Vec3 here = moves_.back().pose.tip_mm;
      if ((here - start).norm() < 1e-9) return;
      if ((here - start).head<2>().norm() > kShortLinkMm) {
        lift_to(clearance_z_);
        push({start.x(), start.y(), clearance_z_}, MoveKind::kRapid, 0);
      } else {
        const double over =
            std::min(clearance_z_, std::max({highest_between(here, start) + kAboveMm, here.z(), start.z()}));
        lift_to(over);
        push({start.x(), start.y(), over}, MoveKind::kLink, options_.link_feed_mm_per_s);
      }
    }
    // Beside the block straight down; above it the last millimetre with care.
    const bool beside = x_of(i) <= box_.min.x() - radius_ || x_of(i) >= box_.max.x() + radius_ ||
                        y_of(j) <= box_.min.y() - radius_ || y_of(j) >= box_.max.y() + radius_;
    const double careful = std::min(moves_.back().pose.tip_mm.z(), start.z() + kAboveMm);
    if (!beside && careful > start.z()) {
      push({start.x(), start.y(), careful}, MoveKind::kLink, options_.link_feed_mm_per_s);
      push(start, MoveKind::kPlunge, mill_.plunge_feed_mm_per_s);
    } else {
      push(start, MoveKind::kLink, options_.link_feed_mm_per_s);
    }
  }

  void lift_to(double z) {
    const Vec3 here = moves_.back().pose.tip_mm;
    if (z > here.z()) push({here.x(), here.y(), z}, MoveKind::kLink, options_.link_feed_mm_per_s);
  }

  /// Highest stock under the cutter on the straight way between two places.
  [[nodiscard]] double highest_between(const Vec3& a, const Vec3& b) const {
    const double reach = std::max(radius_, shank_radius_);
    const auto clamped = [](double u, int most) { return std::clamp(static_cast<int>(std::lround(u)), 0, most); };
    const int i0 = clamped((std::min(a.x(), b.x()) - reach - box_.min.x()) / dx_ - 1, block_nx_);
    const int i1 = clamped((std::max(a.x(), b.x()) + reach - box_.min.x()) / dx_ + 1, block_nx_);
    const int j0 = clamped((std::min(a.y(), b.y()) - reach - box_.min.y()) / dy_ - 1, block_ny_);
    const int j1 = clamped((std::max(a.y(), b.y()) + reach - box_.min.y()) / dy_ + 1, block_ny_);
    float highest = kNothing;
    for (int j = j0; j <= j1; ++j) {
      for (int i = i0; i <= i1; ++i) highest = std::max(highest, stock_.at(i, j));
    }
    Box2 way;
    for (const Vec3& end : {a, b}) {
      way.include(end.head<2>() - Vec2::Constant(reach + kBesideMm));
      way.include(end.head<2>() + Vec2::Constant(reach + kBesideMm));
    }
    for (const KeepOut& k : blank_.keep_outs) {
      const bool beside = k.min_mm.x() > way.max.x() || k.max_mm.x() < way.min.x() || k.min_mm.y() > way.max.y() || k.max_mm.y() < way.min.y();
      if (!beside) highest = std::max(highest, static_cast<float>(k.max_mm.z()));
    }
    return highest;
  }

  void push(const Vec3& tip, MoveKind kind, double feed) {
    if (!moves_.empty() && kind != MoveKind::kRapid && (moves_.back().pose.tip_mm - tip).norm() < 1e-9) return;
    moves_.push_back({{tip, Vec3::UnitZ()}, kind, feed});
  }

  /// Highest material above the surface at the block's nodes within the lens.
  [[nodiscard]] double most_left_mm() const {
    double most = 0;
    for (int j = 0; j <= block_ny_; ++j) {
      for (int i = 0; i <= block_nx_; ++i) {
        if (!on_lens(i, j)) continue;
        const double design = target_.at(i, j) - margin_mm_ - options_.allowance_mm;
        most = std::max(most, stock_.at(i, j) - design);
      }
    }
    return most;
  }

  const SplineSurface& surface_;
  const Blank& blank_;
  const Cutter& mill_;
  const RoughOptions& options_;
  double radius_, cut_feed_;
  double slot_depth_;
  double shank_radius_ = 0;  ///< with its air, where it is wider than the mill
  Box2 box_;
  int block_nx_ = 0, block_ny_ = 0, rim_x_ = 0, rim_y_ = 0;
  double dx_ = 0, dy_ = 0;
  std::vector<Offset> offsets_;      ///< under the cutter
  std::vector<Row> rows_;            ///< of them
  std::vector<Offset> around_;       ///< and a cell beside it
  std::vector<Offset> under_shank_;  ///< beside the mill, where the shank is wider
  Grid<float> target_, tip_, stock_;
  double margin_mm_ = 0, lowest_tip_ = 0, clearance_z_ = 0;
  std::vector<Move> moves_;
  RoughCutting cutting_;
};

}  // namespace

namespace {

void check(const SplineSurface& surface, const Blank& blank, const Cutter& mill, const RoughOptions& options) {
  const auto refuse = [](const std::string& what) { throw InputError("rough: " + what); };
  if (!(blank.size_mm.x() > 0 && blank.size_mm.y() > 0 && blank.height_mm > 0)) refuse("the blank has no size");
  if (!(mill.radius_mm() > 0 && mill.feed_mm_per_s() > 0 && mill.plunge_feed_mm_per_s > 0)) {
    refuse("the cutter '" + mill.name + "' has no diameter or no feeds");
  }
  if (!(options.allowance_mm >= 0)) refuse("allowance_mm must be at least 0");
  if (!(options.stepdown_mm >= 0.05)) refuse("stepdown_mm must be at least 0.05");
  const double most_stepdown = (mill.flute_length_mm - (wider_shank(mill) ? kShankAirMm : 0)) / kDeepestShare;
  if (!(options.stepdown_mm <= most_stepdown + 1e-9)) {
    refuse("stepdown_mm = " + compact(options.stepdown_mm, 3) + " is too much for '" + mill.name + "': where lines leave steps its " +
           compact(mill.flute_length_mm, 3) + " mm of flutes cut " + compact(kDeepestShare, 2) + " times as deep" +
           (wider_shank(mill) ? " below a shank that is wider" : "") + "; at most " + fixed(std::floor(most_stepdown * 100) / 100, 2) +
           ", or a mill with longer flutes");
  }
  if (!(options.stepover_mm >= kPitchMm && options.stepover_mm <= mill.diameter_mm)) {
    refuse("stepover_mm must be from " + compact(kPitchMm, 3) + " to the cutter's diameter");
  }
  if (mill.most_stepover_mm > 0 && options.stepover_mm > mill.most_stepover_mm + 1e-9) {
    refuse("stepover_mm = " + compact(options.stepover_mm, 3) + " is wider than the " + compact(mill.most_stepover_mm, 3) + " mm that '" + mill.name +
           "' is meant for (most_stepover_mm in its file)");
  }
  if (!(options.clearance_mm > 0 && options.link_feed_mm_per_s > 0)) refuse("clearance and link feed must be above 0");
  if (!(options.max_feed_mm_per_s > 0 && options.acceleration_mm_per_s2 > 0)) refuse("highest feed and acceleration must be above 0");
  const Box2 block = Box2::centred(blank.size_mm);
  const Box2& lens = surface.extent();
  if (lens.min.x() < block.min.x() - 1e-6 || lens.min.y() < block.min.y() - 1e-6 ||
      lens.max.x() > block.max.x() + 1e-6 || lens.max.y() > block.max.y() + 1e-6) {
    refuse("the blank of " + compact(blank.size_mm.x(), 3) + " x " + compact(blank.size_mm.y(), 3) +
           " mm is smaller than the lens; give a larger one");
  }
  const double highest = surface.highest();
  if (highest > blank.height_mm + 1e-6) {
    refuse("the lens is " + compact(highest - blank.height_mm, 3) + " mm taller than the blank of " +
           compact(blank.height_mm, 3) + " mm; use a higher blank (stock.height_mm) or a longer distance");
  }
}

}  // namespace

ToolPath plan_roughing(const SplineSurface& surface, const Blank& blank, const Cutter& mill, const RoughOptions& options,
                       const Monitor& monitor) {
  check(surface, blank, mill, options);
  return Rougher(surface, blank, mill, options).plan(monitor);
}

RoughChoice plan_faster_roughing(const SplineSurface& surface, const Blank& blank, const Cutter& mill, RoughOptions options,
                                 const Monitor& monitor) {
  constexpr double kRapidMmPerS = 200;  // both ways alike
  check(surface, blank, mill, options);
  options.way = RoughWay::kLevels;
  Rougher by_levels(surface, blank, mill, options);
  ToolPath levels = by_levels.plan(monitor.part(0, 0.5));
  RoughOptions layer_options = options;
  layer_options.way = RoughWay::kLayers;
  Rougher by_layers(surface, blank, mill, layer_options);
  ToolPath layers = by_layers.plan(monitor.part(0.5, 1));
  RoughChoice choice{RoughWay::kLevels, {}, {}, {}, levels.minutes(kRapidMmPerS), layers.minutes(kRapidMmPerS)};
  if (choice.layers_minutes < choice.levels_minutes) choice.way = RoughWay::kLayers;
  choice.path = std::move(choice.way == RoughWay::kLayers ? layers : levels);
  const Rougher& taken = choice.way == RoughWay::kLayers ? by_layers : by_levels;
  choice.rest = taken.rest();
  choice.cutting = taken.cutting();
  return choice;
}

namespace {

/// Every node under a ball, with the height of the ball's underside there.
template <typename Rest, typename See>
void under_ball(Rest& rest, const Vec3& centre, double radius, See see) {
  auto& h = rest.heights_mm;
  const Vec2 pitch = rest.extent.size().cwiseQuotient(Vec2(h.width - 1, h.height - 1));
  const Vec2 low = (centre.head<2>() - rest.extent.min - Vec2::Constant(radius)).cwiseQuotient(pitch);
  const Vec2 high = (centre.head<2>() - rest.extent.min + Vec2::Constant(radius)).cwiseQuotient(pitch);
  for (int j = std::max(0, static_cast<int>(std::ceil(low.y()))); j <= std::min<double>(h.height - 1, high.y()); ++j) {
    for (int i = std::max(0, static_cast<int>(std::ceil(low.x()))); i <= std::min<double>(h.width - 1, high.x()); ++i) {
      const Vec2 away = rest.extent.min + Vec2(i, j).cwiseProduct(pitch) - centre.head<2>();
      const double square = radius * radius - away.squaredNorm();
      if (square > 0) see(h.at(i, j), centre.z() - std::sqrt(square));
    }
  }
}

bool cuts(const Move& move) { return move.kind == MoveKind::kCut || move.kind == MoveKind::kPlunge; }

}  // namespace

double deepest_cut_mm(const RestMaterial& rest, const ToolPath& path) {
  constexpr double kEveryMm = 1;
  const double radius = path.cutter.radius_mm();
  double deepest = 0;
  Vec3 last = Vec3::Constant(std::numeric_limits<double>::infinity());
  for (const Move& move : path.moves) {
    const Vec3 centre = move.pose.tip_mm + radius * move.pose.axis;
    if (!cuts(move) || (centre - last).norm() < kEveryMm) continue;
    last = centre;
    under_ball(rest, centre, radius, [&](float stands, double z) { deepest = std::max(deepest, stands - z); });
  }
  return deepest;
}

RestMaterial after_pass(RestMaterial rest, const ToolPath& path) {
  constexpr double kEveryMm = 0.25;
  const double radius = path.cutter.radius_mm();
  const auto centre = [&](const Move& move) { return Vec3(move.pose.tip_mm + radius * move.pose.axis); };
  for (std::size_t k = 1; k < path.moves.size(); ++k) {
    if (!cuts(path.moves[k])) continue;
    const Vec3 from = centre(path.moves[k - 1]), to = centre(path.moves[k]);
    const int pieces = std::max(1, static_cast<int>(std::ceil((to - from).norm() / kEveryMm)));
    for (int m = 0; m <= pieces; ++m) {
      under_ball(rest, from + (to - from) * m / pieces, radius, [](float& stands, double z) { stands = std::min(stands, static_cast<float>(z)); });
    }
  }
  return rest;
}

}  // namespace lightmill

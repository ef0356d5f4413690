#include "machine/detail/stock_field.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/core/text.h"

namespace lightmill {

namespace {
constexpr double kMostNodes = 4e8;  ///< 3.2 GB of heights and makers
/// Slack of the tests that leave out tiles, over all rounding in them.
constexpr double kSlack_mm = 1e-7;
}  // namespace

StockField::StockField(const Blank& blank, double pitch_mm) : pitch_mm_(pitch_mm), blank_height_mm_(blank.height_mm) {
  if (!(pitch_mm > 0)) throw InputError("dry_run.pitch_um must be above 0, not " + compact(pitch_mm * 1000, 3));
  if (!(blank.size_mm.x() > 0 && blank.size_mm.y() > 0 && blank.height_mm > 0)) {
    throw InputError("the blank must have a size and a height above 0, not " + compact(blank.size_mm.x(), 3) + " x " +
                     compact(blank.size_mm.y(), 3) + " x " + compact(blank.height_mm, 3) + " mm");
  }
  // A blank that is not a whole number of pitches keeps its nodes centred, less than half a pitch inside its rim.
  const double columns = std::floor(blank.size_mm.x() / pitch_mm + 1e-6) + 1;
  const double rows = std::floor(blank.size_mm.y() / pitch_mm + 1e-6) + 1;
  if (columns * rows > kMostNodes) {
    throw InputError("a pitch of " + compact(pitch_mm * 1000, 3) + " um makes " + compact(columns * rows / 1e6, 0) +
                     " million nodes of this blank; ask for a coarser dry_run.pitch_um");
  }
  const int width = static_cast<int>(columns);
  const int height = static_cast<int>(rows);
  const Vec2 half((width - 1) * pitch_mm / 2, (height - 1) * pitch_mm / 2);
  extent_ = {-half, half};
  heights_ = Grid<float>(width, height, static_cast<float>(blank.height_mm));
  makers_ = Grid<std::uint32_t>(width, height, kUncut);
  int w = (width + kTileNodes - 1) / kTileNodes;
  int h = (height + kTileNodes - 1) / kTileNodes;
  for (;;) {
    pyramid_.emplace_back(w, h, static_cast<float>(blank.height_mm));
    if (w == 1 && h == 1) break;
    w = (w + 1) / 2;
    h = (h + 1) / 2;
  }
}

void StockField::lower_to(const std::function<double(const Vec2&)>& height_mm) {
  parallel_blocks(heights_.height, kTileNodes, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int i = 0; i < heights_.width; ++i) {
        float& height = heights_.at(i, j);
        height = std::min(height, static_cast<float>(height_mm({x(i), y(j)})));
      }
    }
  });
  const TileRange all{0, pyramid_.front().width - 1, 0, pyramid_.front().height - 1};
  for (int tj = 0; tj <= all.j1; ++tj) {
    for (int ti = 0; ti <= all.i1; ++ti) pyramid_.front().at(ti, tj) = highest_node_of_tile(ti, tj);
  }
  refresh_pyramid(all);
}

StockField::TileRange StockField::tiles(const Box2& rectangle) const {
  const double left = (rectangle.min.x() - extent_.min.x()) / pitch_mm_;
  const double right = (rectangle.max.x() - extent_.min.x()) / pitch_mm_;
  const double bottom = (rectangle.min.y() - extent_.min.y()) / pitch_mm_;
  const double top = (rectangle.max.y() - extent_.min.y()) / pitch_mm_;
  if (!(right >= 0 && top >= 0 && left <= heights_.width - 1 && bottom <= heights_.height - 1)) return {};
  const auto tile = [](double node, int count) {
    return static_cast<int>(std::clamp(node, 0.0, count - 1.0)) / kTileNodes;
  };
  return {tile(left, heights_.width), tile(right, heights_.width), tile(bottom, heights_.height),
          tile(top, heights_.height)};
}

double StockField::highest(const Box2& rectangle) const {
  TileRange range = tiles(rectangle);
  if (range.empty()) return -kNothing;
  std::size_t level = 0;
  while (level + 1 < pyramid_.size() && (range.i1 - range.i0 > 3 || range.j1 - range.j0 > 3)) {
    range = {range.i0 / 2, range.i1 / 2, range.j0 / 2, range.j1 / 2};
    ++level;
  }
  float most = -std::numeric_limits<float>::infinity();
  for (int j = range.j0; j <= range.j1; ++j) {
    for (int i = range.i0; i <= range.i1; ++i) most = std::max(most, pyramid_[level].at(i, j));
  }
  return most;
}

/// Calls visit(node index, i, j, height) for the nodes of a tile that the sweep may lower below `below`: a superset of
/// those whose least height along the path is on this motion or on its first vertex.
template <typename Visit>
void StockField::visit_tile(const Sweep& sweep, int ti, int tj, double below, Visit&& visit) const {
  const Vec2 centre = tile_centre(ti, tj);
  const double half = tile_half_mm();
  const int i_begin = ti * kTileNodes;
  const int i_end = std::min(i_begin + kTileNodes, heights_.width);
  const int j_begin = tj * kTileNodes;
  const int j_end = std::min(j_begin + kTileNodes, heights_.height);
  if (sweep.shape == Sweep::Shape::kTilted) {
    const Vec3 middle = (sweep.from + sweep.to) / 2;
    const Frustum around_tile = sweep.around(half * std::sqrt(2.0) + kSlack_mm);
    if (underside(around_tile, middle, sweep.axis, centre.x(), centre.y()) >= below) return;
    const Frustum around = sweep.around(kSlack_mm);
    for (int j = j_begin; j < j_end; ++j) {
      for (int i = i_begin; i < i_end; ++i) {
        const std::size_t node = heights_.index(i, j);
        if (underside(around, middle, sweep.axis, x(i), y(j)) >= heights_.values[node]) continue;
        visit(node, i, j, sweep.height(x(i), y(j)));
      }
    }
    return;
  }
  const double dx = centre.x() - sweep.from.x();
  const double dy = centre.y() - sweep.from.y();
  const double ax = sweep.along_x;
  const double ay = sweep.along_y;
  const double s = dx * ax + dy * ay;
  const double u = std::abs(dy * ax - dx * ay);
  const double spread = half * (std::abs(ax) + std::abs(ay)) + kSlack_mm;  // of s and of u over the tile
  const double nearest = std::max(0.0, u - spread);
  const double radius = sweep.radius_mm;
  if (nearest >= radius) return;

  double first = -kNothing;
  double last = kNothing;
  if (!sweep.whole) {
    // The slab beside the motion, shifted to where a climbing ball touches, and the wedge behind its start.
    const double r_most = std::sqrt(radius * radius - nearest * nearest);
    const double farthest = u + spread;
    const double r_least = farthest < radius ? std::sqrt(radius * radius - farthest * farthest) : 0.0;
    const double shift_a = r_most * sweep.sine;
    const double shift_b = r_least * sweep.sine;
    first = std::min(shift_a, shift_b) - sweep.back_mm - kSlack_mm;
    last = std::max(shift_a, shift_b) + sweep.length_mm + kSlack_mm;
    if (sweep.shape == Sweep::Shape::kMill) {
      first = -sweep.back_mm - kSlack_mm;
      last = sweep.length_mm + kSlack_mm;
    }
    if (s + spread < first || s - spread > last) return;
  }
  const double behind = std::max({0.0, -(s + spread), s - spread - sweep.length_mm});
  const double distance2 = nearest * nearest + behind * behind;
  // Heights are stored as float: what would be stored is what must be lower (a floor that is already milled is not).
  if (distance2 >= radius * radius) return;
  if (static_cast<float>(sweep.least_height(std::sqrt(distance2))) >= below) return;

  for (int j = j_begin; j < j_end; ++j) {
    const double node_y = y(j);
    int from = i_begin;
    int to = i_end;
    if (!sweep.whole && std::abs(ax) > 0.1) {
      // s grows by ax per mm of x along the row: the part of the row inside [first, last].
      const double offset = (node_y - sweep.from.y()) * ay;
      double x_a = sweep.from.x() + (first - offset) / ax;
      double x_b = sweep.from.x() + (last - offset) / ax;
      if (x_a > x_b) std::swap(x_a, x_b);
      const double a = (x_a - extent_.min.x()) / pitch_mm_;
      const double b = (x_b - extent_.min.x()) / pitch_mm_;
      if (a > i_end || b < i_begin) continue;
      from = std::max(from, static_cast<int>(std::ceil(std::max(a, 0.0))));
      to = std::min(to, static_cast<int>(std::floor(std::min(b, static_cast<double>(i_end)))) + 1);
    }
    for (int i = from; i < to; ++i) {
      const std::size_t node = heights_.index(i, j);
      visit(node, i, j, sweep.height(x(i), node_y, heights_.values[node]));
    }
  }
}

float StockField::highest_node_of_tile(int ti, int tj) const {
  // One maximum per column of the tile, so that the compiler can work on several at once.
  float most[kTileNodes];
  std::fill(most, most + kTileNodes, -std::numeric_limits<float>::infinity());
  const int columns = std::min(kTileNodes, heights_.width - ti * kTileNodes);
  for (int j = tj * kTileNodes; j < std::min((tj + 1) * kTileNodes, heights_.height); ++j) {
    const float* row = &heights_.values[heights_.index(ti * kTileNodes, j)];
    if (columns == kTileNodes) {
      for (int i = 0; i < kTileNodes; ++i) most[i] = row[i] > most[i] ? row[i] : most[i];
    } else {
      for (int i = 0; i < columns; ++i) most[i] = row[i] > most[i] ? row[i] : most[i];
    }
  }
  return *std::max_element(most, most + kTileNodes);
}

void StockField::cut_tile_row(std::span<const Sweep> sweeps, std::span<const Maker> order, int tj) {
  Grid<float>& level = pyramid_.front();
  const double bottom = y(tj * kTileNodes);
  const double top = y(std::min((tj + 1) * kTileNodes, heights_.height) - 1);
  for (const Maker& maker : order) {
    const Sweep& sweep = sweeps[maker.sweep];
    if (sweep.reach.max.y() < bottom || sweep.reach.min.y() > top) continue;
    const TileRange range = tiles({{sweep.reach.min.x(), bottom}, {sweep.reach.max.x(), top}});
    for (int ti = range.i0; ti <= range.i1; ++ti) {
      const float below = level.at(ti, tj);
      if (static_cast<float>(sweep.lowest_mm) >= below) continue;
      bool lowered = false;
      visit_tile(sweep, ti, tj, below, [&](std::size_t node, int, int, double height) {
        const float value = static_cast<float>(std::max(height, 0.0));
        if (value < heights_.values[node]) {
          heights_.values[node] = value;
          makers_.values[node] = maker.witness;
          lowered = true;
        }
      });
      if (lowered) level.at(ti, tj) = highest_node_of_tile(ti, tj);
    }
  }
}

void StockField::cut(std::span<const Sweep> sweeps) {
  if (sweeps.empty()) return;
  Box2 reach;
  std::vector<Maker> order(sweeps.size());
  for (std::size_t k = 0; k < sweeps.size(); ++k) {
    reach.include(sweeps[k].reach.min);
    reach.include(sweeps[k].reach.max);
    order[k] = {static_cast<std::uint32_t>(k), kNotABall};
    if (sweeps[k].shape == Sweep::Shape::kBall) {
      order[k].witness = static_cast<std::uint32_t>(witnesses_.size());
      witnesses_.push_back({sweeps[k].from, sweeps[k].to, sweeps[k].radius_mm});
    }
  }
  // A mill that goes down lowers its whole footprint with every motion: the lowest motion first leaves nothing to the
  // others.
  const auto rank = [&](const Maker& maker) {
    return sweeps[maker.sweep].shape == Sweep::Shape::kMill ? sweeps[maker.sweep].lowest_mm : kNothing;
  };
  std::stable_sort(order.begin(), order.end(), [&](const Maker& a, const Maker& b) { return rank(a) < rank(b); });
  const TileRange range = tiles(reach);
  if (range.empty()) return;
  // A tile row belongs to one thread at a time, so nodes and pyramid need no locks.
  parallel_blocks(range.j1 - range.j0 + 1, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t row = begin; row < end; ++row) cut_tile_row(sweeps, order, range.j0 + static_cast<int>(row));
  });
  refresh_pyramid(range);
}

void StockField::refresh_pyramid(const TileRange& changed) {
  TileRange range = changed;
  for (std::size_t level = 1; level < pyramid_.size(); ++level) {
    range = {range.i0 / 2, range.i1 / 2, range.j0 / 2, range.j1 / 2};
    const Grid<float>& fine = pyramid_[level - 1];
    for (int j = range.j0; j <= range.j1; ++j) {
      for (int i = range.i0; i <= range.i1; ++i) {
        const int right = std::min(2 * i + 1, fine.width - 1);
        const int up = std::min(2 * j + 1, fine.height - 1);
        pyramid_[level].at(i, j) = std::max(std::max(fine.at(2 * i, 2 * j), fine.at(right, 2 * j)),
                                            std::max(fine.at(2 * i, up), fine.at(right, up)));
      }
    }
  }
}

StockField::Probe StockField::probe(const Sweep& sweep) const {
  Probe deepest;
  if (!may_touch(sweep)) return deepest;
  const TileRange range = tiles(sweep.reach);
  for (int tj = range.j0; tj <= range.j1; ++tj) {
    for (int ti = range.i0; ti <= range.i1; ++ti) {
      const float below = tile_highest(ti, tj);
      if (sweep.lowest_mm >= below) continue;
      visit_tile(sweep, ti, tj, below, [&](std::size_t node, int i, int j, double height) {
        const double depth = heights_.values[node] - height;
        if (depth > deepest.depth_mm) deepest = {depth, {x(i), y(j), height}};
      });
    }
  }
  return deepest;
}

double StockField::removed_mm3() const {
  // Trapezoids: rim nodes stand for half a cell. Rows are summed in order, whatever thread summed each.
  std::vector<double> rows(heights_.height);
  parallel_blocks(rows.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t j = begin; j < end; ++j) {
      const float* row = &heights_.values[j * heights_.width];
      double sum = 0;
      for (int i = 0; i < heights_.width; ++i) sum += blank_height_mm_ - row[i];
      sum -= (2 * blank_height_mm_ - row[0] - row[heights_.width - 1]) / 2;
      rows[j] = sum;
    }
  });
  double sum = 0;
  for (const double row : rows) sum += row;
  sum -= (rows.front() + rows.back()) / 2;
  return std::max(0.0, sum) * pitch_mm_ * pitch_mm_;
}

namespace {

/// Two surfaces meet where their heights differ by no more than this.
constexpr double kMeeting_mm = 2e-6;

/// Where two balls' surfaces meet, nearest to a node and in its cell.
struct Ridge {
  double x = 0, y = 0;  ///< from the node
  double height = 0;
  double slope_x = 0, slope_y = 0;  ///< mean of both surfaces there
};

/// Newton from the node: on both planes, which rise from their mean by -+ k, the surfaces meet where k . d is half the
/// difference of their heights, nearest at d = k difference / 2 |k|^2.
std::optional<Ridge> ridge_in_cell(const BallWitness& one, const BallWitness& other, SweptPoint a, SweptPoint b,
                                   double x, double y, double half) {
  double at_x = 0;
  double at_y = 0;
  for (int round = 0; round < 4; ++round) {
    if (a.height == kNothing || b.height == kNothing) return std::nullopt;
    const double kx = (b.slope_x - a.slope_x) / 2;
    const double ky = (b.slope_y - a.slope_y) / 2;
    // Smooth joints between motions of one path meet in equal slopes: no ridge.
    constexpr double kLeastSlope = 5e-5;
    const double k2 = kx * kx + ky * ky;
    if (k2 < kLeastSlope * kLeastSlope) return std::nullopt;
    if (round > 0 && std::abs(a.height - b.height) < kMeeting_mm) {
      return Ridge{at_x, at_y, std::min(a.height, b.height), (a.slope_x + b.slope_x) / 2, (a.slope_y + b.slope_y) / 2};
    }
    const double target = (a.height - b.height) / 2 + kx * at_x + ky * at_y;  // of k . d, d from the node
    if (std::abs(target) > (std::abs(kx) + std::abs(ky)) * half * (1 + 1e-9)) return std::nullopt;
    at_x = kx * target / k2;
    at_y = ky * target / k2;
    if (std::abs(at_x) > half) {
      at_x = std::copysign(half, at_x);
      at_y = ky != 0 ? std::clamp((target - kx * at_x) / ky, -half, half) : 0.0;
    } else if (std::abs(at_y) > half) {
      at_y = std::copysign(half, at_y);
      at_x = kx != 0 ? std::clamp((target - ky * at_y) / kx, -half, half) : 0.0;
    }
    a = swept_ball(one.from, one.to, one.radius_mm, x + at_x, y + at_y);
    b = swept_ball(other.from, other.to, other.radius_mm, x + at_x, y + at_y);
  }
  return std::nullopt;
}

}  // namespace

StockField::Peaks StockField::peaks() const {
  Peaks peaks{heights_, Grid<PeakOffset>(heights_.width, heights_.height)};
  const double half = pitch_mm_ / 2;
  const double step = half / PeakOffset::kMost;
  const auto steps = [&](double mm) { return static_cast<std::int8_t>(std::lround(mm / step)); };
  parallel_blocks(heights_.height, 16, [&](std::size_t begin, std::size_t end) {
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      for (int i = 0; i < heights_.width; ++i) {
        const std::size_t node = heights_.index(i, j);
        const double own = heights_.values[node];
        // The balls that made the 3 x 3 nodes around, each once.
        std::uint32_t makers[9];
        int count = 0;
        for (int b = std::max(j - 1, 0); b <= std::min(j + 1, heights_.height - 1); ++b) {
          for (int a = std::max(i - 1, 0); a <= std::min(i + 1, heights_.width - 1); ++a) {
            const std::uint32_t maker = makers_.at(a, b);
            if (maker >= kNotABall) continue;
            if (std::find(makers, makers + count, maker) == makers + count) makers[count++] = maker;
          }
        }
        if (count < 2) continue;
        SweptPoint around[9];
        for (int k = 0; k < count; ++k) {
          const BallWitness& ball = witnesses_[makers[k]];
          around[k] = swept_ball(ball.from, ball.to, ball.radius_mm, x(i), y(j));
        }
        double highest = own;  // carried to the node along the slope between the surfaces that meet
        for (int a = 0; a < count; ++a) {
          for (int b = a + 1; b < count; ++b) {
            const auto ridge =
                ridge_in_cell(witnesses_[makers[a]], witnesses_[makers[b]], around[a], around[b], x(i), y(j), half);
            if (!ridge) continue;
            // It is one of the part only where no other ball has taken it away.
            double envelope = ridge->height;
            for (int k = 0; k < count; ++k) {
              if (k == a || k == b) continue;
              const BallWitness& ball = witnesses_[makers[k]];
              envelope = std::min(
                  envelope, swept_ball(ball.from, ball.to, ball.radius_mm, x(i) + ridge->x, y(j) + ridge->y).height);
            }
            if (envelope < ridge->height - kMeeting_mm) continue;
            // Where neither of the two made the node, it lies beyond another ridge (two motions of one pass, the node
            // on the next one's flank): their plane is that much too high over it.
            const double beyond = std::max(0.0, std::min(around[a].height, around[b].height) - own);
            const double there = envelope - ridge->slope_x * ridge->x - ridge->slope_y * ridge->y - beyond;
            if (there <= highest) continue;
            highest = there;
            const PeakOffset offset{steps(ridge->x), steps(ridge->y)};
            peaks.offsets.values[node] = offset;
            peaks.heights_mm.values[node] = static_cast<float>(envelope + ridge->slope_x * (offset.x * step - ridge->x) +
                                                               ridge->slope_y * (offset.y * step - ridge->y));
          }
        }
      }
    }
  });
  return peaks;
}

}  // namespace lightmill

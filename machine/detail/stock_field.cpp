#include "machine/detail/stock_field.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/core/text.h"

namespace lightmill {

namespace {
constexpr double kMostNodes = 4e8;  ///< 3.2 GB of heights and makers
/// Slack of the tests that leave out what leaning cutters cannot reach, over all rounding in them.
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
  const auto slab = sweep.slab_over(centre, Vec2(half, half), below);
  if (!slab) return;
  const double ax = sweep.along_x;
  const double ay = sweep.along_y;
  for (int j = j_begin; j < j_end; ++j) {
    const double node_y = y(j);
    int from = i_begin;
    int to = i_end;
    if (!sweep.whole && std::abs(ax) > 0.1) {
      // s grows by ax per mm of x along the row: the part of the row inside [first, last].
      const double offset = (node_y - sweep.from.y()) * ay;
      double x_a = sweep.from.x() + (slab->first - offset) / ax;
      double x_b = sweep.from.x() + (slab->last - offset) / ax;
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

namespace {

/// Whether a node counts as made by `witness`, which comes down to `height`, rather than by who made it before. A mill's floor has
/// no ridges; a ball's side goes over into the ball, and is found by steps: nearer to a ball than this it is the ball.
bool makes(std::uint32_t witness, float height, std::uint32_t before, float height_before) {
  constexpr float kSame_mm = 2e-6F;
  if (witness == kMilled) return height <= height_before;
  if (is_ball(witness) && before == kSide) return height < height_before + kSame_mm;
  if (witness == kSide && is_ball(before)) return height < height_before - kSame_mm;
  return height < height_before;
}

}  // namespace

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
        if (makes(maker.witness, value, makers_.values[node], heights_.values[node])) makers_.values[node] = maker.witness;
        if (value < heights_.values[node]) {
          heights_.values[node] = value;
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
    order[k] = {static_cast<std::uint32_t>(k), sweeps[k].from_height_mm > 0 ? kSide : kMilled};
    if (sweeps[k].shape == Sweep::Shape::kBall) {
      order[k].witness = static_cast<std::uint32_t>(witnesses_.size());
      witnesses_.push_back({sweeps[k].from, sweeps[k].to, sweeps[k].radius_mm, sweeps[k].whole ? kNothing : sweeps[k].back_mm});
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

}  // namespace lightmill

// The height field itself: nodes, what made each of them, and a pyramid of upper bounds.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "cam/blank.h"
#include "design/core/grid.h"
#include "machine/detail/stock_sweep.h"
#include "machine/stock_model.h"

namespace lightmill {

/// A motion of a ball: all that is needed to evaluate its surface anywhere.
struct BallWitness {
  Vec3 from, to;
  double radius_mm = 0;
  double back_mm = 0;  ///< as a sweep's; kNothing where its whole footprint counts
};

inline constexpr std::uint32_t kUncut = 0xFFFFFFFFu;     ///< witness of a node that is still the blank's top
inline constexpr std::uint32_t kMilled = 0xFFFFFFFEu;    ///< made by a mill
inline constexpr std::uint32_t kSide = 0xFFFFFFFDu;      ///< made by the side of a ball's cutter
/// Whether a node was made by a ball: its witness is an index.
inline bool is_ball(std::uint32_t witness) { return witness < kSide; }
inline constexpr int kTileNodes = 16;                    ///< tiles of the finest pyramid level are 16 x 16 nodes

class StockField {
 public:
  StockField(const Blank& blank, double pitch_mm);

  void lower_to(const std::function<double(const Vec2&)>& height_mm);

  /// Removes what the sweeps cover, on all threads. The least height wins, so neither order nor threads matter; of
  /// equal heights a mill counts as the maker, then a ball, then its side; else the first.
  void cut(std::span<const Sweep> sweeps);

  /// How far a sweep would reach into the stock, without removing anything: the largest height above the swept surface.
  struct Probe {
    double depth_mm = 0;
    Vec3 place_mm = Vec3::Zero();
  };
  [[nodiscard]] Probe probe(const Sweep& sweep) const;

  /// An upper bound of the heights over a rectangle; -infinity beside the blank.
  [[nodiscard]] double highest(const Box2& rectangle) const;
  [[nodiscard]] double highest() const { return pyramid_.back().values.front(); }
  /// False only if nothing of the sweep can reach the stock.
  [[nodiscard]] bool may_touch(const Sweep& sweep) const {
    return sweep.lowest_mm < highest() && sweep.lowest_mm < highest(sweep.reach);
  }

  struct TileRange {
    int i0 = 0, i1 = -1, j0 = 0, j1 = -1;
    [[nodiscard]] bool empty() const { return i1 < i0 || j1 < j0; }
  };
  [[nodiscard]] TileRange tiles(const Box2& rectangle) const;
  [[nodiscard]] float tile_highest(int i, int j) const { return pyramid_.front().at(i, j); }
  [[nodiscard]] Vec2 tile_centre(int i, int j) const {
    return {x(i * kTileNodes) + tile_half_mm(), y(j * kTileNodes) + tile_half_mm()};
  }
  /// Half the side of a tile, from first to last node.
  [[nodiscard]] double tile_half_mm() const { return (kTileNodes - 1) * pitch_mm_ / 2; }

  [[nodiscard]] double x(int i) const { return extent_.min.x() + pitch_mm_ * i; }
  [[nodiscard]] double y(int j) const { return extent_.min.y() + pitch_mm_ * j; }
  [[nodiscard]] const Box2& extent() const { return extent_; }
  [[nodiscard]] double pitch_mm() const { return pitch_mm_; }
  [[nodiscard]] const Grid<float>& heights() const { return heights_; }
  [[nodiscard]] double removed_mm3() const;
  /// What made each node: an index of witnesses(), kUncut, kMilled or kSide.
  [[nodiscard]] const Grid<std::uint32_t>& makers() const { return makers_; }
  [[nodiscard]] const std::vector<BallWitness>& witnesses() const { return witnesses_; }

 private:
  template <typename Visit>
  void visit_tile(const Sweep& sweep, int ti, int tj, double below, Visit&& visit) const;
  struct Maker {
    std::uint32_t sweep = 0;
    std::uint32_t witness = kMilled;
  };
  void cut_tile_row(std::span<const Sweep> sweeps, std::span<const Maker> order, int tj);
  [[nodiscard]] float highest_node_of_tile(int ti, int tj) const;
  void refresh_pyramid(const TileRange& changed);

  Box2 extent_;
  double pitch_mm_ = 0;
  double blank_height_mm_ = 0;
  Grid<float> heights_;
  Grid<std::uint32_t> makers_;
  std::vector<BallWitness> witnesses_;
  std::vector<Grid<float>> pyramid_;  ///< level 0: tiles; each next one halves both sides; the last is one value
};

}  // namespace lightmill

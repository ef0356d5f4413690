#include "machine/detail/stock_peaks.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "design/core/parallel.h"

namespace lightmill {

namespace {

/// Surfaces that are no farther apart than this are taken for the same there: rounding is below.
constexpr double kTie_mm = 1e-8;
/// Two surfaces meet where their heights differ by no more than this, at a place that is known to kPlace_mm.
constexpr double kMeeting_mm = 2e-6;
constexpr double kPlace_mm = 1e-10;
/// How far beside a jump the surfaces on both sides of it are looked at.
constexpr double kRim_mm = 1e-8;
/// Smooth joints between motions of one path meet without a turn: no ridge.
constexpr double kLeastTurn_rad = 5e-5;
/// Motions are listed by blocks of so many nodes a side.
constexpr int kBlockNodes = 4;
constexpr int kTileBlocks = kTileNodes / kBlockNodes;
/// Surfaces on a line are told apart in so many halves of halves.
constexpr int kMostHalves = 24;
/// Over the curvature of a ball at the slope between two nodes: it may be steeper in between.
constexpr double kSafety = 2;
/// Where one motion made both ends of a line, another one may be lower in between by the bend of a ball. Where that is less than
/// half of this (at 20 um a ball of 2 mm radius on a slope of 0.6), it is not looked for.
constexpr double kShallow_mm = 8e-5;
/// A ridge raises no node by more than so many times its height over its surroundings: beside a wall the slope over a pitch is not
/// that of the surface. Between equal flanks it raises a node by less than twice.
constexpr double kMostRaise = 2;
/// A place must be so much higher along the surface than the node, or the place found before.
constexpr float kWorth_mm = 2e-6F;

struct Motion {
  Sweep sweep;
  BallWitness ball;
};

Motion motion_of(const BallWitness& ball) {
  Motion motion{{}, ball};
  motion.sweep.from = ball.from;
  motion.sweep.to = ball.to;
  motion.sweep.radius_mm = ball.radius_mm;
  motion.sweep.whole = ball.back_mm == kNothing;
  motion.sweep.back_mm = motion.sweep.whole ? 0 : ball.back_mm;
  motion.sweep.prepare();
  return motion;
}

/// Seen from above, what a motion may make: its contacts lie across it, wedges behind its start.
Box2 contacts(const Sweep& sweep, double beside_mm) {
  if (sweep.whole) return sweep.reach;
  const Vec2 along(sweep.along_x, sweep.along_y);
  const Vec2 across = (Vec2::Ones() - (sweep.cosine * along).cwiseAbs2()).cwiseMax(0).cwiseSqrt() * sweep.radius_mm;
  const Vec2 start = sweep.from.head<2>() - sweep.back_mm * along, end = sweep.to.head<2>();
  const Vec2 beside = Vec2::Constant(beside_mm);
  return {start.cwiseMin(end) - across - beside, start.cwiseMax(end) + across + beside};
}

/// A line of the mesh from one node on to the next, and the motions that may be the lowest there.
struct MeshLine {
  double x = 0, y = 0;  ///< of the node
  int axis = 0;
  std::span<const std::uint32_t> candidates;
  const std::vector<Motion>& motions;

  [[nodiscard]] double at_x(double t) const { return axis == 0 ? x + t : x; }
  [[nodiscard]] double at_y(double t) const { return axis == 1 ? y + t : y; }
  [[nodiscard]] double height(std::uint32_t motion, double t) const { return motions[motion].sweep.height(at_x(t), at_y(t)); }
  /// kNothing where the motion does not reach.
  [[nodiscard]] double slope(std::uint32_t motion, double t) const {
    const BallWitness& ball = motions[motion].ball;
    const SweptPoint point = swept_ball(ball.from, ball.to, ball.radius_mm, at_x(t), at_y(t));
    return point.height == kNothing ? kNothing : axis == 0 ? point.slope_x : point.slope_y;
  }
};

/// Which motion is the lowest at a place on a line.
struct Lowest {
  double t = 0;
  std::uint32_t motion = 0;
  double height = kNothing;
};

Lowest lowest_at(const MeshLine& line, double t) {
  Lowest lowest{t};
  for (const std::uint32_t motion : line.candidates) {
    const double height = line.height(motion, t);
    if (height < lowest.height) lowest = {t, motion, height};
  }
  return lowest;
}

/// Where the surface of `left`, the lowest at one place, comes up to that of `right`, the lowest farther on. Nothing where material
/// that neither reaches stands between.
std::optional<double> meeting(const MeshLine& line, const Lowest& left, const Lowest& right) {
  double low = left.t, high = right.t;
  double at_low = left.height - line.height(right.motion, low);
  double at_high = line.height(left.motion, high) - right.height;
  if (at_low >= 0) return low;
  if (at_high <= 0) return high;
  // False position, the end that stays counting half; by halves where one of the balls does not reach.
  int last = 0;
  for (int round = 0; round < 60 && high - low > kPlace_mm; ++round) {
    const bool finite = std::isfinite(at_low) && std::isfinite(at_high);
    const double middle = low + (high - low) * (finite ? at_low / (at_low - at_high) : 0.5);
    const double at = line.height(left.motion, middle) - line.height(right.motion, middle);
    if (std::isnan(at)) return std::nullopt;
    if (std::abs(at) < kTie_mm / 100) return middle;
    if (at < 0) {
      low = middle;
      at_low = at;
      if (last < 0) at_high /= 2;
    } else {
      high = middle;
      at_high = at;
      if (last > 0) at_low /= 2;
    }
    last = at < 0 ? -1 : 1;
  }
  return (low + high) / 2;
}

/// How far a ball of radius 1 mm may bend below its chord over a length, rising by a slope on average.
double bend(double length_mm, double slope) {
  const double steepness2 = 1 + slope * slope;
  return kSafety * length_mm * length_mm / 8 * steepness2 * std::sqrt(steepness2);
}

/// A place between two others, of one surface both, where another one is lower.
std::optional<Lowest> dip(const MeshLine& line, const Lowest& left, const Lowest& right) {
  const double most = bend(right.t - left.t, (right.height - left.height) / (right.t - left.t));
  for (const std::uint32_t other : line.candidates) {
    if (other == left.motion) continue;
    const double most_of_other = most / line.motions[other].ball.radius_mm;
    if (most_of_other < kShallow_mm) continue;
    // The difference of both heights bends by no more than that, so from below zero it does not get higher at the ends.
    const double above_left = std::sqrt(std::max(0.0, line.height(other, left.t) - left.height));
    if (above_left * above_left > 4 * most_of_other) continue;
    const double above_right = std::sqrt(std::max(0.0, line.height(other, right.t) - right.height));
    if (above_left + above_right > 2 * std::sqrt(most_of_other)) continue;
    double low = left.t, high = right.t;
    for (int half = 0; half < kMostHalves; ++half) {
      const double middle = (low + high) / 2;
      if (line.height(other, middle) < line.height(left.motion, middle) - kTie_mm) return lowest_at(line, middle);
      const double steeper = line.slope(other, middle) - line.slope(left.motion, middle);
      if (!(std::abs(steeper) * (high - low) > kShallow_mm / 8)) break;
      (steeper < 0 ? low : high) = middle;
    }
  }
  return std::nullopt;
}

/// Calls visit(t, height) for the ridges between two places. Where two surfaces meet above a third one, that one is met first, on both
/// sides.
template <typename Visit>
void visit_ridges(const MeshLine& line, const Lowest& left, const Lowest& right, int halves, Visit&& visit) {
  if (halves == 0 || right.t - left.t < kPlace_mm || left.height == kNothing || right.height == kNothing) return;
  std::optional<Lowest> between;
  if (left.motion == right.motion) {
    between = dip(line, left, right);
    if (!between) return;
  } else {
    const auto t = meeting(line, left, right);
    if (!t) return;
    between = lowest_at(line, *t);
    const Lowest left_there{*t, left.motion, line.height(left.motion, *t)};
    const Lowest right_there{*t, right.motion, line.height(right.motion, *t)};
    if (std::abs(left_there.height - right_there.height) > kMeeting_mm) {
      // The rim of a ball's footprint: the surface jumps.
      visit_ridges(line, left, lowest_at(line, *t - kRim_mm), halves - 1, visit);
      visit_ridges(line, lowest_at(line, *t + kRim_mm), right, halves - 1, visit);
      return;
    }
    const double height = std::min(left_there.height, right_there.height);
    if (between->height >= height - kTie_mm) {
      const double before = line.slope(left.motion, *t), behind = line.slope(right.motion, *t);
      if (before - behind > kLeastTurn_rad * (1 + before * before)) visit(*t, height);
      visit_ridges(line, left, left_there, halves - 1, visit);
      visit_ridges(line, right_there, right, halves - 1, visit);
      return;
    }
  }
  visit_ridges(line, left, *between, halves - 1, visit);
  visit_ridges(line, *between, right, halves - 1, visit);
}

struct Node {
  int i = 0, j = 0;
  [[nodiscard]] Node moved(int axis, int by) const { return axis == 0 ? Node{i + by, j} : Node{i, j + by}; }
};

/// A rectangle of nodes. What is the lowest somewhere on a line of the mesh stands above one of the line's ends by no more than `ridge`,
/// what the surface may rise there over the chord between its ends, and `bend / radius`, what a ball may bend below its own chord.
struct Block {
  Vec2 centre = Vec2::Zero(), half = Vec2::Zero();
  double top = -kNothing;
  double ridge = 0, bend = 0;

  void include(const Block& other) {
    top = std::max(top, other.top);
    ridge = std::max(ridge, other.ridge);
    bend = std::max(bend, other.bend);
  }
  [[nodiscard]] double slack(const Sweep& sweep) const { return ridge + bend / sweep.radius_mm; }
  [[nodiscard]] bool may_hold(const Sweep& sweep, double pitch_mm) const { return sweep.slab_over(centre, half, top + slack(sweep), pitch_mm).has_value(); }
};

/// A row of tiles with the rows of nodes next to it, and what may be the lowest where.
class Strip {
 public:
  Strip(const StockField& field, int tile_row);
  void list(std::uint32_t witness);
  /// After the last list().
  void raise(RidgePeaks& peaks);

 private:
  [[nodiscard]] Block block(int i, int j, int columns, int rows) const;
  [[nodiscard]] std::size_t block_of(const Node& node) const {
    return static_cast<std::size_t>(node.i / kBlockNodes) * rows_ + (node.j - begin_) / kBlockNodes;
  }
  [[nodiscard]] bool is_own(const Node& node) const { return node.j >= own_begin_ && node.j < own_end_; }
  [[nodiscard]] bool is_here(const Node& node) const {
    return node.i >= 0 && node.i < heights_.width && node.j >= begin_ && node.j < end_;
  }
  [[nodiscard]] std::uint32_t maker(const Node& node) const { return makers_.at(node.i, node.j); }
  [[nodiscard]] double height(const Node& node) const { return heights_.at(node.i, node.j); }
  [[nodiscard]] bool is_contested(const Node& node) const { return contested_.at(node.i, node.j - begin_) != 0; }
  [[nodiscard]] bool comes_near(const Motion& motion, std::uint32_t witness, int column, int row);
  template <typename Visit>
  void visit_lines(Visit&& visit) const;
  [[nodiscard]] MeshLine line_from(const Node& node, int axis, std::vector<std::uint32_t>& both) const;
  [[nodiscard]] double surface(const Node& node, int axis, double t);
  void raise_along(const Node& node, int axis, RidgePeaks& peaks);

  const StockField& field_;
  const Grid<float>& heights_;
  const Grid<std::uint32_t>& makers_;
  int own_begin_, own_end_;  ///< rows of nodes
  int begin_, end_;          ///< with those next to them
  int rows_;                 ///< of blocks
  std::vector<Block> blocks_, tiles_;
  std::vector<Motion> motions_;
  std::vector<std::vector<std::uint32_t>> lists_;  ///< of motions, by blocks
  Grid<char> contested_;                           ///< by nodes: one that is not the maker may be lower beside the node
  Grid<float> highest_;                            ///< by own nodes: as carried to them
  std::vector<std::uint32_t> both_, beside_;       ///< lists of two blocks
};

/// visit(node, axis) for the lines between nodes that balls have made, along axis from the node.
template <typename Visit>
void Strip::visit_lines(Visit&& visit) const {
  for (int j = begin_; j < end_; ++j) {
    for (int i = 0; i < heights_.width; ++i) {
      const Node node{i, j};
      if (!is_ball(maker(node))) continue;
      for (const int axis : {0, 1}) {
        const Node next = node.moved(axis, 1);
        if (is_here(next) && is_ball(maker(next))) visit(node, axis);
      }
    }
  }
}

Strip::Strip(const StockField& field, int tile_row)
    : field_(field),
      heights_(field.heights()),
      makers_(field.makers()),
      own_begin_(tile_row * kTileNodes),
      own_end_(std::min(own_begin_ + kTileNodes, heights_.height)),
      begin_(std::max(own_begin_ - 1, 0)),
      end_(std::min(own_end_ + 1, heights_.height)),
      rows_((end_ - begin_ + kBlockNodes - 1) / kBlockNodes),
      contested_(heights_.width, end_ - begin_),
      highest_(heights_.width, own_end_ - own_begin_) {
  const float* own = &heights_.values[heights_.index(0, own_begin_)];
  std::copy(own, own + highest_.values.size(), highest_.values.begin());
  for (int i = 0; i < heights_.width; i += kBlockNodes) {
    for (int j = begin_; j < end_; j += kBlockNodes) blocks_.push_back(block(i, j, kBlockNodes, kBlockNodes));
  }
  lists_.resize(blocks_.size());
  const double pitch = field.pitch_mm();
  visit_lines([&](const Node& node, int axis) {
    const Node next = node.moved(axis, 1);
    Block line;
    line.bend = bend(pitch, (height(next) - height(node)) / pitch);
    if (maker(node) != maker(next)) {
      // Each of both makers is convex, so below its chord, which starts from the surface and ends above it.
      const auto above = [&](std::uint32_t witness, const Node& end) {
        const BallWitness& ball = field.witnesses()[witness];
        return swept_ball(ball.from, ball.to, ball.radius_mm, field.x(end.i), field.y(end.j)).height - height(end);
      };
      line.ridge = std::max(0.0, std::min(above(maker(node), next), above(maker(next), node)));
    }
    // Stored heights are rounded.
    line.ridge += std::max(height(node), height(next)) * std::numeric_limits<float>::epsilon();
    blocks_[block_of(node)].include(line);
    blocks_[block_of(next)].include(line);
  });
  for (int i = 0; i < heights_.width; i += kTileNodes) {
    Block tile = block(i, begin_, kTileNodes, end_ - begin_);
    const std::size_t end = std::min(block_of({i + kTileNodes, begin_}), blocks_.size());
    for (std::size_t k = block_of({i, begin_}); k < end; ++k) tile.include(blocks_[k]);
    tiles_.push_back(tile);
  }
}

Block Strip::block(int i, int j, int columns, int rows) const {
  const int i_end = std::min(i + columns, heights_.width), j_end = std::min(j + rows, end_);
  const Vec2 low(field_.x(i), field_.y(j)), high(field_.x(i_end - 1), field_.y(j_end - 1));
  Block result;
  result.centre = (low + high) / 2;
  result.half = (high - low) / 2;
  for (int b = j; b < j_end; ++b) {
    for (int a = i; a < i_end; ++a) result.top = std::max<double>(result.top, heights_.at(a, b));
  }
  return result;
}

bool Strip::comes_near(const Motion& motion, std::uint32_t witness, int column, int row) {
  const Block& block = blocks_[static_cast<std::size_t>(column) * rows_ + row];
  const double slack = block.slack(motion.sweep);
  const int i_begin = column * kBlockNodes, i_end = std::min(i_begin + kBlockNodes, heights_.width);
  const int j_begin = begin_ + row * kBlockNodes, j_end = std::min(j_begin + kBlockNodes, end_);
  // Convex, it is nowhere below its tangent plane.
  const BallWitness& ball = motion.ball;
  const SweptPoint tangent = swept_ball(ball.from, ball.to, ball.radius_mm, block.centre.x(), block.centre.y());
  if (tangent.height < kNothing) {
    double least = kNothing;
    for (int j = j_begin; j < j_end; ++j) {
      const double in_row = tangent.height + tangent.slope_y * (field_.y(j) - block.centre.y());
      for (int i = i_begin; i < i_end; ++i) {
        least = std::min(least, in_row + tangent.slope_x * (field_.x(i) - block.centre.x()) - heights_.at(i, j));
      }
    }
    if (least > slack) return false;
  }
  const double bend = block.bend / ball.radius_mm;
  bool near = false;
  for (int j = j_begin; j < j_end; ++j) {
    for (int i = i_begin; i < i_end; ++i) {
      const double above = motion.sweep.height(field_.x(i), field_.y(j)) - heights_.at(i, j);
      if (above > slack) continue;
      if (bend < kShallow_mm) return true;
      near = true;
      if (makers_.at(i, j) != witness && above < bend + kMeeting_mm) contested_.at(i, j - begin_) = 1;
    }
  }
  return near;
}

void Strip::list(std::uint32_t witness) {
  const Motion motion = motion_of(field_.witnesses()[witness]);
  const double pitch = field_.pitch_mm();
  const StockField::TileRange range = field_.tiles(contacts(motion.sweep, pitch));  // of its columns
  bool is_listed = false;
  for (int tile = range.i0; tile <= range.i1; ++tile) {
    if (!tiles_[tile].may_hold(motion.sweep, pitch)) continue;
    const int end = std::min((tile + 1) * kTileNodes, heights_.width);
    for (int column = tile * kTileBlocks; column * kBlockNodes < end; ++column) {
      for (int row = 0; row < rows_; ++row) {
        const std::size_t k = static_cast<std::size_t>(column) * rows_ + row;
        if (!blocks_[k].may_hold(motion.sweep, pitch) || !comes_near(motion, witness, column, row)) continue;
        lists_[k].push_back(static_cast<std::uint32_t>(motions_.size()));
        is_listed = true;
      }
    }
  }
  if (is_listed) motions_.push_back(motion);
}

MeshLine Strip::line_from(const Node& node, int axis, std::vector<std::uint32_t>& both) const {
  const auto& list = lists_[block_of(node)];
  const auto& next_list = lists_[block_of(node.moved(axis, 1))];
  MeshLine line{field_.x(node.i), field_.y(node.j), axis, list, motions_};
  if (&list != &next_list) {
    both.clear();
    std::set_union(list.begin(), list.end(), next_list.begin(), next_list.end(), std::back_inserter(both));
    line.candidates = both;
  }
  return line;
}

/// The surface on a line of the mesh; straight between nodes where not both are made by balls.
double Strip::surface(const Node& node, int axis, double t) {
  const Node next = node.moved(axis, 1);
  if (is_ball(maker(node)) && is_ball(maker(next))) {
    const double lowest = lowest_at(line_from(node, axis, beside_), t).height;
    if (lowest < kNothing) return lowest;
  }
  const double share = t / field_.pitch_mm();
  return (1 - share) * height(node) + share * height(next);
}

void Strip::raise_along(const Node& node, int axis, RidgePeaks& peaks) {
  const Node next = node.moved(axis, 1);
  if (!is_own(node) && !is_own(next)) return;
  if (maker(node) == maker(next) && !is_contested(node) && !is_contested(next)) return;
  const double pitch = field_.pitch_mm(), half = pitch / 2;
  const MeshLine line = line_from(node, axis, both_);
  // From a place on the line, of this height, with those half a pitch to both sides.
  const auto raise_from = [&](double t, double there, double before, double behind) {
    const double slope = (behind - before) / pitch;
    const double above = there - (before + behind) / 2;
    if (!(above > 0 && above < kNothing)) return;
    const auto raise_node = [&](const Node& end, double end_t) {
      if (!is_own(end)) return;
      const auto raised = static_cast<float>(std::min(there - slope * (t - end_t), height(end) + kMostRaise * above));
      float& highest = highest_.at(end.i, end.j - own_begin_);
      if (raised <= highest + kWorth_mm) return;
      highest = raised;
      const double step = half / PeakOffset::kMost;
      const auto steps = static_cast<std::int8_t>(std::lround((t - end_t) / step));
      peaks.offsets.at(end.i, end.j) = axis == 0 ? PeakOffset{steps, 0} : PeakOffset{0, steps};
      peaks.heights_mm.at(end.i, end.j) = static_cast<float>(there + slope * (steps * step - (t - end_t)));
    };
    if (t <= half) raise_node(node, 0);
    if (t >= half) raise_node(next, pitch);
  };
  raise_from(half, lowest_at(line, half).height, height(node), height(next));
  visit_ridges(line, lowest_at(line, 0), lowest_at(line, pitch), kMostHalves, [&](double t, double there) {
    const Node before = node.moved(axis, -1);
    if (t < half && is_here(before)) {
      raise_from(t, there, surface(before, axis, t + half), lowest_at(line, t + half).height);
    } else if (t > half && is_here(next.moved(axis, 1))) {
      raise_from(t, there, lowest_at(line, t - half).height, surface(next, axis, t - half));
    }
  });
}

void Strip::raise(RidgePeaks& peaks) {
  visit_lines([&](const Node& node, int axis) { raise_along(node, axis, peaks); });
}

}  // namespace

RidgePeaks ridge_peaks(const StockField& field) {
  const Grid<float>& heights = field.heights();
  const std::vector<BallWitness>& witnesses = field.witnesses();
  // The motions of every row of tiles.
  std::vector<std::vector<std::uint32_t>> of_row((heights.height + kTileNodes - 1) / kTileNodes);
  for (std::size_t k = 0; k < witnesses.size(); ++k) {
    // A row also looks at the nodes next to it.
    const StockField::TileRange range = field.tiles(contacts(motion_of(witnesses[k]).sweep, 2 * field.pitch_mm()));
    for (int row = range.j0; row <= range.j1; ++row) of_row[row].push_back(static_cast<std::uint32_t>(k));
  }
  RidgePeaks peaks{heights, Grid<PeakOffset>(heights.width, heights.height)};
  parallel_blocks(of_row.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t row = begin; row < end; ++row) {
      Strip strip(field, static_cast<int>(row));
      for (const std::uint32_t k : of_row[row]) strip.list(k);
      strip.raise(peaks);
    }
  });
  return peaks;
}

}  // namespace lightmill

#include "machine/cut_out.h"

#include <algorithm>
#include <cmath>

#include "cam/outline_region.h"

namespace lightmill {

namespace {

/// A wall that is farther from the outline is another one, or none.
constexpr double kSearched_mm = 1;
constexpr double kOutlinePitch_mm = 0.05;
/// Rays that cross the outline at less than 30 degrees are left to those of the other bundle.
constexpr double kLeastAcross = 0.5;
/// Of the slot's width on either side the walls' own deviation and the raster's take this much at most.
constexpr double kBesideWalls_mm = 0.15;
constexpr double kJustBelow = 0.98;
/// A band along the slot's middle in which widths are read, on either side.
constexpr double kBand_mm = 0.5;
constexpr int kHeightHalvings = 12;

struct Crossing {
  double place = 0;   ///< along the ray
  double normal = 0;  ///< component of the outward normal along it
};

/// Where the line across which `across` is `at` meets the outline.
std::vector<Crossing> crossings(const std::vector<Vec2>& loop, int along, double at) {
  std::vector<Crossing> found;
  const int across = 1 - along;
  for (std::size_t k = 0; k < loop.size(); ++k) {
    const Vec2& a = loop[k];
    const Vec2& b = loop[(k + 1) % loop.size()];
    if ((a[across] > at) == (b[across] > at)) continue;
    const Vec2 way = b - a;
    const Vec2 outward = Vec2(way.y(), -way.x()).normalized();
    if (std::abs(outward[along]) < kLeastAcross) continue;
    found.push_back({a[along] + (at - a[across]) / way[across] * way[along], outward[along]});
  }
  return found;
}

/// Of the wall that belongs to a crossing, mm.
double deviation_at(std::span<const Span> spans, const Crossing& crossing) {
  double nearest = kSearched_mm;
  bool found = false, material = false;
  for (const Span& span : spans) {
    const double off = (crossing.normal > 0 ? span.to : span.from) - crossing.place;
    material = material || (span.from < crossing.place && crossing.place < span.to);
    if (std::abs(off) >= std::abs(nearest)) continue;
    nearest = off;
    found = true;
  }
  if (!found) return material ? kSearched_mm : -kSearched_mm;
  return nearest * crossing.normal;
}

}  // namespace

WallDeviation measure_walls(const SolidStock& solid, const Outline& outline, double from_mm, double to_mm) {
  WallDeviation result;
  const std::vector<Vec2> loop = outline_places(outline, kOutlinePitch_mm);
  const SolidStock::Cells levels = solid.cells(2, from_mm, to_mm);
  double squares = 0;
  for (const int along : {0, 1}) {
    const RayBundle& bundle = solid.rays(along);
    for (int column = 0; column < bundle.columns(); ++column) {
      const double at = solid.place_mm(1 - along, column);
      for (const Crossing& crossing : crossings(loop, along, at)) {
        for (int level = levels.from; level <= levels.to; ++level) {
          const double um = deviation_at(bundle.at(column, level), crossing) * 1000;
          Vec3 place(at, at, solid.place_mm(2, level));
          place[along] = crossing.place;
          ++result.places;
          squares += um * um;
          if (um > result.max_left_um) {
            result.max_left_um = um;
            result.left_place_mm = place;
          }
          if (-um > result.max_gouge_um) {
            result.max_gouge_um = -um;
            result.gouge_place_mm = place;
          }
        }
      }
    }
  }
  if (result.places > 0) result.rms_um = std::sqrt(squares / static_cast<double>(result.places));
  return result;
}

namespace {

/// The slot as z rays see it.
class Slot {
 public:
  using Cells = std::vector<std::pair<int, int>>;

  Slot(const SolidStock& solid, const Outline& part, double width_mm)
      : solid_(solid),
        inner_(part, beside()),
        outer_(part, width_mm - beside()),
        band_from_(part, width_mm / 2 - std::min(kBand_mm, width_mm / 8)),
        band_to_(part, width_mm / 2 + std::min(kBand_mm, width_mm / 8)),
        seen_(columns(), rows()) {
    std::size_t band = 0;
    for (int j = 0; j < rows(); ++j) {
      for (int i = 0; i < columns(); ++i) {
        if (!outer_.contains(place(i, j)) || inner_.contains(place(i, j))) continue;
        cells_.emplace_back(i, j);
        if (in_band(i, j)) ++band;
      }
    }
    const std::vector<Vec2> middle = way_around(part, width_mm / 2);
    double length = 0;
    for (std::size_t k = 0; k < middle.size(); ++k) length += (middle[(k + 1) % middle.size()] - middle[k]).norm();
    width_per_cell_ = band > 0 ? length / static_cast<double>(band) : 0;
  }
  [[nodiscard]] const Cells& cells() const { return cells_; }
  [[nodiscard]] Vec2 place(int i, int j) const { return {solid_.place_mm(0, i), solid_.place_mm(1, j)}; }
  /// Along the slot's middle.
  [[nodiscard]] double width_mm(const Cells& set) const {
    return width_per_cell_ * static_cast<double>(std::count_if(set.begin(), set.end(), [&](const auto& cell) { return in_band(cell.first, cell.second); }));
  }

  /// The connected sets among these cells that stand higher than `level_mm` and reach from one side of the slot to the other.
  std::vector<Cells> bridges(const Cells& among, double level_mm) {
    std::vector<Cells> found;
    ++round_;
    for (const auto& [i, j] : among) {
      if (height(i, j) > level_mm) seen_.at(i, j) = round_;
    }
    for (const auto& start : among) {
      if (seen_.at(start.first, start.second) != round_) continue;
      seen_.at(start.first, start.second) = 0;
      Cells set{start};
      bool at_part = false, at_frame = false;
      for (std::size_t k = 0; k < set.size(); ++k) {
        const auto [i, j] = set[k];
        for (const auto& [di, dj] : {std::pair(1, 0), std::pair(-1, 0), std::pair(0, 1), std::pair(0, -1)}) {
          const int a = i + di, b = j + dj;
          if (a < 0 || b < 0 || a >= columns() || b >= rows()) continue;
          at_part = at_part || inner_.contains(place(a, b));
          at_frame = at_frame || !outer_.contains(place(a, b));
          if (seen_.at(a, b) != round_) continue;
          seen_.at(a, b) = 0;
          set.emplace_back(a, b);
        }
      }
      if (at_part && at_frame) found.push_back(std::move(set));
    }
    return found;
  }

 private:
  [[nodiscard]] double beside() const { return kBesideWalls_mm + solid_.pitch_mm().maxCoeff(); }
  [[nodiscard]] int columns() const { return solid_.rays(2).columns(); }
  [[nodiscard]] int rows() const { return solid_.rays(2).rows(); }
  /// Of the material that stands on the blank's back.
  [[nodiscard]] double height(int i, int j) const {
    const auto spans = solid_.rays(2).at(i, j);
    return spans.empty() || spans.front().from > 0 ? 0.0 : static_cast<double>(spans.front().to);
  }

  [[nodiscard]] bool in_band(int i, int j) const { return band_to_.contains(place(i, j)) && !band_from_.contains(place(i, j)); }

  const SolidStock& solid_;
  OutlineRegion inner_, outer_, band_from_, band_to_;
  double width_per_cell_ = 0;
  Grid<int> seen_;
  int round_ = 0;
  Cells cells_;
};

}  // namespace

std::vector<Tab> find_tabs(const SolidStock& solid, const Outline& part, double slot_mm, double least_mm) {
  Slot slot(solid, part, slot_mm);
  std::vector<Tab> tabs;
  for (const Slot::Cells& bridge : slot.bridges(slot.cells(), least_mm)) {
    Tab tab;
    double low = least_mm, high = solid.blank().height_mm;
    for (int k = 0; k < kHeightHalvings; ++k) {
      const double middle = (low + high) / 2;
      (slot.bridges(bridge, middle).empty() ? high : low) = middle;
    }
    tab.height_mm = low;
    std::size_t cells = 0;
    for (const Slot::Cells& set : slot.bridges(bridge, kJustBelow * low)) {
      cells += set.size();
      tab.width_mm += slot.width_mm(set);
      for (const auto& [i, j] : set) tab.place_mm += slot.place(i, j);
    }
    tab.place_mm /= static_cast<double>(std::max<std::size_t>(cells, 1));
    tabs.push_back(tab);
  }
  return tabs;
}

}  // namespace lightmill

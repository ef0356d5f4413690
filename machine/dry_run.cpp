#include "machine/dry_run.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>

#include "cam/outline_region.h"
#include "design/core/errors.h"
#include "design/core/parallel.h"
#include "design/core/text.h"

namespace lightmill {

namespace {

/// Pitch of the closing: its fillets have the ball's curvature, so that bilinear interpolation is at most
/// pitch^2 / 8 R high, 0.16 um at R 2 mm.
constexpr double kClosingPitch_mm = 0.05;
/// Left out along an outline: the walls of the cut-out begin there.
constexpr double kOutlineRim_mm = 0.02;
/// Cusps are counted in bins for their percentile.
constexpr double kCuspBin_um = 0.001;
constexpr int kCuspBins = 100000;

/// Heights over the reachable surface are counted as finely and as far to either side of it; what is beyond counts as there.
constexpr double kHeightBin_um = 0.05;
constexpr int kHeightBins = 20000;
/// The histogram leaves out this share of the area at either end, and has as many bins at most.
constexpr double kOuterShare = 1e-3;
constexpr double kMostHistogramBins = 60;

/// Area by height over the reachable surface in bins of kHeightBin_um; the one of zero is number kHeightBins.
using HeightAreas = std::vector<double>;

void add_area(HeightAreas& areas, double height_um, double area_mm2) {
  const double bin = std::clamp(std::floor(height_um / kHeightBin_um), -1.0 * kHeightBins, kHeightBins - 1.0);
  areas[static_cast<std::size_t>(bin + kHeightBins)] += area_mm2;
}

/// In the narrowest bins of 1, 2 or 5 times a power of ten that are few enough.
DeviationHistogram histogram_of(const HeightAreas& fine) {
  DeviationHistogram histogram;
  const double outer = kOuterShare * std::accumulate(fine.begin(), fine.end(), 0.0);
  if (outer <= 0) return histogram;
  const int last = 2 * kHeightBins - 1;
  int low = 0, high = last;
  for (double below = fine[low]; below <= outer; below += fine[++low]) {
  }
  for (double above = fine[high]; above <= outer; above += fine[--high]) {
  }
  int merged = 1;  // fine bins in one
  for (const int step : {1, 2, 4, 10, 20, 40, 100, 200, 400, 1000}) {
    merged = step;
    if (high - low + 1 <= (kMostHistogramBins - 1) * merged) break;
  }
  // Zero stays an edge.
  const auto edge = [&](int bin) { return static_cast<int>(std::floor(static_cast<double>(bin - kHeightBins) / merged)); };
  histogram.bin_um = merged * kHeightBin_um;
  histogram.first_um = edge(low) * histogram.bin_um;
  histogram.area_mm2.assign(edge(high) - edge(low) + 1, 0);
  for (int bin = 0; bin <= last; ++bin) {
    if (edge(bin) < edge(low)) histogram.below_mm2 += fine[bin];
    else if (edge(bin) > edge(high)) histogram.above_mm2 += fine[bin];
    else histogram.area_mm2[edge(bin) - edge(low)] += fine[bin];
  }
  return histogram;
}

struct Measures {
  double gouge = 0, cusp = 0, residue = 0;
  Vec2 gouge_place = Vec2::Zero(), cusp_place = Vec2::Zero();
  std::size_t gouged = 0;
};

}  // namespace

Deviation measure_deviation(const MachinedSurface& machined, const SplineSurface& design,
                            const DeviationOptions& options, const Monitor& monitor) {
  if (!(options.finishing_ball_radius_mm > 0)) {
    throw InputError("finishing_ball_radius_mm must be above 0, not " + compact(options.finishing_ball_radius_mm, 4));
  }
  ReachableSurface reachable = reachable_surface(
      design, options.finishing_ball_radius_mm, std::max(machined.pitch_mm, kClosingPitch_mm), monitor.part(0, 0.6));
  if (options.outline) reachable = within(std::move(reachable), *options.outline);
  return measure_deviation(machined, design, reachable, options, monitor.part(0.6, 1));
}

Deviation measure_deviation(const MachinedSurface& machined, const SplineSurface& design,
                            const ReachableSurface& reachable, const DeviationOptions& options,
                            const Monitor& monitor) {
  const int width = machined.heights_mm.width;
  const int height = machined.heights_mm.height;
  Deviation result;
  result.deviation_um = Grid<float>(width, height);
  result.unreachable_area_mm2 = reachable.unreachable_area_mm2;

  Box2 measured = design.extent();
  measured.min += Vec2::Constant(options.border_mm - 1e-9);
  measured.max -= Vec2::Constant(options.border_mm - 1e-9);
  std::optional<OutlineRegion> within;
  if (options.outline) within.emplace(*options.outline, -kOutlineRim_mm);
  const Grid<float>& closing = reachable.closing_mm;

  // Blocks of rows do not depend on the threads; they are put together in order.
  constexpr std::size_t kRows = 32;
  const std::size_t blocks = (height + kRows - 1) / kRows;
  std::vector<Measures> measures(blocks);
  std::vector<float> cusps(machined.peaks_mm.values.size(), -1.0F);  // of reachable nodes
  constexpr std::size_t kBlocksPerReport = 16;
  HeightAreas heights(2 * kHeightBins);
  std::vector<HeightAreas> block_heights(std::min(kBlocksPerReport, blocks));
  // What a node stands for of a line of them: half as much at the rim.
  const auto share = [&](double at, double least, double most) {
    return std::clamp(std::min(at + machined.pitch_mm / 2, most) - std::max(at - machined.pitch_mm / 2, least), 0.0, machined.pitch_mm);
  };
  for (std::size_t first = 0; first < blocks; first += kBlocksPerReport) {
    monitor.report("comparing with the design", static_cast<double>(first) / blocks);
    const std::size_t count = std::min(kBlocksPerReport, blocks - first);
    parallel_blocks(count, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t block = first + begin; block < first + end; ++block) {
        Measures& m = measures[block];
        HeightAreas& areas = block_heights[block - first];
        areas.assign(heights.size(), 0);
        const int j_end = static_cast<int>(std::min<std::size_t>((block + 1) * kRows, height));
        for (int j = static_cast<int>(block * kRows); j < j_end; ++j) {
          const double y = machined.extent.min.y() + machined.pitch_mm * j;
          for (int i = 0; i < width; ++i) {
            const double x = machined.extent.min.x() + machined.pitch_mm * i;
            const std::size_t node = machined.heights_mm.index(i, j);
            const SplineSurface::Sample there = design.sample(x, y);
            const double design_height = there.h;
            const double node_height = machined.heights_mm.values[node];
            result.deviation_um.values[node] = static_cast<float>((node_height - design_height) * 1000);
            if (within && !within->contains({x, y})) {
              result.deviation_um.values[node] = std::numeric_limits<float>::quiet_NaN();
              continue;
            }
            if (!measured.contains({x, y})) continue;

            // The closing and its residue in the cell around.
            const double a = std::clamp((x - reachable.extent.min.x()) / reachable.pitch_mm, 0.0, closing.width - 1.0);
            const double b = std::clamp((y - reachable.extent.min.y()) / reachable.pitch_mm, 0.0, closing.height - 1.0);
            const int ia = std::min(static_cast<int>(a), std::max(closing.width - 2, 0));
            const int jb = std::min(static_cast<int>(b), std::max(closing.height - 2, 0));
            const int ia1 = std::min(ia + 1, closing.width - 1);
            const int jb1 = std::min(jb + 1, closing.height - 1);
            const double fa = a - ia;
            const double fb = b - jb;
            const double closed = (1 - fb) * ((1 - fa) * closing.at(ia, jb) + fa * closing.at(ia1, jb)) +
                                  fb * ((1 - fa) * closing.at(ia, jb1) + fa * closing.at(ia1, jb1));
            const double residue =
                std::max(std::max(reachable.residue_um.at(ia, jb), reachable.residue_um.at(ia1, jb)),
                         std::max(reachable.residue_um.at(ia, jb1), reachable.residue_um.at(ia1, jb1)));
            const bool cut_again = options.rest_pass && residue >= reachable.threshold_um;
            const double gouge = ((cut_again ? design_height : std::max(closed, design_height)) - node_height) * 1000;
            add_area(areas, -gouge, share(x, measured.min.x(), measured.max.x()) * share(y, measured.min.y(), measured.max.y()));
            if (gouge > m.gouge) {
              m.gouge = gouge;
              m.gouge_place = {x, y};
            }
            if (gouge > options.gouge_tolerance_um) ++m.gouged;
            // A peak that stands beside what is measured is not the node's.
            Vec2 place = machined.peak_place_mm(i, j);
            double peak = machined.peaks_mm.values[node];
            if (!measured.contains(place)) {
              place = {x, y};
              peak = node_height;
            }
            const SplineSurface::Sample below = machined.peak_offsets.values[node] == PeakOffset{} ? there : design.sample(place.x(), place.y());
            peak = (peak - below.h) * 1000;
            if (residue < reachable.threshold_um) {
              // Along the normal, as a cusp is meant.
              const double cusp = peak / std::sqrt(1 + below.hx * below.hx + below.hy * below.hy);
              cusps[node] = static_cast<float>(std::max(cusp, 0.0));
              if (cusp > m.cusp) {
                m.cusp = cusp;
                m.cusp_place = place;
              }
            } else {
              m.residue = std::max(m.residue, peak);
            }
          }
        }
      }
    });
    for (std::size_t k = 0; k < count; ++k) {
      std::transform(heights.begin(), heights.end(), block_heights[k].begin(), heights.begin(), std::plus<>());
    }
  }
  result.histogram = histogram_of(heights);
  std::size_t gouged = 0;
  for (const Measures& m : measures) {
    gouged += m.gouged;
    if (m.gouge > result.max_gouge_um) {
      result.max_gouge_um = m.gouge;
      result.gouge_place_mm = m.gouge_place;
    }
    if (m.cusp > result.max_cusp_um) {
      result.max_cusp_um = m.cusp;
      result.cusp_place_mm = m.cusp_place;
    }
    result.residue_um = std::max(result.residue_um, m.residue);
  }
  result.gouged_area_mm2 = static_cast<double>(gouged) * machined.pitch_mm * machined.pitch_mm;

  // The 99th percentile to a bin; above the bins it is the highest.
  std::vector<std::size_t> bins(kCuspBins + 1, 0);
  std::size_t total = 0;
  for (const float cusp : cusps) {
    if (cusp < 0) continue;
    ++bins[static_cast<std::size_t>(std::min(cusp / kCuspBin_um, static_cast<double>(kCuspBins)))];
    ++total;
  }
  std::size_t below = 0;
  for (int bin = 0; bin <= kCuspBins && total > 0; ++bin) {
    below += bins[bin];
    if (static_cast<double>(below) >= 0.99 * static_cast<double>(total)) {
      result.p99_cusp_um =
          bin == kCuspBins ? result.max_cusp_um : std::min((bin + 1) * kCuspBin_um, result.max_cusp_um);
      break;
    }
  }
  monitor.report("comparing with the design", 1);
  return result;
}

namespace {

/// Weights of a Gaussian at whole pitches, from the centre outwards, of sum 1 with both sides. Beyond 6 sigma 2e-9 is
/// left out.
std::vector<double> gaussian(double sigma_nodes) {
  const int reach = static_cast<int>(std::ceil(6 * sigma_nodes));
  std::vector<double> weights(reach + 1);
  double sum = 0;
  for (int k = 0; k <= reach; ++k) {
    weights[k] = std::exp(-0.5 * (k / sigma_nodes) * (k / sigma_nodes));
    sum += (k == 0 ? 1 : 2) * weights[k];
  }
  for (double& weight : weights) weight /= sum;
  return weights;
}

/// A node beyond a line's ends, by point reflection about the end nodes (heights and slopes go on, so that the rim is not
/// flattened): sign * f[index] + first * f[0] + last * f[count - 1], whatever far out.
struct Continued {
  int index = 0;
  double sign = 1;
  double first = 0;
  double last = 0;
};

Continued continued(int index, int count) {
  Continued result;
  while (count > 1 && (index < 0 || index >= count)) {
    const bool below = index < 0;
    (below ? result.first : result.last) += 2 * result.sign;
    result.sign = -result.sign;
    index = (below ? 0 : 2 * (count - 1)) - index;
  }
  result.index = count > 1 ? index : 0;
  return result;
}

}  // namespace

Grid<float> polish(const Grid<float>& heights_mm, double pitch_mm, double sigma_um) {
  if (!(pitch_mm > 0)) throw InputError("the pitch must be above 0, not " + compact(pitch_mm, 6) + " mm");
  if (!(sigma_um >= 0)) throw InputError("dry_run.polish_sigma_um must be at least 0, not " + compact(sigma_um, 3));
  if (sigma_um == 0 || heights_mm.empty()) return heights_mm;
  const std::vector<double> weights = gaussian(sigma_um / 1000 / pitch_mm);
  const int reach = static_cast<int>(weights.size()) - 1;
  const int width = heights_mm.width;
  const int height = heights_mm.height;
  Grid<float> result(width, height);
  // Strips of rows: first down the columns in double, then along the rows.
  constexpr std::size_t kRows = 64;
  parallel_blocks(height, kRows, [&](std::size_t begin, std::size_t end) {
    std::vector<double> padded(static_cast<std::size_t>(width) + 2 * reach);
    std::vector<double> sums(width);
    for (int j = static_cast<int>(begin); j < static_cast<int>(end); ++j) {
      double* const column = padded.data() + reach;
      const float* const centre = &heights_mm.values[static_cast<std::size_t>(j) * width];
      for (int i = 0; i < width; ++i) column[i] = weights[0] * centre[i];
      const auto add_row = [&](int row_index, double weight) {
        const float* const row = &heights_mm.values[static_cast<std::size_t>(row_index) * width];
        for (int i = 0; i < width; ++i) column[i] += weight * row[i];
      };
      for (int k = 1; k <= reach; ++k) {
        for (const int beside : {j - k, j + k}) {
          const Continued at = continued(beside, height);
          add_row(at.index, weights[k] * at.sign);
          if (at.first != 0) add_row(0, weights[k] * at.first);
          if (at.last != 0) add_row(height - 1, weights[k] * at.last);
        }
      }
      const auto beyond = [&](int i) {
        const Continued at = continued(i, width);
        return at.sign * column[at.index] + at.first * column[0] + at.last * column[width - 1];
      };
      for (int k = 1; k <= reach; ++k) {
        column[-k] = beyond(-k);
        column[width - 1 + k] = beyond(width - 1 + k);
      }
      for (int i = 0; i < width; ++i) sums[i] = weights[0] * column[i];
      constexpr int kSpan = 512;  // stays in the first cache for all weights
      for (int from = 0; from < width; from += kSpan) {
        const int to = std::min(from + kSpan, width);
        for (int k = 1; k <= reach; ++k) {
          const double weight = weights[k];
          for (int i = from; i < to; ++i) sums[i] += weight * (column[i - k] + column[i + k]);
        }
      }
      float* const out = &result.values[static_cast<std::size_t>(j) * width];
      for (int i = 0; i < width; ++i) out[i] = static_cast<float>(sums[i]);
    }
  });
  return result;
}

double polish_removal_um(const MachinedSurface& milled, const Grid<float>& polished_mm, const Outline& outline, double rim_mm) {
  const OutlineRegion looked_at(outline, -rim_mm);
  double most = 0;
  for (int j = 0; j < polished_mm.height; ++j) {
    for (int i = 0; i < polished_mm.width; ++i) {
      if (!looked_at.contains(milled.extent.min + milled.pitch_mm * Vec2(i, j))) continue;
      most = std::max(most, static_cast<double>(polished_mm.at(i, j)) - milled.heights_mm.at(i, j));
    }
  }
  return most * 1000;
}

}  // namespace lightmill

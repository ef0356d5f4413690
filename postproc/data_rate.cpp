#include "postproc/data_rate.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "design/core/text.h"

namespace lightmill {
namespace {

constexpr double kBitsPerByte = 10;
constexpr double kUsable = 0.9;

}  // namespace

DataRate data_rate(const MachineModel& machine, std::span<const double> feed_seconds, std::size_t bytes,
                   std::size_t blocks, int baud) {
  constexpr double unlimited = std::numeric_limits<double>::infinity();
  DataRate rate;
  rate.bytes_per_block = blocks > 0 ? static_cast<double>(bytes) / static_cast<double>(blocks) : 0;
  if (machine.min_block_s > 0) rate.control_blocks_per_s = 1 / machine.min_block_s;
  if (baud > 0 && rate.bytes_per_block > 0)
    rate.link_blocks_per_s = kUsable * baud / (kBitsPerByte * rate.bytes_per_block);
  const double control = rate.control_blocks_per_s > 0 ? rate.control_blocks_per_s : unlimited;
  const double link = rate.link_blocks_per_s > 0 ? rate.link_blocks_per_s : unlimited;
  const double given = std::min(control, link);

  const std::span<const double> times = feed_seconds;
  const double total_s = std::accumulate(times.begin(), times.end(), 0.0);
  if (times.empty()) return rate;
  rate.mean_blocks_per_s = static_cast<double>(times.size()) / total_s;
  const std::size_t window =
      std::min<std::size_t>(times.size(), static_cast<std::size_t>(std::max(1, machine.planner_blocks)));
  double stretch_s = 0, starved_s = 0;
  for (std::size_t i = 0; i < times.size(); ++i) {
    stretch_s += times[i];
    if (i >= window) stretch_s -= times[i - window];
    if (i + 1 < window) continue;
    const double wanted = static_cast<double>(window) / stretch_s;
    rate.peak_blocks_per_s = std::max(rate.peak_blocks_per_s, wanted);
    // Rounding of the running sum is no starvation.
    if (wanted > given * (1 + 1e-6)) starved_s += times[i];
  }
  rate.starved_share = starved_s / total_s;
  if (rate.starved_share > 0) {
    const bool by_link = link <= control;
    rate.remedy = "the program wants up to " + compact(rate.peak_blocks_per_s, 0) + " blocks/s, " +
                  (by_link ? "the link gives " : "the control gives ") + compact(given, 0) + ": ";
    rate.remedy += by_link ? "run it from the control's disk, use " +
                                 compact(rate.peak_blocks_per_s * rate.bytes_per_block * kBitsPerByte / kUsable, 0) +
                                 " baud, arcs, fewer decimals, or a wider chord_tolerance_um"
                           : "use arcs, a wider chord_tolerance_um or tip_tolerance_um, tool-centre-point control, or a feed "
                             "lower by a factor of " +
                                 compact(rate.peak_blocks_per_s / given, 2);
  }
  return rate;
}

}  // namespace lightmill

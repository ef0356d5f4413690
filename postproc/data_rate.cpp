#include "postproc/data_rate.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>

#include "design/core/text.h"

namespace lightmill {
namespace {

/// Rounding of a running sum is no starvation.
constexpr double kRounding = 1e-6;
constexpr double kBitsPerByte = 10;
constexpr double kUsable = 0.9;  // the rest is left for acknowledgements that come late
constexpr int kUsualBauds[] = {9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600, 1000000, 2000000, 3000000, 4000000};

double link_blocks_per_s(int baud, double bytes_per_block) { return kUsable * baud / (kBitsPerByte * bytes_per_block); }

}  // namespace

double wanted_baud(double wanted_per_s, double bytes_per_block) { return bytes_per_block * wanted_per_s * kBitsPerByte / kUsable; }

int least_baud(double wanted_per_s, double bytes_per_block) {
  const auto* const found = std::find_if(std::begin(kUsualBauds), std::end(kUsualBauds),
                                         [&](int baud) { return link_blocks_per_s(baud, bytes_per_block) * (1 + kRounding) >= wanted_per_s; });
  return found == std::end(kUsualBauds) ? 0 : *found;
}

DataRate data_rate(const MachineModel& machine, std::span<const double> feed_seconds, std::size_t bytes,
                   std::size_t blocks, int baud) {
  constexpr double unlimited = std::numeric_limits<double>::infinity();
  DataRate rate;
  rate.bytes_per_block = blocks > 0 ? static_cast<double>(bytes) / static_cast<double>(blocks) : 0;
  if (machine.min_block_s > 0) rate.control_blocks_per_s = 1 / machine.min_block_s;
  if (baud > 0 && rate.bytes_per_block > 0)
    rate.link_blocks_per_s = link_blocks_per_s(baud, rate.bytes_per_block);
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
    if (wanted > given * (1 + kRounding)) starved_s += times[i];
  }
  rate.starved_share = starved_s / total_s;
  if (rate.starved_share > 0) {
    const bool by_link = link <= control;
    rate.remedy = "the program wants up to " + compact(rate.peak_blocks_per_s, 0) + " blocks/s, " +
                  (by_link ? "the link gives " : "the control gives ") + compact(given, 0) + ": ";
    if (by_link && rate.peak_blocks_per_s <= control * (1 + kRounding)) {
      const int enough = least_baud(rate.peak_blocks_per_s, rate.bytes_per_block);
      rate.remedy += enough > 0 ? "use a line of " + std::to_string(enough) + " baud (stream.baud), or "
                                : "no usual line is fast enough, so ";
    }
    rate.remedy += "lower the feed by a factor of " + fixed(std::ceil(100 * rate.peak_blocks_per_s / given) / 100, 2) + " (max_feed_mm_per_min)";
  }
  return rate;
}

}  // namespace lightmill

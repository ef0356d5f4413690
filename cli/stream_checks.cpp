#include "cli/stream_checks.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "cli/stages.h"
#include "design/core/text.h"
#include "postproc/data_rate.h"

namespace lightmill {

using nlohmann::json;

std::string checklist(const Job& job) {
  std::string text = "Before the start, confirm each:\n";
  text += "  blank   clamped as on the setup sheet, " + compact(job.lens.size_mm.x(), 1) + " x " +
          compact(job.lens.size_mm.y(), 1) + " mm lens on it, protective film off\n";
  text += "  zero    G" + std::to_string(job.machine.work_offset) + " on the centre of the blank's back\n";
  for (const auto* pass : {&job.rough.cutter, &job.semi_finish.cutter, &job.finish.cutter}) {
    text += "  tool    T" + std::to_string(pass->number) + " " + pass->name + ", " + compact(pass->length_mm, 2) +
            " mm from the spindle's nose to the tip\n";
  }
  text += "  spindle warmed up\n  coolant air on, no oil\n  guard   closed";
  return text;
}

std::string slow_link(const json& report, int baud) {
  std::string text;
  if (!report.contains("postproc") || baud <= 0) return text;
  for (const auto& [pass, figures] : report.at("postproc").items()) {
    if (!figures.is_object() || !figures.contains("data_rate")) continue;
    const json& rate = figures.at("data_rate");
    const double bytes = rate.value("bytes_per_block", 0.0), peak = rate.value("peak_blocks_per_s", 0.0);
    const double needed = wanted_baud(peak, bytes);
    if (needed <= baud) continue;
    text += (text.empty() ? "" : "\n") + pass + " wants up to " + compact(std::ceil(peak), 0) + " blocks of " +
            compact(bytes, 0) + " bytes a second, " + compact(std::ceil(needed), 0) + " baud; this line has " +
            std::to_string(baud) + " and will starve it (the cutter stops in the cut): a faster line, a lower feed, or " +
            "longer blocks (a larger tolerance, arcs) help";
  }
  return text;
}

}  // namespace lightmill

#include "postproc/detail/rs274.h"

#include "design/core/text.h"

namespace lightmill::detail {

std::string Rs274::comment(const std::string& text) const {
  return "(" + text + ")";
}

Blocks Rs274::safe_modes(const Sheet& sheet) const {
  return {"G21 G90 G94 G17 G40 G49 G80 G" + std::to_string(sheet.work_offset) +
          (sheet.arcs && !arc_centre_is_relative ? " G91.1" : "")};
}

std::string Rs274::machine_move(const std::string& words) const {
  return "G53 G0 " + words;
}

Blocks Rs274::tool_change(const Sheet& sheet) const {
  return {"T" + std::to_string(sheet.tool) + " M6"};
}

Blocks Rs274::spindle_on(const Sheet& sheet) const {
  return {"S" + compact(sheet.rpm, 0) + " M3",
          "G4 P" + (dwell_in_ms ? compact(1000 * sheet.dwell_s, 0) : compact(sheet.dwell_s, 3))};
}

Blocks Rs274::coolant_off_spindle_off(bool coolant) const {
  return {coolant ? "M5 M9" : "M5"};
}

Blocks Rs274::descend(const Sheet&, bool) const {
  return {};
}

Blocks Rs274::length_off(const Sheet&) const {
  return {"G49"};
}

}  // namespace lightmill::detail

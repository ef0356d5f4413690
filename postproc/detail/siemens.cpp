#include "design/core/text.h"
#include "postproc/detail/dialect.h"

namespace lightmill::detail {

namespace {

// Frames (the work offset) are given again after TRAORI, which may reset them. SUPA does not take the tool's length
// away, D0 does; D1 brings it back before the tool goes down. Unverified on a machine.
class Siemens final : public Dialect {
 public:
  Siemens() {
    name = "siemens";
    title = "Siemens 840D: tool length from the tool offset (D1), TRAORI, unverified";
    extension = ".MPF";
    language = Language::kSiemens;
    most_decimals = 6;
    name_prefix = "LM_";
    upper_case = true;
    modulo_rotary = true;
    tcp = true;
    smoothing_needed = true;
    least_linear_mm = 1e-3;
  }
  [[nodiscard]] std::string first_lines(const Sheet& sheet) const override { return "; %_N_" + sheet.name + "_MPF\n"; }
  [[nodiscard]] std::string comment(const std::string& text) const override { return "; " + text; }
  [[nodiscard]] Blocks safe_modes(const Sheet& sheet) const override {
    Blocks blocks{"G17 G40 G71 G90 G94 G" + std::to_string(sheet.work_offset)};
    if (sheet.has_tcp) blocks.insert(blocks.begin(), "TRAFOOF");
    return blocks;
  }
  [[nodiscard]] std::string machine_move(const std::string& words) const override { return "SUPA G0 " + words + " D0"; }
  [[nodiscard]] Blocks tool_change(const Sheet& sheet) const override {
    return {"T" + std::to_string(sheet.tool) + " M6"};
  }
  [[nodiscard]] Blocks spindle_on(const Sheet& sheet) const override {
    return {"S" + compact(sheet.rpm, 0) + " M3", "G4 F" + compact(sheet.dwell_s, 3)};
  }
  [[nodiscard]] Blocks coolant_off_spindle_off(bool coolant) const override { return {coolant ? "M5 M9" : "M5"}; }
  [[nodiscard]] Blocks before_cut(const Sheet& sheet) const override {
    return {"CYCLE832(" + compact(sheet.smoothing_mm, 6) +
            (sheet.turning ? ",_ORI_FINISH," + compact(sheet.smoothing_deg, 6) : std::string(",_FINISH,1")) + ")"};
  }
  [[nodiscard]] Blocks descend(const Sheet& sheet, bool) const override {
    if (!sheet.tcp) return {"D1"};
    return {"D1", "TRAORI", "G" + std::to_string(sheet.work_offset), "ORIWKS ORIAXES"};
  }
  [[nodiscard]] Blocks tcp_off(const Sheet&) const override { return {"TRAFOOF"}; }
  [[nodiscard]] Blocks after_cut(const Sheet&) const override { return {"CYCLE832(0,_OFF,1)"}; }
};

}  // namespace

const Dialect& siemens_dialect() {
  static const Siemens dialect;
  return dialect;
}

}  // namespace lightmill::detail

#include "postproc/detail/rs274.h"

namespace lightmill::detail {

namespace {

// Increment system IS-C: four decimals. G5.1 Q1: AI contour control. G43 and G43.4 may move the axes themselves, so
// they stand in the block that goes down. Unverified on a machine.
class Fanuc final : public Rs274 {
 public:
  Fanuc() {
    name = "fanuc";
    title = "Fanuc 30i: tool length from the offset table (G43 H, G43.4 H), unverified";
    most_decimals = 4;
    whole_digits = 5;
    percent = true;
    program_number = true;
    decimal_point = true;
    upper_case = true;
    dwell_in_ms = true;
    length_with_descent = true;
    tcp = true;
    smoothing_needed = true;
    least_linear_mm = 1e-3;
    arc_centre_is_relative = true;
  }
  [[nodiscard]] Blocks coolant_off_spindle_off(bool coolant) const override {
    return coolant ? Blocks{"M5", "M9"} : Blocks{"M5"};  // one M code per block
  }
  [[nodiscard]] Blocks before_cut(const Sheet&) const override { return {"G5.1 Q1"}; }
  [[nodiscard]] Blocks descend(const Sheet& sheet, bool first) const override {
    if (sheet.tcp) return {"G43.4 H" + std::to_string(sheet.tool)};
    return first ? Blocks{"G43 H" + std::to_string(sheet.tool)} : Blocks{};
  }
  [[nodiscard]] Blocks tcp_off(const Sheet&) const override { return {"G49"}; }
  [[nodiscard]] Blocks after_cut(const Sheet&) const override { return {"G5.1 Q0"}; }
  [[nodiscard]] Blocks length_off(const Sheet& sheet) const override {
    return sheet.tcp ? Blocks{} : Rs274::length_off(sheet);  // done before the machine's top
  }
};

}  // namespace

const Dialect& fanuc_dialect() {
  static const Fanuc dialect;
  return dialect;
}

}  // namespace lightmill::detail

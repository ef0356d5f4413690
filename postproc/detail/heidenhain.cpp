#include "design/core/text.h"
#include "postproc/detail/dialect.h"

namespace lightmill::detail {

namespace {

constexpr int kDatumOfG54 = 53;  // G54 is datum 1 of the preset table

// What both languages of a TNC share. Under M128 the tool's length must reach to the ball's centre: DL in the tool call
// takes the radius off, so that the tool table keeps the length to the tip. [iTNC 530 manual; TNC 430 p. 494: limits]
class Tnc : public Dialect {
 public:
  Tnc() {
    most_decimals = 4;
    whole_digits = 5;
    feed_decimals = 3;
    line_end = "\r\n";
    upper_case = true;
    plus_sign = true;
    tcp = true;
    tcp_ball_centre = true;
    smoothing_needed = true;
    least_linear_mm = 1e-3;
  }
  [[nodiscard]] std::string comment(const std::string& text) const override { return "; " + text; }
  [[nodiscard]] Blocks coolant_off_spindle_off(bool coolant) const override { return {coolant ? "M5 M9" : "M5"}; }
  [[nodiscard]] Blocks descend(const Sheet& sheet, bool) const override {
    return sheet.tcp ? Blocks{"M128"} : Blocks{};
  }
  [[nodiscard]] Blocks tcp_off(const Sheet&) const override { return {"M129"}; }

 protected:
  [[nodiscard]] static std::string delta(const Sheet& sheet) {
    return sheet.delta_mm != 0 ? " DL" + sheet.number(sheet.delta_mm) : "";
  }
  [[nodiscard]] static std::string corner(const Sheet& sheet, const Vec3& at) {
    return "X" + sheet.number(at.x()) + " Y" + sheet.number(at.y()) + " Z" + sheet.number(at.z());
  }
};

class Conversational final : public Tnc {
 public:
  Conversational() {
    name = "heidenhain";
    title = "Heidenhain iTNC 530 conversational: tool length from TOOL.T, M128, unverified";
    extension = ".H";
    language = Language::kConversational;
  }
  [[nodiscard]] Blocks opening(const Sheet& sheet) const override {
    return {"BEGIN PGM " + sheet.name + " MM", "BLK FORM 0.1 Z " + corner(sheet, sheet.blank_min_mm),
            "BLK FORM 0.2 " + corner(sheet, sheet.blank_max_mm)};
  }
  [[nodiscard]] Blocks safe_modes(const Sheet& sheet) const override {
    Blocks blocks{"CYCL DEF 247 DATUM SETTING ~\r\n  Q339=+" + std::to_string(sheet.work_offset - kDatumOfG54)};
    if (sheet.has_tcp) blocks.insert(blocks.begin(), "M129");
    if (sheet.endless_inner) blocks.emplace_back("M126");
    return blocks;
  }
  [[nodiscard]] std::string machine_move(const std::string& words) const override {
    return "L " + words + " R0 FMAX M91";
  }
  [[nodiscard]] Blocks tool_change(const Sheet& sheet) const override {
    return {"TOOL CALL " + std::to_string(sheet.tool) + " Z S" + compact(sheet.rpm, 0) + delta(sheet)};
  }
  [[nodiscard]] Blocks spindle_on(const Sheet& sheet) const override {
    return {"M3", "CYCL DEF 9.0 DWELL TIME", "CYCL DEF 9.1 DWELL " + compact(sheet.dwell_s, 3)};
  }
  [[nodiscard]] Blocks before_cut(const Sheet& sheet) const override {
    return {"CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1 T" + compact(sheet.smoothing_mm, 6),
            "CYCL DEF 32.2 HSC-MODE:0 TA" + compact(sheet.smoothing_deg, 6)};
  }
  [[nodiscard]] Blocks after_cut(const Sheet&) const override { return {"CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1"}; }
  [[nodiscard]] Blocks closing(const Sheet& sheet) const override {
    Blocks blocks;
    if (sheet.endless_inner) blocks.emplace_back("M127");
    blocks.emplace_back("M30");
    blocks.push_back("END PGM " + sheet.name + " MM");
    return blocks;
  }
};

// No word for a block's time is known here, so turning axes need M128.
class Iso final : public Tnc {
 public:
  Iso() {
    name = "heidenhain_iso";
    title = "Heidenhain iTNC 530 DIN/ISO: as conversational, no time word, unverified";
    extension = ".I";
    language = Language::kHeidenhainIso;
    inverse_time = false;
  }
  [[nodiscard]] std::string first_lines(const Sheet& sheet) const override { return "%" + sheet.name + " G71 *\r\n"; }
  [[nodiscard]] Blocks opening(const Sheet& sheet) const override {
    return {"G30 G17 " + corner(sheet, sheet.blank_min_mm), "G31 G90 " + corner(sheet, sheet.blank_max_mm)};
  }
  [[nodiscard]] Blocks safe_modes(const Sheet& sheet) const override {
    Blocks blocks{"G90 G40", "G247 Q339=+" + std::to_string(sheet.work_offset - kDatumOfG54)};
    if (sheet.has_tcp) blocks.insert(blocks.begin(), "M129");
    if (sheet.endless_inner) blocks.emplace_back("M126");
    return blocks;
  }
  [[nodiscard]] std::string machine_move(const std::string& words) const override { return "G00 " + words + " M91"; }
  [[nodiscard]] Blocks tool_change(const Sheet& sheet) const override {
    return {"T" + std::to_string(sheet.tool) + " G17 S" + compact(sheet.rpm, 0) + delta(sheet)};
  }
  [[nodiscard]] Blocks spindle_on(const Sheet& sheet) const override {
    return {"M3", "G04 F" + compact(sheet.dwell_s, 3)};
  }
  [[nodiscard]] Blocks before_cut(const Sheet& sheet) const override {
    return {"G62 T" + compact(sheet.smoothing_mm, 6) + " P01 0 P02 " + compact(sheet.smoothing_deg, 6)};
  }
  [[nodiscard]] Blocks after_cut(const Sheet&) const override { return {"G62"}; }
  [[nodiscard]] Blocks closing(const Sheet& sheet) const override {
    return sheet.endless_inner ? Blocks{"M127", "M30"} : Blocks{"M30"};
  }
  [[nodiscard]] std::string last_lines(const Sheet& sheet) const override {
    return "N99999999 %" + sheet.name + " G71 *\r\n";
  }
};

}  // namespace

const Dialect& heidenhain_dialect() {
  static const Conversational dialect;
  return dialect;
}

const Dialect& heidenhain_iso_dialect() {
  static const Iso dialect;
  return dialect;
}

}  // namespace lightmill::detail

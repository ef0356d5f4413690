#include "design/core/text.h"
#include "postproc/detail/rs274.h"

namespace lightmill::detail {

namespace {

// G64 P: blending within 2 um. Below 1 um of X, Y, Z release 2.9 takes the wrong time for a G93 block (issue 2410).
// M428 and M429 are the remaps of the shipped trunnion configurations (switchkins).
class LinuxCnc final : public Rs274 {
 public:
  LinuxCnc() {
    name = "linuxcnc";
    title = "RS274/NGC for LinuxCNC: tool length from the tool table (G43 H)";
    extension = ".ngc";
    percent = true;
    tcp = true;
    tcp_inverse_time = true;
    smoothing_needed = true;
    least_linear_mm = 1e-3;
  }
  [[nodiscard]] Blocks safe_modes(const Sheet& sheet) const override {
    Blocks blocks = Rs274::safe_modes(sheet);
    blocks.front() += " G64 P" + compact(sheet.smoothing_mm, 6);
    if (sheet.has_tcp) blocks.insert(blocks.begin(), "M429");
    return blocks;
  }
  // The tool's length here does not move Z.
  [[nodiscard]] Blocks before_cut(const Sheet& sheet) const override { return {"G43 H" + std::to_string(sheet.tool)}; }
  [[nodiscard]] Blocks descend(const Sheet& sheet, bool) const override {
    return sheet.tcp ? Blocks{"M428"} : Blocks{};
  }
  [[nodiscard]] Blocks tcp_off(const Sheet&) const override { return {"M429"}; }
};

}  // namespace

const Dialect& linuxcnc_dialect() {
  static const LinuxCnc dialect;
  return dialect;
}

}  // namespace lightmill::detail

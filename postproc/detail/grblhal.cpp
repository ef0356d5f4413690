#include "postproc/detail/rs274.h"

namespace lightmill::detail {

namespace {

class GrblHal final : public Rs274 {
 public:
  GrblHal() {
    name = "grblhal";
    title = "RS274 for grblHAL: tool length in the program (G43.1)";
    length_in_table = false;
  }
  [[nodiscard]] Blocks tool_change(const Sheet& sheet) const override {
    Blocks blocks = Rs274::tool_change(sheet);
    blocks.push_back("G43.1 Z" + sheet.number(sheet.length_mm));
    return blocks;
  }
};

}  // namespace

const Dialect& grblhal_dialect() {
  static const GrblHal dialect;
  return dialect;
}

}  // namespace lightmill::detail

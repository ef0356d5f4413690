// Phrases of RS274 words, as grblHAL, LinuxCNC and Fanuc share them.
#pragma once

#include "postproc/detail/dialect.h"

namespace lightmill::detail {

class Rs274 : public Dialect {
 public:
  Rs274() { arcs = true; }
  [[nodiscard]] std::string comment(const std::string& text) const override;
  [[nodiscard]] Blocks safe_modes(const Sheet& sheet) const override;
  [[nodiscard]] std::string machine_move(const std::string& words) const override;
  [[nodiscard]] Blocks tool_change(const Sheet& sheet) const override;
  [[nodiscard]] Blocks spindle_on(const Sheet& sheet) const override;
  [[nodiscard]] Blocks coolant_off_spindle_off(bool coolant) const override;
  [[nodiscard]] Blocks descend(const Sheet& sheet, bool first) const override;
  [[nodiscard]] Blocks length_off(const Sheet& sheet) const override;
};

}  // namespace lightmill::detail

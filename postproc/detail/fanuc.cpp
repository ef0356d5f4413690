#include "postproc/detail/dialect.h"

namespace lightmill::detail {

// Increment system IS-C: four decimals. G5.1 Q1: AI contour control. Unverified on a machine.
const Dialect& fanuc_dialect() {
  static constexpr Dialect dialect{.name = "fanuc",
                                   .title = "Fanuc 30i: tool length from the offset table (G43 H), unverified",
                                   .smoothing_on = "G5.1 Q1",
                                   .smoothing_off = "G5.1 Q0",
                                   .most_decimals = 4,
                                   .percent = true,
                                   .program_number = true,
                                   .decimal_point = true,
                                   .upper_case = true,
                                   .length_in_table = true,
                                   .dwell_in_ms = true,
                                   .one_m_per_block = true};
  return dialect;
}

}  // namespace lightmill::detail

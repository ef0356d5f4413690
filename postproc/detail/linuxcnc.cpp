#include "postproc/detail/dialect.h"

namespace lightmill::detail {

// G64 P: blending within 2 um. Below 1 um of X, Y, Z release 2.9 takes the wrong time for a G93 block (issue 2410).
const Dialect& linuxcnc_dialect() {
  static constexpr Dialect dialect{.name = "linuxcnc",
                                   .title = "RS274/NGC for LinuxCNC: tool length from the tool table (G43 H)",
                                   .extension = ".ngc",
                                   .modes = "G64 P0.002",
                                   .percent = true,
                                   .length_in_table = true,
                                   .least_linear_mm = 1e-3};
  return dialect;
}

}  // namespace lightmill::detail

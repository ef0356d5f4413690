#include "postproc/detail/dialect.h"

namespace lightmill::detail {

const Dialect& grblhal_dialect() {
  static constexpr Dialect dialect{.name = "grblhal", .title = "RS274 for grblHAL: tool length in the program (G43.1)"};
  return dialect;
}

}  // namespace lightmill::detail

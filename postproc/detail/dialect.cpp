#include "postproc/detail/dialect.h"

#include <string>

#include "design/core/errors.h"

namespace lightmill::detail {

std::vector<const Dialect*> all_dialects() {
  return {&grblhal_dialect(), &linuxcnc_dialect(), &fanuc_dialect()};
}

const Dialect& dialect_of(std::string_view controller) {
  std::string known;
  for (const Dialect* dialect : all_dialects()) {
    if (dialect->name == controller) return *dialect;
    known += (known.empty() ? "" : ", ") + std::string(dialect->name);
  }
  throw InputError("no program can be written for controller '" + std::string(controller) + "' yet; known here: " + known);
}

}  // namespace lightmill::detail

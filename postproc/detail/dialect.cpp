#include "postproc/detail/dialect.h"

#include <string>

#include "design/core/errors.h"
#include "design/core/text.h"

namespace lightmill::detail {

std::string NumberStyle::operator()(double value) const {
  std::string text = compact(value, decimals);
  if (plus && text.front() != '-') text.insert(0, "+");
  if (point && text.find('.') == std::string::npos) text += '.';
  return text;
}

std::vector<const Dialect*> all_dialects() {
  return {&grblhal_dialect(), &linuxcnc_dialect(),   &fanuc_dialect(),
          &siemens_dialect(), &heidenhain_dialect(), &heidenhain_iso_dialect()};
}

const Dialect& dialect_of(std::string_view controller) {
  std::string known;
  for (const Dialect* dialect : all_dialects()) {
    if (dialect->name == controller) return *dialect;
    known += (known.empty() ? "" : ", ") + std::string(dialect->name);
  }
  throw InputError("no program can be written for controller '" + std::string(controller) + "'; known here: " + known);
}

}  // namespace lightmill::detail

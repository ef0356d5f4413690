// Numbers as text without locale, exponent or minus zero.
#pragma once

#include <string>

namespace lightmill {

/// `value` with exactly `decimals` decimals, rounded half to even on the binary value; never "-0", never an exponent.
std::string fixed(double value, int decimals);

/// As fixed(), with trailing zeros and a trailing point removed ("1.5", "2").
std::string compact(double value, int decimals);

}  // namespace lightmill

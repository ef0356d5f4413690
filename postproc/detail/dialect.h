// What differs between the controllers that read RS274 words: data only, one source file per controller.
#pragma once

#include <string_view>
#include <vector>

namespace lightmill::detail {

struct Dialect {
  std::string_view name;             ///< [controller] kind
  std::string_view title;
  std::string_view extension = ".nc";
  std::string_view modes{};            ///< beside the safe modes of the first block
  std::string_view smoothing_on{};     ///< blocks around the cut
  std::string_view smoothing_off{};
  int most_decimals = 8;
  bool percent = false;              ///< the program stands between two lines of %
  bool program_number = false;       ///< O word on the first line
  bool decimal_point = false;        ///< X1 would be a micrometre: X1.
  bool upper_case = false;           ///< also in comments
  bool length_in_table = false;      ///< G43 H instead of G43.1 Z
  bool dwell_in_ms = false;
  bool one_m_per_block = false;
  /// A G93 block with turning axes and a shorter way of X, Y, Z than this runs at the wrong speed: it is written as two.
  double least_linear_mm = 0;
};

const Dialect& grblhal_dialect();
const Dialect& linuxcnc_dialect();
const Dialect& fanuc_dialect();

std::vector<const Dialect*> all_dialects();
/// Throws InputError naming the machine's controller and those that can be written.
const Dialect& dialect_of(std::string_view controller);

}  // namespace lightmill::detail

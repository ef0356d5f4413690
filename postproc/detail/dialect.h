// What differs between the controllers: facts for the moves and phrases around them, one source file per controller.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "design/core/geometry.h"

namespace lightmill::detail {

enum class Language { kRs274, kSiemens, kHeidenhainIso, kConversational };

/// How numbers stand in the text.
struct NumberStyle {
  int decimals = 5;
  bool point = false;  ///< X1 would be a micrometre: X1.
  bool plus = false;   ///< X+1
  [[nodiscard]] std::string operator()(double value) const;
};

/// What the phrases around the moves speak of.
struct Sheet {
  std::string name;  ///< of the program, as the control knows it
  NumberStyle number;
  int work_offset = 54;
  bool has_tcp = false;  ///< the control has tool-centre-point control, so its state must be set
  bool tcp = false;      ///< this pass uses it
  bool endless_inner = false;
  Vec3 blank_min_mm = Vec3::Zero(), blank_max_mm = Vec3::Zero();  ///< a box around the cut, for the control's graphics
  // The tool of a pass.
  int tool = 1;
  double rpm = 0;
  double dwell_s = 0;
  double length_mm = 0;  ///< spindle nose to tip
  double delta_mm = 0;   ///< from the tip to the point the program speaks of, along the tool downwards
  double smoothing_mm = 0, smoothing_deg = 0;
  bool turning = false;  ///< rotary axes move in the cut
  bool arcs = false;     ///< the cut may hold some
};

using Blocks = std::vector<std::string>;

class Dialect {
 public:
  virtual ~Dialect() = default;

  std::string_view name;  ///< [controller] kind
  std::string_view title;
  std::string_view extension = ".nc";
  Language language = Language::kRs274;
  int most_decimals = 8;
  int feed_decimals = 9;
  int whole_digits = 6;  ///< of a coordinate, before the point
  std::string_view line_end = "\n";
  std::string_view name_prefix{};  ///< of programs, where they must begin with letters
  bool upper_case = false;         ///< names and comments
  bool decimal_point = false;
  bool plus_sign = false;
  bool percent = false;              ///< the program stands between two lines of %
  bool program_number = false;       ///< O word on the first line
  bool length_in_table = true;       ///< otherwise the program says the tool's length (G43.1)
  bool length_with_descent = false;  ///< the tool's length is called in the block that goes down from the machine's top
  bool dwell_in_ms = false;
  bool modulo_rotary = false;     ///< an endless axis is written within a turn: C=DC(...)
  bool inverse_time = true;       ///< has a word for a block's time
  bool arc_centre_is_relative = false;  ///< always; otherwise G91.1 makes it so
  bool arcs = false;              ///< G2 and G3 in three planes do not touch the tool's length
  bool tcp = false;               ///< can have tool-centre-point control
  bool tcp_inverse_time = false;  ///< keeps inverse time under it
  bool tcp_ball_centre = false;   ///< which then guides the ball's centre
  bool smoothing_needed = false;  ///< for every cut
  /// A block with turning axes and a shorter way of X, Y, Z than this runs at the wrong speed: it is written as two.
  double least_linear_mm = 0;

  // Phrases: blocks without numbers and ends.
  [[nodiscard]] virtual std::string first_lines(const Sheet&) const { return {}; }  ///< whole lines before block one
  [[nodiscard]] virtual Blocks opening(const Sheet&) const { return {}; }
  [[nodiscard]] virtual std::string comment(const std::string& text) const = 0;
  [[nodiscard]] virtual Blocks safe_modes(const Sheet&) const = 0;
  /// A rapid to machine coordinates, given as words.
  [[nodiscard]] virtual std::string machine_move(const std::string& words) const = 0;
  [[nodiscard]] virtual Blocks tool_change(const Sheet&) const = 0;
  [[nodiscard]] virtual Blocks spindle_on(const Sheet&) const = 0;
  [[nodiscard]] virtual Blocks coolant_off_spindle_off(bool coolant) const = 0;
  [[nodiscard]] virtual Blocks before_cut(const Sheet&) const { return {}; }  ///< at the machine's top
  /// Before, or (where length_with_descent) in front of the words of, the block that leaves the machine's top.
  [[nodiscard]] virtual Blocks descend(const Sheet&, bool first) const = 0;
  [[nodiscard]] virtual Blocks tcp_off(const Sheet&) const { return {}; }  ///< before the machine's top
  [[nodiscard]] virtual Blocks after_cut(const Sheet&) const { return {}; }
  [[nodiscard]] virtual Blocks length_off(const Sheet&) const { return {}; }
  [[nodiscard]] virtual Blocks closing(const Sheet&) const { return {"M30"}; }
  [[nodiscard]] virtual std::string last_lines(const Sheet&) const { return {}; }
};

const Dialect& grblhal_dialect();
const Dialect& linuxcnc_dialect();
const Dialect& fanuc_dialect();
const Dialect& siemens_dialect();
const Dialect& heidenhain_dialect();
const Dialect& heidenhain_iso_dialect();

std::vector<const Dialect*> all_dialects();
/// Throws InputError naming the machine's controller and those that can be written.
const Dialect& dialect_of(std::string_view controller);

}  // namespace lightmill::detail

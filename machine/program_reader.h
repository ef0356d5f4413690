// Whole programs as the controls that run files read them: text in, machine motion out, or the first thing not
// understood.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "postproc/machine_model.h"

namespace lightmill {

enum class ReaderDialect { kLinuxCnc, kFanuc, kHeidenhain, kHeidenhainIso, kSiemens };

/// "linuxcnc", "fanuc", "siemens", "heidenhain" (conversational), "heidenhain_iso"; throws InputError for any other name.
ReaderDialect reader_dialect(std::string_view name);

/// X, Y, Z, outer, inner; mm and rad.
using AxisValues = std::array<double, 5>;

/// What the operator has entered at the control.
struct ReaderSetup {
  std::array<AxisValues, 9> offsets{};   ///< G54, G55 ... G59, G59.1, G59.2, G59.3; datums 1 to 9 on Heidenhain
  std::map<int, double> tool_length_mm;    ///< tool table
  std::map<int, double> tool_diameter_mm;  ///< tool table, for G41 and G42; negative: the other side
  AxisValues start{};                    ///< machine coordinates
  long most_blocks = 100'000'000;        ///< executed; a program that needs more does not end
};

/// One thing for the machine to do, in the order of execution.
struct ProgramStep {
  enum Kind : std::uint8_t { kMove, kDwell, kSpindle, kCoolant, kChangeTool, kPause, kEnd };
  Kind kind = kMove;
  long line = 0;  ///< of the text, from 1
  long block = 0;  ///< its count in the order of execution, from 1
  bool rapid = false;
  bool tcp = false;         ///< kMove: made under tool-centre-point control
  bool whole = true;        ///< kMove: ends at a programmed point; false: a chord on the way there
  AxisValues target{};      ///< kMove: machine coordinates
  AxisValues programmed{};  ///< kMove: in the active work offset; under TCP X, Y, Z are the tip in the workpiece frame
  double seconds = 0;       ///< kMove: at the programmed feed (0: rapid); kDwell
  double corner_tolerance_mm = -1;  ///< kMove: how far the tip may leave its end; 0: not at all; below 0: as the control does
  bool exact_stop = false;  ///< kMove: stands at its end
  int number = 0;           ///< tool; spindle 3, 4, 5; coolant 7, 8, 9; kMove: the tool whose length an H has called, 0: none has
  double rpm = 0;
};

/// Where and why a control would have stopped.
struct ProgramError {
  long line = 0;
  int column = 0;  ///< from 1
  std::string rule;
};

struct ReadResult {
  long blocks = 0;                    ///< executed
  bool ended = false;                 ///< by the program's own end
  std::optional<ProgramError> error;  ///< nothing after it was executed
};

/// Reads the whole program; `on_step` hears every step up to the end or the first error. Throws nothing of its own.
ReadResult read_program(std::string_view text, ReaderDialect dialect, const MachineModel& machine,
                        const ReaderSetup& setup, const std::function<void(const ProgramStep&)>& on_step);

}  // namespace lightmill

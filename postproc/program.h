// Axis motion to program text in the machine's RS274 dialect.
#pragma once

#include <string>
#include <vector>

#include "postproc/axis_motion.h"

namespace lightmill {

struct ProgramOptions {
  int decimals = 5;                  ///< of mm and degrees
  bool block_numbers = false;        ///< N words (for checks)
  std::string job_name;
  std::string job_hash;
  double warm_up_s = 8;              ///< spindle dwell before the first cut; the machine's own start time if that is longer
};

struct Program {
  std::string file_name;             ///< "30_finish.nc"
  std::string text;                  ///< ASCII, LF
  std::size_t blocks = 0;            ///< lines that are not comments
};

/// "10_rough.nc", "20_semi_finish.nc", "30_finish.nc"; "40_<pass>.nc" for other passes.
std::string program_file_name(const std::string& pass);

/// Header, tool change, spindle with dwell, air, machine-top Z before any rotary move, footer. Feed moves are G94 if no
/// rotary joint moves in any of them, otherwise all G93 with F = 1/minutes on every line, rounded down. Words: the gauge
/// point less the work offset's zero (and less the tool's length in Z, which G43.1 adds again); only those that changed.
/// Throws InputError for a spindle speed the machine has not, and NumericalError if the finished text fails
/// check_program_text().
Program write_program(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                      const ProgramOptions& options = {});

/// A dialect as `lightmill dialects` lists it; each is a file detail/<name>.cpp.
struct DialectFacts {
  std::string name;
  std::string title;
  std::string extension;
  int most_decimals = 0;
};
std::vector<DialectFacts> dialects();

}  // namespace lightmill

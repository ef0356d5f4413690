// A program's motions without any stock, and which of them left the surface as it is somewhere.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "machine/program_run.h"

namespace lightmill {

/// Tells every motion of a program as `dialect` ("grblhal" or a reader's) means it, its line as the text counts. Behind a line that
/// is not understood a reader's program has no motions.
void trace_program(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect, std::string_view program,
                   const std::function<void(const Motion&, const std::vector<SweptMove>&)>& on_motion);

/// Where the tip stands behind the first motion of a line or, if it has none, of those after it; workpiece frame.
std::optional<Vec3> place_of_line(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                                  std::string_view program, long line);

/// The motion that cut deepest at a place.
struct Maker {
  std::string program;
  long line = 0;
  Vec3 place_mm = Vec3::Zero();  ///< on the surface
  std::string picture;           ///< SVG: a section through cutter and surface there
};

/// Which motion of the programs, carried out in their order, left `surface` as it is at a place; the first of those that cut as
/// deep. None if no cutter comes there.
std::optional<Maker> maker_of(const MachineModel& machine, const OperatorSetup& setup, const std::string& dialect,
                              const std::vector<ProgramFile>& programs, const MachinedSurface& surface, const Vec2& place_mm);

}  // namespace lightmill

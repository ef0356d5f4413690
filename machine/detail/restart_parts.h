// What restarts of every dialect have in common: the place to go on from, and the way out of the work.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "machine/kinematics.h"
#include "machine/program_lines.h"
#include "machine/restart.h"

namespace lightmill::detail {

/// The index of a line of the text, or of the next one that is not blank.
std::size_t index_of_line(const std::vector<ProgramLine>& lines, long number);
/// The same for the line that a restart is asked for. Throws InputError if the program does not reach so far.
std::size_t index_to_go_on_at(const std::vector<ProgramLine>& lines, long number);

/// What a line does, as far as a restart asks.
struct LineFacts {
  bool good = true;    ///< the program can go on with it: its modes can be set without moving
  bool plain = true;   ///< nothing but feed moves, offset and tool length stay
  bool feeds = false;
  double cut_mm = 0;   ///< the tip's way at feed
  bool stops_spindle = false;
};

/// The index of the line to go on with; the last of `lines` is the first one that may not be cut. Goes back by the
/// overlap over plain lines only, to a good one; 0: nothing was cut before. `low_without_spindle`: nothing can be fed in
/// there, so it is the line that stopped the spindle. `overlap_mm` becomes what was found.
std::size_t restart_index(const std::vector<LineFacts>& lines, bool low_without_spindle, double& overlap_mm);

/// From the tip along the tool's axis out of the box around blank and clamps, and the clearance and the tool's radius more.
double way_out_mm(const OperatorSetup& setup, const ToolPose& pose, int tool, double clearance_mm);

/// How the linear axes move for a millimetre along the tool's axis away from the work. A head that stands upright, and
/// every table, has it along Z.
Vec3 outwards(WorkpieceView& view, const JointPosition& at);
/// How far a restart backs out along the tool's axis before it goes up, of `wanted_mm`; 0 where up is outwards.
double back_out_mm(const MachineModel& machine, const Vec3& outwards, double z_mm, double wanted_mm);
/// Out of the cut along the tool's axis, in machine coordinates.
JointPosition backed_out(WorkpieceView& view, const JointPosition& at, double mm);

/// Adds the piece if it comes nearer to the place than the radius.
void add_piece_near(const Vec3& place, double radius_mm, const PathPiece& piece, std::vector<PathPiece>& pieces);

/// Throws InputError if the axes would leave their travels; `text` is the line that moves them there.
void within_travels(const MachineModel& machine, const std::array<double, 5>& joints, std::string_view text);

inline constexpr double kBackOut_mm = 20;  ///< of the operator in a trial

/// The name of a Heidenhain restart in its BEGIN and END blocks is the program's with this behind it.
inline constexpr const char* kFileRestartSuffix = "_R";

/// Printable, without what ends a comment or acts at once on the wire.
std::string plain_comment(std::string_view text);

// Restarts of programs that are files; the text of a grblHAL program is its own affair.
Restart write_file_restart(const MachineModel& machine, const OperatorSetup& setup, std::string_view program, long line,
                           const RestartOptions& options);
std::vector<PathPiece> file_path_near(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                                      const Vec3& place, double radius_mm, const std::string& dialect);
RestartTrial try_file_restart(const MachineModel& machine, const OperatorSetup& setup, const StockOptions& stock,
                              const std::vector<std::string>& done, std::string_view program, const Restart& restart,
                              const std::string& dialect, const Monitor& monitor);

}  // namespace lightmill::detail

// A program that broke off goes on: where it stands, the text that takes it up again, and a trial of it.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "design/core/monitor.h"
#include "machine/journal.h"
#include "machine/simulated_machine.h"

namespace lightmill {

/// What a journal proves of a program, in numbers of lines of its text; 0: none.
struct StreamPlace {
  long acknowledged_line = 0;             ///< the last one with an acknowledgement
  long executed_line = 0;                 ///< the last one that surely is carried out
  long sent_line = 0;                     ///< no line behind it can have been carried out
  long uncut_line = 0;                    ///< the first one that may not have been carried out; 0: all were
  std::string reason;                     ///< how uncut_line follows, in one sentence
  std::optional<JointPosition> reported;  ///< where the axes stood at the last status report
  double report_age_s = 0;                ///< of that report when the journal ends
  long reported_line = 0;  ///< the line on whose way that is, if one of those that may be under way passes there
};

/// The number of the program's last line that is among the first `sent` lines of a stream; 0: none.
long last_line_of(std::string_view program, const JournalHeader& header, long sent);

/// An acknowledgement says that a line was understood, not that it was milled: the planner's blocks and what the
/// control has prepared beyond them are taken off, counted in lines that surely move. Lines that make the control wait
/// for standstill (spindle, coolant, dwell, tool) prove everything before them. Throws InputError if the journal is of
/// another program.
StreamPlace find_place(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                       const JournalSummary& journal);

struct RestartOptions {
  double overlap_mm = 2;           ///< of the tip's way that is gone over again
  double clearance_mm = 5;         ///< from the blank and its clamps to where the feed in begins
  double entry_feed_mm_per_s = 5;  ///< along the tool's axis, down to the restart place
  std::string program_name;        ///< for the text's first comment
  std::string dialect = "grblhal";  ///< of the program
  /// On a tilting head the text begins with so much backing out along the tool's axis, from where it stopped; the way up
  /// would cut. 0: the operator does that.
  double back_out_mm = 20;
  std::optional<JointPosition> stands;  ///< where it stopped, as reported; else as at the restart place
};

/// A program that does the rest of another one.
struct Restart {
  std::string text;
  long entry_lines = 0;   ///< leading lines of its own, as program_lines() counts; 0: the whole program again
  long first_line = 1;    ///< of the original, which follows them to its end, unchanged
  long uncut_line = 1;    ///< of the original, as asked for
  double overlap_mm = 0;  ///< as found: shorter where the cut began, longer by a part of a line
  ToolPose place;         ///< where the cut goes on, workpiece frame, with the length that the program believes
  ToolPose stand_off;     ///< where the feed in along the tool's axis begins
  int tool = 0;
  double tool_length_mm = 0;
  double rpm = 0;
  double dwell_s = 0;
  double backs_out_mm = 0;  ///< of its own accord, before anything else
};

/// The text that mills everything from `line` on: it goes back by the overlap, but not over a rapid, a tool change or
/// anything else that is no plain cut; takes the modal state there from the interpreter; then safe modes, tool-centre-point
/// control off, the machine's top, tool and length, spindle and dwell, coolant, the rotary axes, X and Y above the place,
/// tool-centre-point control on if the program had it, down the tool's axis in a rapid to the clearance and at the low feed
/// to the place, the modes, and the program's own lines (renumbered where the control counts blocks). Before anything was
/// cut it is the whole program. The text is read again before it is returned: no error, the modes and every end point of
/// the original. Throws InputError for a line that is not there, text that the control does not take or that has loops,
/// subprograms or inches as a file, or an entry outside the travels.
Restart write_restart(const MachineModel& machine, const OperatorSetup& setup, std::string_view program, long line,
                      const RestartOptions& options = {});

/// A straight piece of the tip's way in the workpiece frame.
struct PathPiece {
  long line = 0;
  Vec3 from = Vec3::Zero(), to = Vec3::Zero();
  bool rapid = false;
};

/// The pieces of the program that come nearer than `radius_mm` to `place`, in order.
std::vector<PathPiece> path_near(const MachineModel& machine, const OperatorSetup& setup, std::string_view program,
                                 const Vec3& place, double radius_mm, const std::string& dialect = "grblhal");

struct RestartTrial {
  std::vector<Fault> faults;  ///< of the restart only
  MachinedSurface surface;
  double seconds = 0;  ///< of machine time, the restart only
};

/// Mills on the simulated machine the programs that are done, this one up to restart.uncut_line, resets the control,
/// backs out along the tool's axis as the operator would if the restart does not, and mills the restart.
RestartTrial try_restart(const MachineModel& machine, const OperatorSetup& setup, const StockOptions& stock,
                         const std::vector<std::string>& done, std::string_view program, const Restart& restart,
                         const std::string& dialect = "grblhal", const Monitor& monitor = {});

}  // namespace lightmill

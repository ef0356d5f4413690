// Streams a program to a grbl or grblHAL controller: keeps its receive buffer full, never over, and says what happened.
#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "design/core/monitor.h"
#include "machine/connection.h"
#include "machine/journal.h"
#include "machine/program_lines.h"
#include "postproc/machine_model.h"

namespace lightmill {

/// How a connection with a controller begins.
enum class Greeting {
  kReset,  ///< soft reset (refused while the machine moves), then the banner; nothing of an earlier job is left
  kWait,   ///< wait for the banner that a controller sends at power-on
  kNone,   ///< the controller is known to be ready; keep its modal state
};

/// A controller's status report, e.g. "<Hold:0|MPos:0.000,0.000,0.000,0.000,0.000,0.000|Bf:100,1023|FS:1000,36000>".
struct StatusReport {
  std::string state;                     ///< without the part behind a colon ("Hold")
  int substate = -1;                     ///< behind it; Hold:0 has come to rest, Hold:1 is braking
  std::vector<double> machine_position;  ///< mm and degrees, as printed; empty: not reported
  std::vector<double> work_offset;       ///< WCO, only in some reports
  int free_blocks = -1, free_bytes = -1;
  double feed_mm_per_min = -1;           ///< as it moves now
  std::vector<double> overrides;         ///< feed, rapid, spindle in percent, only in some reports
};

/// False if `line` is no status report.
bool parse_status(std::string_view line, StatusReport& report);

/// How far a stream is when a status report has come.
struct StreamStatus {
  long lines_total = 0, lines_acknowledged = 0;
  long lines_executed = 0;      ///< surely
  long line = 0;                ///< of the text: the one that is surely executed last; 0: none
  int under_way_bytes = 0;      ///< sent and not acknowledged
  int receive_buffer_bytes = 0;
  long starved_reports = 0;
  StatusReport report;          ///< work offset and overrides are the last ones reported
};

struct StreamOptions {
  int receive_buffer_bytes = 0;  ///< 0: ask the controller ($I)
  std::chrono::milliseconds reply_timeout{
      5000};  ///< no reply and an idle controller for this long: an acknowledgement is lost
  std::function<void(const std::string&)> on_traffic;  ///< every line sent ("> ") and received ("< "), for the journal
  Greeting greeting = Greeting::kReset;
  std::chrono::milliseconds settle_time{
      100};                ///< of silence before the first line, so that no stale reply is taken for ours
  int longest_line = 256;  ///< characters the controller takes
  /// Status reports are asked for so often while streaming: position, planner, starvation. 0: only when in doubt.
  std::chrono::milliseconds status_interval{250};
  /// Wait for each line's acknowledgement before the next one is sent: slower, for a line or controller that loses bytes.
  bool one_at_a_time = false;
  /// Bytes handed to the system and not on the wire yet: a feed hold waits behind them (128: 11 ms at 115200 baud).
  std::size_t most_queued_bytes = 128;
  /// After so many lines the stream waits until every acknowledgement is there, so that a lost one is noticed near its
  /// place.
  long audit_every_lines = 20000;
  /// Asked when the program stops for the operator (tool change, M0); true: go on, `~` is sent. Without it the stream
  /// ends there. Also asked when the machine is held for longer than reply_timeout without the program's wish (false: the
  /// stream ends; without it: waits).
  std::function<bool(const std::string& what)> on_operator;
  /// Real-time bytes that the operator wants sent now (! ~ overrides); asked all the time while streaming. A reset (0x18)
  /// means: give up. The machine is held first and reset when it stands, so that it keeps its place.
  std::function<std::string()> commands;
  /// Told at every status report while streaming.
  std::function<void(const StreamStatus&)> on_status;
  /// True: before this line the machine comes to rest and the operator is asked (on_operator), as for a single block,
  /// a line to look at, an optional stop in the line `before` it.
  std::function<bool(const ProgramLine& line, std::string_view before)> pause_before;
  /// The controller's settings ($$) must fit this machine file, or nothing is sent; null: not asked.
  const MachineModel* machine = nullptr;
  /// Told before lines are sent, and when they are acknowledged or a status is reported. When it cannot be written the
  /// machine is held.
  Journal* journal = nullptr;
};

enum class StreamEnd {
  kDone,
  kControllerError,
  kAlarm,
  kLostAcknowledgement,
  kReset,
  kHungUp,
  kStopped,
  kAborted,  ///< by the operator: the machine has stopped, was reset, and keeps its place
  kJournal,
  kWrongPlace,  ///< the machine has come to rest elsewhere than the program says: a line was garbled or lost
};

/// Lines are counted without blank ones; `error_line` and the line numbers in `message` are those of the text.
struct StreamResult {
  StreamEnd end = StreamEnd::kDone;
  std::string message;  ///< one line: what is known and what is not
  long lines_total = 0;
  long lines_sent = 0;
  long lines_acknowledged = 0;  ///< by an ok, or proven executed by a status report
  long lines_executed = 0;      ///< surely: acknowledged, and no longer in the planner at the last status report
  std::vector<double> last_position;  ///< MPos of the last status report
  long error_line = 0;          ///< of the program, if the controller named one
  long bytes_sent = 0;
  double seconds = 0;
  double streaming_seconds = 0;  ///< of them from the first line sent to the last acknowledgement
  int highest_buffer_fill = 0;          ///< unacknowledged bytes, at most receive_buffer_bytes - 1
  int receive_buffer_bytes = 0;         ///< as used
  /// Oks that got lost although position and modes are as after their lines; the one thing that looks the same is a
  /// whole line lost whose effect a later one has undone, so the message names where.
  long recovered_acknowledgements = 0;
  long repeated_blocks = 0;  ///< blockwise transfer: sent again because the control refused them
  long starved_reports = 0;  ///< status reports that found the planner empty between two motions: the line is too slow
  long first_starved_line = 0;
  [[nodiscard]] bool done() const { return end == StreamEnd::kDone; }
};

/// Sends the whole program in the controller's check mode ($C): it reads every line as if to execute it, and nothing
/// moves. Finds what the controller would refuse before it can refuse it in the cut. Leaves check mode, by which the
/// controller resets itself. Throws as stream_program() does.
StreamResult check_program(Connection& connection, std::string_view program, const StreamOptions& options = {},
                           const Monitor& monitor = {});

/// Where settings ($n, as `$$` lists them) contradict the machine file, in words: units, laser mode, spindle, speeds,
/// accelerations, travels. Settings that the controller does not list are not compared.
std::vector<std::string> setting_differences(const std::map<int, double>& settings, const MachineModel& machine);

/// Connects (greeting, drain, one empty line with exactly one ok), streams the program by character counting, waits
/// until the machine is idle. Lines go as they stand, but without blanks around them and without blank lines. Never
/// repeats a line and never skips one: on any doubt it stops feeding, holds the machine and returns. The one thing it
/// recovers from is a single lost ok, and only when two status reports say that the machine is idle with empty buffers,
/// and position and modes are what the lines sent so far ask for. Lines that would read as one valid line if the line
/// feed between them got lost are never under way together. Throws InputError, before anything is sent, for a line the
/// controller could not take (too long; bytes that act at once, as ? ! ~ or those above 127, even in a comment; `$`
/// commands). Throws IoError if no controller answers or it is not ready.
StreamResult stream_program(Connection& connection, std::string_view program, const StreamOptions& options = {},
                            const Monitor& monitor = {});

}  // namespace lightmill

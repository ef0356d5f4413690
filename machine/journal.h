// A stream's journal: what was sent, acknowledged and reported, appended and synced, so that a killed sender or a power
// cut does not lose the place.
#pragma once

#include <chrono>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "design/core/errors.h"
#include "machine/clock.h"

namespace lightmill {

/// The journal cannot be written: whoever streams holds the machine and says so.
struct JournalError : IoError {
  using IoError::IoError;
};

/// What a stream is about. Counts of lines are those of program_lines(), numbers of lines those of the text.
struct JournalHeader {
  std::string program;         ///< file name of the program that is milled
  std::string program_digest;  ///< program_digest() of it
  std::string sent_digest;     ///< of the text that is sent; another one when it is a restart of the program
  std::string machine_digest;  ///< of the machine file
  std::string job_digest;      ///< of the job or whatever else the program was made from
  std::string started;         ///< date and time for people
  long lines = 0;              ///< of the text that is sent
  int planner_blocks = 0;      ///< of the controller, at most
  // A restart sends `entry_lines` of its own, then the program from `first_line` on.
  long entry_lines = 0;
  long first_line = 1;
  long uncut_line = 1;  ///< everything before it was cut by earlier streams
};

struct JournalOptions {
  /// A power cut takes at most the records of so long a time (and what the disk itself has promised and not kept).
  std::chrono::milliseconds sync_every{500};
  /// Acknowledgements and unchanged states are recorded no more often; what is missing makes the place found an earlier
  /// one, never a later one.
  std::chrono::milliseconds record_every{100};
  /// Sent lines are announced so many at a time, before they go out.
  long announce_lines = 64;
  const Clock* clock = nullptr;  ///< of the records; null: the wall's
};

/// Appends. One line of text a record, closed by a digest of all records so far. Grows with time and lines, about 1 kB
/// a second at most while the machine keeps its pace; memory does not grow. Syncing has a thread of its own, so that a
/// slow disk does not starve the machine. All throw JournalError when the disk is full or gone, also when an earlier
/// sync failed.
class Journal {
 public:
  /// Creates the file, which must not be there yet.
  Journal(const std::filesystem::path& path, const JournalHeader& header, const JournalOptions& options = {});
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// The first `lines` lines are about to have been sent.
  void sending(long lines);
  /// The first `lines` lines have their acknowledgement.
  void acknowledged(long lines);
  /// All of the first `lines` lines had their acknowledgement and no other was under way.
  void audited(long lines);
  /// A status report of the controller, as it came.
  void reported(std::string_view status);
  /// Anything else worth knowing: an error, an alarm, what the operator did.
  void note(std::string_view what);
  /// The last record, on the disk when this returns: "done", or why the stream ended early.
  void end(std::string_view how, std::string_view message);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct JournalRecord {
  double seconds = 0;  ///< since the stream began
  std::string
      kind;  ///< "sending", "acknowledged", "audited", "reported", "note", "message", "end", or a key of the header
  std::string text;
};

/// Calls for each whole record in order, up to the first that is torn or changed; returns how many bytes are behind it.
/// Throws InputError if the file cannot be read or is no journal.
std::size_t read_records(const std::filesystem::path& path, const std::function<void(const JournalRecord&)>& on_record);

/// What a journal tells about the stream.
struct JournalSummary {
  JournalHeader header;
  long records = 0;
  std::size_t torn_bytes = 0;  ///< of a record that was being written, or damaged
  double seconds = 0;          ///< of the last record
  long sent = 0;               ///< lines sent, at most
  long acknowledged = 0;       ///< lines acknowledged, at least
  long audited = 0;            ///< up to here no acknowledgement was missing
  std::string report;          ///< the last status report, empty: none
  double report_seconds = 0;
  long acknowledged_at_report = 0;
  std::deque<JournalRecord> last_notes;  ///< the last 20
  std::string end;                       ///< "done", ...; empty: the sender died
  std::string end_message;
  [[nodiscard]] bool done() const { return end == "done"; }
};
/// Throws InputError that says what is missing when not even the header is whole.
JournalSummary read_journal(const std::filesystem::path& path);

}  // namespace lightmill

// Programs to a controller, with a journal; and what goes on where a stream broke off.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "cli/progress.h"
#include "cli/run_folder.h"

namespace lightmill {

struct StreamChoices {
  std::string what;  ///< run folder or program
  std::string port;  ///< empty: the job's
  int baud = 0;      ///< 0: the job's, else 115200
  std::string protocol;  ///< empty: the job's, or what the dialect's control speaks
  std::string format;    ///< empty: the job's, or the protocol's own
  std::string proof;     ///< folder of the dry run of a single program
  bool unproven = false;  ///< mill without a proof, if somebody types that they mean it
  bool confirm_all = false;
  bool no_check = false;
  bool one_at_a_time = false;  ///< wait for each line's acknowledgement
  std::vector<long> pause_at;  ///< lines of the text that is sent
  bool single_block = false, optional_stops = false;
};

/// Streams one program after the other. Of a run folder only what the dry run has proven, with journals in DIR/stream
/// and a line of summary each in DIR/streams.jsonl. Returns an exit code.
int stream(StreamChoices choices, Progress& progress);

struct ResumeChoices {
  StreamChoices stream;
  long from_line = 0;  ///< 0: as the journal proves
  double overlap_mm = 2;
  bool yes = false;  ///< stream without a typed confirmation
  std::string program;  ///< that broke off, on a control that runs files
};

/// Is the folder's last stream one of its present programs and not through them all?
bool has_broken_stream(const std::filesystem::path& folder);

/// Is there a stream to go on with, or a line that a control which runs files stopped at?
bool can_resume(const ResumeChoices& choices);

/// Says what is known of the stream that broke off, writes the restart with its picture into DIR/stream, tries it on
/// the simulated machine, and, when confirmed, streams it and the programs that follow. Returns an exit code.
int resume_stream(ResumeChoices choices, Progress& progress);
}  // namespace lightmill

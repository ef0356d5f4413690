// How far a stream is, in the time of the dry run: on the terminal, and in a plain log that stays.
#pragma once

#include <chrono>
#include <filesystem>
#include <fstream>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "cli/progress.h"
#include "machine/program_schedule.h"
#include "machine/streamer.h"

namespace lightmill {

/// "2024-06-11 17:05:09", local time.
std::string now_text();

/// Of one program. The log has a line every ten seconds, whenever the machine's state changes, for every reply that is
/// no acknowledgement and for every byte that acts at once.
class StreamProgress {
 public:
  /// Without a schedule the share of lines is shown; without a `log` there is none. Throws IoError if it cannot be written.
  StreamProgress(Progress& progress, ProgramSchedule schedule, const std::filesystem::path& log);

  /// Time counts from here on: what was checked before took none of the schedule's.
  void begin();
  void status(const StreamStatus& status);
  /// For protocols that acknowledge nothing: so many lines have gone out.
  void sent(long lines, long lines_total);
  /// What StreamOptions::on_traffic hears.
  void traffic(std::string_view line);
  void note(std::string_view what);
  /// Figures for the end-of-job summary: planned, held and streamed seconds, the pace.
  [[nodiscard]] nlohmann::json summary() const;

 private:
  Progress& progress_;
  ProgramSchedule schedule_;
  PaceEstimate pace_;
  std::chrono::steady_clock::time_point started_;
  std::ofstream log_;
  std::string state_;
  double logged_s_ = 0, seen_s_ = 0, held_s_ = 0;
  [[nodiscard]] double elapsed_s() const;
  void show(long lines, long lines_total, bool moving, const std::string& what, nlohmann::json details, bool log_now);
};

}  // namespace lightmill

// What the command line shows while a stage works, and how Ctrl-C reaches it.
#pragma once

#include <chrono>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "design/core/monitor.h"

namespace lightmill {

/// One line that is drawn over on a terminal, plain lines every few seconds in a log, JSON lines on stdout for machines.
class Progress {
 public:
  enum class Style { kAuto, kJson, kQuiet };
  explicit Progress(Style style);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// A monitor for a stage that starts now.
  Monitor stage(std::string_view name);
  /// The stage is done, or was found done.
  void done(std::string_view note = "");
  /// What a stage's monitor shows, with a better guess of the time left than from the share that is done; `details` go
  /// into the JSON event.
  void show(std::string_view what, double fraction, std::optional<double> seconds_left,
            const nlohmann::json* details = nullptr);
  /// A line that stays.
  void say(std::string_view line);
  /// An event for --json; silent otherwise.
  void event(const nlohmann::json& event);

 private:
  void clear_line();

  Style style_;
  bool terminal_ = false;
  bool drawn_ = false;
  std::string stage_;
  std::chrono::steady_clock::time_point started_;
  std::chrono::steady_clock::time_point shown_;
};

/// "45 s", "12 min", "1.5 h".
std::string span_of_time(double seconds);

/// From here on SIGINT and SIGTERM only set a flag that stop_requested() reads (and every Monitor of Progress).
void catch_stop_signals();
bool stop_requested();

}  // namespace lightmill

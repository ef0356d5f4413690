// Streams a program to a grblHAL controller: keeps its receive buffer full, never over, and says what happened.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "design/core/monitor.h"
#include "machine/connection.h"

namespace lightmill {

struct StreamOptions {
  int receive_buffer_bytes = 0;       ///< 0: ask the controller ($I)
  std::chrono::milliseconds reply_timeout{5000};  ///< no reply and an idle controller for this long: an acknowledgement is lost
  std::function<void(const std::string&)> on_traffic;  ///< every line sent ("> ") and received ("< "), for the journal
};

enum class StreamEnd { kDone, kControllerError, kAlarm, kLostAcknowledgement, kReset, kHungUp, kStopped };

struct StreamResult {
  StreamEnd end = StreamEnd::kDone;
  std::string message;               ///< one line: what is known and what is not
  long lines_total = 0;
  long lines_sent = 0;
  long lines_acknowledged = 0;
  long error_line = 0;               ///< of the program, if the controller named one
  long bytes_sent = 0;
  double seconds = 0;
  int highest_buffer_fill = 0;       ///< unacknowledged bytes, at most receive_buffer_bytes - 1
  [[nodiscard]] bool done() const { return end == StreamEnd::kDone; }
};

/// Connects (banner or reset, drain, one empty line with exactly one ok), streams the program by character counting, waits
/// until the machine is idle. Never repeats a line and never skips one: on any doubt it stops, holds the machine and returns.
StreamResult stream_program(Connection& connection, std::string_view program, const StreamOptions& options = {},
                            const Monitor& monitor = {});

}  // namespace lightmill

// Drip feed: a control mills a program while it comes over the line, and stops and starts the sender by XOFF and XON.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>

#include "design/core/monitor.h"
#include "machine/connection.h"
#include "machine/journal.h"
#include "machine/streamer.h"

namespace lightmill {

struct DripOptions {
  int leader_nulls = 0;          ///< before the first character, at most 50
  bool tape_marks = true;        ///< % before and behind, unless the program has them
  std::string line_end = "\r\n";
  std::string trailer;           ///< behind the last line: ETX EOT ("\x03\x04") for Heidenhain's standard protocol
  /// The control may hold for a tool change or a dwell; after so long without a byte taken the operator is asked.
  std::chrono::milliseconds stuck_after{60'000};
  std::size_t most_queued_bytes = 32;  ///< still goes out behind an XOFF that this sender obeys
  std::function<void(const std::string&)> on_traffic;
  std::function<void(long lines)> on_sent;  ///< told how many lines the system has taken
  Journal* journal = nullptr;               ///< told what is about to be sent, before it is; ends the feed if it cannot be written
  /// True: wait on; false, or nobody to ask: the feed ends.
  std::function<bool(const std::string& what)> on_operator;
};

/// XON and XOFF are obeyed here and, on ports opened for it, by the system too. This protocol acknowledges nothing: what
/// has been sent is known, what has been milled only the control knows. Throws InputError, before anything is sent, for
/// characters that seven bits do not hold.
StreamResult drip_feed(Connection& connection, std::string_view program, const DripOptions& options = {},
                       const Monitor& monitor = {});

}  // namespace lightmill

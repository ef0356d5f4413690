// A byte stream to a controller.
#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "machine/clock.h"

namespace lightmill {

/// Bytes both ways with deadlines. Not thread safe. Throws IoError when the other side hangs up.
class Connection {
 public:
  virtual ~Connection() = default;
  /// Writes what fits before the deadline; returns the count of bytes taken by the system.
  virtual std::size_t write_some(std::span<const char> bytes, std::chrono::milliseconds deadline) = 0;
  /// Reads what is there, waiting for at most `deadline` for the first byte; returns the count (0: nothing came).
  virtual std::size_t read_some(std::span<char> buffer, std::chrono::milliseconds deadline) = 0;
  /// Waits until there is something to read or, if asked, room to write; false on deadline.
  virtual bool wait(bool for_room, std::chrono::milliseconds deadline) = 0;
  /// Bytes taken by the system that are not on the wire yet, as far as it tells.
  [[nodiscard]] virtual std::size_t queued() const { return 0; }
  [[nodiscard]] virtual std::string name() const = 0;
  /// What its deadlines are measured by; a sender takes its own time-outs from it.
  [[nodiscard]] virtual const Clock& clock() const { return wall_clock(); }
};

struct SerialFormat {
  int data_bits = 8;  ///< 7 or 8
  char parity = 'N';  ///< N, E, O
  int stop_bits = 1;  ///< 1 or 2
  bool software_flow = false;  ///< the system obeys XON and XOFF; controllers with real-time bytes must not have it
  bool hardware_flow = false;  ///< RTS/CTS
};
/// "8N1", "7E1", "7E2"...; throws InputError.
SerialFormat serial_format(std::string_view text);

/// Opens a serial port through libserial. Throws IoError that names the port, the reason and the remedy.
std::unique_ptr<Connection> open_serial(const std::string& port, int baud, const SerialFormat& format = {});

/// A byte stream to a network serial server, "tcp://host:port"; the line's speed and format are set there.
std::unique_ptr<Connection> open_tcp(const std::string& address);

/// One or the other, by the name.
std::unique_ptr<Connection> open_connection(const std::string& port, int baud, const SerialFormat& format = {});

}  // namespace lightmill

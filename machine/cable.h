// One direction of a serial line: bytes arrive at the pace of the baud rate, and are disturbed on the way where planted.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "machine/clock.h"

namespace lightmill {

/// What can happen to the bytes of a line. `at` counts from 1: bytes of its direction, or acknowledgements for the
/// kinds that name them.
struct LineFault {
  enum class Kind : std::uint8_t {
    kDropByte,
    kFlipByte,    ///< bit `bit` of the byte is turned over
    kDoubleByte,
    kDropOk,      ///< "ok" and its line end get lost
    kDoubleOk,
    kLateOk,      ///< and all behind it, by `seconds`
    kDropXon,     ///< this XON (0x11) and all later ones get lost: the sender stays stopped
    kSlow,        ///< from this byte on bytes take `seconds` longer each
    kHangUp,      ///< the plug is out from this byte on, both ways
  };
  Kind kind = Kind::kDropByte;
  bool to_machine = true;  ///< direction; acknowledgements and XON come from the machine
  long at = 1;
  int bit = 0;
  double seconds = 0;
};

/// "flip@120", "drop-ok@3"...: drop, flip, double, drop-ok, double-ok, late-ok, drop-xon, slow, hang-up. Without a place
/// the seed chooses one among the first thousand. Throws InputError.
LineFault line_fault(std::string_view text, unsigned seed);

/// The place of a fault "name@place", or the one that the seed chooses if none is given; nothing if it is no number from 1.
std::optional<long> fault_place(std::string_view text, unsigned seed);

/// A line between a sender and a machine.
struct LineOptions {
  int baud = 0;  ///< 0: not paced
  bool even_parity = false;  ///< seven bits and a parity bit: a turned byte is noticed and arrives as a NUL
  std::vector<LineFault> faults;
};

class Cable {
 public:
  /// `baud` at ten bits a byte; 0: bytes arrive at once. Faults of the other direction are left out.
  Cable(const LineOptions& line, bool to_machine);

  /// The sender puts bytes on the line at `now`; they queue behind those under way.
  void put(std::string_view bytes, ClockTime now);
  /// What has arrived by `now` since the last call.
  std::string take(ClockTime now);
  /// When the next byte arrives; kNever if none is under way.
  [[nodiscard]] ClockTime next_arrival() const { return under_way_.empty() ? kNever : under_way_.front().arrival; }
  /// Bytes put on the line that have not arrived.
  [[nodiscard]] std::size_t waiting() const { return under_way_.size(); }
  [[nodiscard]] bool hung_up() const { return hung_up_; }
  [[nodiscard]] long bytes() const { return bytes_; }  ///< put so far
  [[nodiscard]] double busy_seconds() const { return busy_seconds_; }  ///< in which bytes moved

 private:
  struct Byte {
    char value;
    ClockTime arrival;
  };
  double byte_ns_;
  bool even_parity_;
  std::vector<LineFault> faults_;
  std::deque<Byte> under_way_;
  double free_ns_ = 0;  ///< when the line has sent all it was given
  double delay_ns_ = 0;
  long bytes_ = 0, oks_ = 0, xons_ = 0;
  bool line_start_ = true, hung_up_ = false;
  double busy_seconds_ = 0;
  void send(char byte, ClockTime now);
  [[nodiscard]] const LineFault* planted(LineFault::Kind kind, long at) const;
};

}  // namespace lightmill

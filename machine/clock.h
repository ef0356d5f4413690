// Time as a sender and a machine see it: the wall's, or one that only a simulation moves.
#pragma once

#include <chrono>

namespace lightmill {

/// Since some fixed moment; all time-outs of a link and its sender are taken from one clock.
using ClockTime = std::chrono::nanoseconds;

/// Later than any moment.
inline constexpr ClockTime kNever = ClockTime::max();

class Clock {
 public:
  virtual ~Clock() = default;
  [[nodiscard]] virtual ClockTime now() const = 0;
};

/// Steady; not set back when somebody sets the time of day.
const Clock& wall_clock();

/// Stands still until it is moved.
class VirtualClock final : public Clock {
 public:
  [[nodiscard]] ClockTime now() const override { return now_; }
  /// Earlier moments are ignored.
  void advance_to(ClockTime moment) {
    if (moment > now_) now_ = moment;
  }

 private:
  ClockTime now_{0};
};

}  // namespace lightmill

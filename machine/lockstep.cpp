#include "machine/lockstep.h"

#include <algorithm>
#include <cstring>

#include "design/core/errors.h"

namespace lightmill {

LockstepLink::LockstepLink(SimulatedMachine& machine, VirtualClock& clock, const LineOptions& line)
    : machine_(machine), clock_(clock), to_machine_(line, true), to_sender_(line, false) {}

void LockstepLink::check_plug() const {
  if (machine_.dead() || to_machine_.hung_up() || to_sender_.hung_up()) {
    throw IoError("the simulated line has hung up: the cable is out or the controller is off");
  }
}

void LockstepLink::work() {
  machine_.receive(to_machine_.take(clock_.now()));
  // Acknowledgements leave as their lines are taken.
  while (machine_.work(1) > 0) to_sender_.put(machine_.take_replies(), clock_.now());
  to_sender_.put(machine_.take_replies(), clock_.now());
  arrived_ += to_sender_.take(clock_.now());
}

void LockstepLink::step(ClockTime end) {
  clock_.advance_to(std::min({end, to_machine_.next_arrival(), to_sender_.next_arrival(), machine_.next_event()}));
  work();
}

std::size_t LockstepLink::write_some(std::span<const char> bytes, std::chrono::milliseconds) {
  check_plug();
  to_machine_.put({bytes.data(), bytes.size()}, clock_.now());
  return bytes.size();
}

std::size_t LockstepLink::read_some(std::span<char> buffer, std::chrono::milliseconds deadline) {
  if (!wait(false, deadline)) return 0;
  const std::size_t count = std::min(buffer.size(), arrived_.size());
  std::memcpy(buffer.data(), arrived_.data(), count);
  arrived_.erase(0, count);
  return count;
}

bool LockstepLink::wait(bool for_room, std::chrono::milliseconds deadline) {
  const ClockTime end = clock_.now() + deadline;
  work();
  while (arrived_.empty() && !for_room) {
    check_plug();
    if (clock_.now() >= end) return false;
    step(end);
  }
  return true;
}

void LockstepLink::run_for(std::chrono::milliseconds time) {
  const ClockTime end = clock_.now() + time;
  while (clock_.now() < end) step(end);
}

}  // namespace lightmill

// Fuzzes the simulated machine's side of the wire, every personality: bytes in any pieces, between them work and time.
#include <chrono>
#include <cmath>
#include <cstdlib>

#include "tests/machine/machine_rig.h"

namespace {

using namespace lightmill;

/// The first byte: who listens, whether motions take time, how long the pieces are.
struct Setting {
  Personality personality;
  bool paced;
  std::size_t piece;
  explicit Setting(std::uint8_t byte)
      : personality(std::array{Personality::kGrblHal, Personality::kGrbl, Personality::kBlockwise, Personality::kDripFeed}[byte & 3]),
        paced((byte & 4) != 0),
        piece(1 + (byte >> 3)) {}
  [[nodiscard]] bool acknowledges_lines() const {
    return personality == Personality::kGrblHal || personality == Personality::kGrbl;
  }
};

void require(bool holds) {
  if (!holds) std::abort();
}

void require_finite(const JointPosition& q) {
  for (const double v : {q.x_mm, q.y_mm, q.z_mm, q.outer_rad, q.inner_rad}) require(std::isfinite(v));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const Setting setting(data[0]);
  MachineModel machine = test::skew_machine();
  machine.receive_buffer_bytes = 256;
  // Drip feed begins and ends otherwise there.
  if (!setting.acknowledges_lines() && setting.paced) machine.controller = "heidenhain";
  VirtualClock clock;
  SimulationOptions options = test::no_stock();
  options.personality = setting.personality;
  options.time_factor = setting.paced ? 1 : 0;
  options.clock = &clock;
  SimulatedMachine simulated(machine, test::skew_setup(), options);
  simulated.on_motion = [](const Motion& motion, const std::vector<SweptMove>&) {
    require_finite(motion.to);
    require(motion.seconds >= 0);
  };
  simulated.start();
  std::size_t said = 0;
  for (std::size_t at = 1; at < size; at += setting.piece) {
    simulated.receive({reinterpret_cast<const char*>(data) + at, std::min(setting.piece, size - at)});
    simulated.work(3);
    said += simulated.take_replies().size();
    // From a millisecond, a byte's time, to two seconds, longer than any time-out of a block.
    clock.advance_to(clock.now() + std::chrono::milliseconds(1 << data[at] % 12));
  }
  simulated.work(100);
  said += simulated.take_replies().size();
  require_finite(simulated.result().joints);
  // At most some lines of answer for a byte: settings and reports are the longest.
  require(said <= 5000 * (size + 1));
  if (!setting.acknowledges_lines()) return 0;
  // An idle machine answers a line, whatever stands before its end; M0 waits for the operator.
  simulated.receive("?");
  if (simulated.take_replies().starts_with("<Idle|")) {
    simulated.receive("\n");
    simulated.work(1);
    simulated.receive("?");
    const std::string answer = simulated.take_replies();
    const auto says = [&](std::string_view text) { return answer.find(text) != std::string::npos; };
    require(says("ok\r\n") || says("error:") || says("ALARM:") || says("<Hold:0|"));
  }
  // Whatever happened, a reset brings it back.
  simulated.receive("\x18");
  simulated.take_replies();
  simulated.receive("\n");
  simulated.work(1);
  require(simulated.take_replies() == "ok\r\n");
  return 0;
}

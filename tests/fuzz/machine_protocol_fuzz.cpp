// libFuzzer on the simulated machine's side of the wire: bytes in any pieces, between them work. run.sh builds and runs
// it.
#include <cmath>
#include <cstdlib>

#include "tests/machine/machine_rig.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace lightmill;
  if (size < 2) return 0;
  static const MachineModel machine = test::skew_machine();
  SimulationOptions options = test::no_stock();
  options.personality = (data[0] & 1) != 0 ? Personality::kGrbl : Personality::kGrblHal;
  const std::size_t piece = 1 + (data[0] >> 1);
  SimulatedMachine simulated(machine, test::skew_setup(), options);
  simulated.on_motion = [](const Motion& motion, const std::vector<SweptMove>&) {
    for (const double q : {motion.to.x_mm, motion.to.y_mm, motion.to.z_mm, motion.to.outer_rad, motion.to.inner_rad}) {
      if (!std::isfinite(q)) std::abort();
    }
  };
  simulated.start();
  std::size_t said = 0;
  for (std::size_t at = 1; at < size && !simulated.dead(); at += piece) {
    simulated.receive({reinterpret_cast<const char*>(data) + at, std::min(piece, size - at)});
    simulated.work(3);
    said += simulated.take_replies().size();
  }
  simulated.work(100);
  said += simulated.take_replies().size();
  // At most some lines of answer for a byte: settings and reports are the longest.
  if (said > 5000 * (size + 1)) std::abort();
  return 0;
}

// libFuzzer on the program reader, every dialect; the first byte, '0' to '4', names it. run.sh builds and runs it.
#include <cmath>
#include <cstdlib>

#include "machine/program_reader.h"
#include "tests/machine/machine_rig.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace lightmill;
  if (size == 0) return 0;
  static const MachineModel machine = test::skew_machine();
  ReaderSetup setup;
  setup.offsets[0] = {10, -5, -400, 0, 0};
  setup.tool_length_mm = {{1, 80}};
  setup.tool_diameter_mm = {{1, 4}};
  setup.most_blocks = 300;
  const auto dialect = static_cast<ReaderDialect>(data[0] % 16 % 5);
  read_program({reinterpret_cast<const char*>(data) + 1, size - 1}, dialect, machine, setup,
               [](const ProgramStep& step) {
                 for (const double q : step.target) {
                   if (!std::isfinite(q) || !(step.seconds >= 0)) std::abort();
                 }
               });
  return 0;
}

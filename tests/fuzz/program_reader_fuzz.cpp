// libFuzzer on the program reader, every dialect; the first byte names it. From the project's folder:
//   clang++ -std=c++20 -O1 -g -fsanitize=fuzzer,address,undefined -I. -I/usr/include/eigen3
//   tests/fuzz/program_reader_fuzz.cpp
//     machine/detail/{reader_core,word_reader,heidenhain_reader}.cpp machine/kinematics.cpp -o /tmp/program_reader_fuzz
//   /tmp/program_reader_fuzz -max_total_time=600 -rss_limit_mb=1000 -timeout=5
#include <cmath>
#include <cstdlib>

#include "machine/program_reader.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace lightmill;
  if (size == 0) return 0;
  MachineModel machine;
  machine.outer.letter = 'B';
  machine.outer.axis = Vec3::UnitY();
  machine.outer.point_mm = {-3, 2, -380};
  machine.inner.point_mm = {4, -7, -370};
  machine.max_spindle_rpm = 36000;
  ReaderSetup setup;
  setup.offsets[0] = {10, -5, -400, 0, 0};
  setup.tool_length_mm = {{1, 80}};
  setup.most_blocks = 300;
  const auto dialect = static_cast<ReaderDialect>(data[0] % 5);
  read_program({reinterpret_cast<const char*>(data) + 1, size - 1}, dialect, machine, setup,
               [](const ProgramStep& step) {
                 for (const double q : step.target) {
                   if (!std::isfinite(q) || !(step.seconds >= 0)) std::abort();
                 }
               });
  return 0;
}

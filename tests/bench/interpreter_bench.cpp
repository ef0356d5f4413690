// Blocks a second of the program reader alone: interpreter_bench [blocks] | interpreter_bench PROGRAM (prints its programmed points)
#include <sys/resource.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/program_reader.h"

using namespace lightmill;

int main(int argc, char** argv) {
  const MachineModel machine = read_machine(LIGHTMILL_FIXTURES "/machines/hsm400u_grblhal.toml");
  ReaderSetup setup;
  for (int tool = 1; tool < 100; ++tool) setup.tool_length_mm[tool] = 0;
  const long blocks = argc > 1 ? std::atol(argv[1]) : 1000000;
  if (argc > 1 && blocks == 0) {
    setup.most_blocks = 10'000'000;
    const ReadResult result = read_program(read_whole(argv[1]), ReaderDialect::kLinuxCnc, machine, setup, [](const ProgramStep& step) {
      if (step.kind == ProgramStep::kMove && step.whole) {
        std::printf("%d %.4f %.4f %.4f\n", step.rapid, step.programmed[0], step.programmed[1], step.programmed[2]);
      }
    });
    if (result.error) std::fprintf(stderr, "line %ld column %d: %s\n", result.error->line, result.error->column, result.error->rule.c_str());
    return result.error ? 1 : 0;
  }
  for (const bool five_axes : {false, true}) {
    std::string text = five_axes ? "G21 G90 G93 G17\n" : "G21 G90 G94 G17\nF1000\n";
    for (long i = 0; i < blocks; ++i) {
      const double t = static_cast<double>(i) * 1e-3;
      text += "N" + std::to_string(i % 99999) + " G1 X" + fixed(40 * std::sin(t), 5) + "Y" + fixed(-20 + 40 * std::cos(1.1 * t), 5) + "Z" +
              fixed(55 + std::sin(7 * t), 5);
      if (five_axes) text += "B" + fixed(10 * std::sin(t), 5) + "C" + fixed(20 * t, 5) + "F600";
      text += "\n";
    }
    text += "M2\n";
    rusage before{}, after{};
    getrusage(RUSAGE_SELF, &before);
    long steps = 0;
    const ReadResult result = read_program(text, ReaderDialect::kLinuxCnc, machine, setup, [&](const ProgramStep&) { ++steps; });
    getrusage(RUSAGE_SELF, &after);
    const double seconds = static_cast<double>(after.ru_utime.tv_sec - before.ru_utime.tv_sec) + 1e-6 * static_cast<double>(after.ru_utime.tv_usec - before.ru_utime.tv_usec);
    std::printf("%s: %.0f blocks/s of CPU, %ld steps%s\n", five_axes ? "five axes, G93" : "three axes", static_cast<double>(result.blocks) / seconds, steps,
                result.error ? (", stopped: " + result.error->rule).c_str() : "");
  }
  return 0;
}

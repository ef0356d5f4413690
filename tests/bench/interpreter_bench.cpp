// Blocks a second of the program reader alone, beside LinuxCNC's rs274 on the same program where it is installed:
// interpreter_bench [blocks] | interpreter_bench PROGRAM (prints its programmed points)
#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/program_reader.h"

using namespace lightmill;

namespace {

double user_seconds(int who) {
  rusage used{};
  getrusage(who, &used);
  return static_cast<double>(used.ru_utime.tv_sec) + 1e-6 * static_cast<double>(used.ru_utime.tv_usec);
}

/// CPU seconds of rs274 with its listing thrown away; below 0: not installed, or it refused the program.
double rs274_seconds(const std::string& program) {
  const auto folder = std::filesystem::temp_directory_path() / ("interpreter_bench_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  std::ofstream(folder / "mm.ini") << "[TRAJ]\nLINEAR_UNITS = mm\n[RS274NGC]\nPARAMETER_FILE = prog.var\n";
  std::ofstream(folder / "program.ngc") << program;
  // A HOME of its own: rs274 empties the user's tool table.
  const std::string command = "cd '" + folder.string() + "' && HOME=. rs274 -g -i mm.ini program.ngc out.txt > log.txt 2>&1";
  const double before = user_seconds(RUSAGE_CHILDREN);
  const int status = std::system(command.c_str());
  const double seconds = user_seconds(RUSAGE_CHILDREN) - before;
  std::filesystem::remove_all(folder);
  return status == 0 ? seconds : -1;
}

}  // namespace

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
    const double before = user_seconds(RUSAGE_SELF);
    long steps = 0;
    const ReadResult result = read_program(text, ReaderDialect::kLinuxCnc, machine, setup, [&](const ProgramStep&) { ++steps; });
    const double seconds = user_seconds(RUSAGE_SELF) - before, theirs = rs274_seconds(text);
    std::printf("%s: %.0f blocks/s of CPU, %ld steps%s", five_axes ? "five axes, G93" : "three axes", static_cast<double>(result.blocks) / seconds, steps,
                result.error ? (", stopped: " + result.error->rule).c_str() : "");
    if (theirs > 0) std::printf("; rs274 %.0f, %.0f times longer", static_cast<double>(result.blocks) / theirs, theirs / seconds);
    std::printf("\n");
  }
  return 0;
}

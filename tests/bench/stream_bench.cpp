// Lines a second through pseudo-terminal, libserial, streamer and simulated machine: stream_bench [lines] [--stock]
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "design/core/text.h"
#include "machine/connection.h"
#include "machine/detail/interpreter.h"
#include "machine/program_lines.h"
#include "machine/pseudo_terminal.h"
#include "machine/simulated_machine.h"
#include "machine/streamer.h"

using namespace lightmill;

namespace {

MachineModel machine_model() {
  return read_machine(LIGHTMILL_FIXTURES "/machines/hsm400u_grblhal.toml");
}

/// Finishing at a fixed tilt: mostly "X.. Y.. Z..", five decimals; or five axes with G93.
std::string program(long lines, bool five_axes) {
  std::string text = "G21 G90 G94 G17\nT3 M6\nG43.1 Z85\nS36000 M3\nG4 P8\nG53 G0 Z0\nG0 X0 Y0\nG0 Z60\n";
  text += five_axes ? "G93\n" : "G1 F1080\n";
  for (long i = 0; i < lines; ++i) {
    const double t = static_cast<double>(i) * 1e-3;
    text += "X" + fixed(40 * std::sin(t), 5) + "Y" + fixed(-20 + 40 * std::cos(1.1 * t), 5) + "Z" +
            fixed(55 + std::sin(7 * t), 5);
    if (five_axes) text += "B" + fixed(10 * std::sin(t), 5) + "C" + fixed(20 * t, 5) + "F600";
    text += "\n";
  }
  return text + "M5\nM2\n";
}

double user_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

}  // namespace

int main(int argc, char** argv) {
  const long lines = argc > 1 ? std::atol(argv[1]) : 300000;
  const bool with_stock = argc > 2 && std::strcmp(argv[2], "--stock") == 0;
  const MachineModel model = machine_model();
  OperatorSetup setup;
  Cutter cutter;
  cutter.number = 3;
  cutter.diameter_mm = 4;
  cutter.corner_radius_mm = 2;
  cutter.flute_length_mm = 6;
  cutter.shank_diameter_mm = 4;
  cutter.length_mm = 85;
  setup.cutters = {cutter};
  setup.blank.size_mm = {100, 100};
  setup.blank.height_mm = 20;
  setup.workpiece_origin_mm = {0, 0, -420};
  for (const bool five_axes : {false, true}) {
    const std::string text = program(lines, five_axes);
    SimulationOptions options;
    options.remove_stock = with_stock;
    options.stock.pitch_mm = 0.1;
    std::printf("%s, %ld lines, %.1f MB\n", five_axes ? "five axes, G93" : "three axes", lines,
                1e-6 * static_cast<double>(text.size()));

    {
      detail::Interpreter interpreter(model);
      const auto listing = program_lines(text);
      const double start = user_seconds();
      long steps = 0;
      for (const ProgramLine& line : listing) {
        interpreter.execute(line.text);
        steps += static_cast<long>(interpreter.steps().size());
      }
      std::printf("  interpreter alone     %9.0f lines/s of CPU (%ld steps)\n",
                  static_cast<double>(listing.size()) / (user_seconds() - start), steps);
    }
    {
      SimulatedMachine machine(model, setup, options);
      long pieces = 0;
      machine.on_motion = [&](const Motion&, const std::vector<SweptMove>& sweep) {
        pieces += static_cast<long>(sweep.size());
      };
      machine.start();
      const double start = user_seconds();
      for (const ProgramLine& line : program_lines(text)) {
        machine.receive(line.text);
        machine.receive("\n");
        machine.work(1);
        if (line.text == "T3 M6") machine.receive("~");
      }
      const double seconds = user_seconds() - start;
      std::printf("  machine alone         %9.0f lines/s of CPU (%ld pieces, %zu faults)\n",
                  static_cast<double>(lines) / seconds, pieces, machine.result().faults.size());
    }
    // Two processes, as in the dry run.
    int verdict[2];
    if (pipe(verdict) != 0) return 1;
    PseudoTerminal terminal{std::filesystem::path()};
    const pid_t child = fork();
    if (child == 0) {
      SimulatedMachine machine(model, setup, options);
      machine.start();
      long loops = 0;
      serve(machine, terminal, {}, [&] { return ++loops % 1024 == 0 && getppid() == 1; });
      _exit(0);
    }
    auto connection = open_serial(terminal.far_end(), 115200);
    StreamOptions stream;
    stream.most_queued_bytes = 1 << 16;
    stream.on_operator = [](const std::string&) { return true; };
    const double user = user_seconds();
    const StreamResult result = stream_program(*connection, text, stream);
    std::printf("  streamed              %9.0f lines/s, %.2f s wall, %.2f s CPU of the streamer; highest fill %d; %s\n",
                static_cast<double>(result.lines_total) / result.seconds, result.seconds, user_seconds() - user,
                result.highest_buffer_fill, result.message.c_str());
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    rusage usage{};
    getrusage(RUSAGE_CHILDREN, &usage);
    std::printf("  CPU of the machines so far %.2f s user, %.2f s system\n",
                static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec),
                static_cast<double>(usage.ru_stime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_stime.tv_usec));
  }
  return 0;
}

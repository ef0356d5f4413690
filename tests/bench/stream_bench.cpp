// Lines a second through pseudo-terminal, libserial, streamer and simulated machine: stream_bench [lines] [--stock]
// How long a feed hold takes to the wire: stream_bench hold MOMENTS
// Hours of streaming on the virtual clock, memory and starvation: stream_bench hours N [PROGRAM]
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>
#include <random>
#include <vector>

#include "design/core/files.h"
#include "design/core/text.h"
#include "machine/connection.h"
#include "machine/detail/interpreter.h"
#include "machine/journal.h"
#include "machine/lockstep.h"
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

/// User and system, of all threads.
double process_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return user_seconds() + static_cast<double>(usage.ru_stime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_stime.tv_usec);
}

struct Way {
  const char* name;
  bool one_at_a_time, journal;
};

/// A machine that moves and cuts nothing, in the clock's time.
SimulationOptions without_stock(const Clock& clock) {
  SimulationOptions options;
  options.remove_stock = false;
  options.time_factor = 1;
  options.clock = &clock;
  return options;
}

/// From the press of the hold key to its byte on the wire, at random moments of a stream at 115,200 baud: the sender's
/// loop, and the bytes that the system holds before it.
int hold_latency(int count) {
  constexpr double kByte_s = 10.0 / 115200;
  std::string text = "G21 G90 G94\nS20000 M3\nG4 P1\nG0 Z70\nG0 X0 Y0\nG1 F3000\n";
  for (long i = 1; i <= 1500; ++i) {
    text += "X" + fixed(0.1 * static_cast<double>(i % 400), 4) + "Y" + fixed(1e-4 * static_cast<double>(i), 4) + "Z70\n";
  }
  text += "M5\nM2\n";
  std::mt19937 random(3);
  std::vector<double> latency_s;
  for (int i = 0; i < count; ++i) {
    VirtualClock clock;
    const SimulationOptions options = without_stock(clock);
    OperatorSetup setup;
    setup.workpiece_origin_mm = {0, 0, -420};
    SimulatedMachine machine(machine_model(), setup, options);
    machine.start();
    LockstepLink link(machine, clock, {.baud = 115200, .faults = {}});
    const ClockTime press = std::chrono::microseconds(700'000 + static_cast<long>(random() % 2'000'000));
    StreamOptions stream;
    bool pressed = false;
    stream.commands = [&]() -> std::string {
      if (pressed || clock.now() < press) return "";
      pressed = true;
      latency_s.push_back(std::chrono::duration<double>(clock.now() - press).count() +
                          static_cast<double>(link.queued() + 1) * kByte_s);
      return "!";
    };
    Monitor monitor;
    monitor.should_stop = [&] { return pressed; };
    stream_program(link, text, stream, monitor);
  }
  if (latency_s.size() < static_cast<std::size_t>(count)) {
    std::printf("a stream ended before the key was pressed\n");
    return 1;
  }
  std::sort(latency_s.begin(), latency_s.end());
  const auto ms = [&](double share) { return 1000 * latency_s[static_cast<std::size_t>(share * static_cast<double>(latency_s.size() - 1))]; };
  std::printf("feed hold, key to wire at 115,200 baud, %zu moments: median %.1f ms, 99 %% %.1f ms, longest %.1f ms\n",
              latency_s.size(), ms(0.5), ms(0.99), ms(1));
  return ms(0.99) < 20 ? 0 : 1;
}

/// An hour of finishing at 1200 mm/min in steps of 0.1 mm: 200 lines a second.
std::string hour_of_finishing() {
  std::string text = "G21 G90 G94\nG43.1 Z85\nS36000 M3\nG4 P8\nG0 X0 Y0\nG0 Z60\nG1 F1200\n";
  for (long i = 0; i < 720'000; ++i) {
    text += "X" + fixed(0.1 * static_cast<double>(i % 400), 5) + "Y" + fixed(1e-5 * static_cast<double>(i % 100000), 5) + "\n";
    if (i % 400 == 399) text += "G0 X0\nG1\n";
  }
  return text + "M5\nM2\n";
}

long resident_kb() {
  long pages = 0, resident = 0;
  if (FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &pages, &resident) != 2) resident = 0;
    std::fclose(file);
  }
  return resident * sysconf(_SC_PAGESIZE) / 1024;
}

/// Sender and machine in lockstep at 115,200 baud: the program again and again until the hours are over.
int hours(double count, const std::string& text) {
  constexpr int kTools = 20;
  VirtualClock clock;
  const SimulationOptions options = without_stock(clock);
  OperatorSetup setup;
  setup.workpiece_origin_mm = {0, 0, -420};
  for (int number = 1; number <= kTools; ++number) {
    Cutter cutter;
    cutter.number = number;
    setup.cutters.push_back(cutter);
  }
  SimulatedMachine machine(machine_model(), setup, options);
  machine.start();
  LockstepLink link(machine, clock, {.baud = 115200, .faults = {}});
  const auto hour = [&] { return std::chrono::duration<double>(clock.now()).count() / 3600; };
  StreamOptions stream;
  stream.on_operator = [](const std::string&) { return true; };
  Monitor monitor;
  double next = 0;
  monitor.on_progress = [&](std::string_view, double share) {
    if (share < next) return;
    next += 0.25;
    std::printf("  %3.0f %%  %6.2f h  %ld kB resident\n", 100 * share, hour(), resident_kb());
  };
  const double user = user_seconds();
  LineDigest digest;
  long lines = 0, starved_reports = 0;
  do {
    next = 0;
    const StreamResult result = stream_program(link, text, stream, monitor);
    lines += result.lines_total;
    starved_reports += result.starved_reports;
    for (const ProgramLine& line : program_lines(text)) digest.add(line.text);
    if (!result.done()) {
      std::printf("  %s\n", result.message.c_str());
      return 1;
    }
  } while (hour() < count);
  const SimulationResult milled = machine.result();
  const bool same = milled.received_digest == digest.hex();
  std::printf("  %ld lines in %.2f h, %.1f s of CPU; starvations %ld (%.3f s), starved reports %ld, overflowed bytes %ld, lines as sent: %s\n",
              lines, hour(), user_seconds() - user, milled.starvations, milled.starved_seconds, starved_reports,
              milled.overflowed_bytes, same ? "yes" : "no");
  return same ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 2 && std::strcmp(argv[1], "hours") == 0) return hours(std::atof(argv[2]), argc > 3 ? read_whole(argv[3]) : hour_of_finishing());
  if (argc > 2 && std::strcmp(argv[1], "hold") == 0) return hold_latency(std::atoi(argv[2]));
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
    const std::filesystem::path folder = std::filesystem::temp_directory_path() / ("stream_bench_" + std::to_string(getpid()));
    for (const Way& way : {Way{"streamed", false, false}, Way{"one line at a time", true, false}, Way{"with journal", false, true}}) {
      StreamOptions stream;
      stream.most_queued_bytes = 1 << 16;
      stream.on_operator = [](const std::string&) { return true; };
      stream.one_at_a_time = way.one_at_a_time;
      std::unique_ptr<Journal> journal;
      if (way.journal) {
        journal = std::make_unique<Journal>(folder / (five_axes ? "five" : "three"), JournalHeader{});
        stream.journal = journal.get();
      }
      const double user = process_seconds();
      const StreamResult result = stream_program(*connection, text, stream);
      const double cpu = process_seconds() - user;
      std::printf("  %-20s %9.0f lines/s, %.2f s wall, %.2f s CPU of the sender (%.0f %%, %.1f us a line); highest fill %d; %s\n", way.name,
                  static_cast<double>(result.lines_total) / result.seconds, result.seconds, cpu, 100 * cpu / result.seconds,
                  1e6 * cpu / static_cast<double>(result.lines_total), result.highest_buffer_fill, result.message.c_str());
    }
    std::filesystem::remove_all(folder);
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

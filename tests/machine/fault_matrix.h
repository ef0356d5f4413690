// Every fault at many places of a stream, in lockstep: what the sender says, and whether it is true.
#pragma once

#include <limits>
#include <random>
#include <string>
#include <vector>

#include "design/core/text.h"
#include "machine/program_lines.h"
#include "machine/streamer.h"
#include "machine_rig.h"

namespace lightmill::test {

struct MatrixRow {
  std::string fault;
  int places = 0;
  int went_on = 0;  ///< every line executed once, in order
  int doubtful = 0; ///< went on, and says between which lines an ok, or a whole line, got lost
  int stopped = 0;  ///< and said so
  int silent = 0;   ///< ended as if nothing had been, but other lines than the program's were executed
  std::vector<std::string> broken;  ///< promises
};

/// A zigzag of feed moves that grbl takes too; two stops in it.
inline std::string matrix_program() {
  std::string text = "G21 G90 G94\nS20000 M3\nG4 P1\nG0 Z60\nG0 X-2 Y-5\nG1 Z50 F3000\n";
  for (int i = 0; i < 120; ++i) {
    text += "X" + fixed(i % 2 == 0 ? 2.8125 : -2.0375, 4) + "Y" + fixed(-5 + 0.05 * i, 3) + "\n";
    if (i == 60) text += "G4 P0.2\n";
  }
  return text + "G0 Z60\nM5\nM2\n";
}

struct MatrixFault {
  std::string name;
  LineFault line;                                  ///< its `at` is the place
  long PlantedFaults::* planted = nullptr;         ///< or a fault of the control
  bool may_be_silent = false;                      ///< a garbled digit is a digit
  enum { kNothing, kClockJumps, kDiskFull } sender = kNothing;  ///< or of the sender's computer
};

inline std::vector<MatrixFault> matrix_faults() {
  using Kind = LineFault::Kind;
  return {
      {"byte lost on the way to the machine", {.kind = Kind::kDropByte}, nullptr, true},
      {"byte turned on the way to the machine", {.kind = Kind::kFlipByte}, nullptr, true},
      {"byte doubled on the way to the machine", {.kind = Kind::kDoubleByte}, nullptr, true},
      {"byte lost in a reply", {.kind = Kind::kDropByte, .to_machine = false}},
      {"byte turned in a reply", {.kind = Kind::kFlipByte, .to_machine = false}},
      {"byte doubled in a reply", {.kind = Kind::kDoubleByte, .to_machine = false}},
      {"ok lost", {.kind = Kind::kDropOk, .to_machine = false}},
      {"ok doubled", {.kind = Kind::kDoubleOk, .to_machine = false}},
      {"ok 3 s late", {.kind = Kind::kLateOk, .to_machine = false, .seconds = 3}},
      {"line a hundred times slower", {.kind = Kind::kSlow, .seconds = 0.0087}},
      {"cable out", {.kind = Kind::kHangUp}},
      {"whole line lost", {}, &PlantedFaults::drop_line_at},
      {"error on a line", {}, &PlantedFaults::error_at_line},
      {"limit switch", {}, &PlantedFaults::alarm_at_line},
      {"door opened", {}, &PlantedFaults::door_at_line},
      {"controller restarts", {}, &PlantedFaults::reset_at_line},
      {"power loss of the controller", {}, &PlantedFaults::power_loss_at_line},
      {.name = "sender's clock jumps by an hour, on or back", .line = {}, .sender = MatrixFault::kClockJumps},
      {.name = "disk full for the journal", .line = {}, .sender = MatrixFault::kDiskFull},
  };
}

inline MatrixRow matrix_row(const MatrixFault& fault, Personality personality, int places, unsigned seed) {
  const std::string program = matrix_program();
  const std::vector<ProgramLine> lines = program_lines(program);
  std::mt19937 random(seed);
  MatrixRow row;
  row.fault = fault.name;
  row.places = places;
  for (int i = 0; i < places; ++i) {
    SimulationOptions simulation = no_stock();
    simulation.personality = personality;
    simulation.time_factor = 1;
    LineOptions wire{.baud = 115200, .faults = {}};
    std::string at;
    const long byte = 12 + static_cast<long>(random() % (program.size() - 12));
    if (fault.sender != MatrixFault::kNothing) {
      at = "byte " + std::to_string(byte);
    } else if (fault.planted != nullptr) {
      const long line = 1 + static_cast<long>(random() % lines.size());
      simulation.planted.*fault.planted = line;
      at = "line " + std::to_string(line);
    } else {
      LineFault planted = fault.line;
      const bool of_oks = planted.kind == LineFault::Kind::kDropOk || planted.kind == LineFault::Kind::kDoubleOk ||
                          planted.kind == LineFault::Kind::kLateOk;
      // Behind the greeting: its own checks are strict.
      planted.at = of_oks              ? 3 + static_cast<long>(random() % (lines.size() - 1))
                   : planted.to_machine ? byte
                                        : 700 + static_cast<long>(random() % (4 * lines.size()));
      planted.bit = static_cast<int>(random() % 8);
      at = "place " + std::to_string(planted.at) + " bit " + std::to_string(planted.bit);
      wire.faults.push_back(planted);
    }
    Lockstep rig(simulation, wire);
    if (personality == Personality::kGrbl) {
      rig.machine.receive("$10=3\n");  // reports its buffers
      rig.machine.work(1);
      rig.machine.take_replies();
    }
    StreamOptions options;
    int asked = 0;
    options.on_operator = [&](const std::string&) { return ++asked < 3; };
    JumpingLink jumping(rig.link, fault.sender == MatrixFault::kClockJumps ? byte : std::numeric_limits<long>::max(),
                        std::chrono::hours(i % 2 == 0 ? 1 : -1));
    Monitor monitor;
    if (fault.sender == MatrixFault::kDiskFull) {
      const double share = static_cast<double>(byte) / static_cast<double>(program.size());
      monitor.on_progress = [share](std::string_view, double fraction) {
        if (fraction >= share) throw JournalError("no space left on device");
      };
    }
    const StreamResult result = stream_program(jumping, program, options, monitor);
    const auto broken = [&](const std::string& promise) {
      row.broken.push_back(fault.name + " at " + at + ": " + promise + " (" + result.message + ")");
    };
    // The hold is behind the bytes that the system had.
    if (result.end == StreamEnd::kJournal) rig.link.run_for(std::chrono::milliseconds(20));
    const SimulationResult then = rig.machine.result();
    const bool whole = then.received_digest == program_digest(program);
    if (result.done() && result.recovered_acknowledgements > 0) {
      ++row.doubtful;
      if (result.message.find("or a whole line (between lines") == std::string::npos) broken("it does not say where");
      continue;
    }
    if (result.done()) {
      ++(whole ? row.went_on : row.silent);
      if (!whole && !fault.may_be_silent) broken("lines were lost or repeated and nothing is said");
      continue;
    }
    ++row.stopped;
    if (result.message.empty()) broken("it does not say why it stopped");
    // What it claims is true.
    if (!fault.may_be_silent) {
      std::string prefix;
      for (long l = 0; l < then.lines && l < static_cast<long>(lines.size()); ++l)
        prefix += std::string(lines[static_cast<std::size_t>(l)].text) + "\n";
      const bool goes_on = personality == Personality::kGrbl && result.end == StreamEnd::kControllerError;
      const bool lost_one = fault.planted == &PlantedFaults::drop_line_at;
      if (!goes_on && !lost_one && then.received_digest != program_digest(prefix)) broken("not the program's first lines in order");
    }
    if (result.lines_executed > then.lines && !fault.may_be_silent && fault.planted != &PlantedFaults::drop_line_at) {
      broken("it is sure of " + std::to_string(result.lines_executed) + " lines, but only " +
             std::to_string(then.lines) + " were executed");
    }
    if (then.lines > result.lines_sent) broken("more lines executed than sent");
    // The machine is held or has stopped; with the line gone nobody can, and that is said.
    rig.link.run_for(std::chrono::minutes(1));
    const SimulationResult later = rig.machine.result();
    if (result.end == StreamEnd::kHungUp) {
      if (result.message.find("goes on with what it has buffered") == std::string::npos) broken("it does not say that the machine goes on");
    } else if (later.machine_seconds != then.machine_seconds || later.lines != then.lines) {
      broken("the machine goes on after the end");
    }
  }
  return row;
}

constexpr const char* kFaultTable = "<!-- fault matrix: written by tests/bench/fault_bench.cpp -->\n";
constexpr const char* kFaultTableEnd = "<!-- end of fault matrix -->\n";

/// grblHAL's figures and grbl's beside each other where they differ.
inline std::string markdown(const std::vector<MatrixRow>& hal, const std::vector<MatrixRow>& grbl) {
  std::string text = kFaultTable;
  text += "| fault | random places, each control | went on, whole | went on, doubt said | stopped, said so | silent |\n|---|---|---|---|---|---|\n";
  const auto both = [](int a, int b) { return std::to_string(a) + (a == b ? "" : " / " + std::to_string(b)) + " | "; };
  for (std::size_t i = 0; i < hal.size(); ++i) {
    const MatrixRow &a = hal[i], &b = grbl[i];
    text += "| " + a.fault + " | " + both(a.places, b.places) + both(a.went_on, b.went_on) + both(a.doubtful, b.doubtful) +
            both(a.stopped, b.stopped) + both(a.silent, b.silent);
    text.back() = '\n';
  }
  return text + kFaultTableEnd;
}

}  // namespace lightmill::test

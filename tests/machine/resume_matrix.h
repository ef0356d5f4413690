// Streams that end early in every way, at many places, and what a resume leaves: in lockstep on a virtual clock.
#pragma once

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "design/core/text.h"
#include "machine/journal.h"
#include "machine/program_lines.h"
#include "machine/restart.h"
#include "machine/streamer.h"
#include "postproc/program.h"
#include "tests/machine/machine_rig.h"
#include "tests/postproc/support.h"

namespace lightmill::test {

struct Shop {
  MachineModel machine = hostile_machine();
  OperatorSetup setup;
};

/// The flutes reach out of the cut, as where a rougher has been before: backing out along the axis cuts nothing.
inline ToolPath with_long_flutes(ToolPath path) {
  path.cutter.flute_length_mm = 20;
  return path;
}

inline Shop shop_on(const MachineModel& machine, const WorkSetup& work) {
  Shop shop;
  shop.machine = machine;
  shop.setup.cutters = {with_long_flutes(empty_path(0)).cutter};
  shop.setup.blank.size_mm = {36, 36};
  shop.setup.blank.height_mm = 15;
  shop.setup.workpiece_origin_mm = work.origin_mm;
  shop.setup.work_offset = work.work_offset;
  return shop;
}

struct Written {
  Shop shop;
  std::string text;
};

inline Written written(const ToolPath& given, MachineModel machine = hostile_machine(), double arcs_mm = 0) {
  machine.controller = "grblhal";
  machine.has_tcp = false;
  const ToolPath path = with_long_flutes(given);
  const WorkSetup work = work_on_table(machine, {23, -17, 30}, 55);
  ProgramOptions options;
  options.arc_tolerance_mm = arcs_mm;
  return {shop_on(machine, work), write_program(machine, work, plan_motion(machine, work, path), options).text};
}

/// The greatest difference of heights and peaks.
inline double worst_um(const MachinedSurface& a, const MachinedSurface& b) {
  double worst = 0;
  for (std::size_t i = 0; i < a.heights_mm.values.size(); ++i) {
    worst = std::max(worst, 1000.0 * std::abs(a.heights_mm.values[i] - b.heights_mm.values[i]));
    worst = std::max(worst, 1000.0 * std::abs(a.peaks_mm.values[i] - b.peaks_mm.values[i]));
  }
  return worst;
}

/// A program, and the surface that it leaves when nothing happens.
struct ResumeCase {
  Written written;
  StockOptions stock;
  MachinedSurface undisturbed;
};

inline MachinedSurface undisturbed_surface(const Written& w, const StockOptions& stock) {
  SimulationOptions options;
  options.stock = stock;
  SimulatedMachine machine(w.shop.machine, w.shop.setup, options);
  for (const ProgramLine& line : program_lines(w.text)) {
    machine.receive(std::string(line.text) + "\n");
    machine.work(1);
    machine.receive("~");
  }
  return machine.machined();
}

/// Two rows of five-axis finishing.
inline ResumeCase resume_case() {
  ResumeCase result;
  result.written = written(lead_rows(20 * kDeg, 2, 8));
  result.stock.pitch_mm = 0.4;
  result.undisturbed = undisturbed_surface(result.written, result.stock);
  return result;
}

struct ResumeFault {
  std::string name;
  LineFault line = {};  ///< its `at` is the place
  long PlantedFaults::*planted = nullptr;
  enum Sender { kLives, kKilled, kLosesPower, kDiskFull, kClockJumps } sender = kLives;
  /// Lines behind a lost one were carried out from where it should not have been: the chord is part of the mark.
  double most_um = 0.05;
};

inline std::vector<ResumeFault> resume_faults() {
  using Kind = LineFault::Kind;
  return {
      {"byte lost in a reply", {.kind = Kind::kDropByte, .to_machine = false}},
      {"byte turned in a reply", {.kind = Kind::kFlipByte, .to_machine = false}},
      {"ok lost", {.kind = Kind::kDropOk, .to_machine = false}},
      {"ok doubled", {.kind = Kind::kDoubleOk, .to_machine = false}},
      {"ok 3 s late", {.kind = Kind::kLateOk, .to_machine = false, .seconds = 3}},
      {"cable out and in again", {.kind = Kind::kHangUp}},
      {.name = "whole line lost", .planted = &PlantedFaults::drop_line_at, .most_um = 10},
      {.name = "error on a line", .planted = &PlantedFaults::error_at_line},
      {.name = "limit switch", .planted = &PlantedFaults::alarm_at_line},
      {.name = "door opened", .planted = &PlantedFaults::door_at_line},
      {.name = "controller restarts", .planted = &PlantedFaults::reset_at_line},
      {.name = "power loss of the controller, and back", .planted = &PlantedFaults::power_loss_at_line},
      {.name = "sender killed", .sender = ResumeFault::kKilled},
      {.name = "sender's power cut, journal torn", .sender = ResumeFault::kLosesPower},
      {.name = "disk full for the journal", .sender = ResumeFault::kDiskFull},
      {.name = "sender's clock jumps by an hour, on or back", .sender = ResumeFault::kClockJumps},
  };
}

struct ResumeRow {
  std::string fault;
  int places = 0;
  int went_on = 0;  ///< the stream ended well in spite of it
  int resumed = 0;
  double worst_um = 0;     ///< of surfaces after a resume from the undisturbed one
  long most_repeated = 0;  ///< lines that were carried out and are milled again
  std::vector<std::string> broken;
};

/// The operator holds the machine, resets the control and unlocks it.
inline void unlock(LockstepLink& link) {
  std::array<char, 4096> buffer;
  for (const char* bytes : {"!", "\x18", "$X\n", "\n"}) {
    link.write_some(std::string_view(bytes), std::chrono::milliseconds(100));
    link.run_for(std::chrono::milliseconds(300));
    while (link.read_some(buffer, std::chrono::milliseconds(50)) > 0) {
    }
  }
}

inline ResumeRow resume_row(const ResumeCase& program, const ResumeFault& fault, int places, unsigned seed) {
  const std::string& text = program.written.text;
  const Shop& shop = program.written.shop;
  const auto lines = static_cast<long>(program_lines(text).size());
  std::string pattern = (std::filesystem::temp_directory_path() / "lightmill_resume_XXXXXX").string();
  if (mkdtemp(pattern.data()) == nullptr) std::abort();
  const std::filesystem::path folder = pattern;
  std::mt19937 random(seed);
  ResumeRow row;
  row.fault = fault.name;
  row.places = places;
  for (int i = 0; i < places; ++i) {
    const auto below = [&](long n) { return static_cast<long>(random() % static_cast<unsigned long>(n)); };
    SimulationOptions simulation;
    simulation.stock = program.stock;
    simulation.time_factor = 1;
    simulation.starvation_mark_mm = 0;  // the marks of resumes alone
    LineOptions wire{.baud = 115200, .faults = {}};
    long place = 30 + below(lines - 60);
    if (fault.planted != nullptr) {
      simulation.planted.*fault.planted = place;
    } else if (fault.sender == ResumeFault::kLives) {
      LineFault planted = fault.line;
      if (planted.kind == LineFault::Kind::kDropByte || planted.kind == LineFault::Kind::kFlipByte)
        place = 1500 + below(8 * lines);
      if (planted.kind == LineFault::Kind::kHangUp) place = 700 + below(static_cast<long>(text.size()) - 1000);
      planted.at = place;
      planted.bit = static_cast<int>(below(8));
      wire.faults.push_back(planted);
    }
    const auto broken = [&](const std::string& what) {
      row.broken.push_back(fault.name + " at place " + std::to_string(place) + ": " + what);
    };

    Lockstep rig(simulation, wire, shop.machine, shop.setup);
    const std::filesystem::path path = folder / std::to_string(i);
    JournalHeader header;
    header.program_digest = program_digest(text);
    header.lines = lines;
    header.planner_blocks = shop.machine.planner_blocks;
    StreamOptions options;
    int asked = 0;
    options.on_operator = [&](const std::string&) { return ++asked < 3; };
    Monitor monitor;
    const double killed_at = static_cast<double>(place) / static_cast<double>(lines);
    if (fault.sender == ResumeFault::kKilled || fault.sender == ResumeFault::kLosesPower) {
      monitor.on_progress = [&](std::string_view, double fraction) {
        if (fraction >= killed_at) throw Killed{};
      };
    }
    std::string said;
    bool done = false;
    {
      JournalOptions journal_options;
      journal_options.clock = &rig.clock;
      Journal journal(path, header, journal_options);
      options.journal = &journal;
      if (fault.sender == ResumeFault::kDiskFull) {
        monitor.on_progress = [&](std::string_view, double fraction) {
          if (fraction >= killed_at) throw JournalError("no space left on device");
        };
      }
      try {
        JumpingLink jumping(rig.link, fault.sender == ResumeFault::kClockJumps ? 40 * place : std::numeric_limits<long>::max(),
                            std::chrono::hours(i % 2 == 0 ? 1 : -1));
        const StreamResult result = stream_program(jumping, text, options, monitor);
        said = result.message;
        done = result.done();
        // Half of the senders say nothing more.
        if (below(2) == 0 || result.end == StreamEnd::kLostAcknowledgement)
          journal.end(done                                            ? "done"
                      : result.end == StreamEnd::kLostAcknowledgement ? "lost acknowledgement"
                                                                      : "other",
                      said);
      } catch (const Killed&) {
        rig.link.run_for(std::chrono::milliseconds(below(3000)));
      }
    }
    if (done) {
      ++row.went_on;
      continue;
    }
    if (fault.sender == ResumeFault::kLosesPower) {
      const auto size = std::filesystem::file_size(path);
      std::filesystem::resize_file(path, size - static_cast<std::uintmax_t>(below(static_cast<long>(size / 2))));
    }
    if (rig.machine.dead()) {
      rig.clock.advance_to(rig.clock.now() + std::chrono::seconds(10));
      rig.machine.start();
    }
    LockstepLink again(rig.machine, rig.clock);
    unlock(again);
    const long executed = rig.machine.result().lines;
    try {
      const StreamPlace found = find_place(shop.machine, shop.setup, text, read_journal(path));
      if (found.uncut_line == 0) {
        broken("the program is taken for finished; " + said);
        continue;
      }
      const Restart restart = write_restart(shop.machine, shop.setup, text, found.uncut_line);
      row.most_repeated = std::max(row.most_repeated, executed - restart.first_line);
      StreamOptions rest;
      rest.on_operator = [](const std::string&) { return true; };
      const StreamResult result = stream_program(again, restart.text, rest);
      if (!result.done()) broken("the restart ended early: " + result.message);
    } catch (const std::exception& error) {
      broken(error.what());
      continue;
    }
    ++row.resumed;
    const double mark_um = worst_um(program.undisturbed, rig.machine.machined());
    row.worst_um = std::max(row.worst_um, mark_um);
    if (mark_um > fault.most_um) broken("a mark of " + std::to_string(mark_um) + " um; " + said);
  }
  std::filesystem::remove_all(folder);
  return row;
}

constexpr const char* kResumeTable = "<!-- resume matrix: written by tests/bench/fault_bench.cpp -->\n";
constexpr const char* kResumeTableEnd = "<!-- end of resume matrix -->\n";

inline std::string markdown(const std::vector<ResumeRow>& rows) {
  std::string text = kResumeTable;
  text +=
      "| what happened | random places | went on | resumed | lines milled again, at most | mark, um "
      "|\n|---|---|---|---|---|---|\n";
  for (const ResumeRow& row : rows) {
    text += "| " + row.fault + " | " + std::to_string(row.places) + " | " + std::to_string(row.went_on) + " | " +
            std::to_string(row.resumed) + " | " + std::to_string(row.most_repeated) + " | " + fixed(row.worst_um, 3) +
            " |\n";
  }
  return text + kResumeTableEnd;
}

}  // namespace lightmill::test

// LinuxCNC's own interpreter beside ours: the canonical motion that its rs274 makes of a program.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "design/core/files.h"
#include "machine/program_reader.h"
#include "tests/scratch_folder.h"

namespace lightmill::test {

/// A move of XYZ, mm.
struct CanonMove {
  Vec3 to = Vec3::Zero();
  bool rapid = false;
  Vec3 middle = Vec3::Zero();  ///< of the way
  double length = 0;
  double feed = 0;  ///< in force, mm/min
};

struct CanonRun {
  std::vector<CanonMove> moves;
  std::vector<std::string> calls;  ///< dwells, stops and starts of the spindle
  std::string error;               ///< what stopped it
};

class Rs274 {
 public:
  /// Tools 1 to 55 of this diameter and no length.
  explicit Rs274(double diameter_mm = 4) {
    std::ofstream(folder_ / "mm.ini") << "[TRAJ]\nLINEAR_UNITS = mm\n[RS274NGC]\nPARAMETER_FILE = prog.var\n";
    std::ofstream tools(folder_ / "tool.tbl");
    char line[100];
    for (int n = 1; n <= 55; ++n) {  // in inches, whatever the file above says
      std::snprintf(line, sizeof line, "T%d P%d D%.12f Z+0 ;any\n", n, n, diameter_mm / 25.4);
      tools << line;
    }
  }

  static bool installed() { return std::system("command -v rs274 > /dev/null") == 0; }

  CanonRun run(const std::string& program) const {
    std::ofstream(folder_ / "program.ngc") << program;
    return run_file(folder_ / "program.ngc");
  }
  CanonRun run_file(const std::filesystem::path& program) const {
    // A HOME of its own: rs274 empties the user's tool table.
    const std::string command = "cd '" + folder_.root().string() +
                                "' && rm -f out.txt prog.var && HOME=. timeout 20 rs274 -g -i mm.ini -t tool.tbl '" +
                                program.string() + "' out.txt > log.txt 2>&1";
    const int status = std::system(command.c_str());
    CanonRun run = parse(read_whole(folder_ / "out.txt"));
    if (status != 0) run.error = read_whole(folder_ / "log.txt") + " ";
    return run;
  }

 private:
  static CanonRun parse(const std::string& listing) {
    CanonRun run;
    double unit = 1, feed = 0;
    int plane = 2;
    Vec3 at = Vec3::Zero();
    for (std::size_t from = 0; from < listing.size();) {
      const std::size_t end = std::min(listing.find('\n', from), listing.size());
      std::string line = listing.substr(from, end - from);
      from = end + 1;
      const std::size_t open = line.find('('), begin = open == std::string::npos ? open : line.rfind(' ', open);
      if (begin == std::string::npos) continue;
      const std::string name = line.substr(begin + 1, open - begin - 1), text = line.substr(open + 1);
      double v[8] = {};
      const char* p = text.c_str();
      for (double& x : v) {
        char* stop = nullptr;
        x = std::strtod(p, &stop);
        if (stop == p) break;
        p = *stop == ',' ? stop + 1 : stop;
      }
      if (name == "USE_LENGTH_UNITS") {
        unit = text.find("INCH") != std::string::npos ? 25.4 : 1;
      } else if (name == "SELECT_PLANE") {
        plane = text.find("XY") != std::string::npos ? 2 : text.find("XZ") != std::string::npos ? 1 : 0;
      } else if (name == "SET_FEED_RATE") {
        feed = v[0] * unit;
      } else if (name == "STRAIGHT_FEED" || name == "STRAIGHT_TRAVERSE" || name == "STRAIGHT_PROBE") {
        CanonMove move;
        move.to = Vec3(v[0], v[1], v[2]) * unit;
        move.middle = (at + move.to) / 2;
        move.rapid = name == "STRAIGHT_TRAVERSE";
        move.length = (move.to - at).norm();
        move.feed = feed;
        run.moves.push_back(move);
        at = move.to;
      } else if (name == "NURBS_FEED") {  // whose points it does not tell
        CanonMove move;
        move.to = move.middle = at = Vec3::Constant(NAN);
        run.moves.push_back(move);
      } else if (name == "ARC_FEED") {
        const int a = (plane + 1) % 3, b = (plane + 2) % 3;
        CanonMove move;
        move.to[a] = v[0] * unit;
        move.to[b] = v[1] * unit;
        move.to[plane] = v[5] * unit;
        const double ca = v[2] * unit, cb = v[3] * unit, from_angle = std::atan2(at[b] - cb, at[a] - ca);
        double turn = std::atan2(move.to[b] - cb, move.to[a] - ca) - from_angle;
        // Four decimals decide nothing about a full turn: ends as near as that are one.
        const double slack = 4e-4 / std::max(1e-6, std::hypot(at[a] - ca, at[b] - cb));
        while (v[4] > 0 && turn <= slack) turn += 2 * kPi;
        while (v[4] < 0 && turn >= -slack) turn -= 2 * kPi;
        turn += 2 * kPi * (v[4] > 0 ? v[4] - 1 : v[4] + 1);
        const double r = (std::hypot(at[a] - ca, at[b] - cb) + std::hypot(move.to[a] - ca, move.to[b] - cb)) / 2;
        move.middle[a] = ca + r * std::cos(from_angle + turn / 2);
        move.middle[b] = cb + r * std::sin(from_angle + turn / 2);
        move.middle[plane] = (at[plane] + move.to[plane]) / 2;
        move.length = std::hypot(std::hypot(at[a] - ca, at[b] - cb) * turn, move.to[plane] - at[plane]);
        move.feed = feed;
        run.moves.push_back(move);
        at = move.to;
      } else if ((name == "DWELL" && v[0] > 0) || name == "PROGRAM_STOP" || name.starts_with("START_SPINDLE")) {
        run.calls.push_back(line.substr(begin + 1));
      }
    }
    return run;
  }

  ScratchFolder folder_;
};

inline std::string call(const ProgramStep& step) {
  char text[60] = "";
  if (step.kind == ProgramStep::kDwell) std::snprintf(text, sizeof text, "DWELL(%.4f)", step.seconds);
  if (step.kind == ProgramStep::kPause) return "PROGRAM_STOP()";
  if (step.kind == ProgramStep::kSpindle && step.number != 5)
    return step.number == 3 ? "START_SPINDLE_CLOCKWISE(0)" : "START_SPINDLE_COUNTERCLOCKWISE(0)";
  return text;
}

/// What our reader makes of the same program.
struct OwnRun {
  std::vector<CanonMove> moves;
  std::vector<std::string> calls;
  ReadResult result;
};

inline OwnRun read_as_canon(const std::string& program, const MachineModel& machine, const ReaderSetup& setup,
                            ReaderDialect dialect = ReaderDialect::kLinuxCnc) {
  OwnRun run;
  std::vector<Vec3> chords;
  double seconds = 0;
  Vec3 at = Vec3::Zero();
  run.result = read_program(program, dialect, machine, setup, [&](const ProgramStep& step) {
    if (const std::string said = call(step); !said.empty()) run.calls.push_back(said);
    if (step.kind != ProgramStep::kMove) return;
    if (chords.empty()) chords.push_back(at);
    chords.emplace_back(step.programmed[0], step.programmed[1], step.programmed[2]);
    seconds += step.seconds;
    if (!step.whole) return;
    CanonMove move;
    move.to = chords.back();
    move.rapid = step.rapid;
    move.middle = (chords[(chords.size() - 1) / 2] + chords[chords.size() / 2]) / 2;
    for (const Vec3& p : chords) {
      move.length += (p - at).norm();
      at = p;
    }
    move.feed = seconds > 0 ? move.length / seconds * 60 : 0;
    run.moves.push_back(move);
    chords.clear();
    seconds = 0;
  });
  return run;
}

}  // namespace lightmill::test

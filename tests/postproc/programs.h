// Programs made of small paths, and their text line by line.
#pragma once

#include <algorithm>
#include <sstream>
#include <string>
#include <vector>

#include "postproc/program_check.h"
#include "tests/postproc/support.h"

namespace lightmill::test {

struct Made {
  MachineModel machine;
  WorkSetup setup;
  ToolPath path;
  AxisMotion motion;
  ProgramOptions options;
  Program program;
};

inline Made make(const MachineModel& machine, const WorkSetup& setup, const ToolPath& path,
                 const ProgramOptions& options = {}) {
  Made made{machine, setup, path, plan_motion(machine, setup, path), options, {}};
  made.program = write_program(made.machine, made.setup, made.motion, options);
  return made;
}

inline ProgramOptions with_decimals(int decimals) {
  ProgramOptions options;
  options.decimals = decimals;
  return options;
}

inline ProgramOptions with_block_numbers(bool on) {
  ProgramOptions options;
  options.block_numbers = on;
  return options;
}

inline std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

inline std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  return text;
}

inline std::vector<std::string> faults_of(const Made& made, const std::string& text) {
  return check_program_text(made.machine, made.setup, made.motion, text, made.options);
}

inline Made make_for(const std::string& controller, bool turning, bool tcp = false) {
  MachineModel machine = hostile_machine();
  machine.controller = controller;
  machine.has_tcp = tcp;
  const WorkSetup setup = work_on_table(machine, {23, -17, 30}, 54);
  ProgramOptions options = with_decimals(4);
  options.tcp = tcp;
  return make(machine, setup, turning ? lead_rows(20 * kDeg, 2, 5) : fixed_rows(30 * kDeg, 70 * kDeg, 2, 8), options);
}

/// The blocks' numbers set right again, where the dialect has them, so that a lost line is not betrayed by its number.
inline std::string renumbered(const std::vector<std::string>& lines, const std::string& controller) {
  const bool conversational = controller == "heidenhain", iso = controller == "heidenhain_iso";
  std::string text;
  long number = iso ? 1 : 0;
  for (const std::string& line : lines) {
    std::size_t digits = iso && line.starts_with("N") && !line.starts_with("N99999999") ? 1 : 0;
    if ((conversational && !line.starts_with(" ")) || digits == 1) {
      const std::size_t end = line.find_first_not_of("0123456789", digits);
      text += line.substr(0, digits) + std::to_string(number++) + line.substr(end) + "\n";
    } else {
      text += line + "\n";
    }
  }
  return text;
}

inline bool is_comment(const std::string& line) {
  return line.starts_with("(") || (line.find(';') != std::string::npos && !line.starts_with("; %"));
}

}  // namespace lightmill::test

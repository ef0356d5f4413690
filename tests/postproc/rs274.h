// A second interpreter, not ours: LinuxCNC's.
#pragma once

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "design/core/files.h"
#include "design/core/text.h"
#include "tests/postproc/programs.h"
#include "tests/scratch_folder.h"

namespace lightmill::test {

struct Canonical {
  std::string call;
  std::vector<double> numbers;
};

struct Rs274Run {
  int exit_code = 0;
  std::string errors;
  std::vector<Canonical> calls;  // feeds and traverses with X Y Z A B C, and what else takes numbers
};

inline bool has_rs274() {
  return std::system("command -v rs274 > /dev/null 2>&1") == 0;
}

inline Rs274Run run_rs274(const Made& made) {
  // A folder and HOME of its own: rs274 truncates the user's ~/.tool.mmap.
  const ScratchFolder folder;
  const Cutter& cutter = made.path.cutter;
  // M428 and M429 as the trunnion configurations have them: remaps, here to subprograms that only say so.
  write_whole(folder / "mm.ini",
              "[TRAJ]\nLINEAR_UNITS = mm\n[RS274NGC]\nPARAMETER_FILE = prog.var\nSUBROUTINE_PATH = " + folder.root().string() +
                  "\nREMAP=M428 modalgroup=10 ngc=428remap\nREMAP=M429 modalgroup=10 "
                  "ngc=429remap\n");
  for (const std::string m : {"428", "429"}) {
    write_whole(folder / (m + "remap.ngc"), "o<" + m + "remap> sub\n(M" + m + ")\no<" + m + "remap> endsub\nM2\n");
  }
  write_whole(folder / "tool.tbl", "T" + std::to_string(cutter.number) + " P1 D" + fixed(cutter.diameter_mm / 25.4, 8) +
                                       " Z+" + fixed(cutter.length_mm / 25.4, 8) + " ;inches\n");  // 2.9 reads inches
  write_whole(folder / made.program.file_name, made.program.text);
  const std::string command = "cd '" + folder.root().string() + "' && HOME='" + folder.root().string() +
                              "' rs274 -g -i mm.ini -t tool.tbl " + made.program.file_name + " out.txt > log.txt 2>&1";
  Rs274Run run;
  const int status = std::system(command.c_str());
  run.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  run.errors = read_whole(folder / "log.txt");
  for (const std::string& line : lines_of(read_whole(folder / "out.txt"))) {
    const std::size_t open = line.find('('), close = line.rfind(')');
    if (open == std::string::npos || close == std::string::npos) continue;
    Canonical canonical;
    canonical.call = line.substr(line.rfind(' ', open) + 1, open - line.rfind(' ', open) - 1);
    std::string arguments = line.substr(open + 1, close - open - 1);
    std::replace(arguments.begin(), arguments.end(), ',', ' ');
    std::istringstream in(arguments);
    for (double value; in >> value;) canonical.numbers.push_back(value);
    run.calls.push_back(canonical);
  }
  return run;
}

}  // namespace lightmill::test

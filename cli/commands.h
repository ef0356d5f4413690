// The lightmill command: reads the command line, runs what it asks for.
#pragma once

namespace lightmill {

/// Exit codes people may rely on (DESIGN.md, "Command line").
enum ExitCode : int {
  kExitDone = 0,
  kExitBug = 1,
  kExitBadInput = 2,
  kExitIo = 3,
  kExitNumerics = 4,
  kExitDryRunFault = 5,
  kExitStreamEnded = 6,
  kExitStopped = 130,
};

/// Runs a command; returns its exit code. Throws the three exceptions and Stopped.
int run_command_line(int argc, char** argv);

}  // namespace lightmill

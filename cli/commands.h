// The lightmill command.
#pragma once
namespace lightmill {
int run_command_line(int argc, char** argv);
}  // namespace lightmill

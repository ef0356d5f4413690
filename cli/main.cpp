#include "cli/commands.h"
int main(int argc, char** argv) { return lightmill::run_command_line(argc, argv); }

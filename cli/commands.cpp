#include "cli/commands.h"
namespace lightmill {
int run_command_line(int, char**) { return 0; }
}  // namespace lightmill

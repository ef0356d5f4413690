#include <cstdio>
#include <exception>
#include <filesystem>
#include <new>
#include <string>

#include "cli/commands.h"
#include "design/core/errors.h"

namespace {

/// One line on stderr, whatever the message holds.
int complain(std::string message, int code) {
  for (char& c : message) {
    if (c == '\n' || c == '\r') c = ' ';
  }
  std::fprintf(stderr, "lightmill: %s\n", message.c_str());
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace lightmill;
  try {
    return run_command_line(argc, argv);
  } catch (const InputError& e) {
    return complain(e.what(), kExitBadInput);
  } catch (const IoError& e) {
    return complain(e.what(), kExitIo);
  } catch (const NumericalError& e) {
    return complain(e.what(), kExitNumerics);
  } catch (const Stopped&) {
    return complain("stopped; finished stages are kept, the same command goes on from there", kExitStopped);
  } catch (const std::bad_alloc&) {
    return complain("not enough memory; choose fewer samples, a smaller mesh or a coarser dry_run.pitch_um", kExitIo);
  } catch (const std::filesystem::filesystem_error& e) {
    if (e.code() == std::errc::invalid_argument) {
      return complain("a file or folder name is empty; name one (is a shell variable unset?)", kExitBadInput);
    }
    return complain(e.path1().string() + ": " + e.code().message() + "; check the path and its permissions", kExitIo);
  } catch (const std::exception& e) {
    return complain(std::string("internal error, please report it: ") + e.what(), kExitBug);
  }
}

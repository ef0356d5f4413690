// A process of our own that ends when we do.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace lightmill {

/// Runs arguments[0]; its output goes to a log file. The kernel kills it if this process dies, the destructor if it lives on.
/// In a process group of its own, so that Ctrl-C on the terminal reaches us first. Throws IoError.
class ChildProcess {
 public:
  ChildProcess(const std::vector<std::string>& arguments, const std::filesystem::path& log);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  /// Asks it to end (SIGTERM).
  void terminate() const;
  /// Its exit code (128 + signal if killed), or nothing if it still runs after `deadline`.
  std::optional<int> wait(std::chrono::milliseconds deadline);
  [[nodiscard]] pid_t id() const { return pid_; }

 private:
  pid_t pid_ = -1;
  std::optional<int> exit_code_;
};

}  // namespace lightmill

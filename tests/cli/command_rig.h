// Runs the real lightmill binary in a folder that goes away, and looks at files as an outsider would.
#pragma once

#include <pty.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/scratch_folder.h"

namespace lightmill::test {

namespace fs = std::filesystem;

inline std::string slurp(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  return std::move(text).str();
}

inline void spill(const fs::path& path, const std::string& text) {
  fs::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary) << text;
}

inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  if (at == std::string::npos) throw std::runtime_error("the text has no '" + from + "'");
  return text.replace(at, from.size(), to);
}

struct CommandResult {
  int code = -1;
  std::string out, err;
};

inline std::string quoted(const std::string& text) {
  std::string result = "'";
  for (const char c : text) result += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return result + "'";
}

inline CommandResult lightmill_command(const std::vector<std::string>& arguments) {
  const ScratchFolder scratch;
  std::string command = quoted(LIGHTMILL_BINARY);
  for (const auto& argument : arguments) command += " " + quoted(argument);
  command += " </dev/null >" + quoted((scratch / "out").string()) + " 2>" + quoted((scratch / "err").string());
  const int status = std::system(command.c_str());
  CommandResult result;
  result.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  result.out = slurp(scratch / "out");
  result.err = slurp(scratch / "err");
  return result;
}

/// At a terminal of its own, where somebody types; `out` has all that is said there.
inline CommandResult typed_command(const std::vector<std::string>& arguments, const std::string& typed) {
  std::vector<std::string> all = {LIGHTMILL_BINARY};
  all.insert(all.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (auto& argument : all) argv.push_back(argument.data());
  argv.push_back(nullptr);
  int terminal = -1;
  const pid_t child = forkpty(&terminal, nullptr, nullptr, nullptr);
  if (child == 0) {
    execv(argv[0], argv.data());
    _exit(127);
  }
  CommandResult result;
  if (write(terminal, typed.data(), typed.size()) != static_cast<ssize_t>(typed.size())) result.err = "nothing could be typed";
  char buffer[4096];
  for (ssize_t count = 0; (count = read(terminal, buffer, sizeof buffer)) > 0;) result.out.append(buffer, static_cast<std::size_t>(count));
  close(terminal);
  int status = 0;
  waitpid(child, &status, 0);
  result.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return result;
}

/// Starts the binary without waiting; output goes to `log`.
inline pid_t start_lightmill(const std::vector<std::string>& arguments, const fs::path& log) {
  std::vector<std::string> all = {LIGHTMILL_BINARY};
  all.insert(all.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (auto& argument : all) argv.push_back(argument.data());
  argv.push_back(nullptr);
  const pid_t child = fork();
  if (child == 0) {
    FILE* file = std::freopen(log.c_str(), "w", stderr);
    if (file) dup2(fileno(file), STDOUT_FILENO);
    execv(argv[0], argv.data());
    _exit(127);
  }
  return child;
}

inline int wait_for(pid_t child) {
  int status = 0;
  waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

inline fs::path fixture(const std::string& name) { return fs::path(LIGHTMILL_FIXTURES) / name; }

/// The tiny job in a folder, with a line of it replaced.
inline fs::path tiny_job(const ScratchFolder& folder, const std::string& from = "", const std::string& to = "") {
  std::string text = replaced(slurp(fixture("jobs/tiny.toml")), "../pictures/tiny.png", fixture("pictures/tiny.png").string());
  if (!from.empty()) text = replaced(text, from, to);
  spill(folder / "tiny.toml", text);
  return folder / "tiny.toml";
}

/// The same for another machine file and its dialect, over whose zero the blank stands higher.
inline fs::path tiny_job_on(const ScratchFolder& folder, const std::string& machine, const std::string& dialect) {
  const fs::path job = tiny_job(folder, "workpiece_origin_mm = [7, -4, 0]",
                                "file = \"" + fixture("machines/" + machine).string() + "\"\nworkpiece_origin_mm = [7, -4, 30]");
  spill(job, slurp(job) + "\n[controller]\ndialect = \"" + dialect + "\"\n");
  return job;
}

}  // namespace lightmill::test

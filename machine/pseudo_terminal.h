// A pseudo-terminal whose far end another process opens as if it were a serial port.
#pragma once

#include <chrono>
#include <filesystem>
#include <span>
#include <string>

namespace lightmill {

/// Owns the controlling end; removes the symbolic link when it goes, also when a signal (INT, TERM, HUP) nobody else
/// handles ends the process. Throws IoError.
class PseudoTerminal {
 public:
  /// `link`: a symbolic link to the far end (e.g. DIR/port); empty: none.
  explicit PseudoTerminal(const std::filesystem::path& link);
  ~PseudoTerminal();
  PseudoTerminal(const PseudoTerminal&) = delete;
  PseudoTerminal& operator=(const PseudoTerminal&) = delete;

  [[nodiscard]] const std::string& far_end() const { return far_end_; }
  /// Bytes from the far end (0: none within the deadline). A hang-up of the far end is not an error: another may open
  /// it.
  std::size_t read_some(std::span<char> buffer, std::chrono::milliseconds deadline);
  /// Writes all bytes, or as many as fit before the deadline.
  std::size_t write_some(std::span<const char> bytes, std::chrono::milliseconds deadline);
  /// Cuts the line as if the plug were pulled: the client sees a hang-up, nothing more is read or written.
  void hang_up();

 private:
  int fd_ = -1;
  int keep_open_fd_ = -1;  ///< our own hold on the far end, so that a client's close does not hang up the line
  std::string far_end_;
  std::filesystem::path link_;
};

}  // namespace lightmill

// Program text as the wire sees it: its lines, and a digest that proves which lines a machine has executed.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace lightmill {

/// A line that is sent: without its line end and blanks around it.
struct ProgramLine {
  long number = 0;        ///< in the text, from 1
  std::string_view text;  ///< into the program
};

/// All lines but blank ones (a controller takes an empty line as the order to forget its last error).
std::vector<ProgramLine> program_lines(std::string_view program);

/// What a machine counts that is sent program after program: all lines but `$` commands.
class SentLines {
 public:
  void add(const std::string& name, std::string_view program);
  struct Place {
    std::string program;
    long line = 0;  ///< in the text, from 1
  };
  /// Nothing for counts of 0 and beyond the last line.
  [[nodiscard]] std::optional<Place> find(long count) const;

 private:
  struct Program {
    std::string name;
    std::vector<long> numbers;
  };
  std::vector<Program> programs_;
};

/// Does its last line end the program (M2 or M30 outside comments; a closing % may follow)? One that does not was cut
/// short on its way, its very last number perhaps with it, and would leave the machine with the spindle running.
bool ends_itself(std::string_view program);

/// Has it an M1 outside comments? Controllers whose switch for optional stops is off run over it.
bool is_optional_stop(std::string_view line);

/// FNV-1a, 64 bits, over every line's bytes and a line feed: a lost, doubled, changed or swapped line changes it.
class LineDigest {
 public:
  void add(std::string_view line) {
    for (const char c : line) mix(static_cast<unsigned char>(c));
    mix('\n');
  }
  /// Sixteen hexadecimal digits.
  [[nodiscard]] std::string hex() const;

 private:
  std::uint64_t state_ = 14695981039346656037ULL;
  void mix(unsigned char byte) { state_ = (state_ ^ byte) * 1099511628211ULL; }
};

/// LineDigest of a whole program's lines, what SimulationResult::received_digest must equal after it (and only it) ran.
std::string program_digest(std::string_view program);

}  // namespace lightmill

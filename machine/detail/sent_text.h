// What a sender must know about the lines it sends, without being an interpreter: their letters, and where they end.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace lightmill::detail {

/// The letters of a line's words, comments left out.
struct LineWords {
  std::uint32_t letters = 0;  ///< bit 0: A; without G and M
  bool axes = false;          ///< X Y Z A B C
  bool motion = false;        ///< G0 G1 G2 G3
  bool tool_change = false;   ///< M6
  bool pause = false;         ///< M0, M1
  bool program_end = false;    ///< M2, M30
  bool other_command = false;  ///< any G or M but the motions
};
LineWords words_of(std::string_view line);

/// Would a controller take `first` and `second` for one valid line if the line feed between them got lost? Not if a
/// word is repeated or two motions meet: then it answers with an error.
bool may_merge(const LineWords& first, const LineWords& second);

/// Empty if a controller can take the line as it stands, else why not.
std::string refusal(std::string_view line, int longest);

/// Where a program's text has sent the axes and which modes it has set, as far as the words alone tell.
class ProgrammedState {
 public:
  void read(std::string_view line);
  /// Compares with a status report (X, Y, Z, A, B, C; mm and degrees). False if an axis stands elsewhere; adds to
  /// `compared` how many axes could be.
  bool agrees_position(const std::vector<double>& machine_position, const std::vector<double>& work_offset,
                       int& compared) const;
  /// Compares with the answer to $G, "[GC:G0 G54 G17 G21 G90 G94 G49 M5 M9 T0 F0 S0]".
  bool agrees_modes(std::string_view answer, int& compared) const;

 private:
  enum class Known : std::uint8_t { kNo, kWork, kMachine };
  std::array<double, 6> value_{};
  std::array<Known, 6> known_{};
  bool inches_ = false, incremental_ = false;
  /// Last command of a modal group as $G writes it, in tenths (G90: 900); -1: not set by the program.
  enum Mode { kOffset, kUnits, kDistance, kFeed, kLength, kSpindle, kModes };
  std::array<long, kModes> mode_{-1, -1, -1, -1, -1, -1};
  double tool_ = -1;
  static int mode_of(char letter, long tenths);
};

}  // namespace lightmill::detail

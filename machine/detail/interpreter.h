// RS274 as grblHAL hears it: one line of text to steps of the machine, or an error code; strict, without allocation per
// line.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "postproc/machine_model.h"

namespace lightmill::detail {

/// grblHAL's error codes, those that this interpreter can give.
enum GcodeError : int {
  kGcodeOk = 0,
  kExpectedLetter = 1,  ///< a word must begin with a letter
  kBadNumber = 2,       ///< the number of a word is missing or not one; a comment that does not end
  kNegativeValue = 4,
  kOverflow = 11,     ///< line longer than kLongestLine
  kUnsupported = 20,  ///< word or command that this controller does not know
  kModalGroup = 21,   ///< two commands of one modal group
  kNoFeed = 22,       ///< feed zero or not given; G93 block without F
  kNotInteger = 23,
  kAxisConflict = 24,  ///< two commands that both want the axis words (two motions in a line: a lost line feed)
  kWordRepeated = 25,
  kNoAxisWords = 26,
  kBadLineNumber = 27,
  kValueMissing = 28,
  kG53Mode = 30,         ///< G53 needs G0 or G1
  kAxisWordsExist = 31,  ///< axis words while motion is cancelled (G80)
  kNoArcPlane = 32,      ///< arc without axis word in its plane
  kInvalidTarget = 33,   ///< arc whose ends do not fit its radius; a rotary axis that turns more than 1000 times
  kArcRadius = 34,
  kNoArcOffsets = 35,
  kUnusedWords = 36,
  kToolOffsetAxis = 37,  ///< G43.1 with another axis than Z
  kToolRange = 38,
  kOutOfRange = 39,  ///< spindle speed out of the machine's range
};

/// In words, for the operator.
std::string_view describe(int gcode_error);

inline constexpr std::size_t kLongestLine = 256;

/// Joint values in the order X, Y, Z, outer, inner; mm and rad, machine coordinates.
using Joints = std::array<double, 5>;

/// One thing for the machine to do. Steps of a line are carried out in order.
struct GcodeStep {
  enum Kind : std::uint8_t {
    kMove,
    kDwell,
    kSpindle,
    kCoolant,
    kSelectTool,
    kChangeTool,
    kPause,
    kOptionalPause,
    kEnd
  };
  Kind kind = kMove;
  bool rapid = false;
  Joints target{};     ///< kMove
  double seconds = 0;  ///< kMove: at the commanded feed (0 for rapids); kDwell
  int number = 0;      ///< tool; spindle: 0 off, 3, 4; coolant: 7, 8, 9
  double rpm = 0;      ///< kSpindle
};

/// Modal state as `$G` reports it.
struct GcodeModes {
  int motion = 0;   ///< 0, 1, 2, 3, 80
  int plane = 17;   ///< 17, 18, 19: of arcs
  int offset = 54;  ///< 54..59
  bool inches = false;
  bool incremental = false;
  bool inverse_time = false;
  int spindle = 5;  ///< 3, 4, 5
  bool mist = false, flood = false;
  int tool = 0;               ///< selected by T
  double feed = 0;            ///< mm/min; the last one of G94, 0: none yet
  double rpm = 0;             ///< S
  double tool_length_mm = 0;  ///< of G43.1
};

/// Holds modal state and the position at the end of what it has read.
class Interpreter {
 public:
  explicit Interpreter(const MachineModel& machine);

  /// Reads one line (without line end). On an error the state is as before and there are no steps.
  int execute(std::string_view line);
  [[nodiscard]] const std::vector<GcodeStep>& steps() const { return steps_; }

  /// Power-on modes; offsets and position stay.
  void reset();
  void set_position(const Joints& joints) { position_ = joints; }
  [[nodiscard]] const Joints& position() const { return position_; }
  /// Of G54..G59, linear axes in mm; rotary offsets are zero.
  void set_offset(int g, const std::array<double, 3>& offset_mm) { offsets_[g - 54] = offset_mm; }
  [[nodiscard]] const std::array<double, 3>& offset(int g) const { return offsets_[g - 54]; }
  [[nodiscard]] const GcodeModes& modes() const { return modes_; }

 private:
  struct Block;
  int read_words(std::string_view line, Block& block) const;
  int add_command_g(int tenths, Block& block) const;
  int add_command_m(int number, Block& block) const;
  int add_arc(const Block& block, const GcodeModes& modes, bool clockwise, const Joints& target, double seconds_per_mm,
              double block_seconds, std::uint32_t& unused);

  std::array<int, 26> axis_of_letter_{};  ///< index into Joints, -1: not an axis
  std::uint32_t axis_letters_ = 0;
  double min_rpm_, max_rpm_;
  GcodeModes modes_;
  Joints position_{};
  std::array<std::array<double, 3>, 6> offsets_{};
  std::vector<GcodeStep> steps_;
};

}  // namespace lightmill::detail

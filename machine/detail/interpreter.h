// RS274 as grblHAL hears it: one line of text to steps of the machine, or an error code; strict, without allocation per
// line.
#pragma once

#include <array>
#include <cstdint>
#include <string>
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
  kUnknownOffset = 29,  ///< P of G10 names no work offset
  kG53Mode = 30,         ///< G53 needs G0 or G1
  kAxisWordsExist = 31,  ///< axis words while motion is cancelled (G80)
  kNoArcPlane = 32,      ///< arc without axis word in its plane
  kInvalidTarget = 33,   ///< arc whose ends do not fit its radius; a rotary axis that turns more than 1000 times; a probe that goes nowhere
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
    kProbe,
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
  Joints target{};     ///< kMove, kProbe
  double seconds = 0;  ///< kMove, kProbe: at the commanded feed (0 for rapids); kDwell
  int number = 0;      ///< tool; spindle: 0 off, 3, 4; coolant: 7, 8, 9; probe: 382 to 385
  double rpm = 0;      ///< kSpindle
};

/// Modal state as `$G` reports it.
struct GcodeModes {
  int motion = 0;   ///< 0, 1, 2, 3, 80, 382 to 385
  int plane = 17;   ///< 17, 18, 19: of arcs
  int offset = 54;  ///< 54 to 59, 591 to 593
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

/// "G54", "G59.1": of a motion or an offset of GcodeModes.
std::string code_name(int code);

inline constexpr int kMostWorkOffsets = 9;

/// Holds modal state and the position at the end of what it has read.
class Interpreter {
 public:
  /// `work_offsets`: 6 (grbl), or 9 with G59.1 to G59.3 (grblHAL).
  explicit Interpreter(const MachineModel& machine, int work_offsets = kMostWorkOffsets);

  /// Reads one line (without line end). On an error the state is as before and there are no steps.
  int execute(std::string_view line);
  [[nodiscard]] const std::vector<GcodeStep>& steps() const { return steps_; }

  /// The last line has set an offset or a reference place (G10, G28.1, G30.1, G92, G92.1).
  [[nodiscard]] bool sets_places() const { return sets_places_; }

  /// Power-on modes, G92 forgotten; work offsets, reference places and position stay.
  void reset();
  void set_position(const Joints& joints) { position_ = joints; }
  [[nodiscard]] const Joints& position() const { return position_; }
  void set_offset(int g, const Joints& offset) { offsets_[index_of_offset(g)] = offset; }
  [[nodiscard]] const Joints& offset(int g) const { return offsets_[index_of_offset(g)]; }
  [[nodiscard]] const Joints& shift() const { return shift_; }  ///< of G92
  [[nodiscard]] const Joints& reference(std::size_t i) const { return references_[i]; }  ///< of G28, G30
  /// Where the program's zero is, tool length included: WCO of both firmwares' reports.
  [[nodiscard]] Joints zero() const { return zero_of(modes_); }
  [[nodiscard]] const GcodeModes& modes() const { return modes_; }

 private:
  static constexpr std::size_t index_of_offset(int g) { return static_cast<std::size_t>(g < 100 ? g - 54 : g - 591 + 6); }

  struct Block;
  /// What a line writes: one place at most.
  struct Written {
    Joints* place = nullptr;
    Joints value{};
  };
  int read_words(std::string_view line, Block& block) const;
  int add_command_g(int tenths, Block& block) const;
  int add_command_m(int number, Block& block) const;
  [[nodiscard]] Joints zero_of(const GcodeModes& modes) const;
  int take_target(const Block& block, const GcodeModes& modes, Joints& target, std::uint32_t& unused) const;
  int set_offsets(const Block& block, const GcodeModes& modes, std::uint32_t& unused, Written& written);
  int go_to_reference(const Block& block, const GcodeModes& modes, Joints& target, std::uint32_t& unused);
  int add_arc(const Block& block, const GcodeModes& modes, bool clockwise, const Joints& target, double seconds_per_mm,
              double block_seconds, std::uint32_t& unused);

  std::array<int, 26> axis_of_letter_{};  ///< index into Joints, -1: not an axis
  std::uint32_t axis_letters_ = 0;
  double min_rpm_, max_rpm_;
  GcodeModes modes_;
  Joints position_{};
  std::size_t work_offsets_;
  std::array<Joints, kMostWorkOffsets> offsets_{};
  Joints shift_{};                        ///< of G92
  std::array<Joints, 2> references_{};    ///< of G28 and G30
  bool sets_places_ = false;
  std::vector<GcodeStep> steps_;
};

}  // namespace lightmill::detail

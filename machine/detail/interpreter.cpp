#include "machine/detail/interpreter.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "machine/kinematics.h"

namespace lightmill::detail {

namespace {

constexpr double kMmPerInch = 25.4;
constexpr double kRadPerDegree = kPi / 180;
/// Of an arc's chords from the arc.
constexpr double kChordError_mm = 1e-4;
constexpr int kMostChords = 100000;

constexpr std::uint32_t bit(char letter) {
  return 1U << (letter - 'A');
}

/// The axes of G17 (X, Y), G18 (Z, X) and G19 (Y, Z): G3 turns from the first to the second.
constexpr std::pair<std::size_t, std::size_t> axes_of(int plane) {
  const auto across = static_cast<std::size_t>(19 - plane);
  return {(across + 1) % 3, (across + 2) % 3};
}

constexpr std::uint32_t bits_in_plane(int plane) {
  const auto [u, v] = axes_of(plane);
  return bit(static_cast<char>('X' + u)) | bit(static_cast<char>('X' + v));
}

/// Letters that carry a value; G and M are commands.
constexpr std::uint32_t kValueLetters = bit('F') | bit('I') | bit('J') | bit('K') | bit('L') | bit('N') | bit('P') |
                                        bit('R') | bit('S') | bit('T') | bit('X') | bit('Y') | bit('Z');

constexpr double kPowersOfTen[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9, 1e10,
                                   1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20};

/// [+-]digits[.digits], at least one digit, no exponent; blanks inside are not allowed. Exact to the last bit while it
/// has at most 15 digits. Moves `at` behind the number; false if there is none.
bool read_number(const char*& at, const char* end, double& value) {
  const char* p = at;
  bool negative = false;
  if (p != end && (*p == '+' || *p == '-')) negative = *p++ == '-';
  std::uint64_t digits = 0;
  int count = 0, decimals = 0;
  bool point = false, any = false;
  for (; p != end; ++p) {
    if (*p >= '0' && *p <= '9') {
      any = true;
      if (count >= 18) {
        if (!point) return false;  // no axis or feed has such a value
        continue;
      }
      digits = digits * 10 + static_cast<std::uint64_t>(*p - '0');
      if (digits != 0) ++count;
      if (point) {
        if (++decimals > 20) return false;
      }
    } else if (*p == '.' && !point) {
      point = true;
    } else {
      break;
    }
  }
  if (!any) return false;
  value = static_cast<double>(digits) / kPowersOfTen[decimals];
  if (negative) value = -value;
  at = p;
  return true;
}

enum ModalGroup : std::uint32_t {
  kMotionGroup = 1 << 0,
  kPlaneGroup = 1 << 1,
  kUnitsGroup = 1 << 2,
  kDistanceGroup = 1 << 3,
  kArcDistanceGroup = 1 << 4,
  kFeedGroup = 1 << 5,
  kCutterCompensationGroup = 1 << 6,
  kToolLengthGroup = 1 << 7,
  kOffsetGroup = 1 << 8,
  kPathGroup = 1 << 9,
  kOneShotGroup = 1 << 10,
  kStopGroup = 1 << 11,
  kToolChangeGroup = 1 << 12,
  kSpindleGroup = 1 << 13,
  kCoolantGroup = 1 << 14,
};

enum class AxisCommand : std::uint8_t { kNone, kMotion, kToolLength, kPlaces };

bool whole(double value) {
  return value == std::floor(value);
}

}  // namespace

struct Interpreter::Block {
  std::uint32_t words = 0;       ///< letters seen
  std::array<double, 26> value;  ///< only of letters seen
  std::uint32_t groups = 0;
  AxisCommand axis_command = AxisCommand::kNone;
  int motion = -1;
  int plane = -1;
  int offset = -1;
  int units = -1, distance = -1, feed_mode = -1;
  int tool_length = -1;  ///< 43 or 49
  int one_shot = -1;  ///< in tenths: 40, 100, 280, 281, 300, 301, 530, 920, 921
  int stop = -1;
  bool change_tool = false;
  int spindle = -1;
  bool mist = false, flood = false, coolant_off = false;
  bool nothing = true;  ///< only blanks and comments

  [[nodiscard]] bool has(char letter) const { return (words & bit(letter)) != 0; }
  [[nodiscard]] double of(char letter) const { return value[static_cast<std::size_t>(letter - 'A')]; }
  /// Of an axis word, by the letter's place.
  [[nodiscard]] double in_mm_or_rad(int letter, std::size_t axis, bool inches) const {
    return value[static_cast<std::size_t>(letter)] * (axis >= 3 ? kRadPerDegree : inches ? kMmPerInch : 1.0);
  }
};

std::string_view describe(int gcode_error) {
  switch (gcode_error) {
    case kGcodeOk:
      return "ok";
    case kExpectedLetter:
      return "a word must begin with a letter";
    case kBadNumber:
      return "bad number format";
    case 3:
      return "unknown $ command";
    case kNegativeValue:
      return "negative value";
    case 8:
      return "allowed only when idle";
    case 9:
      return "locked out by an alarm";
    case kOverflow:
      return "line too long";
    case kUnsupported:
      return "unsupported command or word";
    case kModalGroup:
      return "two commands of one modal group";
    case kNoFeed:
      return "feed not given or zero";
    case kNotInteger:
      return "command value is not an integer";
    case kAxisConflict:
      return "two commands want the axis words";
    case kWordRepeated:
      return "word repeated";
    case kNoAxisWords:
      return "axis words missing";
    case kBadLineNumber:
      return "invalid line number";
    case kValueMissing:
      return "value word missing";
    case kUnknownOffset:
      return "no such work offset";
    case kG53Mode:
      return "G53 needs G0 or G1";
    case kAxisWordsExist:
      return "axis words while motion is cancelled";
    case kNoArcPlane:
      return "no axis word in the arc's plane";
    case kInvalidTarget:
      return "the arc's ends do not fit its centre";
    case kArcRadius:
      return "the arc's radius is too small";
    case kNoArcOffsets:
      return "arc without centre or radius";
    case kUnusedWords:
      return "unused words in the block";
    case kToolOffsetAxis:
      return "G43.1 acts on Z only";
    case kToolRange:
      return "tool number out of range";
    case kOutOfRange:
      return "value out of the machine's range";
    default:
      return "error";
  }
}

std::string code_name(int code) {
  return "G" + (code < 100 ? std::to_string(code) : std::to_string(code / 10) + "." + std::to_string(code % 10));
}

Interpreter::Interpreter(const MachineModel& machine, int work_offsets)
    : min_rpm_(machine.min_spindle_rpm),
      max_rpm_(machine.max_spindle_rpm),
      work_offsets_(static_cast<std::size_t>(work_offsets)) {
  axis_of_letter_.fill(-1);
  axis_of_letter_['X' - 'A'] = 0;
  axis_of_letter_['Y' - 'A'] = 1;
  axis_of_letter_['Z' - 'A'] = 2;
  if (machine.has_rotary()) {
    axis_of_letter_[static_cast<std::size_t>(machine.outer.letter - 'A')] = 3;
    axis_of_letter_[static_cast<std::size_t>(machine.inner.letter - 'A')] = 4;
  }
  for (std::size_t i = 0; i < 26; ++i) axis_letters_ |= axis_of_letter_[i] >= 0 ? 1U << i : 0U;
  steps_.reserve(64);
}

void Interpreter::reset() {
  modes_ = {};
  shift_ = {};
  steps_.clear();
}

Joints Interpreter::zero_of(const GcodeModes& modes) const {
  Joints zero = offset(modes.offset);
  for (std::size_t i = 0; i < zero.size(); ++i) zero[i] += shift_[i];
  zero[2] += modes.tool_length_mm;
  return zero;
}

int Interpreter::add_command_g(int tenths, Block& block) const {
  const auto claim = [&](std::uint32_t group) {
    const bool taken = (block.groups & group) != 0;
    block.groups |= group;
    return taken ? kModalGroup : kGcodeOk;
  };
  switch (tenths) {
    case 0:
    case 10:
    case 20:
    case 30:
    case 382:
    case 383:
    case 384:
    case 385:
      // Before the modal group, as in grbl: two motions in a line are two claims on the axis words.
      if (block.axis_command != AxisCommand::kNone) return kAxisConflict;
      block.axis_command = AxisCommand::kMotion;
      block.motion = tenths < 100 ? tenths / 10 : tenths;
      return claim(kMotionGroup);
    case 800:
      block.motion = 80;
      return claim(kMotionGroup);
    case 100:
    case 280:
    case 300:
    case 920:
      if (block.axis_command != AxisCommand::kNone) return kAxisConflict;
      block.axis_command = AxisCommand::kPlaces;
      [[fallthrough]];
    case 40:
    case 281:
    case 301:
    case 530:
    case 921:
      block.one_shot = tenths;
      return claim(kOneShotGroup);
    case 170:
    case 180:
    case 190:
      block.plane = tenths / 10;
      return claim(kPlaneGroup);
    case 200:
    case 210:
      block.units = tenths / 10;
      return claim(kUnitsGroup);
    case 900:
    case 910:
      block.distance = tenths / 10;
      return claim(kDistanceGroup);
    case 911:
      return claim(kArcDistanceGroup);
    case 930:
    case 940:
      block.feed_mode = tenths / 10;
      return claim(kFeedGroup);
    case 400:
      return claim(kCutterCompensationGroup);
    case 431:
    case 490:
      if (block.axis_command != AxisCommand::kNone) return kAxisConflict;
      block.axis_command = AxisCommand::kToolLength;
      block.tool_length = tenths / 10;
      return claim(kToolLengthGroup);
    case 540:
    case 550:
    case 560:
    case 570:
    case 580:
    case 590:
      block.offset = tenths / 10;
      return claim(kOffsetGroup);
    case 591:
    case 592:
    case 593:
      if (index_of_offset(tenths) >= work_offsets_) return kUnsupported;
      block.offset = tenths;
      return claim(kOffsetGroup);
    case 610:
      return claim(kPathGroup);
    default:
      return kUnsupported;
  }
}

int Interpreter::add_command_m(int number, Block& block) const {
  const auto claim = [&](std::uint32_t group) {
    const bool taken = (block.groups & group) != 0;
    block.groups |= group;
    return taken ? kModalGroup : kGcodeOk;
  };
  switch (number) {
    case 0:
    case 1:
    case 2:
    case 30:
      block.stop = number;
      return claim(kStopGroup);
    case 3:
    case 4:
    case 5:
      block.spindle = number;
      return claim(kSpindleGroup);
    case 6:
      block.change_tool = true;
      return claim(kToolChangeGroup);
    case 7:
    case 8: {  // mist and flood may stand in one block
      bool& mine = number == 7 ? block.mist : block.flood;
      if (mine || block.coolant_off) return kModalGroup;
      mine = true;
      block.groups |= kCoolantGroup;
      return kGcodeOk;
    }
    case 9:
      block.coolant_off = true;
      return claim(kCoolantGroup);
    default:
      return kUnsupported;
  }
}

int Interpreter::read_words(std::string_view line, Block& block) const {
  const char* p = line.data();
  const char* const end = p + line.size();
  while (p != end) {
    char letter = *p;
    if (letter == ' ' || letter == '\t') {
      ++p;
      continue;
    }
    if (letter == ';') break;
    if (letter == '(') {
      p = std::find(p, end, ')');
      if (p == end) return kBadNumber;
      ++p;
      continue;
    }
    if (letter == '%' && block.nothing) return kGcodeOk;
    if (letter >= 'a' && letter <= 'z') letter = static_cast<char>(letter - 'a' + 'A');
    if (letter < 'A' || letter > 'Z') return kExpectedLetter;
    ++p;
    while (p != end && (*p == ' ' || *p == '\t')) ++p;
    double value = 0;
    if (!read_number(p, end, value)) return kBadNumber;
    block.nothing = false;
    if (letter == 'G' || letter == 'M') {
      const double tenths = std::round(value * 10);
      if (!(tenths >= 0 && tenths < 10000)) return kUnsupported;
      if (std::abs(value * 10 - tenths) > 1e-6) return letter == 'G' ? kUnsupported : kNotInteger;
      const int code = static_cast<int>(tenths);
      if (letter == 'M' && code % 10 != 0) return kNotInteger;
      const int error = letter == 'G' ? add_command_g(code, block) : add_command_m(code / 10, block);
      if (error != kGcodeOk) return error;
      continue;
    }
    const auto index = static_cast<std::size_t>(letter - 'A');
    if ((kValueLetters & bit(letter)) == 0 && axis_of_letter_[index] < 0) return kUnsupported;
    if (block.has(letter)) return kWordRepeated;
    block.words |= bit(letter);
    block.value[index] = value;
  }
  return kGcodeOk;
}

int Interpreter::execute(std::string_view line) {
  steps_.clear();
  sets_places_ = false;
  if (line.size() > kLongestLine) return kOverflow;
  Block block;
  if (const int error = read_words(line, block); error != kGcodeOk) return error;
  if (block.nothing) return kGcodeOk;

  // Everything is checked on a copy of the modes; an error leaves the state as it was.
  GcodeModes modes = modes_;
  Joints target = position_;
  const std::uint32_t axis_words = block.words & axis_letters_;
  std::uint32_t unused = block.words;
  const auto use = [&](char letter) { unused &= ~bit(letter); };
  const auto fail = [&](int error) {
    steps_.clear();
    return error;
  };

  if (block.has('N')) {
    if (!whole(block.of('N')) || block.of('N') < 0 || block.of('N') > 9999999) return kBadLineNumber;
    use('N');
  }
  AxisCommand axis_command = block.axis_command;
  if (axis_words != 0 && axis_command == AxisCommand::kNone) axis_command = AxisCommand::kMotion;

  if (block.units >= 0) modes.inches = block.units == 20;
  if (block.distance >= 0) modes.incremental = block.distance == 91;
  if (block.feed_mode >= 0) modes.inverse_time = block.feed_mode == 93;
  if (block.motion >= 0) modes.motion = block.motion;
  if (block.plane >= 0) modes.plane = block.plane;
  if (block.offset >= 0) modes.offset = block.offset;
  const double unit = modes.inches ? kMmPerInch : 1.0;

  // Feed.
  double inverse_time = 0;  // 1/min
  if (block.has('F')) {
    if (block.of('F') < 0) return kNegativeValue;
    use('F');
    if (modes.inverse_time) {
      inverse_time = block.of('F');
    } else {
      modes.feed = block.of('F') * unit;
    }
  } else if (modes.inverse_time && axis_command == AxisCommand::kMotion && modes.motion >= 1 && modes.motion != 80) {
    return kNoFeed;
  } else if (block.feed_mode == 94 && modes_.inverse_time) {
    modes.feed = 0;  // the last F was an inverse time
  }

  // Spindle speed and tool.
  if (block.has('S')) {
    if (block.of('S') < 0) return kNegativeValue;
    modes.rpm = block.of('S');
    use('S');
  }
  if (block.has('T')) {
    if (block.of('T') < 0) return kNegativeValue;
    if (!whole(block.of('T'))) return kNotInteger;
    if (block.of('T') > 9999) return kToolRange;
    modes.tool = static_cast<int>(block.of('T'));
    use('T');
    steps_.push_back({.kind = GcodeStep::kSelectTool, .number = modes.tool});
  }
  if (block.change_tool) {
    // The spindle stops for a change.
    steps_.push_back({.kind = GcodeStep::kChangeTool, .number = modes.tool});
    modes.spindle = 5;
  }
  if (block.spindle >= 0) modes.spindle = block.spindle;
  const bool turning = modes.spindle != 5;
  if (turning && (modes.rpm < min_rpm_ || modes.rpm > max_rpm_ || modes.rpm == 0)) return fail(kOutOfRange);
  // A spindle that turns takes an S without M3 at once [grbl 1.1h, gcode.c, "4. Set spindle speed"].
  if (block.spindle >= 0 || (turning && modes.rpm != modes_.rpm)) {
    steps_.push_back(
        {.kind = GcodeStep::kSpindle, .number = turning ? modes.spindle : 0, .rpm = turning ? modes.rpm : 0.0});
  }
  if (block.mist || block.flood || block.coolant_off) {
    modes.mist = (modes.mist || block.mist) && !block.coolant_off;
    modes.flood = (modes.flood || block.flood) && !block.coolant_off;
    steps_.push_back({.kind = GcodeStep::kCoolant, .number = block.coolant_off ? 9 : (block.flood ? 8 : 7)});
  }
  if (block.one_shot == 40) {
    if (!block.has('P')) return fail(kValueMissing);
    if (block.of('P') < 0) return fail(kNegativeValue);
    use('P');
    steps_.push_back({.kind = GcodeStep::kDwell, .seconds = block.of('P')});
  }

  // Tool length.
  if (axis_command == AxisCommand::kToolLength) {
    if (block.tool_length == 43) {
      if (axis_words == 0) return fail(kNoAxisWords);
      if (axis_words != bit('Z')) return fail(kToolOffsetAxis);
      modes.tool_length_mm = block.of('Z') * unit;
      use('Z');
    } else {
      modes.tool_length_mm = 0;
    }
  }

  if (block.one_shot == 530 && (axis_command == AxisCommand::kToolLength || modes.motion > 1)) return fail(kG53Mode);

  // Offsets and reference places; all but the motion to one are kept for the end, where nothing can fail any more.
  Written written;
  if (block.one_shot == 100 || block.one_shot == 920) {
    if (const int error = set_offsets(block, modes, unused, written); error != kGcodeOk) return fail(error);
  } else if (block.one_shot == 280 || block.one_shot == 300) {
    if (const int error = go_to_reference(block, modes, target, unused); error != kGcodeOk) return fail(error);
  } else if (block.one_shot == 281 || block.one_shot == 301) {
    written = {&references_[block.one_shot == 301], position_};
  } else if (block.one_shot == 921) {
    written = {&shift_, {}};
  }

  // Motion.
  if (axis_command == AxisCommand::kMotion) {
    if (modes.motion == 80) return fail(kAxisWordsExist);
    if (const int error = take_target(block, modes, target, unused); error != kGcodeOk) return fail(error);

    if (modes.motion >= 1 && (modes.inverse_time ? inverse_time : modes.feed) == 0) return fail(kNoFeed);
    const bool probes = modes.motion >= 382;
    if (probes && axis_words == 0) return fail(kNoAxisWords);
    if (probes && target == position_) return fail(kInvalidTarget);
    if (modes.motion <= 1 || probes) {
      if (axis_words != 0) {
        GcodeStep move{.kind = probes ? GcodeStep::kProbe : GcodeStep::kMove, .rapid = modes.motion == 0, .target = target};
        move.number = probes ? modes.motion : 0;
        if (modes.motion >= 1) {
          if (modes.inverse_time) {
            move.seconds = 60 / inverse_time;
          } else {
            // grbl's rule: the Euclidean length over all axes, mm and degrees alike.
            double square = 0;
            for (std::size_t i = 0; i < 5; ++i) {
              const double d = (target[i] - position_[i]) / (i < 3 ? 1.0 : kRadPerDegree);
              square += d * d;
            }
            move.seconds = std::sqrt(square) * 60 / modes.feed;
          }
        }
        steps_.push_back(move);
      }
    } else {
      if (axis_words == 0) return fail(kNoAxisWords);
      if ((axis_words & bits_in_plane(modes.plane)) == 0) return fail(kNoArcPlane);
      const int error = add_arc(block, modes, modes.motion == 2, target, modes.inverse_time ? 0 : 60 / modes.feed,
                                modes.inverse_time ? 60 / inverse_time : 0, unused);
      if (error != kGcodeOk) return fail(error);
    }
  }
  if (unused != 0) return fail(kUnusedWords);

  if (block.stop == 0 || block.stop == 1) {
    steps_.push_back({.kind = block.stop == 0 ? GcodeStep::kPause : GcodeStep::kOptionalPause});
  } else if (block.stop >= 0) {
    steps_.push_back({.kind = GcodeStep::kEnd, .number = block.stop});
    // A program's end resets modes, not units, feed, tool and its length [grblHAL's program completion].
    modes.motion = 1;
    modes.plane = 17;
    modes.offset = 54;
    modes.incremental = false;
    modes.inverse_time = false;
    modes.spindle = 5;
    modes.mist = modes.flood = false;
  }
  modes_ = modes;
  position_ = target;
  sets_places_ = written.place != nullptr;
  if (sets_places_) *written.place = written.value;
  return kGcodeOk;
}

/// Where a block's axis words send the axes.
int Interpreter::take_target(const Block& block, const GcodeModes& modes, Joints& target, std::uint32_t& unused) const {
  const Joints zero = zero_of(modes);
  for (std::uint32_t rest = block.words & axis_letters_; rest != 0; rest &= rest - 1) {
    const int letter = std::countr_zero(rest);
    const auto axis = static_cast<std::size_t>(axis_of_letter_[static_cast<std::size_t>(letter)]);
    const double value = block.in_mm_or_rad(letter, axis, modes.inches);
    target[axis] = value;
    if (block.one_shot != 530) target[axis] += modes.incremental ? position_[axis] : zero[axis];
    if (axis >= 3 && !(std::abs(target[axis] - position_[axis]) <= kMostTurn_rad)) return kInvalidTarget;
  }
  unused &= ~axis_letters_;
  return kGcodeOk;
}

/// G10 L2 and L20 (the machine stands at these coordinates), G92.
int Interpreter::set_offsets(const Block& block, const GcodeModes& modes, std::uint32_t& unused, Written& written) {
  const std::uint32_t axis_words = block.words & axis_letters_;
  if (axis_words == 0) return kNoAxisWords;
  bool stands_there = true;
  Joints others{};  // what else lies between the machine's zero and the program's
  others[2] = modes.tool_length_mm;
  const Joints* add = &shift_;
  if (block.one_shot == 100) {
    if (!block.has('L') || !block.has('P')) return kValueMissing;
    if (block.of('P') < 0) return kNegativeValue;
    const double system = std::floor(block.of('P'));
    if (system > static_cast<double>(work_offsets_)) return kUnknownOffset;
    stands_there = block.of('L') == 20;
    if (!stands_there && (block.of('L') != 2 || block.has('R'))) return kUnsupported;
    unused &= ~(bit('L') | bit('P'));
    written.place = &offsets_[system > 0 ? static_cast<std::size_t>(system) - 1 : index_of_offset(modes.offset)];
  } else {
    written.place = &shift_;
    add = &offset(modes.offset);
  }
  for (std::size_t i = 0; i < others.size(); ++i) others[i] += (*add)[i];
  written.value = *written.place;
  for (std::uint32_t rest = axis_words; rest != 0; rest &= rest - 1) {
    const int letter = std::countr_zero(rest);
    const auto axis = static_cast<std::size_t>(axis_of_letter_[static_cast<std::size_t>(letter)]);
    const double value = block.in_mm_or_rad(letter, axis, modes.inches);
    written.value[axis] = stands_there ? position_[axis] - others[axis] - value : value;
  }
  unused &= ~axis_letters_;
  return kGcodeOk;
}

/// G28, G30: with axis words through the point that they name, and these axes only.
int Interpreter::go_to_reference(const Block& block, const GcodeModes& modes, Joints& target, std::uint32_t& unused) {
  const std::uint32_t axis_words = block.words & axis_letters_;
  const Joints& home = references_[block.one_shot == 300];
  if (axis_words != 0) {
    if (const int error = take_target(block, modes, target, unused); error != kGcodeOk) return error;
    steps_.push_back({.kind = GcodeStep::kMove, .rapid = true, .target = target});
  }
  for (std::uint32_t rest = axis_words != 0 ? axis_words : axis_letters_; rest != 0; rest &= rest - 1) {
    const auto axis = static_cast<std::size_t>(axis_of_letter_[static_cast<std::size_t>(std::countr_zero(rest))]);
    target[axis] = home[axis];
  }
  steps_.push_back({.kind = GcodeStep::kMove, .rapid = true, .target = target});
  return kGcodeOk;
}

int Interpreter::add_arc(const Block& block, const GcodeModes& modes, bool clockwise, const Joints& target,
                         double seconds_per_mm, double block_seconds, std::uint32_t& unused) {
  const double unit = modes.inches ? kMmPerInch : 1.0;
  const auto [u, v] = axes_of(modes.plane);
  const char letter_u = static_cast<char>('I' + u), letter_v = static_cast<char>('I' + v);
  const double dx = target[u] - position_[u], dy = target[v] - position_[v];
  double i = 0, j = 0;  // centre from the start
  if (block.has('R')) {
    unused &= ~bit('R');
    double r = block.of('R') * unit;
    const double chord = std::hypot(dx, dy);
    if (chord == 0) return kInvalidTarget;
    const double square = 4 * r * r - chord * chord;
    if (square < 0) return kArcRadius;
    // The centre lies on the chord's bisector: on its left going counter-clockwise, a negative R takes the long way
    // round.
    double h = std::sqrt(square) / (2 * chord);
    if (clockwise != (r < 0)) h = -h;
    i = dx / 2 - dy * h;
    j = dy / 2 + dx * h;
  } else {
    if (!block.has(letter_u) && !block.has(letter_v)) return kNoArcOffsets;
    if (block.has(letter_u)) i = block.of(letter_u) * unit;
    if (block.has(letter_v)) j = block.of(letter_v) * unit;
    unused &= ~(bit(letter_u) | bit(letter_v));
    const double r = std::hypot(i, j), end_r = std::hypot(dx - i, dy - j), off = std::abs(end_r - r);
    // grbl: 5 um, or 0.1 % of the radius but never more than 0.5 mm.
    if (off > 0.005 && (off > 0.5 || off > 0.001 * r)) return kInvalidTarget;
  }
  const double cx = position_[u] + i, cy = position_[v] + j;
  const double r0 = std::hypot(i, j), r1 = std::hypot(dx - i, dy - j);
  if (r0 == 0 || r1 == 0) return kInvalidTarget;
  const double a0 = std::atan2(-j, -i), a1 = std::atan2(dy - j, dx - i);
  double turn = a1 - a0;
  constexpr double kSameAngle = 5e-7;  // grbl: coincident ends are a full turn
  if (clockwise) {
    if (turn >= -kSameAngle) turn -= 2 * kPi;
  } else {
    if (turn <= kSameAngle) turn += 2 * kPi;
  }
  const double r = std::max(r0, r1);
  // A chord over angle t stays r (1 - cos(t / 2)) inside its arc.
  const double most = r > kChordError_mm ? 2 * std::acos(1 - kChordError_mm / r) : kPi;
  const double wanted = std::ceil(std::abs(turn) / most);
  if (!(wanted <= kMostChords)) return kInvalidTarget;
  const int count = std::max(1, static_cast<int>(wanted));
  double square = std::pow((r0 + r1) / 2 * turn, 2);
  for (std::size_t k = 0; k < 5; ++k) {
    if (k != u && k != v) square += std::pow((target[k] - position_[k]) / (k < 3 ? 1.0 : kRadPerDegree), 2);
  }
  const double seconds = block_seconds > 0 ? block_seconds : std::sqrt(square) * seconds_per_mm;
  for (int n = 1; n <= count; ++n) {
    const double t = static_cast<double>(n) / count, a = a0 + t * turn, rt = r0 + t * (r1 - r0);
    GcodeStep chord{.kind = GcodeStep::kMove, .target = target, .seconds = seconds / count};
    if (n < count) {
      for (std::size_t k = 0; k < 5; ++k) chord.target[k] = position_[k] + t * (target[k] - position_[k]);
      chord.target[u] = cx + rt * std::cos(a);
      chord.target[v] = cy + rt * std::sin(a);
    }
    steps_.push_back(chord);
  }
  return kGcodeOk;
}

}  // namespace lightmill::detail

#include "machine/detail/sent_text.h"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace lightmill::detail {

namespace {

/// Calls word(letter, value) for every word outside comments; the value is 0 if it is no number.
template <typename Word>
void for_each_word(std::string_view line, const Word& word) {
  const char* p = line.data();
  const char* const end = p + line.size();
  while (p != end) {
    char c = *p++;
    if (c == ';') return;
    if (c == '(') {
      while (p != end && *p != ')') ++p;
      continue;
    }
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 'a' + 'A');
    if (c < 'A' || c > 'Z') continue;
    while (p != end && (*p == ' ' || *p == '\t' || *p == '+')) ++p;
    double value = 0;
    const auto result = std::from_chars(p, end, value, std::chars_format::fixed);
    p = result.ptr;
    word(c, value);
  }
}

constexpr std::string_view kAxes = "XYZABC";
/// Half of the last digit of two printed numbers (three decimals each) and the program's own rounding.
constexpr double kReportTolerance = 0.0016;

}  // namespace

LineWords words_of(std::string_view line) {
  // Called for every line that is sent: it looks at letters and at the digits behind G and M only.
  LineWords words;
  const char* p = line.data();
  const char* const end = p + line.size();
  while (p != end) {
    char c = *p++;
    if (c >= 'a' && c <= 'z') c = static_cast<char>(c - 'a' + 'A');
    if (c == ';') break;
    if (c == '(') {
      while (p != end && *p != ')') ++p;
      continue;
    }
    if (c < 'A' || c > 'Z') continue;
    if (c != 'G' && c != 'M') {
      words.letters |= 1U << (c - 'A');
      continue;
    }
    int number = 0;
    bool digits = false;
    while (p != end && (*p == ' ' || *p == '\t')) ++p;
    for (; p != end && *p >= '0' && *p <= '9'; ++p) {
      number = number < 1000 ? number * 10 + (*p - '0') : number;
      digits = true;
    }
    const bool whole = digits && (p == end || *p != '.');
    const bool motion = whole && c == 'G' && number <= 3;
    words.motion = words.motion || motion;
    words.other_command = words.other_command || !motion;
    if (!whole) continue;
    if (c == 'M' && number == 6) words.tool_change = true;
    if (c == 'M' && number <= 1) words.pause = true;
    if (c == 'M' && (number == 2 || number == 30)) words.program_end = true;
  }
  for (const char axis : kAxes) words.axes = words.axes || (words.letters & (1U << (axis - 'A'))) != 0;
  return words;
}

bool may_merge(const LineWords& first, const LineWords& second) {
  if (first.motion && second.motion) return false;
  return (first.letters & second.letters) == 0;
}

std::string refusal(std::string_view line, int longest) {
  if (line.size() > static_cast<std::size_t>(longest)) {
    return "has " + std::to_string(line.size()) + " characters, the controller takes " + std::to_string(longest);
  }
  if (line.front() == '$') return "is a controller command ($), not part of a program";
  for (const char c : line) {
    const auto code = static_cast<unsigned char>(c);
    if (code >= 0x80) return "has a byte above 127, which would act as a real-time command (write comments in ASCII)";
    if (c == '?' || c == '!' || c == '~')
      return std::string("has a '") + c + "', which would act as a real-time command";
    if (code < 0x20 && c != '\t') return "has a control character";
  }
  return {};
}

int ProgrammedState::mode_of(char letter, long tenths) {
  if (letter == 'M') return tenths == 30 || tenths == 40 || tenths == 50 ? kSpindle : -1;
  if (tenths >= 540 && tenths <= 593 && (tenths % 10 == 0 || tenths > 590)) return kOffset;
  switch (tenths) {
    case 200:
    case 210:
      return kUnits;
    case 900:
    case 910:
      return kDistance;
    case 930:
    case 940:
      return kFeed;
    case 431:
    case 490:
      return kLength;
    default:
      return -1;
  }
}

void ProgrammedState::read(std::string_view line) {
  std::array<double, 6> words{};
  std::array<bool, 6> given{};
  bool machine_coordinates = false, offsets_change = false, no_motion = false, lost = false;
  bool ends = false, spindle_stops = false;
  for_each_word(line, [&](char letter, double value) {
    const long tenths = std::lround(std::clamp(value, -1e6, 1e6) * 10);
    if (letter == 'G' || letter == 'M') {
      const int mode = mode_of(letter, tenths);
      if (mode >= 0) mode_[static_cast<std::size_t>(mode)] = tenths;
    }
    if (letter == 'M') {
      ends = ends || tenths == 20 || tenths == 300;
      spindle_stops = spindle_stops || tenths == 60;  // a tool change may stop it, depending on the controller
    }
    if (letter == 'T') tool_ = value;
    if (letter == 'G') {
      if (tenths == 200 || tenths == 210) inches_ = tenths == 200;
      if (tenths == 900 || tenths == 910) incremental_ = tenths == 910;
      if (tenths == 530) machine_coordinates = true;
      if (tenths == 431 || tenths == 430) no_motion = offsets_change = true;
      if (tenths == 490 || (tenths >= 540 && tenths <= 599)) offsets_change = true;
      if (tenths == 100 || tenths == 920) no_motion = offsets_change = true;
      if (tenths == 921) offsets_change = true;
      if (tenths == 280 || tenths == 300 || (tenths >= 382 && tenths <= 385)) lost = true;
      return;
    }
    const std::size_t axis = kAxes.find(letter);
    if (axis == std::string_view::npos) return;
    words[axis] = value * (inches_ && axis < 3 ? 25.4 : 1.0);
    given[axis] = true;
  });
  if (spindle_stops) mode_[kSpindle] = -1;
  if (ends) {
    // What a program's end resets differs between controllers.
    mode_.fill(-1);
    incremental_ = false;
    offsets_change = true;
  }
  for (std::size_t i = 0; i < 6; ++i) {
    // A new offset moves the work coordinates of an axis that stands still; what they are now, the words do not say.
    if (lost || (offsets_change && known_[i] == Known::kWork)) known_[i] = Known::kNo;
    if (!given[i] || no_motion || lost) continue;
    if (machine_coordinates) {
      value_[i] = words[i];
      known_[i] = Known::kMachine;
    } else if (incremental_) {
      value_[i] += words[i];
    } else {
      value_[i] = words[i];
      known_[i] = Known::kWork;
    }
  }
}

bool ProgrammedState::agrees_position(const std::vector<double>& machine_position,
                                      const std::vector<double>& work_offset, int& compared) const {
  for (std::size_t i = 0; i < 6 && i < machine_position.size(); ++i) {
    if (known_[i] == Known::kNo) continue;
    double expected = value_[i];
    if (known_[i] == Known::kWork) {
      if (i >= work_offset.size()) continue;
      expected += work_offset[i];
    }
    if (std::abs(machine_position[i] - expected) > kReportTolerance) return false;
    ++compared;
  }
  return true;
}

bool ProgrammedState::agrees_modes(std::string_view answer, int& compared) const {
  if (!answer.starts_with("[GC:")) return false;
  bool agrees = true;
  for_each_word(answer.substr(4), [&](char letter, double value) {
    const long tenths = std::lround(std::clamp(value, -1e6, 1e6) * 10);
    const int mode = letter == 'G' || letter == 'M' ? mode_of(letter, tenths) : -1;
    if (mode >= 0 && mode_[static_cast<std::size_t>(mode)] >= 0) {
      agrees = agrees && mode_[static_cast<std::size_t>(mode)] == tenths;
      ++compared;
    }
    if (letter == 'T' && tool_ >= 0) {
      agrees = agrees && value == tool_;
      ++compared;
    }
  });
  return agrees;
}

}  // namespace lightmill::detail

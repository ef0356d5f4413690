// How long each line of a program takes and what the axes do in it, as a table.
#pragma once

#include <functional>
#include <string>

#include "machine/motion_timing.h"

namespace lightmill {

/// A line of a program's text.
struct TextLine {
  std::string program;  ///< file name
  long line = 0;
};

/// A line's motions (an arc's chords, the pieces of a turn) in one row, in the order in which they are made; a line that is
/// executed again has another row. Lines that move nothing have none; a dwell is told with the motion that follows.
class LineTimes {
 public:
  explicit LineTimes(std::function<TextLine(const TimedBlock&)> place);
  void add(const TimedBlock& block);
  /// CSV with a head: feeds are the tip's over the work, speed and acceleration along the path of all axes (mm and degrees).
  [[nodiscard]] std::string table();

 private:
  std::function<TextLine(const TimedBlock&)> place_;
  std::string rows_;
  TextLine at_;
  long line_ = -1;  ///< as the machine counts, like `program_`
  int program_ = 0;
  bool rapid_ = false;
  double stood_s_ = 0, seconds_ = 0, asked_s_ = 0, tip_mm_ = 0, speed_ = 0, acceleration_ = 0;
  void end_row();
};

}  // namespace lightmill

// What all controls that run files have in common: offsets, tool length, TCP, straight moves and arcs.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "machine/detail/work_frame.h"
#include "machine/program_reader.h"

namespace lightmill::detail {

inline constexpr double kRadPerDegree = kPi / 180;
inline constexpr double kMmPerInch = 25.4;
inline constexpr double kSameAngle_rad = 1e-9;

/// The plane's axes in the order of a right-handed turn, and the axis across: G17, G18, G19.
inline constexpr int kPlanes[3][3] = {{0, 1, 2}, {2, 0, 1}, {1, 2, 0}};

/// Thrown inside a reader; read_program() turns it into a ProgramError.
struct ReaderError {
  int column;
  std::string rule;
};

[[noreturn]] inline void reject(int column, std::string rule) {
  throw ReaderError{column, std::move(rule)};
}

/// [digits][.digits] without sign or exponent at `at`, which moves behind it; false if there is no digit. Exact up to
/// 15 digits.
bool read_digits(const char*& at, const char* end, double& value, bool* has_point = nullptr);

/// The machine as the control holds it.
class ReaderCore {
 public:
  ReaderCore(const MachineModel& machine, const ReaderSetup& setup,
             const std::function<void(const ProgramStep&)>& on_step);

  /// Index in AxisValues of an axis letter, or -1.
  [[nodiscard]] int axis_of(char letter) const;
  /// Program coordinates of where the machine stands.
  [[nodiscard]] const AxisValues& here() const { return here_; }
  [[nodiscard]] const AxisValues& joints() const { return joints_; }

  /// Straight, in program coordinates. `seconds` 0 for rapids.
  void move(const AxisValues& to, bool rapid, double seconds);
  /// Straight in machine coordinates, whatever the offsets; not under TCP.
  void move_joints(const AxisValues& to, bool rapid, double seconds);
  /// An arc to `to` about `centre` (in the plane's axes u, v), turning by `turn_rad` (its sign is the sense from u to
  /// v).
  void arc(const AxisValues& to, int u, int v, double centre_u, double centre_v, double turn_rad, double seconds);
  /// Along point(t), t from 0 to `spans`, smooth between whole numbers; at this feed, or in 1 / feed minutes.
  void curve(const AxisValues& to, int spans, const std::function<AxisValues(double)>& point, double feed_per_min,
             bool inverse_time);
  void say(ProgramStep::Kind kind, int number = 0, double value = 0);

  // Changing any of these leaves the machine where it is and renews here().
  void set_offset(const AxisValues& offset);
  void set_length(double length_mm);
  void set_tcp(bool on);
  /// Program coordinates in a frame. `on_work`: the frame is the work's, as the rotary axes have turned it: a tilted plane, in
  /// which linear moves follow the work and the rotary axes turn alone. Otherwise it is the machine's.
  void set_frame(const WorkFrame& frame, bool on_work);
  [[nodiscard]] const WorkFrame& frame() const { return frame_; }
  [[nodiscard]] bool tilted() const { return tilted_; }
  [[nodiscard]] bool tcp() const { return tcp_; }
  [[nodiscard]] double length_mm() const { return length_mm_; }
  [[nodiscard]] double tool_length(int number, int column) const;
  /// Rotary words that turn the cutter into a direction of program coordinates; the nearest first, none if there are none.
  [[nodiscard]] std::vector<RotaryAngles> angles_for(const Vec3& direction);
  /// The first of them that `wanted` agrees to; refused if there is none.
  template <typename Wanted>
  RotaryAngles angles_for(const Vec3& direction, int column, Wanted wanted) {
    for (const RotaryAngles& angles : angles_for(direction)) {
      if (wanted(angles)) return angles;
    }
    reject(column, "the rotary axes cannot turn the tool into this direction");
  }
  /// Straight with the cutter's axis turning evenly, in the plane of both, into a direction of program coordinates.
  void move_on_great_circle(const AxisValues& to, const Vec3& direction, bool rapid, double seconds);

  /// Time of a move at a feed over the linear axes, or over the angles (degrees) if only those move.
  [[nodiscard]] double seconds_at(const AxisValues& to, double feed_per_min) const;

  long line = 0;
  long blocks = 0;  ///< begun so far
  // How corners are passed, for the moves to come (ProgramStep).
  double corner_tolerance_mm = -1;
  bool exact_stop = false;
  int length_of = 0;  ///< the tool whose length a word of its own has called
  const ReaderSetup& setup;
  const MachineModel& machine;

 private:
  [[nodiscard]] AxisValues to_joints(const AxisValues& program);
  [[nodiscard]] AxisValues to_program(const AxisValues& joints);
  void renew();
  void pass(const AxisValues& to, bool rapid, double seconds, bool whole);
  const std::function<void(const ProgramStep&)>& on_step_;
  WorkpieceView view_;
  AxisValues here_{}, joints_{}, offset_{};
  WorkFrame frame_;
  double length_mm_ = 0;
  bool tcp_ = false, framed_ = false, tilted_ = false;
};

/// The turn of an arc from angle a0 to a1: coincident ends are a full turn.
inline double turn_between(double a0, double a1, bool clockwise) {
  double turn = a1 - a0;
  if (clockwise) {
    while (turn >= -kSameAngle_rad) turn -= 2 * kPi;
    while (turn < -2 * kPi - kSameAngle_rad) turn += 2 * kPi;
  } else {
    while (turn <= kSameAngle_rad) turn += 2 * kPi;
    while (turn > 2 * kPi + kSameAngle_rad) turn -= 2 * kPi;
  }
  return turn;
}

/// Centre of the arc of radius r between two points: negative r takes the long way.
void centre_by_radius(double u0, double v0, double u1, double v1, double r, bool clockwise, int column, double& cu,
                      double& cv);

/// RS274/NGC as LinuxCNC reads it, or Fanuc's.
ReadResult read_word_program(std::string_view text, bool fanuc, ReaderCore& core);
/// Heidenhain conversational.
ReadResult read_heidenhain(std::string_view text, ReaderCore& core);
/// Heidenhain DIN/ISO.
ReadResult read_heidenhain_iso(std::string_view text, ReaderCore& core);
/// Siemens 840D.
ReadResult read_siemens(std::string_view text, ReaderCore& core);

/// The text's lines without their ends.
std::vector<std::string_view> split_lines(std::string_view text);

/// A word of a block between blanks.
struct Token {
  std::string_view text;
  int column;
};

/// A line's words up to its comment, which a semicolon begins.
void split_words(std::string_view line, std::vector<Token>& tokens);

/// A whole text that is a number, with a sign if need be.
double signed_number(std::string_view text, int column);

/// A Heidenhain control's datum from its preset table.
const AxisValues& datum(const ReaderCore& core, double number, int column);

/// Reads line after line until `ended`: `read_line(i)` carries line i out and gives the next one's index; `prepare`
/// looks at the whole text before.
template <typename ReadLine, typename Prepare>
ReadResult run_lines(ReaderCore& core, std::size_t lines, const bool& ended, const char* missing_end,
                     ReadLine read_line, Prepare prepare) {
  ReadResult result;
  try {
    prepare();
    for (std::size_t at = 0; at < lines && !ended;) {
      core.line = static_cast<long>(at) + 1;
      if ((result.blocks = ++core.blocks) > core.setup.most_blocks) reject(1, "the program does not end");
      at = read_line(at);
    }
    if (!ended) reject(1, missing_end);
  } catch (const ReaderError& e) {
    result.error = ProgramError{core.line, e.column, e.rule};
  }
  result.ended = ended;
  return result;
}

}  // namespace lightmill::detail

// A program's text as the checker reads it: blocks of orders, the same for every dialect.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <string_view>

#include "postproc/detail/dialect.h"
#include "postproc/machine_model.h"

namespace lightmill::detail {

enum class Order : std::uint8_t {
  kRapid,     ///< G0, FMAX
  kFeed,      ///< G1, L with a feed
  kClockwise,
  kCounterClockwise,
  kMachine,   ///< machine coordinates in this block: G53, SUPA, M91
  kNoLength,  ///< D0 in this block: the tool's length is out of force
  kMetric,
  kAbsolute,
  kPlane,     ///< XY
  kPlaneZx,
  kPlaneYz,
  kRelativeCentre,  ///< G91.1
  kNoRadius,  ///< G40, R0
  kNoCycle,
  kOffset,  ///< work offset `offset`
  kPerMinute,
  kInverse,  ///< G93
  kTimed,    ///< this block takes `time` seconds (FT)
  kDwell,    ///< `time`
  kLengthOff,
  kLengthOn,    ///< from the tool table, tool `length_of` (0: the tool in the spindle), plus `delta`
  kLengthSaid,  ///< `length`
  kTcpOn,
  kTcpOff,
  kTcpFrame,  ///< ORIWKS ORIAXES
  kSmoothOn,  ///< within `smoothing`
  kSmoothOff,
  kShortWay,  ///< of endless axes: M126
  kLongWay,
  kBlank,  ///< BLK FORM, G30, G31
  kCount
};

inline constexpr double kNotSaid = std::numeric_limits<double>::quiet_NaN();

struct Block {
  std::uint64_t orders = 0;
  std::uint64_t m_codes = 0;                                                     ///< bits 0 to 63
  std::array<double, 5> axis{kNotSaid, kNotSaid, kNotSaid, kNotSaid, kNotSaid};  ///< mm and degrees
  std::array<double, 3> centre{kNotSaid, kNotSaid, kNotSaid};                    ///< I, J, K
  double f = kNotSaid, s = kNotSaid, t = kNotSaid;
  double number = kNotSaid;  ///< of the block
  int offset = 0;
  int length_of = 0;
  double time = kNotSaid, length = kNotSaid, delta = 0, smoothing = kNotSaid;
  double smoothing_angle = kNotSaid;  ///< degrees, of rotary axes
  bool short_way = false;  ///< C=DC(...)

  void order(Order o) { orders |= 1ULL << static_cast<int>(o); }
  [[nodiscard]] bool has(Order o) const { return (orders >> static_cast<int>(o) & 1) != 0; }
  [[nodiscard]] bool has_m(int code) const { return (m_codes >> code & 1) != 0; }
  [[nodiscard]] bool said(int i) const { return axis[i] == axis[i]; }
  [[nodiscard]] bool linear() const { return said(0) || said(1) || said(2); }
  [[nodiscard]] bool rotary() const { return said(3) || said(4); }
};

/// Calls `complain` for what it cannot read, and `run` for each block.
class BlockReader {
 public:
  struct Events {
    std::function<void(const std::string&)> complain;
    std::function<void(const Block&)> run;
  };
  BlockReader(const MachineModel& machine, const Dialect& dialect, Events events)
      : machine_(machine), dialect_(dialect), events_(std::move(events)) {}

  void line(std::string_view text);
  /// After the last line: what the frame still lacks.
  void finish();
  [[nodiscard]] long line_number() const { return line_; }

 private:
  [[nodiscard]] int axis_of(char letter) const;
  void conversational(std::string_view text);
  void conversational_block(std::string_view text);
  void words(std::string_view text);
  void cycle(std::string_view rest, Block& block, bool& runs);
  bool complain(const std::string& what) {
    events_.complain(what);
    return false;
  }

  const MachineModel& machine_;
  const Dialect& dialect_;
  Events events_;
  long line_ = 0;
  bool opened_ = false, closed_ = false;
  std::string_view name_;
  int percents_ = 0;
  double next_number_ = 0;
  bool continues_ = false;  // a ~ stood at the line's end
  std::string_view cycle_;  // CYCL DEF whose values follow
  Block held_;
};

}  // namespace lightmill::detail

// RS274/NGC as LinuxCNC reads it, and Fanuc's blocks, which share its words: one reader, its parts in sources of their
// own.
#pragma once

#include <bit>
#include <map>
#include <optional>
#include <unordered_map>
#include <utility>

#include "machine/detail/cutter_compensation.h"
#include "machine/detail/expressions.h"
#include "machine/detail/splines.h"

namespace lightmill::detail {

inline std::size_t index_of(char letter) {
  return static_cast<std::size_t>(letter - 'A');
}
constexpr std::uint32_t bit(char letter) {
  return 1U << (letter - 'A');
}

inline constexpr std::size_t kDeepestCall = 10;
inline constexpr std::size_t kMoreOffsets = 48;  // G54.1 P1 to P48

const Grammar& word_grammar(bool fanuc);

class WordReader : private ExpressionReader {
 public:
  WordReader(std::string_view text, bool fanuc, ReaderCore& core);
  ReadResult run();

 private:
  // --- A line's text, without blanks and comments, in capitals: word_reader.cpp ---
  void prepare(std::string_view line);
  [[nodiscard]] int column() const override {
    const auto i = static_cast<std::size_t>(p_ - text_.data());
    return columns_.empty() ? 1 : columns_[std::min(i, columns_.size() - 1)];
  }

  // --- Parameters and functions with a syntax of their own: word_expressions.cpp ---
  bool operand(double& v, int depth) override;
  std::string name_end();
  double* named(const std::string& name);
  double parameter(int depth);
  static int address(double v, int where);
  double numbered(int n);

  // --- O-words, subprograms, kept modes: word_flow.cpp ---
  struct Frame {
    std::size_t back;
    std::unordered_map<int, double> saved;
    std::size_t loops;
    int locals = 0;  ///< parameters of its own, from 1 on
    std::size_t start = 0;
    long left = 0;  ///< repeats to come, from `start`
    std::unordered_map<int, double> arguments{};
    bool modal = false;
  };
  /// What M70 keeps.
  struct Modes {
    double unit, rpm;
    ModalFeed feed;
    bool incremental, centre_absolute, to_r_level;
    int plane, spindle;
    std::size_t offset;
  };
  struct Loop {
    std::string label;
    std::size_t line;
    double left;
    bool repeats;
  };
  std::string label();
  std::size_t find(std::size_t from, const std::string& wanted, std::initializer_list<std::string_view> words,
                   std::string_view* found = nullptr);
  void leave_sub();
  void enter_sub(Frame frame);
  void set_locals(const std::unordered_map<int, double>& values, int count);
  void keep_modes(int code);
  void restore();
  void leave_loop(const std::string& name, int where, bool again);
  void flow();

  // --- Fanuc's custom macros: word_macro.cpp ---
  struct MacroCall {
    std::size_t line;
    double times;
    std::unordered_map<int, double> arguments;
  };
  void look_through();
  long find_mark(char kind, double number, bool backwards);
  std::size_t find_program(double number, int where);
  double variable(double n, int where);
  void assign();
  void go_to(double n, int where);
  bool statement();
  bool read_argument(char letter, int where);
  double repeats(double program);
  void call(std::size_t line, double times, const std::unordered_map<int, double>* arguments, bool modal);
  void call_subprogram();
  void take_macro_call(int tenths);
  void call_modal();
  void leave_program();

  // --- A block and its codes: word_reader.cpp ---
  struct Code {
    char letter;
    int tenths, group;
  };
  /// What a block's codes ask for; -1: nothing of the kind.
  struct Request {
    int motion = -1, compensation = -1, length = -1, shot = -1, offset = -1, feed_mode = -1, stop = -1, spindle = -1,
        coolant = -1, tcp = -1, keep = -1, signal = -1, plane = -1, macro = -1;
    bool change = false;
  };
  void read_block(std::string_view line);
  void read_word(std::uint32_t& groups);
  static std::string code_name(int tenths);
  [[nodiscard]] const char* why_refused(char letter, int tenths) const;
  [[nodiscard]] int g_group(int tenths) const;
  [[nodiscard]] int m_group(int tenths) const;
  void take_g(const Code& g, Request& request);
  void take_m(int code, Request& request);
  void set_corners(int tenths);
  void refuse_in_tilted_plane(const Request& request) const;
  [[nodiscard]] bool has(char letter) const { return (words_ & bit(letter)) != 0; }
  double use(char letter) {
    words_ &= ~bit(letter);
    return values_[index_of(letter)];
  }
  double need(char letter, const char* why) {
    if (!has(letter)) reject(1, std::string(why) + " needs " + letter);
    return use(letter);
  }
  [[nodiscard]] int column_of(char letter) const { return word_columns_[index_of(letter)]; }
  [[nodiscard]] double scale(int axis) const { return axis < 3 ? unit_ : kRadPerDegree; }
  void perform();
  bool set_feed(int feed_mode, double unit);
  [[nodiscard]] Feed feed(bool said_here = true) const { return feed_.at(rpm_, spindle_ != 5, said_here); }
  void set_speed_and_tool(Request& request);
  void refuse_beside_compensation(const Code& code);
  void dwell();
  void stop(int code);

  // --- Offsets, lengths, moves and arcs: word_motion.cpp ---
  void renew_offset();
  void set_compensation(int tenths);
  bool set_length(int tenths);
  int more_offset();
  bool shift(int tenths);
  std::vector<int> taken_axes();
  double target_value(int axis);
  [[nodiscard]] bool polar() const { return polar_radius_ || polar_angle_; }
  std::pair<double, double> polar_end();
  void set_data();
  void set_fanuc_offset(double l, double p);
  void reference(const AxisValues& home);
  void move(bool machine_coordinates, bool feed_here);
  void arc(const AxisValues& to, std::uint32_t named);

  // --- Fanuc's tilted planes and tool directions: word_planes.cpp ---
  void take_plane(int tenths);
  void turn_to_plane();
  void turn_to_direction(AxisValues& to);

  // --- Canned cycles: word_cycles.cpp ---
  /// The sticky words of a cycle.
  struct Cycle {
    double level = 0;  ///< across the plane where the first of these cycles was called
    std::optional<double> r, depth, dwell_s, peck, i, j, k;
  };
  void read_cycle(double height);
  void drill();
  void make_hole(AxisValues& at, double r, double bottom, double clear);

  // --- Splines: word_splines.cpp ---
  AxisValues spline_end();
  void refuse_spline_modes(bool feed_here) const;
  void bezier(bool cubic, bool feed_here);
  void add_control_point(bool fresh, bool feed_here);
  void end_spline(bool after_points);
  void follow_spline(const std::vector<ControlPoint>& points, int order, const AxisValues& to);

  // --- Probing, inputs and outputs: word_signals.cpp ---
  void probe();
  void signal(int code);

  bool fanuc_;
  ReaderCore& core_;
  std::vector<std::string_view> lines_;
  std::size_t at_ = 0, next_ = 0;
  bool ended_ = false;
  int percents_ = 0;
  std::string text_;
  std::vector<int> columns_;
  std::unordered_map<int, double> numbers_;
  std::unordered_map<std::string, double> globals_;
  std::vector<std::unordered_map<std::string, double>> locals_{1};
  std::unordered_map<std::string, std::size_t> subs_, whiles_;
  std::vector<Frame> frames_;
  std::vector<Loop> loops_;
  std::vector<std::pair<std::string, double>> settings_;
  bool looked_through_ = false;
  std::map<std::pair<char, double>, std::vector<std::size_t>> marks_;  ///< lines of N and O, of DO and END as D and E
  std::vector<std::size_t> programs_;                                  ///< lines of O
  long searched_ = 0;                                                  ///< lines looked at for ends of structures
  std::optional<MacroCall> modal_call_;
  bool reads_arguments_ = false;
  std::unordered_map<int, double> arguments_;
  std::array<int, 3> ijk_{};
  std::uint32_t words_ = 0, axis_letters_ = 0;
  std::array<double, 26> values_{};
  std::array<int, 26> word_columns_{};
  std::vector<Code> codes_;
  // Modes.
  double unit_ = 1, rpm_ = 0;
  ModalFeed feed_;
  bool incremental_ = false, centre_absolute_ = false, to_r_level_ = false;
  int motion_ = 0, plane_ = 0, spindle_ = 5, tool_ = 0, selected_ = 0, last_cycle_ = -1;
  Cycle cycle_;
  std::vector<ControlPoint> control_points_;
  int spline_order_ = 3;
  std::array<double, 2> spline_direction_{};  ///< in which the next G5 without I and J begins
  std::array<AxisValues, 2> references_{};    ///< of G28 and G30
  std::size_t offset_ = 0;
  std::array<AxisValues, 9 + kMoreOffsets> offsets_{};
  AxisValues shift_{}, kept_shift_{};
  AxisValues local_shift_{};    ///< Fanuc's G52; LinuxCNC has it in the same place as G92
  bool directions_ = false;  ///< I, J and K are the tool's: G43.5
  CutterCompensation path_;
  std::vector<std::optional<Modes>> saved_{1};
  std::vector<bool> restores_{false};  ///< M73: at the subprogram's return
  std::optional<double> polar_radius_, polar_angle_;
  int polar_column_ = 0;
};

}  // namespace lightmill::detail

// Siemens 840D programs: one reader, its parts in sources of their own.
#pragma once

#include <map>
#include <optional>
#include <unordered_map>

#include "machine/detail/contour_corner.h"
#include "machine/detail/expressions.h"

namespace lightmill::detail {

class SiemensReader : private ExpressionReader {
 public:
  SiemensReader(std::string_view text, ReaderCore& core);
  ReadResult run();

 private:
  enum class How : std::uint8_t { kModal, kAbsolute, kIncremental, kShortest, kUpwards, kDownwards };
  struct AxisWord {
    bool named = false;
    double value = 0;
    How how = How::kModal;
  };
  struct Words {
    std::array<AxisWord, 5> axes{};
    std::array<AxisWord, 3> centre{};  ///< I, J, K
    std::optional<double> radius, turns, f, s;
    std::optional<double> rounding, chamfer, side;     ///< RND, CHF, CHR: of the corner at the block's end
    std::array<std::optional<double>, 3> direction{};  ///< A3, B3, C3
    int motion = -1, d = -1, tool = -1, tcp = -1, offset = -1, spindle = -1, coolant = -1, stop = -1, compensation = -1;
    bool suppress = false, dwell = false, change = false;
  };

  // --- A block and its words: siemens_reader.cpp ---
  void read_line(std::size_t at);
  void read_block();
  [[nodiscard]] int column() const override { return static_cast<int>(p_ - text_.data()) + 1; }
  bool operand(double& v, int depth) override;
  /// A name of letters, digits and underscores at the cursor.
  [[nodiscard]] std::string_view name() const;
  bool take_name(std::string_view wanted);
  [[nodiscard]] bool word_ends() const { return p_ == end_ || *p_ == ' ' || *p_ == '\t' || *p_ == ';'; }
  void expect_word_end() const {
    if (!word_ends()) reject(column(), "words stand apart by blanks");
  }
  void read_word(Words& w, std::uint32_t& groups);
  bool read_keyword(std::string_view word, int where, Words& w);
  void read_address(char letter, double v, int where, Words& w, std::uint32_t& groups);
  void read_axis(AxisWord& word, bool rotary, int where);
  /// Behind an address: a number, or = and an expression.
  double address_value();
  void g_code(Words& w, double v, int where, std::uint32_t& groups);
  void m_code(Words& w, double v, int where, std::uint32_t& groups);
  void pass_corners(bool exact_stop, double tolerance_mm);
  void perform(Words& w);
  void change_tool(const Words& w);

  // --- Variables, jumps, loops, subprograms: siemens_flow.cpp ---
  struct Variable {
    double value = 0;
    bool whole = false;  ///< INT
  };
  struct Call {
    std::size_t back, start;
    long left;                                                            ///< repeats to come
    std::vector<std::pair<std::string, std::optional<Variable>>> hidden;  ///< the caller's of the parameters' names
  };
  void look_through();
  bool statement();
  Variable* variable(int depth = 0);
  void assign(Variable& variable);
  bool assignment();
  [[nodiscard]] std::string new_name();
  [[nodiscard]] bool type_is_whole();
  std::vector<std::optional<double>> arguments();
  void take_arguments(std::size_t line, Call& call, int where);
  void define_variables();
  void branch(const std::string& word);
  void jump(bool holds);
  void call(std::size_t line, int where);
  void leave_program(int code);
  std::size_t partner_of(int where) const;

  // --- Drilling: siemens_cycles.cpp ---
  struct Cycle {
    int number = 0;  ///< 81, 82, 83
    std::vector<std::optional<double>> values;
  };
  bool cycle_call();
  void drill(const Cycle& cycle);

  // --- Frames, swivelling, moves: siemens_motion.cpp ---
  bool read_frame();
  void renew_frame();
  void swivel();
  void set_compensation(int code);
  [[nodiscard]] Feed feed(bool said_here = true) const { return feed_.at(rpm_, spindle_ != 5, said_here); }
  void move(const Words& w, bool feed_here);
  void arc(const Words& w, const AxisValues& to);
  /// Where the program means to stand.
  [[nodiscard]] AxisValues place() const { return held_ ? held_->move.to : path_.place(); }
  void follow(const Words& w, ContourMove next, const Feed& feed);
  void refuse_inside_contour() const {
    if (held_) reject(1, "behind RND, CHF and CHR another path must follow");
  }
  void set_direction(const Words& w, AxisValues& to, std::optional<Vec3>& great_circle_to);

  ReaderCore& core_;
  CutterCompensation path_;
  std::vector<std::string_view> lines_;
  std::size_t at_ = 0, next_ = 0;
  std::string text_;
  bool began_ = false, ended_ = false;
  // Flow.
  std::unordered_map<int, Variable> r_;
  std::map<std::string, Variable, std::less<>> variables_;
  bool looked_through_ = false;
  std::vector<std::size_t> partners_;  ///< of each line: where its IF, ELSE or loop goes on
  std::map<std::string, std::vector<std::size_t>, std::less<>> labels_;
  std::map<std::string, std::size_t, std::less<>> subprograms_;
  std::vector<std::size_t> sections_;  ///< first lines of programs
  std::vector<Call> calls_;
  std::optional<std::size_t> counted_;  ///< the FOR that its ENDFOR leads back to
  // Modes.
  enum class Turning : std::uint8_t { kUnsaid, kAxes, kGreatCircle };
  Turning turning_ = Turning::kUnsaid;
  bool incremental_ = false, machine_directions_ = false;
  double unit_ = 1, rpm_ = 0;
  ModalFeed feed_;
  int motion_ = 1, tool_ = 0, selected_ = 0, spindle_ = 5, plane_ = 0;
  struct HeldPath {
    AxisValues from{};
    ContourMove move;
    Corner corner;
    double chamfer_length_mm = 0;  ///< CHF's, from side to side
    long line = 0;
  };
  std::optional<HeldPath> held_;      ///< a corner stands behind it
  std::optional<Cycle> modal_cycle_;  ///< MCALL
  WorkFrame programmed_, swivelled_;
  bool swivels_ = false;
};

}  // namespace lightmill::detail

// Heidenhain (TNC) programs, conversational and DIN/ISO: one reader, its parts in sources of their own.
#pragma once

#include <map>
#include <optional>
#include <unordered_map>

#include "machine/detail/contour_corner.h"
#include "machine/detail/expressions.h"

namespace lightmill::detail {

class HeidenhainReader : private ExpressionReader {
 public:
  HeidenhainReader(std::string_view text, ReaderCore& core, bool iso);
  ReadResult run();

 private:
  // --- Blocks and what they say but motion: heidenhain_reader.cpp ---
  void check_frame();
  bool split(std::string_view line);
  [[nodiscard]] bool is(std::size_t i, std::string_view text) const {
    return i < tokens_.size() && tokens_[i].text == text;
  }
  void expect_end(std::size_t i) const {
    if (i < tokens_.size()) reject(tokens_[i].column, "'" + std::string(tokens_[i].text) + "' is not understood here");
  }
  [[noreturn]] void incomplete() const {
    reject(tokens_.empty() ? 1 : tokens_.back().column, "the block is not complete");
  }
  void read_block();
  void frame(bool begin);
  void tool();
  void define_tool();
  [[nodiscard]] double tool_length(int number, int column) const;
  void function();
  void preset(double n, int column);
  void renew_offset();
  void set_tcp(bool on);
  void refuse_beside_compensation(const char* what) const {
    if (path_.on()) reject(tokens_[0].column, std::string(what) + " while cutter compensation is on");
  }
  void modes(std::size_t i);
  std::size_t retract(std::size_t i);
  void finish();

  // --- Cycles: heidenhain_cycles.cpp ---
  struct Cycle {
    int number = 0;
    std::map<int, double> words;  ///< Q parameters
  };
  void cycle();
  void begin_cycle(int number, std::size_t words);
  void read_cycle_words(std::size_t i);
  void end_cycle();
  void datum_shift();
  void dwell();
  void tolerance(bool first);
  void call_cycle();

  // --- DIN/ISO in conversational words: heidenhain_iso_reader.cpp ---
  struct IsoWords;
  void add(std::string_view before, std::string_view text, int column);
  void read_added();
  void read_iso_block();
  void iso_frame(const std::vector<Token>& words);
  void iso_function(const std::vector<Token>& words);
  void sort_iso_word(IsoWords& w, const std::vector<Token>& words, std::size_t& i);
  void iso_cycles(const IsoWords& w, int column);
  void iso_path(const IsoWords& w, std::string_view step, int column);

  // --- Q parameters, labels, jumps: heidenhain_flow.cpp ---
  [[nodiscard]] int column() const override;
  bool operand(double& v, int depth) override;
  /// Sets the cursor on the block from this word on.
  void read_from(std::size_t token);
  /// A word's value: a number or a Q parameter, with a sign if need be.
  double number(std::string_view text, int column);
  int q_number();
  void formula();
  void fn();
  void fn_jump(int code);
  void jump_to(std::string_view label, int column);
  void label();
  void call();

  // --- Paths: heidenhain_motion.cpp ---
  struct Path {
    AxisValues words{};
    std::array<bool, 5> named{};
    bool rotary_absolute[2] = {false, false};
    bool axes = false;
    std::optional<double> radius;  ///< R of CR
    int sense = 0;                 ///< DR
    std::optional<double> polar_radius, polar_angle;
    bool radius_adds = false, angle_adds = false;
  };
  bool axis_word(const Token& token, AxisValues& to, const AxisValues& from, bool* absolute_rotary = nullptr);
  void circle_centre();
  void move(std::string_view kind);
  std::size_t read_path(Path& path, std::string_view kind, const AxisValues& from, std::size_t first = 1);
  double cutter_radius() const;
  void set_compensation();
  void straight(const AxisValues& to, bool axes);
  void polar_end(const Path& path, const AxisValues& from, AxisValues& to);
  void arc(std::string_view kind, const Path& path, const AxisValues& from, AxisValues to);
  void vector_move();

  // --- Corners, approach, departure: heidenhain_contour.cpp ---
  struct HeldPath {
    AxisValues from{};
    ContourMove move;
    Corner corner;
    double corner_feed = 0;
    long line = 0, corner_line = 0;
  };
  struct Transition {
    std::string_view kind;  ///< LT, LN, CT, LCT
    double length_mm = 0;   ///< LEN or R
    double angle_rad = 0;   ///< CCA
  };
  struct Approach {
    Transition way;
    AxisValues to{};  ///< the contour's first point
    int side = 0;
    double feed = 0, feed_before = 0;
    bool rapid_before = false;
    long line = 0;
  };
  struct TouchingArc {
    Vec2 centre;
    double radius_mm, centre_radius_mm;  ///< of the contour, and of the cutter's centre
    int sense;
  };
  struct Said {
    ProgramStep::Kind kind;
    int number;
    double value;
  };
  /// Where the program means to stand.
  [[nodiscard]] AxisValues place() const;
  [[nodiscard]] int active_side() const;
  [[nodiscard]] bool corner_follows() const;
  void corner();
  void follow(ContourMove next, const Feed& feed);
  std::optional<ContourMove> turn_corner(const ContourMove& next);
  void begin_approach();
  std::size_t read_transition(Path& path, Transition& way, const AxisValues& from);
  [[nodiscard]] TouchingArc touching_arc(const Transition& way, const Vec2& at, const Vec2& along, int side,
                                         double cutter_mm) const;
  [[nodiscard]] double touched_at(const TouchingArc& arc, const Vec2& outside, bool ahead) const;
  void approach(const ContourMove& first);
  void depart();
  void say(ProgramStep::Kind kind, int number, double value = 0);
  void say_waiting();
  void refuse_inside_contour() const;

  // --- Tilted planes: heidenhain_plane.cpp ---
  void plane();
  void turn_to_plane(std::string_view how, double distance_mm, double feed, const RotaryAngles& angles);

  ReaderCore& core_;
  CutterCompensation path_;
  std::vector<std::string_view> lines_;
  std::size_t at_ = 0, next_ = 0;
  std::vector<Token> tokens_;
  bool iso_;
  std::string translated_;  ///< what added_ views
  std::vector<Token> added_;
  int iso_motion_ = 1;
  bool iso_incremental_ = false;
  long number_ = 0;
  bool continued_ = false, begun_ = false, ended_ = false;
  std::string_view name_;
  std::unordered_map<std::string_view, std::size_t> labels_;
  std::unordered_map<std::size_t, long> repeats_;
  std::vector<std::size_t> calls_;
  std::unordered_map<int, double> q_;
  double unit_ = 1, feed_ = 0, rpm_ = 0;
  double block_seconds_ = 0;  ///< FT: of this block alone
  struct DefinedTool {
    double length_mm = 0, radius_mm = 0;
  };
  std::map<int, DefinedTool> defined_tools_;  ///< by TOOL DEF: they go before the table's
  int tool_ = 0, spindle_ = 5;
  double radius_delta_mm_ = 0;  ///< DR of TOOL CALL
  std::optional<Cycle> defining_, cycle_;
  bool shortest_ = false, fmax_ = false, machine_coordinates_ = false, tcp_off_ = false, has_centre_ = false;
  int side_ = 0, active_side_ = 0;  ///< as programmed, and as it was when compensation began: RL 1, RR -1
  bool fmax_before_ = false;        ///< the last straight line was at FMAX
  double heading_ = 0;              ///< of the path's end in the plane; CT goes on in it
  bool has_heading_ = false;
  std::optional<HeldPath> held_;      ///< a corner stands behind it
  std::optional<Approach> approach_;  ///< until the path that gives its direction
  std::vector<Said> said_;            ///< by a block whose path waits for one of them
  std::vector<int> ends_;
  AxisValues preset_{}, shift_{}, centre_{};
  Vec3 tilted_shift_ = Vec3::Zero();  ///< of cycle 7 in a tilted plane
  Eigen::Matrix3d plane_turn_ = Eigen::Matrix3d::Identity();
};

}  // namespace lightmill::detail

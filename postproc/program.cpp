#include "postproc/program.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <limits>
#include <utility>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "postproc/detail/arc_fit.h"
#include "postproc/detail/dialect.h"
#include "postproc/detail/trunnion.h"
#include "postproc/program_check.h"

namespace lightmill {
namespace {

using detail::Blocks;
using detail::Dialect;
using detail::Language;

constexpr std::size_t kLongestLine = 80;
constexpr int kFeedDigits = 5;  // significant, so that rounding down costs at most 1e-4 of the feed
// A feed that is a round number up to rounding of the last bits must not lose a digit by rounding down.
constexpr double kFeedSlack = 1e-9;
constexpr double kLeastFeed = 1e-4;
constexpr double kMostTime_s = 999.999;  // of an FT word
constexpr double kDegPerRad = 180 / kPi;
constexpr double kRoundingWorthSaying = 0.01;  // of a pass's time
constexpr double kBlankSlack_mm = 1e-6;        // a whole millimetre stays one, whatever its last bits
constexpr double kSameSpeed = 1e-6;  // of moves that one arc replaces
constexpr double kArcSlack = 1e-4;   // an arc longer by less keeps the plan's feed, so that F is not said again
constexpr int kXyPlane = 2;
constexpr std::array<std::string_view, 3> kPlaneWords{"G19", "G18", "G17"};  // by the axis across
constexpr std::array<std::string_view, 4> kMotionWords{"G0", "G1", "G2", "G3"};

// Text for comments: printable ASCII without what ends a comment or what a grbl controller takes as a real-time
// command.
std::string plain(const std::string& text) {
  std::string result;
  for (const unsigned char c : text) {
    if (c >= 0x80 && c < 0xC0) continue;  // the rest of a UTF-8 character
    const bool good = c >= ' ' && c < 0x7F && std::string_view("!?~%$").find(static_cast<char>(c)) == std::string_view::npos;
    result += c == '(' ? '[' : c == ')' ? ']' : c == ';' ? ',' : good ? static_cast<char>(c) : '_';
  }
  return result;
}

std::string upper(std::string text) {
  for (char& c : text) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  return text;
}

double rapid_seconds(const MachineModel& m, const JointPosition& a, const JointPosition& b) {
  double seconds =
      std::max({std::abs(b.x_mm - a.x_mm) / m.x.max_speed_mm_per_s, std::abs(b.y_mm - a.y_mm) / m.y.max_speed_mm_per_s,
                std::abs(b.z_mm - a.z_mm) / m.z.max_speed_mm_per_s});
  if (!m.has_rotary()) return seconds;
  return std::max({seconds, std::abs(b.outer_rad - a.outer_rad) / m.outer.max_speed_rad_per_s,
                   std::abs(b.inner_rad - a.inner_rad) / m.inner.max_speed_rad_per_s});
}

double total_seconds(const MachineModel& machine, const AxisMotion& motion) {
  double seconds = 0;
  for (std::size_t i = 1; i < motion.moves.size(); ++i) {
    const AxisMove& move = motion.moves[i];
    seconds +=
        move.kind == MoveKind::kRapid ? rapid_seconds(machine, motion.moves[i - 1].joints, move.joints) : move.seconds;
  }
  return seconds;
}

bool turns_in_cut(const AxisMotion& motion) {
  return std::any_of(motion.moves.begin(), motion.moves.end(),
                     [](const AxisMove& move) { return move.rotary_moves && move.kind != MoveKind::kRapid; });
}

bool is_ball(const Cutter& cutter) {
  return std::abs(cutter.corner_radius_mm - cutter.diameter_mm / 2) < 1e-9;
}

std::string program_stem(const std::string& pass) {
  const std::array<std::pair<std::string_view, std::string_view>, 4> known{
      {{"rough", "10"}, {"semi_finish", "20"}, {"finish", "30"}, {"rest", "35"}}};
  for (const auto& [name, number] : known) {
    if (pass == name) return std::string(number) + "_" + pass;
  }
  std::string safe;
  for (const unsigned char c : pass) safe += c < 0x80 && std::isalnum(c) != 0 ? static_cast<char>(c) : '_';
  return "40_" + safe;
}

// The program's name at the control.
std::string control_name(const Dialect& dialect, const std::string& stem) {
  return std::string(dialect.name_prefix) + (dialect.upper_case && !dialect.program_number ? upper(stem) : stem);
}

// An FT word's time: never shorter.
double whole_milliseconds(double seconds) {
  return std::max(std::ceil(seconds * 1000 * (1 - kFeedSlack)), 1.0) / 1000;
}

class ProgramWriter {
 public:
  ProgramWriter(const MachineModel& machine, const WorkSetup& setup, std::span<const AxisMotion> passes,
                const ProgramOptions& options)
      : machine_(machine),
        setup_(setup),
        passes_(passes),
        options_(options),
        dialect_(detail::dialect_of(machine.controller)),
        unit_(std::pow(10.0, options.decimals)),
        letters_{'X', 'Y', 'Z', machine.outer.letter, machine.inner.letter} {
    std::size_t moves = 0;
    for (const AxisMotion& pass : passes) moves += pass.moves.size();
    text_.reserve(4096 + moves * 40);
    stem_ = passes.size() == 1 ? program_stem(passes.front().pass) : "00_whole";
    if (options.parts > 0) {
      const std::string of = std::to_string(options.parts);
      std::string part = std::to_string(options.part);
      part.insert(0, of.size() - std::min(of.size(), part.size()), '0');  // so that names sort as parts run
      stem_ += "_" + part + "of" + of;
    }
    sheet_.name = control_name(dialect_, stem_);
    sheet_.number = {options.decimals, dialect_.decimal_point, dialect_.plus_sign};
    sheet_.work_offset = setup.work_offset;
    sheet_.has_tcp = machine.has_tcp;
    sheet_.endless_inner = machine.has_rotary() && std::isinf(machine.inner.max_rad);
    sheet_.smoothing_mm = options.smoothing_mm;
    sheet_.smoothing_deg = options.smoothing_deg;
    sheet_.arcs = options.arc_tolerance_mm > 0;
  }

  Program write() {
    header();
    for (const AxisMotion& pass : passes_) {
      if (&pass != &passes_.front()) count_pass();
      begin_pass(pass);
      for (std::size_t i = 0; i < pass.moves.size();) {
        if (options_.arc_tolerance_mm > 0) {
          const std::size_t end = end_of_stretch(i);
          if (end > i) {
            cut_with_arcs(i, end);
            i = end;
            continue;
          }
        }
        write_move(pass.moves[i++]);
      }
      end_pass();
    }
    mode_ = -1;  // said again, for whoever looks at the end only
    Position home = at_;
    home[kOuter] = home[kInner] = 0;
    rapid_block(home, kOuter, kInner);
    if (machine_.park_mm) {
      block(dialect_.machine_move("X" + sheet_.number(machine_.park_mm->x()) + " Y" +
                                  sheet_.number(machine_.park_mm->y())));
    }
    all(dialect_.length_off(sheet_));
    all(dialect_.closing(sheet_));
    text_ += dialect_.last_lines(sheet_);
    if (dialect_.percent) text_ += "%\n";
    count_pass();
    program_.file_name = control_name(dialect_, stem_) + std::string(dialect_.extension);
    program_.text = std::move(text_);
    for (const AxisMotion& pass : passes_) program_.passes.push_back(pass.pass);
    return std::move(program_);
  }

 private:
  // The five axis words, in units of the last decimal, as the controller sees them.
  enum Word { kX, kY, kZ, kOuter, kInner, kWords };
  using Position = std::array<long long, kWords>;
  static constexpr long long kUnknown = std::numeric_limits<long long>::min();
  static constexpr long long kTop = std::numeric_limits<long long>::max() - 1;  // a Z that no word can have

  // The point that the program's X, Y, Z guide, in the frame they are given in.
  [[nodiscard]] Vec3 point(const JointPosition& joints) const {
    const double length = sheet_.length_mm + sheet_.delta_mm;
    if (tcp_on_) return detail::tip_at(machine_, setup_, length, joints);
    return Vec3(joints.x_mm, joints.y_mm, joints.z_mm - length) - setup_.origin_mm;
  }

  [[nodiscard]] Position words(const JointPosition& joints, const Vec3& at) const {
    const auto units = [this](double value) { return std::llround(value * unit_); };
    return {units(at.x()), units(at.y()), units(at.z()), units(joints.outer_rad * kDegPerRad),
            units(joints.inner_rad * kDegPerRad)};
  }

  // All text since the pass before belongs to this one.
  void count_pass() {
    figures_.bytes = text_.size() - program_.bytes;
    program_ += figures_;
    program_.by_pass.push_back(std::exchange(figures_, {}));
  }

  // Text --------------------------------------------------------------------------------------------------------------

  void begin_block() {
    switch (dialect_.language) {
      case Language::kConversational:
        integer(number_++);
        text_ += ' ';
        break;
      case Language::kHeidenhainIso:
        text_ += 'N';
        integer(++number_);
        text_ += ' ';
        break;
      default:
        if (options_.block_numbers) {
          text_ += 'N';
          integer(++number_);
          text_ += ' ';
        }
    }
    fresh_ = true;
  }

  void end_block() {
    if (dialect_.language == Language::kHeidenhainIso) text_ += " *";
    text_ += dialect_.line_end;
    ++figures_.blocks;
  }

  void block(const std::string& words) {
    begin_block();
    text_ += words;
    end_block();
  }

  void all(const Blocks& blocks) {
    for (const std::string& words : blocks) block(words);
  }

  void comment(const std::string& sentence) {
    const bool numbered =
        dialect_.language == Language::kConversational || dialect_.language == Language::kHeidenhainIso;
    const std::string clean = dialect_.upper_case ? upper(plain(sentence)) : plain(sentence);
    const std::size_t room = kLongestLine - 2 - (numbered ? 6 : 0);
    for (std::size_t begin = 0; begin < clean.size();) {
      std::size_t end = std::min(clean.size(), begin + room);
      if (end < clean.size()) {
        const std::size_t space = clean.rfind(' ', end);
        if (space != std::string::npos && space > begin) end = space;
      }
      if (numbered) begin_block();
      text_ += dialect_.comment(clean.substr(begin, end - begin));
      text_ += dialect_.line_end;
      begin = end < clean.size() && clean[end] == ' ' ? end + 1 : end;
    }
  }

  void integer(unsigned long long value) {
    char digits[24];
    text_.append(digits, std::to_chars(digits, digits + sizeof digits, value).ptr);
  }

  void space() {
    if (!fresh_) text_ += ' ';
    fresh_ = false;
  }

  void number(long long units) {
    char digits[32];
    if (units < 0) {
      text_ += '-';
    } else if (dialect_.plus_sign) {
      text_ += '+';
    }
    const unsigned long long magnitude = units < 0 ? 0ULL - static_cast<unsigned long long>(units) : units;
    const auto end = std::to_chars(digits, digits + sizeof digits, magnitude).ptr;
    const int count = static_cast<int>(end - digits);
    int last = count;  // trailing zeros behind the point are dropped
    while (last > std::max(count - options_.decimals, 0) && digits[last - 1] == '0') --last;
    const int whole = count - options_.decimals;
    if (whole > 0) {
      text_.append(digits, whole);
    } else {
      text_ += '0';
    }
    if (last > std::max(whole, 0)) {
      text_ += '.';
      text_.append(static_cast<std::size_t>(std::max(-whole, 0)), '0');
      text_.append(digits + std::max(whole, 0), digits + last);
    } else if (dialect_.decimal_point) {
      text_ += '.';
    }
  }

  void axis_word(int w, long long units) {
    const bool within_turn = w == kInner && dialect_.modulo_rotary && sheet_.endless_inner;
    if (!within_turn && static_cast<double>(std::llabs(units)) >= std::pow(10.0, dialect_.whole_digits) * unit_) {
      throw InputError(pass_->pass + ": " + letters_[w] + " would be written as " +
                       compact(static_cast<double>(units) / unit_, 4) + ", and " + std::string(dialect_.name) +
                       " takes " + std::to_string(dialect_.whole_digits) +
                       " digits before the point; give the axis limits in the machine file, so that it unwinds");
    }
    space();
    text_ += letters_[w];
    if (within_turn) {
      const long long turn = std::llround(360 * unit_);
      text_ += "=DC(";
      number(((units % turn) + turn) % turn);
      text_ += ')';
    } else {
      number(units);
    }
    at_[w] = units;
  }

  // The words that differ from where the controller stands; `first` .. `last` only.
  void axis_words(const Position& to, int first, int last) {
    for (int w = first; w <= last; ++w) {
      if (to[w] != at_[w]) axis_word(w, to[w]);
    }
  }

  [[nodiscard]] bool same(const Position& to, int first, int last) const {
    return std::equal(to.begin() + first, to.begin() + last + 1, at_.begin() + first);
  }

  // G0 to G3 where they change; a TNC says L in every block.
  void mode(int g) {
    if (dialect_.language == Language::kConversational) {
      space();
      text_ += 'L';
      return;
    }
    if (mode_ == g) return;
    space();
    text_ += dialect_.language == Language::kHeidenhainIso ? (g == 0 ? "G00" : "G01") : kMotionWords[g];
    mode_ = g;
  }

  // `value` rounded down to kFeedDigits significant digits and the control's decimals.
  [[nodiscard]] std::string feed_text(double value) const {
    if (!(value >= kLeastFeed && std::isfinite(value))) {
      throw NumericalError("a feed word of " + std::to_string(value) + " cannot be written");
    }
    const int exponent = static_cast<int>(std::floor(std::log10(value)));
    const int decimals = std::min(kFeedDigits - 1 - exponent, dialect_.feed_decimals);
    const double scale = std::pow(10.0, decimals);
    const double rounded = std::floor(value * scale * (1 + kFeedSlack)) / scale;
    if (!(rounded > 0)) throw NumericalError("a feed word of " + std::to_string(value) + " rounds to nothing");
    std::string text = compact(rounded, std::max(decimals, 0));
    if (dialect_.decimal_point && text.find('.') == std::string::npos) text += '.';
    return text;
  }

  // Parts -------------------------------------------------------------------------------------------------------------

  void header() {
    if (dialect_.percent) text_ += "%\n";
    if (dialect_.program_number) {
      // O0030; its parts O3001, O3002...
      const std::string part = std::to_string(options_.part);
      text_ += options_.parts == 0 ? "O00" + stem_.substr(0, 2) : "O" + stem_.substr(0, 2) + (part.size() < 2 ? "0" : "") + part;
      text_ += '\n';
    }
    measure_blank();
    text_ += dialect_.first_lines(sheet_);
    const Blocks opening = dialect_.opening(sheet_);
    all(opening);

    const Vec3& zero = setup_.origin_mm;
    const std::string offset = "G" + std::to_string(setup_.work_offset);
    const std::string letters = !machine_.has_rotary()
                                    ? "no rotary axis"
                                    : std::string(1, machine_.outer.letter) + "0 " + machine_.inner.letter + "0";
    double minutes = 0;
    for (const AxisMotion& pass : passes_) {
      minutes += (total_seconds(machine_, pass) + rounding_seconds(pass) + dwell_s()) / 60;
    }
    comment("LIGHTMILL " LIGHTMILL_VERSION " " + control_name(dialect_, stem_) + std::string(dialect_.extension));
    if (!options_.job_name.empty()) comment("JOB " + options_.job_name);
    if (!options_.job_hash.empty()) comment("HASH OF THE JOB " + options_.job_hash);
    if (options_.parts > 0) {
      comment("PART " + std::to_string(options_.part) + " OF " + std::to_string(options_.parts) + ", starts by itself");
    }
    for (const AxisMotion& pass : passes_) {
      comment("MAKES the " + pass.pass + " pass of a lens, " + std::to_string(pass.moves.size()) + " moves, " +
              (turns_in_cut(pass) ? "5 axes at once" : "rotary axes fixed"));
    }
    for (const AxisMotion& pass : passes_) {
      if (pass.rewinds > 0) {
        comment("REWINDS " + std::to_string(pass.rewinds) + " times in the cut of " + pass.pass +
                ": a rotary axis is at its limit, the tool leaves the part and comes back");
      }
    }
    comment("TIME ABOUT " + fixed(minutes, 1) + " MIN, accelerations not counted");
    for (const AxisMotion& pass : passes_) {
      if (const double lost = rounding_seconds(pass); lost > kRoundingWorthSaying * total_seconds(machine_, pass)) {
        comment("SLOWER BY " + fixed(lost, 1) + " S in " + pass.pass +
                ": times of blocks are whole milliseconds; M128 has no such loss");
      }
    }
    for (const AxisMotion& pass : passes_) tool_comments(pass);
    comment("ZERO " + (dialect_.tcp_ball_centre ? "DATUM " + std::to_string(setup_.work_offset - 53) : offset) +
            " = WORKPIECE ORIGIN WITH " + letters + ": the centre of the blank's back");
    comment("ZERO IN MACHINE COORDINATES X" + fixed(zero.x(), 3) + " Y" + fixed(zero.y(), 3) + " Z" +
            fixed(zero.z(), 3));
    comment("MACHINE " + machine_.name);
    if (!machine_.notes.empty()) comment("MACHINE " + machine_.notes);
    bool guided = false, unguided = false;
    for (const AxisMotion& pass : passes_) (uses_tcp(machine_, pass, options_) ? guided : unguided) = true;
    if (guided) {
      comment(dialect_.tcp_ball_centre ? "TOOL CENTRE CONTROL M128: X Y Z are the ball's centre in the workpiece "
                                         "frame, the tool table keeps the "
                                         "length to the tip, DL in the tool call takes it to the centre"
                                       : "TOOL CENTRE CONTROL: X Y Z are the tip in the workpiece frame");
    }
    if (unguided) {
      comment(
          "NO TOOL CENTRE CONTROL: the program holds axis positions and fits this machine, this zero and this tool "
          "length only");
    }
    for (const AxisMotion& pass : passes_) {
      if (const char* air = air_word(pass)) {
        comment(std::string(air) + (std::string_view(air) == "M7" ? " = AIR ON THE MIST OUTPUT" : " = COOLANT"));
        break;
      }
    }
    all(dialect_.safe_modes(sheet_));
  }

  void tool_comments(const AxisMotion& pass) {
    const Cutter& cutter = pass.cutter;
    comment("TOOL T" + std::to_string(cutter.number) + " " + cutter.name);
    comment("TOOL DIAMETER " + compact(cutter.diameter_mm, 3) + " CORNER RADIUS " +
            compact(cutter.corner_radius_mm, 3) +
            (cutter.taper_rad > 0 ? " TAPER " + compact(cutter.taper_rad * 180 / kPi, 3) + " DEG" : "") + " STICK-OUT " +
            compact(cutter.reach_mm(), 3) + " MM");
    comment("TOOL LENGTH " + fixed(cutter.length_mm, 3) + " MM FROM SPINDLE NOSE TO TIP");
    comment("TOOL " + pass.pass + " AT " + compact(pass.spindle_rpm, 0) +
            " RPM, cutting data: " + (cutter.source.empty() ? "untested" : cutter.source));
  }

  // A box around what is cut, from the blank's back up, for the control's graphics.
  void measure_blank() {
    if (dialect_.language != Language::kConversational && dialect_.language != Language::kHeidenhainIso) return;
    Vec3 low(0, 0, 0), high(1, 1, 1);
    for (const AxisMotion& pass : passes_) {
      for (const AxisMove& move : pass.moves) {
        if (move.kind != MoveKind::kCut) continue;
        const Vec3 tip = detail::tip_at(machine_, setup_, pass.cutter.length_mm, move.joints);
        low = low.cwiseMin(tip - Vec3(1, 1, 0));
        high = high.cwiseMax(tip + Vec3(1, 1, 1));
      }
    }
    sheet_.blank_min_mm = (low.array() + kBlankSlack_mm).floor();
    sheet_.blank_max_mm = (high.array() - kBlankSlack_mm).ceil();
  }

  void begin_pass(const AxisMotion& pass) {
    pass_ = &pass;
    const Cutter& cutter = pass.cutter;
    sheet_.tool = cutter.number;
    sheet_.rpm = pass.spindle_rpm;
    sheet_.dwell_s = dwell_s();
    sheet_.length_mm = cutter.length_mm;
    sheet_.tcp = uses_tcp(machine_, pass, options_);
    sheet_.delta_mm = sheet_.tcp && dialect_.tcp_ball_centre ? -cutter.radius_mm() : 0;
    sheet_.turning = turns_in_cut(pass);
    timed_ = sheet_.turning && (!sheet_.tcp || dialect_.tcp_inverse_time);
    first_descent_ = true;
    feed_.clear();

    const std::string top = dialect_.machine_move(top_words());
    if (&pass == &passes_.front()) block(top);
    const Vec3& change = machine_.tool_change_mm;
    block(dialect_.machine_move("X" + sheet_.number(change.x()) + " Y" + sheet_.number(change.y())));
    if (change.z() != machine_.retract_z_mm) block(dialect_.machine_move("Z" + sheet_.number(change.z())));
    all(dialect_.tool_change(sheet_));
    all(dialect_.spindle_on(sheet_));
    if (const char* air = air_word(pass)) block(air);
    // The operator may have jogged at the tool change: up again, whatever Z is, before anything turns.
    block(top);
    all(dialect_.before_cut(sheet_));
    mode_ = 0;
    at_.fill(kUnknown);
    at_[kZ] = kTop;
    if (!machine_.has_rotary()) at_[kOuter] = at_[kInner] = 0;
    if (timed_ && dialect_.language != Language::kConversational) block("G93");
  }

  void end_pass() {
    leave_arc_plane();
    if (tcp_on_) leave_tcp();
    if (timed_ && dialect_.language != Language::kConversational) block("G94");
    all(dialect_.after_cut(sheet_));
    all(dialect_.coolant_off_spindle_off(air_word(*pass_) != nullptr));
    block(dialect_.machine_move(top_words()));
  }

  void leave_arc_plane() {
    if (plane_ != kXyPlane) block("G17");
    plane_ = kXyPlane;
  }

  void leave_tcp() {
    all(dialect_.tcp_off(sheet_));
    tcp_on_ = false;
    at_[kX] = at_[kY] = at_[kZ] = kUnknown;
  }

  // What stands between the machine's top and the first move below it; words that go in front of that move's own.
  Blocks leave_top() {
    leave_arc_plane();  // the tool's length belongs to G17
    Blocks blocks = dialect_.descend(sheet_, first_descent_);
    first_descent_ = false;
    if (sheet_.tcp) {
      tcp_on_ = true;
      at_[kX] = at_[kY] = at_[kZ] = kUnknown;
    }
    if (dialect_.length_with_descent) return blocks;
    all(blocks);
    return {};
  }

  // A rapid at the machine's top goes there by machine coordinates, turns the table, then goes across.
  void rapid(const AxisMove& move) {
    const bool top = move.joints.z_mm == machine_.retract_z_mm;
    if (move.rotary_moves && !top) throw NumericalError("a rapid turns the table below the machine's top");
    if (top) {
      if (tcp_on_) leave_tcp();
      if (at_[kZ] != kTop) {
        block(dialect_.machine_move(top_words()));
        at_[kZ] = kTop;
        mode_ = 0;
      }
      Position to = words(move.joints, point(move.joints));
      to[kZ] = kTop;
      rapid_block(to, kOuter, kInner);
      rapid_block(to, kX, kY);
      return;
    }
    const Blocks front = at_[kZ] == kTop ? leave_top() : Blocks{};
    rapid_block(words(move.joints, point(move.joints)), kX, kZ, front);
  }

  void rapid_block(const Position& to, int first, int last, const Blocks& front = {}) {
    if (same(to, first, last)) return;
    begin_block();
    mode(0);
    for (const std::string& words : front) {
      space();
      text_ += words;
    }
    axis_words(to, first, last);
    if (dialect_.language == Language::kConversational) text_ += " FMAX";
    end_block();
  }

  void write_move(const AxisMove& move) {
    if (move.kind == MoveKind::kRapid) {
      rapid(move);
    } else {
      feed(move);
    }
    from_ = move.joints;
  }

  void feed(const AxisMove& move) {
    if (at_[kZ] == kTop) throw NumericalError("a cut begins at the machine's top");
    const Vec3 at = point(move.joints);
    const Position to = words(move.joints, at);
    // What rounds to nothing is left out and loses nothing: the next block's end is absolute.
    if (same(to, kX, kInner)) return;
    double way_mm = (at - point(from_)).norm();
    const double turn_deg =
        std::hypot(move.joints.outer_rad - from_.outer_rad, move.joints.inner_rad - from_.inner_rad) * kDegPerRad;
    const bool turned = !same(to, kOuter, kInner);
    if (turned && dialect_.least_linear_mm > 0) {
      double written_mm = 0;
      for (const int w : {kX, kY, kZ}) written_mm = std::hypot(written_mm, static_cast<double>(to[w] - at_[w]) / unit_);
      if (written_mm < dialect_.least_linear_mm) {
        // Turn and way apart: the turn takes the whole time.
        feed_block(to, kOuter, kInner, turn_deg, move.seconds);
        way_mm = std::max(written_mm, way_mm);
        if (same(to, kX, kZ)) return;
      }
    }
    feed_block(to, kX, kInner, way_mm, move.seconds);
  }

  void feed_block(const Position& to, int first, int last, double way, double seconds) {
    begin_block();
    mode(1);
    axis_words(to, first, last);
    end_feed_block(way, seconds);
  }

  void end_feed_block(double way, double seconds) {
    figures_.feed_seconds.push_back(seconds);
    if (timed_ && dialect_.language == Language::kConversational) {
      const double written_s = whole_milliseconds(seconds);
      if (!(written_s <= kMostTime_s))
        throw InputError(pass_->pass + ": a move takes longer than 999.999 s, the control's longest FT");
      figures_.rounding_s += written_s - seconds;
      figures_.worst_rounding = std::max(figures_.worst_rounding, written_s / seconds);
      text_ += " FT" + compact(written_s, 3);
    } else {
      std::string word = feed_text(timed_ ? 60 / seconds : 60 * way / seconds);
      if (timed_ || word != feed_) {
        text_ += " F";
        text_ += word;
        feed_ = std::move(word);
      }
    }
    end_block();
  }

  // Arcs --------------------------------------------------------------------------------------------------------------

  [[nodiscard]] double slowest_axis() const {
    return std::min({machine_.x.max_speed_mm_per_s, machine_.y.max_speed_mm_per_s, machine_.z.max_speed_mm_per_s});
  }

  // The end of the moves from `begin` on that arcs may replace: straight cuts at one speed that every axis can go, rotary
  // axes standing.
  [[nodiscard]] std::size_t end_of_stretch(std::size_t begin) const {
    double speed = 0;
    JointPosition from = from_;
    std::size_t end = begin;
    for (; end < pass_->moves.size(); ++end) {
      const AxisMove& move = pass_->moves[end];
      if (move.kind != MoveKind::kCut || move.rotary_moves) break;
      const double now = (point(move.joints) - point(from)).norm() / move.seconds;
      if (end == begin) speed = now;
      if (!(now <= slowest_axis() && std::abs(now - speed) <= kSameSpeed * speed)) break;
      from = move.joints;
    }
    return end;
  }

  void cut_with_arcs(std::size_t begin, std::size_t end) {
    std::vector<Vec3> points{point(from_)};
    for (std::size_t i = begin; i < end; ++i) points.push_back(point(pass_->moves[i].joints));
    for (std::size_t i = begin; i < end;) {
      const auto run =
          detail::longest_arc(std::span(points).subspan(i - begin), options_.arc_tolerance_mm, 1 / unit_);
      double way = 0, seconds = 0;
      for (std::size_t k = i; run && k < i + run->moves; ++k) {
        way += (points[k - begin + 1] - points[k - begin]).norm();
        seconds += pass_->moves[k].seconds;
      }
      if (run && run->length_mm <= slowest_axis() * seconds) {
        if (!(run->length_mm >= way && run->length_mm <= way * (1 + kArcSlack))) way = run->length_mm;
        i += run->moves;
        arc(*run, points[i - begin], pass_->moves[i - 1].joints, way, seconds);
      } else {
        write_move(pass_->moves[i++]);
      }
    }
  }

  void arc(const detail::ArcRun& run, const Vec3& end, const JointPosition& joints, double way, double seconds) {
    const Position from = at_, to = words(joints, end);
    begin_block();
    if (run.arc.normal != plane_) {
      space();
      text_ += kPlaneWords[run.arc.normal];
      plane_ = run.arc.normal;
    }
    mode(run.arc.clockwise ? 2 : 3);
    for (int w = kX; w <= kZ; ++w) {
      if (w != run.arc.normal || to[w] != at_[w]) axis_word(w, to[w]);
    }
    for (int w = kX; w <= kZ; ++w) {
      if (w == run.arc.normal) continue;
      space();
      text_ += static_cast<char>('I' + w);
      number(std::llround(run.arc.centre_mm[w] * unit_) - from[w]);
    }
    end_feed_block(way, seconds);
    ++figures_.arcs;
    figures_.max_arc_error_mm = std::max(figures_.max_arc_error_mm, run.error_mm);
    from_ = joints;
  }

  // Facts -------------------------------------------------------------------------------------------------------------

  // What whole milliseconds add to the planned times.
  [[nodiscard]] double rounding_seconds(const AxisMotion& pass) const {
    if (dialect_.language != Language::kConversational || !turns_in_cut(pass) || uses_tcp(machine_, pass, options_))
      return 0;
    double seconds = 0;
    for (const AxisMove& move : pass.moves) {
      if (move.kind != MoveKind::kRapid) seconds += whole_milliseconds(move.seconds) - move.seconds;
    }
    return seconds;
  }
  [[nodiscard]] double dwell_s() const { return std::max(options_.warm_up_s, machine_.spindle_start_s); }
  [[nodiscard]] std::string top_words() const { return "Z" + sheet_.number(machine_.retract_z_mm); }
  // M7 is the mist output, where a shop's air blast or mist unit hangs; M8 is flood.
  [[nodiscard]] static const char* air_word(const AxisMotion& pass) {
    const std::string& coolant = pass.cutter.coolant;
    return coolant == "air" || coolant == "mist" ? "M7" : coolant == "flood" ? "M8" : nullptr;
  }

  const MachineModel& machine_;
  const WorkSetup& setup_;
  std::span<const AxisMotion> passes_;
  const ProgramOptions& options_;
  const Dialect& dialect_;
  double unit_;
  std::array<char, kWords> letters_;
  detail::Sheet sheet_;
  std::string stem_;
  const AxisMotion* pass_ = nullptr;
  std::string text_;
  Program program_;
  ProgramFigures figures_;         // of the pass so far
  unsigned long long number_ = 0;  // of the next (conversational) or last block
  bool fresh_ = true;              // no word in this block yet
  bool timed_ = false;             // every block of the cut carries its time
  bool tcp_on_ = false;
  bool first_descent_ = true;
  Position at_{};
  JointPosition from_;  // the move before
  int mode_ = -1;
  int plane_ = kXyPlane;
  std::string feed_;
};

void check_input(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion) {
  if (setup.work_offset < 54 || setup.work_offset > 59) {
    throw InputError("work offset G" + std::to_string(setup.work_offset) + " does not exist: use 54 to 59");
  }
  if (!(motion.spindle_rpm >= machine.min_spindle_rpm && motion.spindle_rpm <= machine.max_spindle_rpm)) {
    throw InputError(motion.pass + ": spindle speed " + compact(motion.spindle_rpm, 1) + " rpm is outside " +
                     machine.name + "'s " + compact(machine.min_spindle_rpm, 1) + " to " +
                     compact(machine.max_spindle_rpm, 1) + " rpm; change the cutter's spindle_rpm");
  }
  if (motion.cutter.number < 1) {
    throw InputError(motion.pass + ": cutter '" + motion.cutter.name + "' needs a number of at least 1 for its T word");
  }
}

}  // namespace

void check_program_options(const MachineModel& machine, const ProgramOptions& options) {
  const Dialect& dialect = detail::dialect_of(machine.controller);
  if (options.decimals < 3 || options.decimals > dialect.most_decimals) {
    throw InputError("decimals = " + std::to_string(options.decimals) + ": must be from 3 to " +
                     std::to_string(dialect.most_decimals) + " for " + machine.controller);
  }
  if (options.arc_tolerance_mm > 0 && !dialect.arcs) {
    throw InputError("arcs are asked for ([controller] arcs), but " + machine.controller +
                     " programs have straight moves only: another plane would turn its tool length; use \"grblhal\", "
                     "\"linuxcnc\" or \"fanuc\"");
  }
  if (!options.tcp) return;
  if (!machine.has_rotary()) {
    throw InputError("tool-centre-point control is asked for, but " + machine.name +
                     " has no rotary axes that it could follow; leave it out ([controller] tcp = \"off\")");
  }
  if (!dialect.tcp || !machine.has_tcp) {
    throw InputError("tool-centre-point control is asked for, but the machine file of " + machine.name +
                     " does not say that its " + machine.controller + " control has it ([controller] tcp = true); the post's own kinematics " +
                     "do without ([controller] tcp = \"off\")");
  }
}

std::string program_file_name(const std::string& pass, const std::string& controller) {
  const Dialect& dialect = detail::dialect_of(controller);
  return control_name(dialect, program_stem(pass)) + std::string(dialect.extension);
}

bool uses_tcp(const MachineModel& machine, const AxisMotion& motion, const ProgramOptions& options) {
  const Dialect& dialect = detail::dialect_of(machine.controller);
  const bool turning = turns_in_cut(motion);
  if (!options.tcp || !machine.has_rotary()) {
    if (turning && motion.tcp) {
      throw InputError(motion.pass + ": the motion was cut for tool-centre-point control and can only be written with it");
    }
    if (turning && !dialect.inverse_time) {
      throw InputError(motion.pass + ": rotary axes move in the cut, and " + machine.controller +
                       " has no word for a block's time; use tool-centre-point control ([controller] tcp = \"on\") or "
                       "dialect = \"heidenhain\"");
    }
    return false;
  }
  if (!dialect.tcp_ball_centre || is_ball(motion.cutter)) return true;
  if (turning) {
    throw InputError(motion.pass + ": M128 takes ball cutters only, '" + motion.cutter.name +
                     "' is none; use axis = \"fixed\" or \"vertical\" for this pass");
  }
  return false;
}

ProgramFigures& ProgramFigures::operator+=(const ProgramFigures& other) {
  blocks += other.blocks;
  bytes += other.bytes;
  feed_seconds.insert(feed_seconds.end(), other.feed_seconds.begin(), other.feed_seconds.end());
  arcs += other.arcs;
  rounding_s += other.rounding_s;
  worst_rounding = std::max(worst_rounding, other.worst_rounding);
  max_arc_error_mm = std::max(max_arc_error_mm, other.max_arc_error_mm);
  return *this;
}

Program write_program(const MachineModel& machine, const WorkSetup& setup, std::span<const AxisMotion> passes,
                      const ProgramOptions& options) {
  if (passes.empty()) throw InputError("no pass to write a program for");
  check_program_options(machine, options);
  for (const AxisMotion& pass : passes) check_input(machine, setup, pass);
  Program program = ProgramWriter(machine, setup, passes, options).write();
  const std::vector<std::string> faults = check_program_text(machine, setup, passes, program.text, options);
  if (!faults.empty()) {
    throw NumericalError(program.file_name + " breaks a safety rule (" + std::to_string(faults.size()) +
                         " in all): " + faults.front());
  }
  return program;
}

Program write_program(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                      const ProgramOptions& options) {
  return write_program(machine, setup, std::span(&motion, 1), options);
}

std::vector<DialectFacts> dialects() {
  std::vector<DialectFacts> facts;
  for (const Dialect* d : detail::all_dialects()) {
    facts.push_back({std::string(d->name), std::string(d->title), std::string(d->extension), d->most_decimals, d->tcp});
  }
  return facts;
}

}  // namespace lightmill

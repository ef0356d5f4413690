#include "postproc/program.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <limits>

#include "design/core/errors.h"
#include "design/core/text.h"
#include "postproc/detail/dialect.h"
#include "postproc/program_check.h"

namespace lightmill {
namespace {

constexpr std::size_t kLongestLine = 80;
constexpr int kFeedDigits = 5;  // significant, so that rounding down costs at most 1e-4 of the feed
// A feed that is a round number up to rounding of the last bits must not lose a digit by rounding down.
constexpr double kFeedSlack = 1e-9;
constexpr double kLeastFeed = 1e-4;

// Text for comments: printable ASCII without what ends a comment or what a grbl controller takes as a real-time
// command.
std::string plain(const std::string& text) {
  std::string result;
  for (const unsigned char c : text) {
    if (c >= 0x80 && c < 0xC0) continue;  // the rest of a UTF-8 character
    const bool good =
        c >= ' ' && c < 0x7F && std::string_view("()!?~%$;").find(static_cast<char>(c)) == std::string_view::npos;
    result += good ? static_cast<char>(c) : '_';
  }
  return result;
}

double rapid_seconds(const MachineModel& m, const JointPosition& a, const JointPosition& b) {
  return std::max({std::abs(b.x_mm - a.x_mm) / m.x.max_speed_mm_per_s,
                   std::abs(b.y_mm - a.y_mm) / m.y.max_speed_mm_per_s,
                   std::abs(b.z_mm - a.z_mm) / m.z.max_speed_mm_per_s,
                   std::abs(b.outer_rad - a.outer_rad) / m.outer.max_speed_rad_per_s,
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

// `value` rounded down to kFeedDigits significant digits.
std::string feed_text(double value) {
  if (!(value >= kLeastFeed && std::isfinite(value))) {
    throw NumericalError("a feed word of " + std::to_string(value) + " cannot be written");
  }
  const int exponent = static_cast<int>(std::floor(std::log10(value)));
  const int decimals = kFeedDigits - 1 - exponent;
  const double scale = std::pow(10.0, decimals);
  return compact(std::floor(value * scale * (1 + kFeedSlack)) / scale, std::max(decimals, 0));
}

class ProgramWriter {
 public:
  ProgramWriter(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                const ProgramOptions& options)
      : machine_(machine), setup_(setup), motion_(motion), options_(options), dialect_(detail::dialect_of(machine.controller)), unit_(std::pow(10.0, options.decimals)) {}

  Program write() {
    text_.reserve(4096 + motion_.moves.size() * 36);
    header();
    for (const AxisMove& move : motion_.moves) {
      if (move.kind == MoveKind::kRapid) {
        rapid(move);
      } else {
        feed(move);
      }
      from_ = move.joints;
    }
    footer();
    return {file_name(), std::move(text_), blocks_};
  }

 private:
  // The five axis words, in units of the last decimal, as the controller sees them.
  enum Word { kX, kY, kZ, kOuter, kInner, kWords };
  using Position = std::array<long long, kWords>;
  static constexpr long long kUnknown = std::numeric_limits<long long>::min();

  [[nodiscard]] Position words(const JointPosition& joints) const {
    const auto units = [this](double value) { return std::llround(value * unit_); };
    constexpr double deg = 180 / kPi;
    return {units(joints.x_mm - setup_.origin_mm.x()), units(joints.y_mm - setup_.origin_mm.y()),
            units(joints.z_mm - motion_.cutter.length_mm - setup_.origin_mm.z()), units(joints.outer_rad * deg),
            units(joints.inner_rad * deg)};
  }

  // Text --------------------------------------------------------------------------------------------------------------

  void comment(const std::string& sentence) {
    std::string clean = plain(sentence);
    if (dialect_.upper_case) {
      for (char& c : clean) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
    }
    constexpr std::size_t room = kLongestLine - 2;
    for (std::size_t begin = 0; begin < clean.size();) {
      std::size_t end = std::min(clean.size(), begin + room);
      if (end < clean.size()) {
        const std::size_t space = clean.rfind(' ', end);
        if (space != std::string::npos && space > begin) end = space;
      }
      text_ += "(" + clean.substr(begin, end - begin) + ")\n";
      begin = end < clean.size() && clean[end] == ' ' ? end + 1 : end;
    }
  }

  // A number of the header or footer.
  [[nodiscard]] std::string written(double value) const {
    std::string result = compact(value, options_.decimals);
    if (dialect_.decimal_point && result.find('.') == std::string::npos) result += '.';
    return result;
  }

  void begin_block() {
    ++blocks_;
    if (options_.block_numbers) text_ += "N" + std::to_string(blocks_) + " ";
  }

  void block(const std::string& words) {
    begin_block();
    text_ += words;
    text_ += '\n';
  }

  void number(long long units) {
    char digits[32];
    if (units < 0) text_ += '-';
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

  // Appends the words that differ from where the controller stands; `first` .. `last` only.
  void axis_words(const Position& to, int first, int last) {
    const std::array<char, kWords> letters{'X', 'Y', 'Z', machine_.outer.letter, machine_.inner.letter};
    for (int w = first; w <= last; ++w) {
      if (to[w] == at_[w]) continue;
      if (text_.back() != '\n' && text_.back() != ' ') text_ += ' ';
      text_ += letters[w];
      number(to[w]);
      at_[w] = to[w];
    }
  }

  [[nodiscard]] bool same(const Position& to, int first, int last) const {
    return std::equal(to.begin() + first, to.begin() + last + 1, at_.begin() + first);
  }

  void mode(int g) {
    if (mode_ == g) return;
    text_ += g == 0 ? "G0" : "G1";
    mode_ = g;
  }

  // Parts -------------------------------------------------------------------------------------------------------------

  void header() {
    const Cutter& cutter = motion_.cutter;
    double stick_out = cutter.length_mm;
    for (const HolderPiece& piece : cutter.holder) stick_out = std::min(stick_out, piece.from_mm);
    const bool turning = turns();
    const double minutes = (total_seconds(machine_, motion_) + dwell_s()) / 60;
    const Vec3& zero = setup_.origin_mm;
    const std::string offset = "G" + std::to_string(setup_.work_offset);
    if (dialect_.percent) text_ += "%\n";
    if (dialect_.program_number) text_ += "O00" + file_name().substr(0, 2) + "\n";
    const std::string letters = !machine_.has_rotary() ? "no rotary axis" : std::string(1, machine_.outer.letter) + "0 " + machine_.inner.letter + "0";

    comment("LIGHTMILL " LIGHTMILL_VERSION " " + file_name());
    if (!options_.job_name.empty()) comment("JOB " + options_.job_name);
    if (!options_.job_hash.empty()) comment("HASH OF THE JOB " + options_.job_hash);
    comment("MAKES the " + motion_.pass + " pass of a lens, " + std::to_string(motion_.moves.size()) + " moves, " +
            (turning ? "5 axes at once" : "rotary axes fixed"));
    comment("TIME ABOUT " + fixed(minutes, 1) + " MIN, accelerations not counted");
    comment("TOOL T" + std::to_string(cutter.number) + " " + cutter.name);
    comment("TOOL DIAMETER " + compact(cutter.diameter_mm, 3) + " CORNER RADIUS " +
            compact(cutter.corner_radius_mm, 3) + " STICK-OUT " + compact(stick_out, 3) + " MM");
    comment("TOOL LENGTH " + fixed(cutter.length_mm, 3) + " MM FROM SPINDLE NOSE TO TIP");
    comment("TOOL " + motion_.pass + " AT " + compact(motion_.spindle_rpm, 0) +
            " RPM, cutting data: " + (cutter.source.empty() ? "untested" : cutter.source));
    comment("ZERO " + offset + " = WORKPIECE ORIGIN WITH " + letters + ": the centre of the blank's back");
    comment("ZERO IN MACHINE COORDINATES X" + fixed(zero.x(), 3) + " Y" + fixed(zero.y(), 3) + " Z" +
            fixed(zero.z(), 3));
    comment("MACHINE " + machine_.name);
    if (!machine_.notes.empty()) comment("MACHINE " + machine_.notes);
    comment(
        "NO TOOL CENTRE CONTROL: the program holds axis positions and fits this machine, this zero and this tool "
        "length only");
    if (air_word())
      comment(std::string(air_word()) +
              (std::string_view(air_word()) == "M7" ? " = AIR ON THE MIST OUTPUT" : " = COOLANT"));

    const std::string top = top_words();
    block("G21 G90 G94 G17 G40 G49 G80 " + offset + (dialect_.modes.empty() ? "" : " " + std::string(dialect_.modes)));
    block("G53 G0 " + top);
    mode_ = 0;
    const Vec3& change = machine_.tool_change_mm;
    block("G53 G0 X" + written(change.x()) + " Y" + written(change.y()));
    if (change.z() != machine_.retract_z_mm) block("G53 G0 Z" + written(change.z()));
    block("T" + std::to_string(cutter.number) + " M6");
    if (!dialect_.length_in_table) block("G43.1 Z" + written(cutter.length_mm));
    block("S" + compact(motion_.spindle_rpm, 0) + " M3");
    block("G4 P" + (dialect_.dwell_in_ms ? compact(1000 * dwell_s(), 0) : compact(dwell_s(), 3)));
    if (air_word()) block(air_word());
    // The operator may have jogged at the tool change: up again, whatever Z is, before anything turns.
    block("G53 G0 " + top);
    // Only here: on some controls the offset itself moves Z.
    if (dialect_.length_in_table) block("G43 H" + std::to_string(cutter.number));
    if (!dialect_.smoothing_on.empty()) block(std::string(dialect_.smoothing_on));
    at_.fill(kUnknown);
    at_[kZ] = top_z_;
    if (!machine_.has_rotary()) at_[kOuter] = at_[kInner] = 0;
    if (turning) block("G93");
  }

  void footer() {
    if (turns()) block("G94");
    if (!dialect_.smoothing_off.empty()) block(std::string(dialect_.smoothing_off));
    block(air_word() && !dialect_.one_m_per_block ? "M5 M9" : "M5");
    if (air_word() && dialect_.one_m_per_block) block("M9");
    block("G53 G0 " + top_words());
    std::string home;
    if (at_[kOuter] != 0) home += std::string(" ") + machine_.outer.letter + written(0);
    if (at_[kInner] != 0) home += std::string(" ") + machine_.inner.letter + written(0);
    if (!home.empty()) block("G0" + home);
    if (machine_.park_mm) block("G53 G0 X" + written(machine_.park_mm->x()) + " Y" + written(machine_.park_mm->y()));
    block("G49");
    block("M30");
    if (dialect_.percent) text_ += "%\n";
  }

  // A rapid at the machine's top goes there by machine coordinates, turns the table, then goes across.
  void rapid(const AxisMove& move) {
    Position to = words(move.joints);
    const bool top = move.joints.z_mm == machine_.retract_z_mm;
    if (move.rotary_moves && !top) throw NumericalError("a rapid turns the table below the machine's top");
    if (top) {
      to[kZ] = top_z_;
      if (at_[kZ] != top_z_) {
        block("G53 G0 " + top_words());
        at_[kZ] = top_z_;
        mode_ = 0;
      }
    }
    rapid_block(to, kOuter, kInner);
    rapid_block(to, kX, kZ);
  }

  void rapid_block(const Position& to, int first, int last) {
    if (same(to, first, last)) return;
    begin_block();
    mode(0);
    axis_words(to, first, last);
    text_ += '\n';
  }

  void feed(const AxisMove& move) {
    const Position to = words(move.joints);
    // What rounds to nothing is left out and loses nothing: the next block's end is absolute.
    if (same(to, kX, kInner)) return;
    if (turns() && !same(to, kOuter, kInner) && !same(to, kX, kZ)) {
      double way_mm = 0;
      for (const int w : {kX, kY, kZ}) way_mm = std::hypot(way_mm, static_cast<double>(to[w] - at_[w]) / unit_);
      if (way_mm < dialect_.least_linear_mm) {
        begin_block();
        mode(1);
        axis_words(to, kOuter, kInner);
        text_ += " F" + feed_text(60 / move.seconds) + '\n';
      }
    }
    begin_block();
    mode(1);
    axis_words(to, kX, kInner);
    std::string word;
    if (turns()) {
      word = feed_text(60 / move.seconds);
    } else {
      const double length =
          Vec3(move.joints.x_mm - from_.x_mm, move.joints.y_mm - from_.y_mm, move.joints.z_mm - from_.z_mm).norm();
      word = feed_text(60 * length / move.seconds);
    }
    if (turns() || word != feed_) {
      text_ += " F";
      text_ += word;
      if (dialect_.decimal_point && word.find('.') == std::string::npos) text_ += '.';
      feed_ = std::move(word);
    }
    text_ += '\n';
  }

  [[nodiscard]] std::string file_name() const {
    std::string name = program_file_name(motion_.pass);
    return name.substr(0, name.size() - 3) + std::string(dialect_.extension);
  }

  // Facts -------------------------------------------------------------------------------------------------------------

  [[nodiscard]] bool turns() const { return turns_; }
  [[nodiscard]] double dwell_s() const { return std::max(options_.warm_up_s, machine_.spindle_start_s); }
  [[nodiscard]] std::string top_words() const { return "Z" + written(machine_.retract_z_mm); }
  // M7 is the mist output, where a shop's air blast or mist unit hangs; M8 is flood.
  [[nodiscard]] const char* air_word() const {
    const std::string& coolant = motion_.cutter.coolant;
    return coolant == "air" || coolant == "mist" ? "M7" : coolant == "flood" ? "M8" : nullptr;
  }

  const MachineModel& machine_;
  const WorkSetup& setup_;
  const AxisMotion& motion_;
  const ProgramOptions& options_;
  const detail::Dialect& dialect_;
  double unit_;
  bool turns_ = std::any_of(motion_.moves.begin(), motion_.moves.end(),
                            [](const AxisMove& move) { return move.rotary_moves && move.kind != MoveKind::kRapid; });
  long long top_z_ = std::numeric_limits<long long>::max() - 1;  // a Z that no word can have: reached by G53
  std::string text_;
  std::size_t blocks_ = 0;
  Position at_{};
  JointPosition from_;  // the move before
  int mode_ = -1;
  std::string feed_;
};

}  // namespace

std::string program_file_name(const std::string& pass) {
  const std::array<std::pair<std::string_view, std::string_view>, 3> known{
      {{"rough", "10"}, {"semi_finish", "20"}, {"finish", "30"}}};
  for (const auto& [name, number] : known) {
    if (pass == name) return std::string(number) + "_" + pass + ".nc";
  }
  std::string safe;
  for (const unsigned char c : pass) safe += c < 0x80 && std::isalnum(c) != 0 ? static_cast<char>(c) : '_';
  return "40_" + safe + ".nc";
}

Program write_program(const MachineModel& machine, const WorkSetup& setup, const AxisMotion& motion,
                      const ProgramOptions& options) {
  const int most_decimals = detail::dialect_of(machine.controller).most_decimals;
  if (options.decimals < 3 || options.decimals > most_decimals) {
    throw InputError("decimals = " + std::to_string(options.decimals) + ": must be from 3 to " +
                     std::to_string(most_decimals) + " for " + machine.controller);
  }
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
  Program program = ProgramWriter(machine, setup, motion, options).write();
  const std::vector<std::string> faults = check_program_text(machine, setup, motion, program.text, options);
  if (!faults.empty()) {
    throw NumericalError(program.file_name + " breaks a safety rule (" + std::to_string(faults.size()) +
                         " in all): " + faults.front());
  }
  return program;
}

std::vector<DialectFacts> dialects() {
  std::vector<DialectFacts> facts;
  for (const detail::Dialect* d : detail::all_dialects()) {
    facts.push_back({std::string(d->name), std::string(d->title), std::string(d->extension), d->most_decimals});
  }
  return facts;
}

}  // namespace lightmill

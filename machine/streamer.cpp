#include "machine/streamer.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>

#include "design/core/text.h"
#include "machine/detail/sent_text.h"
#include "machine/program_lines.h"

namespace lightmill {

namespace {

using std::chrono::milliseconds;

constexpr milliseconds kStatusTimeout{1000};
constexpr milliseconds kBannerTimeout{5000};
constexpr milliseconds kPollInterval{5};  // a key waits no longer
constexpr milliseconds kProgressInterval{100};
constexpr milliseconds kBrakingTimeout{10'000};
constexpr char kSoftReset = 0x18;
constexpr int kDoorResuming = 4;  // grblHAL: the spindle comes up again

std::string plural(long count, const std::string& noun) {
  return std::to_string(count) + " " + noun + (count == 1 ? "" : "s");
}

/// Ends the stream from anywhere inside; never leaves stream_program().
struct Ended {
  StreamEnd end;
  std::string message;
  long error_line = 0;
};

class Streamer {
 public:
  Streamer(Connection& connection, std::string_view program, const StreamOptions& options, const Monitor& monitor)
      : connection_(connection), options_(options), monitor_(monitor), lines_(program_lines(program)) {
    result_.lines_total = static_cast<long>(lines_.size());
    for (const ProgramLine& line : lines_) {
      const std::string why = detail::refusal(line.text, options_.longest_line);
      if (!why.empty()) throw InputError("line " + std::to_string(line.number) + " of the program " + why);
    }
  }

  /// With `checking` in check mode: nothing moves.
  StreamResult run(bool checking) {
    const ClockTime start = now();
    last_reply_ = start;
    greet();
    checking_ = checking;
    try {
      if (checking) enter_check_mode();
      stream();
      wait_until_idle();
      result_.message = plural(acknowledged_, "line") + " executed";
      executed_ = acknowledged_;
      if (result_.starved_reports > 0) {
        result_.message += "; the planner was found empty in the cut " + plural(result_.starved_reports, "time") +
                           ", first at line " + std::to_string(result_.first_starved_line) +
                           ": the wire or this computer is too slow for the program";
      }
      if (result_.recovered_acknowledgements > 0) {
        result_.message += "; " + plural(result_.recovered_acknowledgements, "acknowledgement") +
                           " got lost on the way, or a whole line (" + recovery_ +
                           "): look at the part there, or stream these lines again";
      }
    } catch (const Ended& ended) {
      result_.end = ended.end;
      if (ended.end != StreamEnd::kAborted) hold_quietly();
      result_.message = ended.message + "; " + account();
      result_.error_line = ended.error_line;
    } catch (const Stopped&) {
      result_.end = StreamEnd::kStopped;
      hold_quietly();
      result_.message =
          "stopped by the user; the machine is held (~ on the controller goes on, a reset gives up); " + account();
    } catch (const JournalError& error) {
      result_.end = StreamEnd::kJournal;
      hold_quietly();
      result_.message = std::string(error.what()) + "; the machine is held; " + account();
    } catch (const IoError& error) {
      result_.end = StreamEnd::kHungUp;
      result_.message = std::string(error.what()) + "; the controller goes on with what it has buffered; " + account();
    }
    if (checking) leave_check_mode();
    result_.lines_sent = static_cast<long>(next_);
    result_.lines_acknowledged = acknowledged_;
    result_.lines_executed = executed_;
    result_.last_position = status_.machine_position;
    result_.seconds = seconds_since(start);
    return result_;
  }

 private:
  Connection& connection_;
  const StreamOptions& options_;
  const Monitor& monitor_;
  std::vector<ProgramLine> lines_;
  StreamResult result_;

  std::size_t next_ = 0;          ///< first line not sent
  long acknowledged_ = 0;         ///< lines before this one have their ok; [acknowledged_, next_) are under way
  int in_flight_ = 0;             ///< bytes of the lines under way
  int last_acknowledged_bytes_ = 0;  ///< of the line that was acknowledged last
  std::size_t audited_ = 0;       ///< all acknowledgements up to here have been there at once
  std::size_t followed_ = 0;      ///< programmed_ has read the lines before this one
  detail::LineWords last_words_;  ///< of the line before next_
  detail::ProgrammedState programmed_;
  std::string modes_;    ///< the controller's last answer to $G
  std::string unsent_;   ///< bytes the system has not taken yet
  std::string partial_;  ///< beginning of a reply
  StatusReport status_;
  long status_count_ = 0;
  long unreadable_ = 0;
  std::string recovery_;
  int idle_blocks_ = -1, idle_bytes_ = -1;
  int planner_blocks_ = 100;  ///< as the controller says; else what no usual one exceeds
  long executed_ = 0;         ///< lines before this one have surely been executed
  ClockTime last_reply_{};   ///< that acknowledged a line
  ClockTime polled_{}, reported_{};  ///< the last report asked for while streaming, and the last that came
  long polled_at_count_ = -1;
  ClockTime last_progress_{};

  // While greeting, replies are counted here instead of ending the stream.
  bool greeting_ = true;
  bool banner_ = false;
  bool locked_ = false;
  int greeting_oks_ = 0;
  std::string greeting_error_;
  std::map<int, double> settings_;
  bool checking_ = false;
  bool held_by_operator_ = false;
  std::optional<ClockTime> let_go_;  ///< when the operator has last ended a hold
  std::size_t let_through_ = 0;  ///< lines before this one have had their rest
  bool operator_line_ = false;  ///< the last line sent makes the controller wait for the operator

  /// What is known of the lines, in words.
  [[nodiscard]] std::string account() const {
    const auto sent = static_cast<long>(next_);
    std::string text = std::to_string(acknowledged_) + " of " + plural(result_.lines_total, "line") + " acknowledged";
    if (sent > acknowledged_) {
      text += ", " + std::to_string(sent - acknowledged_) + " more sent (lines " +
              std::to_string(number(static_cast<std::size_t>(acknowledged_))) + " to " +
              std::to_string(number(next_ - 1)) + ") that may or may not be executed";
    } else {
      text += ", none other sent";
    }
    text += executed_ == 0 ? "; none is surely executed"
                           : "; those to line " + std::to_string(number(static_cast<std::size_t>(executed_ - 1))) +
                                 " are surely executed";
    if (!status_.machine_position.empty()) {
      text += ", last reported at";
      for (std::size_t i = 0; i < status_.machine_position.size(); ++i) {
        text += (i > 0 ? "," : " ") + compact(status_.machine_position[i], 3);
      }
    }
    if (unreadable_ > 0) text += "; " + plural(unreadable_, "reply line") + " could not be read";
    return text;
  }
  [[nodiscard]] ClockTime now() const { return connection_.clock().now(); }
  [[nodiscard]] double seconds_since(ClockTime start) const {
    return std::chrono::duration<double>(now() - start).count();
  }
  /// Line number in the text.
  [[nodiscard]] long number(std::size_t index) const { return index < lines_.size() ? lines_[index].number : 0; }

  void journal(const char* direction, std::string_view line) const {
    if (options_.on_traffic) options_.on_traffic(direction + std::string(line));
  }

  // --- Bytes ---

  void flush(milliseconds deadline) {
    if (unsent_.empty()) return;
    const std::size_t queued = connection_.queued();
    if (queued >= options_.most_queued_bytes) return;
    const std::string_view next = std::string_view(unsent_).substr(0, options_.most_queued_bytes - queued);
    unsent_.erase(0, connection_.write_some(next, deadline));
  }

  /// A byte that acts at once; it overtakes lines that the system has not taken yet.
  void send_real_time(char byte) {
    journal("> ", byte == kSoftReset ? std::string_view("<reset>") : std::string_view(&byte, 1));
    connection_.write_some({&byte, 1}, kStatusTimeout);
  }

  void hold_quietly() {
    try {
      unsent_.clear();
      send_real_time('!');
    } catch (const IoError&) {
      // Then nobody is there to be held.
    }
  }

  /// Reads and handles what comes within the deadline; false if nothing came.
  bool listen(milliseconds deadline) {
    std::array<char, 8192> bytes;
    const std::size_t count = connection_.read_some(bytes, deadline);
    if (count == 0) return false;
    std::string_view news(bytes.data(), count);
    for (;;) {
      const std::size_t end = news.find('\n');
      if (end == std::string_view::npos) break;
      std::string_view line = news.substr(0, end);
      news.remove_prefix(end + 1);
      std::string whole;
      if (!partial_.empty()) {
        whole = partial_ + std::string(line);
        partial_.clear();
        line = whole;
      }
      while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.remove_suffix(1);
      if (!line.empty()) {
        journal("< ", line);
        handle(line);
      }
    }
    partial_ += news;
    if (partial_.size() > 4096) partial_.clear();
    return true;
  }

  // --- Replies ---

  void handle(std::string_view line) {
    if (line == "ok") {
      if (greeting_) {
        ++greeting_oks_;
      } else if (acknowledged_ == static_cast<long>(next_)) {
        hold_quietly();
        throw Ended{StreamEnd::kLostAcknowledgement, "the controller sent one acknowledgement too many"};
      } else {
        last_acknowledged_bytes_ = static_cast<int>(lines_[static_cast<std::size_t>(acknowledged_)].text.size()) + 1;
        in_flight_ -= last_acknowledged_bytes_;
        ++acknowledged_;
        if (options_.journal != nullptr) options_.journal->acknowledged(acknowledged_);
        last_reply_ = now();
      }
    } else if (line.front() == '<') {
      StatusReport report;
      if (parse_status(line, report)) {
        if (report.work_offset.empty()) report.work_offset = status_.work_offset;
        if (report.overrides.empty()) report.overrides = status_.overrides;
        status_ = report;
        ++status_count_;
        reported_ = now();
        if (!greeting_) {
          look_at_buffer();
          look_at_planner();
          tell_status();
        }
        if (options_.journal != nullptr && !greeting_) options_.journal->reported(line);
      } else {
        ++unreadable_;
      }
    } else if (line.starts_with("error:")) {
      if (greeting_) {
        greeting_error_ = line;
      } else {
        controller_error(std::string(line));
      }
    } else if (line.starts_with("ALARM:")) {
      if (greeting_) {
        locked_ = true;
      } else {
        const long at = number(static_cast<std::size_t>(acknowledged_));
        throw Ended{StreamEnd::kAlarm,
                    "the controller stopped with " + std::string(line) + " at or before line " + std::to_string(at),
                    at};
      }
    } else if (line.starts_with("GrblHAL ") || line.starts_with("Grbl ")) {
      banner_ = true;
      if (!greeting_) {
        throw Ended{StreamEnd::kReset,
                    "the controller restarted in the middle of the program; its position is not to be "
                    "trusted before it is homed"};
      }
    } else if (line.front() == '$') {
      read_setting(line);
    } else if (line.front() == '[') {
      if (line.find("to unlock]") != std::string_view::npos) locked_ = true;
      if (greeting_ && line.starts_with("[OPT:")) read_options(line);
      if (line.starts_with("[GC:")) modes_ = line;
    } else {
      // A reply that the wire has garbled; the count of acknowledgements will tell whether it was one.
      ++unreadable_;
    }
  }

  /// "$110=6000.000"
  void read_setting(std::string_view line) {
    int number = 0;
    double value = 0;
    const char* const end = line.data() + line.size();
    const auto [equals, wrong] = std::from_chars(line.data() + 1, end, number);
    if (wrong != std::errc() || equals == end || *equals != '=') return;
    if (std::from_chars(equals + 1, end, value).ec == std::errc()) settings_[number] = value;
  }

  /// The controller cannot hold more than is under way; if it says so, an ok was counted that was none.
  void look_at_buffer() {
    const int held = idle_bytes_ - status_.free_bytes;
    if (idle_bytes_ < 0 || status_.free_bytes < 0 || held <= in_flight_) return;
    throw Ended{StreamEnd::kLostAcknowledgement,
                "the controller's buffer holds " + std::to_string(held) + " bytes where at most " +
                    std::to_string(in_flight_) + " can be under way: an acknowledgement came twice"};
  }

  /// What a status report tells about the lines acknowledged so far; replies and reports come in the controller's order.
  void look_at_planner() {
    const bool still = status_.state == "Idle" || status_.state == "Check";
    const int waiting = still                        ? 0
                        : status_.free_blocks >= 0   ? std::max(0, planner_blocks_ - status_.free_blocks)
                                                     : planner_blocks_;
    executed_ = std::max(executed_, acknowledged_ - waiting);
    // An empty planner between two motions: the cutter stands in the cut. Around other lines that is the program's wish.
    if (status_.free_blocks < planner_blocks_ || (!still && status_.state != "Run")) return;
    if (acknowledged_ == 0 || acknowledged_ >= result_.lines_total) return;
    for (const long index : {acknowledged_ - 1, acknowledged_}) {
      const detail::LineWords words = detail::words_of(lines_[static_cast<std::size_t>(index)].text);
      if (!words.axes || words.other_command) return;
    }
    if (result_.starved_reports++ == 0) result_.first_starved_line = number(static_cast<std::size_t>(acknowledged_));
  }

  void tell_status() const {
    if (!options_.on_status) return;
    StreamStatus status;
    status.lines_total = result_.lines_total;
    status.lines_acknowledged = acknowledged_;
    status.lines_executed = executed_;
    status.line = executed_ > 0 ? number(static_cast<std::size_t>(executed_ - 1)) : 0;
    status.under_way_bytes = in_flight_;
    status.receive_buffer_bytes = result_.receive_buffer_bytes;
    status.starved_reports = result_.starved_reports;
    status.report = status_;
    options_.on_status(status);
  }

  /// [OPT:VNML+,100,1024,6,0] or [OPT:V,15,128]: options, planner blocks, receive buffer.
  void read_options(std::string_view line) {
    const std::size_t first = line.find(','), second = line.find(',', first + 1);
    if (second == std::string_view::npos) return;
    std::from_chars(line.data() + first + 1, line.data() + second, planner_blocks_);
    int bytes = 0;
    std::from_chars(line.data() + second + 1, line.data() + line.size(), bytes);
    if (bytes > 1 && result_.receive_buffer_bytes == 0) result_.receive_buffer_bytes = bytes;
  }

  /// error:n answers the oldest line under way. grblHAL refuses all that follow, grbl would execute them: hold, and
  /// hear out what is said about the rest.
  [[noreturn]] void controller_error(const std::string& reply) {
    const auto index = static_cast<std::size_t>(acknowledged_);
    if (index >= next_) {
      hold_quietly();
      throw Ended{StreamEnd::kLostAcknowledgement,
                  "the controller said " + reply + " although every line was acknowledged"};
    }
    hold_quietly();
    greeting_ = true;  // what comes now is counted, not obeyed
    greeting_oks_ = 0;
    while (listen(milliseconds(100))) {
    }
    std::string message = "the controller refused line " + std::to_string(lines_[index].number) + " with " + reply +
                          ": '" + std::string(lines_[index].text.substr(0, 80)) + "'";
    message += greeting_oks_ > 0 ? "; it executed " + plural(greeting_oks_, "line") + " after it"
                                 : "; it executed none of the lines after it";
    throw Ended{StreamEnd::kControllerError, message, lines_[index].number};
  }

  /// Asks for a status report and waits for it; false if none comes.
  bool ask_status() {
    const long before = status_count_;
    const ClockTime end = now() + std::max<ClockTime>(2 * kStatusTimeout, options_.reply_timeout);
    while (status_count_ == before && now() < end) {
      // Asked again: the question may have got lost.
      send_real_time('?');
      const ClockTime again = std::min<ClockTime>(end, now() + kStatusTimeout);
      while (status_count_ == before && now() < again) listen(milliseconds(50));
    }
    return status_count_ != before;
  }

  // --- Connecting ---

  void drain() {
    while (listen(options_.settle_time)) {
    }
  }

  void greet() {
    drain();
    const std::string on_port = " on " + connection_.name();
    if (options_.greeting == Greeting::kReset) {
      if (!ask_status() && !ask_status()) {
        throw IoError("no controller answers" + on_port + ": check cable, power and baud rate");
      }
      constexpr std::array<std::string_view, 4> kBusy{"Run", "Jog", "Home", "Door"};
      const bool braking = status_.state == "Hold" && status_.substate > 0;
      if (braking || std::find(kBusy.begin(), kBusy.end(), status_.state) != kBusy.end()) {
        throw IoError("the controller" + on_port + " is busy (" + status_.state + "): wait or stop it first");
      }
      banner_ = locked_ = false;
      send_real_time(kSoftReset);
    }
    if (options_.greeting != Greeting::kNone) {
      wait_for_banner();
      if (!banner_) throw IoError("no grblHAL banner" + on_port + ": is it another controller?");
      drain();
    }
    if (!ask_status()) throw IoError("no controller answers" + on_port + ": check cable, power and baud rate");
    if (locked_ || status_.state == "Alarm") {
      throw IoError("the controller" + on_port + " is locked by an alarm: home it ($H) or unlock it ($X) first");
    }
    // An empty line also makes grblHAL forget an error of an earlier program.
    greeting_oks_ = 0;
    command("\n", on_port);
    drain();
    if (greeting_oks_ != 1) {
      throw IoError("the controller" + on_port + " answers " + std::to_string(greeting_oks_) +
                    " times where it should once: somebody else may be sending");
    }
    result_.receive_buffer_bytes = options_.receive_buffer_bytes;
    command("$I\n", on_port);
    if (options_.receive_buffer_bytes == 0) {
      if (result_.receive_buffer_bytes == 0) {
        throw IoError("the controller" + on_port + " does not say how large its receive buffer is: give it in the job");
      }
    }
    if (options_.machine != nullptr) check_settings(on_port);
    for (const ProgramLine& line : lines_) {
      if (static_cast<int>(line.text.size()) + 1 > result_.receive_buffer_bytes - 1) {
        throw InputError("line " + std::to_string(line.number) +
                         " of the program is longer than the controller's buffer");
      }
    }
    if (ask_status()) {
      idle_blocks_ = status_.free_blocks;
      idle_bytes_ = status_.free_bytes;
    }
    greeting_ = false;
  }

  void wait_for_banner() {
    const ClockTime end = now() + kBannerTimeout;
    while (!banner_ && now() < end) listen(milliseconds(50));
  }

  void check_settings(const std::string& on_port) {
    settings_.clear();
    command("$$\n", on_port);
    const std::vector<std::string> differences = setting_differences(settings_, *options_.machine);
    if (differences.empty()) return;
    std::string all;
    for (const std::string& difference : differences) all += (all.empty() ? "" : "; ") + difference;
    throw InputError("the controller" + on_port + " is not set as the machine file says: " + all +
                     ": correct one of the two");
  }

  void command(std::string_view text, const std::string& on_port) {
    journal("> ", text.substr(0, text.size() - 1));
    const int before = greeting_oks_;
    greeting_error_.clear();
    connection_.write_some(text, kStatusTimeout);
    ClockTime end = now() + kStatusTimeout;
    while (greeting_oks_ == before && greeting_error_.empty() && now() < end) {
      // On a slow line an answer takes its time; only silence is a time-out.
      if (listen(milliseconds(50))) end = now() + kStatusTimeout;
    }
    if (greeting_oks_ == before) {
      throw IoError("the controller" + on_port + " does not acknowledge" +
                    (greeting_error_.empty() ? "" : " but says " + greeting_error_));
    }
  }

  // --- Check mode ---

  void enter_check_mode() {
    greeting_ = true;
    command("$C\n", " on " + connection_.name());
    greeting_ = false;
  }

  /// The controller resets itself when it leaves check mode.
  void leave_check_mode() {
    if (result_.done()) {
      result_.message = "the controller takes all " + plural(acknowledged_, "line");
    } else {
      result_.message = "in check mode, nothing has moved: " + result_.message;
    }
    executed_ = 0;
    for (const StreamEnd left : {StreamEnd::kHungUp, StreamEnd::kReset, StreamEnd::kAborted}) {
      if (result_.end == left) return;
    }
    unsent_.clear();
    greeting_ = true;
    banner_ = false;
    command("$C\n", " on " + connection_.name());
    wait_for_banner();
    drain();
  }

  // --- Streaming ---

  [[nodiscard]] bool all_acknowledged() const { return acknowledged_ == static_cast<long>(next_); }

  /// Appends lines to unsent_ while the controller's buffer has room for them and nothing says to wait.
  void feed() {
    while (next_ < lines_.size()) {
      const ProgramLine& line = lines_[next_];
      const int size = static_cast<int>(line.text.size()) + 1;
      // The line acknowledged last is taken to be in the buffer still, so that an ok which comes twice does not overflow it.
      if (!all_acknowledged() && in_flight_ + last_acknowledged_bytes_ + size > result_.receive_buffer_bytes - 1) return;
      if (rests_before_next()) return;
      const detail::LineWords words = detail::words_of(line.text);
      if (!all_acknowledged()) {
        // The count of acknowledgements is checked now and then, and around lines that ask for the operator. Two lines
        // that would read as one if the line feed between them got lost are never under way together.
        if (options_.one_at_a_time || operator_line_ || words.tool_change || words.pause) return;
        if (static_cast<long>(next_ - audited_) >= options_.audit_every_lines) return;
        if (detail::may_merge(last_words_, words)) return;
      } else {
        if (operator_line_) return;
        audited_ = next_;
        if (options_.journal != nullptr) options_.journal->audited(static_cast<long>(next_));
      }
      if (options_.journal != nullptr) options_.journal->sending(static_cast<long>(next_) + 1);
      unsent_ += line.text;
      unsent_ += '\n';
      in_flight_ += size;
      result_.bytes_sent += size;
      if (in_flight_ > result_.highest_buffer_fill) result_.highest_buffer_fill = in_flight_;
      journal("> ", line.text);
      operator_line_ = words.tool_change || words.pause;
      last_words_ = words;
      ++next_;
    }
  }

  [[nodiscard]] bool pauses_before_next() const {
    return options_.pause_before &&
           options_.pause_before(lines_[next_], next_ > 0 ? lines_[next_ - 1].text : std::string_view());
  }
  /// Before the next line the machine is to stand: the operator wants to look, or the program is about to end, which
  /// changes offsets, so that its place can be compared for the last time.
  [[nodiscard]] bool rests_before_next() const {
    if (checking_ || next_ >= lines_.size() || let_through_ > next_) return false;
    const std::string_view text = lines_[next_].text;
    return pauses_before_next() || (text.find_first_of("Mm") != std::string_view::npos && detail::words_of(text).program_end);
  }

  void rest_before_next() {
    wait_until_idle();
    audit_place();
    if (pauses_before_next()) {
      const std::string what =
          "before line " + std::to_string(lines_[next_].number) + ": " + std::string(lines_[next_].text);
      if (!options_.on_operator || !options_.on_operator(what)) {
        throw Ended{StreamEnd::kStopped, "paused " + what + ", and nobody goes on"};
      }
    }
    let_through_ = next_ + 1;
    last_reply_ = now();
  }

  void send_commands() {
    if (!options_.commands) return;
    for (const char byte : options_.commands()) {
      if (byte == kSoftReset) abort_program();
      if (byte == '!') held_by_operator_ = true;
      if (byte == '~') {
        held_by_operator_ = false;
        let_go_ = now();
      }
      send_real_time(byte);
    }
  }

  /// A stop under control, and the reset only when the machine stands: so it keeps its place.
  [[noreturn]] void abort_program() {
    unsent_.clear();
    send_real_time('!');
    const ClockTime end = now() + kBrakingTimeout;
    const auto stands = [&] {
      if (status_.state == "Hold" || status_.state == "Door") return status_.substate <= 0;
      return status_.state == "Idle" || status_.state == "Check" || status_.state == "Tool";
    };
    do {
      if (now() > end || !ask_status()) {
        throw Ended{StreamEnd::kStopped, "given up by the operator; the machine was told to hold and does not say that it stands"};
      }
      listen(kPollInterval);
    } while (!stands());
    greeting_ = true;  // what comes now is no reply to a line
    banner_ = false;
    send_real_time(kSoftReset);
    wait_for_banner();
    drain();
    throw Ended{StreamEnd::kAborted, std::string("given up by the operator; the machine has stopped under control and was reset") +
                                         (locked_ ? ", and says that it has lost its place: home it" : ", its place is kept")};
  }

  void progress(bool force = false) {
    if (!force && now() - last_progress_ < kProgressInterval) return;
    last_progress_ = now();
    monitor_.report("streaming",
                    lines_.empty() ? 1.0 : static_cast<double>(acknowledged_) / static_cast<double>(lines_.size()));
  }

  /// Asks for a report now and then, but never so often that reports crowd out acknowledgements on a slow line.
  void poll_status() {
    if (options_.status_interval.count() == 0) return;
    const bool answered = status_count_ > polled_at_count_;
    if (!answered && now() - polled_ < options_.reply_timeout) return;
    if (answered && now() - reported_ < std::max<ClockTime>(options_.status_interval, 4 * (reported_ - polled_))) return;
    polled_ = now();
    polled_at_count_ = status_count_;
    send_real_time('?');
  }

  void stream() {
    const ClockTime start = last_reply_ = now();
    while (next_ < lines_.size() || !all_acknowledged()) {
      send_commands();
      feed();
      flush(milliseconds(0));
      poll_status();
      const bool waits_for_room = !unsent_.empty();
      const bool heard = listen(waits_for_room ? milliseconds(1) : kPollInterval);
      if (operator_line_ && unsent_.empty() && (!heard || all_acknowledged())) serve_operator();
      if (all_acknowledged() && !operator_line_ && rests_before_next()) rest_before_next();
      if (!all_acknowledged() && now() - last_reply_ >= options_.reply_timeout) look_for_lost_acknowledgement();
      progress();
    }
    if (operator_line_) serve_operator();
    result_.streaming_seconds = seconds_since(start);
  }

  /// The last line sent was M6, M0 or M1: the controller may be waiting for somebody to press the button.
  void serve_operator() {
    const detail::LineWords words = last_words_;
    const std::string line(lines_[next_ - 1].text);
    for (;;) {
      monitor_.check();
      if (!ask_status()) throw Ended{StreamEnd::kLostAcknowledgement, "the controller does not answer any more"};
      if (status_.state == "Tool" || (words.pause && status_.state == "Hold")) break;
      if (status_.state == "Alarm") throw Ended{StreamEnd::kAlarm, "the controller is in alarm", number(next_ - 1)};
      // An optional pause that is switched off, or a tool changer of its own: nobody is asked.
      if (all_acknowledged() && (status_.state == "Idle" || status_.state == "Check")) {
        operator_line_ = false;
        return;
      }
      if (!all_acknowledged() && now() - last_reply_ >= options_.reply_timeout) return;
      listen(kPollInterval);
    }
    const std::string what = (words.tool_change ? "tool change: " : "program pause: ") + line;
    if (!options_.on_operator || !options_.on_operator(what)) {
      throw Ended{StreamEnd::kStopped, "the machine waits for the operator (" + what + ") and nobody confirmed"};
    }
    // Confirmed once; a `~` that got lost on the way is sent again.
    const long acknowledged = acknowledged_;
    for (int i = 0;; ++i) {
      send_real_time('~');
      listen(kPollInterval);
      if (acknowledged_ > acknowledged) break;
      if (!ask_status()) throw Ended{StreamEnd::kLostAcknowledgement, "the controller does not answer any more"};
      if (status_.state != "Tool" && status_.state != "Hold") break;
      if (i == 20) throw Ended{StreamEnd::kStopped, "the machine does not go on after the operator's confirmation"};
    }
    operator_line_ = false;
    last_reply_ = now();
  }

  /// No reply for long although lines are under way: is the machine busy, or has an acknowledgement got lost?
  void look_for_lost_acknowledgement() {
    const long before = acknowledged_;
    for (int i = 0; i < 2; ++i) {
      if (!ask_status()) {
        throw Ended{StreamEnd::kLostAcknowledgement, "the controller does not answer any more"};
      }
      if (acknowledged_ != before) return;
      if (status_.state == "Alarm") {
        const long at = number(static_cast<std::size_t>(acknowledged_));
        throw Ended{StreamEnd::kAlarm, "the controller is in alarm", at};
      }
      // Run, Hold, Door, Tool: it has its reasons, the lines are safe in its buffer.
      if (status_.state != "Idle" && status_.state != "Check") {
        if (status_.state != "Run") serve_held_machine();
        last_reply_ = now();
        return;
      }
      listen(milliseconds(100));
      if (acknowledged_ != before) return;
    }
    const long missing = static_cast<long>(next_) - acknowledged_;
    const std::string where =
        "between lines " + std::to_string(number(audited_)) + " and " + std::to_string(number(next_ - 1));
    const auto give_up = [&](const std::string& why) -> Ended {
      hold_quietly();
      return {StreamEnd::kLostAcknowledgement,
              plural(missing, "acknowledgement") + " missing " + where + " and the machine is idle; " + why};
    };
    if (idle_bytes_ < 0) throw give_up("it does not report its buffer ($10=3 would make it), so nothing proves where the line is");
    if (status_.free_bytes != idle_bytes_ || status_.free_blocks != idle_blocks_) {
      throw give_up("its buffer is not empty: the end of a line got lost on the way");
    }
    if (missing != 1) throw give_up("more than one is missing, so lines may have got lost");
    int compared = 0;
    if (!stands_as_programmed(compared)) {
      throw give_up("it does not stand where line " + std::to_string(number(next_ - 1)) + " ends: a line got lost");
    }
    modes_.clear();
    unsent_ += "$G\n";
    flush(kStatusTimeout);
    journal("> ", "$G");
    greeting_ = true;  // its ok is not a line's
    const int oks = greeting_oks_;
    const auto end = now() + kStatusTimeout;
    while (greeting_oks_ == oks && now() < end) listen(milliseconds(50));
    greeting_ = false;
    if (greeting_oks_ != oks + 1) throw give_up("it does not answer $G as it should");
    if (!programmed_.agrees_modes(modes_, compared)) {
      throw give_up("its modes " + modes_ + " are not those of the program: a line got lost");
    }
    if (compared == 0) throw give_up("nothing tells whether the last line was executed");
    // Everything sent was taken out of the buffer and carried out, and nothing was refused: only the ok is missing.
    ++result_.recovered_acknowledgements;
    recovery_ = where + ", machine idle with empty buffers, position and modes as programmed, so the stream went on";
    acknowledged_ = static_cast<long>(next_);
    if (options_.journal != nullptr) options_.journal->acknowledged(acknowledged_);
    in_flight_ = 0;
    last_reply_ = now();
  }

  /// Somebody at the machine may have held it, or opened its door.
  void serve_held_machine() {
    if (!options_.on_operator || held_by_operator_) return;
    if (status_.state == "Door" && status_.substate == kDoorResuming) return;
    // A report may have left before the operator's ~ arrived.
    if (let_go_ && now() - *let_go_ < options_.reply_timeout) return;
    const std::string what = "the machine waits (" + status_.state + ") although the program did not ask for it";
    if (!options_.on_operator(what)) throw Ended{StreamEnd::kStopped, what + " and the operator does not go on"};
    send_real_time('~');
  }

  /// Does the resting machine report the place where the lines sent so far end? Adds how many axes could be compared.
  bool stands_as_programmed(int& compared) {
    while (followed_ < next_) programmed_.read(lines_[followed_++].text);
    // The work offset comes with every so many reports only, and an old one may be another tool's.
    status_.work_offset.clear();
    for (int i = 0; status_.work_offset.empty() && i < 40; ++i) {
      if (!ask_status()) throw Ended{StreamEnd::kLostAcknowledgement, "the controller does not answer any more"};
    }
    return programmed_.agrees_position(status_.machine_position, status_.work_offset, compared) ||
           status_.state == "Check";
  }

  /// Where the machine rests anyway, its place is compared: a garbled number that the controller took shows here.
  void audit_place() {
    int compared = 0;
    if (next_ == 0 || stands_as_programmed(compared)) return;
    throw Ended{StreamEnd::kWrongPlace, "the machine does not stand where line " + std::to_string(number(next_ - 1)) +
                                            " ends: a line was garbled or lost on the way"};
  }

  void wait_until_idle() {
    ClockTime moved = now();
    for (;;) {
      progress(true);
      if (!ask_status()) throw Ended{StreamEnd::kLostAcknowledgement, "the controller does not answer any more"};
      if (status_.state == "Idle" || status_.state == "Check") return;
      if (status_.state == "Alarm") throw Ended{StreamEnd::kAlarm, "the controller is in alarm"};
      send_commands();
      if (status_.state == "Run") moved = now();
      if (now() - moved >= options_.reply_timeout) {
        serve_held_machine();
        moved = now();
      }
      listen(kPollInterval);
    }
  }
};

bool read_numbers(std::string_view text, std::vector<double>& numbers) {
  numbers.clear();
  while (!text.empty()) {
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc()) return false;
    numbers.push_back(value);
    text.remove_prefix(static_cast<std::size_t>(end - text.data()));
    if (text.empty()) return true;
    if (text.front() != ',') return false;
    text.remove_prefix(1);
  }
  return !numbers.empty();
}

}  // namespace

bool parse_status(std::string_view line, StatusReport& report) {
  if (line.size() < 3 || line.front() != '<' || line.back() != '>') return false;
  line = line.substr(1, line.size() - 2);
  StatusReport read;
  const std::string_view state = line.substr(0, line.find('|'));
  read.state = state.substr(0, state.find(':'));
  if (read.state.empty()) return false;
  if (read.state.size() < state.size()) {
    std::from_chars(state.data() + read.state.size() + 1, state.data() + state.size(), read.substate);
  }
  std::string_view rest = line.substr(state.size());
  while (!rest.empty()) {
    rest.remove_prefix(1);
    const std::string_view field = rest.substr(0, rest.find('|'));
    rest.remove_prefix(field.size());
    const std::size_t colon = field.find(':');
    if (colon == std::string_view::npos) continue;
    const std::string_view key = field.substr(0, colon), value = field.substr(colon + 1);
    std::vector<double> numbers;
    if (key == "MPos" && !read_numbers(value, read.machine_position)) return false;
    if (key == "WCO" && !read_numbers(value, read.work_offset)) return false;
    if (key == "Ov" && !read_numbers(value, read.overrides)) return false;
    if (key == "FS" || key == "F") {
      if (!read_numbers(value, numbers)) return false;
      read.feed_mm_per_min = numbers[0];
    }
    if (key == "Bf") {
      if (!read_numbers(value, numbers) || numbers.size() != 2) return false;
      read.free_blocks = static_cast<int>(numbers[0]);
      read.free_bytes = static_cast<int>(numbers[1]);
    }
  }
  report = read;
  return true;
}

StreamResult stream_program(Connection& connection, std::string_view program, const StreamOptions& options,
                            const Monitor& monitor) {
  return Streamer(connection, program, options, monitor).run(false);
}

StreamResult check_program(Connection& connection, std::string_view program, const StreamOptions& options,
                           const Monitor& monitor) {
  StreamOptions checking = options;
  checking.journal = nullptr;
  return Streamer(connection, program, checking, monitor).run(true);
}

std::vector<std::string> setting_differences(const std::map<int, double>& settings, const MachineModel& machine) {
  constexpr double kSameShare = 0.01;  // settings are typed in by hand
  std::vector<std::string> differences;
  const auto compare = [&](int number, const std::string& what, double expected, const std::string& unit) {
    const auto found = settings.find(number);
    if (found == settings.end() || std::abs(found->second - expected) <= kSameShare * std::abs(expected)) return;
    differences.push_back("$" + std::to_string(number) + " (" + what + ") is " + compact(found->second, 3) +
                          ", the file says " + compact(expected, 3) + unit);
  };
  compare(13, "reports in inches", 0, "");
  compare(32, "laser mode", 0, "");
  compare(30, "highest spindle speed", machine.max_spindle_rpm, " rpm");
  const std::array<std::pair<char, const LinearAxis*>, 3> axes = {
      {{'X', &machine.x}, {'Y', &machine.y}, {'Z', &machine.z}}};
  for (int i = 0; i < 3; ++i) {
    const auto& [letter, axis] = axes[static_cast<std::size_t>(i)];
    const std::string name(1, letter);
    compare(110 + i, name + " speed", axis->max_speed_mm_per_s * 60, " mm/min");
    if (axis->acceleration_mm_per_s2 > 0) compare(120 + i, name + " acceleration", axis->acceleration_mm_per_s2, " mm/s2");
    compare(130 + i, name + " travel", axis->max_mm - axis->min_mm, " mm");
  }
  return differences;
}

}  // namespace lightmill

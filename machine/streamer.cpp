#include "machine/streamer.h"

#include <algorithm>
#include <array>
#include <charconv>

#include "machine/detail/sent_text.h"
#include "machine/program_lines.h"

namespace lightmill {

namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kStatusTimeout{1000};
constexpr milliseconds kBannerTimeout{5000};
constexpr milliseconds kPollInterval{20};
constexpr milliseconds kProgressInterval{100};
constexpr milliseconds kReportInterval{500};
constexpr char kSoftReset = 0x18;

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

  StreamResult run() {
    const auto start = Clock::now();
    greet();
    try {
      stream();
      wait_until_idle();
      result_.message = plural(acknowledged_, "line") + " executed";
      if (result_.recovered_acknowledgements > 0) {
        result_.message += "; " + plural(result_.recovered_acknowledgements, "acknowledgement") +
                           " got lost on the way (" + recovery_ + ")";
      }
    } catch (const Ended& ended) {
      result_.end = ended.end;
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
    result_.lines_sent = static_cast<long>(next_);
    result_.lines_acknowledged = acknowledged_;
    result_.seconds = std::chrono::duration<double>(Clock::now() - start).count();
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
  Clock::time_point last_reply_ = Clock::now();
  Clock::time_point last_progress_{};
  Clock::time_point last_poll_{};
  long acknowledged_at_poll_ = 0;

  // While greeting, replies are counted here instead of ending the stream.
  bool greeting_ = true;
  bool banner_ = false;
  bool locked_ = false;
  int greeting_oks_ = 0;
  std::string greeting_error_;
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
    if (unreadable_ > 0) text += "; " + plural(unreadable_, "reply line") + " could not be read";
    return text;
  }
  /// Line number in the text.
  [[nodiscard]] long number(std::size_t index) const { return index < lines_.size() ? lines_[index].number : 0; }

  void journal(const char* direction, std::string_view line) const {
    if (options_.on_traffic) options_.on_traffic(direction + std::string(line));
  }

  // --- Bytes ---

  void flush(milliseconds deadline) {
    if (unsent_.empty()) return;
    const std::size_t taken = connection_.write_some(unsent_, deadline);
    unsent_.erase(0, taken);
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
    last_reply_ = Clock::now();
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
        in_flight_ -= static_cast<int>(lines_[static_cast<std::size_t>(acknowledged_)].text.size()) + 1;
        ++acknowledged_;
        if (options_.journal != nullptr) options_.journal->acknowledged(acknowledged_);
      }
    } else if (line.front() == '<') {
      StatusReport report;
      if (parse_status(line, report)) {
        if (report.work_offset.empty()) report.work_offset = status_.work_offset;
        status_ = report;
        ++status_count_;
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
    } else if (line.front() == '[') {
      if (line.find("to unlock]") != std::string_view::npos) locked_ = true;
      if (greeting_ && line.starts_with("[OPT:")) read_options(line);
      if (line.starts_with("[GC:")) modes_ = line;
    } else {
      // A reply that the wire has garbled; the count of acknowledgements will tell whether it was one.
      ++unreadable_;
    }
  }

  /// [OPT:VNML+,100,1024,6,0]: options, planner blocks, receive buffer.
  void read_options(std::string_view line) {
    const std::size_t first = line.find(','), second = line.find(',', first + 1);
    if (second == std::string_view::npos) return;
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
    send_real_time('?');
    const auto end = Clock::now() + std::max(kStatusTimeout, options_.reply_timeout);
    while (status_count_ == before && Clock::now() < end) listen(milliseconds(50));
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
      for (const char* state : {"Run", "Jog", "Home", "Door"}) {
        if (status_.state == state) {
          throw IoError("the controller" + on_port + " is busy (" + status_.state + "): wait or stop it first");
        }
      }
      banner_ = locked_ = false;
      send_real_time(kSoftReset);
    }
    if (options_.greeting != Greeting::kNone) {
      const auto end = Clock::now() + kBannerTimeout;
      while (!banner_ && Clock::now() < end) listen(milliseconds(50));
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
    if (options_.receive_buffer_bytes == 0) {
      command("$I\n", on_port);
      if (result_.receive_buffer_bytes == 0) {
        throw IoError("the controller" + on_port + " does not say how large its receive buffer is: give it in the job");
      }
    }
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

  void command(std::string_view text, const std::string& on_port) {
    journal("> ", text.substr(0, text.size() - 1));
    const int before = greeting_oks_;
    greeting_error_.clear();
    connection_.write_some(text, kStatusTimeout);
    const auto end = Clock::now() + kStatusTimeout;
    while (greeting_oks_ == before && greeting_error_.empty() && Clock::now() < end) listen(milliseconds(50));
    if (greeting_oks_ == before) {
      throw IoError("the controller" + on_port + " does not acknowledge" +
                    (greeting_error_.empty() ? "" : " but says " + greeting_error_));
    }
  }

  // --- Streaming ---

  [[nodiscard]] bool all_acknowledged() const { return acknowledged_ == static_cast<long>(next_); }

  /// Appends lines to unsent_ while the controller's buffer has room for them and nothing says to wait.
  void feed() {
    while (next_ < lines_.size()) {
      const ProgramLine& line = lines_[next_];
      const int size = static_cast<int>(line.text.size()) + 1;
      if (in_flight_ + size > result_.receive_buffer_bytes - 1) return;
      const detail::LineWords words = detail::words_of(line.text);
      if (!all_acknowledged()) {
        // The count of acknowledgements is checked now and then, and around lines that ask for the operator. Two lines
        // that would read as one if the line feed between them got lost are never under way together.
        if (operator_line_ || words.tool_change || words.pause) return;
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

  void progress(bool force = false) {
    const auto now = Clock::now();
    if (!force && now - last_progress_ < kProgressInterval) return;
    last_progress_ = now;
    monitor_.report("streaming",
                    lines_.empty() ? 1.0 : static_cast<double>(acknowledged_) / static_cast<double>(lines_.size()));
  }

  /// A report for the journal now and then; none while acknowledgements are missing, whose silence must be heard.
  void poll() {
    if (options_.journal == nullptr || acknowledged_ == acknowledged_at_poll_) return;
    if (Clock::now() - last_poll_ < kReportInterval) return;
    last_poll_ = Clock::now();
    acknowledged_at_poll_ = acknowledged_;
    send_real_time('?');
  }

  void stream() {
    last_reply_ = Clock::now();
    while (next_ < lines_.size() || !all_acknowledged()) {
      poll();
      feed();
      flush(milliseconds(0));
      const bool waits_for_room = !unsent_.empty();
      if (!listen(waits_for_room ? milliseconds(1) : kPollInterval)) {
        if (operator_line_ && unsent_.empty()) serve_operator();
        if (!all_acknowledged() && Clock::now() - last_reply_ >= options_.reply_timeout)
          look_for_lost_acknowledgement();
      } else if (operator_line_ && all_acknowledged()) {
        serve_operator();
      }
      progress();
    }
    if (operator_line_) serve_operator();
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
      if (!all_acknowledged() && Clock::now() - last_reply_ >= options_.reply_timeout) return;
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
    last_reply_ = Clock::now();
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
      // Run, Hold, Door, Tool: it has its reasons, the lines are safe in its buffer. Somebody at the machine may have
      // held it.
      if (status_.state != "Idle" && status_.state != "Check") {
        if (status_.state != "Run" && options_.on_operator &&
            options_.on_operator("the machine waits (" + status_.state + ") although the program did not ask for it")) {
          send_real_time('~');
        }
        last_reply_ = Clock::now();
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
    if (idle_bytes_ < 0 || status_.free_bytes != idle_bytes_ || status_.free_blocks != idle_blocks_) {
      throw give_up("its buffer is not empty: the end of a line got lost on the way");
    }
    if (missing != 1) throw give_up("more than one is missing, so lines may have got lost");
    while (followed_ < next_) programmed_.read(lines_[followed_++].text);
    // The work offset comes with every so many reports only, and an old one may be another tool's.
    status_.work_offset.clear();
    for (int i = 0; status_.work_offset.empty() && i < 40; ++i) ask_status();
    int compared = 0;
    if (!programmed_.agrees_position(status_.machine_position, status_.work_offset, compared) &&
        status_.state != "Check") {
      throw give_up("it does not stand where line " + std::to_string(number(next_ - 1)) + " ends: a line got lost");
    }
    modes_.clear();
    unsent_ += "$G\n";
    flush(kStatusTimeout);
    journal("> ", "$G");
    greeting_ = true;  // its ok is not a line's
    const int oks = greeting_oks_;
    const auto end = Clock::now() + kStatusTimeout;
    while (greeting_oks_ == oks && Clock::now() < end) listen(milliseconds(50));
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
    last_reply_ = Clock::now();
  }

  void wait_until_idle() {
    for (;;) {
      progress(true);
      if (!ask_status()) throw Ended{StreamEnd::kLostAcknowledgement, "the controller does not answer any more"};
      if (status_.state == "Idle" || status_.state == "Check") return;
      if (status_.state == "Alarm") throw Ended{StreamEnd::kAlarm, "the controller is in alarm"};
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
  return Streamer(connection, program, options, monitor).run();
}

}  // namespace lightmill

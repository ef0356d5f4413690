#include "machine/drip_feed.h"

#include <algorithm>
#include <array>

#include "design/core/errors.h"
#include "machine/program_lines.h"

namespace lightmill {

namespace {

using std::chrono::milliseconds;

constexpr char kXon = 0x11, kXoff = 0x13;
constexpr milliseconds kPollInterval{1};
constexpr int kMostLeader = 50;

/// What goes over the line, and where each line of it ends.
struct Tape {
  std::string bytes;
  std::vector<std::size_t> line_ends;
};

Tape punch(const std::vector<ProgramLine>& lines, const DripOptions& options) {
  Tape tape;
  tape.bytes.assign(static_cast<std::size_t>(std::clamp(options.leader_nulls, 0, kMostLeader)), '\0');
  const bool has_marks = !lines.empty() && lines.front().text.starts_with('%');
  if (options.tape_marks && !has_marks) tape.bytes += "%" + options.line_end;
  for (const ProgramLine& line : lines) {
    tape.bytes += std::string(line.text) + options.line_end;
    tape.line_ends.push_back(tape.bytes.size());
  }
  if (options.tape_marks && (lines.empty() || lines.back().text != "%" || lines.size() == 1)) {
    tape.bytes += "%" + options.line_end;
  }
  tape.bytes += options.trailer;
  return tape;
}

class DripFeed {
 public:
  DripFeed(Connection& connection, std::string_view program, const DripOptions& options, const Monitor& monitor)
      : connection_(connection), options_(options), monitor_(monitor), lines_(program_lines(program)) {
    for (const ProgramLine& line : lines_) {
      for (const char c : line.text) {
        if ((c >= 0x20 && c < 0x7f) || c == '\t') continue;
        throw InputError("line " + std::to_string(line.number) +
                         " of the program has a character that the control would not take (write comments in ASCII)");
      }
    }
    tape_ = punch(lines_, options_);
    result_.lines_total = static_cast<long>(lines_.size());
  }

  StreamResult run() {
    const ClockTime start = progress_ = now();
    try {
      while (sent_ < tape_.bytes.size() || connection_.queued() > 0) feed();
      result_.message = std::to_string(result_.lines_total) +
                        " lines sent, and the line has taken them; this protocol acknowledges nothing";
      if (holds_ > 0) result_.message += "; the control held the sender " + std::to_string(holds_) + " times";
    } catch (const Stopped&) {
      result_.end = StreamEnd::kStopped;
      result_.message = "stopped by the user" + account();
    } catch (const JournalError& error) {
      result_.end = StreamEnd::kJournal;
      result_.message = error.what() + account();
    } catch (const IoError& error) {
      result_.end = StreamEnd::kHungUp;
      result_.message = error.what() + account();
    }
    if (stuck_) {
      result_.end = StreamEnd::kStopped;
      result_.message = stuck_message() + " and nobody goes on" + account();
    }
    result_.lines_sent = lines_within(sent_);
    result_.bytes_sent = static_cast<long>(sent_);
    result_.seconds = result_.streaming_seconds = std::chrono::duration<double>(now() - start).count();
    return result_;
  }

 private:
  Connection& connection_;
  const DripOptions& options_;
  const Monitor& monitor_;
  std::vector<ProgramLine> lines_;
  Tape tape_;
  StreamResult result_;
  std::size_t sent_ = 0;
  bool held_ = false, stuck_ = false;
  long holds_ = 0;
  std::size_t queued_ = 0;
  ClockTime progress_{};

  [[nodiscard]] ClockTime now() const { return connection_.clock().now(); }
  [[nodiscard]] long lines_within(std::size_t bytes) const {
    return std::upper_bound(tape_.line_ends.begin(), tape_.line_ends.end(), bytes) - tape_.line_ends.begin();
  }
  [[nodiscard]] std::string account() const {
    return "; " + std::to_string(lines_within(sent_)) + " of " + std::to_string(result_.lines_total) +
           " lines sent; the control goes on with what it has: hold it there (feed hold)";
  }
  [[nodiscard]] std::string stuck_message() const {
    return "the control has taken nothing for " + std::to_string(options_.stuck_after.count() / 1000) +
           " s" + (held_ ? " since its XOFF" : "");
  }

  void feed() {
    std::array<char, 256> replies;
    const std::size_t count = connection_.read_some(replies, kPollInterval);
    for (std::size_t i = 0; i < count; ++i) {
      const bool holds = replies[i] == kXoff;
      if (!holds && replies[i] != kXon) continue;
      if (options_.on_traffic) options_.on_traffic(holds ? "< XOFF" : "< XON");
      holds_ += holds ? 1 : 0;
      held_ = holds;
      progress_ = now();
    }
    const std::size_t queued = connection_.queued();
    if (queued < queued_) progress_ = now();
    queued_ = queued;
    if (!held_ && sent_ < tape_.bytes.size() && queued < options_.most_queued_bytes) {
      const std::size_t room = std::min(options_.most_queued_bytes - queued, tape_.bytes.size() - sent_);
      if (options_.journal != nullptr) options_.journal->sending(std::min(lines_within(sent_ + room) + 1, result_.lines_total));
      const std::size_t taken = connection_.write_some({tape_.bytes.data() + sent_, room}, milliseconds(0));
      if (taken > 0) progress_ = now();
      sent_ += taken;
      queued_ += taken;
    }
    if (options_.on_sent) options_.on_sent(lines_within(sent_));
    monitor_.report("feeding", static_cast<double>(sent_) / static_cast<double>(tape_.bytes.size()));
    monitor_.check();
    if (now() - progress_ < options_.stuck_after) return;
    progress_ = now();
    if (options_.on_operator && options_.on_operator(stuck_message())) return;
    stuck_ = true;
    throw Stopped();
  }
};

}  // namespace

StreamResult drip_feed(Connection& connection, std::string_view program, const DripOptions& options,
                       const Monitor& monitor) {
  return DripFeed(connection, program, options, monitor).run();
}

}  // namespace lightmill

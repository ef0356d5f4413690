#include "machine/block_transfer.h"

#include <array>
#include <optional>

#include "design/core/errors.h"
#include "machine/detail/fe_block.h"
#include "machine/program_lines.h"

namespace lightmill {

namespace {

using detail::FeArrival;
using std::chrono::milliseconds;

constexpr milliseconds kPollInterval{20};

struct Ended {
  StreamEnd end;
  std::string message;
};

class BlockTransfer {
 public:
  BlockTransfer(Connection& connection, std::string_view program, const BlockTransferOptions& options,
                const Monitor& monitor)
      : connection_(connection), options_(options), monitor_(monitor), lines_(program_lines(program)) {
    for (const ProgramLine& line : lines_) {
      for (const char c : line.text) {
        if (c >= 0x20 && c < 0x7f) continue;
        throw InputError("line " + std::to_string(line.number) +
                         " of the program has a character that seven bits do not hold (write comments in ASCII)");
      }
    }
    result_.lines_total = static_cast<long>(lines_.size());
  }

  StreamResult run() {
    const ClockTime start = now();
    try {
      wait_for_request();
      const ClockTime streaming = now();
      for (const ProgramLine& line : lines_) {
        monitor_.check();
        send(detail::fe_block(detail::kStx, line.text, options_.printable_check),
             "line " + std::to_string(line.number));
        result_.lines_sent = ++result_.lines_acknowledged;
        monitor_.report("sending", static_cast<double>(result_.lines_sent) / static_cast<double>(lines_.size()));
      }
      // The control closes the transfer itself.
      send(std::string(1, detail::kEtx), "the program's end", detail::kEot);
      result_.streaming_seconds = std::chrono::duration<double>(now() - streaming).count();
      result_.message = std::to_string(result_.lines_acknowledged) + " lines are on the control's disk as " + name_;
    } catch (const Ended& ended) {
      stop(ended.end, ended.message);
    } catch (const Stopped&) {
      stop(StreamEnd::kStopped, "stopped by the user");
    } catch (const IoError& error) {
      result_.end = StreamEnd::kHungUp;
      result_.message = error.what() + account();
    }
    result_.seconds = std::chrono::duration<double>(now() - start).count();
    return result_;
  }

 private:
  Connection& connection_;
  const BlockTransferOptions& options_;
  const Monitor& monitor_;
  std::vector<ProgramLine> lines_;
  StreamResult result_;
  detail::FeReader reader_;
  std::string unread_;
  std::string name_;  ///< that the control has asked for

  [[nodiscard]] ClockTime now() const { return connection_.clock().now(); }
  [[nodiscard]] std::string account() const {
    return "; " + std::to_string(result_.lines_acknowledged) + " of " + std::to_string(result_.lines_total) +
           " lines acknowledged; nothing has moved: delete what the control holds of it and read in again";
  }

  void stop(StreamEnd end, const std::string& message) {
    result_.end = end;
    result_.message = message + account();
    try {
      write(detail::fe_block(detail::kSoh, "STOPPED"));  // an error of the sender's: ends the reading in
    } catch (const IoError&) {
      // Then nobody is there.
    }
  }

  void write(const std::string& bytes) {
    std::size_t written = 0;
    const ClockTime end = now() + options_.reply_timeout;
    while (written < bytes.size()) {
      written += connection_.write_some({bytes.data() + written, bytes.size() - written}, kPollInterval);
      if (now() > end) throw Ended{StreamEnd::kLostAcknowledgement, "the line takes no bytes"};
    }
    result_.bytes_sent += static_cast<long>(bytes.size());
  }

  std::optional<FeArrival> hear(milliseconds timeout) {
    const ClockTime end = now() + timeout;
    for (;;) {
      while (!unread_.empty()) {
        const char byte = unread_.front();
        unread_.erase(0, 1);
        if (auto arrival = reader_.push(byte)) {
          if (options_.on_traffic) options_.on_traffic("< " + name_of(*arrival));
          return arrival;
        }
      }
      monitor_.check();
      if (now() >= end) return std::nullopt;
      std::array<char, 256> bytes;
      const std::size_t count = connection_.read_some(bytes, kPollInterval);
      unread_.assign(bytes.data(), count);
    }
  }

  static std::string name_of(const FeArrival& arrival) {
    switch (arrival.opener) {
      case detail::kAck:
        return "<ACK>";
      case detail::kNak:
        return "<NAK>";
      case detail::kEot:
        return "<EOT>";
      case detail::kEtx:
        return "<ETX>";
      default:
        return (arrival.opener == detail::kSoh ? "<SOH>" : "<STX>") + arrival.text + (arrival.sound ? "" : " (unsound)");
    }
  }

  /// <SOH> type name mode <ETB>: mode E asks for a program.
  void wait_for_request() {
    const ClockTime end = now() + options_.start_timeout;
    while (now() < end) {
      const auto request = hear(kPollInterval);
      if (!request || request->opener != detail::kSoh) continue;
      if (!request->sound) {
        write(std::string(1, detail::kNak));
        continue;
      }
      if (request->text.size() < 2 || request->text.back() != 'E') {
        throw Ended{StreamEnd::kControllerError,
                    "the control wants to send, not to read ('" + request->text + "'): choose reading in there"};
      }
      name_ = request->text.substr(1, request->text.size() - 2);
      write(std::string(1, detail::kAck));
      return;
    }
    throw IoError("the control on " + connection_.name() +
                  " does not ask for a program: start reading in (blockwise, FE) there, check baud rate and 7E1");
  }

  void send(const std::string& block, const std::string& what, char good = detail::kAck) {
    for (int repeats = 0;; ++repeats) {
      if (options_.on_traffic) options_.on_traffic("> " + what);
      write(block);
      const auto answer = hear(options_.reply_timeout);
      if (!answer) throw Ended{StreamEnd::kLostAcknowledgement, "no answer to " + what};
      // Whole blocks are read before they are answered; an answer to a block that is still on its way is another's.
      if (connection_.queued() > 0) {
        throw Ended{StreamEnd::kLostAcknowledgement, "the control answered twice before " + what};
      }
      if (answer->opener == good) return;
      if (answer->opener != detail::kNak) {
        throw Ended{StreamEnd::kControllerError, "the control broke off at " + what + ": " + name_of(*answer)};
      }
      if (repeats == options_.most_repeats) {
        throw Ended{StreamEnd::kControllerError, "the control refused " + what + " " +
                                                     std::to_string(repeats + 1) + " times: the line is disturbed"};
      }
      ++result_.repeated_blocks;
    }
  }
};

}  // namespace

StreamResult transfer_blockwise(Connection& connection, std::string_view program, const BlockTransferOptions& options,
                                const Monitor& monitor) {
  return BlockTransfer(connection, program, options, monitor).run();
}

}  // namespace lightmill

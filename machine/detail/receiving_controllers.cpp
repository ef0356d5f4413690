// Controls that take a program as a text: blockwise onto their disk (FE), or drip fed with XON and XOFF. What the text
// means is read by the reader of their dialect (program_run.h).
#include <algorithm>
#include <cmath>

#include "machine/detail/controller.h"
#include "machine/detail/fe_block.h"
#include "machine/detail/line_buffer.h"
#include "machine/detail/receive_buffer.h"
#include "machine/program_lines.h"

namespace lightmill::detail {

namespace {

using std::chrono::milliseconds;

class ReceivingController : public Controller {
 public:
  using Controller::Controller;
  void add_to(SimulationResult& result) const override {
    result.lines = lines_;
    result.received_bytes = received_bytes_;
    result.received_digest = digest_.hex();
    result.received_program = text_;
    result.alarm = alarm_;
  }

 protected:
  long lines_ = 0, received_bytes_ = 0;
  LineDigest digest_;
  std::string text_;
  bool alarm_ = false;

  void store(std::string_view line) {
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.remove_suffix(1);
    if (line.empty()) return;
    text_ += line;
    text_ += '\n';
    digest_.add(line);
    ++lines_;
  }
  void raise_alarm(const std::string& message) {
    alarm_ = true;
    mill_.add_fault("alarm", message, lines_ + 1);
  }
};

/// Asks for a program, then acknowledges or refuses each block.
class BlockwiseController final : public ReceivingController {
 public:
  using ReceivingController::ReceivingController;

  void power_on() override { ask(); }

  void receive(std::string_view bytes) override {
    for (const char byte : bytes) {
      ++received_bytes_;
      last_byte_ = mill_.clock().now();
      if (const auto arrival = reader_.push(byte)) take(*arrival);
    }
  }

  bool work() override {
    const ClockTime now = mill_.clock().now();
    if (reader_.inside() && now >= last_byte_ + kBlockTimeout) {
      // The end of the block got lost.
      reader_.clear();
      replies_ += kNak;
      return true;
    }
    if (asking_ && now >= asked_ + kAskAgain) {
      ask();
      return true;
    }
    return false;
  }

  [[nodiscard]] ClockTime next_event() const override {
    const ClockTime block = reader_.inside() ? last_byte_ + kBlockTimeout : kNever;
    return std::min(block, asking_ ? asked_ + kAskAgain : kNever);
  }

 private:
  static constexpr milliseconds kBlockTimeout{1000}, kAskAgain{3000};
  FeReader reader_;
  bool asking_ = false, reading_ = false;
  ClockTime asked_{}, last_byte_{};

  void ask() {
    asking_ = true;
    asked_ = mill_.clock().now();
    replies_ += fe_block(kSoh, "H1E");
  }

  void take(const FeArrival& arrival) {
    if (asking_) {
      if (arrival.opener == kAck) {
        asking_ = false;
        reading_ = true;
      } else if (arrival.opener == kNak) {
        ask();
      }
      return;
    }
    if (!reading_) return;
    if (arrival.opener == kSoh && arrival.sound) {
      reading_ = false;
      raise_alarm("the reading in was broken off: " + arrival.text);
      replies_ += kEot;
    } else if (arrival.opener == kEtx) {
      reading_ = false;
      replies_ += kEot;
    } else if (arrival.opener == kStx && arrival.sound) {
      store(arrival.text);
      replies_ += kAck;
    } else {
      replies_ += kNak;
    }
  }
};

/// Takes lines at its own pace and stops the sender while its buffer is full.
class DripController final : public ReceivingController {
 public:
  explicit DripController(Mill& mill)
      : ReceivingController(mill),
        buffer_(mill.machine().receive_buffer_bytes),
        heidenhain_(mill.machine().controller.starts_with("heidenhain")),
        stop_at_(mill.machine().receive_buffer_bytes * 3 / 4),
        start_at_(mill.machine().receive_buffer_bytes / 4) {}

  void power_on() override { replies_ += kDc1; }

  void receive(std::string_view bytes) override {
    for (const char byte : bytes) {
      ++received_bytes_;
      if (state_ == State::kEnded || alarm_) continue;
      // Before the first mark there is only leader. A Heidenhain text has none: it begins anywhere and ends with EOT.
      if (state_ == State::kLeader && (heidenhain_ ? byte <= ' ' : byte != '%')) continue;
      said_eot_ = said_eot_ || (heidenhain_ && byte == kEot);
      if (said_eot_ || (heidenhain_ && byte == kEtx)) continue;
      if (state_ == State::kLeader) state_ = State::kReading;
      if (byte == '\0') {
        raise_alarm("parity");
        hold();
        continue;
      }
      buffer_.push(byte);
    }
    if (!holding_ && buffer_.fill() >= stop_at_) hold();
  }

  bool work() override {
    if (alarm_ || state_ != State::kReading || mill_.clock().now() < next_block_) return false;
    const bool whole = block_.fill_from(buffer_);
    if (block_.overlong()) {
      raise_alarm("a block without end");
      hold();
      return false;
    }
    if (whole) {
      take(block_.kept());
      block_.clear();
      next_block_ = mill_.clock().now() + block_time();
    }
    if (holding_ && buffer_.fill() <= start_at_ && state_ == State::kReading) {
      holding_ = false;
      replies_ += kDc1;
    }
    return whole;
  }

  [[nodiscard]] ClockTime next_event() const override {
    return !alarm_ && state_ == State::kReading && buffer_.fill() > 0 && next_block_ > mill_.clock().now() ? next_block_
                                                                                                          : kNever;
  }

  void add_to(SimulationResult& result) const override {
    ReceivingController::add_to(result);
    result.overflowed_bytes = buffer_.lost();
    result.highest_buffer_fill = buffer_.highest();
  }

 private:
  enum class State { kLeader, kReading, kEnded };
  static constexpr std::size_t kLongestBlock = 4096;
  ReceiveBuffer buffer_;
  LineBuffer block_{LineBuffer::Keeps::kAll, kLongestBlock};
  bool heidenhain_, said_eot_ = false;
  int stop_at_, start_at_;
  State state_ = State::kLeader;
  bool holding_ = false;
  ClockTime next_block_{};

  [[nodiscard]] ClockTime block_time() const {
    return ClockTime(static_cast<ClockTime::rep>(mill_.options().drip_block_s * 1e9));
  }
  void hold() {
    holding_ = true;
    replies_ += kDc3;
  }
  void take(std::string_view line) {
    const bool mark = line.starts_with('%');
    // The first mark opens; the next one, alone on its line, closes.
    const bool closes = mark && lines_ > 0;
    store(line);
    if (!closes) return;
    state_ = State::kEnded;
    hold();
  }
};

}  // namespace

std::unique_ptr<Controller> make_blockwise_controller(Mill& mill) {
  return std::make_unique<BlockwiseController>(mill);
}

std::unique_ptr<Controller> make_drip_controller(Mill& mill) {
  return std::make_unique<DripController>(mill);
}

}  // namespace lightmill::detail

// What a machine's control does with the bytes of its serial line: one personality each, over one mill.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "machine/clock.h"
#include "machine/detail/mill.h"
#include "machine/simulated_machine.h"

namespace lightmill::detail {

class Controller {
 public:
  explicit Controller(Mill& mill) : mill_(mill) {}
  virtual ~Controller() = default;
  Controller(const Controller&) = delete;
  Controller& operator=(const Controller&) = delete;

  virtual void power_on() = 0;
  /// Bytes as they come off the wire.
  virtual void receive(std::string_view bytes) = 0;
  /// Executes one buffered line; false if there is none or the machine waits for something.
  virtual bool work() = 0;
  /// When work() may find something to do although nothing is received and no motion ends; kNever: not so.
  [[nodiscard]] virtual ClockTime next_event() const { return kNever; }
  virtual void begin_program() {}
  /// Without power: hears and says nothing.
  [[nodiscard]] virtual bool dead() const { return false; }
  /// Fills in what the control knows of a result.
  virtual void add_to(SimulationResult& result) const = 0;

  std::string take_replies() {
    std::string replies;
    replies.swap(replies_);
    return replies;
  }

 protected:
  Mill& mill_;
  std::string replies_;
};

/// grbl 1.1 or grblHAL.
std::unique_ptr<Controller> make_grbl_controller(Mill& mill, Personality personality);
/// Takes a program blockwise (FE) onto its disk.
std::unique_ptr<Controller> make_blockwise_controller(Mill& mill);
/// Is drip fed with XON and XOFF.
std::unique_ptr<Controller> make_drip_controller(Mill& mill);

}  // namespace lightmill::detail

#include "machine/clock.h"

namespace lightmill {

namespace {

class WallClock final : public Clock {
 public:
  [[nodiscard]] ClockTime now() const override {
    return std::chrono::duration_cast<ClockTime>(std::chrono::steady_clock::now().time_since_epoch());
  }
};

}  // namespace

const Clock& wall_clock() {
  static const WallClock clock;
  return clock;
}

}  // namespace lightmill

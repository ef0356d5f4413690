// Progress out of, and the wish to stop into, a long stage. Only the command line prints.
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "design/core/errors.h"

namespace lightmill {

/// The last parameter of every long stage. A default one is silent and never stops.
struct Monitor {
  /// Called with what is being done and the done fraction of the stage in [0, 1]; may be called from the stage's thread only.
  std::function<void(std::string_view what, double fraction)> on_progress;
  /// Called now and then; true means: stop as soon as it is clean to do so.
  std::function<bool()> should_stop;

  /// Reports progress. Throws Stopped if the user wants to stop.
  void report(std::string_view what, double fraction) const {
    if (on_progress) on_progress(what, fraction);
    check();
  }
  /// Throws Stopped if the user wants to stop.
  void check() const {
    if (should_stop && should_stop()) throw Stopped();
  }
  /// A monitor for a part of this stage that spans [from, to] of its progress.
  [[nodiscard]] Monitor part(double from, double to) const {
    Monitor inner;
    if (on_progress) {
      inner.on_progress = [outer = on_progress, from, to](std::string_view what, double fraction) {
        outer(what, from + (to - from) * fraction);
      };
    }
    inner.should_stop = should_stop;
    return inner;
  }
};

}  // namespace lightmill

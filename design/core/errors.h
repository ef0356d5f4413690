// The three exceptions, one per person who can help.
#pragma once

#include <stdexcept>

namespace lightmill {

/// The user can help: a bad file, value or job. The message is one line that names what, where and the remedy.
struct InputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// The system can help: a file that cannot be written, a port that is not there.
struct IoError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// We can help: an iteration that did not end where the mathematics says it must.
struct NumericalError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// The user asked to stop (Ctrl-C). Finished stages stay usable.
struct Stopped : std::runtime_error {
  Stopped() : std::runtime_error("stopped by the user") {}
};

}  // namespace lightmill

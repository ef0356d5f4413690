#include "cli/operator_keys.h"

#include <poll.h>
#include <unistd.h>

#include <array>
#include <cstdio>

namespace lightmill {

namespace {

constexpr char kFeedAsProgrammed = '\x90', kFeedUp = '\x91', kFeedDown = '\x92';

}  // namespace

OperatorKeys::OperatorKeys(int terminal)
    : terminal_(terminal), is_terminal_(::isatty(terminal) == 1 && ::tcgetattr(terminal, &before_) == 0) {
  listen(true);
}

OperatorKeys::~OperatorKeys() {
  listen(false);
}

void OperatorKeys::listen(bool to_keys) const {
  if (!is_terminal_) return;
  termios settings = before_;
  if (to_keys) {
    settings.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
    settings.c_cc[VMIN] = 0;
    settings.c_cc[VTIME] = 0;
  }
  ::tcsetattr(terminal_, TCSANOW, &settings);
}

std::string OperatorKeys::pressed() {
  std::string bytes;
  if (!is_terminal_) return bytes;
  pollfd waiting{terminal_, POLLIN, 0};
  std::array<char, 64> keys;
  if (::poll(&waiting, 1, 0) <= 0) return bytes;
  const ssize_t count = ::read(terminal_, keys.data(), keys.size());
  for (ssize_t i = 0; i < count; ++i) {
    switch (keys[static_cast<std::size_t>(i)]) {
      case 'h':
      case '!':
        bytes += '!';
        break;
      case 'r':
      case '~':
        bytes += '~';
        break;
      case '+':
        bytes += kFeedUp;
        break;
      case '-':
        bytes += kFeedDown;
        break;
      case '0':
        bytes += kFeedAsProgrammed;
        break;
      default:
        break;
    }
  }
  return bytes;
}

bool OperatorKeys::ask(const std::string& what) {
  if (!is_terminal_) return false;
  listen(false);
  std::fprintf(stderr, "\nThe machine waits: %s\nWhen it is done press Enter to go on, or type q and Enter to stop: ",
               what.c_str());
  bool agreed = true;
  for (char c = 0; c != '\n';) {
    if (::read(terminal_, &c, 1) != 1) {
      agreed = false;
      break;
    }
    agreed = agreed && c == '\n';
  }
  listen(true);
  return agreed;
}

}  // namespace lightmill

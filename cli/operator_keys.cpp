#include "cli/operator_keys.h"

#include <poll.h>
#include <unistd.h>

#include <array>
#include <cstdio>

namespace lightmill {

namespace {

struct Key {
  char key;
  const char* bytes;  ///< of a grbl controller that act at once
  const char* what;
};

constexpr Key kKeys[] = {{'h', "!", "hold: the axes brake and stand, the spindle keeps turning"},
                         {'!', "!", nullptr},
                         {'r', "~", "resume after a hold"},
                         {'~', "~", nullptr},
                         {'+', "\x91", "feed 10 % up"},
                         {'-', "\x92", "feed 10 % down"},
                         {'0', "\x90", "feed as programmed"},
                         {']', "\x9a", "spindle 10 % up"},
                         {'[', "\x9b", "spindle 10 % down"},
                         {'=', "\x99", "spindle as programmed"},
                         {'1', "\x95", "rapids at full speed"},
                         {'2', "\x96", "rapids at half speed"},
                         {'4', "\x97", "rapids at a quarter"},
                         {'q', "\x18", "give up: hold, wait until the axes stand, reset"}};
constexpr char kPauseKey = 'p', kSingleBlockKey = 'b';

}  // namespace

std::string key_list() {
  std::string text;
  const auto add = [&](char key, const char* what) { text += std::string("  ") + key + "  " + what + "\n"; };
  for (const Key& key : kKeys) {
    if (key.what != nullptr) add(key.key, key.what);
  }
  add(kPauseKey, "pause: stop before the next line that is not sent yet, and ask");
  add(kSingleBlockKey, "single block on and off: so before every line");
  return text + "  Ctrl-C  stop: the machine is held and the stream ends\n";
}

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
    const char pressed = keys[static_cast<std::size_t>(i)];
    if (pressed == kPauseKey) pause_ = true;
    if (pressed == kSingleBlockKey) single_block_ = !single_block_;
    for (const Key& key : kKeys) {
      if (key.key == pressed) bytes += key.bytes;
    }
  }
  return bytes;
}

bool OperatorKeys::ask(const std::string& what) {
  pause_ = false;
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

// The operator's keys at the terminal while a program streams.
#pragma once

#include <termios.h>

#include <string>

namespace lightmill {

/// Reads keys as they are pressed, without echo; the terminal is as before when the object goes. Without a terminal
/// there are no keys and nobody can confirm.
class OperatorKeys {
 public:
  explicit OperatorKeys(int terminal);
  ~OperatorKeys();
  OperatorKeys(const OperatorKeys&) = delete;
  OperatorKeys& operator=(const OperatorKeys&) = delete;

  /// What the keys pressed since the last call ask of a grbl controller, as its real-time bytes: h or ! feed hold,
  /// r or ~ resume, + and - the feed by 10 percent, 0 the feed as programmed. Other keys do nothing.
  std::string pressed();
  /// Asks at the terminal; true: Enter alone.
  bool ask(const std::string& what);

  static constexpr const char* kHelp = "keys: h hold, r resume, + - feed by 10 %, 0 feed as programmed, Ctrl-C stop";

 private:
  int terminal_;
  termios before_{};  ///< read while is_terminal_ is found out
  bool is_terminal_;
  void listen(bool to_keys) const;
};

}  // namespace lightmill

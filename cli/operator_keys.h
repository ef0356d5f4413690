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

  /// What the keys pressed since the last call ask of a grbl controller, as its real-time bytes (key_list()). Other keys
  /// do nothing.
  std::string pressed();
  /// Has a key asked for a stop before the next line? A single block stays on until its key is pressed again, a pause
  /// ends with the next ask().
  [[nodiscard]] bool wants_stop() const { return single_block_ || pause_; }
  void set_single_block(bool on) { single_block_ = on; }
  /// Asks at the terminal; true: Enter alone.
  bool ask(const std::string& what);

 private:
  int terminal_;
  termios before_{};  ///< read while is_terminal_ is found out
  bool is_terminal_;
  bool single_block_ = false, pause_ = false;
  void listen(bool to_keys) const;
};

/// All keys in words, a line each.
std::string key_list();

}  // namespace lightmill

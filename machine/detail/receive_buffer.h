// What a control's serial line fills: a ring of bytes that loses what does not fit.
#pragma once

#include <cstddef>
#include <vector>

namespace lightmill::detail {

/// Holds at most size - 1 bytes, as a ring of `size` does.
class ReceiveBuffer {
 public:
  explicit ReceiveBuffer(int size) : ring_(static_cast<std::size_t>(size)) {}

  /// A byte that finds it full is lost.
  void push(char byte) {
    if (free() == 0) {
      ++lost_;
      return;
    }
    ring_[(first_ + fill_) % ring_.size()] = byte;
    ++fill_;
    if (byte == '\n') ++line_ends_;
    if (fill_ > highest_) highest_ = fill_;
  }
  /// The oldest byte; there must be one.
  char pop() {
    const char byte = ring_[first_];
    first_ = (first_ + 1) % ring_.size();
    --fill_;
    if (byte == '\n') --line_ends_;
    return byte;
  }
  void clear() { fill_ = line_ends_ = 0; }

  [[nodiscard]] bool empty() const { return fill_ == 0; }
  [[nodiscard]] bool holds_line() const { return line_ends_ > 0; }
  [[nodiscard]] int fill() const { return static_cast<int>(fill_); }
  [[nodiscard]] int free() const { return static_cast<int>(ring_.size() - 1 - fill_); }
  [[nodiscard]] int highest() const { return static_cast<int>(highest_); }
  [[nodiscard]] long lost() const { return lost_; }

 private:
  std::vector<char> ring_;
  std::size_t first_ = 0, fill_ = 0, line_ends_ = 0, highest_ = 0;
  long lost_ = 0;
};

}  // namespace lightmill::detail

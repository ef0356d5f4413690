// The controller's receive buffer: bounded, and what does not fit is lost.
#pragma once

#include <cstring>
#include <optional>
#include <string_view>
#include <vector>

namespace lightmill::detail {

/// Holds at most size - 1 bytes, as a ring of `size` does. Lines come out whole.
class ReceiveBuffer {
 public:
  explicit ReceiveBuffer(int size) : capacity_(static_cast<std::size_t>(size) - 1), bytes_(capacity_ * 4) {}

  /// False: full, the byte is lost.
  bool push(char byte) {
    if (end_ - begin_ >= capacity_) {
      ++lost_;
      return false;
    }
    if (end_ == bytes_.size()) {
      std::memmove(bytes_.data(), bytes_.data() + begin_, end_ - begin_);
      end_ -= begin_;
      begin_ = 0;
      searched_ = 0;
    }
    bytes_[end_++] = byte;
    if (end_ - begin_ > highest_) highest_ = end_ - begin_;
    return true;
  }

  /// The first whole line, without its line feed; valid until the next push. Nothing if there is none.
  std::optional<std::string_view> next_line() {
    if (searched_ < begin_) searched_ = begin_;
    const void* found = searched_ < end_ ? std::memchr(bytes_.data() + searched_, '\n', end_ - searched_) : nullptr;
    if (found == nullptr) {
      searched_ = end_;
      return std::nullopt;
    }
    const auto at = static_cast<std::size_t>(static_cast<const char*>(found) - bytes_.data());
    const std::string_view line(bytes_.data() + begin_, at - begin_);
    line_end_ = at + 1;
    return line;
  }
  /// Takes the line that next_line() has shown out of the buffer.
  void drop_line() { begin_ = searched_ = line_end_; }

  /// Throws away a beginning that can be no line of a program any more; true if there was one.
  bool drop_longer_than(std::size_t most) {
    if (end_ - begin_ <= most || searched_ != end_) return false;
    begin_ = end_;
    return true;
  }

  void clear() { begin_ = end_ = searched_ = 0; }
  [[nodiscard]] int fill() const { return static_cast<int>(end_ - begin_); }
  [[nodiscard]] int free() const { return static_cast<int>(capacity_ - (end_ - begin_)); }
  [[nodiscard]] int highest() const { return static_cast<int>(highest_); }
  [[nodiscard]] long lost() const { return lost_; }

 private:
  std::size_t capacity_;
  std::vector<char> bytes_;
  std::size_t begin_ = 0, end_ = 0, searched_ = 0, line_end_ = 0, highest_ = 0;
  long lost_ = 0;
};

}  // namespace lightmill::detail

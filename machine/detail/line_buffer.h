// The line that a control puts together out of its receive buffer, byte by byte, before it executes it.
#pragma once

#include <string>
#include <string_view>

#include "machine/detail/receive_buffer.h"

namespace lightmill::detail {

class LineBuffer {
 public:
  /// What it keeps of a line.
  enum class Keeps {
    kAll,      ///< a control that reads programs as texts
    kText,     ///< grblHAL: no control characters, no blanks at the beginning
    kContent,  ///< grbl: no blanks, no comments, no slash, no small letters
  };
  LineBuffer(Keeps keeps, std::size_t longest) : keeps_(keeps), longest_(longest) {}

  /// Takes bytes out of the ring up to the end of a line; true if the line is whole.
  bool fill_from(ReceiveBuffer& ring) {
    while (!whole_ && !ring.empty()) push(ring.pop());
    return whole_;
  }
  [[nodiscard]] bool whole() const { return whole_; }
  /// As it came, without its line feed and the blanks around it.
  [[nodiscard]] std::string_view text() const {
    const std::size_t end = text_.find_last_not_of(kBlanks);
    return std::string_view(text_).substr(0, end + 1);  // npos + 1 is 0
  }
  /// What the control has kept of it.
  [[nodiscard]] std::string_view kept() const { return kept_; }
  /// More was to be kept than fits, or more came than a simulation should remember.
  [[nodiscard]] bool overlong() const { return overlong_; }
  void clear() {
    text_.clear();
    kept_.clear();
    comment_ = '\0';
    whole_ = overlong_ = false;
  }

 private:
  static constexpr std::string_view kBlanks = " \t\r";
  static constexpr std::size_t kLongestText = 1 << 16;
  Keeps keeps_;
  std::size_t longest_;
  std::string text_, kept_;
  char comment_ = '\0';  ///< inside one: what began it
  bool whole_ = false, overlong_ = false;

  void push(char byte) {
    if (byte == '\n') {
      whole_ = true;
      return;
    }
    if (!text_.empty() || kBlanks.find(byte) == std::string_view::npos) {
      if (text_.size() == kLongestText) {
        overlong_ = true;
        return;
      }
      text_ += byte;
    }
    if (!drops(byte)) keep(byte);
  }
  bool drops(char byte) {
    if (keeps_ == Keeps::kAll) return false;
    if (keeps_ == Keeps::kText) return byte < ' ' || (byte == ' ' && kept_.empty());
    if (comment_ != '\0') {
      if (comment_ == '(' && byte == ')') comment_ = '\0';
      return true;
    }
    if (byte == '(' || byte == ';') comment_ = byte;
    return comment_ != '\0' || byte <= ' ' || byte == '/';
  }
  void keep(char byte) {
    if (kept_.size() == longest_) {
      overlong_ = true;
      return;
    }
    kept_ += keeps_ == Keeps::kContent && byte >= 'a' && byte <= 'z' ? static_cast<char>(byte - 'a' + 'A') : byte;
  }
};

}  // namespace lightmill::detail

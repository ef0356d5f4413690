// The blocks of Heidenhain's FE protocol: opener, text, ETB, a check character, DC1.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace lightmill::detail {

inline constexpr char kSoh = 0x01, kStx = 0x02, kEtx = 0x03, kEot = 0x04, kAck = 0x06, kDc1 = 0x11, kDc3 = 0x13,
                      kNak = 0x15, kEtb = 0x17;

/// Of all bytes up to ETB, both ends included.
inline char block_check(std::string_view bytes) {
  char check = 0;
  for (const char byte : bytes) check = static_cast<char>(check ^ byte);
  return check;
}

/// A whole block. `printable_check`: a blank before ETB keeps the check character from being a control character (MP5020
/// bit 1).
inline std::string fe_block(char opener, std::string_view text, bool printable_check = false) {
  std::string block = opener + std::string(text) + kEtb;
  if (printable_check && static_cast<unsigned char>(block_check(block)) < 0x20) block.insert(block.size() - 1, 1, ' ');
  const char check = block_check(block);
  return block + check + kDc1;
}

/// What came: a block, or one of the characters that stand alone (ACK, NAK, ETX, EOT), which is then the opener.
struct FeArrival {
  char opener = 0;
  std::string text;
  bool sound = true;  ///< the check character is right
};

class FeReader {
 public:
  std::optional<FeArrival> push(char byte) {
    if (block_.empty()) {
      if (byte == kAck || byte == kNak || byte == kEtx || byte == kEot) return FeArrival{byte, "", true};
      if (byte == kSoh || byte == kStx) block_ = byte;
      return std::nullopt;
    }
    block_ += byte;
    const std::size_t size = block_.size();
    if (size > kLongest) return finish(false);
    // The check character may look like any other: only its place tells it.
    if (byte != kDc1 || size < 4 || block_[size - 3] != kEtb) return std::nullopt;
    return finish(block_check(std::string_view(block_).substr(0, size - 2)) == block_[size - 2]);
  }
  [[nodiscard]] bool inside() const { return !block_.empty(); }
  void clear() { block_.clear(); }

 private:
  static constexpr std::size_t kLongest = 512;
  std::string block_;
  FeArrival finish(bool sound) {
    FeArrival arrival{block_.front(), sound ? block_.substr(1, block_.size() - 4) : "", sound};
    block_.clear();
    return arrival;
  }
};

}  // namespace lightmill::detail

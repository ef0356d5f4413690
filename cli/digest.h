// SHA-256 of texts and files: what a stage was made from, and which program the machine heard.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

namespace lightmill {

/// Collects bytes; hex() ends it [FIPS 180-4].
class Sha256 {
 public:
  Sha256& add(std::string_view bytes);
  /// The digest of all bytes so far as 64 lower-case hexadecimal digits. Call once.
  std::string hex();

 private:
  void block(const unsigned char* bytes);
  std::array<std::uint32_t, 8> state_{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                      0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
  std::array<unsigned char, 64> pending_{};
  std::size_t pending_count_ = 0;
  std::uint64_t total_ = 0;
};

std::string sha256_of_text(std::string_view text);
/// Throws InputError when the file cannot be read.
std::string sha256_of_file(const std::filesystem::path& path);

}  // namespace lightmill

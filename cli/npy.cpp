#include "cli/npy.h"

#include <bit>
#include <cstring>
#include <regex>
#include <string>

#include "design/core/errors.h"
#include "design/core/files.h"

namespace lightmill {

static_assert(std::endian::native == std::endian::little, "files are little-endian and written as memory holds them");

void write_npy(const std::filesystem::path& path, const NpyTable& table) {
  std::string header = "{'descr': '<f8', 'fortran_order': False, 'shape': (" + std::to_string(table.rows()) + ", " +
                       std::to_string(table.columns) + "), }";
  // The header ends in a newline where the total is a multiple of 64.
  header += std::string(63 - (10 + header.size()) % 64, ' ') + "\n";
  std::string bytes("\x93NUMPY\x01\x00", 8);
  bytes += static_cast<char>(header.size() & 0xff);
  bytes += static_cast<char>(header.size() >> 8);
  bytes += header;
  bytes.append(reinterpret_cast<const char*>(table.values.data()), table.values.size() * sizeof(double));
  write_whole(path, bytes);
}

NpyTable read_npy(const std::filesystem::path& path) {
  const std::string bytes = read_whole(path);
  const auto fail = [&](const std::string& why) { return InputError(path.string() + " is no table of float64: " + why); };
  if (bytes.size() < 10 || bytes.compare(0, 8, std::string("\x93NUMPY\x01\x00", 8)) != 0) throw fail("not an npy file of version 1.0");
  const std::size_t length = static_cast<unsigned char>(bytes[8]) + 256U * static_cast<unsigned char>(bytes[9]);
  if (bytes.size() < 10 + length) throw fail("its header is cut off");
  const std::string header = bytes.substr(10, length);
  std::smatch match;
  static const std::regex kShape(R"('shape': \((\d{1,12}), (\d{1,6})\))");
  if (header.find("'descr': '<f8'") == std::string::npos || header.find("'fortran_order': False") == std::string::npos ||
      !std::regex_search(header, match, kShape)) {
    throw fail("its header says " + header);
  }
  NpyTable table;
  const std::size_t rows = std::stoull(match[1]);
  table.columns = std::stoi(match[2]);
  if (bytes.size() != 10 + length + rows * table.columns * sizeof(double)) throw fail("its size does not fit its header");
  table.values.resize(rows * table.columns);
  std::memcpy(table.values.data(), bytes.data() + 10 + length, table.values.size() * sizeof(double));
  return table;
}

}  // namespace lightmill
